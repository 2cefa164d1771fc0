//! A parent's interior from its children's: two by two texels become one.
//!
//! Texels are cells, not grid points: a parent texel covers exactly two by two child texels, and
//! takes the mean of the stored ones that are valid (summed in f64, colors in linear light), on
//! the step of the level, ties to even. It is valid if any child is; its coverage is the mean of
//! theirs. Children past the outline do not exist and do not count.

use std::sync::{Arc, LazyLock};

use areoid_formats::bound::Span;
use areoid_formats::codec::Quantum;
use areoid_formats::page::Kind;

use crate::tile::{Tile, nothing, on_step};

/// A child and its place: (0 upper or 1 lower, 0 left or 1 right).
pub type PlacedTile = ((usize, usize), Arc<Tile>);

/// The interior of a parent of `rows * cols` texels, in pages of `interior` texels a side.
///
/// `children` are those with a valid texel; `None` if there are none.
#[must_use]
pub fn parent(
    (rows, cols): (usize, usize),
    interior: usize,
    children: &[PlacedTile],
    kind: Kind,
    quantum: Quantum,
) -> Option<Tile> {
    if children.is_empty() {
        return None;
    }
    let (count, channels) = (rows * cols, kind.channels());
    let mut planes = Tile::blank(count, channels);
    let mut spans = vec![nothing(count); channels];
    let mut coverage = vec![0_u8; count];
    let half = interior / 2;
    for ((down, right), child) in children {
        for child_row in (0..child.rows).step_by(2) {
            let row = down * half + child_row / 2;
            for child_col in (0..child.cols).step_by(2) {
                let to = row * cols + right * half + child_col / 2;
                let taps = Taps::of(child, child_row, child_col);
                for channel in 0..channels {
                    let valid = taps.valid(&child.planes[channel]);
                    planes[channel][to] = match kind {
                        Kind::Height => mean(valid).map_or(f32::NAN, |m| on_step(m, quantum, 1)),
                        Kind::Color | Kind::Normal => mean_of_codes(valid),
                    };
                    taps.span(&mut spans[channel], to, child, channel);
                }
                coverage[to] = taps.coverage(child);
            }
        }
    }
    let full = coverage.iter().all(|&code| code == u8::MAX);
    let coverage = (!full).then_some(coverage);
    Some(Tile { rows, cols, planes, original: None, coverage, spans: Some(spans) })
}

/// The one to four child texels under a parent texel.
struct Taps {
    places: [usize; 4],
    count: usize,
}

impl Taps {
    fn of(child: &Tile, row: usize, col: usize) -> Self {
        let at = row * child.cols + col;
        let (below, beside) = (row + 1 < child.rows, col + 1 < child.cols);
        let (places, count) = match (below, beside) {
            (true, true) => ([at, at + 1, at + child.cols, at + child.cols + 1], 4),
            (true, false) => ([at, at + child.cols, at, at], 2),
            (false, true) => ([at, at + 1, at, at], 2),
            (false, false) => ([at; 4], 1),
        };
        Self { places, count }
    }

    fn each(&self) -> impl Iterator<Item = usize> + '_ {
        self.places[..self.count].iter().copied()
    }

    fn valid<'a>(&'a self, plane: &'a [f32]) -> impl Iterator<Item = f32> + 'a {
        self.each().map(|at| plane[at]).filter(|texel| !texel.is_nan())
    }

    fn coverage(&self, child: &Tile) -> u8 {
        let Some(codes) = &child.coverage else { return u8::MAX };
        let sum: u32 = self.each().map(|at| u32::from(codes[at])).sum();
        if sum == 0 {
            return 0;
        }
        // Rounded to nearest, but full only where all are, and never down to invalid.
        let count = u32::try_from(self.count).expect("at most four");
        let nearest = (2 * sum + count) / (2 * count);
        let full = sum == 255 * count;
        u8::try_from(nearest.clamp(1, if full { 255 } else { 254 })).expect("clamped to codes")
    }

    fn span(&self, span: &mut Span, to: usize, child: &Tile, channel: usize) {
        for at in self.each() {
            let (least, greatest) = match &child.spans {
                Some(spans) => (spans[channel].least[at], spans[channel].greatest[at]),
                // A leaf's own span; `min` and `max` pass NaN over.
                None => {
                    let texel = finest(child, channel, at);
                    (texel, texel)
                }
            };
            span.least[to] = span.least[to].min(least);
            span.greatest[to] = span.greatest[to].max(greatest);
        }
    }
}

/// A leaf texel before quantization.
fn finest(leaf: &Tile, channel: usize, at: usize) -> f32 {
    leaf.original.as_ref().map_or(leaf.planes[channel][at], |original| original[channel][at])
}

fn mean(valid: impl Iterator<Item = f32>) -> Option<f64> {
    let (sum, count) =
        valid.fold((0.0, 0.0), |(sum, count), texel| (sum + f64::from(texel), count + 1.0));
    (count > 0.0).then_some(sum / count)
}

/// The code of the mean light of `codes`, NaN without any.
fn mean_of_codes(codes: impl Iterator<Item = f32>) -> f32 {
    let mut common = None;
    let mut same = true;
    let light = codes.map(|code| {
        same &= *common.get_or_insert(code) == code;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a code")]
        LIGHT.linear[code as usize]
    });
    let (sum, count) = light.fold((0.0, 0.0), |(sum, count), light| (sum + light, count + 1.0));
    match common {
        None => f32::NAN,
        Some(code) if same => code,
        Some(_) => {
            let mean: f64 = sum / count;
            #[expect(clippy::cast_precision_loss, reason = "at most 255")]
            let code = LIGHT.steps.partition_point(|&step| step < mean) as f32;
            code
        }
    }
}

/// The light of each sRGB code, and the light half-way (in code) between neighboring codes.
///
/// # References
///
/// IEC 61966-2-1, the sRGB transfer function.
struct Light {
    linear: [f64; 256],
    steps: [f64; 255],
}

static LIGHT: LazyLock<Light> = LazyLock::new(|| {
    let linear = |code: f64| {
        let encoded = code / 255.0;
        if encoded <= 0.040_45 { encoded / 12.92 } else { ((encoded + 0.055) / 1.055).powf(2.4) }
    };
    Light {
        linear: std::array::from_fn(|code| linear(code as f64)),
        steps: std::array::from_fn(|code| linear(code as f64 + 0.5)),
    }
});

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colors_are_averaged_in_linear_light() {
        // Half the light of white is code 188 in sRGB, not 128.
        assert_eq!(mean_of_codes([0.0, 255.0].into_iter()), 188.0);
        assert_eq!(mean_of_codes([7.0; 4].into_iter()), 7.0);
        assert!(mean_of_codes(std::iter::empty()).is_nan());
    }

    #[test]
    fn every_code_comes_back_from_its_own_light() {
        for code in 0..256 {
            let light = LIGHT.linear[code];
            assert_eq!(LIGHT.steps.partition_point(|&step| step < light), code);
        }
    }
}
