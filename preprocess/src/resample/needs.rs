//! What of a source a leaf needs: prepared tiles.
//!
//! ```text
//!   leaf ─▶ tiles of texels ─▶ rectangles of the source, with what kernels reach ─▶ prepared tiles
//! ```
//!
//! All of it is a function of the grids, so that uses can be counted before anything is read. Past
//! the source's edges rectangles fold onto the pixels that stand for what is there.

use std::ops::Range;

use areoid_formats::address::PageAddress;
use areoid_formats::grid::Placement;
use areoid_formats::pyramid::Pyramid;

use super::extension::Extension;
use super::prepare::PREPARED;
use super::source::Rect;
use super::tile::{Footprint, TargetTile};
use super::transform::Transform;

/// How far taps lie from the pixel above and to the left of a place, in pixels: to the left, to
/// the right, up and down.
pub type Reach = [i64; 4];

/// A prepared tile: its column and its row among those of a source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PreparedAt {
    /// Row of tiles.
    pub row: u32,
    /// Column of tiles.
    pub col: u32,
}

/// Texels below which a rectangle is not cut further to name fewer tiles.
const FINEST_CUT: usize = 16;

/// Places named are so much wider.
const SLACK_PX: f64 = 1.0 / 1024.0;

/// The prepared tiles that the interior of a leaf and so many texels around it may need, sorted: all that
/// they do, and few more.
///
/// `reach` is what a kernel reaches for a footprint. It is asked for the same tiles of texels that
/// the leaf is sampled in: others have other footprints.
///
/// # Panics
///
/// If `leaf` is none of the finest pages of `pyramid`, that of the target's texels.
#[must_use]
pub fn prepared_tiles(
    transform: &Transform,
    pyramid: &Pyramid,
    (leaf, around): (PageAddress, u32),
    reach: impl Fn(Footprint) -> Reach,
) -> Vec<PreparedAt> {
    assert_eq!(leaf.level, pyramid.finest(), "a leaf is a finest page");
    let (rows, cols) = texels_around(pyramid, leaf, around);
    let length = |range: &Range<i64>| range.clone().count();
    let whole =
        TargetTile { row: rows.start, col: cols.start, rows: length(&rows), cols: length(&cols) };
    if transform.range(whole).is_none() {
        return Vec::new();
    }
    let mut found = Vec::new();
    for tile in transform.tiles(rows, cols) {
        if transform.range(tile).is_some() {
            name(transform, tile, reach(transform.footprint(tile)), &mut found);
        }
        // Neighbors name the same.
        found.dedup();
    }
    found.sort_unstable();
    found.dedup();
    found
}

/// Rows and columns of the interior of a leaf and of so many texels around it.
pub(super) fn texels_around(
    pyramid: &Pyramid,
    leaf: PageAddress,
    around: u32,
) -> (Range<i64>, Range<i64>) {
    let (height, width) = pyramid.interior_size(leaf);
    let range = |index: u32, length: u32| {
        let first = i64::from(index * pyramid.interior());
        first - i64::from(around)..first + i64::from(length + around)
    };
    (range(leaf.row, height), range(leaf.col, width))
}

/// Names what a rectangle of texels needs: all of its own rectangle in the source if that is one
/// tile or the texels are few, else what its quarters need.
fn name(transform: &Transform, texels: TargetTile, reach: Reach, found: &mut Vec<PreparedAt>) {
    let Some(range) = transform.range(texels) else { return };
    // A place is that of a tile of texels, and may be another by rounding than that of a quarter.
    let [left, right, top, bottom] = range;
    let range = [left - SLACK_PX, right + SLACK_PX, top - SLACK_PX, bottom + SLACK_PX];
    let rects = window(transform.source(), range, reach);
    let count: u64 = rects.iter().map(|rect| tiles_of(rect).count() as u64).sum();
    let side = texels.rows.max(texels.cols);
    if count <= 1 || side <= FINEST_CUT {
        found.extend(rects.iter().flat_map(tiles_of));
        return;
    }
    let halves = |start: i64, length: usize| {
        let first = length.div_ceil(2);
        [(start, first), (start + first as i64, length - first)]
    };
    for (row, rows) in halves(texels.row, texels.rows) {
        for (col, cols) in halves(texels.col, texels.cols) {
            if rows > 0 && cols > 0 {
                name(transform, TargetTile { row, col, rows, cols }, reach, found);
            }
        }
    }
}

/// How many leaves name each prepared tile, row by row.
#[must_use]
pub fn uses(source: &Placement, named: impl IntoIterator<Item = PreparedAt>) -> Vec<u32> {
    let cols = source.width.div_ceil(PREPARED) as usize;
    let mut uses = vec![0; cols * source.height.div_ceil(PREPARED) as usize];
    for tile in named {
        uses[tile.row as usize * cols + tile.col as usize] += 1;
    }
    uses
}

/// The pixels of the source that a window about positions in `range` holds: columns and rows from
/// the least to the greatest, each with its reach, folded.
#[must_use]
pub fn window(source: &Placement, range: [f64; 4], reach: Reach) -> Vec<Rect> {
    let [left, right, top, bottom] = range.map(floor);
    let [to_left, to_right, up, down] = reach;
    let (cols, rows) = (left - to_left..right + to_right + 1, top - up..bottom + down + 1);
    let extension = Extension::new(source.extent());
    let rects = extension.rows(rows).into_iter().flat_map(|rows| {
        let cols = extension.cols(cols.clone(), rows.first.turned);
        cols.into_iter().map(move |cols| Rect { cols: cols.range(), rows: rows.range() })
    });
    rects.collect()
}

/// The prepared tiles that hold pixels of a rectangle.
fn tiles_of(rect: &Rect) -> impl Iterator<Item = PreparedAt> + use<> {
    let tiles = |range: &Range<u32>| range.start / PREPARED..range.end.div_ceil(PREPARED);
    let cols = tiles(&rect.cols);
    tiles(&rect.rows).flat_map(move |row| cols.clone().map(move |col| PreparedAt { row, col }))
}

#[expect(clippy::cast_possible_truncation, reason = "positions are confined to their source")]
fn floor(position: f64) -> i64 {
    position.floor() as i64
}

#[cfg(test)]
mod tests;
