//! An atmosphere that scatters light once, in f64: what `shader/atmosphere.wgsl` computes.
//!
//! ```text
//!            sun
//!             ↓  e^{-τ(sun)}
//!   eye ←── x ← scattered by molecules (Rayleigh) and by dust (Mie) ── ground
//!       e^{-τ(eye, x)}
//! ```
//!
//! Density falls off exponentially with the height above a sphere that touches the reference surface
//! under the eye. Along the ray the integral is a sum; toward the sun it is Chapman's function.
//!
//! # Units
//!
//! Meters, and per meter. Light is such that white ground square to the sun sends 1.
//!
//! # Precision
//!
//! Held against fine sums by the tests: optical depths toward the sun within 3 %, light within 3 %
//! of the brightest.
//!
//! # References
//!
//! * E. Bruneton and F. Neyret, "Precomputed Atmospheric Scattering", EGSR 2008: the model and the
//!   Earth's coefficients.
//! * F. Smith and C. Smith, "Numerical evaluation of Chapman's grazing incidence integral ch(X, χ)",
//!   Journal of Geophysical Research 77, 1972: the rational function for exp(y²) erfc(y).
//! * M. Tomasko et al., "Properties of dust in the Martian atmosphere from the Imager on Mars
//!   Pathfinder", JGR 104, 1999: the color of the dust.

use areoid_formats::body::Ellipsoid;
use glam::DVec3;

use crate::known_body::KnownBody;
use crate::mirror;

/// What air is made of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Atmosphere {
    /// Scattering by molecules at the reference surface, red, green and blue, per meter.
    pub rayleigh: [f64; 3],
    /// Over which the molecules thin out by e, meters.
    pub rayleigh_height_m: f64,
    /// Scattering by dust or haze at the reference surface, per meter.
    pub mie: [f64; 3],
    /// What dust takes from a ray, scattered or swallowed, per meter.
    pub mie_extinction: [f64; 3],
    /// Over which the dust thins out by e, meters.
    pub mie_height_m: f64,
    /// How far dust scatters forward, between -1 and 1.
    pub asymmetry: f64,
    /// Where nothing is left, meters above the reference surface.
    pub top_m: f64,
}

impl Atmosphere {
    /// Clear air with a little haze.
    pub const EARTH: Self = Self {
        rayleigh: [5.8e-6, 13.5e-6, 33.1e-6],
        rayleigh_height_m: 8000.0,
        mie: [4e-6; 3],
        mie_extinction: [4.44e-6; 3],
        mie_height_m: 1200.0,
        asymmetry: 0.8,
        top_m: 60_000.0,
    };

    /// Dust of an optical depth of 0.4, which swallows blue; molecules count for little.
    pub const MARS: Self = Self {
        rayleigh: [0.2e-7, 0.46e-7, 1.2e-7],
        rayleigh_height_m: 11_100.0,
        mie: [3.5e-5, 3.2e-5, 2.7e-5],
        mie_extinction: [3.6e-5; 3],
        mie_height_m: 11_100.0,
        asymmetry: 0.65,
        top_m: 90_000.0,
    };

    /// That of a body of this size, if one is known.
    #[must_use]
    pub fn of(body: &Ellipsoid) -> Option<Self> {
        KnownBody::of(body).map(|body| match body {
            KnownBody::Earth => Self::EARTH,
            KnownBody::Mars => Self::MARS,
        })
    }
}

/// Samples along a ray.
pub const STEPS: usize = 24;

/// The air about one eye.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Air {
    /// What it is made of.
    pub atmosphere: Atmosphere,
    /// Of the sphere, meters.
    pub radius_m: f64,
    /// Of the eye above it.
    pub eye_m: f64,
    /// From the sphere's center to the eye, a unit.
    pub up: DVec3,
    /// Toward the sun, a unit.
    pub sun: DVec3,
}

/// Light that comes along a ray, and how much of what is behind gets through.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scattered {
    /// Red, green and blue; 1 is white ground square to the sun.
    pub light: DVec3,
    /// 0 to 1.
    pub transmittance: DVec3,
}

impl Air {
    /// The air of a body about an eye, lit from the unit direction `sun`.
    #[must_use]
    pub fn new(body: &Ellipsoid, atmosphere: Atmosphere, eye: DVec3, sun: DVec3) -> Self {
        let (_, altitude) = body.geographic_from_cartesian(eye);
        let radius_m = eye.length() - altitude.0;
        Self { atmosphere, radius_m, eye_m: altitude.0, up: eye.normalize(), sun }
    }

    /// The constants for the shaders.
    #[expect(clippy::cast_possible_truncation, reason = "heights, factors and a direction")]
    pub(crate) fn mirrored(&self) -> mirror::Atmosphere {
        let air = &self.atmosphere;
        mirror::Atmosphere {
            rayleigh: air.rayleigh.map(|c| c as f32),
            rayleigh_height: air.rayleigh_height_m as f32,
            mie: air.mie.map(|c| c as f32),
            mie_height: air.mie_height_m as f32,
            mie_extinction: air.mie_extinction.map(|c| c as f32),
            asymmetry: air.asymmetry as f32,
            eye_up: self.up.as_vec3().to_array(),
            eye_height: self.eye_m as f32,
            radius: self.radius_m as f32,
            top: air.top_m as f32,
            _pad: [0; 2],
        }
    }

    /// Height above the sphere at a distance along a ray whose direction has `cosine` with up:
    /// √(a² + 2 a t cosine + t²) − R with a = R + h, without subtracting large numbers.
    pub(crate) fn height_m(&self, cosine: f64, t: f64) -> f64 {
        let (radius, eye) = (self.radius_m, self.eye_m);
        let above = eye * (2.0 * radius + eye) + t * (2.0 * (radius + eye) * cosine + t);
        above / ((radius * radius + above).max(0.0).sqrt() + radius)
    }

    /// Where a ray enters the air and leaves it, if it does.
    #[must_use]
    pub fn span(&self, cosine: f64) -> Option<(f64, f64)> {
        // With a = R + h: t² + 2 a cosine t + (a² − (R + top)²) = 0.
        let a = self.radius_m + self.eye_m;
        let rest = (self.eye_m - self.atmosphere.top_m)
            * (2.0 * self.radius_m + self.eye_m + self.atmosphere.top_m);
        let half = a * cosine;
        let root = (half * half - rest).max(0.0).sqrt();
        let (first, last) = (-half - root, -half + root);
        (half * half > rest && last > 0.0).then_some((first.max(0.0), last))
    }

    /// Meters of air of the ground's density from a height toward the sun, for a scale height.
    /// Below the horizon's rim it is night: no light comes.
    #[must_use]
    pub fn sunward_m(&self, height_m: f64, cosine: f64, scale_m: f64) -> f64 {
        let (x, h) = (self.radius_m / scale_m, height_m / scale_m);
        let upward = scale_m * chapman(x + h, cosine.abs()) * (-h).exp();
        if cosine >= 0.0 {
            return upward;
        }
        // The ray's lowest point above the ground.
        let lowest = (1.0 - cosine * cosine).max(0.0).sqrt() * (x + h) - x;
        if lowest < 0.0 {
            return f64::INFINITY;
        }
        2.0 * scale_m * chapman(x + lowest, 0.0) * (-lowest).exp() - upward
    }

    /// The share of sunlight that reaches a height where the sun has `cosine` with up.
    #[must_use]
    pub fn sunlight(&self, height_m: f64, cosine: f64) -> DVec3 {
        let air = &self.atmosphere;
        let molecules = self.sunward_m(height_m, cosine, air.rayleigh_height_m);
        let dust = self.sunward_m(height_m, cosine, air.mie_height_m);
        if molecules.is_infinite() || dust.is_infinite() {
            return DVec3::ZERO;
        }
        let rayleigh = DVec3::from_array(air.rayleigh);
        (-(rayleigh * molecules + DVec3::from_array(air.mie_extinction) * dust)).exp()
    }

    /// What comes along a ray of unit `direction` from as far as `end_m`, or from outside.
    #[must_use]
    pub fn along(&self, direction: DVec3, end_m: f64, steps: usize) -> Scattered {
        let air = &self.atmosphere;
        let clear = Scattered { light: DVec3::ZERO, transmittance: DVec3::ONE };
        let cosine = direction.dot(self.up);
        let Some((start, end)) = self.span(cosine) else { return clear };
        let end = end.min(end_m);
        if end <= start {
            return clear;
        }
        let rayleigh = DVec3::from_array(air.rayleigh);
        let (mie, extinction) = (DVec3::from_array(air.mie), DVec3::from_array(air.mie_extinction));
        let angle = direction.dot(self.sun);
        let by_molecules = rayleigh * rayleigh_phase(angle);
        let by_dust = mie * mie_phase(angle, air.asymmetry);

        // Samples crowd about the ray's lowest point, where the air is.
        let lowest = (-(self.radius_m + self.eye_m) * cosine).clamp(start, end);
        let first = -(lowest - start).sqrt();
        let each = ((end - lowest).sqrt() - first) / steps as f64;
        let (mut light, mut transmittance) = (DVec3::ZERO, DVec3::ONE);
        for i in 0..steps {
            let root = first + (i as f64 + 0.5) * each;
            let t = lowest + root * root.abs();
            let step = 2.0 * root.abs() * each;
            let height = self.height_m(cosine, t);
            let molecules = (-height / air.rayleigh_height_m).exp();
            let dust = (-height / air.mie_height_m).exp();
            let up =
                (self.up * (self.radius_m + self.eye_m) + direction * t) / (self.radius_m + height);
            let sunlight = self.sunlight(height.max(0.0), up.dot(self.sun));
            let through = (-(rayleigh * molecules + extinction * dust) * (0.5 * step)).exp();
            transmittance *= through;
            light += transmittance * sunlight * (by_molecules * molecules + by_dust * dust) * step;
            transmittance *= through;
        }
        // White ground square to the sun sends 1: the sun's irradiance is π.
        Scattered { light: light * std::f64::consts::PI, transmittance }
    }
}

/// Chapman's function for a cosine of 0 or more: the air along a ray from `x` scale heights from the
/// center, over that straight up.
pub(crate) fn chapman(x: f64, cosine: f64) -> f64 {
    let y = (0.5 * x).sqrt() * cosine;
    // exp(y²) erfc(y).
    let erfcx = if y > 8.0 {
        0.564_988_23 / (0.066_518_74 + y)
    } else {
        (1.060_696_3 + 0.556_438_31 * y) / (1.061_989_6 + (1.724_560_9 + y) * y)
    };
    (0.5 * std::f64::consts::PI * x).sqrt() * erfcx
}

/// The share of light that molecules scatter by an angle, per steradian.
#[must_use]
pub fn rayleigh_phase(cosine: f64) -> f64 {
    3.0 / (16.0 * std::f64::consts::PI) * (1.0 + cosine * cosine)
}

/// The share of light that dust scatters by an angle, per steradian: after Cornette and Shanks.
#[must_use]
pub fn mie_phase(cosine: f64, asymmetry: f64) -> f64 {
    let g2 = asymmetry * asymmetry;
    3.0 / (8.0 * std::f64::consts::PI) * (1.0 - g2) * (1.0 + cosine * cosine)
        / ((2.0 + g2) * (1.0 + g2 - 2.0 * asymmetry * cosine).powf(1.5))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn air(eye_m: f64, sun: DVec3) -> Air {
        let atmosphere = Atmosphere::EARTH;
        Air { atmosphere, radius_m: 6.378e6, eye_m, up: DVec3::Z, sun: sun.normalize() }
    }

    #[test]
    fn phases_scatter_all_light() {
        let mean = |phase: &dyn Fn(f64) -> f64| {
            let n = 100_000;
            let cosine = |i: u32| (f64::from(i) + 0.5) / f64::from(n) * 2.0 - 1.0;
            (0..n).map(|i| phase(cosine(i))).sum::<f64>() / f64::from(n)
        };
        let sphere = 4.0 * std::f64::consts::PI;
        assert!((mean(&rayleigh_phase) * sphere - 1.0).abs() < 1e-6);
        assert!((mean(&|c| mie_phase(c, 0.65)) * sphere - 1.0).abs() < 1e-6);
    }

    #[test]
    fn the_air_toward_the_sun_is_its_integral() {
        for scale_m in [1200.0, 8000.0, 11_100.0] {
            for height_m in [0.0, 3000.0, 20_000.0] {
                for degrees in [0.0_f64, 40.0, 75.0, 85.0, 89.0, 90.0, 91.5] {
                    let air = air(height_m, DVec3::Z);
                    let cosine = degrees.to_radians().cos();
                    let told = air.sunward_m(height_m, cosine, scale_m);
                    let steps = 400_000;
                    let step = 2.5e6 / f64::from(steps);
                    let heights =
                        (0..steps).map(|i| air.height_m(cosine, (f64::from(i) + 0.5) * step));
                    let mut sum = 0.0;
                    let mut sinks = false;
                    for height in heights {
                        sinks |= height < 0.0;
                        sum += (-height / scale_m).exp() * step;
                    }
                    if sinks {
                        assert!(told.is_infinite() || degrees <= 90.0);
                    } else {
                        assert!(
                            (told / sum - 1.0).abs() < 0.03,
                            "{scale_m} {height_m} {degrees}: {told} {sum}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn few_steps_see_what_many_do() {
        let brightest = DVec3::ONE;
        for sun in [DVec3::Z, DVec3::new(1.0, 0.0, 0.2), DVec3::new(0.0, 1.0, 0.02)] {
            for eye_m in [2.0, 9000.0, 400_000.0] {
                let air = air(eye_m, sun);
                for pitch in [-80.0_f64, -40.0, -10.0, 0.5, 5.0, 30.0, 90.0] {
                    let (sine, cosine) = pitch.to_radians().sin_cos();
                    let direction = DVec3::new(cosine, 0.0, sine);
                    // The ground, where the ray meets it.
                    let a = air.radius_m + air.eye_m;
                    let under = a * a * sine * sine - air.eye_m * (2.0 * air.radius_m + air.eye_m);
                    let end =
                        if sine < 0.0 && under > 0.0 { -a * sine - under.sqrt() } else { f64::MAX };
                    let few = air.along(direction, end, STEPS);
                    let many = air.along(direction, end, 4000);
                    let off = (few.light - many.light).abs().max_element();
                    assert!(off < 0.03 * brightest.x, "{sun} {eye_m} {pitch}: {few:?} {many:?}");
                    let through = (few.transmittance - many.transmittance).abs().max_element();
                    assert!(through < 0.02, "{sun} {eye_m} {pitch}: {few:?} {many:?}");
                }
            }
        }
    }

    #[test]
    fn a_clear_sky_is_blue_and_no_air_is_black() {
        let air = air(2.0, DVec3::new(0.3, 0.0, 1.0));
        let sky = air.along(DVec3::new(-0.5, 0.3, 0.8).normalize(), f64::MAX, STEPS);
        assert!(sky.light.z > 1.5 * sky.light.x && sky.light.x > 0.0, "{sky:?}");
        let space = air_from_space();
        assert_eq!(space.along(DVec3::X, f64::MAX, STEPS).light, DVec3::ZERO);
    }

    fn air_from_space() -> Air {
        air(3e7, DVec3::X)
    }
}
