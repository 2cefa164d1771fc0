//! What is valid, what a sample becomes, and where it is laid.

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
    let out = all_heights(&block(samples), info);
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
    all_colors(&block(samples), info).unwrap()
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
    let result = all_colors(&samples, &info(SampleType::F32, 1, false));
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
    for (cols, rows) in [(10..17, 20..25), (11..14, 22..24), (16..17, 24..25), (12..12, 20..21)] {
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

        let (mut whole, mut alpha) = ([-1; 50], [9; 50]);
        let planes = (&mut whole[3..], Some(&mut alpha[3..]));
        let filled = whole_heights_into(&block, &info, &window, planes.0, planes.1, 9);
        assert_eq!(filled.unwrap(), Filled::All);
        assert_eq!(whole.map(f32::from), expected, "{window:?}");
        assert_eq!(alpha.map(|alpha| alpha == u8::MAX), expected.map(|height| height >= 0.0));
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
    let (mut whole, mut alpha) = ([40, 41, 42, 43], [9; 4]);
    let filled =
        whole_heights_into(&samples, &height, &window, &mut whole, Some(&mut alpha), 2).unwrap();
    assert_eq!((filled, whole, alpha), (Filled::Part, [40, 1, 2, 43], [9, 255, 255, 9]));
    let (mut red, mut green, mut blue, mut alpha) = ([4; 4], [5; 4], [6; 4], [9; 4]);
    let planes = [&mut red[..], &mut green, &mut blue];
    let filled = colors_into(&samples, &height, &window, planes, Some(&mut alpha), 2).unwrap();
    assert_eq!((filled, alpha), (Filled::Part, [9, 255, 255, 9]));
    assert_eq!((red, green, blue), ([4, 1, 2, 4], [5, 1, 2, 5], [6, 1, 2, 6]));

    let nothing = Window { cols: 1..2, rows: 1..2 };
    assert_eq!(heights_into(&samples, &height, &nothing, &mut out, 2), Filled::Nothing);
    height.nodata = None;
    assert_eq!(heights_into(&samples, &height, &nothing, &mut out, 2), Filled::All);
}

#[test]
fn whole_heights_are_hidden_by_alpha_and_refused_if_they_are_not_whole() {
    let mut info = info(SampleType::I8, 1, true);
    let samples = block(Samples::I8(vec![-1, 0, -2, 3, 3, 0, 4, 4]));
    let (window, mut heights, mut alpha) = (Window::of(&samples), [40; 4], [9; 4]);
    let mut laid = |info: &RasterInfo| {
        whole_heights_into(&samples, info, &window, &mut heights, Some(&mut alpha), 2)
    };
    assert_eq!(laid(&info).unwrap(), Filled::Part);
    info.scale = 2.0;
    assert!(laid(&info).unwrap_err().to_string().contains("I8"));
    assert_eq!((heights, alpha), ([40, -2, 40, 4], [9, 255, 9, 255]));
}

#[test]
fn translucent_colors_are_not_all() {
    let info = info(SampleType::U8, 1, true);
    let samples = block(Samples::U8(vec![1, 255, 2, 254, 3, 255, 4, 255]));
    let (mut planes, mut alpha) = ([[0; 4]; 3], [0; 4]);
    let mut laid = |window: Window| {
        let planes = planes.each_mut().map(|plane| &mut plane[..]);
        colors_into(&samples, &info, &window, planes, Some(&mut alpha), 2).unwrap()
    };
    assert_eq!(laid(Window::of(&samples)), Filled::Part);
    assert_eq!(laid(Window { cols: 0..2, rows: 1..2 }), Filled::All);
}

/// The rule, texel by texel.
#[expect(clippy::cast_possible_truncation, reason = "the one rounding that is documented")]
fn expected_height<T: Sample>(sample: T, info: &RasterInfo) -> f32 {
    let nodata = info.nodata.and_then(T::exactly);
    let height = (sample.number() * info.scale + info.offset) as f32;
    if Some(sample) == nodata || !height.is_finite() { f32::NAN } else { height }
}

#[test]
#[expect(clippy::cast_possible_truncation, reason = "any samples will do")]
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
                let found = all_heights(&block, &info).into_iter().map(f32::to_bits);
                assert!(found.eq(expected), "{info:?}");
            }
        }
    }
}
