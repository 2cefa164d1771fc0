//! How a view moves, and where it will be soon.
//!
//! The eye goes on along its straight line and the camera goes on turning about its axis, each as
//! fast as over the last few updates; the nearer the ground, the slower an eye that goes down.
//!
//! # References
//!
//! * P-BDAM, section 4.4: fetching for the position expected in a moment.

use std::time::Duration;

use glam::{DMat3, DQuat, DVec3};
use tokio::time::Instant;

use crate::view::View;

/// The recent past of a view.
#[derive(Clone, Debug, Default)]
pub(crate) struct Motion {
    last: Option<(Instant, View)>,
    /// Meters a second.
    velocity: DVec3,
    /// Radians a second about its own direction.
    rotation: DVec3,
    /// How far it went last, in meters, and turned, in radians.
    step: (f64, f64),
}

impl Motion {
    /// Velocities forget what is older than about this.
    const MEMORY: Duration = Duration::from_millis(80);

    /// After a pause of this, or a leap that no flight makes, what was before says nothing.
    const PAUSE: Duration = Duration::from_millis(500);

    /// A view is nearly the one before if it went no farther than this share of its height, and turned by no
    /// more than so many radians.
    const NEAR: (f64, f64) = (0.05, 0.1);

    /// The view was `view` at `now`.
    pub(crate) fn observe(&mut self, view: &View, now: Instant) {
        let Some((then, before)) = self.last.replace((now, *view)) else { return };
        let elapsed = now.saturating_duration_since(then);
        if elapsed.is_zero() {
            self.last = Some((then, *view));
            return;
        }
        let seconds = elapsed.as_secs_f64();
        let velocity = (view.eye - before.eye) / seconds;
        let turn = turn(before.orientation, view.orientation) / seconds;
        let is_leap = (view.eye - before.eye).length() > 0.05 * before.eye.length();
        self.step = ((view.eye - before.eye).length(), turn.length() * seconds);
        if elapsed > Self::PAUSE || is_leap || !velocity.is_finite() || !turn.is_finite() {
            (self.velocity, self.rotation) = (DVec3::ZERO, DVec3::ZERO);
            return;
        }
        let weight = 1.0 - (-seconds / Self::MEMORY.as_secs_f64()).exp();
        self.velocity += weight * (velocity - self.velocity);
        self.rotation += weight * (turn - self.rotation);
    }

    /// Whether the view is nearly the one before, above ground that is `radius_m` from the body's center.
    pub(crate) fn is_steady(&self, radius_m: f64) -> bool {
        let height = self.last.map_or(0.0, |(_, view)| view.eye.length() - radius_m);
        let (share, angle) = Self::NEAR;
        self.step.0 <= share * height && self.step.1 <= angle
    }

    /// The view after `ahead`, above ground that is `radius_m` from the body's center; `None` if it
    /// will not have changed.
    pub(crate) fn predict(&self, ahead: Duration, radius_m: f64) -> Option<View> {
        let (_, view) = self.last?;
        let seconds = ahead.as_secs_f64();
        let (way, turn) = (self.velocity * seconds, self.rotation * seconds);
        if way.length() < 1e-9 * view.eye.length() && turn.length() < 1e-4 {
            return None;
        }
        let orientation = DMat3::from_quat(DQuat::from_scaled_axis(turn)) * view.orientation;
        Some(View { eye: above_ground(view.eye, way, radius_m), orientation, ..view })
    }
}

/// An eye that has gone some way; one that comes down does so ever more slowly, by equal factors.
fn above_ground(eye: DVec3, way: DVec3, radius_m: f64) -> DVec3 {
    let (before, after) = (eye.length() - radius_m, (eye + way).length() - radius_m);
    if before <= 0.0 || after >= before {
        return eye + way;
    }
    let height = before * ((after - before) / before).exp();
    (eye + way).normalize_or_zero() * (radius_m + height)
}

/// The turn from one orientation to another: its axis, as long as its angle in radians.
fn turn(before: DMat3, after: DMat3) -> DVec3 {
    let turn = DQuat::from_mat3(&(after * before.transpose()));
    // Of the two ways around, the short one.
    let turn = if turn.w < 0.0 { -turn } else { turn };
    turn.to_scaled_axis()
}

#[cfg(test)]
mod tests {
    use super::*;
    use areoid_formats::units::Degrees;

    fn view(eye: DVec3, angle: f64) -> View {
        View {
            eye,
            orientation: DMat3::from_rotation_z(angle) * DMat3::from_rotation_x(0.4),
            vertical_fov: Degrees(45.0).into(),
            viewport: [640, 480],
            tolerance_px: 1.0,
        }
    }

    #[test]
    fn a_steady_flight_goes_on_as_it_is() {
        let (start, frame) = (Instant::now(), Duration::from_secs(1) / 60);
        let (eye, way) = (DVec3::new(3.5e6, 1e5, -2e5), DVec3::new(200.0, 7e3, 30.0));
        let at = |seconds: f64| view(eye + way * seconds, 0.3 * seconds);
        let mut motion = Motion::default();
        for step in 0..60 {
            motion.observe(&at(f64::from(step) / 60.0), start + step * frame);
        }
        let expected = motion.predict(Duration::from_millis(500), 1e6).unwrap();
        let truth = at(59.0 / 60.0 + 0.5);
        assert!((expected.eye - truth.eye).length() < 1.0, "{expected:?}");
        let off = turn(expected.orientation, truth.orientation).length();
        assert!(off < 1e-4, "{off}");
    }

    #[test]
    fn a_view_at_rest_and_one_that_leapt_stay() {
        let (start, frame) = (Instant::now(), Duration::from_secs(1) / 60);
        let mut motion = Motion::default();
        for step in 0..10 {
            motion.observe(&view(DVec3::new(4e6, 0.0, 0.0), 0.0), start + step * frame);
            assert_eq!(motion.predict(Duration::from_secs(1), 1e6), None);
        }
        motion.observe(&view(DVec3::new(0.0, 4e6, 0.0), 0.0), start + 10 * frame);
        assert_eq!(motion.predict(Duration::from_secs(1), 1e6), None);
        motion.observe(&view(DVec3::new(0.0, 4e6, 0.0), f64::NAN), start + 11 * frame);
        assert_eq!(motion.predict(Duration::from_secs(1), 1e6), None);
    }

    #[test]
    fn an_eye_that_comes_down_stays_above_ground() {
        let (start, frame) = (Instant::now(), Duration::from_secs(1) / 60);
        let mut motion = Motion::default();
        // Half as high every half second.
        let height = |seconds: f64| 1e5 * 0.25_f64.powf(seconds);
        for step in 0..60 {
            let eye = DVec3::X * (3e6 + height(f64::from(step) / 60.0));
            motion.observe(&view(eye, 0.0), start + step * frame);
        }
        let expected = motion.predict(Duration::from_millis(500), 3e6).unwrap();
        let truth = height(59.0 / 60.0 + 0.5);
        let off = (expected.eye.length() - 3e6) / truth;
        assert!((0.8..1.2).contains(&off), "{off}");
        let long = motion.predict(Duration::from_secs(10), 3e6).unwrap();
        assert!(long.eye.length() > 3e6);
    }
}
