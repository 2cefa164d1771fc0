//! Pages in memory: texels and their coverage.
//!
//! A texel is *valid* where its coverage is not zero. Coverage is the weight a texel carries in a
//! composition: 255 well inside the data, falling toward holes and outlines (see
//! [`archive`](crate::archive) for how it is made). Validity decides whether a texel counts at all; coverage decides
//! how much of it shows over other datasets.

use serde::{Deserialize, Serialize};

/// What the texels of a dataset are.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Meters above the reference surface.
    Height,
    /// sRGB codes.
    Color,
    /// Surface normals, as the codes of [`normal`](crate::normal).
    Normal,
}

impl Kind {
    /// Numbers that make up a texel.
    #[must_use]
    pub const fn channels(self) -> usize {
        match self {
            Self::Height => 1,
            Self::Color | Self::Normal => 3,
        }
    }

    /// The name on the command line and in JSON.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Height => "height",
            Self::Color => "color",
            Self::Normal => "normal",
        }
    }
}

/// The texels of a page, row-major from its top-left corner.
#[derive(Clone, Debug, PartialEq)]
pub enum Texels {
    /// Meters above the reference surface; NaN where there is no data.
    Height(Vec<f32>),
    /// sRGB codes, or those of normals; 0 where there is no data.
    Color(Vec<[u8; 3]>),
}

/// A page's texels with its border.
///
/// Invariant: `texels` and `coverage`, where it is some, have `side * side` elements, and a height
/// is NaN exactly where the coverage is zero.
#[derive(Clone, Debug, PartialEq)]
pub struct Page {
    side: usize,
    texels: Texels,
    coverage: Option<Vec<u8>>,
    is_gray: bool,
}

/// A value read from a page, and how the page covers the place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reconstruction {
    /// Meters, or codes; a height uses the first number alone.
    pub value: [f64; 3],
    /// Weight of the valid taps, 0 to 1: 1 where the bound of the page speaks.
    pub valid_weight: f64,
    /// Reconstructed coverage, 0 to 1.
    pub coverage: f64,
}

/// Valid taps that together weigh less than this leave a place without a value.
pub const LEAST_VALID_WEIGHT: f64 = 1.0 / 512.0;

impl Page {
    /// A page of `side * side` texels.
    ///
    /// # Panics
    ///
    /// If a slice does not have `side * side` elements.
    #[must_use]
    pub fn new(side: usize, texels: Texels, coverage: Option<Vec<u8>>) -> Self {
        let count = match &texels {
            Texels::Height(texels) => texels.len(),
            Texels::Color(texels) => texels.len(),
        };
        assert_eq!(count, side * side, "a page has side x side texels");
        assert!(
            coverage.as_ref().is_none_or(|c| c.len() == count),
            "coverage stands beside texels"
        );
        let is_gray = match &texels {
            Texels::Height(_) => false,
            Texels::Color(colors) => {
                coverage.is_none()
                    && colors.iter().all(|[red, green, blue]| red == green && green == blue)
            }
        };
        Self { side, texels, coverage, is_gray }
    }

    /// Whether one channel tells all: every texel has three, is fully covered, and its red, green and blue
    /// are equal, as in most mosaics of planets.
    #[must_use]
    pub fn is_gray(&self) -> bool {
        self.is_gray
    }

    /// Texels along a side, border included.
    #[must_use]
    pub fn side(&self) -> usize {
        self.side
    }

    /// The texels.
    #[must_use]
    pub fn texels(&self) -> &Texels {
        &self.texels
    }

    /// Coverage beside each texel, or `None` where all are fully covered.
    #[must_use]
    pub fn coverage(&self) -> Option<&[u8]> {
        self.coverage.as_deref()
    }

    /// Bytes this page holds in memory.
    #[must_use]
    pub fn bytes(&self) -> usize {
        let texels = match &self.texels {
            Texels::Height(texels) => size_of_val(texels.as_slice()),
            Texels::Color(texels) => size_of_val(texels.as_slice()),
        };
        texels + self.coverage.as_ref().map_or(0, Vec::len)
    }

    /// The coverage code of a texel.
    ///
    /// # Panics
    ///
    /// If `row` or `col` is not below the side.
    #[must_use]
    pub fn coverage_at(&self, row: usize, col: usize) -> u8 {
        self.coverage.as_ref().map_or(u8::MAX, |coverage| coverage[row * self.side + col])
    }

    /// The numbers of a texel; a height fills the first.
    ///
    /// # Panics
    ///
    /// If `row` or `col` is not below the side.
    #[must_use]
    pub fn value_at(&self, row: usize, col: usize) -> [f64; 3] {
        let at = row * self.side + col;
        match &self.texels {
            Texels::Height(texels) => [f64::from(texels[at]), 0.0, 0.0],
            Texels::Color(texels) => texels[at].map(f64::from),
        }
    }

    /// The bilinear reconstruction R at (`x`, `y`), in texels from the page's top-left corner: the
    /// center of texel (0, 0) is (0.5, 0.5).
    ///
    /// A tap without data drops out and the others are weighted anew; where the valid taps weigh
    /// less than [`LEAST_VALID_WEIGHT`] there is no value.
    ///
    /// # Domain
    ///
    /// The interior of the page: its taps are in the page. Outside it the nearest taps are used.
    #[must_use]
    pub fn reconstruct(&self, x: f64, y: f64) -> Option<Reconstruction> {
        let last = self.side as f64 - 1.0;
        let (x, y) = ((x - 0.5).clamp(0.0, last), (y - 0.5).clamp(0.0, last));
        let (left, top) = (x.floor().min(last - 1.0), y.floor().min(last - 1.0));
        let (across, down) = (x - left, y - top);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped to the page above"
        )]
        let (col, row) = (left as usize, top as usize);

        let taps = [
            (row, col, (1.0 - across) * (1.0 - down)),
            (row, col + 1, across * (1.0 - down)),
            (row + 1, col, (1.0 - across) * down),
            (row + 1, col + 1, across * down),
        ];
        let mut found = Reconstruction { value: [0.0; 3], valid_weight: 0.0, coverage: 0.0 };
        for (row, col, weight) in taps {
            let coverage = self.coverage_at(row, col);
            if coverage == 0 || weight == 0.0 {
                continue;
            }
            let value = self.value_at(row, col);
            for (sum, value) in found.value.iter_mut().zip(value) {
                *sum += weight * value;
            }
            found.valid_weight += weight;
            found.coverage += weight * f64::from(coverage) / 255.0;
        }
        if found.valid_weight < LEAST_VALID_WEIGHT {
            return None;
        }
        found.value = found.value.map(|sum| sum / found.valid_weight);
        Some(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tap_without_data_drops_out() {
        let texels = Texels::Height(vec![1.0, 3.0, f32::NAN, 5.0]);
        let page = Page::new(2, texels, Some(vec![255, 255, 0, 255]));
        let center = page.reconstruct(1.0, 1.0).unwrap();
        assert_eq!(center.value[0], 3.0);
        assert_eq!(center.valid_weight, 0.75);
        assert_eq!(page.reconstruct(0.5, 1.5), None);
        assert_eq!(page.reconstruct(1.5, 1.5).unwrap().value[0], 5.0);
    }

    #[test]
    fn less_than_a_512th_of_valid_weight_is_no_value() {
        let texels = Texels::Height(vec![7.0, f32::NAN, f32::NAN, f32::NAN]);
        let page = Page::new(2, texels, Some(vec![255, 0, 0, 0]));
        assert_eq!(page.reconstruct(1.5 - 1.0 / 600.0, 0.5), None);
        assert_eq!(page.reconstruct(1.5 - 1.0 / 500.0, 0.5).unwrap().value[0], 7.0);
    }
}
