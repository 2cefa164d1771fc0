//! Samples to what pages hold: heights in meters, and colors of 8 bits.
//!
//! Both functions lay a window of a block over planes of a destination whose rows are `stride`
//! texels apart, and leave those texels as they were that have no data: several rasters over one
//! another are several calls on planes that were blank at first.

use std::ops::Range;

use super::error::RasterError;
use super::samples::{Sample, SampleType, Samples, with_samples};
use super::{Block, RasterInfo};

/// A rectangle of a raster's pixels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Window {
    /// Columns of the raster.
    pub cols: Range<u32>,
    /// Rows of the raster, counted downward.
    pub rows: Range<u32>,
}

/// How much of a destination was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filled {
    /// Every texel, and each is opaque: no mask need be looked at.
    All,
    /// Some texels, or some that are not opaque.
    Part,
    /// No texel at all.
    Nothing,
}

impl Window {
    /// All of a block.
    #[must_use]
    pub const fn of(block: &Block) -> Self {
        Self { cols: block.col..block.col + block.width, rows: block.row..block.row + block.height }
    }
}

/// Lays the heights of a window of `block` over `out`: the first band, scaled.
///
/// What has no data is left as it was: NaN, infinities, samples that equal the no-data value in
/// their own type, pixels whose alpha is 0, and heights beyond the range of an `f32`.
///
/// # Units
///
/// Metres, as far as the file says: `sample * scale + offset`.
///
/// # Shapes
///
/// `out` begins with the window's first texel; those of the next row follow `stride` later.
///
/// # Precision
///
/// Scaled in `f64` and rounded once.
///
/// # Panics
///
/// If the window is not inside the block, the block's samples are not those of `info`, or `out` or
/// `stride` is too short for the window.
pub fn heights_into(
    block: &Block,
    info: &RasterInfo,
    window: &Window,
    out: &mut [f32],
    stride: usize,
) -> Filled {
    let part = Part::new(block, info, window, stride);
    part.check(out.len());
    let written = with_samples!(&block.samples, values => heights(values, &part, info, out));
    part.filled(written, written)
}

fn heights<T: Sample>(values: &[T], part: &Part, info: &RasterInfo, out: &mut [f32]) -> usize {
    let nodata = info.nodata.and_then(T::exactly);
    let (scale, offset) = (info.scale, info.offset);
    let lines = || part.lines(values);
    let rows = out.chunks_mut(part.stride).map(|row| &mut row[..part.width]);
    #[expect(clippy::cast_possible_truncation, reason = "the one rounding that is documented")]
    let scaled = |sample: T| (sample.number() * scale + offset) as f32;
    // What it is for a scale of 1 and no offset, which compilers turn into one conversion.
    #[expect(clippy::cast_possible_truncation, reason = "the one rounding that is documented")]
    let plain = |sample: T| (sample.number() + 0.0) as f32;
    #[expect(clippy::float_cmp, reason = "the values that files have where nothing is scaled")]
    let is_plain = (scale, offset) == (1.0, 0.0);

    if part.samples > 1 {
        let alpha = info.has_alpha.then(|| usize::from(info.bands));
        let hidden = |pixel: &[T]| alpha.is_some_and(|alpha| pixel[alpha] == T::default());
        return lines()
            .zip(rows)
            .map(|(line, row)| {
                let pixels = line.chunks_exact(part.samples);
                lay(pixels, row, |pixel| {
                    (scaled(pixel[0]), Some(pixel[0]) != nodata && !hidden(pixel))
                })
            })
            .sum();
    }
    // One loop for each case, so that each is a vector loop without the others' questions.
    lines()
        .zip(rows)
        .map(|(line, row)| match (nodata, is_plain) {
            (None, true) => lay(line, row, |&sample| (plain(sample), true)),
            (None, false) => lay(line, row, |&sample| (scaled(sample), true)),
            (Some(nodata), true) => lay(line, row, |&sample| (plain(sample), sample != nodata)),
            (Some(nodata), false) => lay(line, row, |&sample| (scaled(sample), sample != nodata)),
        })
        .sum()
}

/// Writes what is valid and finite; how many texels that are.
#[inline(always)]
fn lay<S>(
    samples: impl IntoIterator<Item = S>,
    row: &mut [f32],
    height: impl Fn(S) -> (f32, bool),
) -> usize {
    let mut written = 0_u32;
    for (texel, sample) in row.iter_mut().zip(samples) {
        let (height, valid) = height(sample);
        let valid = valid & height.is_finite();
        *texel = if valid { height } else { *texel };
        written += u32::from(valid);
    }
    written as usize
}

/// Lays the colors of a window of `block` over three planes: its first three bands, or its only one
/// three times.
///
/// What has no data is left as it was: where the file's own alpha is 0, or where every color band
/// equals the no-data value. Elsewhere alpha becomes the file's, at least 1, or 255. Samples of 16
/// bits become the nearest of 8.
///
/// # Shapes
///
/// Each plane and `alpha` begin with the window's first texel; those of the next row follow
/// `stride` later.
///
/// # Errors
///
/// [`RasterError::NotSupported`] unless samples are unsigned integers of 8 or 16 bits.
///
/// # Panics
///
/// See [`heights_into`].
pub fn colors_into(
    block: &Block,
    info: &RasterInfo,
    window: &Window,
    planes: [&mut [u8]; 3],
    alpha: &mut [u8],
    stride: usize,
) -> Result<Filled, RasterError> {
    let part = Part::new(block, info, window, stride);
    planes.iter().for_each(|plane| part.check(plane.len()));
    part.check(alpha.len());
    let to = Colors { planes, alpha };
    Ok(match &block.samples {
        Samples::U8(values) => colors(values, &part, info, |value| value, to),
        Samples::U16(values) => colors(values, &part, info, byte_of, to),
        _ => {
            let found = format!("colors of type {:?}", info.sample);
            let supported = format!("{:?} and {:?}", SampleType::U8, SampleType::U16);
            return Err(RasterError::not_supported(&info.path, found, supported));
        }
    })
}

/// Where colors are laid.
struct Colors<'out> {
    planes: [&'out mut [u8]; 3],
    alpha: &'out mut [u8],
}

fn colors<T: Sample>(
    values: &[T],
    part: &Part,
    info: &RasterInfo,
    byte: impl Fn(T) -> u8,
    to: Colors,
) -> Filled {
    let nodata = info.nodata.and_then(T::exactly);
    let bands = usize::from(info.bands);
    let places = if bands >= 3 { [0, 1, 2] } else { [0; 3] };
    let always_opaque = nodata.is_none() && !info.has_alpha;
    let (mut written, mut opaque) = (0, 0);
    let [reds, greens, blues] = to.planes.map(|plane| plane.chunks_mut(part.stride));
    let rows = reds.zip(greens).zip(blues).zip(to.alpha.chunks_mut(part.stride));
    for (line, (((red, green), blue), alpha)) in part.lines(values).zip(rows) {
        let [red, green, blue, alpha] = [red, green, blue, alpha].map(|row| &mut row[..part.width]);
        if always_opaque {
            match part.samples {
                1 => split::<T, 1>(line, [0; 3], &byte, [red, green, blue]),
                3 => split::<T, 3>(line, places, &byte, [red, green, blue]),
                _ => {
                    for (index, pixel) in line.chunks_exact(part.samples).enumerate() {
                        let [r, g, b] = places.map(|place| byte(pixel[place]));
                        (red[index], green[index], blue[index]) = (r, g, b);
                    }
                }
            }
            alpha.fill(255);
            (written, opaque) = (written + part.width, opaque + part.width);
            continue;
        }
        for (index, pixel) in line.chunks_exact(part.samples).enumerate() {
            let empty =
                nodata.is_some_and(|nodata| pixel[..bands].iter().all(|&band| band == nodata));
            let opacity = match info.has_alpha {
                false => 255,
                true if pixel[bands] == T::default() => 0,
                // A trace of 16 bits must not become the 0 that means no data.
                true => byte(pixel[bands]).max(1),
            };
            if !empty && opacity > 0 {
                let [r, g, b] = places.map(|place| byte(pixel[place]));
                (red[index], green[index], blue[index]) = (r, g, b);
                alpha[index] = opacity;
                written += 1;
                opaque += usize::from(opacity == 255);
            }
        }
    }
    part.filled(written, opaque)
}

/// Splits pixels of a fixed number of samples into planes.
#[inline(always)]
fn split<T: Copy, const SAMPLES: usize>(
    line: &[T],
    places: [usize; 3],
    byte: impl Fn(T) -> u8,
    [red, green, blue]: [&mut [u8]; 3],
) {
    let texels = red.iter_mut().zip(green).zip(blue);
    for (((red, green), blue), pixel) in texels.zip(line.as_chunks::<SAMPLES>().0) {
        let [r, g, b] = places.map(|place| byte(pixel[place]));
        (*red, *green, *blue) = (r, g, b);
    }
}

/// The nearest 8-bit value of a 16-bit one: 0 to 0, 65535 to 255.
fn byte_of(value: u16) -> u8 {
    u8::try_from((u32::from(value) + 128) / 257).expect("65663 / 257 is 255")
}

/// A window of a block's samples, and the destination's stride.
struct Part {
    /// Samples of a pixel.
    samples: usize,
    /// Samples of a row of the block.
    line: usize,
    /// The first sample of the window in its rows.
    first: usize,
    rows: Range<usize>,
    /// Pixels of the window.
    width: usize,
    stride: usize,
}

impl Part {
    fn new(block: &Block, info: &RasterInfo, window: &Window, stride: usize) -> Self {
        let whole = Window::of(block);
        let inside = |part: &Range<u32>, whole: &Range<u32>| {
            whole.start <= part.start && part.start <= part.end && part.end <= whole.end
        };
        assert!(
            inside(&window.cols, &whole.cols) && inside(&window.rows, &whole.rows),
            "the window is inside the block"
        );
        let samples = info.samples_per_pixel();
        let line = block.width as usize * samples;
        assert_eq!(
            block.samples.len(),
            line * block.height as usize,
            "the block is one of this raster"
        );
        let width = (window.cols.end - window.cols.start) as usize;
        assert!(width <= stride, "rows of the destination do not overlap");
        Self {
            samples,
            line,
            first: (window.cols.start - block.col) as usize * samples,
            rows: (window.rows.start - block.row) as usize..(window.rows.end - block.row) as usize,
            width,
            stride: stride.max(1),
        }
    }

    /// Checks that a destination of `len` texels has all rows.
    fn check(&self, len: usize) {
        let needed =
            self.rows.len().checked_sub(1).map_or(0, |last| last * self.stride + self.width);
        assert!(len >= needed, "the destination has {len} texels, not {needed}");
    }

    /// The window's rows of samples.
    fn lines<'values, T>(&self, values: &'values [T]) -> impl Iterator<Item = &'values [T]> {
        let Self { line, first, .. } = *self;
        let len = self.width * self.samples;
        self.rows.clone().map(move |row| &values[row * line + first..][..len])
    }

    fn filled(&self, written: usize, opaque: usize) -> Filled {
        if opaque == self.width * self.rows.len() {
            Filled::All
        } else if written > 0 {
            Filled::Part
        } else {
            Filled::Nothing
        }
    }
}

/// Heights of a whole block, NaN where there is no data.
#[cfg(test)]
pub(crate) fn whole_heights(block: &Block, info: &RasterInfo) -> Vec<f32> {
    let mut heights = vec![f32::NAN; block.width as usize * block.height as usize];
    heights_into(block, info, &Window::of(block), &mut heights, block.width as usize);
    heights
}

/// Colors of a whole block and their alpha, 0 where there is no data.
#[cfg(test)]
pub(crate) fn whole_colors(
    block: &Block,
    info: &RasterInfo,
) -> Result<(Vec<[u8; 3]>, Vec<u8>), RasterError> {
    let [mut red, mut green, mut blue, mut alpha] =
        std::array::from_fn(|_| vec![0; block.width as usize * block.height as usize]);
    let planes = [&mut red[..], &mut green, &mut blue];
    colors_into(block, info, &Window::of(block), planes, &mut alpha, block.width as usize)?;
    let colors = red.iter().zip(green).zip(blue).map(|((&red, green), blue)| [red, green, blue]);
    Ok((colors.collect(), alpha))
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
        let out = whole_heights(&block(samples), info);
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

    fn colors_of(samples: Samples, info: &RasterInfo) -> (Vec<[u8; 3]>, Vec<u8>) {
        whole_colors(&block(samples), info).unwrap()
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
        let samples = block(Samples::F32(vec![0.0; 4]));
        let result = whole_colors(&samples, &info(SampleType::F32, 1, false));
        assert!(result.unwrap_err().to_string().contains("F32"));
    }

    /// A block of 7 × 5 pixels at (10, 20) of a raster, of samples 0, 1, 2 ..
    fn numbered(info: &RasterInfo, sample: impl Fn(u16) -> Samples) -> (Block, RasterInfo) {
        let samples = u16::try_from(35 * info.samples_per_pixel()).unwrap();
        let block = Block { col: 10, row: 20, width: 7, height: 5, samples: sample(samples) };
        (block, info.clone())
    }

    #[test]
    fn a_window_is_laid_where_it_belongs_and_nowhere_else() {
        let (block, info) = numbered(&info(SampleType::I16, 2, false), |count| {
            Samples::I16((0..i16::try_from(count).unwrap()).collect())
        });
        for (cols, rows) in [(10..17, 20..25), (11..14, 22..24), (16..17, 24..25), (12..12, 20..21)]
        {
            let window = Window { cols: cols.clone(), rows: rows.clone() };
            let mut out = [-1.0; 50];
            let filled = heights_into(&block, &info, &window, &mut out[3..], 9);
            assert_eq!(filled, Filled::All);
            let mut expected = [-1.0; 50];
            for (row, col) in rows.clone().flat_map(|row| cols.clone().map(move |col| (row, col))) {
                let at = 3 + (row - rows.start) * 9 + col - cols.start;
                expected[at as usize] = (((row - 20) * 7 + col - 10) * 2) as f32;
            }
            assert_eq!(out, expected, "{window:?}");
        }
    }

    #[test]
    fn what_has_no_data_stays_as_it_was() {
        let mut height = RasterInfo { nodata: Some(7.0), ..info(SampleType::U8, 1, false) };
        let samples = block(Samples::U8(vec![7, 1, 2, 7]));
        let mut out = [40.0, 41.0, 42.0, 43.0];
        let window = Window::of(&samples);
        assert_eq!(heights_into(&samples, &height, &window, &mut out, 2), Filled::Part);
        assert_eq!(out, [40.0, 1.0, 2.0, 43.0]);
        let (mut red, mut green, mut blue, mut alpha) = ([4; 4], [5; 4], [6; 4], [9; 4]);
        let planes = [&mut red[..], &mut green, &mut blue];
        let filled = colors_into(&samples, &height, &window, planes, &mut alpha, 2).unwrap();
        assert_eq!((filled, alpha), (Filled::Part, [9, 255, 255, 9]));
        assert_eq!((red, green, blue), ([4, 1, 2, 4], [5, 1, 2, 5], [6, 1, 2, 6]));

        let nothing = Window { cols: 1..2, rows: 1..2 };
        assert_eq!(heights_into(&samples, &height, &nothing, &mut out, 2), Filled::Nothing);
        height.nodata = None;
        assert_eq!(heights_into(&samples, &height, &nothing, &mut out, 2), Filled::All);
    }

    #[test]
    fn translucent_colors_are_not_all() {
        let info = info(SampleType::U8, 1, true);
        let samples = block(Samples::U8(vec![1, 255, 2, 254, 3, 255, 4, 255]));
        let (mut planes, mut alpha) = ([[0; 4]; 3], [0; 4]);
        let mut laid = |window: Window| {
            let planes = planes.each_mut().map(|plane| &mut plane[..]);
            colors_into(&samples, &info, &window, planes, &mut alpha, 2).unwrap()
        };
        assert_eq!(laid(Window::of(&samples)), Filled::Part);
        assert_eq!(laid(Window { cols: 0..2, rows: 1..2 }), Filled::All);
    }

    /// The rule, texel by texel.
    fn expected_height<T: Sample>(sample: T, info: &RasterInfo) -> f32 {
        let nodata = info.nodata.and_then(T::exactly);
        let height = (sample.number() * info.scale + info.offset) as f32;
        if Some(sample) == nodata || !height.is_finite() { f32::NAN } else { height }
    }

    #[test]
    fn every_type_and_scaling_follows_the_rule() {
        let raw: Vec<f64> = vec![0.0, -0.0, 1.0, 100.0, 127.0, -128.0, f64::NAN, 1e39, 0.1, 200.0];
        for sample in [
            Samples::U8(vec![0, 1, 255, 7]),
            Samples::I8(vec![0, 1, -128, 7]),
            Samples::U16(vec![0, 1, 65535, 7]),
            Samples::I16(vec![0, 1, -32768, 7]),
            Samples::U32(vec![0, 1, u32::MAX, 7]),
            Samples::I32(vec![0, 1, i32::MIN, 7]),
            Samples::F32(raw.iter().map(|&value| value as f32).collect()),
            Samples::F64(raw),
        ] {
            for (scale, offset) in [(1.0, 0.0), (0.1, -5.0), (1.0, 1e39)] {
                for nodata in [None, Some(7.0), Some(0.0), Some(f64::NAN), Some(-0.5)] {
                    let base = info(sample.sample_type(), 1, false);
                    let info = RasterInfo { nodata, scale, offset, ..base };
                    let width = u32::try_from(sample.len()).unwrap();
                    let samples = sample.clone();
                    let block = Block { col: 0, row: 0, width, height: 1, samples };
                    let expected: Vec<u32> = with_samples!(&sample, values => values
                        .iter()
                        .map(|&value| expected_height(value, &info).to_bits())
                        .collect());
                    let found = whole_heights(&block, &info).into_iter().map(f32::to_bits);
                    assert!(found.eq(expected), "{info:?}");
                }
            }
        }
    }
}
