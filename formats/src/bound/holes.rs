//! Cells with missing taps around: point by point.

use super::interval::{Ends, Row, Terms, Texel};
use super::{Child, LATTICE, Window, parent_taps, taps};
use crate::lanes::{greatest, least};

/// Finds the cells of a child beside holes, and puts their intervals right.
pub(super) struct Holes<'a, S: Texel> {
    parent: Window<'a, S>,
    child: Child<'a, S>,
    terms: Terms<S>,
    /// What the three rows of the child have that a row of cells looks at, by column of the window:
    /// [`HOLE`], [`VALID`] or both.
    fine: Vec<u8>,
    /// What the two rows of the parent have, likewise.
    coarse: Vec<u8>,
    /// What each cell of the row is: [`WHOLE`], [`BESIDE`] or [`WITHIN`] holes.
    places: Vec<u8>,
    /// By whether a cell's row and column in the parent are odd.
    weights: [[Weights; 2]; 2],
}

/// What each of the parent's four taps around a cell weighs at the points of its lattice.
type Weights = [[f64; 9]; 4];

const HOLE: u8 = 1;
const VALID: u8 = 2;

/// No tap is missing.
const WHOLE: u8 = 0;
/// Some taps are missing.
const BESIDE: u8 = 1;
/// There is no tap, of the child or of the parent: nothing to hold against one another.
const WITHIN: u8 = 2;

impl<'a, S: Texel> Holes<'a, S> {
    pub(super) fn new(parent: Window<'a, S>, child: Child<'a, S>, terms: Terms<S>) -> Self {
        let columns = || vec![VALID; parent.side];
        let places = vec![WHOLE; child.size.1.next_multiple_of(2)];
        let weights = [0, 1].map(|row| [0, 1].map(|col| weights(row, col)));
        Self { parent, child, terms, fine: columns(), coarse: columns(), places, weights }
    }

    /// Replaces the intervals of row `row` that a missing tap made wrong.
    #[inline(always)]
    pub(super) fn mend(
        &mut self,
        row: usize,
        known: Option<Ends<'_, S::Cell>>,
        Row { low, high }: &mut Row<S>,
    ) {
        if !self.find(row) {
            return;
        }
        let mut next = 0;
        for run in self.places[..self.child.size.1].chunk_by(|one, other| one == other) {
            let cells = next..next + run.len();
            next = cells.end;
            if run[0] == WITHIN {
                low[cells.clone()].fill(S::EMPTY.0);
                high[cells].fill(S::EMPTY.1);
            } else if run[0] == BESIDE {
                for col in cells {
                    let end = |end: S::Cell| S::end(end, self.terms.known_log2);
                    let known =
                        known.map_or([0.0; 2], |ends| [end(ends.low[col]), end(ends.high[col])]);
                    let (least, greatest) = self.careful(row, col, known);
                    (low[col], high[col]) = S::outward(least, greatest, self.terms.unit_log2);
                }
            }
        }
    }

    /// Says what the cells of a row are; false if all are whole.
    #[inline(always)]
    fn find(&mut self, row: usize) -> bool {
        let Self { parent, child, fine, coarse, places, .. } = self;
        let interior = parent.side - 2;
        let (top, bottom, _) = parent_taps(child.row * interior + row, 1);
        let in_fine = mark(child.window, [row, row + 1, row + 2], fine);
        let in_coarse = mark(*parent, [top, bottom, bottom], coarse);
        if !(in_fine || in_coarse) {
            return false;
        }
        let coarse = &coarse[child.col * interior / 2..];
        let twos = coarse.iter().zip(&coarse[1..]).zip(&coarse[2..]);
        for (pair, ((&a, &b), &c)) in places.as_chunks_mut::<2>().0.iter_mut().zip(twos) {
            *pair = [a | b, b | c];
        }
        let threes = fine.iter().zip(&fine[1..]).zip(&fine[2..]);
        for (place, ((&a, &b), &c)) in places.iter_mut().zip(threes) {
            let (fine, coarse) = (a | b | c, *place);
            let within = (fine == HOLE) | (coarse == HOLE);
            *place = ((fine | coarse) & HOLE) + u8::from(within);
        }
        true
    }

    /// The interval of a child cell with missing taps around.
    #[inline(always)]
    fn careful(&self, row: usize, col: usize, known: [f64; 2]) -> (f64, f64) {
        let Self { parent, child, terms: Terms { rounding, .. }, .. } = self;
        let interior = parent.side - 2;
        let (row_in_parent, col_in_parent) =
            (child.row * interior + row, child.col * interior + col);
        let (top, bottom, _) = parent_taps(row_in_parent, 1);
        let (left, right, _) = parent_taps(col_in_parent, 1);
        let texels = [(top, left), (top, right), (bottom, left), (bottom, right)];
        let texels = texels.map(|(row, col)| parent.at(row, col));
        let weights = &self.weights[row_in_parent % 2][col_in_parent % 2];
        let mut coarse = [0.0; 9];
        for (weights, texel) in weights.iter().zip(texels) {
            for (here, &weight) in coarse.iter_mut().zip(weights) {
                *here += if weight > 0.0 { weight * texel } else { 0.0 };
            }
        }
        // NaN is neither less nor greater.
        let (mut lowest, mut highest) = (f64::INFINITY, f64::NEG_INFINITY);
        for here in coarse {
            (lowest, highest) = (least(here, lowest), greatest(here, highest));
        }
        let mut fine = [[0.0; 3]; 3];
        for (down, texels) in fine.iter_mut().enumerate() {
            for (across, texel) in texels.iter_mut().enumerate() {
                *texel = child.window.at(row + down, col + across);
            }
        }
        let (lowest_finest, highest_finest) = finest_around(child.window, &fine, row, col);

        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        let mut broken = [false; 9];
        for (((down, across), here), broken) in LATTICE.into_iter().zip(coarse).zip(&mut broken) {
            let (top, bottom) = taps(1, down);
            let (left, right) = taps(1, across);
            let sum = fine[top][left] + fine[top][right] + fine[bottom][left] + fine[bottom][right];
            let difference = here - sum / 4.0;
            *broken = sum.is_nan();
            low = least(difference + known[0] - rounding, low);
            high = greatest(difference + known[1] + rounding, high);
        }
        if !child.finest && lowest_finest <= highest_finest && broken.contains(&true) {
            // The chain breaks on the quarters and edges that meet in such a point. R_l is bilinear
            // on each, so its extremes are at the points of the lattice beside it; R_L may be
            // anything.
            for ((down, across), _) in LATTICE.into_iter().zip(broken).filter(|(_, broken)| *broken)
            {
                for ((other_down, other_across), there) in LATTICE.into_iter().zip(coarse) {
                    let beside =
                        other_down.abs_diff(down) <= 1 && other_across.abs_diff(across) <= 1;
                    if beside {
                        low = least(there - highest_finest - rounding, low);
                        high = greatest(there - lowest_finest + rounding, high);
                    }
                }
            }
        }
        // Nothing in the cell is farther apart than the two surfaces' own ranges.
        (low.max(lowest - highest_finest - rounding), high.min(highest - lowest_finest + rounding))
    }
}

/// The weights in cells whose row and column in the parent are even, 0, or odd, 1.
fn weights(row: usize, col: usize) -> Weights {
    let mut weights = [[0.0; 9]; 4];
    for (point, (down, across)) in LATTICE.into_iter().enumerate() {
        let below = f64::from(parent_taps(row, down).2) / 4.0;
        let beside = f64::from(parent_taps(col, across).2) / 4.0;
        weights[0][point] = (1.0 - below) * (1.0 - beside);
        weights[1][point] = (1.0 - below) * beside;
        weights[2][point] = below * (1.0 - beside);
        weights[3][point] = below * beside;
    }
    weights
}

/// Marks columns by what they have in three rows; false if there are no holes.
#[inline(always)]
fn mark<S>(window: Window<'_, S>, rows: [usize; 3], columns: &mut [u8]) -> bool {
    let Some(coverage) = window.coverage else { return false };
    let [a, b, c] = rows.map(|row| &coverage[row * window.side..][..window.side]);
    let mut any = 0;
    for (column, ((&a, &b), &c)) in columns.iter_mut().zip(a.iter().zip(b).zip(c)) {
        let of = |code: u8| if code == 0 { HOLE } else { VALID };
        *column = of(a) | of(b) | of(c);
        any |= *column;
    }
    any & HOLE != 0
}

/// Least and greatest finest texel under a child cell and its eight neighbors, `texels`.
#[inline(always)]
fn finest_around<S: Texel>(
    window: Window<'_, S>,
    texels: &[[f64; 3]; 3],
    row: usize,
    col: usize,
) -> (f64, f64) {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for (down, texels) in texels.iter().enumerate() {
        let first = (row + down) * window.side + col;
        for (across, &texel) in texels.iter().enumerate() {
            let (lowest, highest) = match window.span {
                Some(_) if texel.is_nan() => continue,
                Some(span) => {
                    (span.least[first + across].into(), span.greatest[first + across].into())
                }
                None => (texel, texel),
            };
            (low, high) = (least(lowest, low), greatest(highest, high));
        }
    }
    (low, high)
}
