//! A parent's interior from its children's: two by two texels become one.
//!
//! Texels are cells, not grid points: a parent texel covers exactly two by two child texels, and
//! takes the mean of the stored ones that are valid (summed in f64, colors in linear light), on
//! the step of the level, ties to even. It is valid if any child is; its coverage is the mean of
//! theirs. Children past the outline do not exist and do not count.

use areoid_formats::bound::Span;
use areoid_formats::codec::Quantum;
use areoid_formats::lanes;

use crate::texel::Texel;
use crate::tile::{Tile, nothing};

/// Whether the finest texels under each texel are kept: only bounds beside holes need them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Spans {
    /// They are.
    Kept,
    /// The source has no holes.
    Unneeded,
}

/// A child and its place: (0 upper or 1 lower, 0 left or 1 right).
pub type PlacedTile<'a, S> = ((usize, usize), &'a Tile<S>);

/// The interior of a parent of `size` rows and columns, in pages of `side` texels.
///
/// `children` are those with a valid texel; `None` if there are none.
#[must_use]
pub fn parent<S: Texel>(
    side: usize,
    size: (usize, usize),
    children: &[PlacedTile<'_, S>],
    quantum: Quantum,
    spans: Spans,
) -> Option<Tile<S>> {
    if children.is_empty() {
        return None;
    }
    let mut tile = Tile::blank(side, size);
    let full = children.iter().filter(|(_, child)| child.coverage.is_none());
    let covered = full.map(|(_, child)| child.rows.div_ceil(2) * child.cols.div_ceil(2));
    if covered.sum::<usize>() == size.0 * size.1 {
        tile.coverage = None;
    }
    if spans == Spans::Kept {
        tile.spans = Some(vec![nothing(side * side); S::CHANNELS]);
    }
    let half = (side - 2) / 2;
    for ((down, right), child) in children {
        for child_row in (0..child.rows).step_by(2) {
            let to = tile.at(down * half + child_row / 2, right * half);
            halve_row(&mut tile, to, child, child_row, quantum);
        }
    }
    let Some(coverage) = &tile.coverage else { return Some(tile) };
    let all = |wanted: u8| {
        (0..size.0).all(|row| coverage[tile.row(row)].iter().all(|&code| code == wanted))
    };
    if all(0) {
        return None;
    }
    if all(u8::MAX) {
        tile.coverage = None;
    }
    Some(tile)
}

/// Two rows of a child into one of its parent, from `to` on.
fn halve_row<S: Texel>(
    parent: &mut Tile<S>,
    to: usize,
    child: &Tile<S>,
    row: usize,
    quantum: Quantum,
) {
    let upper = child.row(row);
    let whole = row + 1 < child.rows;
    let lower = child.row(if whole { row + 1 } else { row });
    let covered = |range: &std::ops::Range<usize>| {
        child.coverage.as_ref().is_none_or(|codes| !codes[range.clone()].contains(&0))
    };
    // Pairs of columns that have all four texels go together; what is left one by one.
    let simple = if whole && covered(&upper) && covered(&lower) { child.cols / 2 } else { 0 };
    for channel in 0..S::CHANNELS {
        let plane = &child.planes[channel];
        let rows = [&plane[upper.clone()], &plane[lower.clone()]];
        let out = &mut parent.planes[channel][to..to + simple];
        lanes::vectorized(Halving { rows, quantum, out });
        if let Some(spans) = &mut parent.spans {
            let (low, high) = span_of(child, channel);
            let part = to..to + simple;
            let rows = [&low[upper.clone()], &low[lower.clone()]];
            fold_pairs(rows, &mut spans[channel].least[part.clone()], lanes::least);
            let rows = [&high[upper.clone()], &high[lower.clone()]];
            fold_pairs(rows, &mut spans[channel].greatest[part], lanes::greatest);
        }
    }
    match (&mut parent.coverage, &child.coverage) {
        (None, _) => {}
        (Some(codes), None) => codes[to..to + simple].fill(u8::MAX),
        (Some(codes), Some(coverage)) => {
            let pairs = coverage[upper.clone()].as_chunks::<2>().0.iter();
            let pairs = pairs.zip(coverage[lower.clone()].as_chunks::<2>().0);
            for (code, (&[a, b], &[c, d])) in codes[to..to + simple].iter_mut().zip(pairs) {
                *code = mean_coverage(&[a, b, c, d]);
            }
        }
    }
    for col in (2 * simple..child.cols).step_by(2) {
        one_texel(parent, to + col / 2, child, (row, col), quantum);
    }
}

/// The least and greatest finest texels of a page; a leaf's are its own before rounding.
fn span_of<S: Texel>(tile: &Tile<S>, channel: usize) -> (&[S], &[S]) {
    match &tile.spans {
        Some(spans) => (&spans[channel].least, &spans[channel].greatest),
        None => {
            let original = tile.original.as_ref().unwrap_or(&tile.planes);
            (&original[channel], &original[channel])
        }
    }
}

/// [`Texel::halve`] in wide vectors.
struct Halving<'a, S> {
    rows: [&'a [S]; 2],
    quantum: Quantum,
    out: &'a mut [S],
}

impl<S: Texel> lanes::Wide for Halving<'_, S> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        S::halve(self.rows, self.quantum, self.out);
    }
}

fn fold_pairs<S: Texel>([upper, lower]: [&[S]; 2], out: &mut [S], pick: impl Fn(S, S) -> S) {
    let pairs = upper.as_chunks::<2>().0.iter().zip(lower.as_chunks::<2>().0);
    for (out, (&[a, b], &[c, d])) in out.iter_mut().zip(pairs) {
        *out = pick(pick(a, b), pick(c, d));
    }
}

/// The parent texel over the one to four texels of a child at (`row`, `col`), the valid ones.
fn one_texel<S: Texel>(
    parent: &mut Tile<S>,
    to: usize,
    child: &Tile<S>,
    (row, col): (usize, usize),
    quantum: Quantum,
) {
    let mut places = [0; 4];
    let mut count = 0;
    for (row, col) in [(row, col), (row, col + 1), (row + 1, col), (row + 1, col + 1)] {
        if row < child.rows && col < child.cols {
            places[count] = child.at(row, col);
            count += 1;
        }
    }
    let places = &places[..count];
    let code_at = |at: usize| child.coverage.as_ref().map_or(u8::MAX, |codes| codes[at]);
    let mut codes = [0; 4];
    places.iter().zip(&mut codes).for_each(|(&at, code)| *code = code_at(at));
    if let Some(coverage) = &mut parent.coverage {
        coverage[to] = mean_coverage(&codes[..count]);
    }

    for channel in 0..S::CHANNELS {
        let mut valid = [S::INVALID; 4];
        let mut valid_count = 0;
        let (low, high) = span_of(child, channel);
        let (mut least, mut greatest) = S::NOTHING;
        for &at in places.iter().filter(|&&at| code_at(at) != 0) {
            valid[valid_count] = child.planes[channel][at];
            valid_count += 1;
            least = if low[at] < least { low[at] } else { least };
            greatest = if high[at] > greatest { high[at] } else { greatest };
        }
        if valid_count > 0 {
            parent.planes[channel][to] = S::mean(&valid[..valid_count], quantum);
        }
        if let Some(spans) = &mut parent.spans {
            let Span { least: low, greatest: high } = &mut spans[channel];
            (low[to], high[to]) = (least, greatest);
        }
    }
}

/// The mean of one to four codes, rounded to nearest, but full only where all are, and invalid only
/// where all are.
#[inline]
fn mean_coverage(codes: &[u8]) -> u8 {
    let sum: u32 = codes.iter().map(|&code| u32::from(code)).sum();
    if sum == 0 {
        return 0;
    }
    let count = u32::try_from(codes.len()).expect("at most four");
    let nearest = (2 * sum + count) / (2 * count);
    let full = sum == 255 * count;
    u8::try_from(nearest.clamp(1, if full { 255 } else { 254 })).expect("clamped to codes")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coverage_is_full_or_nothing_only_where_all_is() {
        assert_eq!(mean_coverage(&[0; 4]), 0);
        assert_eq!(mean_coverage(&[0, 0, 0, 1]), 1);
        assert_eq!(mean_coverage(&[255, 255, 255, 254]), 254);
        assert_eq!(mean_coverage(&[255; 3]), 255);
        assert_eq!(mean_coverage(&[1, 2]), 2);
    }
}
