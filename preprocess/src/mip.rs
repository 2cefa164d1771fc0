//! A parent's interior from its children's: two by two texels become one.
//!
//! Texels are cells, not grid points: a parent texel covers exactly two by two child texels, and
//! takes the mean of the stored ones that are valid (summed in f64, colors in linear light), on
//! the step of the level, ties to even. It is valid if any child is; its coverage is the mean of
//! theirs. Children past the outline do not exist and do not count.

use areoid_formats::bound::Span;
use areoid_formats::lanes::{self, greatest, least};

use crate::texel::{Mean, Texel};
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
    mean: Mean,
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
            halve_row(&mut tile, to, child, child_row, mean);
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
fn halve_row<S: Texel>(parent: &mut Tile<S>, to: usize, child: &Tile<S>, row: usize, mean: Mean) {
    // Runs of columns that have all four texels go together; what is left one by one.
    let pairs = if row + 1 < child.rows { child.cols / 2 } else { 0 };
    let from = child.at(row, 0);
    match &child.coverage {
        None => {
            halve_run(parent, to, child, (from, pairs), mean);
            if let Some(codes) = &mut parent.coverage {
                codes[to..to + pairs].fill(u8::MAX);
            }
        }
        Some(codes) => {
            let [upper, lower] = [from, from + child.side];
            let rows = || {
                let [upper, lower] = [upper, lower].map(|row| codes[row..].as_chunks::<2>().0);
                upper.iter().zip(lower).take(pairs)
            };
            if let Some(means) = &mut parent.coverage {
                for (mean, (&[a, b], &[c, d])) in means[to..].iter_mut().zip(rows()) {
                    *mean = mean_of_four([a, b, c, d]);
                }
            }
            let missing: Vec<u8> = rows()
                .map(|(&[a, b], &[c, d])| [a, b, c, d].map(|code| u8::from(code == 0)))
                .map(|[a, b, c, d]| a + b + c + d)
                .collect();
            let mut next = 0;
            for run in missing.chunk_by(|one, other| one == other) {
                let columns = next..next + run.len();
                next = columns.end;
                match run[0] {
                    0 => {
                        let from = from + 2 * columns.start;
                        halve_run(parent, to + columns.start, child, (from, run.len()), mean);
                    }
                    4 => {}
                    _ => columns.for_each(|col| {
                        one_texel(parent, to + col, child, (row, 2 * col), mean);
                    }),
                }
            }
        }
    }
    for col in (2 * pairs..child.cols).step_by(2) {
        one_texel(parent, to + col / 2, child, (row, col), mean);
    }
}

/// Two by two valid texels of a child, so many pairs of columns from `from` on, into texels of its
/// parent from `to` on.
fn halve_run<S: Texel>(
    parent: &mut Tile<S>,
    to: usize,
    child: &Tile<S>,
    (from, pairs): (usize, usize),
    mean: Mean,
) {
    let part = (from, child.side, 2 * pairs);
    for channel in 0..S::CHANNELS {
        let rows = two_rows(&child.planes[channel], part);
        let out = &mut parent.planes[channel][to..][..pairs];
        lanes::vectorized(Halving { rows, mean, out });
        if let Some(spans) = &mut parent.spans {
            let (low, high) = span_of(child, channel);
            let span = &mut spans[channel];
            fold_pairs(two_rows(low, part), &mut span.least[to..][..pairs], least);
            fold_pairs(two_rows(high, part), &mut span.greatest[to..][..pairs], greatest);
        }
    }
}

/// A part of two rows of a plane of `side` columns: so many columns from `from` on.
fn two_rows<S>(plane: &[S], (from, side, cols): (usize, usize, usize)) -> [&[S]; 2] {
    [&plane[from..][..cols], &plane[from + side..][..cols]]
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
    mean: Mean,
    out: &'a mut [S],
}

impl<S: Texel> lanes::Wide for Halving<'_, S> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        S::halve(self.rows, self.mean, self.out);
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
    mean: Mean,
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
            parent.planes[channel][to] = S::mean(&valid[..valid_count], mean);
        }
        if let Some(spans) = &mut parent.spans {
            let Span { least: low, greatest: high } = &mut spans[channel];
            (low[to], high[to]) = (least, greatest);
        }
    }
}

/// [`mean_coverage`] of four codes, so that a row of them becomes vectors.
#[inline(always)]
fn mean_of_four(codes: [u8; 4]) -> u8 {
    let [a, b, c, d] = codes.map(u16::from);
    let sum = a + b + c + d;
    let most = 254 + u16::from(sum == 4 * 255);
    #[expect(clippy::cast_possible_truncation, reason = "a mean of codes")]
    let code = least((sum + 2) >> 2, most) as u8;
    code + u8::from((sum > 0) & (code == 0))
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

    #[test]
    fn four_codes_have_one_mean() {
        let codes = || [0, 1, 2, 3, 127, 128, 252, 253, 254, 255].into_iter();
        for (a, b) in codes().flat_map(|a| codes().map(move |b| (a, b))) {
            for (c, d) in codes().flat_map(|c| codes().map(move |d| (c, d))) {
                assert_eq!(mean_of_four([a, b, c, d]), mean_coverage(&[a, b, c, d]));
            }
        }
    }
}
