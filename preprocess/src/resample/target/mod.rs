//! The grid that sources are resampled to.
//!
//! ```text
//!   outlines of the sources ──▶ their rims on the target's map ──▶ whole pixels ──▶ even widths
//! ```
//!
//! Texels are as large as the finest source's pixels where its map is truest, or as asked, and
//! square. What goes around the body does so in a width that halves down to a pyramid's root, which
//! makes texels a little smaller. Edges on a pole are outlines: no texel's center lies there.

mod area;
mod split;
mod straight;

use std::f64::consts::TAU;

use areoid_formats::body::Ellipsoid;
use areoid_formats::grid::{Grid, GridError, Placement};
use areoid_formats::projection::{
    Crs, Equirectangular, PolarScale, PolarStereographic, Pole, Projection,
};
use areoid_formats::pyramid::{Extent, PoleContact};
use areoid_formats::units::{Meters, Radians};

use self::area::Area;
pub use self::split::{Split, split};
use self::straight::straight;

/// The map that texels lie on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TargetMap {
    /// The first source's.
    Native,
    /// Meridians and parallels as straight lines, to scale at the equator.
    Equirectangular,
    /// A hemisphere about a pole, to scale there.
    Polar(Pole),
}

/// What is asked of a target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetRequest {
    /// Its map.
    pub map: TargetMap,
    /// Ground meters to a texel where the map is truest; the finest source's if `None`.
    pub pixel_size: Option<Meters>,
    /// Texels along a page's side, border included.
    pub page_side: u32,
}

/// Why there is no target.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum TargetError {
    /// No source.
    #[error("no raster to resample")]
    Empty,
    /// A size that texels cannot have.
    #[error("a texel of {0} m is not supported: expected a positive number")]
    PixelSize(f64),
    /// More texels in a row or column than a grid can have.
    #[error("{texels:e} texels in a row or column are too many: {} are the most", u32::MAX)]
    TooFine {
        /// How many there would be.
        texels: f64,
    },
    /// Sources that have no place on the map.
    #[error("the rasters show nothing of the hemisphere of the map")]
    NothingShown,
    /// A raster that cannot be split into a band and caps.
    #[error(
        "only a whole globe of straight meridians can be split into a band and two polar caps: \
         the raster {0}"
    )]
    NotAGlobe(&'static str),
    /// A globe of so few rows that its band would be all of it.
    #[error("a globe of {found} rows is too small to be split: about {least} are the least")]
    TooFewRows {
        /// Its rows.
        found: u32,
        /// About the least that can be split.
        least: u32,
    },
    /// The size makes no pyramid.
    #[error(transparent)]
    Grid(#[from] GridError),
}

/// Widths and heights a whole number of pixels to this accuracy are that number.
const ROUNDING_PX: f64 = 1e-6;

/// The grid for `sources` that `request` asks for.
///
/// # Errors
///
/// Any [`TargetError`].
pub fn target_grid(sources: &[Placement], request: TargetRequest) -> Result<Grid, TargetError> {
    let first = sources.first().ok_or(TargetError::Empty)?;
    let body = first.crs.body;
    let finest =
        sources.iter().map(|source| source.nominal_pixel().0).fold(f64::INFINITY, f64::min);
    let pixel_m = request.pixel_size.map_or(finest, |size| size.0);
    if !(pixel_m > 0.0 && pixel_m.is_finite()) {
        return Err(TargetError::PixelSize(pixel_m));
    }
    let crs = match request.map {
        TargetMap::Native if request.pixel_size.is_none() && sources.len() == 1 => {
            let Placement { crs, origin, pixel_size, .. } = *first;
            return Ok(Grid::new(crs, origin, pixel_size, first.extent(), request.page_side)?);
        }
        TargetMap::Native => first.crs,
        TargetMap::Equirectangular => {
            Crs::new(Projection::Equirectangular(Equirectangular::default()), body)
        }
        TargetMap::Polar(pole) => polar(pole, body),
    };

    let mut area = Area::NONE;
    for source in sources {
        area = area.with(Area::of(source, &crs));
    }
    if area.is_empty() {
        return Err(TargetError::NothingShown);
    }
    match crs.wraps_with_period() {
        Some(period) => {
            let pixel = pixel_m * period / (TAU * crs.ellipsoid.a().0);
            straight(crs, area, pixel, period, request.page_side)
        }
        None => flat(crs, area, pixel_m, request.page_side),
    }
}

/// The map about a pole, to scale there.
fn polar(pole: Pole, body: Ellipsoid) -> Crs {
    let map = PolarStereographic {
        pole,
        central_meridian: Radians(0.0),
        scale: PolarScale::AtPole(1.0),
        false_easting: Meters(0.0),
        false_northing: Meters(0.0),
    };
    Crs::new(Projection::PolarStereographic(map), body)
}

/// A grid on a map that does not go around the body.
fn flat(crs: Crs, area: Area, pixel: f64, page_side: u32) -> Result<Grid, TargetError> {
    let left = (area.left / pixel + ROUNDING_PX).floor() * pixel;
    let top = (area.top / pixel - ROUNDING_PX).ceil() * pixel;
    let extent = Extent {
        width: whole((area.right - left) / pixel)?,
        height: whole((top - area.bottom) / pixel)?,
        wraps: false,
        north: PoleContact::None,
        south: PoleContact::None,
    };
    Ok(Grid::new(crs, [left, top], [pixel; 2], extent, page_side)?)
}

/// A number of pixels rounded up, at least 1.
fn whole(pixels: f64) -> Result<u32, TargetError> {
    let up = (pixels - ROUNDING_PX).ceil().max(1.0);
    if up.is_nan() || up > f64::from(u32::MAX) {
        return Err(TargetError::TooFine { texels: pixels });
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "in range")]
    Ok(up as u32)
}

#[cfg(test)]
mod tests;
