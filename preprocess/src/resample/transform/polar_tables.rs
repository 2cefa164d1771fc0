//! A polar source seen from a map of straight meridians: the radius is a row's, the direction a
//! column's.
//!
//! ```text
//! u = u_pole + ρ(row) sin λ(col)        v = v_pole ± ρ(row) cos λ(col)
//! ```
//!
//! Rows past a pole, seen half a turn away, have the same radius with the other sign.
//!
//! # Precision
//!
//! Exact: two rounding errors of ρ more than the tables'.

use areoid_formats::geodesy::Geographic;
use areoid_formats::lanes::{Wide, vectorized};
use areoid_formats::projection::PolarStereographic;

use super::exact::Pair;
use crate::resample::tile::{Coords, TargetTile};

/// Tables of directions and radii.
#[derive(Debug)]
pub(super) struct PolarTables {
    /// The source's column and row of the pole.
    pole: [f64; 2],
    /// By column of the target from -1 on: sines and cosines of the direction, so scaled that a
    /// radius in columns makes columns and rows.
    sines: Vec<f64>,
    cosines: Vec<f64>,
    /// By row of the target from -1 on: the radius in columns of the source.
    radii: Vec<f64>,
}

impl PolarTables {
    pub(super) fn new(pair: &Pair, map: &PolarStereographic) -> Self {
        let (target, source) = (&pair.target, &pair.source);
        let [pixel_x, pixel_y] = source.pixel_size;
        let pole = [
            (map.false_easting.0 - source.origin[0]) / pixel_x - 0.5,
            (source.origin[1] - map.false_northing.0) / pixel_y - 0.5,
        ];

        let equator_row = pair.equator_row();
        let direction = |col: i64| {
            let longitude = pair.position(equator_row, pair.extended_col(col) as f64)?.longitude;
            Some(libm::sincos(longitude.0 - map.central_meridian.0))
        };
        let directions =
            (-1..=i64::from(target.width)).map(|col| direction(col).unwrap_or_default());
        // Southward from a north pole is down the rows.
        let rows_per_col = map.pole.sign() * pixel_x / pixel_y;
        let (sines, cosines) =
            directions.map(|(sine, cosine)| (sine, cosine * rows_per_col)).unzip();

        // Past the end of the map: far outside, but finite.
        let nowhere = 4.0
            * (pole[0].abs() + pole[1].abs() + f64::from(source.width) + f64::from(source.height))
            * (pixel_y / pixel_x).max(1.0);
        let radius = |row: i64| {
            let (row, turned) = pair.extended_row(row);
            let latitude = pair.position(row as f64, 0.0)?.latitude;
            let below = Geographic { longitude: map.central_meridian, latitude };
            let shown = source.crs.project(below)?;
            let radius = (shown.y - map.false_northing.0).abs() / pixel_x;
            Some(if turned { -radius } else { radius })
        };
        let radii =
            (-1..=i64::from(target.height)).map(|row| radius(row).unwrap_or(nowhere)).collect();
        Self { pole, sines, cosines, radii }
    }

    /// Sines, cosines and radii of a tile.
    fn tables(&self, tile: TargetTile) -> (&[f64], &[f64], &[f64]) {
        let first = |index: i64| usize::try_from(index + 1).expect("rows and columns start at -1");
        let (row, col) = (first(tile.row), first(tile.col));
        let cols = col..col + tile.cols;
        (&self.sines[cols.clone()], &self.cosines[cols], &self.radii[row..row + tile.rows])
    }

    pub(super) fn fill(&self, tile: TargetTile, out: &mut Coords) {
        let (sines, cosines, radii) = self.tables(tile);
        let Coords { u, v, .. } = out;
        vectorized(Products { pole: self.pole, sines, cosines, radii, u, v });
        out.range = self.range(tile);
    }

    pub(super) fn range(&self, tile: TargetTile) -> [f64; 4] {
        let (sines, cosines, radii) = self.tables(tile);
        let radii = extremes(radii);
        let [left, right] = product(radii, extremes(sines));
        let [top, bottom] = product(radii, extremes(cosines));
        let [u, v] = self.pole;
        [u + left, u + right, v + top, v + bottom]
    }
}

fn extremes(values: &[f64]) -> [f64; 2] {
    let (least, most) = areoid_formats::lanes::extremes(values, (f64::INFINITY, f64::NEG_INFINITY));
    [least, most]
}

/// The least and greatest product of a number of each range.
fn product([a, b]: [f64; 2], [c, d]: [f64; 2]) -> [f64; 2] {
    extremes(&[a * c, a * d, b * c, b * d])
}

/// The positions of a tile.
struct Products<'a> {
    pole: [f64; 2],
    sines: &'a [f64],
    cosines: &'a [f64],
    radii: &'a [f64],
    u: &'a mut [f64],
    v: &'a mut [f64],
}

impl Wide for Products<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { pole, sines, cosines, radii, u, v } = self;
        let rows = u.chunks_exact_mut(sines.len()).zip(v.chunks_exact_mut(cosines.len()));
        for ((u, v), &radius) in rows.zip(radii) {
            for (u, &sine) in u.iter_mut().zip(sines) {
                *u = pole[0] + radius * sine;
            }
            for (v, &cosine) in v.iter_mut().zip(cosines) {
                *v = pole[1] + radius * cosine;
            }
        }
    }
}
