//! A child without holes whose surface is exact: a parent's cell at once.
//!
//! The four child cells of a parent's have 5×5 points of the lattice together. Four columns of them
//! are a pair's own, the fifth is its neighbor's first. Texels of odd and even columns are kept
//! apart, so that neighbors in memory are worked on alike:
//!
//! ```text
//!    texel       odd[k]     even[k]      odd[k + 1]     even[k + 1]
//!    cell              |      2k      |     2k + 1     |
//!    point            edge  center  middle  center    edge
//!    16 R_l          2A+2B   A+3B     4B     3B+D
//! ```

use super::interval::{Cells, Number, Terms, Texel};
use super::{Child, Window, parent_taps, taps};
use crate::lanes::{greatest, least};

/// Pairs that are worked on together.
const LANES: usize = 32;

/// The differences at a child's lattice, two rows of cells at a time.
pub(super) struct Solid<'a, S: Texel, T> {
    parent: Window<'a, S>,
    child: Child<'a, S>,
    terms: Terms<S>,
    /// The four rows of the child's window that two rows of cells look at.
    fine: [Halves<T>; 4],
    /// The parent's texels blended vertically, in quarters.
    coarse: Vec<T>,
    /// What was found for two rows of cells, and at their bottom, which is the top of the next.
    found: [Found<T>; 2],
}

/// The texels of a row, those of odd and of even columns of cells.
struct Halves<T> {
    odd: Vec<T>,
    even: Vec<T>,
}

/// Least and greatest differences for each pair of cells.
struct Found<T> {
    /// At its left edge.
    edge: [Vec<T>; 2],
    /// At the points between its edges.
    inside: [Vec<T>; 2],
}

/// Whether a child is one that [`Solid`] knows how to do.
pub(super) fn is_solid<S: Texel>(parent: Window<'_, S>, child: &Child<'_, S>) -> bool {
    let (rows, cols) = child.size;
    let is_full = parent.coverage.is_none() && child.window.coverage.is_none();
    is_full && child.cells.is_none() && rows.is_multiple_of(2) && cols.is_multiple_of(2)
}

impl<'a, S: Texel, T: Number<S>> Solid<'a, S, T> {
    pub(super) fn new(parent: Window<'a, S>, child: Child<'a, S>, terms: Terms<S>) -> Self {
        // The last has an edge alone. What is beyond is worked on and not used.
        let pairs = (child.size.1 / 2 + 1).next_multiple_of(LANES);
        // Whoever looks at a neighbor finds one.
        let beyond = pairs + LANES;
        let numbers = |count: usize| vec![T::default(); count];
        let halves = || Halves { odd: numbers(beyond), even: numbers(pairs) };
        let ends = |count| [numbers(count), numbers(count)];
        let found = || Found { edge: ends(beyond), inside: ends(pairs) };
        let fine = [halves(), halves(), halves(), halves()];
        let found = [found(), found()];
        Self { parent, child, terms, fine, coarse: numbers(beyond), found }
    }

    /// Widens the parent's cells by all of the child's.
    #[inline(always)]
    pub(super) fn widen(mut self, cells: &mut Cells<S::Cell>) {
        let Child { row: below, col: beside, size: (rows, cols), .. } = self.child;
        let interior = self.parent.side - 2;
        self.read(0, 2);
        self.read(1, 3);
        for row in (0..rows).step_by(2) {
            self.fine.rotate_left(2);
            self.read(row + 2, 2);
            self.read(row + 3, 3);
            if row == 0 {
                self.evaluate::<true>(row, 0, 0);
            }
            self.evaluate::<false>(row, 1, 0);
            self.evaluate::<false>(row, 2, 0);
            self.evaluate::<false>(row, 3, 0);
            self.evaluate::<true>(row, 4, 1);

            let first = (below * interior + row) / 2 * cells.cols + beside * interior / 2;
            let parents = first..first + cols / 2;
            let terms = self.terms;
            let lower = |low: T, to| least(low.low(S::ZERO, terms), to);
            give(&self.found, 0, least, &mut cells.low[parents.clone()], lower);
            let raise = |high: T, to| greatest(high.high(S::ZERO, terms), to);
            give(&self.found, 1, greatest, &mut cells.high[parents], raise);
            self.found.swap(0, 1);
        }
    }

    /// Takes a row of the child's window apart.
    #[inline(always)]
    fn read(&mut self, row: usize, place: usize) {
        let Window { side, texels, .. } = self.child.window;
        let (base, Halves { odd, even }) = (self.terms.base, &mut self.fine[place]);
        let pairs = texels[row * side..][..side].as_chunks::<2>().0;
        for ((odd, even), &[left, right]) in odd.iter_mut().zip(even).zip(pairs) {
            *odd = T::from_texel(left, base);
            *even = T::from_texel(right, base);
        }
    }

    /// Looks at the points of a lattice row of two rows of cells from `row` on, of which there are five.
    /// What was found before in `place` counts, too, unless it is the first.
    #[inline(always)]
    fn evaluate<const FIRST: bool>(&mut self, row: usize, point: usize, place: usize) {
        let Self { parent, child, terms, fine, coarse, found, .. } = self;
        let (side, base) = (parent.side, terms.base);
        let (lower, half) = if point < 3 { (0, point) } else { (1, point - 2) };

        let (top, bottom, weight) = parent_taps(child.row * (side - 2) + row + lower, half);
        let first = child.col * (side - 2) / 2;
        let upper = &parent.texels[top * side..][first..side];
        let below = &parent.texels[bottom * side..][first..side];
        let (above, weight) = (T::from_weight(4 - weight), T::from_weight(weight));
        for ((q, &a), &b) in coarse.iter_mut().zip(upper).zip(below) {
            *q = T::from_texel(a, base) * above + T::from_texel(b, base) * weight;
        }

        let [two, four, eight] = [2, 4, 8].map(T::from_weight);
        let (top, bottom) = taps(1 + lower, half);
        let (top, bottom) = (&fine[top], &fine[bottom]);
        let coarse = chunks(coarse, 0).zip(chunks(coarse, 1)).zip(chunks(coarse, 2));
        let odd = chunks(&top.odd, 0).zip(chunks(&bottom.odd, 0));
        let even = chunks(&top.even, 0).zip(chunks(&bottom.even, 0));
        let next = chunks(&top.odd, 1).zip(chunks(&bottom.odd, 1));
        let Found { edge, inside } = &mut found[place];
        let [edges, insides] = [edge, inside].map(|[low, high]| {
            low.as_chunks_mut().0.iter_mut().zip(high.as_chunks_mut::<LANES>().0)
        });
        let all = edges.zip(insides).zip(coarse).zip(odd.zip(even).zip(next));
        for (((edges, insides), ((a, b), d)), ((odd, even), next)) in all {
            let mut edge = [T::default(); LANES];
            let [mut low, mut high] = [edge; 2];
            for k in 0..LANES {
                let [odd, even, next] = [odd, even, next].map(|(top, bottom)| top[k] + bottom[k]);
                let thrice = b[k] + b[k] * two;
                edge[k] = (a[k] + b[k]) * two - (odd + even) * four;
                let left = a[k] + thrice - even * eight;
                let middle = (b[k] - (even + next)) * four;
                let right = thrice + d[k] - next * eight;
                low[k] = least(least(left, right), middle);
                high[k] = greatest(greatest(left, right), middle);
            }
            note::<FIRST, T>(edge, edges.0, least);
            note::<FIRST, T>(edge, edges.1, greatest);
            note::<FIRST, T>(low, insides.0, least);
            note::<FIRST, T>(high, insides.1, greatest);
        }
    }
}

/// Takes what was found into ends, unless it is the first.
#[inline(always)]
fn note<const FIRST: bool, T: Copy>(
    found: [T; LANES],
    ends: &mut [T; LANES],
    pick: impl Fn(T, T) -> T,
) {
    for k in 0..LANES {
        ends[k] = if FIRST { found[k] } else { pick(found[k], ends[k]) };
    }
}

/// Widens the cells of two rows by the low or the high ends that were found.
#[inline(always)]
fn give<T: Copy + Default, C: Copy>(
    [found, bottom]: &[Found<T>; 2],
    which: usize,
    pick: impl Fn(T, T) -> T,
    cells: &mut [C],
    widened: impl Fn(T, C) -> C,
) {
    let left = chunks(&found.edge[which], 0).zip(chunks(&bottom.edge[which], 0));
    let right = chunks(&found.edge[which], 1).zip(chunks(&bottom.edge[which], 1));
    let inside = chunks(&found.inside[which], 0).zip(chunks(&bottom.inside[which], 0));
    let all = left.zip(right).zip(inside);
    for (cells, ((left, right), inside)) in cells.chunks_mut(LANES).zip(all) {
        let mut ends = [T::default(); LANES];
        for (k, end) in ends.iter_mut().enumerate() {
            let edge = pick(pick(left.0[k], left.1[k]), pick(right.0[k], right.1[k]));
            *end = pick(pick(inside.0[k], inside.1[k]), edge);
        }
        for (cell, &end) in cells.iter_mut().zip(&ends) {
            *cell = widened(end, *cell);
        }
    }
}

/// A row's numbers from the one at `shift` on.
#[inline(always)]
fn chunks<T>(numbers: &[T], shift: usize) -> std::slice::Iter<'_, [T; LANES]> {
    numbers[shift..].as_chunks().0.iter()
}
