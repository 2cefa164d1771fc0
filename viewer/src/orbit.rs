//! A camera that a hand moves: about a place on the ground, from space down to a meter.
//!
//! ```text
//!        eye
//!         \  range                 the frame's up is the normal at the focus; dragging rolls the
//!          \ tilt                  whole frame over the body, so that no pole is special
//!   ahead ──focus── ...
//! ```

use areoid_formats::body::Ellipsoid;
use areoid_formats::geodesy::{Geographic, geographic_from_normal, surface_normal};
use areoid_formats::units::{Meters, Radians};
use glam::{DMat3, DQuat, DVec3};

use crate::camera::{Pose, local_axes};

/// An eye on a tether.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orbit {
    ellipsoid: Ellipsoid,
    /// Columns right, ahead and up at the focus.
    frame: DMat3,
    /// Meters from the focus.
    range_m: f64,
    /// Off the vertical, 0 to just short of a right angle.
    tilt: f64,
}

/// The eye comes no nearer to the ground.
const NEAREST_M: f64 = 2.0;
/// Radii away from the focus at most.
const FARTHEST_RADII: f64 = 20.0;
const STEEPEST: f64 = 0.49 * std::f64::consts::PI;

impl Orbit {
    /// Looks straight down at a place, north up.
    #[must_use]
    pub fn above(ellipsoid: Ellipsoid, place: Geographic, range: Meters) -> Self {
        Self { ellipsoid, frame: local_axes(place), range_m: range.0, tilt: 0.0 }
    }

    /// The place looked at.
    #[must_use]
    pub fn focus(&self) -> Geographic {
        geographic_from_normal(self.frame.z_axis)
    }

    /// How far the eye is from it.
    #[must_use]
    pub fn range(&self) -> Meters {
        Meters(self.range_m)
    }

    /// Drags the ground by pixels to the right and down, each of `pixel_angle` radians.
    pub fn drag(&mut self, right_px: f64, down_px: f64, pixel_angle: f64) {
        // Never faster than the planet's own disc turns under the hand.
        let radius = self.ellipsoid.a().0;
        let angle = pixel_angle * (self.range_m / radius).min(1.5);
        let about =
            self.frame.y_axis * (-right_px * angle) + self.frame.x_axis * (-down_px * angle);
        self.roll(DQuat::from_scaled_axis(about));
    }

    /// Comes nearer by a factor below 1, or leaves by one above.
    pub fn zoom(&mut self, factor: f64) {
        let farthest = FARTHEST_RADII * self.ellipsoid.a().0;
        self.range_m = (self.range_m * factor).clamp(NEAREST_M, farthest);
    }

    /// Turns about the vertical and tilts off it.
    pub fn turn(&mut self, heading: Radians, tilt: Radians) {
        self.roll(DQuat::from_axis_angle(self.frame.z_axis, -heading.0));
        self.tilt = (self.tilt + tilt.0).clamp(0.0, STEEPEST);
    }

    /// Puts north ahead.
    pub fn face_north(&mut self) {
        self.frame = local_axes(self.focus());
    }

    /// The eye, kept above the ground, whose height at a normal `ground` knows.
    #[must_use]
    pub fn pose(&self, ground: impl Fn(DVec3) -> f64) -> Pose {
        let [right, ahead, up] = [self.frame.x_axis, self.frame.y_axis, self.frame.z_axis];
        let (sine, cosine) = self.tilt.sin_cos();
        let backward = up * cosine - ahead * sine;
        let focus = self
            .ellipsoid
            .cartesian_from_geographic(geographic_from_normal(up), Meters(ground(up)));
        let mut eye = focus + self.range_m * backward;
        let (place, altitude) = self.ellipsoid.geographic_from_cartesian(eye);
        let normal = surface_normal(place);
        let lift = ground(normal) + NEAREST_M - altitude.0;
        if lift > 0.0 {
            eye += lift * normal;
        }
        Pose { eye, orientation: DMat3::from_cols(right, backward.cross(right), backward) }
    }

    fn roll(&mut self, by: DQuat) {
        let turned = DMat3::from_quat(by) * self.frame;
        // Thousands of small turns must not skew the frame.
        let up = turned.z_axis.normalize();
        let right = turned.y_axis.cross(up).normalize();
        self.frame = DMat3::from_cols(right, up.cross(right), up);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use areoid_formats::units::Degrees;

    fn mars() -> Ellipsoid {
        Ellipsoid::sphere(Meters(3_396_190.0)).unwrap()
    }

    fn at(longitude: f64, latitude: f64) -> Geographic {
        Geographic::from_degrees(Degrees(longitude), Degrees(latitude))
    }

    #[test]
    fn the_ground_follows_the_hand() {
        let mut orbit = Orbit::above(mars(), at(10.0, 0.0), Meters(1e5));
        orbit.drag(100.0, 0.0, 1e-3);
        assert!(orbit.focus().longitude.0 < Radians::from(Degrees(10.0)).0);
        orbit.drag(0.0, 100.0, 1e-3);
        assert!(orbit.focus().latitude.0 > 0.0);
    }

    #[test]
    fn a_pole_is_passed_straight() {
        let mut orbit = Orbit::above(mars(), at(10.0, 89.0), Meters(1e6));
        for _ in 0..2000 {
            orbit.drag(0.0, 1.0, 1e-3);
        }
        let passed = orbit.focus();
        assert!((Degrees::from(passed.longitude).0 + 170.0).abs() < 1e-6, "{passed:?}");
        let pose = orbit.pose(|_| 0.0);
        assert!((pose.orientation.determinant() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_eye_stays_above_the_ground() {
        let mut orbit = Orbit::above(mars(), at(0.0, 0.0), Meters(1e4));
        orbit.zoom(1e-9);
        orbit.turn(Radians(1.0), Radians(3.0));
        let pose = orbit.pose(|_| 500.0);
        let (_, altitude) = mars().geographic_from_cartesian(pose.eye);
        assert!(altitude.0 >= 501.9, "{altitude:?}");
        assert!(pose.orientation.y_axis.dot(pose.eye) > 0.0);
    }
}
