//! What the oracle answers: reconstructions, suprema and ranges.

use super::levels::Levels;
use super::raster::Raster;

/// Rows and columns of finest texels, from..to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Footprint {
    pub(crate) top: usize,
    pub(crate) bottom: usize,
    pub(crate) left: usize,
    pub(crate) right: usize,
}

/// A level with a ring of its extension around it, ready to be reconstructed.
#[derive(Debug)]
struct Ringed {
    scale: f64,
    across: usize,
    planes: Vec<Vec<f32>>,
}

/// The reconstruction R of every level, and of the samples before they were rounded.
#[derive(Debug)]
pub(crate) struct Oracle {
    pub(crate) levels: Levels,
    source: Ringed,
    stored: Vec<Ringed>,
}

impl Oracle {
    pub(crate) fn new(raster: &Raster, halvings: usize) -> Self {
        let levels = Levels::new(raster, halvings);
        let unrounded = Levels::new(&Raster { step: None, ..raster.clone() }, 0);
        let stored = (0..levels.count()).map(|k| Ringed::new(&levels, k)).collect();
        Self { source: Ringed::new(&unrounded, 0), levels, stored }
    }

    /// R of a level at (x, y) finest texels from the outline's corner; `None` if a tap that weighs
    /// is missing.
    pub(crate) fn value(&self, halvings: usize, channel: usize, x: f64, y: f64) -> Option<f64> {
        self.stored[halvings].value(channel, x, y)
    }

    /// |R of a level − R of the samples|, the largest over channels, where law 1 speaks.
    pub(crate) fn error(&self, halvings: usize, x: f64, y: f64) -> Option<f64> {
        let mut largest = 0.0_f64;
        for channel in 0..self.source.planes.len() {
            let truth = self.source.value(channel, x, y)?;
            largest = largest.max((self.value(halvings, channel, x, y)? - truth).abs());
        }
        Some(largest)
    }

    /// The supremum of [`Self::error`] over a footprint. Both surfaces are bilinear between half
    /// texels of the finest level, so it is taken at one of those points.
    pub(crate) fn supremum(&self, halvings: usize, page: Footprint) -> f64 {
        let mut largest = 0.0_f64;
        for half_row in 2 * page.top..=2 * page.bottom {
            for half_col in 2 * page.left..=2 * page.right {
                let (x, y) = (half_col as f64 / 2.0, half_row as f64 / 2.0);
                largest = largest.max(self.error(halvings, x, y).unwrap_or(0.0));
            }
        }
        largest
    }

    /// Least and greatest stored finest texel of a footprint widened by `margin` texels of the
    /// extended level; `None` if none is valid.
    pub(crate) fn range(&self, page: Footprint, margin: i64) -> Option<(f32, f32)> {
        let span = |from: usize, to: usize| from as i64 - margin..to as i64 + margin;
        let mut range: Option<(f32, f32)> = None;
        for row in span(page.top, page.bottom) {
            for col in span(page.left, page.right) {
                for channel in 0..self.source.planes.len() {
                    let texel = self.levels.texel(0, channel, row, col);
                    if !texel.is_nan() {
                        let (low, high) = range.unwrap_or((texel, texel));
                        range = Some((low.min(texel), high.max(texel)));
                    }
                }
            }
        }
        range
    }

    /// The largest |stored − sample| of a footprint.
    pub(crate) fn source_error(&self, page: Footprint) -> f64 {
        let center = |index: usize| index as f64 + 0.5;
        let mut largest = 0.0_f64;
        for row in page.top..page.bottom {
            for col in page.left..page.right {
                largest = largest.max(self.error(0, center(col), center(row)).unwrap_or(0.0));
            }
        }
        largest
    }
}

impl Ringed {
    fn new(levels: &Levels, halvings: usize) -> Self {
        let level = levels.level(halvings);
        let (across, down) = (level.width + 2, level.height + 2);
        let planes = (0..level.planes.len())
            .map(|channel| {
                (0..across * down)
                    .map(|at| {
                        let (row, col) = ((at / across) as i64 - 1, (at % across) as i64 - 1);
                        levels.texel(halvings, channel, row, col)
                    })
                    .collect()
            })
            .collect();
        Self { scale: (1_u64 << halvings) as f64, across, planes }
    }

    fn value(&self, channel: usize, x: f64, y: f64) -> Option<f64> {
        // Centers are at halves; the ring puts the first texel at index 1.
        let (x, y) = (x / self.scale + 0.5, y / self.scale + 0.5);
        let (right, below) = (x - x.floor(), y - y.floor());
        let at = y.floor() as usize * self.across + x.floor() as usize;
        let taps = [
            (at, (1.0 - right) * (1.0 - below)),
            (at + 1, right * (1.0 - below)),
            (at + self.across, (1.0 - right) * below),
            (at + self.across + 1, right * below),
        ];
        let mut sum = 0.0;
        for (at, weight) in taps.into_iter().filter(|&(_, weight)| weight != 0.0) {
            sum += weight * f64::from(self.planes[channel][at]);
        }
        (!sum.is_nan()).then_some(sum)
    }
}
