//! Cells with missing taps around: point by point.

use super::interval::{Ends, Row, Terms, Texel};
use super::{Child, LATTICE, Window, parent_taps, taps};

/// Finds the cells of a child beside holes, and puts their intervals right.
pub(super) struct Holes<'a, S: Texel> {
    parent: Window<'a, S>,
    child: Child<'a, S>,
    terms: Terms<S>,
    /// In the three rows of the child that a row of cells looks at, by column of the window.
    fine: Columns,
    /// In the two rows of the parent, likewise.
    coarse: Columns,
}

/// Columns with a hole in one of some rows, and those with nothing else: 1, else 0.
struct Columns {
    any: Vec<u8>,
    all: Vec<u8>,
}

impl<'a, S: Texel> Holes<'a, S> {
    pub(super) fn new(parent: Window<'a, S>, child: Child<'a, S>, terms: Terms<S>) -> Self {
        let flags = || vec![0; parent.side];
        let columns = || Columns { any: flags(), all: flags() };
        Self { parent, child, terms, fine: columns(), coarse: columns() }
    }

    /// Replaces the intervals of row `row` that a missing tap made wrong.
    pub(super) fn mend(
        &mut self,
        row: usize,
        known: Option<Ends<'_, S::Cell>>,
        Row { low, high }: &mut Row<S>,
    ) {
        let interior = self.parent.side - 2;
        let (top, bottom, _) = parent_taps(self.child.row * interior + row, 1);
        let fine = self.fine.mark(self.child.window, &[row, row + 1, row + 2]);
        let coarse = self.coarse.mark(self.parent, &[top, bottom]);
        if !(fine || coarse) {
            return;
        }
        for col in 0..self.child.size.1 {
            let (left, right, _) = parent_taps(self.child.col * interior + col, 1);
            let of_fine = |flags: &[u8]| [flags[col], flags[col + 1], flags[col + 2]];
            let of_coarse = |flags: &[u8]| [flags[left], flags[right]];
            let any = of_fine(&self.fine.any)
                .iter()
                .chain(&of_coarse(&self.coarse.any))
                .any(|&hole| hole == 1);
            if !any {
                continue;
            }
            // In the middle of a hole there is nothing to hold against one another.
            let nothing =
                of_fine(&self.fine.all) == [1; 3] || of_coarse(&self.coarse.all) == [1; 2];
            let (least, greatest) = if nothing {
                (f64::INFINITY, f64::NEG_INFINITY)
            } else {
                let end = |end: S::Cell| S::end(end, self.terms.known_log2);
                let known =
                    known.map_or([0.0; 2], |ends| [end(ends.low[col]), end(ends.high[col])]);
                self.careful(row, col, known)
            };
            (low[col], high[col]) = S::outward(least, greatest, self.terms.unit_log2);
        }
    }

    /// The interval of a child cell with missing taps around.
    fn careful(&self, row: usize, col: usize, known: [f64; 2]) -> (f64, f64) {
        let Self { parent, child, terms: Terms { rounding, .. }, .. } = self;
        let interior = parent.side - 2;
        let coarse = LATTICE.map(|(down, across)| {
            let (top, bottom, below) = parent_taps(child.row * interior + row, down);
            let (left, right, beside) = parent_taps(child.col * interior + col, across);
            let [below, beside] = [below, beside].map(|quarters| f64::from(quarters) / 4.0);
            let taps = [
                (top, left, (1.0 - below) * (1.0 - beside)),
                (top, right, (1.0 - below) * beside),
                (bottom, left, below * (1.0 - beside)),
                (bottom, right, below * beside),
            ];
            let weighing = taps.iter().filter(|tap| tap.2 > 0.0);
            weighing.map(|&(r, c, weight)| weight * parent.at(r, c)).sum::<f64>()
        });
        let (least, greatest) = finest_around(child.window, row, col);
        let known_coarse = coarse.iter().filter(|here| !here.is_nan());
        let (lowest, highest) = known_coarse
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &here| {
                (low.min(here), high.max(here))
            });

        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for ((down, across), here) in LATTICE.into_iter().zip(coarse) {
            let (top, bottom) = taps(row + 1, down);
            let (left, right) = taps(col + 1, across);
            let corners = [(top, left), (top, right), (bottom, left), (bottom, right)];
            let fine = corners.map(|(r, c)| child.window.at(r, c)).iter().sum::<f64>() / 4.0;
            if !fine.is_nan() {
                if !here.is_nan() {
                    low = low.min(here - fine + known[0] - rounding);
                    high = high.max(here - fine + known[1] + rounding);
                }
                continue;
            }
            if child.finest {
                continue;
            }
            // The chain breaks on the quarters and edges that meet here. R_l is bilinear on each, so
            // its extremes are at the points of the lattice beside this one; R_L may be anything.
            for ((other_down, other_across), there) in LATTICE.into_iter().zip(coarse) {
                let beside = other_down.abs_diff(down) <= 1 && other_across.abs_diff(across) <= 1;
                if beside && !there.is_nan() && least <= greatest {
                    low = low.min(there - greatest - rounding);
                    high = high.max(there - least + rounding);
                }
            }
        }
        // Nothing in the cell is farther apart than the two surfaces' own ranges.
        (low.max(lowest - greatest - rounding), high.min(highest - least + rounding))
    }
}

impl Columns {
    /// Marks the columns by what they have in `rows`; false if there are no holes.
    fn mark<S>(&mut self, window: Window<'_, S>, rows: &[usize]) -> bool {
        let Some(coverage) = window.coverage else { return false };
        let row = |row: usize| &coverage[row * window.side..][..window.side];
        let holes = rows.iter().any(|&at| row(at).contains(&0));
        self.any.fill(0);
        self.all.fill(u8::from(holes));
        for &at in rows.iter().filter(|_| holes) {
            for ((any, all), &code) in self.any.iter_mut().zip(&mut self.all).zip(row(at)) {
                let hole = u8::from(code == 0);
                (*any, *all) = (*any | hole, *all & hole);
            }
        }
        holes
    }
}

/// Least and greatest finest texel under a child cell and its eight neighbors.
fn finest_around<S: Texel>(window: Window<'_, S>, row: usize, col: usize) -> (f64, f64) {
    let (mut least, mut greatest) = (f64::INFINITY, f64::NEG_INFINITY);
    for r in row..row + 3 {
        for c in col..col + 3 {
            let at = r * window.side + c;
            if window.at(r, c).is_nan() {
                continue;
            }
            let (low, high) = match window.span {
                Some(span) => (span.least[at], span.greatest[at]),
                None => (window.texels[at], window.texels[at]),
            };
            least = least.min(low.into());
            greatest = greatest.max(high.into());
        }
    }
    (least, greatest)
}
