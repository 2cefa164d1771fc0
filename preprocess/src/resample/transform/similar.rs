//! Two polar maps of one surface about one pole: the same figure, turned, stretched and moved.
//!
//! The radius of a place on either map is a length of the map's own times one function of its
//! latitude, so with κ the ratio of those lengths and δ = λₜ - λₛ the angle between the meridians
//! that run straight down,
//!
//! ```text
//! east  = κ (eastₜ cos δ + southₜ sin δ)        u = u_pole + east / pixel_x
//! south = κ (southₜ cos δ - eastₜ sin δ)        v = v_pole ± south / pixel_y
//! ```
//!
//! # Precision
//!
//! Exact: rounding errors of sums of three terms.

use areoid_formats::geodesy::Geographic;
use areoid_formats::grid::Placement;
use areoid_formats::projection::{Crs, PolarStereographic, Projection};

use super::exact::Pair;
use crate::resample::tile::{Coords, TILE, TargetTile};

/// Columns and rows of the source as sums of what a column and a row of the target add.
#[derive(Debug)]
pub(super) struct Similar {
    /// The target's column and row of the pole.
    target_pole: [f64; 2],
    /// The source's.
    source_pole: [f64; 2],
    /// Columns and rows of the source to a column of the target.
    per_col: [f64; 2],
    /// To a row.
    per_row: [f64; 2],
}

impl Similar {
    /// `None` if the maps are not similar, or the target's ends somewhere on the grid.
    pub(super) fn new(pair: &Pair) -> Option<Self> {
        let (target, source) = (&pair.target, &pair.source);
        let [from, to] = [target, source].map(|placement| match placement.crs.projection {
            Projection::PolarStereographic(map) => Some(map),
            _ => None,
        });
        let (from, to) = (from?, to?);
        let is_one_surface = Crs { projection: source.crs.projection, ..target.crs } == source.crs;
        if from.pole != to.pole || !is_one_surface {
            return None;
        }
        // Nothing of a rectangle is farther from the pole than its corners.
        let [right, bottom] = [target.width, target.height].map(f64::from);
        let corners = [[-1.0, -1.0], [right, -1.0], [-1.0, bottom], [right, bottom]];
        if corners.iter().any(|&[col, row]| pair.position(row, col).is_none()) {
            return None;
        }

        let ratio = radius_of_equator(source, &to)? / radius_of_equator(target, &from)?;
        let (sine, cosine) = libm::sincos(from.central_meridian.0 - to.central_meridian.0);
        let sign = from.pole.sign();
        let [[target_x, target_y], [source_x, source_y]] = [target.pixel_size, source.pixel_size];
        let turned = |by: f64, lengths: f64| ratio * lengths * by;
        Some(Self {
            target_pole: pole(target, &from),
            source_pole: pole(source, &to),
            per_col: [
                turned(cosine, target_x / source_x),
                turned(-sign * sine, target_x / source_y),
            ],
            per_row: [
                turned(sign * sine, target_y / source_x),
                turned(cosine, target_y / source_y),
            ],
        })
    }

    /// What a column of the extended level adds to the source's column, or to its row.
    fn of_col(&self, pair: &Pair, axis: usize, col: i64) -> f64 {
        self.per_col[axis] * (pair.extended_col(col) as f64 - self.target_pole[0])
    }

    /// The source's column, or its row, at a row of the extended level below the pole.
    fn of_row(&self, pair: &Pair, axis: usize, row: i64) -> f64 {
        let row = row.clamp(0, i64::from(pair.target.height) - 1) as f64;
        self.source_pole[axis] + self.per_row[axis] * (row - self.target_pole[1])
    }

    pub(super) fn fill(&self, pair: &Pair, tile: TargetTile, out: &mut Coords) {
        for (axis, places) in [&mut out.u, &mut out.v].into_iter().enumerate() {
            let mut columns = [0.0; TILE];
            for (col, column) in (tile.col..).zip(&mut columns[..tile.cols]) {
                *column = self.of_col(pair, axis, col);
            }
            for (row, places) in (tile.row..).zip(places.chunks_exact_mut(tile.cols)) {
                let start = self.of_row(pair, axis, row);
                for (place, column) in places.iter_mut().zip(&columns) {
                    *place = start + column;
                }
            }
        }
        out.range = self.range(pair, tile);
    }

    pub(super) fn range(&self, pair: &Pair, tile: TargetTile) -> [f64; 4] {
        let ends = |first: i64, count: usize| [first, first + count as i64 - 1];
        let [[left, right], [top, bottom]] = [0, 1].map(|axis| {
            let sorted = |[one, other]: [f64; 2]| [one.min(other), one.max(other)];
            let cols = ends(tile.col, tile.cols).map(|col| self.of_col(pair, axis, col));
            let rows = ends(tile.row, tile.rows).map(|row| self.of_row(pair, axis, row));
            let (cols, rows) = (sorted(cols), sorted(rows));
            [rows[0] + cols[0], rows[1] + cols[1]]
        });
        [left, right, top, bottom]
    }
}

/// Column and row of the pole.
fn pole(placement: &Placement, map: &PolarStereographic) -> [f64; 2] {
    let ([x, y], [pixel_x, pixel_y]) = (placement.origin, placement.pixel_size);
    [(map.false_easting.0 - x) / pixel_x - 0.5, (y - map.false_northing.0) / pixel_y - 0.5]
}

/// Map meters from the pole to the equator.
fn radius_of_equator(placement: &Placement, map: &PolarStereographic) -> Option<f64> {
    let equator = Geographic { longitude: map.central_meridian, ..Geographic::default() };
    let shown = placement.crs.project(equator)?;
    Some((shown.y - map.false_northing.0).abs())
}
