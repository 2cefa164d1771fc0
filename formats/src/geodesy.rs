//! Positions on and about a body: geographic, cartesian, and the normal between them.
//!
//! Cartesian coordinates are body-fixed meters from the center: x through (0°, 0°), y through
//! (90° E, 0°), z through the north pole. Heights are meters along the normal of the ellipsoid.
//!
//! # References
//!
//! * M. Heiskanen and H. Moritz, *Physical Geodesy*, 1967, chapter 5: geographic to cartesian.
//! * D. Eberly, *Distance from a Point to an Ellipse, an Ellipsoid, or a Hyperellipsoid*, 2013:
//!   the foot of the normal as the only root of a convex function.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::body::Ellipsoid;
use crate::units::{Degrees, Meters, Radians};

/// A direction of the surface normal: where on a body, without the height.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Geographic {
    /// East-positive longitude.
    pub longitude: Radians,
    /// Planetographic latitude: the angle of the surface normal above the equator.
    pub latitude: Radians,
}

/// What the latitudes of a map or a file mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LatitudeKind {
    /// The angle of the surface normal above the equator, geodetic on the Earth.
    #[default]
    Planetographic,
    /// The angle of the line to the body's center above the equator.
    Planetocentric,
}

impl Geographic {
    /// A position from degrees, as people write it.
    #[must_use]
    pub fn from_degrees(longitude: Degrees, latitude: Degrees) -> Self {
        Self { longitude: longitude.into(), latitude: latitude.into() }
    }
}

/// The sine and cosine of a latitude.
///
/// # Precision
///
/// Toward a pole the cosine is the sine of the colatitude, whose subtraction is exact, and not of
/// an angle that is itself rounded: ±[`FRAC_PI_2`] is the pole, with a cosine of exactly 0.
pub(crate) fn sin_cos_of_latitude(latitude: Radians) -> (f64, f64) {
    if latitude.0.abs() <= FRAC_PI_4 {
        return libm::sincos(latitude.0);
    }
    let (cosine, sine) = libm::sincos(FRAC_PI_2 - latitude.0.abs());
    (sine.copysign(latitude.0), cosine)
}

/// The unit normal of every ellipsoid at `position`: the direction of the zenith.
#[must_use]
pub fn surface_normal(position: Geographic) -> DVec3 {
    let (sin_latitude, cos_latitude) = sin_cos_of_latitude(position.latitude);
    let (sin_longitude, cos_longitude) = libm::sincos(position.longitude.0);
    DVec3::new(cos_latitude * cos_longitude, cos_latitude * sin_longitude, sin_latitude)
}

/// The position whose zenith points along `normal`, of any length but 0, with a longitude in
/// `[-π, π)`.
///
/// On the axis the longitude is 0.
#[must_use]
pub fn geographic_from_normal(normal: DVec3) -> Geographic {
    let distance_from_axis = libm::hypot(normal.x, normal.y);
    let longitude = if distance_from_axis == 0.0 { 0.0 } else { libm::atan2(normal.y, normal.x) };
    Geographic {
        longitude: Radians(longitude).wrapped(),
        latitude: Radians(libm::atan2(normal.z, distance_from_axis)),
    }
}

impl Ellipsoid {
    /// The radius of curvature across the meridian, N: the length of the normal down to the axis.
    pub(crate) fn prime_vertical_radius(&self, sin_latitude: f64) -> f64 {
        self.a().0 / (1.0 - self.eccentricity_squared() * sin_latitude * sin_latitude).sqrt()
    }

    /// The radius of curvature along the meridian, M.
    pub(crate) fn meridian_radius(&self, sin_latitude: f64) -> f64 {
        let e2 = self.eccentricity_squared();
        let w2 = 1.0 - e2 * sin_latitude * sin_latitude;
        self.a().0 * (1.0 - e2) / (w2 * w2.sqrt())
    }

    /// The body-fixed point `height` above `position`.
    ///
    /// # Precision
    ///
    /// A few rounding errors of the distance from the center; a pole lies on the axis exactly.
    #[must_use]
    pub fn cartesian_from_geographic(&self, position: Geographic, height: Meters) -> DVec3 {
        let normal = surface_normal(position);
        let n = self.prime_vertical_radius(normal.z);
        let flattened = (self.b().0 / self.a().0).powi(2);
        DVec3::new(
            (n + height.0) * normal.x,
            (n + height.0) * normal.y,
            (n * flattened + height.0) * normal.z,
        )
    }

    /// The position and height of a body-fixed point: the foot of its normal on the surface.
    ///
    /// # Domain
    ///
    /// Every finite point below 10¹² m. Where several normals meet in it (near the center, nearer
    /// than the centers of curvature) the answer is the nearest point of the surface; the plane of
    /// the equator belongs to the north there, and the center to the north pole.
    ///
    /// # Precision
    ///
    /// A few rounding errors of the radius or the distance from the center, whichever is larger.
    #[must_use]
    pub fn geographic_from_cartesian(&self, point: DVec3) -> (Geographic, Meters) {
        let (r, z) = (libm::hypot(point.x, point.y), point.z.abs());
        let (foot, normal) = self.foot_of_normal(r, z);
        let height = (r - foot.0) * normal.0 + (z - foot.1) * normal.1;

        let longitude = if r == 0.0 { 0.0 } else { libm::atan2(point.y, point.x) };
        let latitude =
            libm::atan2(normal.1, normal.0).copysign(if z == 0.0 { 1.0 } else { point.z });
        let position =
            Geographic { longitude: Radians(longitude).wrapped(), latitude: Radians(latitude) };
        (position, Meters(height))
    }

    /// The nearest point of the meridian's ellipse to (`r`, `z`), both at least 0, and the unit
    /// normal there.
    ///
    /// The foot is `(a² r / (t + a²), b² z / (t + b²))` for the only root `t > -b²` of
    ///
    /// ```text
    /// F(t) = (a r / (t + a²))² + (b z / (t + b²))² - 1
    /// ```
    ///
    /// F falls and is convex, so Newton's steps from any point left of the root rise to it and
    /// never pass it. Eberly bisects; the start below is near enough for three or four on the Earth.
    fn foot_of_normal(&self, r: f64, z: f64) -> ((f64, f64), (f64, f64)) {
        const MOST_STEPS: u32 = 200;
        // After a relative step this small the error, its square, is below rounding.
        const LAST_STEP: f64 = 1e-9;

        let (a, b) = (self.a().0, self.b().0);
        let (a2, b2) = (a * a, b * b);
        let distance = libm::hypot(r, z);

        // Unknown: s = t + b², which keeps its digits where t comes near -b². Each start makes F at
        // least 0: the first two by one term alone, the third because x / (t + x²) is least at an
        // end of [b, a].
        let focal2 = (a - b) * (a + b);
        let sphere_like = (a * distance - focal2).min(b * distance);
        let mut s = (b * z).max(a * r - focal2).max(sphere_like);
        if s <= 0.0 {
            // In the plane of the equator, nearer to the axis than the center of curvature.
            let foot_r = if focal2 > 0.0 { a2 * r / focal2 } else { 0.0 };
            let foot_z = b * (1.0 - (foot_r / a).powi(2)).max(0.0).sqrt();
            let (normal_r, normal_z) = (foot_r / a2, foot_z / b2);
            let length = libm::hypot(normal_r, normal_z);
            return ((foot_r, foot_z), (normal_r / length, normal_z / length));
        }
        for _ in 0..MOST_STEPS {
            let (u, v) = (a * r / (s + focal2), b * z / s);
            let f = (u - 1.0) * (u + 1.0) + v * v;
            let slope = 2.0 * (u * u / (s + focal2) + v * v / s);
            let step = f / slope;
            s += step;
            if step <= s * LAST_STEP {
                break;
            }
        }

        let (normal_r, normal_z) = (r / (s + focal2), z / s);
        let length = libm::hypot(normal_r, normal_z);
        let foot = (a2 * normal_r, b2 * normal_z);
        (foot, (normal_r / length, normal_z / length))
    }

    /// The angle above the equator of the line from the center to the surface at a planetographic
    /// latitude: `tan φc = (b / a)² tan φ`.
    ///
    /// # Precision
    ///
    /// Two rounding errors; equator and poles map to themselves exactly.
    #[must_use]
    pub fn planetocentric_from_planetographic(&self, latitude: Radians) -> Radians {
        if self.is_sphere() {
            return latitude;
        }
        let (sine, cosine) = sin_cos_of_latitude(latitude);
        let (a, b) = (self.a().0, self.b().0);
        Radians(libm::atan2(b * b * sine, a * a * cosine))
    }

    /// The angle of the surface's normal where the line from the center at a planetocentric
    /// latitude meets it: `tan φ = (a / b)² tan φc`.
    ///
    /// # Precision
    ///
    /// Two rounding errors; equator and poles map to themselves exactly.
    #[must_use]
    pub fn planetographic_from_planetocentric(&self, latitude: Radians) -> Radians {
        if self.is_sphere() {
            return latitude;
        }
        let (sine, cosine) = sin_cos_of_latitude(latitude);
        let (a, b) = (self.a().0, self.b().0);
        Radians(libm::atan2(a * a * sine, b * b * cosine))
    }
}
