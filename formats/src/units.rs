//! Angles and lengths that cannot be mistaken for one another.
//!
//! Angles are radians and lengths are meters everywhere inside the workspace. Degrees exist at the
//! edges only, in file headers, arguments and results, and become radians as they are read.

use std::f64::consts::{PI, TAU};

use serde::{Deserialize, Serialize};

/// An angle in radians.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd, Serialize, Deserialize)]
pub struct Radians(pub f64);

/// An angle in degrees, as people and file headers write it.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd, Serialize, Deserialize)]
pub struct Degrees(pub f64);

/// A length in meters.
#[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd, Serialize, Deserialize)]
pub struct Meters(pub f64);

impl From<Degrees> for Radians {
    fn from(angle: Degrees) -> Self {
        Self(angle.0.to_radians())
    }
}

impl From<Radians> for Degrees {
    fn from(angle: Radians) -> Self {
        Self(angle.0.to_degrees())
    }
}

impl Radians {
    /// The same direction in `[-π, π)`, the range of every longitude in this workspace.
    ///
    /// # Domain
    ///
    /// The range holds for every finite input, to the last bit; infinities and NaN give NaN.
    #[must_use]
    pub fn wrapped(self) -> Self {
        let turns = (self.0 / TAU + 0.5).floor();
        let angle = self.0 - turns * TAU;
        // The sum above rounds: within an ulp of ±π it may be one turn off.
        if angle < -PI {
            Self(angle + TAU)
        } else if angle >= PI {
            Self(angle - TAU)
        } else {
            Self(angle)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn check(angle: f64) {
        let wrapped = Radians(angle).wrapped().0;
        assert!((-PI..PI).contains(&wrapped), "{angle:?} -> {wrapped:?}");
        assert!((wrapped - angle).sin().abs() < 1e-12, "{angle:?} -> {wrapped:?}");
    }

    /// Every float within three ulps of a multiple of π: too few to leave to chance.
    #[test]
    fn the_seam_wraps_into_range() {
        for halves in -8..=8 {
            let (mut below, mut above) = (f64::from(halves) * PI, f64::from(halves) * PI);
            for _ in 0..=3 {
                check(below);
                check(above);
                (below, above) = (below.next_down(), above.next_up());
            }
        }
    }

    proptest! {
        #[test]
        fn any_angle_wraps_into_range(angle in -1e3..1e3) {
            check(angle);
        }
    }
}
