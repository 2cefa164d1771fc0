//! The equirectangular projection: x is longitude and y latitude, to scale.
//!
//! ```text
//! x = a (λ - λ0) cos φts + x0
//! y = a (φ - φ0) + y0
//! ```
//!
//! The same formulas serve the ellipsoid, with its equatorial radius for `a`: the projection is
//! then a relabelled plate carrée and no longer equidistant along meridians. That is what planetary
//! products mean by it, and what keeps it separable.
//!
//! # References
//!
//! J. P. Snyder, *Map Projections: A Working Manual*, USGS Professional Paper 1395, 1987,
//! section 12.

use std::f64::consts::{FRAC_PI_2, TAU};

use super::{MapPoint, Pole};
use crate::body::Ellipsoid;
use crate::geodesy::{Geographic, sin_cos_of_latitude};
use crate::units::{Meters, Radians};

/// The parameters of an equirectangular projection.
///
/// The standard parallel is less than a right angle from the equator, or there is no width to draw
/// on and nothing projects.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Equirectangular {
    /// The meridian at the false easting: λ0.
    pub central_meridian: Radians,
    /// The parallel along which x is to scale: φts.
    pub standard_parallel: Radians,
    /// The parallel at the false northing: φ0.
    pub latitude_of_origin: Radians,
    /// x of the central meridian.
    pub false_easting: Meters,
    /// y of the latitude of origin.
    pub false_northing: Meters,
}

impl Equirectangular {
    /// Meters of x to a radian of longitude.
    pub(super) fn meters_per_radian_of_longitude(&self, ellipsoid: &Ellipsoid) -> f64 {
        ellipsoid.a().0 * sin_cos_of_latitude(self.standard_parallel).1
    }

    /// Longitudes are taken within half a turn of the central meridian, `[-π, π)`.
    pub(super) fn project(&self, ellipsoid: &Ellipsoid, position: Geographic) -> MapPoint {
        let longitude = Radians(position.longitude.0 - self.central_meridian.0).wrapped();
        let latitude = position.latitude.0 - self.latitude_of_origin.0;
        MapPoint {
            x: self.meters_per_radian_of_longitude(ellipsoid) * longitude.0 + self.false_easting.0,
            y: ellipsoid.a().0 * latitude + self.false_northing.0,
        }
    }

    /// The latitude may lie past a pole: the caller decides.
    pub(super) fn unproject(&self, ellipsoid: &Ellipsoid, point: MapPoint) -> Geographic {
        let easting = point.x - self.false_easting.0;
        let northing = point.y - self.false_northing.0;
        let longitude = easting / self.meters_per_radian_of_longitude(ellipsoid);
        Geographic {
            longitude: Radians(longitude + self.central_meridian.0).wrapped(),
            latitude: Radians(northing / ellipsoid.a().0 + self.latitude_of_origin.0),
        }
    }

    /// Meters of x to one turn of longitude.
    pub(super) fn period(&self, ellipsoid: &Ellipsoid) -> f64 {
        TAU * self.meters_per_radian_of_longitude(ellipsoid)
    }

    /// y of a pole.
    pub(super) fn y_of_pole(&self, ellipsoid: &Ellipsoid, pole: Pole) -> f64 {
        let latitude = pole.sign() * FRAC_PI_2 - self.latitude_of_origin.0;
        ellipsoid.a().0 * latitude + self.false_northing.0
    }
}
