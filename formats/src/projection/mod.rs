//! Map projections: from a body's surface to the plane of a raster, and back.
//!
//! ```text
//!  planetographic          the map's own latitude          map point
//!  on the body      ──────▶  graphic or centric   ──────▶   x, y
//!             LatitudeKind, body          Projection, ellipsoid
//! ```
//!
//! Three projections are enough for planetary rasters: geographic and equirectangular for the
//! globe, polar stereographic for the caps. A [`Crs`] puts one of them on an ellipsoid, says what
//! its latitudes mean, and reads and writes itself as a PROJ string.
//!
//! # Conventions
//!
//! Map units are meters, or degrees for [`Projection::Geographic`]; x grows east at the center of
//! the map and y grows north. Coordinates are carried over unchanged between surfaces of one body:
//! there are no datum shifts.

mod crs;
mod equirectangular;
mod ground;
mod parameters;
mod polar_stereographic;
mod proj_string;

pub use crs::Crs;
pub use equirectangular::Equirectangular;
pub use parameters::CrsError;
pub use polar_stereographic::{PolarScale, PolarStereographic};

/// A point in the plane of a map.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MapPoint {
    /// Easting in meters, or longitude in degrees for [`Projection::Geographic`].
    pub x: f64,
    /// Northing in meters, or latitude in degrees for [`Projection::Geographic`].
    pub y: f64,
}

/// One end of the axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Pole {
    /// Latitude +90°.
    North,
    /// Latitude -90°.
    South,
}

impl Pole {
    /// +1 for the north pole and -1 for the south, so that one formula serves both.
    #[must_use]
    pub const fn sign(self) -> f64 {
        match self {
            Self::North => 1.0,
            Self::South => -1.0,
        }
    }
}

/// A way to draw longitude and latitude in a plane, apart from the ellipsoid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Projection {
    /// x is the longitude and y the latitude, in degrees.
    Geographic,
    /// Meridians and parallels as equidistant straight lines, in meters.
    Equirectangular(Equirectangular),
    /// A conformal map about a pole, in meters.
    PolarStereographic(PolarStereographic),
}
