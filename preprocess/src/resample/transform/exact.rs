//! Positions through the body, one by one: the oracle, and the way where no other leads.

use std::f64::consts::{FRAC_PI_2, PI};

use areoid_formats::geodesy::Geographic;
use areoid_formats::grid::Placement;
use areoid_formats::projection::Projection;
use areoid_formats::units::Radians;

use super::{cols_of, rows_of};
use crate::resample::extension::Extension;
use crate::resample::tile::{Coords, TargetTile};

/// A target and a source.
#[derive(Debug)]
pub(super) struct Pair {
    pub(super) target: Placement,
    pub(super) source: Placement,
}

/// Where texels are put that the source's map does not show: outside any raster.
pub(super) const NOWHERE: f64 = -1e9;

impl Pair {
    pub(super) fn new(target: Placement, source: Placement) -> Self {
        Self { target, source }
    }

    /// What a place among the finest texels shows.
    pub(super) fn position(&self, row: f64, col: f64) -> Option<Geographic> {
        self.target.geographic_from_pixel(col, row)
    }

    /// The row that shows the equator, of a target of straight meridians: columns are the same in all
    /// rows, but on a pole longitude says nothing.
    ///
    /// # Panics
    ///
    /// If the target's map does not draw the equator.
    pub(super) fn equator_row(&self) -> f64 {
        let equator = self.target.crs.project(Geographic::default());
        let equator = equator.expect("maps of straight meridians draw the equator");
        (self.target.origin[1] - equator.y) / self.target.pixel_size[1] - 0.5
    }

    pub(super) fn exact(&self, row: f64, col: f64) -> Option<(f64, f64)> {
        let shown = self.source.crs.project(self.position(row, col)?)?;
        Some(self.source.pixel_from_map(shown))
    }

    pub(super) fn back(&self, u: f64, v: f64) -> Option<(f64, f64)> {
        let position = self.source.crs.unproject(self.source.map_from_pixel(u, v))?;
        let shown = self.target.crs.project(position)?;
        let (col, row) = self.target.pixel_from_map(shown);
        Some((row, col))
    }

    /// The row of the level that shows in row `row` of the extended level, and whether it does half
    /// a turn away.
    pub(super) fn extended_row(&self, row: i64) -> (i64, bool) {
        let from = Extension::new(self.target.extent()).row(row);
        let last = i64::from(self.target.height) - 1;
        if from.real { (i64::from(from.index), from.turned) } else { (row.clamp(0, last), false) }
    }

    /// The column of the level that shows in column `col` of the extended level, not wrapped.
    pub(super) fn extended_col(&self, col: i64) -> i64 {
        if self.target.wraps { col } else { col.clamp(0, i64::from(self.target.width) - 1) }
    }

    /// Columns to what is seen half a turn away.
    fn half_turn(&self, turned: bool) -> f64 {
        if turned { f64::from(self.target.width) / 2.0 } else { 0.0 }
    }

    /// The row and column of a texel that shows what the extended level does there.
    fn extended(&self, row: i64, col: i64) -> (f64, f64) {
        let (row, turned) = self.extended_row(row);
        (row as f64, self.extended_col(col) as f64 + self.half_turn(turned))
    }

    /// The middle of a tile, in rows and columns of the level.
    fn middle(&self, tile: TargetTile) -> (f64, f64) {
        let (row, turned) = self.extended_row(tile.row + tile.rows as i64 / 2);
        let col = self.extended_col(tile.col + tile.cols as i64 / 2);
        (row as f64, col as f64 + self.half_turn(turned))
    }

    /// All texels of a tile, in the turn of the one in its middle.
    pub(super) fn fill(&self, tile: TargetTile, out: &mut Coords) {
        let (row, col) = self.middle(tile);
        let middle = self.exact(row, col).map_or(0.0, |(u, _)| u);
        let mut range = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
        let texels = rows_of(tile).flat_map(|row| cols_of(tile).map(move |col| (row, col)));
        for ((row, col), (u_out, v_out)) in texels.zip(out.u.iter_mut().zip(&mut out.v)) {
            let (row, col) = self.extended(row, col);
            let (u, v) = match self.exact(row, col) {
                Some((u, v)) => (self.turn_near(u, middle), v),
                None => (if self.source.wraps { middle } else { NOWHERE }, NOWHERE),
            };
            range = [range[0].min(u), range[1].max(u), range[2].min(v), range[3].max(v)];
            (*u_out, *v_out) = (u, v);
        }
        out.range = range;
    }

    /// Column `u` in the turn in which it is nearest to `middle`.
    fn turn_near(&self, u: f64, middle: f64) -> f64 {
        let Some(period) = self.source.period_px() else { return u };
        u - period * ((u - middle) / period).round()
    }

    /// A rectangle about the positions of a rectangle of texels, from its rim.
    ///
    /// The rim of what is seen is that of the rectangle where maps are continuous. Between two
    /// samples it is taken to bend no more than twice as much as between their neighbors.
    pub(super) fn range(&self, tile: TargetTile) -> [f64; 4] {
        const EVERY: usize = 8;
        let everything = [-1.0, f64::from(self.source.width), -1.0, f64::from(self.source.height)];
        let steps = |length: usize| length.saturating_sub(1).div_ceil(EVERY).max(1);
        let (down, across) = (steps(tile.rows), steps(tile.cols));
        let at = |row: usize, col: usize| {
            let place = |start: i64, length: usize, step: usize, of: usize| {
                start as f64 + length.saturating_sub(1) as f64 * step as f64 / of as f64
            };
            let last = |length: u32| f64::from(length) - 1.0;
            let row = place(tile.row, tile.rows, row, down).clamp(0.0, last(self.target.height));
            let col = place(tile.col, tile.cols, col, across).clamp(0.0, last(self.target.width));
            self.exact(row, col)
        };
        let rim: Option<Vec<(f64, f64)>> = (0..across)
            .map(|col| at(0, col))
            .chain((0..down).map(|row| at(row, across)))
            .chain((0..across).map(|col| at(down, across - col)))
            .chain((0..down).map(|row| at(down - row, 0)))
            .collect();
        // What the source's map puts at infinity lies in it or near it.
        let Some(rim) = rim else { return everything };
        if self.holds_the_end_of_the_source(tile) {
            return everything;
        }

        let mut range = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
        let (mut bend_u, mut bend_v) = (0.0_f64, 0.0_f64);
        let before = |at: usize| rim[(at + rim.len() - 1) % rim.len()];
        let after = |at: usize| rim[(at + 1) % rim.len()];
        for (at, &(u, v)) in rim.iter().enumerate() {
            range = [range[0].min(u), range[1].max(u), range[2].min(v), range[3].max(v)];
            let corner = [0, across, across + down, 2 * across + down].contains(&at);
            if !corner {
                bend_u = bend_u.max((before(at).0 + after(at).0 - 2.0 * u).abs());
                bend_v = bend_v.max((before(at).1 + after(at).1 - 2.0 * v).abs());
            }
        }
        let [left, right, top, bottom] = range;
        // A bend of h²|f''| leaves its chord by an eighth.
        let (bend_u, bend_v) = (bend_u / 4.0 + 1e-3, bend_v / 4.0 + 1e-3);
        [left - bend_u, right + bend_u, top - bend_v, bottom + bend_v]
    }

    /// Whether a rectangle of texels holds the pole that is at infinity on the source's map.
    fn holds_the_end_of_the_source(&self, tile: TargetTile) -> bool {
        let Projection::PolarStereographic(map) = &self.source.crs.projection else { return false };
        let latitude = Radians(-map.pole.sign() * FRAC_PI_2);
        let end = Geographic { latitude, ..Geographic::default() };
        let Some(end) = self.target.crs.project(end) else { return false };
        let (x, y) = self.target.pixel_from_map(end);
        let holds = |place: f64, start: i64, length: usize| {
            (start as f64..=start as f64 + length as f64).contains(&place)
        };
        holds(x, tile.col, tile.cols) && holds(y, tile.row, tile.rows)
    }

    /// Lengths of a texel's footprint along the source's columns and rows, by differences.
    pub(super) fn footprint(&self, tile: TargetTile) -> [f64; 2] {
        let (row, col) = self.middle(tile);
        let difference = |one: Option<(f64, f64)>, other: Option<(f64, f64)>| {
            let ((u, v), (other_u, other_v)) = (one?, other?);
            Some((self.turn_near(u, other_u) - other_u, v - other_v))
        };
        let across = difference(self.exact(row, col + 0.5), self.exact(row, col - 0.5));
        let down = difference(self.exact(row + 0.5, col), self.exact(row - 0.5, col));
        match (across, down) {
            (Some(across), Some(down)) => {
                [libm::hypot(across.0, down.0), libm::hypot(across.1, down.1)]
            }
            _ => [1.0, 1.0],
        }
    }

    /// Pixels of the source, along its columns and rows, to the coarser of its two spacings on the
    /// ground in the middle of a tile. 1 where the source shows nothing.
    pub(super) fn detail(&self, tile: TargetTile) -> [f64; 2] {
        let (row, col) = self.middle(tile);
        let Some(position) = self.position(row, col) else { return [1.0, 1.0] };
        let [[ex, ey], [nx, ny]] = self.source.crs.ground_jacobian(position);
        let spacing_u = libm::hypot(ex, nx) * self.source.pixel_size[0];
        let spacing_v = libm::hypot(ey, ny) * self.source.pixel_size[1];
        let coarser = spacing_u.max(spacing_v);
        // So many columns meet in the half row beside a pole.
        let most = self.source.period_px().map_or(f64::INFINITY, |period| period / PI);
        let pixels = |spacing: f64| (coarser / spacing).min(most.max(1.0));
        let detail = [pixels(spacing_u), pixels(spacing_v)];
        if detail.iter().all(|pixels| pixels.is_finite()) { detail } else { [1.0, 1.0] }
    }
}
