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
        if mean == Mean::OfNormals {
            let pairs = upper.as_chunks::<2>().0.iter().zip(lower.as_chunks::<2>().0);
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
        let (upper, lower) = (upper.as_chunks::<2>().0, lower.as_chunks::<2>().0);
        let [(uppers, upper), (lowers, lower)] = [upper, lower].map(<[_]>::as_chunks::<BLOCK>);
        let (outs, out) = out.as_chunks_mut::<BLOCK>();
        for (out, (upper, lower)) in outs.iter_mut().zip(uppers.iter().zip(lowers)) {
            light.halve(upper, lower, out);
        }
        let rest = |row: &[[u8; 2]]| {
            let mut block = [[0; 2]; BLOCK];
            block[..row.len()].copy_from_slice(row);
            block
        };
        let mut block = [0; BLOCK];
        light.halve(&rest(upper), &rest(lower), &mut block);
        out.copy_from_slice(&block[..out.len()]);
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

/// Texels that are halved together.
const BLOCK: usize = 64;

/// Halves rows of codes where four are alike: where they differ little, light is nearly in proportion to
/// codes, and the code nearest to their mean light is that nearest to their mean. Which are not is said
/// by a one; whether there are any is what it returns.
///
/// # Precision
///
/// Exact. With f the light of a code, four codes from c to c + r have a mean light of which the code is
/// above their mean by at most r²/8 · f″/f′, and f″/f′ is 1.4/(c + 14.0) at most. A mean is a whole number
/// of quarters, so that less than a quarter changes nothing but that halves are rounded up. Along the
/// straight part of f, codes below 11, halves are decided by how light is rounded.
#[inline(always)]
fn halve_alike(
    upper: &[[u8; 2]; BLOCK],
    lower: &[[u8; 2]; BLOCK],
    out: &mut [u8; BLOCK],
    others: &mut [u8; BLOCK],
) -> bool {
    let mut any = 0;
    for at in 0..BLOCK {
        let [upper, lower] = [upper[at], lower[at]].map(u16::from_le_bytes);
        let ([a, b], [c, d]) = ([upper & 0xff, upper >> 8], [lower & 0xff, lower >> 8]);
        let low = least(least(a, b), least(c, d));
        let high = greatest(greatest(a, b), greatest(c, d));
        let sum = a + b + c + d;
        // More than so much is too much anyway.
        let spread = least(high - low, 100);
        let is_wide = 3 * spread * spread > 4 * (low + 14);
        let is_half = low < 12 && sum & 3 == 2;
        others[at] = u8::from(is_wide | is_half);
        any |= others[at];
        #[expect(clippy::cast_possible_truncation, reason = "a mean lies between codes")]
        {
            out[at] = ((sum + 2) >> 2) as u8;
        }
    }
    any != 0
}

/// The light of each sRGB code, and the code of four lights.
///
/// # References
///
/// IEC 61966-2-1, the sRGB transfer function.
struct Light {
    /// Light of each code, white's being [`WHITE`].
    linear: [u32; 256],
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
    /// Halves two rows.
    #[inline(always)]
    fn halve(&self, upper: &[[u8; 2]; BLOCK], lower: &[[u8; 2]; BLOCK], out: &mut [u8; BLOCK]) {
        let mut others = [0; BLOCK];
        if !halve_alike(upper, lower, out, &mut others) {
            return;
        }
        for (eight, others) in others.as_chunks::<8>().0.iter().enumerate() {
            if u64::from_le_bytes(*others) == 0 {
                continue;
            }
            for at in (8 * eight..8 * eight + 8).filter(|at| others[at % 8] != 0) {
                out[at] = self.of_four([upper[at], lower[at]]);
            }
        }
    }

    /// The code nearest the mean of the light of four.
    #[inline(always)]
    fn of_four(&self, [[a, b], [c, d]]: [[u8; 2]; 2]) -> u8 {
        let light = |code: u8| self.linear[usize::from(code)];
        self.code(light(a) + light(b) + light(c) + light(d))
    }

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
    Light {
        linear: std::array::from_fn(|code| units(light_of(code as f64))),
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
    fn codes_that_are_alike_have_the_mean_of_their_light() {
        let light = &*LIGHT;
        let (mut alike, mut different) = (0, 0);
        for a in 0..=255_u8 {
            // One more than the widest that are alike.
            let codes = || a..=a.saturating_add(20);
            for (b, c) in codes().flat_map(|b| codes().map(move |c| (b, c))) {
                let (mut upper, mut lower) = ([[a, b]; BLOCK], [[c, a]; BLOCK]);
                for (lower, d) in lower.iter_mut().zip(codes()) {
                    lower[1] = d;
                }
                if a % 2 == 0 {
                    (upper, lower) = (lower, upper);
                }
                let (mut out, mut others) = ([0; BLOCK], [0; BLOCK]);
                halve_alike(&upper, &lower, &mut out, &mut others);
                for at in 0..BLOCK {
                    if others[at] != 0 {
                        different += 1;
                        continue;
                    }
                    alike += 1;
                    let four = [upper[at], lower[at]];
                    assert_eq!(out[at], light.of_four(four), "{four:?}");
                }
            }
        }
        assert!(alike > 1_000_000 && different > 1_000_000, "{alike} {different}");
    }

    proptest! {
        #[test]
        fn rows_are_halved_four_by_four(
            (upper, lower) in (1..150_usize).prop_flat_map(|count| {
                let row = || prop::collection::vec(any::<u8>(), 2 * count);
                (row(), row())
            }),
            shift in 0..8_u8,
        ) {
            let [upper, lower] = [upper, lower].map(|row| -> Vec<u8> {
                row.into_iter().map(|code| code >> shift).collect()
            });
            let mut out = vec![0; upper.len() / 2];
            u8::halve([&upper, &lower], Mean::OfColors, &mut out);
            for (at, &code) in out.iter().enumerate() {
                let four = [upper[2 * at], upper[2 * at + 1], lower[2 * at], lower[2 * at + 1]];
                prop_assert_eq!(code, u8::mean(&four, Mean::OfColors));
            }
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
