//! Where a picture is taken from, and how sharp it has to be.

use areoid_formats::bounds::{Aabb, HalfSpace};
use areoid_formats::units::{Meters, Radians};
use areoid_formats::volume::{Horizon, Volume};
use glam::{DMat3, DVec3};

/// A pinhole camera in body-fixed space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Body-fixed meters from the body's center.
    pub eye: DVec3,
    /// Columns: right, up, backward, as unit vectors in body-fixed space.
    pub orientation: DMat3,
    /// The whole angle between the lower and the upper edge of the picture.
    pub vertical_fov: Radians,
    /// Width and height of the picture in pixels.
    pub viewport: [u32; 2],
    /// The largest error of a height on the screen, and the largest texel of a color, in pixels.
    pub tolerance_px: f64,
}

impl View {
    /// The direction the camera looks in, a unit vector in body-fixed space.
    #[must_use]
    pub fn axis(&self) -> DVec3 {
        -self.orientation.z_axis
    }
}

/// What a search has to know of a view, computed once.
#[derive(Clone, Debug)]
pub(crate) struct Lens {
    pub(crate) eye: DVec3,
    pub(crate) axis: DVec3,
    /// The four sides, and the plane through the eye that the camera looks away from.
    pub(crate) frustum: [HalfSpace; 5],
    /// Pixels to a tangent of 1 from the view axis: S / (2 tan(θ/2)).
    pixels_per_tangent: f64,
    /// Cosine of the angle between the axis and the picture's corners.
    pub(crate) corner_cosine: f64,
    /// What a sphere below all terrain hides.
    horizon: Option<Horizon>,
}

impl Lens {
    /// A dataset that is smaller on the screen is not drawn.
    pub(crate) const SMALLEST_PX: f64 = 1.0;

    pub(crate) fn new(view: &View, inscribed_radius: Meters) -> Self {
        let [width, height] = view.viewport.map(|pixels| f64::from(pixels.max(1)));
        let up_tangent = (view.vertical_fov.0 / 2.0).tan();
        let right_tangent = up_tangent * width / height;
        let DMat3 { x_axis: right, y_axis: up, z_axis: backward } = view.orientation;
        let side = |normal| HalfSpace::through(view.eye, normal);
        Self {
            eye: view.eye,
            axis: view.axis(),
            frustum: [
                side(right - right_tangent * backward),
                side(-right - right_tangent * backward),
                side(up - up_tangent * backward),
                side(-up - up_tangent * backward),
                side(-backward),
            ],
            pixels_per_tangent: height / (2.0 * up_tangent),
            corner_cosine: (1.0 + up_tangent.powi(2) + right_tangent.powi(2)).sqrt().recip(),
            horizon: Horizon::new(view.eye, inscribed_radius),
        }
    }

    /// Whether all of a page is out of sight.
    pub(crate) fn misses(&self, volume: &Volume) -> bool {
        self.horizon.is_some_and(|horizon| volume.hidden_by(&horizon))
            || volume.outside(&self.frustum)
    }

    /// Whether a box, of which nothing is farther than `greatest_radius` from the body's center, is
    /// out of sight, or too small to be seen.
    pub(crate) fn misses_box(&self, bounds: &Aabb, greatest_radius: Meters) -> bool {
        self.horizon.is_some_and(|horizon| horizon.hides_box(bounds, greatest_radius))
            || bounds.outside(&self.frustum)
            || self.pixels(bounds.diagonal(), bounds.distance_from(self.eye), self.corner_cosine)
                < Self::SMALLEST_PX
    }

    /// How large a length can be on the screen, `distance` or more away and at an angle from the
    /// axis of this cosine or more: `ARCHITECTURE.md`, the error on the screen.
    pub(crate) fn pixels(&self, length_m: f64, distance_m: f64, cosine: f64) -> f64 {
        if length_m > 0.0 {
            length_m * self.pixels_per_tangent / (distance_m * cosine * cosine)
        } else {
            // Nothing is not visible, however near.
            0.0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use areoid_formats::units::Degrees;

    /// A short stick across the line of sight, anywhere in the picture and turned any way, is
    /// never longer than promised, and at the corner nearly as long.
    #[test]
    fn a_stick_is_never_longer_on_the_screen() {
        let view = View {
            eye: DVec3::new(1.0, 2.0, 3.0),
            orientation: DMat3::from_rotation_y(0.7) * DMat3::from_rotation_x(0.3),
            vertical_fov: Degrees(45.0).into(),
            viewport: [1600, 900],
            tolerance_px: 1.0,
        };
        let lens = Lens::new(&view, Meters(1.0));
        let screen = |point: DVec3| {
            let seen = view.orientation.transpose() * (point - view.eye);
            glam::DVec2::new(seen.x, seen.y) / -seen.z * lens.pixels_per_tangent
        };
        let (mut longest, stick) = (0.0_f64, 1e-3);
        for corner in 0..=20 {
            let share = f64::from(corner) / 20.0;
            let tangent = glam::DVec2::new(1600.0, 900.0) / 900.0 * 22.5_f64.to_radians().tan();
            let sight = DVec3::new(share * tangent.x, share * tangent.y, -1.0).normalize();
            let point = view.eye + view.orientation * (100.0 * sight);
            assert!(lens.frustum.iter().all(|side| side.normal.dot(point) >= side.offset - 1e-9));
            let cosine = (point - view.eye).normalize().dot(lens.axis);
            let promised = lens.pixels(stick, 100.0, cosine);
            for turn in 0..36 {
                let along = DVec3::new(sight.y, -sight.x, 0.0).normalize_or(DVec3::X);
                let across = sight.cross(along);
                let (sine, cosine) = (f64::from(turn) * 10.0).to_radians().sin_cos();
                let end = point + view.orientation * (stick * (along * cosine + across * sine));
                let length = (screen(end) - screen(point)).length();
                assert!(length <= promised * (1.0 + 1e-4), "{length} > {promised}");
                longest = longest.max(length / promised);
            }
        }
        assert!(longest > 0.999, "{longest}");
    }
}
