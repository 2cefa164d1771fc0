//! What is under a pixel, from the pages in memory, in f64: nobody waits for the GPU.

use areoid_cache::View;
use areoid_formats::body::Ellipsoid;
use areoid_formats::geodesy::Geographic;
use areoid_formats::page::Kind;
use glam::DVec3;

use crate::blend::Vantage;
use crate::surface::{Surface, SurfacePoint};

/// A place of the surface drawn.
#[derive(Clone, Debug, PartialEq)]
pub struct Picked {
    /// Where.
    pub place: Geographic,
    /// The composed height there from the finest pages in memory, without exaggeration, and where it
    /// comes from; none if no dataset has any.
    pub height: Option<SurfacePoint>,
}

/// Samples of a ray between the shells that hold the terrain.
const STEPS: u32 = 256;
/// Halvings of the step in which it goes under.
const HALVINGS: u32 = 40;

/// What the ray through a place of the picture, in pixels from its top left, meets first.
///
/// # Precision
///
/// Ridges narrower than 1/256 of the ray's way through the terrain may be missed.
#[must_use]
pub fn pick(
    surface: &Surface,
    ellipsoid: &Ellipsoid,
    view: &View,
    exaggeration: f64,
    pixel: [f64; 2],
) -> Option<Picked> {
    let direction = direction_of(view, pixel);
    let vantage = Vantage::new(view, exaggeration);
    let height_at = |distance_m: f64| {
        let point = view.eye + distance_m * direction;
        let (place, altitude) = ellipsoid.geographic_from_cartesian(point);
        let found = surface.height_seen(place, &vantage);
        let height_m = found.map_or(0.0, |found| exaggeration * found.value[0]);
        (altitude.0 - height_m, place)
    };
    let (low, high) = surface.height_range_m();
    let [outer, inner] =
        [ellipsoid.a().0 + exaggeration * high, ellipsoid.b().0 + exaggeration * low];
    let (start, beyond) = crossing(view.eye, direction, outer)?;
    // Past the middle of the planet nothing is seen.
    let end = crossing(view.eye, direction, inner).map_or(beyond, |(end, _)| end.max(start));
    let step = (end - start) / f64::from(STEPS);
    let mut before = start;
    for i in 1..=STEPS {
        let here = start + f64::from(i) * step;
        let (above, place) = height_at(here);
        if above <= 0.0 {
            let (mut near, mut far, mut found) = (before, here, place);
            for _ in 0..HALVINGS {
                let middle = 0.5 * (near + far);
                let (above, place) = height_at(middle);
                if above <= 0.0 {
                    (far, found) = (middle, place);
                } else {
                    near = middle;
                }
            }
            let height = surface.compose(Kind::Height, found, 0.0);
            return Some(Picked { place: found, height });
        }
        before = here;
    }
    None
}

/// The unit direction of a ray through a place of the picture.
fn direction_of(view: &View, [x, y]: [f64; 2]) -> DVec3 {
    let [width, height] = view.viewport.map(f64::from);
    let tangent = (view.vertical_fov.0 / 2.0).tan();
    let right = (2.0 * x / width - 1.0) * tangent * width / height;
    let up = (1.0 - 2.0 * y / height) * tangent;
    (view.orientation * DVec3::new(right, up, -1.0)).normalize()
}

/// Where a ray is inside a sphere about the center, ahead of the eye.
fn crossing(eye: DVec3, direction: DVec3, radius: f64) -> Option<(f64, f64)> {
    let along = -eye.dot(direction);
    let off = eye + along * direction;
    let half = (radius * radius - off.length_squared()).max(0.0).sqrt();
    (half > 0.0 && along + half > 0.0).then_some(((along - half).max(0.0), along + half))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Pose;
    use areoid_formats::units::{Degrees, Meters};

    fn look(pitch: f64) -> Option<Picked> {
        let body = Ellipsoid::WGS84;
        let eye = Geographic::from_degrees(Degrees(10.0), Degrees(45.0));
        let (heading, pitch) = (Degrees(0.0).into(), Degrees(pitch).into());
        let pose = Pose::from_eye(&body, eye, Meters(1e5), heading, pitch);
        let view = pose.view(Degrees(45.0).into(), [100, 80], 1.0);
        pick(&Surface::default(), &body, &view, 1.0, [50.0, 40.0])
    }

    #[test]
    fn the_middle_of_a_picture_is_what_the_eye_looks_at() {
        let below = look(-90.0).unwrap();
        assert!((Degrees::from(below.place.latitude).0 - 45.0).abs() < 1e-6, "{below:?}");
        assert!((Degrees::from(below.place.longitude).0 - 10.0).abs() < 1e-6, "{below:?}");
        assert_eq!(below.height, None);
        let ahead = look(-45.0).unwrap();
        assert!((Degrees::from(ahead.place.latitude).0 - 45.9).abs() < 0.05, "{ahead:?}");
        assert_eq!(look(10.0), None);
    }
}
