//! Colors and normals: codes, those of colors averaged as light.

use std::sync::LazyLock;

use areoid_formats::archive::{ConstantTexel, Description};
use areoid_formats::codec::{self, EncodeError, Quantum, Scratch};
use areoid_formats::lanes::{greatest, least};

use super::{Mean, Planes, PlanesView, Texel, nearest_within};

impl Texel for u8 {
    const CHANNELS: usize = 3;
    const INVALID: Self = 0;
    const NOTHING: (Self, Self) = (Self::MAX, Self::MIN);

    fn channels(planes: Planes, _: Option<&[u8]>) -> Vec<Vec<Self>> {
        match planes {
            Planes::Color(planes) => planes.into(),
            _ => panic!("a dataset of codes has leaves of codes"),
        }
    }

    fn view(channels: &[Vec<Self>]) -> PlanesView<'_> {
        PlanesView::Color([&channels[0], &channels[1], &channels[2]])
    }

    fn to_step(_: &mut [Vec<Self>], _: Quantum) -> Option<Option<Vec<Vec<Self>>>> {
        Some(None)
    }

    fn stored(value: f64, _: Quantum) -> Self {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 255")]
        let code = value.round_ties_even() as Self;
        code
    }

    fn mean(texels: &[Self], mean: Mean) -> Self {
        let count = u32::try_from(texels.len()).expect("one to four");
        if mean == Mean::OfNormals {
            let sum: u32 = texels.iter().map(|&code| u32::from(code)).sum();
            return Self::stored(f64::from(sum) / f64::from(count), Quantum::NONE);
        }
        let light = &*LIGHT;
        let sum: u32 = texels.iter().map(|&code| light.linear[usize::from(code)]).sum();
        light.code(4 * sum / count)
    }

    #[inline(always)]
    fn halve([upper, lower]: [&[Self]; 2], mean: Mean, out: &mut [Self]) {
        let pairs = upper.as_chunks::<2>().0.iter().zip(lower.as_chunks::<2>().0);
        if mean == Mean::OfNormals {
            for (out, (&[a, b], &[c, d])) in out.iter_mut().zip(pairs) {
                let [a, b, c, d] = [a, b, c, d].map(u16::from);
                let sum = a + b + c + d;
                // To the nearest quarter, and from between two to the even one.
                #[expect(clippy::cast_possible_truncation, reason = "a mean lies between codes")]
                {
                    *out = ((sum + 1 + (sum >> 2 & 1)) >> 2) as Self;
                }
            }
            return;
        }
        let light = &*LIGHT;
        // Said outside, lest it be fetched for each texel.
        let of_two: &[u32; 1 << 16] = &light.of_two;
        for (out, (&upper, &lower)) in out.iter_mut().zip(pairs) {
            let [upper, lower] =
                [upper, lower].map(|two| of_two[usize::from(u16::from_le_bytes(two))]);
            *out = light.code(upper + lower);
        }
    }

    #[inline(always)]
    fn linear(texels: &[Self], mean: Mean, out: &mut [f64]) {
        let light = &*LIGHT;
        for (out, &code) in out.iter_mut().zip(texels) {
            *out = match mean {
                Mean::OfNormals => code.into(),
                _ => light.linear[usize::from(code)].into(),
            };
        }
    }

    #[inline(always)]
    fn nearest(sums: &[f64], range: [&[Self]; 2], mean: Mean, out: &mut [Self]) {
        if mean == Mean::OfNormals {
            return nearest_within(sums, range, Quantum::NONE, out);
        }
        let light = &*LIGHT;
        let range = range[0].iter().zip(range[1]);
        for ((out, &sum), (&low, &high)) in out.iter_mut().zip(sums).zip(range) {
            let within = greatest(least(sum, WHITE.into()), 0.0);
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "in range")]
            let code = light.code((4.0 * within) as u32);
            *out = greatest(least(code, high), low);
        }
    }

    fn constant(texels: &[Self]) -> ConstantTexel {
        ConstantTexel([texels[0], texels[1], texels[2], 0])
    }

    fn encode(
        planes: &[Vec<Self>],
        coverage: Option<&[u8]>,
        description: &Description,
        scratch: &mut Scratch,
        payload: &mut Vec<u8>,
    ) -> Result<(), EncodeError> {
        let side = description.grid.pyramid().page_side() as usize;
        let planes = [0, 1, 2].map(|channel| &planes[channel][..]);
        codec::encode_color_planes_into(planes, coverage, side, scratch, payload)
    }
}

/// The light of each sRGB code, and the code of four lights.
///
/// # References
///
/// IEC 61966-2-1, the sRGB transfer function.
struct Light {
    /// Light of each code, white's being [`WHITE`].
    linear: [u32; 256],
    /// Light of two codes, the first in the lower byte: neighbors are alike, so that what is looked up
    /// lies close together.
    of_two: Box<[u32; 1 << 16]>,
    /// For each span of sums of four lights the code at its start, in the lowest byte, and above it
    /// the least sum that has the next code.
    spans: [u32; SPANS],
}

/// A thousandth of the narrowest code's light, or finer.
const WHITE: u32 = (1 << 22) - 1;

/// Spans of sums below 2^24, each narrower than the least distance, half-way between codes, of two
/// steps, 2^24/(255 · 12.92).
const SPANS: usize = 1 << (24 - SPAN_LOG2);

const SPAN_LOG2: u32 = 12;

impl Light {
    /// The code nearest the mean of four lights with this sum, at most four times [`WHITE`].
    #[inline]
    fn code(&self, sum: u32) -> u8 {
        let span = self.spans[(sum >> SPAN_LOG2) as usize];
        // At most one step lies in a span.
        let [code, ..] = span.to_le_bytes();
        code + u8::from(sum >= span >> 8)
    }
}

/// The light of a code, for kernels that sum it.
pub(crate) fn light(code: u8) -> f32 {
    // Below 2^22, so that f32 has it to the bit.
    LIGHT.linear[usize::from(code)] as f32
}

/// The code nearest an amount of light.
pub(crate) fn code(light: f32) -> u8 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "within bounds")]
    let quarters = (4.0 * light).clamp(0.0, 4.0 * WHITE as f32) as u32;
    LIGHT.code(quarters)
}

/// Light of a code from 0 to 255, from 0 to 1.
fn light_of(code: f64) -> f64 {
    let encoded = code / 255.0;
    if encoded <= 0.040_45 { encoded / 12.92 } else { libm::pow((encoded + 0.055) / 1.055, 2.4) }
}

static LIGHT: LazyLock<Light> = LazyLock::new(|| {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "below 2^24")]
    let units = |light: f64| (light * f64::from(WHITE)).round() as u32;
    // The least sum of each code but the first, and one that there is not.
    let mut least: Vec<u32> =
        (0..255).map(|code| units(4.0 * light_of(f64::from(code) + 0.5))).collect();
    least.push((1 << 24) - 1);
    let span = |span: usize| {
        let start = u32::try_from(span << SPAN_LOG2).expect("below 2^24");
        let code = least.partition_point(|&least| least <= start);
        least[code] << 8 | u32::try_from(code).expect("at most 255")
    };
    let linear: [u32; 256] = std::array::from_fn(|code| units(light_of(code as f64)));
    let of_two: Vec<u32> =
        linear.iter().flat_map(|second| linear.map(|first| first + second)).collect();
    Light {
        linear,
        of_two: of_two.try_into().expect("all pairs of codes"),
        spans: std::array::from_fn(span),
    }
});

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn colors_are_averaged_in_linear_light() {
        // Half the light of white is code 188 in sRGB, not 128.
        assert_eq!(u8::mean(&[0, 255], Mean::OfColors), 188);
        assert_eq!(u8::mean(&[7; 3], Mean::OfColors), 7);
    }

    #[test]
    fn normals_are_averaged_as_they_are() {
        assert_eq!(u8::mean(&[1, 254], Mean::OfNormals), 128);
        assert_eq!(u8::mean(&[2, 3], Mean::OfNormals), 2);
        assert_eq!(u8::mean(&[1, 1, 2], Mean::OfNormals), 1);
    }

    #[test]
    fn every_code_comes_back_from_its_own_light() {
        for code in 0..=255 {
            assert_eq!(u8::mean(&[code; 4], Mean::OfColors), code);
            assert_eq!(super::code(light(code)), code);
        }
    }

    #[test]
    fn light_that_was_summed_has_the_code_below_it() {
        let codes = |sums: &[f64], low: u8, high: u8| {
            let mut out = vec![0; sums.len()];
            let range = [&vec![low; sums.len()][..], &vec![high; sums.len()][..]];
            u8::nearest(sums, range, Mean::OfColors, &mut out);
            out
        };
        for code in 0..255_u8 {
            let next = (4.0 * f64::from(WHITE) * light_of(f64::from(code) + 0.5)).round();
            assert_eq!(codes(&[(next - 0.25) / 4.0, next / 4.0], 0, 255), [code, code + 1]);
        }
        assert_eq!(codes(&[-1e9, 1e9], 0, 255), [0, 255]);
        assert_eq!(codes(&[-1e9, 1e9], 7, 9), [7, 9]);
    }

    proptest! {
        #[test]
        fn a_code_is_the_nearest_to_the_mean_light(codes: [u8; 4]) {
            let mean = codes.iter().map(|&code| light_of(code.into())).sum::<f64>() / 4.0;
            let code = f64::from(u8::mean(&codes, Mean::OfColors));
            // Lights are rounded to units, and so are the steps between codes.
            let slack = 1.5 / f64::from(WHITE);
            prop_assert!(code == 0.0 || light_of(code - 0.5) <= mean + slack);
            prop_assert!(code == 255.0 || mean - slack <= light_of(code + 0.5));
        }

        #[test]
        fn a_row_has_the_codes_of_its_texels(upper: [u8; 8], lower: [u8; 8]) {
            for mean in [Mean::OfColors, Mean::OfNormals] {
                let mut halved = [0; 4];
                u8::halve([&upper, &lower], mean, &mut halved);
                for (col, code) in halved.into_iter().enumerate() {
                    let [a, b] = [2 * col, 2 * col + 1];
                    let one = u8::mean(&[upper[a], upper[b], lower[a], lower[b]], mean);
                    prop_assert_eq!(code, one);
                }
            }
        }
    }
}
