//! The polar stereographic projection of the sphere and of the ellipsoid.
//!
//! Everything is said in the colatitude θ, the angle from the pole at the center, because latitudes
//! near 90° have no digits left where this projection is used most. With the half-angle tangent
//! τ = tan(θ/2) and the eccentricity e, Snyder's t and constant factor combine into
//!
//! ```text
//! ρ    = 2 k0 (a² / b) τ E(τ)
//! E(τ) = exp(-e artanh(2 e τ² / ((1 - e²) + (1 + e²) τ²)))
//! ```
//!
//! where `a² / b` is the radius of curvature at the pole. E is 1 there and everywhere on a sphere,
//! and nothing in it cancels: Snyder subtracts two logarithms that agree at the pole.
//!
//! # References
//!
//! J. P. Snyder, *Map Projections: A Working Manual*, USGS Professional Paper 1395, 1987,
//! section 21: polar aspects of the sphere and of the ellipsoid.

use std::f64::consts::FRAC_PI_2;

use super::{MapPoint, Pole};
use crate::body::Ellipsoid;
use crate::geodesy::Geographic;
use crate::units::{Meters, Radians};

/// Where a polar stereographic map is true to scale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PolarScale {
    /// The scale factor at the pole: 1 for a tangent plane, 0.994 for UPS.
    AtPole(f64),
    /// The standard parallel, in the hemisphere of the pole at the center whatever its sign.
    TrueAt(Radians),
}

/// The parameters of a polar stereographic projection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PolarStereographic {
    /// The pole at the center of the map.
    pub pole: Pole,
    /// The meridian that runs straight down from a north pole, straight up from a south pole.
    pub central_meridian: Radians,
    /// Where the map is true to scale.
    pub scale: PolarScale,
    /// x of the pole.
    pub false_easting: Meters,
    /// y of the pole.
    pub false_northing: Meters,
}

impl PolarStereographic {
    /// The map ends here, 10° short of the opposite pole, which is infinitely far away.
    ///
    /// The corners of a square map that reaches the equator lie at 109.5°; at the rim the scale is
    /// 132 times that of the center.
    pub const MAX_COLATITUDE: Radians = Radians(170.0 * (std::f64::consts::PI / 180.0));

    /// So far past the rim is the rim itself, lest rounding takes it away: radians.
    const RIM_SLACK: f64 = 1e-9;

    pub(super) fn project(&self, ellipsoid: &Ellipsoid, position: Geographic) -> Option<MapPoint> {
        let theta = self.colatitude(position.latitude)?;
        let tau = libm::tan(theta / 2.0);
        let rho = self.radius_at_pole(ellipsoid) * tau * conformal_factor(ellipsoid, tau);
        let (sine, cosine) = libm::sincos(position.longitude.0 - self.central_meridian.0);
        Some(MapPoint {
            x: rho * sine + self.false_easting.0,
            y: -self.pole.sign() * rho * cosine + self.false_northing.0,
        })
    }

    pub(super) fn unproject(&self, ellipsoid: &Ellipsoid, point: MapPoint) -> Option<Geographic> {
        let easting = point.x - self.false_easting.0;
        let southing = -self.pole.sign() * (point.y - self.false_northing.0);
        let rho = libm::hypot(easting, southing);
        let theta = 2.0 * libm::atan(half_tangent(ellipsoid, rho / self.radius_at_pole(ellipsoid)));
        let theta = Self::within_rim(theta)?;

        // At the pole the central meridian is as good as any; atan2 would tell 0 from -0.
        let turn = if rho == 0.0 { 0.0 } else { libm::atan2(easting, southing) };
        Some(Geographic {
            longitude: Radians(self.central_meridian.0 + turn).wrapped(),
            latitude: Radians(self.pole.sign() * (FRAC_PI_2 - theta)),
        })
    }

    /// The angle from the pole at the center, or `None` past the rim.
    pub(super) fn colatitude(&self, latitude: Radians) -> Option<f64> {
        Self::within_rim(FRAC_PI_2 - self.pole.sign() * latitude.0)
    }

    /// A colatitude of the map, brought back onto the rim it misses by rounding.
    fn within_rim(theta: f64) -> Option<f64> {
        let on_map = (0.0..=Self::MAX_COLATITUDE.0 + Self::RIM_SLACK).contains(&theta);
        on_map.then(|| theta.min(Self::MAX_COLATITUDE.0))
    }

    /// Map meters from the pole to a unit sine of the colatitude, ρ / sin θ: finite at the pole.
    pub(super) fn radius_per_sine(&self, ellipsoid: &Ellipsoid, theta: f64) -> f64 {
        let tau = libm::tan(theta / 2.0);
        // sin θ = 2 τ / (1 + τ²), so that τ itself drops out.
        let half = 0.5 * self.radius_at_pole(ellipsoid) * (1.0 + tau * tau);
        half * conformal_factor(ellipsoid, tau)
    }

    /// 2 k0 a² / b: map meters to a unit of τ, next to the pole.
    pub(crate) fn radius_at_pole(&self, ellipsoid: &Ellipsoid) -> f64 {
        let (a, b) = (ellipsoid.a().0, ellipsoid.b().0);
        2.0 * a * (a / b) * self.scale_at_pole(ellipsoid)
    }

    /// k0. A standard parallel at θ has ρ = a sin θ / w with w² = 1 - e² cos² θ, hence
    /// k0 = (b / a) cos²(θ/2) / (w E(τ)).
    fn scale_at_pole(&self, ellipsoid: &Ellipsoid) -> f64 {
        match self.scale {
            PolarScale::AtPole(scale) => scale,
            PolarScale::TrueAt(parallel) => {
                let theta = FRAC_PI_2 - parallel.0.abs();
                let (tau, cosine) = (libm::tan(theta / 2.0), libm::cos(theta));
                let w = (1.0 - ellipsoid.eccentricity_squared() * cosine * cosine).sqrt();
                let flattened = ellipsoid.b().0 / ellipsoid.a().0;
                flattened / ((1.0 + tau * tau) * w * conformal_factor(ellipsoid, tau))
            }
        }
    }
}

/// E(τ): how far the ellipsoid pulls a parallel toward the pole, 1 on a sphere.
fn conformal_factor(ellipsoid: &Ellipsoid, tau: f64) -> f64 {
    if ellipsoid.is_sphere() {
        return 1.0;
    }
    libm::exp(-conformal_exponent(ellipsoid.eccentricity_squared(), tau))
}

/// -ln E(τ), which grows from 0 at the pole to 2 e artanh e at the other.
fn conformal_exponent(e2: f64, tau: f64) -> f64 {
    let (e, tau2) = (e2.sqrt(), tau * tau);
    e * libm::atanh(2.0 * e * tau2 / ((1.0 - e2) + (1.0 + e2) * tau2))
}

/// The τ with τ E(τ) = `r`.
///
/// Newton's method for w = ln(τ / r), the root of `w + ln E(r exp w)`. Its slope is the ratio of
/// the radii of curvature, `(1 - e²) / (1 - e² cos² θ)`, which falls to the equator and rises past
/// it: a step may pass the root once, and from that side none does, however flat the ellipsoid.
/// Two or three steps reach the last bits on the planets. (Snyder iterates the latitude without a
/// slope, which gains a factor of e² a step.)
fn half_tangent(ellipsoid: &Ellipsoid, r: f64) -> f64 {
    const MOST_STEPS: u32 = 50;
    // After a step this small the error, its square, is below rounding.
    const LAST_STEP: f64 = 1e-9;

    if ellipsoid.is_sphere() || r == 0.0 || !r.is_finite() {
        return r;
    }
    let e2 = ellipsoid.eccentricity_squared();
    let mut w = conformal_exponent(e2, r);
    for _ in 0..MOST_STEPS {
        let tau = r * libm::exp(w);
        let cosine = (1.0 - tau * tau) / (1.0 + tau * tau);
        let slope = (1.0 - e2) / (1.0 - e2 * cosine * cosine);
        let step = (conformal_exponent(e2, tau) - w) / slope;
        w += step;
        if step.abs() <= LAST_STEP {
            break;
        }
    }
    r * libm::exp(w)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        /// Also on pancakes, where steps pass the root.
        #[test]
        fn the_half_tangent_is_found_on_any_ellipsoid(
            ratio in -1.0..0.0, exponent in -12.0..1.2,
        ) {
            let b = Meters(10f64.powf(ratio));
            let ellipsoid = Ellipsoid::new(Meters(1.0), b).unwrap();
            let tau = 10f64.powf(exponent);
            let found = half_tangent(&ellipsoid, tau * conformal_factor(&ellipsoid, tau));
            // artanh near 1 is worth (a / b)² rounding errors, and the slope's end as many again.
            let tolerance = 2e-15 / ellipsoid.b().0.powi(4);
            prop_assert!((found / tau - 1.0).abs() <= tolerance, "{ellipsoid} {tau} {found}");
        }
    }

    #[test]
    fn the_half_tangent_has_its_last_bits_on_the_planets() {
        for ratio in [1.0 - 1.0 / 298.257, 0.994] {
            let ellipsoid = Ellipsoid::new(Meters(1.0), Meters(ratio)).unwrap();
            for tau in [1e-9, 0.01, 0.3, 1.0, 3.0, 11.0] {
                let found = half_tangent(&ellipsoid, tau * conformal_factor(&ellipsoid, tau));
                assert!((found / tau - 1.0).abs() <= 1e-15, "{tau} {found}");
            }
        }
    }
}
