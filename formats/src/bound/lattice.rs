//! `R_l − R_{l+1}` at the points of a child's lattice, row by row, in sixteenths.
//!
//! With `q` the parent's texels blended vertically (in quarters) and `f` the sum of the child's
//! two, both of one lattice row, and A, B, D three neighbors of `q`, the parent's reconstruction at
//! the edges and centers of child cells repeats every second cell:
//!
//! ```text
//!    cell          2k                    2k + 1                2k + 2
//!             |------o------|---------------o---------------|---
//!    point    edge   center  edge           center          edge
//!    16 R_l   2A+2B  A+3B    4B             3B+D            2B+2D
//!    16 R_l+1 4 f of both sides at an edge, 8 f at a center
//! ```

use super::interval::{Ends, Number, Row, Terms, Texel};
use super::{Child, Window, parent_taps, taps};
use crate::lanes::{greatest, least};

/// Three lattice rows of a child: the top, the middle and the bottom of one row of its cells.
pub(super) struct Lattice<'a, S: Texel, T> {
    parent: Window<'a, S>,
    child: Child<'a, S>,
    terms: Terms<S>,
    rows: [Extremes<T>; 3],
    coarse: Vec<T>,
    edges: Vec<T>,
    centers: Vec<T>,
    fine: Vec<T>,
}

/// The least and greatest of the three points of a lattice row in each cell.
struct Extremes<T> {
    low: Vec<T>,
    high: Vec<T>,
}

impl<'a, S: Texel, T: Number<S>> Lattice<'a, S, T> {
    pub(super) fn new(parent: Window<'a, S>, child: Child<'a, S>, terms: Terms<S>) -> Self {
        let cols = child.size.1;
        let pairs = cols / 2 + 1;
        let numbers = |count: usize| vec![T::default(); count];
        let row = || Extremes { low: numbers(cols), high: numbers(cols) };
        Self {
            parent,
            child,
            terms,
            rows: [row(), row(), row()],
            coarse: numbers(pairs + 2),
            edges: numbers(2 * pairs),
            centers: numbers(2 * pairs),
            fine: numbers(cols + 2),
        }
    }

    /// Moves to row `row` of cells, from the one before it.
    #[inline(always)]
    pub(super) fn advance(&mut self, row: usize) {
        if row == 0 {
            self.evaluate(row, 0);
        } else {
            self.rows.swap(0, 2);
        }
        self.evaluate(row, 1);
        self.evaluate(row, 2);
    }

    /// Least and greatest difference in the cells of the current row, each added to what is known of
    /// it, if that is not zero.
    #[inline(always)]
    pub(super) fn intervals(
        &self,
        known: Option<Ends<'_, S::Cell>>,
        Row { low, high }: &mut Row<S>,
    ) {
        let terms = self.terms;
        let [top, middle, bottom] = &self.rows;
        let lows = || top.low.iter().zip(&middle.low).zip(&bottom.low);
        let highs = || top.high.iter().zip(&middle.high).zip(&bottom.high);
        let Some(known) = known else {
            for (low, ((&a, &b), &c)) in low.iter_mut().zip(lows()) {
                *low = least(least(a, b), c).low(S::ZERO, terms);
            }
            for (high, ((&a, &b), &c)) in high.iter_mut().zip(highs()) {
                *high = greatest(greatest(a, b), c).high(S::ZERO, terms);
            }
            return;
        };
        for ((low, ((&a, &b), &c)), &known) in low.iter_mut().zip(lows()).zip(known.low) {
            *low = least(least(a, b), c).low(known, terms);
        }
        for ((high, ((&a, &b), &c)), &known) in high.iter_mut().zip(highs()).zip(known.high) {
            *high = greatest(greatest(a, b), c).high(known, terms);
        }
    }

    #[inline(always)]
    fn evaluate(&mut self, row: usize, half: usize) {
        let side = self.parent.side;
        let interior = side - 2;
        let cols = self.child.size.1;
        let base = self.terms.base;

        let (top, bottom, weight) = parent_taps(self.child.row * interior + row, half);
        // A row that weighs nothing may have holes: NaN times zero is NaN.
        let (top, bottom) = match weight {
            0 => (top, top),
            4 => (bottom, bottom),
            _ => (top, bottom),
        };
        let first = self.child.col * interior / 2;
        let upper = &self.parent.texels[top * side..][first..side];
        let lower = &self.parent.texels[bottom * side..][first..side];
        let (above, below) = (T::from_weight(4 - weight), T::from_weight(weight));
        for ((q, &a), &b) in self.coarse.iter_mut().zip(upper).zip(lower) {
            *q = T::from_texel(a, base) * above + T::from_texel(b, base) * below;
        }
        let [two, three, four] = [2, 3, 4].map(T::from_weight);
        let pairs = self.edges.as_chunks_mut::<2>().0.iter_mut();
        let pairs = pairs.zip(self.centers.as_chunks_mut::<2>().0);
        let (q0, q1, q2) = (&self.coarse[..], &self.coarse[1..], &self.coarse[2..]);
        for (((edges, centers), (&a, &b)), &d) in pairs.zip(q0.iter().zip(q1)).zip(q2) {
            *edges = [(a + b) * two, b * four];
            *centers = [a + b * three, b * three + d];
        }

        let (top, bottom) = taps(row + 1, half);
        let upper = &self.child.window.texels[top * side..][..side];
        let lower = &self.child.window.texels[bottom * side..][..side];
        for ((f, &a), &b) in self.fine.iter_mut().zip(upper).zip(lower) {
            *f = (T::from_texel(a, base) + T::from_texel(b, base)) * four;
        }
        for ((edge, &a), &b) in self.edges.iter_mut().zip(&self.fine).zip(&self.fine[1..]) {
            *edge = *edge - (a + b);
        }
        let Extremes { low, high } = &mut self.rows[half];
        let edges = self.edges[..cols].iter().zip(&self.edges[1..=cols]);
        let centers = self.centers[..cols].iter().zip(&self.fine[1..=cols]);
        for (((low, high), (&left, &right)), (&center, &fine)) in
            low.iter_mut().zip(high).zip(edges).zip(centers)
        {
            let center = center - fine * two;
            *low = least(least(left, right), center);
            *high = greatest(greatest(left, right), center);
        }
    }
}
