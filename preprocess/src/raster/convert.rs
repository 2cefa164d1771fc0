//! Samples to what pages hold: heights in meters, and colors of 8 bits.

use super::error::RasterError;
use super::samples::{Sample, SampleType, Samples, with_samples};
use super::{Block, RasterInfo};

/// The heights of a block: the first band, scaled.
///
/// NaN stands for no data: NaN itself, infinities, samples that equal the no-data value in their
/// own type, pixels whose alpha is 0, and heights beyond the range of an `f32`.
///
/// # Units
///
/// Metres, as far as the file says: `sample * scale + offset`.
///
/// # Shapes
///
/// `out` has the block's `width * height` elements, row by row.
///
/// # Precision
///
/// Scaled in `f64` and rounded once.
///
/// # Panics
///
/// If `out` has another length, or the block's samples are not those of `info`.
pub fn heights_into(block: &Block, info: &RasterInfo, out: &mut [f32]) {
    let stride = checked_stride(block, info, out.len());
    let alpha = info.has_alpha.then(|| usize::from(info.bands));
    with_samples!(&block.samples, values => heights(values, stride, alpha, info, out));
}

fn heights<T: Sample>(
    values: &[T],
    stride: usize,
    alpha: Option<usize>,
    info: &RasterInfo,
    out: &mut [f32],
) {
    let nodata = info.nodata.and_then(T::exactly);
    let (scale, offset) = (info.scale, info.offset);
    for (height, pixel) in out.iter_mut().zip(values.chunks_exact(stride)) {
        let sample = pixel[0];
        let hidden = alpha.is_some_and(|alpha| pixel[alpha] == T::default());
        #[expect(clippy::cast_possible_truncation, reason = "the one rounding that is documented")]
        let scaled = (sample.number() * scale + offset) as f32;
        let valid = Some(sample) != nodata && !hidden && scaled.is_finite();
        *height = if valid { scaled } else { f32::NAN };
    }
}

/// The colors of a block: its first three bands, or its only one three times.
///
/// Alpha is 0 where there is no data: where the file's own alpha is 0, or where every color band
/// equals the no-data value. Elsewhere it is the file's, at least 1, or 255. Samples of 16 bits
/// become the nearest of 8.
///
/// # Shapes
///
/// Both outputs have the block's `width * height` elements, row by row.
///
/// # Errors
///
/// [`RasterError::NotSupported`] unless samples are unsigned integers of 8 or 16 bits.
///
/// # Panics
///
/// If an output has another length, or the block's samples are not those of `info`.
pub fn colors_into(
    block: &Block,
    info: &RasterInfo,
    out_rgb: &mut [[u8; 3]],
    out_alpha: &mut [u8],
) -> Result<(), RasterError> {
    assert_eq!(out_rgb.len(), out_alpha.len(), "colors and alpha are of the same pixels");
    let stride = checked_stride(block, info, out_rgb.len());
    match &block.samples {
        Samples::U8(values) => colors(values, stride, info, |value| value, out_rgb, out_alpha),
        Samples::U16(values) => colors(values, stride, info, byte_of, out_rgb, out_alpha),
        _ => {
            let found = format!("colors of type {:?}", info.sample);
            let supported = format!("{:?} and {:?}", SampleType::U8, SampleType::U16);
            return Err(RasterError::not_supported(&info.path, found, supported));
        }
    }
    Ok(())
}

fn colors<T: Sample>(
    values: &[T],
    stride: usize,
    info: &RasterInfo,
    byte: impl Fn(T) -> u8,
    out_rgb: &mut [[u8; 3]],
    out_alpha: &mut [u8],
) {
    let nodata = info.nodata.and_then(T::exactly);
    let bands = usize::from(info.bands);
    let places = if bands >= 3 { [0, 1, 2] } else { [0; 3] };
    let outputs = out_rgb.iter_mut().zip(out_alpha);
    for ((rgb, alpha), pixel) in outputs.zip(values.chunks_exact(stride)) {
        *rgb = places.map(|place| byte(pixel[place]));
        let empty = nodata.is_some_and(|nodata| pixel[..bands].iter().all(|&band| band == nodata));
        *alpha = match (empty, info.has_alpha) {
            (true, _) => 0,
            (false, false) => 255,
            (false, true) if pixel[bands] == T::default() => 0,
            // A trace of 16 bits must not become the 0 that means no data.
            (false, true) => byte(pixel[bands]).max(1),
        };
    }
}

/// The nearest 8-bit value of a 16-bit one: 0 to 0, 65535 to 255.
fn byte_of(value: u16) -> u8 {
    u8::try_from((u32::from(value) + 128) / 257).expect("65663 / 257 is 255")
}

/// Samples of a pixel, once the block has all of them and the output a place for each.
fn checked_stride(block: &Block, info: &RasterInfo, out: usize) -> usize {
    let pixels = block.width as usize * block.height as usize;
    let stride = info.samples_per_pixel();
    assert_eq!(out, pixels, "an output has one element for each pixel of the block");
    assert_eq!(block.samples.len(), pixels * stride, "the block is one of this raster");
    stride
}

#[cfg(test)]
mod tests {
    use super::super::Outline;
    use super::*;

    fn info(sample: SampleType, bands: u16, has_alpha: bool) -> RasterInfo {
        RasterInfo {
            path: "test.tif".into(),
            width: 2,
            height: 2,
            bands,
            has_alpha,
            sample,
            crs: None,
            outline: Outline { origin: [0.0, 0.0], pixel_size: [1.0, 1.0] },
            point_registered: false,
            nodata: None,
            scale: 1.0,
            offset: 0.0,
            block_width: 2,
            block_height: 2,
        }
    }

    fn block(samples: Samples) -> Block {
        Block { col: 0, row: 0, width: 2, height: 2, samples }
    }

    fn heights_of(samples: Samples, info: &RasterInfo) -> Vec<Option<f32>> {
        let mut out = [0.0; 4];
        heights_into(&block(samples), info, &mut out);
        out.iter().map(|&height| (!height.is_nan()).then_some(height)).collect()
    }

    #[test]
    fn heights_are_scaled_and_nodata_is_compared_before() {
        let info = RasterInfo {
            nodata: Some(-32768.0),
            scale: 0.5,
            offset: -10.0,
            ..info(SampleType::I16, 1, false)
        };
        let samples = Samples::I16(vec![-32768, 0, 3, -32767]);
        let expected = [None, Some(-10.0), Some(-8.5), Some(-16393.5)];
        assert_eq!(heights_of(samples, &info), expected);
    }

    #[test]
    fn a_decimal_nodata_matches_the_float_it_was_written_from() {
        let mut info = info(SampleType::F32, 1, false);
        let samples = || Samples::F32(vec![-3.402_823e38, f32::NAN, f32::NEG_INFINITY, 1.5]);
        info.nodata = Some(-3.402_823_060_737_096_5e38);
        assert_eq!(heights_of(samples(), &info), [None, None, None, Some(1.5)]);
        info.nodata = Some(f64::NAN);
        assert_eq!(heights_of(samples(), &info)[3], Some(1.5));
        info.nodata = None;
        assert_eq!(heights_of(samples(), &info)[0], Some(-3.402_823e38));
    }

    #[test]
    fn heights_beyond_f32_and_under_zero_alpha_are_no_data() {
        let samples = Samples::F64(vec![1e300, -1e39, 0.1, 7.0]);
        let expected = [None, None, Some(0.1), Some(7.0)];
        assert_eq!(heights_of(samples, &info(SampleType::F64, 1, false)), expected);
        let samples = Samples::U16(vec![5, 1, 6, 0, 0, 65535, 0, 0]);
        let expected = [Some(5.0), None, Some(0.0), None];
        assert_eq!(heights_of(samples, &info(SampleType::U16, 1, true)), expected);
    }

    fn colors_of(samples: Samples, info: &RasterInfo) -> ([[u8; 3]; 4], [u8; 4]) {
        let (mut rgb, mut alpha) = ([[9; 3]; 4], [9; 4]);
        colors_into(&block(samples), info, &mut rgb, &mut alpha).unwrap();
        (rgb, alpha)
    }

    #[test]
    fn gray_becomes_rgb_and_the_nodata_value_alpha_zero() {
        let info = RasterInfo { nodata: Some(0.0), ..info(SampleType::U8, 1, false) };
        let (rgb, alpha) = colors_of(Samples::U8(vec![0, 1, 2, 255]), &info);
        assert_eq!(rgb, [[0; 3], [1; 3], [2; 3], [255; 3]]);
        assert_eq!(alpha, [0, 255, 255, 255]);
    }

    #[test]
    fn a_color_is_no_data_only_if_all_its_bands_are() {
        let info = RasterInfo { nodata: Some(0.0), ..info(SampleType::U8, 3, false) };
        let samples = Samples::U8(vec![0, 0, 0, 0, 0, 1, 1, 2, 3, 0, 9, 0]);
        let (rgb, alpha) = colors_of(samples, &info);
        assert_eq!(alpha, [0, 255, 255, 255]);
        assert_eq!(rgb[2], [1, 2, 3]);
    }

    #[test]
    fn sixteen_bits_round_to_eight_and_a_trace_of_alpha_stays() {
        for value in 0..=255_u8 {
            assert_eq!(byte_of(u16::from(value) * 257), value);
        }
        assert_eq!((byte_of(128), byte_of(129), byte_of(65535)), (0, 1, 255));
        let samples = Samples::U16(vec![257, 0, 514, 1, 0, 300, 65535, 65535]);
        let (rgb, alpha) = colors_of(samples, &info(SampleType::U16, 1, true));
        assert_eq!(rgb[1], [2; 3]);
        assert_eq!(alpha, [0, 1, 1, 255]);
    }

    #[test]
    fn colors_of_other_types_are_refused() {
        let (mut rgb, mut alpha) = ([[0; 3]; 4], [0; 4]);
        let samples = block(Samples::F32(vec![0.0; 4]));
        let result = colors_into(&samples, &info(SampleType::F32, 1, false), &mut rgb, &mut alpha);
        assert!(result.unwrap_err().to_string().contains("F32"));
    }
}
