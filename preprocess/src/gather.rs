//! Rectangles of a level, extended, copied from the tiles that hold them.
//!
//! ```text
//!             tile        tile
//!   run    ┌────────┬──────────────┐     columns of the level that are consecutive columns of a
//!   of ────│───▪▪▪▪▪│▪▪▪▪▪▪▪▪▪▪▪▪  │     tile make a run; what is wrapped, turned or repeated
//!   a row  └────────┴──────────────┘     begins another
//! ```

use std::ops::Range;

use areoid_formats::address::{Level, PageAddress};
use areoid_formats::bound::Span;
use areoid_formats::codec::Quantum;
use areoid_formats::page::LEAST_VALID_WEIGHT;
use areoid_formats::pyramid::{ExtendedRow, Pyramid};

use crate::texel::Texel;
use crate::tile::{Tile, nothing};

/// Consecutive columns of a window that come from consecutive columns of a column of tiles.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cols {
    /// First column in the window.
    pub(crate) to: usize,
    /// How many.
    pub(crate) length: usize,
    /// Column of tiles.
    pub(crate) tile: u32,
    /// First column in the tile's interior.
    pub(crate) from: usize,
}

impl Cols {
    /// What lies in columns `cols` of the window.
    pub(crate) fn within(&self, cols: &Range<usize>) -> Option<Self> {
        let start = self.to.max(cols.start);
        let end = (self.to + self.length).min(cols.end);
        let from = self.from + (start - self.to);
        (start < end).then(|| Self { to: start, length: end - start, tile: self.tile, from })
    }
}

/// Columns `within` of a level, extended, in rows that are turned or not; the first is the window's.
pub(crate) fn cols_of(
    pyramid: &Pyramid,
    level: Level,
    within: Range<i64>,
    turned: bool,
) -> Vec<Cols> {
    let interior = pyramid.interior();
    let mut runs: Vec<Cols> = Vec::new();
    for (to, col) in within.enumerate() {
        let col = pyramid.extended_col(level, col, turned);
        let (tile, from) = (col / interior, (col % interior) as usize);
        match runs.last_mut() {
            Some(run) if run.tile == tile && run.from + run.length == from => run.length += 1,
            _ => runs.push(Cols { to, length: 1, tile, from }),
        }
    }
    runs
}

/// The tiles of a level.
pub(crate) struct Tiles<'a, F> {
    /// Whose level it is.
    pub(crate) pyramid: &'a Pyramid,
    /// Which.
    pub(crate) level: Level,
    /// What is known of each page: `None` for one without a valid texel.
    pub(crate) tile_of: F,
    /// The step that rows between two rows are put on.
    pub(crate) quantum: Quantum,
}

/// What was copied so far, one thing behind another.
#[derive(Debug)]
pub(crate) struct Gathered<S> {
    /// Stored texels, one plane a channel.
    pub(crate) planes: Vec<Vec<S>>,
    /// Those before rounding, if wanted.
    pub(crate) original: Option<Vec<Vec<S>>>,
    /// Coverage beside each.
    pub(crate) coverage: Vec<u8>,
    /// The finest texels under each, if wanted.
    pub(crate) spans: Option<Vec<Span<S>>>,
}

impl<S: Texel> Gathered<S> {
    /// Nothing yet, of originals and of finest texels only where they are wanted.
    pub(crate) fn new(rounded: bool, spanned: bool) -> Self {
        let empty = || vec![Vec::new(); S::CHANNELS];
        Self {
            planes: empty(),
            original: rounded.then(empty),
            coverage: Vec::new(),
            spans: spanned.then(|| vec![nothing(0); S::CHANNELS]),
        }
    }

    /// Forgets all of it.
    pub(crate) fn clear(&mut self) {
        self.planes.iter_mut().chain(self.original.iter_mut().flatten()).for_each(Vec::clear);
        for span in self.spans.iter_mut().flatten() {
            span.least.clear();
            span.greatest.clear();
        }
        self.coverage.clear();
    }

    /// Appends columns `cols` of a row of the level, extended, and of the `rows` - 1 that follow it
    /// in the same tile.
    pub(crate) fn take<'a>(
        &mut self,
        tiles: &Tiles<'_, impl Fn(PageAddress) -> Option<&'a Tile<S>>>,
        source: ExtendedRow,
        cols: &Cols,
        rows: usize,
    ) where
        S: 'a,
    {
        let interior = tiles.pyramid.interior();
        let at = |row: u32| {
            let page = PageAddress::new(tiles.level, row / interior, cols.tile);
            ((tiles.tile_of)(page), (row % interior) as usize)
        };
        let (tile, row) = at(source.row);
        if source.weight == 0.0 {
            self.copy(tile, row, cols, rows);
        } else {
            let (next_tile, next) = at(source.next);
            let taps = [(tile, row, 1.0 - source.weight), (next_tile, next, source.weight)];
            self.blend(cols, taps, tiles.quantum);
        }
    }

    /// Appends texels of `rows` rows from `row` of a tile's interior on.
    fn copy(&mut self, tile: Option<&Tile<S>>, row: usize, cols: &Cols, rows: usize) {
        let Some(tile) = tile else {
            (0..rows * cols.length).for_each(|_| self.invalid());
            return;
        };
        let part = (tile.at(row, cols.from), tile.side, (rows, cols.length));
        for (channel, plane) in tile.planes.iter().enumerate() {
            gather(plane, part, &mut self.planes[channel]);
            if let Some(original) = &mut self.original {
                let plane = tile.original.as_ref().map_or(plane, |original| &original[channel]);
                gather(plane, part, &mut original[channel]);
            }
            if let (Some(spans), Some(tile_spans)) = (&mut self.spans, &tile.spans) {
                let (span, source) = (&mut spans[channel], &tile_spans[channel]);
                gather(&source.least, part, &mut span.least);
                gather(&source.greatest, part, &mut span.greatest);
            }
        }
        match &tile.coverage {
            Some(codes) => gather(codes, part, &mut self.coverage),
            None => self.coverage.resize(self.coverage.len() + rows * cols.length, u8::MAX),
        }
    }

    fn invalid(&mut self) {
        let planes = self.planes.iter_mut().chain(self.original.iter_mut().flatten());
        planes.for_each(|plane| plane.push(S::INVALID));
        for span in self.spans.iter_mut().flatten() {
            span.least.push(S::NOTHING.0);
            span.greatest.push(S::NOTHING.1);
        }
        self.coverage.push(0);
    }

    /// Two rows of a post-registered grid's coarser level, mirrored over a pole between texels:
    /// their weighted mean, on the step.
    fn blend(&mut self, cols: &Cols, taps: [(Option<&Tile<S>>, usize, f64); 2], quantum: Quantum) {
        for place in 0..cols.length {
            let present = taps.iter().filter_map(|&(tile, row, weight)| {
                let tile = tile?;
                let from = tile.at(row, cols.from + place);
                let code = tile.coverage.as_ref().map_or(u8::MAX, |codes| codes[from]);
                (code != 0).then_some((tile, from, code, weight))
            });
            let total: f64 = present.clone().map(|(.., weight)| weight).sum();
            if total < LEAST_VALID_WEIGHT {
                self.invalid();
                continue;
            }
            for channel in 0..S::CHANNELS {
                let texels = present
                    .clone()
                    .map(|(tile, from, _, weight)| weight * tile.planes[channel][from].into());
                let texel = S::stored(texels.sum::<f64>() / total, quantum);
                self.planes[channel].push(texel);
                if let Some(original) = &mut self.original {
                    original[channel].push(texel);
                }
                if let Some(spans) = &mut self.spans {
                    let (mut least, mut greatest) = S::NOTHING;
                    for (tile, from, ..) in present.clone() {
                        if let Some(source) = tile.spans.as_ref().map(|spans| &spans[channel]) {
                            let (low, high) = (source.least[from], source.greatest[from]);
                            least = if low < least { low } else { least };
                            greatest = if high > greatest { high } else { greatest };
                        }
                    }
                    spans[channel].least.push(least);
                    spans[channel].greatest.push(greatest);
                }
            }
            let code: f64 = present.map(|(.., code, weight)| weight * f64::from(code)).sum();
            #[expect(clippy::cast_possible_truncation, reason = "clamped to codes")]
            #[expect(clippy::cast_sign_loss, reason = "clamped to codes")]
            self.coverage.push(code.round_ties_even().clamp(1.0, 255.0) as u8);
        }
    }
}

/// Appends a part of a plane of `side` columns: so many rows and columns from `start` on.
fn gather<T: Copy>(
    plane: &[T],
    (start, side, (rows, cols)): (usize, usize, (usize, usize)),
    to: &mut Vec<T>,
) {
    let rows = (start..).step_by(side).take(rows);
    if cols == 1 {
        to.extend(rows.map(|at| plane[at]));
    } else {
        rows.for_each(|at| to.extend_from_slice(&plane[at..at + cols]));
    }
}
