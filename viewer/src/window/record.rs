//! Poses as keys of a flight, for recording.

use areoid_cache::camera::{Pose, local_axes};
use areoid_cache::flight::{Flight, Key};
use areoid_formats::body::Ellipsoid;
use areoid_formats::units::Degrees;

/// The key of a pose whose horizon is level.
pub(super) fn key_of(pose: &Pose, ellipsoid: &Ellipsoid, seconds: f64) -> Key {
    let (place, altitude) = ellipsoid.geographic_from_cartesian(pose.eye);
    let axes = local_axes(place);
    let in_axes = |v: glam::DVec3| axes.transpose() * v;
    let ahead = in_axes(-pose.orientation.z_axis);
    let up = in_axes(pose.orientation.y_axis);
    let pitch = ahead.z.clamp(-1.0, 1.0).asin();
    // Straight down the top of the picture is ahead; straight up its bottom.
    let across = ahead.truncate() * pitch.cos() - up.truncate() * pitch.sin();
    let heading = across.x.atan2(across.y);
    let degrees = |radians: f64| radians.to_degrees();
    let [longitude, latitude] =
        [place.longitude, place.latitude].map(|angle| Degrees::from(angle).0);
    Key {
        seconds,
        eye: [longitude, latitude, altitude.0.max(Flight::LOWEST_M)],
        look: [degrees(heading), degrees(pitch)],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_key_is_the_pose_that_it_was_taken_of(
            longitude in -180.0..180.0_f64, latitude in -89.9..89.9_f64, altitude in -7e3..1e7_f64,
            heading in -180.0..180.0_f64, pitch in -90.0..=0.0_f64,
        ) {
            let body = Ellipsoid::WGS84;
            let key = Key { seconds: 0.0, eye: [longitude, latitude, altitude], look: [heading, pitch] };
            let pose = Flight::new(vec![key]).unwrap().pose(&body, 0.0);
            let taken = key_of(&pose, &body, 0.0);
            let again = Flight::new(vec![taken]).unwrap().pose(&body, 0.0);
            prop_assert!(pose.eye.distance(again.eye) < 1e-3);
            for (one, other) in [
                (pose.orientation.x_axis, again.orientation.x_axis),
                (pose.orientation.z_axis, again.orientation.z_axis),
            ] {
                prop_assert!(one.distance(other) < 1e-6, "{key:?} {taken:?}");
            }
        }
    }
}
