//! A projection on an ellipsoid, and how its latitudes relate to the body.

use std::f64::consts::FRAC_PI_2;

use super::{MapPoint, Pole, Projection};
use crate::body::Ellipsoid;
use crate::geodesy::{Geographic, LatitudeKind};
use crate::units::{Degrees, Radians};

/// A coordinate reference system: what a point of a raster's plane means on the body.
///
/// It serialises as `{proj, latitudes, body: {a, b}}`, with the projection and its ellipsoid as a
/// PROJ string, and reads back equal to the last bit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crs {
    /// How longitude and latitude become x and y.
    pub projection: Projection,
    /// The surface that the projection's formulas are evaluated on.
    pub ellipsoid: Ellipsoid,
    /// What the map's latitudes mean on the body.
    pub latitudes: LatitudeKind,
    /// The surface that positions are given on; it differs from `ellipsoid` where a map made on a
    /// sphere shows an ellipsoidal body.
    pub body: Ellipsoid,
}

/// Latitudes so far past a pole are the pole's own, in radians: rows computed from an origin and a
/// pixel size miss it by rounding. It is the precision that the projections promise.
const POLE_SLACK: f64 = 1e-9;

/// `latitude` brought back onto the pole it misses by rounding, or `None` past it.
fn latitude_in_domain(latitude: Radians) -> Option<Radians> {
    let in_domain = latitude.0.abs() <= FRAC_PI_2 + POLE_SLACK;
    in_domain.then(|| Radians(latitude.0.clamp(-FRAC_PI_2, FRAC_PI_2)))
}

impl Crs {
    /// `projection` on `ellipsoid`, for a body of that surface.
    #[must_use]
    pub const fn new(projection: Projection, ellipsoid: Ellipsoid) -> Self {
        Self { projection, ellipsoid, latitudes: LatitudeKind::Planetographic, body: ellipsoid }
    }

    /// The same map, of a `body` on which its latitudes mean `latitudes`.
    #[must_use]
    pub const fn on_body(self, body: Ellipsoid, latitudes: LatitudeKind) -> Self {
        Self { latitudes, body, ..self }
    }

    /// Whether the map's latitudes differ from the body's planetographic ones.
    pub(super) fn converts_latitudes(&self) -> bool {
        self.latitudes == LatitudeKind::Planetocentric && !self.body.is_sphere()
    }

    /// Planetographic on the body to the map's own latitude; exact at poles and equator.
    pub(super) fn map_latitude(&self, latitude: Radians) -> Option<Radians> {
        let latitude = latitude_in_domain(latitude)?;
        Some(if self.converts_latitudes() {
            self.body.planetocentric_from_planetographic(latitude)
        } else {
            latitude
        })
    }

    /// Where a planetographic position of the body lies on the map.
    ///
    /// # Domain
    ///
    /// Any longitude; x is within half a turn of the map's central meridian, its west end
    /// included. `None` past a pole by more than 10⁻⁹ radians, past
    /// [`MAX_COLATITUDE`](super::PolarStereographic::MAX_COLATITUDE) of a polar map, and where
    /// anything is not finite.
    ///
    /// # Precision
    ///
    /// 10⁻⁹ of the body's radius against PROJ, and there and back; in fact a few rounding errors.
    #[must_use]
    pub fn project(&self, position: Geographic) -> Option<MapPoint> {
        let position = Geographic { latitude: self.map_latitude(position.latitude)?, ..position };
        let point = match &self.projection {
            Projection::Geographic => MapPoint {
                x: wrapped_degrees(Degrees::from(position.longitude).0),
                y: Degrees::from(position.latitude).0,
            },
            Projection::Equirectangular(map) => map.project(&self.ellipsoid, position),
            Projection::PolarStereographic(map) => map.project(&self.ellipsoid, position)?,
        };
        (point.x.is_finite() && point.y.is_finite()).then_some(point)
    }

    /// The planetographic position shown at a point of the map, its longitude in `[-π, π)`.
    ///
    /// # Domain
    ///
    /// Any x of a map that wraps. `None` where [`Self::project`] has none.
    #[must_use]
    pub fn unproject(&self, point: MapPoint) -> Option<Geographic> {
        let shown = match &self.projection {
            Projection::Geographic => Geographic {
                longitude: Radians::from(Degrees(wrapped_degrees(point.x))).wrapped(),
                latitude: Degrees(point.y).into(),
            },
            Projection::Equirectangular(map) => map.unproject(&self.ellipsoid, point),
            Projection::PolarStereographic(map) => map.unproject(&self.ellipsoid, point)?,
        };
        let map_latitude = latitude_in_domain(shown.latitude)?;
        let latitude = if self.converts_latitudes() {
            self.body.planetographic_from_planetocentric(map_latitude)
        } else {
            map_latitude
        };
        shown.longitude.0.is_finite().then_some(Geographic { latitude, ..shown })
    }

    /// Map units of x to one turn of longitude, for a map that wraps.
    #[must_use]
    pub fn wraps_with_period(&self) -> Option<f64> {
        match &self.projection {
            Projection::Geographic => Some(360.0),
            Projection::Equirectangular(map) => Some(map.period(&self.ellipsoid)),
            Projection::PolarStereographic(_) => None,
        }
    }

    /// y of a pole, for a map that draws it as a line.
    #[must_use]
    pub fn y_of_pole(&self, pole: Pole) -> Option<f64> {
        match &self.projection {
            Projection::Geographic => Some(pole.sign() * 90.0),
            Projection::Equirectangular(map) => Some(map.y_of_pole(&self.ellipsoid, pole)),
            Projection::PolarStereographic(_) => None,
        }
    }
}

/// The same direction in `[-180, 180)`. Whole turns of degrees are exact where radians round.
fn wrapped_degrees(angle: f64) -> f64 {
    let wrapped = angle - 360.0 * ((angle + 180.0) / 360.0).floor();
    // The sum rounds: within an ulp of ±180 it may be one turn off.
    if wrapped < -180.0 {
        wrapped + 360.0
    } else if wrapped >= 180.0 {
        wrapped - 360.0
    } else {
        wrapped
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every float within three ulps of a multiple of 180.
    #[test]
    fn degrees_wrap_into_range_at_the_seam() {
        for halves in -8..=8 {
            let seam = f64::from(halves) * 180.0;
            let (mut below, mut above) = (seam, seam);
            for _ in 0..=3 {
                for angle in [below, above] {
                    let wrapped = wrapped_degrees(angle);
                    assert!((-180.0..180.0).contains(&wrapped), "{angle:?} -> {wrapped:?}");
                    let turns = (wrapped - angle) / 360.0;
                    assert!((turns - turns.round()).abs() < 1e-14, "{angle:?} -> {wrapped:?}");
                }
                (below, above) = (below.next_down(), above.next_up());
            }
        }
    }
}
