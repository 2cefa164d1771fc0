//! Payloads keep every texel, are a function of the texels, and survive any damage without a panic.
#![expect(
    clippy::cast_possible_truncation,
    clippy::unwrap_used,
    reason = "tests: noise is cut to fit, and a panic is a failure"
)]

use areoid_formats::codec::{
    DecodeError, EncodeError, Quantum, Scratch, decode_color_planes_into, decode_colors,
    decode_heights, decode_heights_into, encode_color_planes_into, encode_colors, encode_heights,
    encode_heights_into, encode_whole_heights_into,
};
use proptest::prelude::*;

/// `SplitMix64`, so that a test draws one seed and not a million numbers.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }
}

const SIDES: [usize; 10] = [4, 5, 7, 8, 10, 16, 33, 34, 64, 130];

/// Coverage in every pattern that a page may have; `None` is everything.
fn coverage(pattern: u8, side: usize, noise: &mut Noise) -> Option<Vec<u8>> {
    let len = side * side;
    let one = (noise.next() % len as u64) as usize;
    let each: Box<dyn FnMut(usize) -> u8> = match pattern {
        0 => return None,
        1 => Box::new(|_| 255),
        2 => Box::new(|i| u8::from(i == one) * 200),
        3 => Box::new(|i| if (i + i / side).is_multiple_of(2) { 255 } else { 0 }),
        4 => Box::new(|_| noise.next().to_le_bytes()[0]),
        5 => Box::new(|_| if noise.next().is_multiple_of(8) { 0 } else { 255 }),
        6 => Box::new(|i| if i % side > i / side { 255 } else { 0 }),
        7 => Box::new(|i| if i == one { 254 } else { 255 }),
        _ => Box::new(|_| 0),
    };
    Some((0..len).map(each).collect())
}

fn punch(texels: &mut [f32], coverage: Option<&[u8]>) {
    for (texel, &covered) in texels.iter_mut().zip(coverage.unwrap_or_default()) {
        if covered == 0 {
            *texel = f32::NAN;
        }
    }
}

fn bits(texels: &[f32]) -> Vec<u32> {
    texels.iter().map(|texel| if texel.is_nan() { u32::MAX } else { texel.to_bits() }).collect()
}

/// What coverage is after a round trip: nothing where it says nothing.
fn normal(coverage: Option<Vec<u8>>) -> Option<Vec<u8>> {
    coverage.filter(|coverage| coverage.iter().any(|&covered| covered != 255))
}

fn check_heights(mut texels: Vec<f32>, coverage: Option<Vec<u8>>, side: usize, quantum: Quantum) {
    punch(&mut texels, coverage.as_deref());
    let payload = encode_heights(&texels, coverage.as_deref(), side, quantum).unwrap();
    assert_eq!(payload, encode_heights(&texels, coverage.as_deref(), side, quantum).unwrap());
    let (decoded, covered) = decode_heights(&payload, side, quantum).unwrap();
    assert_eq!(bits(&decoded), bits(&texels));
    assert_eq!(covered, normal(coverage));
}

proptest! {
    #[test]
    fn heights_on_a_step_come_back(
        seed: u64,
        side in prop::sample::select(&SIDES[..]),
        pattern in 0_u8..9,
        range_bits in 0_u32..33,
        base: i32,
        (step, offset) in prop::sample::select(vec![
            (1.0, 0.0), (0.5, 0.0), (0.1, -8528.0), (1e-3, 0.1), (1e-3, -1e5), (0.25, 1737.4), (1e-9, 0.0),
        ]),
    ) {
        let quantum = Quantum::new(step, offset).unwrap();
        let noise = &mut Noise(seed);
        let coverage = coverage(pattern, side, noise);
        let texels = (0..side * side)
            .map(|_| {
                let above = noise.next().checked_shr(64 - range_bits).unwrap_or(0) as u32;
                quantum.value(base.wrapping_add(above.cast_signed()))
            })
            .collect();
        check_heights(texels, coverage, side, quantum);
    }

    /// Whatever stands under the holes.
    #[test]
    fn whole_heights_have_the_payload_of_floats(
        seed: u64, side in prop::sample::select(&SIDES[..]), pattern in 0_u8..9,
        least: i16, range in 1_u64..65536,
    ) {
        let noise = &mut Noise(seed);
        let coverage = coverage(pattern, side, noise);
        let heights: Vec<i16> = (0..side * side)
            .map(|_| (i64::from(least) + (noise.next() % range) as i64).min(i16::MAX.into()) as i16)
            .collect();
        let mut texels: Vec<f32> = heights.iter().map(|&height| height.into()).collect();
        punch(&mut texels, coverage.as_deref());
        let meters = Quantum::new(1.0, 0.0).unwrap();
        let expected = encode_heights(&texels, coverage.as_deref(), side, meters).unwrap();
        let (scratch, mut payload) = (&mut Scratch::default(), vec![7]);
        encode_whole_heights_into(&heights, coverage.as_deref(), side, scratch, &mut payload)
            .unwrap();
        prop_assert_eq!(payload, expected);
    }

    #[test]
    fn smooth_heights_come_back(
        seed: u64, side in prop::sample::select(&SIDES[..]), pattern in 0_u8..9,
        slope in -50_i32..50, curve in -3_i32..3, rough in 1_u64..9,
    ) {
        let quantum = Quantum::new(1.0, 0.0).unwrap();
        let noise = &mut Noise(seed);
        let coverage = coverage(pattern, side, noise);
        let texels = (0..side * side)
            .map(|i| {
                let (x, y) = ((i % side) as i32, (i / side) as i32);
                quantum.value(slope * x + curve * x * y + (noise.next() % rough) as i32)
            })
            .collect();
        check_heights(texels, coverage, side, quantum);
    }

    #[test]
    fn floats_of_every_exponent_come_back_bit_for_bit(
        seed: u64, side in prop::sample::select(&SIDES[..]), pattern in 0_u8..9,
    ) {
        let noise = &mut Noise(seed);
        let coverage = coverage(pattern, side, noise);
        let texels = (0..side * side)
            .map(|_| {
                let bits = noise.next() as u32;
                let finite = f32::from_bits(bits).is_finite();
                if finite { f32::from_bits(bits) } else { f32::from_bits(bits & 0x8000_0000) }
            })
            .collect();
        check_heights(texels, coverage, side, Quantum::NONE);
    }

    #[test]
    fn colors_come_back(
        seed: u64, side in prop::sample::select(&SIDES[..]), pattern in 0_u8..9, kind in 0_u8..3,
    ) {
        let noise = &mut Noise(seed);
        let coverage = coverage(pattern, side, noise);
        let mut texels: Vec<[u8; 3]> = (0..side * side)
            .map(|i| {
                let [r, g, b, ..] = noise.next().to_le_bytes();
                let smooth = (i % side * 3 + i / side) as u8;
                match kind {
                    0 => [r, g, b],
                    1 => [r, r.wrapping_add(7), r.wrapping_sub(9)],
                    _ => [smooth, smooth.wrapping_add(g % 3), 200],
                }
            })
            .collect();
        let payload = encode_colors(&texels, coverage.as_deref(), side).unwrap();
        prop_assert_eq!(&payload, &encode_colors(&texels, coverage.as_deref(), side).unwrap());
        for (texel, &covered) in texels.iter_mut().zip(coverage.as_deref().unwrap_or_default()) {
            if covered == 0 {
                *texel = [0; 3];
            }
        }
        let (decoded, covered) = decode_colors(&payload, side).unwrap();
        prop_assert_eq!(&decoded, &texels);
        prop_assert_eq!(&covered, &normal(coverage.clone()));

        // As planes: the same bytes, and the same texels back.
        let (mut scratch, mut of_planes) = (Scratch::default(), vec![7]);
        let planes: [Vec<u8>; 3] =
            [0, 1, 2].map(|channel| texels.iter().map(|texel| texel[channel]).collect());
        let slices = planes.each_ref().map(|plane| &plane[..]);
        let coverage = coverage.as_deref();
        encode_color_planes_into(slices, coverage, side, &mut scratch, &mut of_planes).unwrap();
        prop_assert_eq!(&of_planes, &payload);
        let (mut back, mut back_covered) = ([vec![1], vec![], vec![9; 5]], vec![3]);
        decode_color_planes_into(&payload, side, &mut scratch, &mut back, &mut back_covered)
            .unwrap();
        prop_assert_eq!(back, planes);
        prop_assert_eq!(back_covered, covered.unwrap_or_default());
    }

    #[test]
    fn any_bytes_behind_a_form_decode_to_an_error_or_a_page(
        form in 0_u8..64, mut bytes in prop::collection::vec(any::<u8>(), 0..200),
    ) {
        bytes.insert(0, form);
        for quantum in [Quantum::NONE, Quantum::new(0.1, 5.0).unwrap()] {
            if let Ok(page) = decode_heights(&bytes, 4, quantum) {
                check_consistent(&page);
            }
        }
        let _ = decode_colors(&bytes, 4);
    }
}

#[test]
fn constants_of_every_kind_come_back_in_a_few_bytes() {
    let meters = Quantum::new(1.0, 0.0).unwrap();
    for value in [0.0, 1.0, -8528.0, 2_147_483_648.0, -2_147_483_648.0] {
        check_heights(vec![value; 512 * 512], None, 512, meters);
        assert!(encode_heights(&[value; 100], None, 10, meters).unwrap().len() <= 14);
    }
    for value in [0.0, -0.0, f32::MIN_POSITIVE, 1e-45, f32::MAX, f32::MIN] {
        check_heights(vec![value; 100], None, 10, Quantum::NONE);
    }
}

/// Alternating extremes: residuals wrap at both lane widths.
#[test]
fn extremes_side_by_side_come_back() {
    let meters = Quantum::new(1.0, 0.0).unwrap();
    for (low, high) in [(-32768, 32767), (0, 65535), (0, 65536), (i32::MIN, i32::MAX)] {
        for period in [1, 2, 7] {
            let texels =
                (0..100).map(|i| meters.value(if (i / period) % 2 == 0 { low } else { high }));
            check_heights(texels.collect(), None, 10, meters);
        }
    }
    let texels = (0..100).map(|i| [0.0, -0.0, f32::MAX, f32::MIN, 1e-45][i % 5]).collect();
    check_heights(texels, None, 10, Quantum::NONE);
}

#[test]
fn the_largest_and_smallest_page_come_back_and_no_other_is_taken() {
    let meters = Quantum::new(1.0, 0.0).unwrap();
    for side in [4, 4098] {
        let texels = (0..side * side).map(|i| meters.value((i * i % 977) as i32)).collect();
        check_heights(texels, None, side, meters);
    }
    for side in [0, 3, 4099, usize::MAX] {
        assert_eq!(encode_heights(&[], None, side, meters), Err(EncodeError::Side { found: side }));
        assert_eq!(decode_heights(&[], side, meters), Err(DecodeError::Side { found: side }));
    }
}

#[test]
fn texels_outside_the_domain_are_named() {
    let halves = Quantum::new(0.5, 0.0).unwrap();
    let page = |at: usize, value| {
        let mut texels = vec![1.5; 16];
        texels[at] = value;
        texels
    };
    fn error(texels: Vec<f32>, coverage: Option<&[u8]>, quantum: Quantum) -> EncodeError {
        encode_heights(&texels, coverage, 4, quantum).unwrap_err()
    }
    assert_eq!(error(page(3, 0.25), None, halves), EncodeError::OffStep { index: 3, texel: 0.25 });
    assert_eq!(error(page(5, 1e10), None, halves), EncodeError::OffStep { index: 5, texel: 1e10 });
    assert!(matches!(
        error(page(7, f32::NAN), None, halves),
        EncodeError::NotFinite { index: 7, .. }
    ));
    for quantum in [halves, Quantum::NONE] {
        for value in [f32::INFINITY, f32::NEG_INFINITY] {
            let found = error(page(9, value), None, quantum);
            assert_eq!(found, EncodeError::NotFinite { index: 9, texel: value });
        }
        let mut hole = vec![255; 16];
        hole[2] = 0;
        let found = error(page(1, 2.0), Some(&hole), quantum);
        assert_eq!(found, EncodeError::Uncovered { index: 2, texel: 1.5 });
    }
    let unmade = Quantum { step: f64::NAN, offset: 0.0 };
    assert!(matches!(error(page(0, 1.0), None, unmade), EncodeError::Quantum(_)));
    let found = error(vec![0.0; 15], None, halves);
    assert_eq!(found, EncodeError::Length { what: "texels", expected: 16, found: 15 });
    let found = error(vec![0.0; 16], Some(&[255; 17]), halves);
    assert_eq!(found, EncodeError::Length { what: "coverage", expected: 16, found: 17 });
}

fn check_consistent((texels, coverage): &(Vec<f32>, Option<Vec<u8>>)) {
    for (i, texel) in texels.iter().enumerate() {
        let covered = coverage.as_ref().is_none_or(|coverage| coverage[i] != 0);
        assert!(if covered { texel.is_finite() } else { texel.is_nan() }, "texel {i}: {texel}");
    }
}

/// Pages that use every method, predictor and lane width.
fn samples() -> Vec<(Vec<u8>, usize, Quantum)> {
    let mut samples = Vec::new();
    for seed in 0..4 {
        for (side, pattern) in [(10, 0), (10, 5), (18, 6), (18, 4)] {
            let noise = &mut Noise(seed);
            let coverage = coverage(pattern, side, noise);
            for quantum in [Quantum::new(0.5, 3.0).unwrap(), Quantum::NONE] {
                let mut texels: Vec<f32> = (0..side * side)
                    .map(|i| {
                        let rough = noise.next() % (1 << (4 * seed));
                        quantum.round((i % side * 3 + i / side * 7) as f64 + rough as f64).unwrap()
                    })
                    .collect();
                punch(&mut texels, coverage.as_deref());
                let payload = encode_heights(&texels, coverage.as_deref(), side, quantum).unwrap();
                samples.push((payload, side, quantum));
            }
        }
    }
    samples
}

#[test]
fn every_flipped_bit_ends_in_an_error_or_a_consistent_page() {
    let (mut errors, mut pages) = (0, 0);
    for (payload, side, quantum) in samples() {
        for bit in 0..payload.len() * 8 {
            let mut damaged = payload.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            match decode_heights(&damaged, side, quantum) {
                Ok(page) => {
                    check_consistent(&page);
                    pages += 1;
                }
                Err(_) => errors += 1,
            }
        }
    }
    assert!(errors > 100 && pages > 100, "{errors} errors and {pages} pages: the samples are poor");
}

#[test]
fn every_truncation_and_extension_is_an_error() {
    for (payload, side, quantum) in samples() {
        for len in 0..payload.len() {
            assert!(decode_heights(&payload[..len], side, quantum).is_err(), "{len} bytes");
        }
        let mut longer = payload.clone();
        longer.push(0);
        let (end, len) = (payload.len(), longer.len());
        let found = decode_heights(&longer, side, quantum);
        assert_eq!(found, Err(DecodeError::Trailing { end, len }));
    }
}

#[test]
fn damaged_colors_end_in_an_error_or_in_black_holes() {
    let side = 18;
    let coverage = coverage(5, side, &mut Noise(1));
    let texels: Vec<_> =
        (0..side * side).map(|i| [i as u8, (i * 3) as u8, (i / 5) as u8]).collect();
    let payload = encode_colors(&texels, coverage.as_deref(), side).unwrap();
    for len in 0..payload.len() {
        assert!(decode_colors(&payload[..len], side).is_err());
    }
    for bit in 0..payload.len() * 8 {
        let mut damaged = payload.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        if let Ok((texels, Some(coverage))) = decode_colors(&damaged, side) {
            assert!(texels.iter().zip(coverage).all(|(texel, c)| c != 0 || *texel == [0; 3]));
        }
    }
}

#[test]
fn what_a_scratch_held_before_changes_nothing() {
    let (mut scratch, mut payload) = (Scratch::default(), Vec::new());
    let (mut texels, mut covered) = (Vec::new(), Vec::new());
    for (fresh, side, quantum) in samples().into_iter().rev() {
        decode_heights_into(&fresh, side, quantum, &mut scratch, &mut texels, &mut covered)
            .unwrap();
        let coverage = (!covered.is_empty()).then_some(&covered[..]);
        encode_heights_into(&texels, coverage, side, quantum, &mut scratch, &mut payload).unwrap();
        assert_eq!(payload, fresh);
    }
}

#[test]
fn planes_of_the_wrong_length_are_named() {
    let (scratch, payload) = (&mut Scratch::default(), &mut Vec::new());
    for (wrong, what) in ["red", "green", "blue", "coverage"].into_iter().enumerate() {
        let buffers: [Vec<u8>; 4] = std::array::from_fn(|i| vec![1; 16 + usize::from(i == wrong)]);
        let [red, green, blue, coverage] = buffers.each_ref().map(|buffer| &buffer[..]);
        let planes = [red, green, blue];
        let found = encode_color_planes_into(planes, Some(coverage), 4, scratch, payload);
        assert_eq!(found, Err(EncodeError::Length { what, expected: 16, found: 17 }));
    }
}

/// The bytes of the format, by hand: a change here is a change of every archive.
#[test]
fn a_small_page_has_the_bytes_of_the_format() {
    let meters = Quantum::new(1.0, 0.0).unwrap();
    let texels: Vec<f32> = (0..16).map(|i| (100 + 3 * (i % 4) + 5 * (i / 4)) as f32).collect();
    #[rustfmt::skip]
    let expected = [
        0x10,                       // heights, full coverage, 16-bit lanes
        100, 0, 0, 0,               // base
        2,                          // plane predictor; residuals 0 6 6 6 | 10 0 0 0 | 10 .. | 10 ..
        0b1001_0100, 0, 0, 0,       // planes 1 and 2 raw, 3 sparse
        2, 0, 0, 0,                 // its length
        0b1110, 1, 1, 1,            // plane 1: 10 in rows 1 to 3 of column 0, 6 in row 0 of the others
        0, 1, 1, 1,                 // plane 2
        0b0001, 0b1110,             // plane 3: only byte 0 is not 0
    ];
    assert_eq!(encode_heights(&texels, None, 4, meters).unwrap(), expected);
}
