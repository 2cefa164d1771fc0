//! Where on a map the pixels of a raster lie, before anyone asks for levels.
//!
//! ```text
//!   outline, as written down ──▶ placement: turns, poles, repeated columns ──▶ grid, if it halves
//! ```
//!
//! A raster that is resampled needs no pyramid of its own; what its rows and columns mean at the
//! antimeridian and over a pole is found out here.

use crate::geodesy::Geographic;
use crate::projection::{Crs, MapPoint, Pole};
use crate::pyramid::{Extent, PoleContact, PyramidError};
use crate::units::{Meters, Radians};

/// A rectangle of pixels on a map, as a raster's georeferencing gives it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outline {
    /// Map coordinates of the outer corner of the first pixel, top left.
    pub origin: [f64; 2],
    /// Map units to a pixel, both positive: x grows with the column, y falls with the row.
    pub pixel_size: [f64; 2],
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// Why an outline makes no grid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GridError {
    /// Its size has no pyramid.
    #[error(transparent)]
    Pyramid(#[from] PyramidError),
    /// A pixel size that is not a positive number.
    #[error("a pixel of {0} x {1} map units is not supported: both must be positive numbers")]
    PixelSize(f64, f64),
    /// An origin that is not a number.
    #[error("an origin at {0}, {1} is not a place on a map")]
    Origin(f64, f64),
    /// Rows past a pole.
    #[error(
        "the rows reach {rows} rows past the {pole} pole: half a row is the most that makes sense"
    )]
    PastPole {
        /// Which pole.
        pole: &'static str,
        /// Rows past it.
        rows: f64,
    },
    /// More than one turn around the body.
    #[error("{turns} turns around the body in one row: one is the most")]
    ManyTurns {
        /// Turns.
        turns: f64,
    },
    /// An outline that lies outside what its projection can show.
    #[error("the outline leaves the domain of its projection")]
    OutsideProjection,
}

/// A raster's pixels on a map, with its turns and poles recognized and its numbers made exact.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Projection and body.
    pub crs: Crs,
    /// Map coordinates of the outer corner of the first pixel, top left.
    pub origin: [f64; 2],
    /// Map units to a pixel, both positive.
    pub pixel_size: [f64; 2],
    /// Pixels in a row, without a column that repeats the first.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Whether the rows close around the body.
    pub wraps: bool,
    /// How the top edge meets the north pole. Not `None` only if the rows close.
    pub north: PoleContact,
    /// How the bottom edge meets the south pole. Not `None` only if the rows close.
    pub south: PoleContact,
    /// Columns dropped at the right because they repeat the first: 0 or 1.
    pub dropped_columns: u32,
}

/// Outlines miss poles and full turns by so many pixels because their numbers were rounded when
/// they were written down.
const ROUNDING_PX: f64 = 0.05;

impl Placement {
    /// What an outline means on the map of `crs`.
    ///
    /// It recognizes rows that close around the body, a last column that repeats the first, and
    /// edges or posts on the poles. Numbers rounded when they were written down (within
    /// a twentieth of a pixel of a full turn or of both poles) are made exact.
    ///
    /// # Errors
    ///
    /// Any [`GridError`] but those of a pyramid.
    ///
    /// # Panics
    ///
    /// Never: a map that meets a pole draws it.
    pub fn from_outline(crs: Crs, outline: Outline) -> Result<Self, GridError> {
        let Outline { origin, pixel_size, mut width, height } = outline;
        let ([mut left, mut top], [mut pixel_x, mut pixel_y]) = (origin, pixel_size);
        if !(pixel_x > 0.0 && pixel_y > 0.0 && pixel_x.is_finite() && pixel_y.is_finite()) {
            return Err(GridError::PixelSize(pixel_x, pixel_y));
        }
        if !(left.is_finite() && top.is_finite()) {
            return Err(GridError::Origin(left, top));
        }

        let mut dropped_columns = 0;
        let mut wraps = false;
        if let Some(period) = crs.wraps_with_period() {
            let spare = f64::from(width) - period / pixel_x;
            if spare.abs() <= ROUNDING_PX {
                wraps = true;
            } else if (spare - 1.0).abs() <= ROUNDING_PX && width > 1 {
                wraps = true;
                dropped_columns = 1;
                width -= 1;
            } else if spare > 0.0 {
                let turns = f64::from(width) * pixel_x / period;
                return Err(GridError::ManyTurns { turns });
            }
            if wraps {
                // Texel centers stay put in the middle of the row.
                let exact = period / f64::from(width);
                left += f64::from(width) * (pixel_x - exact) / 2.0;
                pixel_x = exact;
            }
        }

        let past = |pole: Pole, edge: f64, outward: f64| {
            let rows = crs.y_of_pole(pole).map(|y| outward * (edge - y) / pixel_y);
            match rows {
                None => Ok(PoleContact::None),
                Some(rows) if rows < -ROUNDING_PX => Ok(PoleContact::None),
                Some(rows) if rows.abs() <= ROUNDING_PX => Ok(PoleContact::Outline),
                Some(rows) if (rows - 0.5).abs() <= ROUNDING_PX => Ok(PoleContact::Posts),
                Some(rows) if rows < 0.5 => Ok(PoleContact::None),
                Some(rows) => Err(GridError::PastPole { pole: pole_name(pole), rows }),
            }
        };
        let bottom = top - f64::from(height) * pixel_y;
        let (mut north, mut south) =
            (past(Pole::North, top, 1.0)?, past(Pole::South, bottom, -1.0)?);
        if north == south && north != PoleContact::None {
            let rows_between = match north {
                PoleContact::Posts => f64::from(height) - 1.0,
                _ => f64::from(height),
            };
            let y_of = |pole| crs.y_of_pole(pole).expect("a map with pole contact draws the pole");
            if rows_between > 0.0 {
                pixel_y = (y_of(Pole::North) - y_of(Pole::South)) / rows_between;
                let half_row = if north == PoleContact::Posts { pixel_y / 2.0 } else { 0.0 };
                top = y_of(Pole::North) + half_row;
            }
        }
        if !wraps {
            (north, south) = (PoleContact::None, PoleContact::None);
        }

        Ok(Self {
            crs,
            origin: [left, top],
            pixel_size: [pixel_x, pixel_y],
            width,
            height,
            wraps,
            north,
            south,
            dropped_columns,
        })
    }

    /// What decides the levels of a grid of these pixels.
    #[must_use]
    pub fn extent(&self) -> Extent {
        let Self { width, height, wraps, north, south, .. } = *self;
        Extent { width, height, wraps, north, south }
    }

    /// Pixels to one turn of longitude, for a map that goes around the body: the width, to
    /// rounding, if the rows close.
    #[must_use]
    pub fn period_px(&self) -> Option<f64> {
        if self.wraps {
            return Some(f64::from(self.width));
        }
        Some(self.crs.wraps_with_period()? / self.pixel_size[0])
    }

    /// Ground meters to a pixel where the map is truest.
    #[must_use]
    pub fn nominal_pixel(&self) -> Meters {
        nominal_pixel(&self.crs, self.pixel_size)
    }

    /// The place on the map of column `u` and row `v`, pixel centers at whole numbers.
    #[must_use]
    pub fn map_from_pixel(&self, u: f64, v: f64) -> MapPoint {
        MapPoint {
            x: self.origin[0] + (u + 0.5) * self.pixel_size[0],
            y: self.origin[1] - (v + 0.5) * self.pixel_size[1],
        }
    }

    /// The position shown at column `u` and row `v`, also where posts reach past a pole; `None`
    /// outside the domain of the projection.
    #[must_use]
    pub fn geographic_from_pixel(&self, u: f64, v: f64) -> Option<Geographic> {
        shown_at(&self.crs, self.map_from_pixel(u, v))
    }

    /// The column and row of a place on the map, pixel centers at whole numbers.
    ///
    /// On a map that goes around the body the turn is chosen in which the column is nearest the
    /// middle of the raster.
    #[must_use]
    pub fn pixel_from_map(&self, point: MapPoint) -> (f64, f64) {
        let u = (point.x - self.origin[0]) / self.pixel_size[0] - 0.5;
        let v = (self.origin[1] - point.y) / self.pixel_size[1] - 0.5;
        (self.nearest_turn(u), v)
    }

    /// Column `u`, whole turns away from where it is farther than half a turn from the middle of
    /// the raster; itself on a map that does not go around.
    #[must_use]
    pub fn nearest_turn(&self, u: f64) -> f64 {
        let Some(period) = self.period_px() else { return u };
        let middle = (f64::from(self.width) - 1.0) / 2.0;
        u - period * ((u - middle) / period).round()
    }
}

/// The position shown at a place on the map of `crs`: past a pole, half a turn away.
pub(crate) fn shown_at(crs: &Crs, MapPoint { x, y }: MapPoint) -> Option<Geographic> {
    for pole in [Pole::North, Pole::South] {
        let Some(y_of_pole) = crs.y_of_pole(pole) else { continue };
        if pole.sign() * (y - y_of_pole) > 0.0 {
            let near = crs.unproject(MapPoint { x, y: 2.0 * y_of_pole - y })?;
            let longitude = Radians(near.longitude.0 + std::f64::consts::PI).wrapped();
            return Some(Geographic { longitude, ..near });
        }
    }
    crs.unproject(MapPoint { x, y })
}

/// Ground meters to the shorter side of a pixel where the map of `crs` is truest.
pub(crate) fn nominal_pixel(crs: &Crs, pixel_size: [f64; 2]) -> Meters {
    let per_unit = match crs.wraps_with_period() {
        Some(period) => std::f64::consts::TAU * crs.ellipsoid.a().0 / period,
        None => 1.0,
    };
    Meters(pixel_size[1].min(pixel_size[0]) * per_unit)
}

fn pole_name(pole: Pole) -> &'static str {
    match pole {
        Pole::North => "north",
        Pole::South => "south",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::Body;
    use crate::projection::Projection;
    use proptest::prelude::*;

    fn degrees(origin: [f64; 2], pixel: f64, width: u32, height: u32) -> Placement {
        let crs = Crs::new(Projection::Geographic, Body::parse("mars").unwrap().ellipsoid);
        Placement::from_outline(crs, Outline { origin, pixel_size: [pixel; 2], width, height })
            .unwrap()
    }

    #[test]
    fn a_globe_that_does_not_halve_is_placed_all_the_same() {
        let globe = degrees([-180.0, 90.0], 360.0 / 106_694.0, 106_694, 53_347);
        assert!(globe.wraps);
        assert_eq!((globe.north, globe.south), (PoleContact::Outline, PoleContact::Outline));
    }

    #[test]
    fn a_turn_is_as_wide_as_a_raster_that_closes() {
        assert_eq!(degrees([-0.5, 90.5], 1.0, 361, 181).period_px(), Some(360.0));
        assert_eq!(degrees([350.0, 20.0], 0.5, 20, 10).period_px(), Some(720.0));
    }

    proptest! {
        #[test]
        fn pixels_are_found_where_they_are_shown(
            left in -180.0..360.0, width in 1_u32..3600, u in 0.0..1.0, v in 0.0..100.0,
            turns in -2..=2,
        ) {
            let region = degrees([left, 20.0], 0.1, width, 100);
            let u = u * f64::from(width) - 0.5;
            let mut shown = region.map_from_pixel(u, v);
            shown.x += 360.0 * f64::from(turns);
            let found = region.pixel_from_map(shown);
            // At the very end of a whole turn its other end is as near.
            let off = (found.0 - u).rem_euclid(3600.0);
            prop_assert!(off.min(3600.0 - off) < 1e-9 && (found.1 - v).abs() < 1e-9, "{found:?}");
            prop_assert!(width == 3600 || (found.0 - u).abs() < 1e-9, "{found:?}");
        }
    }
}
