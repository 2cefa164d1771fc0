//! Where an eye stands and which way it looks, in f64.
//!
//! An orientation has the columns right, up and backward in body-fixed axes. Headings run
//! clockwise from north, pitches up from the horizon: a pitch of -90° looks straight down, with
//! the heading at the top of the picture.

use crate::view::View;
use areoid_formats::body::Ellipsoid;
use areoid_formats::geodesy::Geographic;
use areoid_formats::units::{Meters, Radians};
use glam::{DMat3, DVec3};

/// A forward direction this near to the vertical, relative to its length, has no heading.
const VERTICAL: f64 = 1e-9;

/// An eye and an orientation: the part of a [`View`] that moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Body-fixed meters.
    pub eye: DVec3,
    /// Columns right, up and backward.
    pub orientation: DMat3,
}

/// East, north and up at a position. At a pole they are those of the position's own meridian.
#[must_use]
pub fn local_axes(position: Geographic) -> DMat3 {
    let up = areoid_formats::geodesy::surface_normal(position);
    let (sine, cosine) = position.longitude.0.sin_cos();
    let east = DVec3::new(-sine, cosine, 0.0);
    DMat3::from_cols(east, up.cross(east), up)
}

impl Pose {
    /// An eye `altitude` above the reference surface that looks along `heading` and `pitch`.
    #[must_use]
    pub fn from_eye(
        ellipsoid: &Ellipsoid,
        position: Geographic,
        altitude: Meters,
        heading: Radians,
        pitch: Radians,
    ) -> Self {
        let eye = ellipsoid.cartesian_from_geographic(position, altitude);
        Self { eye, orientation: orientation(local_axes(position), heading, pitch) }
    }

    /// An eye that looks at a target, with the zenith at the top of the picture; straight down or
    /// up, north is at the top.
    #[must_use]
    pub fn looking_at(
        ellipsoid: &Ellipsoid,
        position: Geographic,
        altitude: Meters,
        target: DVec3,
    ) -> Self {
        let eye = ellipsoid.cartesian_from_geographic(position, altitude);
        let axes = local_axes(position);
        let toward = axes.transpose() * (target - eye);
        let level = toward.x.hypot(toward.y);
        let heading =
            if level <= VERTICAL * toward.length() { 0.0 } else { toward.x.atan2(toward.y) };
        let pitch = toward.z.atan2(level);
        Self { eye, orientation: orientation(axes, Radians(heading), Radians(pitch)) }
    }

    /// The view of this pose.
    #[must_use]
    pub fn view(self, vertical_fov: Radians, viewport: [u32; 2], tolerance_px: f64) -> View {
        View { eye: self.eye, orientation: self.orientation, vertical_fov, viewport, tolerance_px }
    }
}

/// Right, up and backward of an eye with local `axes`.
fn orientation(axes: DMat3, heading: Radians, pitch: Radians) -> DMat3 {
    let (sin_heading, cos_heading) = heading.0.sin_cos();
    let (sin_pitch, cos_pitch) = pitch.0.sin_cos();
    let right = DVec3::new(cos_heading, -sin_heading, 0.0);
    let forward = DVec3::new(sin_heading * cos_pitch, cos_heading * cos_pitch, sin_pitch);
    axes * DMat3::from_cols(right, right.cross(forward), -forward)
}

/// The angle that a pixel at the center of the picture subtends.
#[must_use]
pub fn pixel_angle(view: &View) -> f64 {
    2.0 * (view.vertical_fov.0 / 2.0).tan() / f64::from(view.viewport[1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use areoid_formats::units::Degrees;

    const BODY: Ellipsoid = Ellipsoid::WGS84;

    fn at(longitude: f64, latitude: f64) -> Geographic {
        Geographic::from_degrees(Degrees(longitude), Degrees(latitude))
    }

    #[test]
    fn north_is_up_when_looking_down_also_at_the_poles() {
        for (longitude, latitude) in [(0.0, 0.0), (77.0, -30.0), (10.0, 90.0), (-120.0, -90.0)] {
            let place = at(longitude, latitude);
            let below = BODY.cartesian_from_geographic(place, Meters(0.0));
            let down = Pose::looking_at(&BODY, place, Meters(1e6), below);
            let north = local_axes(place).y_axis;
            assert!(down.orientation.y_axis.distance(north) < 1e-9);
            let same =
                Pose::from_eye(&BODY, place, Meters(1e6), Radians(0.0), Degrees(-90.0).into());
            assert!(same.orientation.abs_diff_eq(down.orientation, 1e-9));
        }
    }

    #[test]
    fn an_eye_looks_at_its_target_with_the_zenith_up() {
        let place = at(137.0, 45.0);
        let target = BODY.cartesian_from_geographic(at(138.0, 46.0), Meters(100.0));
        let pose = Pose::looking_at(&BODY, place, Meters(9e3), target);
        let forward = (target - pose.eye).normalize();
        assert!((-pose.orientation.z_axis).distance(forward) < 1e-12);
        assert!(pose.orientation.x_axis.dot(local_axes(place).z_axis).abs() < 1e-12);
        assert!(pose.orientation.y_axis.dot(local_axes(place).z_axis) > 0.0);
        assert!((pose.orientation.determinant() - 1.0).abs() < 1e-12);
    }
}
