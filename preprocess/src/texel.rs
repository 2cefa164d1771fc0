//! What pages are made of: `f32` heights, NaN where invalid, or `u8` color codes, 0 there.
//!
//! Everything from reading to writing is generic over the two, so that each runs at its own width.

use std::sync::LazyLock;

use areoid_formats::archive::{ConstantTexel, Description};
use areoid_formats::bound;
use areoid_formats::codec::{self, EncodeError, Quantum, Scratch};
use areoid_formats::lanes;

/// A leaf's texels, one plane a channel.
#[derive(Clone, Debug, PartialEq)]
pub enum Planes {
    /// Meters, NaN where invalid.
    Height(Vec<f32>),
    /// Red, green and blue codes, 0 where invalid.
    Color([Vec<u8>; 3]),
}

/// A texel of one channel.
pub trait Texel: bound::Texel<Cell: bytemuck::Pod> + bytemuck::Pod + std::fmt::Debug {
    /// Channels of a page.
    const CHANNELS: usize;
    /// What stands where there is no data; coverage says so.
    const INVALID: Self;
    /// The least and greatest finest texel where there is none.
    const NOTHING: (Self, Self);

    /// The planes of a leaf of this kind.
    ///
    /// # Panics
    ///
    /// If they are of the other kind.
    fn channels(planes: Planes) -> Vec<Vec<Self>>;

    /// Puts the channels of a leaf on the step, and returns what they were if that changed any;
    /// `None` if a texel cannot be stored.
    fn to_step(planes: &mut [Vec<Self>], quantum: Quantum) -> Option<Option<Vec<Vec<Self>>>>;

    /// `value` as it is stored: on the step for heights, a whole code for colors. The value is a
    /// mean of stored ones.
    fn stored(value: f64, quantum: Quantum) -> Self;

    /// The mean of one to four valid texels, as it is stored; summed in f64 from the first on, of
    /// colors the light.
    fn mean(texels: &[Self], quantum: Quantum) -> Self;

    /// [`Self::mean`] of two by two texels, for each pair of columns of two rows.
    fn halve(rows: [&[Self]; 2], quantum: Quantum, out: &mut [Self]);

    /// The texel of a page that has no other, as its entry stores it.
    fn constant(texels: &[Self]) -> ConstantTexel;

    /// The payload of a page, in `payload`.
    ///
    /// # Errors
    ///
    /// [`EncodeError`] if a texel cannot be stored, which rounding to the step rules out.
    fn encode(
        planes: &[Vec<Self>],
        coverage: Option<&[u8]>,
        description: &Description,
        scratch: &mut Scratch,
        payload: &mut Vec<u8>,
    ) -> Result<(), EncodeError>;
}

impl Texel for f32 {
    const CHANNELS: usize = 1;
    const INVALID: Self = Self::NAN;
    const NOTHING: (Self, Self) = (Self::INFINITY, Self::NEG_INFINITY);

    fn channels(planes: Planes) -> Vec<Vec<Self>> {
        match planes {
            Planes::Height(plane) => vec![plane],
            Planes::Color(_) => panic!("a dataset of heights has leaves of heights"),
        }
    }

    fn to_step(planes: &mut [Vec<Self>], quantum: Quantum) -> Option<Option<Vec<Vec<Self>>>> {
        if quantum.is_none() || is_on_step(&planes[0], quantum) {
            return Some(None);
        }
        let original = planes.to_vec();
        let mut changed = false;
        for texel in planes.iter_mut().flatten().filter(|texel| !texel.is_nan()) {
            let stored = quantum.round((*texel).into())?;
            changed |= stored.to_bits() != texel.to_bits();
            *texel = stored;
        }
        Some(changed.then_some(original))
    }

    fn stored(value: f64, quantum: Quantum) -> Self {
        // A mean lies between texels that are on the step.
        quantum.round(value).expect("a mean of stored texels can be stored")
    }

    fn mean(texels: &[Self], quantum: Quantum) -> Self {
        let sum: f64 = texels.iter().map(|&texel| f64::from(texel)).sum();
        Self::stored(sum / texels.len() as f64, quantum)
    }

    #[inline(always)]
    fn halve([upper, lower]: [&[Self]; 2], quantum: Quantum, out: &mut [Self]) {
        let pairs = upper.as_chunks::<2>().0.iter().zip(lower.as_chunks::<2>().0);
        let sums = pairs
            .map(|(&[a, b], &[c, d])| [a, b, c, d].map(f64::from))
            .map(|[a, b, c, d]| a + b + c + d);
        if quantum.is_none() {
            for (out, sum) in out.iter_mut().zip(sums) {
                #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the point")]
                {
                    *out = (sum * 0.25) as Self;
                }
            }
        } else if quantum == (Quantum { step: 1.0, offset: 0.0 }) {
            // Rounds to a whole number, ties to even, as `Quantum::round` does: texels on this step
            // are at most 2^31. Adding and subtracting leaves no -0.0.
            const ROUNDER: f64 = 6_755_399_441_055_744.0;
            for (out, sum) in out.iter_mut().zip(sums) {
                #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the point")]
                {
                    *out = (sum * 0.25 + ROUNDER - ROUNDER) as Self;
                }
            }
        } else {
            for (out, sum) in out.iter_mut().zip(sums) {
                *out = Self::stored(sum * 0.25, quantum);
            }
        }
    }

    fn constant(texels: &[Self]) -> ConstantTexel {
        ConstantTexel(texels[0].to_le_bytes())
    }

    fn encode(
        planes: &[Vec<Self>],
        coverage: Option<&[u8]>,
        description: &Description,
        scratch: &mut Scratch,
        payload: &mut Vec<u8>,
    ) -> Result<(), EncodeError> {
        let side = description.grid.pyramid().page_side() as usize;
        let quantum = description.quantum;
        codec::encode_heights_into(&planes[0], coverage, side, quantum, scratch, payload)
    }
}

impl Texel for u8 {
    const CHANNELS: usize = 3;
    const INVALID: Self = 0;
    const NOTHING: (Self, Self) = (Self::MAX, Self::MIN);

    fn channels(planes: Planes) -> Vec<Vec<Self>> {
        match planes {
            Planes::Color(planes) => planes.into(),
            Planes::Height(_) => panic!("a dataset of colors has leaves of colors"),
        }
    }

    fn to_step(_: &mut [Vec<Self>], _: Quantum) -> Option<Option<Vec<Vec<Self>>>> {
        Some(None)
    }

    fn stored(value: f64, _: Quantum) -> Self {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 255")]
        let code = value.round_ties_even() as Self;
        code
    }

    fn mean(texels: &[Self], _: Quantum) -> Self {
        let light = &*LIGHT;
        let sum: f64 = texels.iter().map(|&code| light.linear[usize::from(code)]).sum();
        light.code(sum / texels.len() as f64)
    }

    fn halve([upper, lower]: [&[Self]; 2], _: Quantum, out: &mut [Self]) {
        let light = &*LIGHT;
        let pairs = upper.as_chunks::<2>().0.iter().zip(lower.as_chunks::<2>().0);
        for (out, (&[a, b], &[c, d])) in out.iter_mut().zip(pairs) {
            let [a, b, c, d] = [a, b, c, d].map(|code| light.linear[usize::from(code)]);
            *out = light.code((a + b + c + d) * 0.25);
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

/// Whether all texels are NaN or, to the bit, on a step of 1, the step of most rasters.
fn is_on_step(texels: &[f32], quantum: Quantum) -> bool {
    // Rounds to a whole number below 2^22.
    const ROUNDER: f32 = 12_582_912.0;
    const LARGEST: f32 = 4_194_304.0;
    quantum == (Quantum { step: 1.0, offset: 0.0 })
        && lanes::none(texels, |texel| {
            let rounded = texel + ROUNDER - ROUNDER;
            let broken = (rounded.to_bits() != texel.to_bits()) | (texel.abs() >= LARGEST);
            broken & !texel.is_nan()
        })
}

/// The light of each sRGB code, and the light half-way (in code) between neighboring codes.
///
/// # References
///
/// IEC 61966-2-1, the sRGB transfer function.
struct Light {
    linear: [f64; 256],
    /// The last one is never reached.
    steps: [f64; 256],
    /// For the start of each span of light, how many steps lie below it.
    below: [u8; SPANS],
}

/// Spans of light, each narrower than the least distance of two steps, 1/(255 · 12.92).
const SPANS: usize = 4096;

impl Light {
    /// The code whose span holds `light`: how many steps lie below it.
    #[inline]
    fn code(&self, light: f64) -> u8 {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 1")]
        let span = ((light * SPANS as f64) as usize).min(SPANS - 1);
        let code = self.below[span];
        // At most one step lies in a span.
        code + u8::from(self.steps[usize::from(code)] < light)
    }
}

static LIGHT: LazyLock<Light> = LazyLock::new(|| {
    let linear = |code: f64| {
        let encoded = code / 255.0;
        if encoded <= 0.040_45 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
    };
    let mut steps: [f64; 256] = std::array::from_fn(|code| linear(code as f64 + 0.5));
    steps[255] = f64::INFINITY;
    let below = std::array::from_fn(|span| {
        let start = span as f64 / SPANS as f64;
        u8::try_from(steps.partition_point(|&step| step < start)).expect("at most 255")
    });
    Light { linear: std::array::from_fn(|code| linear(code as f64)), steps, below }
});

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn colors_are_averaged_in_linear_light() {
        // Half the light of white is code 188 in sRGB, not 128.
        assert_eq!(u8::mean(&[0, 255], Quantum::NONE), 188);
        assert_eq!(u8::mean(&[7; 4], Quantum::NONE), 7);
    }

    #[test]
    fn every_code_comes_back_from_its_own_light() {
        for code in 0..=255 {
            assert_eq!(LIGHT.code(LIGHT.linear[usize::from(code)]), code);
        }
    }

    proptest! {
        #[test]
        fn a_code_is_the_number_of_steps_below(light in 0.0..=1.0_f64, code in 0..255_usize) {
            let step = LIGHT.steps[code];
            for light in [light, step, step.next_up(), step.next_down()] {
                let below = LIGHT.steps.iter().filter(|&&step| step < light).count();
                prop_assert_eq!(usize::from(LIGHT.code(light)), below);
            }
        }

        #[test]
        fn halved_rows_are_means(
            upper: [i16; 6], lower: [i16; 6],
            step in prop::sample::select(vec![0.0, 1.0, 0.25, 0.1]),
        ) {
            let quantum = Quantum::new(step, 0.0).unwrap();
            let on_step = |row: [i16; 6]| row.map(|texel| f32::stored(f64::from(texel) / 8.0, quantum));
            let (upper, lower) = (on_step(upper), on_step(lower));
            let mut halved = [0.0; 3];
            f32::halve([&upper, &lower], quantum, &mut halved);
            for (col, texel) in halved.into_iter().enumerate() {
                let [a, b] = [2 * col, 2 * col + 1];
                let mean = f32::mean(&[upper[a], upper[b], lower[a], lower[b]], quantum);
                prop_assert_eq!(texel.to_bits(), mean.to_bits());
            }
        }
    }
}
