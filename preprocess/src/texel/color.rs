//! Colors: sRGB codes, averaged as light.

use std::sync::LazyLock;

use areoid_formats::archive::{ConstantTexel, Description};
use areoid_formats::codec::{self, EncodeError, Quantum, Scratch};

use super::{Planes, Texel};

impl Texel for u8 {
    const CHANNELS: usize = 3;
    const INVALID: Self = 0;
    const NOTHING: (Self, Self) = (Self::MAX, Self::MIN);

    fn channels(planes: Planes, _: Option<&[u8]>) -> Vec<Vec<Self>> {
        match planes {
            Planes::Color(planes) => planes.into(),
            _ => panic!("a dataset of colors has leaves of colors"),
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

    }
}
