//! What all passes of a picture share, of the view and of how it is drawn.

use areoid_cache::View;
use areoid_formats::body::Ellipsoid;
use bytemuck::Zeroable;
use glam::DVec3;

use super::options::{Light, Options};
use crate::camera::pixel_angle;
use crate::mirror;
use crate::style::{Ramp, Style};
use crate::surface::BARE_COLOR;

/// Samples of color that a pixel takes at most, whatever is asked for.
const MOST_SAMPLES: u32 = 16;

/// The constants for the shaders; those of the geometry and of the pages are still to be filled in.
#[expect(clippy::cast_possible_truncation, reason = "angles, factors and the body's radius")]
pub(super) fn scene_of(
    view: &View,
    ellipsoid: &Ellipsoid,
    light: &Light,
    options: &Options,
) -> mirror::Scene {
    let tangent = (view.vertical_fov.0 / 2.0).tan();
    let aspect = f64::from(view.viewport[0]) / f64::from(view.viewport[1]);
    let axis = |axis: DVec3| axis.as_vec3().to_array();
    let ramp = options.style.ramp.as_ref();
    mirror::Scene {
        right: axis(view.orientation.x_axis),
        focal_x: (1.0 / (tangent * aspect)) as f32,
        up: axis(view.orientation.y_axis),
        focal_y: (1.0 / tangent) as f32,
        backward: axis(view.orientation.z_axis),
        sun: axis(light.toward_sun.normalize()),
        ambient: light.ambient as f32,
        background: options.background.map(|code| f32::from(code) / 255.0),
        exaggeration: options.vertical_exaggeration as f32,
        viewport: view.viewport,
        equatorial_radius: ellipsoid.a().0 as f32,
        eccentricity2: ellipsoid.eccentricity_squared() as f32,
        bare: BARE_COLOR.map(|code| (code / 255.0) as f32),
        pixel_angle: pixel_angle(view) as f32,
        stops: mirrored_stops(&options.style),
        ramp_stops: ramp.map_or(0, |ramp| ramp.stops.len() as u32),
        ramp_opacity: ramp.map_or(0.0, |ramp| ramp.opacity as f32),
        anisotropy: options.anisotropy.min(MOST_SAMPLES).cast_signed(),
        exposure: options.exposure as f32,
        relief: options.relief.map_or([0.0; 3], |relief| {
            let (sin_azimuth, cos_azimuth) = relief.azimuth.0.sin_cos();
            let (up, across) = relief.elevation.0.sin_cos();
            axis(DVec3::new(sin_azimuth * across, cos_azimuth * across, up))
        }),
        debug: options.debug as u32,
        tolerance_px: view.tolerance_px as f32,
        ..mirror::Scene::zeroed()
    }
}

/// Colors and heights of all ramps.
fn mirrored_stops(style: &Style) -> [[f32; 4]; Ramp::MOST_STOPS_IN_ALL] {
    let mut mirrored = [[0.0; 4]; Ramp::MOST_STOPS_IN_ALL];
    for (to, stop) in mirrored.iter_mut().zip(style.stops()) {
        let [red, green, blue] = stop.color.map(|code| f32::from(code) / 255.0);
        *to = [red, green, blue, stop.height_m];
    }
    mirrored
}
