//! Planets and moons as ellipsoids of revolution.
//!
//! A sphere is an ellipsoid whose radii are equal; nothing else tells them apart. The named bodies
//! carry the reference surface that their elevation products are measured from, which is not always
//! the best-fitting one: Mars is a sphere here because MOLA's grids are referred to a sphere.
//!
//! # References
//!
//! * B. A. Archinal et al., *Report of the IAU Working Group on Cartographic Coordinates and
//!   Rotational Elements: 2015*, Celest. Mech. Dyn. Astr. 130:22, 2018.
//! * NIMA TR8350.2, *Department of Defense World Geodetic System 1984*, third edition, 2000.

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::units::Meters;

/// An oblate ellipsoid of revolution, or a sphere.
///
/// Invariant: both radii are finite and positive, and the polar one is not the larger.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Radii", into = "Radii")]
pub struct Ellipsoid {
    equatorial_radius: Meters,
    polar_radius: Meters,
}

/// The two radii as they are stored, before they are checked.
#[derive(Serialize, Deserialize)]
struct Radii {
    a: Meters,
    b: Meters,
}

/// Radii that make no oblate ellipsoid.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EllipsoidError {
    /// A radius is zero, negative, infinite or NaN.
    #[error("a radius must be finite and positive, found equatorial {} m, polar {} m", a.0, b.0)]
    Radius {
        /// The equatorial radius found.
        a: Meters,
        /// The polar radius found.
        b: Meters,
    },

    /// The polar radius exceeds the equatorial one.
    #[error("prolate ellipsoids are not supported: equatorial {} m, polar {} m", a.0, b.0)]
    Prolate {
        /// The equatorial radius found.
        a: Meters,
        /// The polar radius found.
        b: Meters,
    },
}

impl Ellipsoid {
    /// The World Geodetic System of 1984: 1/f = 298.257223563.
    pub const WGS84: Self = Self::known(6_378_137.0, 6_356_752.314_245_179);

    const fn known(a: f64, b: f64) -> Self {
        Self { equatorial_radius: Meters(a), polar_radius: Meters(b) }
    }

    /// An ellipsoid of equatorial radius `a` and polar radius `b`.
    ///
    /// # Errors
    ///
    /// [`EllipsoidError`] unless both are finite and positive and `b` is at most `a`.
    pub fn new(a: Meters, b: Meters) -> Result<Self, EllipsoidError> {
        let is_length = |m: Meters| m.0.is_finite() && m.0 > 0.0;
        if !is_length(a) || !is_length(b) {
            return Err(EllipsoidError::Radius { a, b });
        }
        if b.0 > a.0 {
            return Err(EllipsoidError::Prolate { a, b });
        }
        Ok(Self { equatorial_radius: a, polar_radius: b })
    }

    /// A sphere of radius `r`.
    ///
    /// # Errors
    ///
    /// [`EllipsoidError::Radius`] unless `r` is finite and positive.
    pub fn sphere(r: Meters) -> Result<Self, EllipsoidError> {
        Self::new(r, r)
    }

    /// The equatorial radius.
    #[must_use]
    pub const fn a(&self) -> Meters {
        self.equatorial_radius
    }

    /// The polar radius.
    #[must_use]
    pub const fn b(&self) -> Meters {
        self.polar_radius
    }

    /// Whether the radii are equal to the last bit.
    #[must_use]
    pub fn is_sphere(&self) -> bool {
        self.equatorial_radius == self.polar_radius
    }

    /// The first eccentricity squared, `(a² - b²) / a²`: 0 for a sphere, below 1 always.
    #[must_use]
    pub fn eccentricity_squared(&self) -> f64 {
        let (a, b) = (self.a().0, self.b().0);
        // Factored, so that nearly equal radii keep their digits.
        ((a - b) / a) * ((a + b) / a)
    }

    /// The larger of the two radii's differences from `other`'s, relative to `other`'s.
    fn relative_difference(&self, other: &Self) -> f64 {
        let relative = |ours: Meters, theirs: Meters| ((ours.0 - theirs.0) / theirs.0).abs();
        relative(self.a(), other.a()).max(relative(self.b(), other.b()))
    }
}

impl TryFrom<Radii> for Ellipsoid {
    type Error = EllipsoidError;

    fn try_from(radii: Radii) -> Result<Self, Self::Error> {
        Self::new(radii.a, radii.b)
    }
}

impl From<Ellipsoid> for Radii {
    fn from(ellipsoid: Ellipsoid) -> Self {
        Self { a: ellipsoid.a(), b: ellipsoid.b() }
    }
}

/// `A` for a sphere and `A,B` otherwise, in meters: what [`Body::parse`] reads.
impl fmt::Display for Ellipsoid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_sphere() {
            write!(f, "{}", self.a().0)
        } else {
            write!(f, "{},{}", self.a().0, self.b().0)
        }
    }
}

/// A planet or a moon: a name for people, and the surface that heights are measured from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Body {
    /// A name of [`Body::NAMES`], or the radii for a body without one.
    pub name: String,
    /// The reference surface.
    pub ellipsoid: Ellipsoid,
}

/// Text that names no body.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BodyError {
    /// Neither a known name nor one or two numbers.
    #[error("no body: expected one of {}, or radii in meters as A or A,B, found {found:?}", Body::NAMES.join(", "))]
    Unknown {
        /// The text found.
        found: String,
    },

    /// Two numbers that make no ellipsoid.
    #[error("no body: {0}")]
    Ellipsoid(#[from] EllipsoidError),
}

/// Every named body and its reference surface.
///
/// Mercury is the mean sphere of its elevation products (2439.4 km), not the IAU's ellipsoid
/// (2440.53, 2438.26 km); the two are one body to [`Body::same_as`].
const KNOWN: [(&str, Ellipsoid); 6] = [
    ("earth", Ellipsoid::WGS84),
    ("moon", Ellipsoid::known(1_737_400.0, 1_737_400.0)),
    ("mars", Ellipsoid::known(3_396_190.0, 3_396_190.0)),
    ("mars-ellipsoid", Ellipsoid::known(3_396_190.0, 3_376_200.0)),
    ("mercury", Ellipsoid::known(2_439_400.0, 2_439_400.0)),
    ("venus", Ellipsoid::known(6_051_800.0, 6_051_800.0)),
];

impl Body {
    /// The names that [`Body::parse`] knows.
    pub const NAMES: [&str; 6] =
        [KNOWN[0].0, KNOWN[1].0, KNOWN[2].0, KNOWN[3].0, KNOWN[4].0, KNOWN[5].0];

    /// Radii this close, relatively, are one body's.
    pub const SAME_WITHIN: f64 = 1e-3;

    /// The body that `text` names: `mars`, or radii in meters, `3396190` or `3396190,3376200`.
    ///
    /// # Errors
    ///
    /// [`BodyError`] if the text is neither, or the radii make no ellipsoid.
    pub fn parse(text: &str) -> Result<Self, BodyError> {
        let name = text.trim().to_ascii_lowercase();
        if let Some(&(_, ellipsoid)) = KNOWN.iter().find(|(known, _)| *known == name) {
            return Ok(Self { name, ellipsoid });
        }

        let unknown = || BodyError::Unknown { found: text.to_owned() };
        let meters = |number: &str| number.trim().parse().map(Meters).map_err(|_| unknown());
        let (a, b) = match name.split_once(',') {
            Some((a, b)) => (meters(a)?, meters(b)?),
            None => (meters(&name)?, meters(&name)?),
        };
        Ok(Self::from_ellipsoid(Ellipsoid::new(a, b)?))
    }

    /// The body with exactly this surface, called after the known body whose radii are both within
    /// [`Self::SAME_WITHIN`], or else by its radii.
    ///
    /// The known bodies are so far apart that no surface is near to two of them.
    #[must_use]
    pub fn from_ellipsoid(ellipsoid: Ellipsoid) -> Self {
        let mut known = KNOWN.iter();
        let known = known.find(|(_, it)| ellipsoid.relative_difference(it) <= Self::SAME_WITHIN);
        let name = known.map_or_else(|| ellipsoid.to_string(), |(name, _)| (*name).to_owned());
        Self { name, ellipsoid }
    }

    /// Whether both radii are equal within [`Self::SAME_WITHIN`] of the larger; names do not count.
    #[must_use]
    pub fn same_as(&self, other: &Self) -> bool {
        let (one, other) = (&self.ellipsoid, &other.ellipsoid);
        // The smaller of the two ratios makes the relation symmetric.
        one.relative_difference(other).min(other.relative_difference(one)) <= Self::SAME_WITHIN
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn ellipsoid(a: f64, b: f64) -> Ellipsoid {
        Ellipsoid::new(Meters(a), Meters(b)).unwrap()
    }

    #[test]
    fn radii_that_make_no_oblate_ellipsoid_are_refused() {
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(Ellipsoid::new(Meters(bad), Meters(1.0)).is_err(), "{bad}");
            assert!(Ellipsoid::new(Meters(1.0), Meters(bad)).is_err(), "{bad}");
        }
        let prolate = Ellipsoid::new(Meters(1.0), Meters(1.0_f64.next_up()));
        assert!(matches!(prolate, Err(EllipsoidError::Prolate { .. })));
        assert!(serde_json::from_str::<Ellipsoid>(r#"{"a":1.0,"b":2.0}"#).is_err());
    }

    #[test]
    fn every_known_body_parses_and_finds_its_own_name() {
        for name in Body::NAMES {
            let body = Body::parse(name).unwrap();
            assert_eq!(body.name, name);
            assert_eq!(Body::from_ellipsoid(body.ellipsoid), body);
            assert_eq!(Body::parse(&body.ellipsoid.to_string()).unwrap(), body);
        }
    }

    #[test]
    fn a_body_keeps_its_own_radii_under_a_known_name() {
        let mercury = Body::parse("2440530,2438260").unwrap();
        assert_eq!(mercury.name, "mercury");
        assert_eq!(mercury.ellipsoid, ellipsoid(2_440_530.0, 2_438_260.0));
        assert_eq!(Body::from_ellipsoid(ellipsoid(3_396_000.0, 3_396_000.0)).name, "mars");
        assert_eq!(
            Body::from_ellipsoid(ellipsoid(3_396_190.0, 3_376_000.0)).name,
            "mars-ellipsoid"
        );
        assert_eq!(Body::parse(" 252100.5 ").unwrap().name, "252100.5");
        assert_eq!(Body::parse("5, 4").unwrap().name, "5,4");
    }

    #[test]
    fn no_surface_is_near_to_two_known_bodies() {
        for (i, (name, one)) in KNOWN.iter().enumerate() {
            for (other_name, other) in &KNOWN[i + 1..] {
                let apart = one.relative_difference(other);
                assert!(apart > 3.0 * Body::SAME_WITHIN, "{name} and {other_name}");
            }
        }
    }

    #[test]
    fn one_radius_alone_does_not_make_two_bodies_the_same() {
        let [sphere, flat] = ["mars", "mars-ellipsoid"].map(|name| Body::parse(name).unwrap());
        assert!(!sphere.same_as(&flat) && !flat.same_as(&sphere));
    }

    #[test]
    fn text_that_is_no_body_is_quoted_back() {
        for text in ["", "vulcan", "1,2,3", "1;2", "3396190 m"] {
            let message = Body::parse(text).unwrap_err().to_string();
            assert!(message.contains(&format!("{text:?}")), "{message}");
            assert!(message.contains("mars-ellipsoid"), "{message}");
        }
        assert!(matches!(Body::parse("1,2"), Err(BodyError::Ellipsoid(_))));
        assert!(matches!(Body::parse("nan"), Err(BodyError::Ellipsoid(_))));
    }

    proptest! {
        #[test]
        fn same_as_is_symmetric(
            a in 1.0..2.0, b in 0.5..1.0, scale_a in 0.9985..1.0015, scale_b in 0.9985..1.0015,
        ) {
            let one = Body::from_ellipsoid(ellipsoid(a, a * b));
            let (a2, b2): (f64, f64) = (a * scale_a, a * b * scale_b);
            let other = Body::from_ellipsoid(ellipsoid(a2, b2.min(a2)));
            prop_assert_eq!(one.same_as(&other), other.same_as(&one));
        }

        #[test]
        fn radii_read_back_to_the_last_bit(a in 1e-3..1e9, ratio in 0.01..=1.0) {
            let ellipsoid = ellipsoid(a, a * ratio);
            prop_assert_eq!(Body::parse(&ellipsoid.to_string()).unwrap().ellipsoid, ellipsoid);
            let json = serde_json::to_string(&ellipsoid).unwrap();
            prop_assert_eq!(serde_json::from_str::<Ellipsoid>(&json).unwrap(), ellipsoid);
        }
    }
}
