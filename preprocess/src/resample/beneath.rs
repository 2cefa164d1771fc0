//! Which pixels of a source lie beneath a leaf.
//!
//! ```text
//!   all pixels ─▶ quarters that may meet the leaf ─▶ … ─▶ squares ─▶ bands of them, side by side
//! ```
//!
//! The way from pixels to texels says it, so nothing is missed between texels or past the last of
//! them. It is a function of the grids: uses of blocks are counted by it before anything is read.
//!
//! # Precision
//!
//! A rectangle of pixels is left away where [`Transform::range`] says that it lies beside the leaf:
//! a bound, but between polar maps about opposite poles, or on different surfaces, where it is
//! estimated from places on the rectangle's rim. A pixel that such an estimate misses is not measured.

use std::ops::Range;

use areoid_formats::address::PageAddress;
use areoid_formats::grid::Placement;
use areoid_formats::pyramid::Pyramid;

use super::source::Rect;
use super::tile::{TILE, TargetTile};
use super::transform::Transform;

/// Pixels along a side of a square.
#[expect(clippy::cast_possible_truncation, reason = "it is small")]
const SIDE: u32 = TILE as u32;

/// Squares side by side that are read together at most.
const BAND: u32 = 16;

/// The interior of a leaf among the texels of its grid, their centers at whole numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Interior {
    /// Where its first and last column begin and end.
    pub(super) cols: [f64; 2],
    /// Its rows likewise.
    pub(super) rows: [f64; 2],
}

/// A pixel whose center lies on the edge between two pages is beneath both, also where rounding
/// puts it.
const SEAM_PX: f64 = 1.0 / 1024.0;

impl Interior {
    pub(super) fn of(pyramid: &Pyramid, leaf: PageAddress) -> Self {
        let (height, width) = pyramid.interior_size(leaf);
        let span = |page: u32, length: u32| {
            let first = f64::from(page * pyramid.interior()) - 0.5;
            [first - SEAM_PX, first + f64::from(length) + SEAM_PX]
        };
        Self { cols: span(leaf.col, width), rows: span(leaf.row, height) }
    }

    /// The whole turns by which its columns come to lie among those of a range, where columns are
    /// the same again after `period`; none if they do not meet.
    pub(super) fn turns(
        &self,
        [left, right, top, bottom]: [f64; 4],
        period: Option<f64>,
    ) -> impl Iterator<Item = f64> + use<> {
        let Self { cols: [first, last], rows } = *self;
        let turn = period.unwrap_or(f64::INFINITY);
        let start = if period.is_some() { ((left - last) / turn).ceil() * turn } else { 0.0 };
        let meets = rows[0] <= bottom && top <= rows[1] && start + last >= left;
        let next = move |at: &f64| period.map(|period| at + period);
        std::iter::successors(meets.then_some(start), next)
            .take_while(move |at| at + first <= right)
    }

    /// Whether a pixel of a tile may lie in it.
    pub(super) fn may_meet(&self, back: &Transform, tile: TargetTile) -> bool {
        // Where rows do not close a range may be a turn away.
        let period = back.source().period_px();
        back.range(tile).is_some_and(|range| self.turns(range, period).next().is_some())
    }

    /// Whether nothing of a range lies beside it.
    fn holds(&self, [left, right, top, bottom]: [f64; 4]) -> bool {
        let Self { cols, rows } = self;
        cols[0] <= left && right <= cols[1] && rows[0] <= top && bottom <= rows[1]
    }
}

/// The pixels beneath a leaf and some beside it, in rectangles of at most [`TILE`] rows; `back`
/// leads from the pixels to the texels of the finest level of `pyramid`.
pub(super) fn beneath(back: &Transform, pyramid: &Pyramid, leaf: PageAddress) -> Vec<Rect> {
    let Placement { width, height, .. } = *back.target();
    let size = [height, width].map(|length| length.div_ceil(SIDE));
    let mut search = Search { back, interior: Interior::of(pyramid, leaf), found: Vec::new() };
    search.look([0..size[0], 0..size[1]]);
    search.found.sort_unstable();

    let mut rects: Vec<Rect> = Vec::new();
    for [row, col] in search.found {
        let [first, end] = [col * SIDE, ((col + 1) * SIDE).min(width)];
        let rows = row * SIDE..((row + 1) * SIDE).min(height);
        match rects.last_mut() {
            Some(last)
                if last.rows == rows
                    && last.cols.end == first
                    && end - last.cols.start <= BAND * SIDE =>
            {
                last.cols.end = end;
            }
            _ => rects.push(Rect { cols: first..end, rows }),
        }
    }
    rects
}

struct Search<'a> {
    back: &'a Transform,
    interior: Interior,
    /// Squares, by row and column of squares.
    found: Vec<[u32; 2]>,
}

impl Search<'_> {
    /// Finds squares among `rows` and `cols` of them.
    fn look(&mut self, [rows, cols]: [Range<u32>; 2]) {
        let Placement { width, height, .. } = *self.back.target();
        let span = |range: &Range<u32>, length: u32| {
            let [start, end] = [range.start, range.end].map(|at| (at * SIDE).min(length));
            (i64::from(start), (end - start) as usize)
        };
        let ((row, rows_px), (col, cols_px)) = (span(&rows, height), span(&cols, width));
        let tile = TargetTile { row, col, rows: rows_px, cols: cols_px };
        if !self.interior.may_meet(self.back, tile) {
            return;
        }
        let is_inside = || self.back.range(tile).is_some_and(|range| self.interior.holds(range));
        if rows.len().max(cols.len()) <= 1 || is_inside() {
            self.found.extend(rows.flat_map(|row| cols.clone().map(move |col| [row, col])));
            return;
        }
        let halves = |range: Range<u32>| {
            let middle = range.start.midpoint(range.end + 1);
            [range.start..middle, middle..range.end]
        };
        for rows in halves(rows) {
            for cols in halves(cols.clone()).into_iter().filter(|cols| !cols.is_empty()) {
                if !rows.is_empty() {
                    self.look([rows.clone(), cols]);
                }
            }
        }
    }
}
