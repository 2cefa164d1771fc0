//! Both maps draw meridians and parallels as straight lines: columns from columns, rows from rows.

use super::exact::{NOWHERE, Pair};
use crate::resample::tile::{Coords, TILE, TargetTile};

/// Tables of columns and rows.
#[derive(Debug)]
pub(super) struct Cylindrical {
    /// The source's column at column 0 of the target, and its columns to one of the target's.
    start: f64,
    per_col: f64,
    /// The source's row by row of the target from -1 on, and whether it is seen half a turn away.
    rows: Vec<(f64, bool)>,
}

impl Cylindrical {
    pub(super) fn new(pair: &Pair) -> Self {
        let (target, source) = (&pair.target, &pair.source);
        // Turns of longitude to a column; where both maps are one, the ratio of their pixels.
        let turns_per_col = target.crs.wraps_with_period().map(|turn| target.pixel_size[0] / turn);
        let cols_per_turn = source.crs.wraps_with_period().map(|turn| turn / source.pixel_size[0]);
        let per_col = match (turns_per_col, cols_per_turn) {
            (Some(turns), Some(cols)) if target.crs != source.crs => turns * cols,
            _ => target.pixel_size[0] / source.pixel_size[0],
        };
        let row = |row: i64| {
            let (row, turned) = pair.extended_row(row);
            (pair.exact(row as f64, 0.0).map_or(NOWHERE, |(_, v)| v), turned)
        };
        Self {
            start: pair.exact(pair.equator_row(), 0.0).map_or(NOWHERE, |(u, _)| u),
            per_col,
            rows: (-1..=i64::from(target.height)).map(row).collect(),
        }
    }

    fn rows(&self, tile: TargetTile) -> &[(f64, bool)] {
        let first = usize::try_from(tile.row + 1).expect("rows start at -1");
        &self.rows[first..first + tile.rows]
    }

    /// Columns of the source by columns of the tile: a base in the turn of the tile's middle, and
    /// the extended level's column.
    fn base(&self, pair: &Pair, tile: TargetTile) -> f64 {
        let middle = pair.extended_col(tile.col + tile.cols as i64 / 2) as f64;
        let u = self.start + self.per_col * middle;
        self.start + (pair.source.nearest_turn(u) - u)
    }

    /// Columns from a pole's other side are half a turn away.
    fn half_turn(pair: &Pair) -> f64 {
        pair.source.period_px().unwrap_or(0.0) / 2.0
    }

    pub(super) fn fill(&self, pair: &Pair, tile: TargetTile, out: &mut Coords) {
        let base = self.base(pair, tile);
        let mut columns = [0.0; TILE];
        for (col, column) in (tile.col..).zip(&mut columns) {
            *column = self.per_col * pair.extended_col(col) as f64;
        }
        let lines = out.u.chunks_exact_mut(tile.cols).zip(out.v.chunks_exact_mut(tile.cols));
        for ((u_row, v_row), &(v, turned)) in lines.zip(self.rows(tile)) {
            v_row.fill(v);
            let base = base + if turned { Self::half_turn(pair) } else { 0.0 };
            for (u, column) in u_row.iter_mut().zip(&columns) {
                *u = base + column;
            }
        }
        out.range = self.range(pair, tile);
    }

    pub(super) fn range(&self, pair: &Pair, tile: TargetTile) -> [f64; 4] {
        let base = self.base(pair, tile);
        let at = |turned: bool, col: i64| {
            let base = base + if turned { Self::half_turn(pair) } else { 0.0 };
            base + self.per_col * pair.extended_col(col) as f64
        };
        let [first, last] = [tile.col, tile.col + tile.cols as i64 - 1];
        let rows = self.rows(tile);
        let left = at(rows.iter().all(|&(_, turned)| turned), first);
        let right = at(rows.iter().any(|&(_, turned)| turned), last);
        let (mut top, mut bottom) = (f64::INFINITY, f64::NEG_INFINITY);
        for &(v, _) in rows {
            (top, bottom) = (top.min(v), bottom.max(v));
        }
        [left, right, top, bottom]
    }
}
