//! Heights in meters, on any step or on none.

use areoid_formats::archive::{ConstantTexel, Description};
use areoid_formats::codec::{self, EncodeError, Quantum, Scratch};
use areoid_formats::lanes;

use super::{Mean, Planes, PlanesView, Texel, nearest_within};

impl Texel for f32 {
    const CHANNELS: usize = 1;
    const INVALID: Self = Self::NAN;
    const NOTHING: (Self, Self) = (Self::INFINITY, Self::NEG_INFINITY);

    fn channels(planes: Planes, alpha: Option<&[u8]>) -> Vec<Vec<Self>> {
        vec![match planes {
            Planes::Height(plane) => plane,
            Planes::WholeHeight(plane) => {
                let mut heights: Vec<Self> = plane.into_iter().map(Self::from).collect();
                for (height, &alpha) in heights.iter_mut().zip(alpha.unwrap_or_default()) {
                    *height = if alpha == 0 { Self::NAN } else { *height };
                }
                heights
            }
            Planes::Color(_) => panic!("a dataset of heights has leaves of heights"),
        }]
    }

    fn view(channels: &[Vec<Self>]) -> PlanesView<'_> {
        PlanesView::Height(&channels[0])
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

    fn mean(texels: &[Self], mean: Mean) -> Self {
        let sum: f64 = texels.iter().map(|&texel| f64::from(texel)).sum();
        Self::stored(sum / texels.len() as f64, mean.quantum())
    }

    #[inline(always)]
    fn halve([upper, lower]: [&[Self]; 2], mean: Mean, out: &mut [Self]) {
        let quantum = mean.quantum();
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

    #[inline(always)]
    fn nearest(sums: &[f64], range: [&[Self]; 2], mean: Mean, out: &mut [Self]) {
        nearest_within(sums, range, mean.quantum(), out);
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
