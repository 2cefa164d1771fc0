//! What of a source a leaf needs: prepared tiles, and the blocks that those are made of.
//!
//! ```text
//!   leaf ─▶ tiles of texels ─▶ rectangles of the source, with what kernels reach ─▶ prepared tiles
//!   prepared tile ─▶ its pixels and a halo ─▶ rectangles of the source ─▶ blocks
//! ```
//!
//! All of it is a function of the grids, so that uses can be counted before anything is read. Past
//! the source's edges rectangles fold onto the pixels that stand for what is there: a turn away,
//! over a pole, or mirrored about the outermost pixel.

use std::ops::Range;

use areoid_formats::address::PageAddress;
use areoid_formats::grid::Placement;
use areoid_formats::pyramid::PoleContact;

use super::tile::{Footprint, TargetTile};
use super::transform::Transform;

/// Pixels along a side of a prepared tile.
pub const PREPARED: u32 = 256;

/// How far taps lie from the pixel above and to the left of a place, in pixels: to the left, to
/// the right, up and down.
pub type Reach = [i64; 4];

/// A rectangle of a source's pixels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rect {
    /// Columns.
    pub cols: Range<u32>,
    /// Rows.
    pub rows: Range<u32>,
}

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

/// The prepared tiles that the interior of a leaf and the texel around it may need, sorted: all
/// that they do, and few more.
///
/// `reach` is what a kernel reaches for a footprint.
///
/// # Panics
///
/// If `leaf` is none of the finest pages of the target.
#[must_use]
pub fn prepared_tiles(
    transform: &Transform,
    leaf: PageAddress,
    reach: impl Fn(Footprint) -> Reach,
) -> Vec<PreparedAt> {
    let pyramid = transform.target().pyramid();
    assert_eq!(leaf.level, pyramid.finest(), "a leaf is a finest page");
    let (height, width) = pyramid.interior_size(leaf);
    let interior = pyramid.interior();
    let [row, col] = [leaf.row, leaf.col].map(|index| i64::from(index * interior) - 1);
    let (rows, cols) = (row..row + i64::from(height) + 2, col..col + i64::from(width) + 2);

    let whole = TargetTile { row, col, rows: height as usize + 2, cols: width as usize + 2 };
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

/// Names what a rectangle of texels needs: all of its own rectangle in the source if that is one
/// tile or the texels are few, else what its quarters need.
fn name(transform: &Transform, texels: TargetTile, reach: Reach, found: &mut Vec<PreparedAt>) {
    let Some(range) = transform.range(texels) else { return };
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
    fold(source, left - to_left..right + to_right + 1, top - up..bottom + down + 1)
}

/// The pixels of the source that a prepared tile with a halo of so many pixels is made of.
#[must_use]
pub fn halo(source: &Placement, tile: PreparedAt, halo: u32) -> Vec<Rect> {
    let span = |index: u32, length: u32| {
        let start = i64::from(index) * i64::from(PREPARED);
        let end = (start + i64::from(PREPARED)).min(i64::from(length));
        start - i64::from(halo)..end + i64::from(halo)
    };
    fold(source, span(tile.col, source.width), span(tile.row, source.height))
}

/// The blocks of `block` pixels, columns by rows, of a raster of `size` whose first pixel is the
/// source's at `corner`, that hold pixels of `rects`: columns and rows of blocks, sorted by row.
#[must_use]
pub fn blocks(rects: &[Rect], corner: [u32; 2], size: [u32; 2], block: [u32; 2]) -> Vec<[u32; 2]> {
    let within = |range: &Range<u32>, axis: usize| {
        let start = range.start.max(corner[axis]) - corner[axis];
        let end = range.end.saturating_sub(corner[axis]).min(size[axis]);
        if start < end { start / block[axis]..(end - 1) / block[axis] + 1 } else { 0..0 }
    };
    let mut found: Vec<[u32; 2]> = Vec::new();
    for Rect { cols, rows } in rects {
        let cols = within(cols, 0);
        found.extend(within(rows, 1).flat_map(|row| cols.clone().map(move |col| [col, row])));
    }
    found.sort_unstable_by_key(|&[col, row]| (row, col));
    found.dedup();
    found
}

/// The prepared tiles that hold pixels of a rectangle.
fn tiles_of(rect: &Rect) -> impl Iterator<Item = PreparedAt> + use<> {
    let tiles = |range: &Range<u32>| range.start / PREPARED..range.end.div_ceil(PREPARED);
    let cols = tiles(&rect.cols);
    tiles(&rect.rows).flat_map(move |row| cols.clone().map(move |col| PreparedAt { row, col }))
}

/// The pixels of the source that stand for a rectangle of rows and columns, past its edges or not.
fn fold(source: &Placement, cols: Range<i64>, rows: Range<i64>) -> Vec<Rect> {
    let mut rects = Vec::new();
    for (rows, turned) in fold_rows(source, rows) {
        for cols in fold_cols(source, cols.clone(), turned) {
            rects.push(Rect { cols, rows: rows.clone() });
        }
    }
    rects
}

/// The rows that stand for a range of rows, and whether they do half a turn away.
fn fold_rows(source: &Placement, rows: Range<i64>) -> Vec<(Range<u32>, bool)> {
    let height = i64::from(source.height);
    let mut found = vec![(meet(&rows, height), false)];
    // Row r past an edge stands for row `about - r`.
    let about_north = if source.north == PoleContact::Outline { -1 } else { 0 };
    let south = if source.south == PoleContact::Outline { 2 * height - 1 } else { 2 * height - 2 };
    for (past, about, contact) in [
        (rows.start..rows.end.min(0), about_north, source.north),
        (rows.start.max(height)..rows.end, south, source.south),
    ] {
        if past.is_empty() {
            continue;
        }
        // Mirrored past the other edge, it would be folded again: all rows stand for something.
        let mirrored = about - past.end + 1..about - past.start + 1;
        let inside = (0..height).contains(&mirrored.start) && mirrored.end <= height;
        let rows = if inside { meet(&mirrored, height) } else { 0..source.height };
        found.push((rows.clone(), contact != PoleContact::None));
        if !inside {
            found.push((rows, false));
        }
    }
    found.retain(|(rows, _)| !rows.is_empty());
    found
}

/// The columns that stand for a range of columns in rows that are half a turn away or not.
fn fold_cols(source: &Placement, cols: Range<i64>, turned: bool) -> Vec<Range<u32>> {
    let width = i64::from(source.width);
    if !source.wraps {
        let mut found = vec![meet(&cols, width)];
        for (past, about) in
            [(cols.start..cols.end.min(0), 0), (cols.start.max(width)..cols.end, 2 * width - 2)]
        {
            let mirrored = about - past.end + 1..about - past.start + 1;
            let inside = mirrored.start >= 0 && mirrored.end <= width;
            found.push(match (past.is_empty(), inside) {
                (true, _) => 0..0,
                (_, true) => meet(&mirrored, width),
                _ => 0..source.width,
            });
        }
        found.retain(|cols| !cols.is_empty());
        return found;
    }
    // Half a turn of an odd width falls between two columns.
    let (turn, between) = if turned { (width / 2, width % 2) } else { (0, 0) };
    let length = (cols.end - cols.start + between).min(width);
    let start = (cols.start + turn).rem_euclid(width);
    let mut found = vec![meet(&(start..start + length), width)];
    found.push(meet(&(start - width..start - width + length), width));
    found.retain(|cols| !cols.is_empty());
    found
}

/// What of a range lies in `0..length`.
fn meet(range: &Range<i64>, length: i64) -> Range<u32> {
    let narrow = |index: i64| {
        u32::try_from(index.clamp(0, length)).expect("an index of a source fits its width")
    };
    narrow(range.start)..narrow(range.end)
}

#[expect(clippy::cast_possible_truncation, reason = "positions are confined to their source")]
fn floor(position: f64) -> i64 {
    position.floor() as i64
}

#[cfg(test)]
mod tests;
