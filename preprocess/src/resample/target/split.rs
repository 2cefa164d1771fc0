//! The grids that a globe is split into: a band around the equator and a cap about each pole.
//!
//! ```text
//!    row 0      +--------------------------------+  north pole
//!               |           north cap            |
//!    rows.start |  ..............................|  the band's outline
//!    seam, 60°  |  ------------------------------|  both parts cover wholly
//!               |  ......................._______|  the cap's outline
//!               |             band               |
//! ```
//!
//! # Overlap
//!
//! Coverage is full [`HALO`] texels inside an outline, and rises over those between. Each part
//! reaches so many of its own texels past the seam: there both cover wholly, and the rim in which
//! one's coverage rises lies wholly inside the other. [`HALO`] rows of the band and 0.62 · [`HALO`]
//! rows' worth of the cap are there twice at each seam, and what a square has in its corners.
//!
//! # Pixels
//!
//! The band's are the raster's. Those of a cap are ⅔ of a row at the pole and shrink on the ground
//! by (1 + sin 60°) / 2 to 0.62 of one at the seam.
//!
//! Where its columns crowd at a pole the raster's own surface errs along its rows' height alone, by
//! h²/√120 of the second derivative in the root mean square. A square pixel errs along both axes: by
//! 1.6 times as much where texels are values at their centers, and by 1/√3 times as much where they are
//! fitted ([`super::super::Texels`]). Along a scarp on a meridian the raster has next to no error, and a
//! cap has as much as anywhere: what pixels are smaller than a row is for that. Of heights of Mars at
//! 8 pixels a degree, held against every second pixel of maps of 4 km in places of 2 by 30 degrees, and
//! against `demo/mars/truth_points.csv` from 75 to 85 degrees in meters,
//!
//! ```text
//!                                 raster   ⅔, sampled   ¾, fitted   ⅔, fitted
//!   worst place over the raster's            1.81          0.85        0.69
//!   root mean square                7.41     4.96          2.43        2.06
//! ```

use std::f64::consts::FRAC_PI_2;
use std::ops::Range;

use areoid_formats::geodesy::Geographic;
use areoid_formats::grid::{Grid, GridError, Placement};
use areoid_formats::projection::{Crs, Pole};
use areoid_formats::pyramid::{Extent, PoleContact};
use areoid_formats::units::Radians;

use super::{ROUNDING_PX, TargetError, polar, whole};
use crate::feather::HALO;

/// Where the parts meet, north and south.
const SEAM: Radians = Radians(std::f64::consts::FRAC_PI_3);

/// Pixels of a cap, in rows of the raster at the pole.
const CAP_PIXEL_ROWS: f64 = 2.0 / 3.0;

/// What a globe is split into.
#[derive(Clone, Debug, PartialEq)]
pub struct Split {
    /// The rows of the globe that make the band.
    pub rows: Range<u32>,
    /// The grid of the cap about the north pole.
    pub north: Grid,
    /// The grid of the cap about the south pole.
    pub south: Grid,
}

/// Splits the globe at `source`, in pages of `page_side` texels.
///
/// # Errors
///
/// [`TargetError::NotAGlobe`], [`TargetError::TooFewRows`], or [`TargetError::Grid`].
pub fn split(source: &Placement, page_side: u32) -> Result<Split, TargetError> {
    let refused = |what| Err(TargetError::NotAGlobe(what));
    if source.crs.wraps_with_period().is_none() {
        return refused("lies on another map");
    }
    if !source.wraps {
        return refused("does not go all around");
    }
    for (contact, what) in [
        (source.north, "does not reach the north pole"),
        (source.south, "does not reach the south pole"),
    ] {
        if contact == PoleContact::None {
            return refused(what);
        }
    }
    let start = (row_of_seam(source, Pole::North)? + ROUNDING_PX).floor() - f64::from(HALO);
    let end = (row_of_seam(source, Pole::South)? - ROUNDING_PX).ceil() + f64::from(HALO);
    let found = source.height;
    if start < 1.0 || end > f64::from(found) - 1.0 {
        // A sixth of the rows must be more than reach past the seam.
        return Err(TargetError::TooFewRows { found, least: 6 * (HALO + 1) });
    }
    Ok(Split {
        rows: whole(start)?..whole(end)?,
        north: cap(source, Pole::North, page_side)?,
        south: cap(source, Pole::South, page_side)?,
    })
}

/// Rows from the top edge to a seam.
fn row_of_seam(source: &Placement, pole: Pole) -> Result<f64, TargetError> {
    let latitude = Radians(pole.sign() * SEAM.0);
    let point = source.crs.project(Geographic { latitude, ..Geographic::default() });
    let point = point.ok_or(GridError::OutsideProjection)?;
    Ok((source.origin[1] - point.y) / source.pixel_size[1])
}

/// The square about a pole that reaches [`HALO`] texels past the seam, the pole on a corner of four
/// texels.
fn cap(source: &Placement, pole: Pole, page_side: u32) -> Result<Grid, TargetError> {
    let crs = polar(pole, source.crs.body);
    let pixel = CAP_PIXEL_ROWS * row_at_pole(source, &crs, pole)?;
    let latitude = Radians(pole.sign() * SEAM.0);
    let half = whole(distance(&crs, latitude)? / pixel)?.saturating_add(HALO);
    let edge = f64::from(half) * pixel;
    let side = half.saturating_mul(2);
    let (north, south) = (PoleContact::None, PoleContact::None);
    let extent = Extent { width: side, height: side, wraps: false, north, south };
    Ok(Grid::new(crs, [-edge, edge], [pixel; 2], extent, page_side)?)
}

/// How high the raster's last row is at a pole, in the map units of `crs`, which are ground meters
/// there.
fn row_at_pole(source: &Placement, crs: &Crs, pole: Pole) -> Result<f64, TargetError> {
    let y = source.crs.y_of_pole(pole).ok_or(GridError::OutsideProjection)?;
    let pixel = source.pixel_size[1];
    let mut point = source.map_from_pixel(0.0, 0.0);
    point.y = y - pole.sign() * pixel;
    let shown = source.crs.unproject(point).ok_or(GridError::OutsideProjection)?;
    distance(crs, shown.latitude)
}

/// How far a parallel is from the pole on its map.
fn distance(crs: &Crs, latitude: Radians) -> Result<f64, TargetError> {
    debug_assert!(latitude.0.abs() <= FRAC_PI_2);
    let point = crs.project(Geographic { latitude, ..Geographic::default() });
    let point = point.ok_or(GridError::OutsideProjection)?;
    Ok(libm::hypot(point.x, point.y))
}
