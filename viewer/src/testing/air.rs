//! The air in a picture against the twin on the CPU: sky, limb and ground, by day and at dusk.

use areoid_formats::body::Ellipsoid;
use areoid_formats::geodesy::{Geographic, surface_normal};
use areoid_formats::grid::Outline;
use areoid_formats::page::Kind;
use areoid_formats::projection::{Crs, Projection};
use areoid_formats::units::{Degrees, Meters};
use glam::DVec3;

use super::{Planet, dataset, gpu};
use crate::atmosphere::{Air, Atmosphere, STEPS};
use crate::camera::Pose;
use crate::surface::BARE_COLOR;
use crate::{Light, Options, Renderer};

const SIDE: u32 = 64;
const AMBIENT: f64 = 0.05;

fn code(linear: f64) -> f64 {
    let linear = linear.clamp(0.0, 1.0);
    let encoded =
        if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
    255.0 * encoded
}

/// The largest difference in codes between a picture of a level planet and the twin.
fn worst(
    body: Ellipsoid,
    atmosphere: Atmosphere,
    [altitude, pitch, fov]: [f64; 3],
    sun: DVec3,
) -> f64 {
    let mut planet = Planet::default();
    let degrees = Crs::new(Projection::Geographic, body);
    let outline = Outline { origin: [-180.0, 90.0], pixel_size: [5.0; 2], width: 72, height: 36 };
    planet.add(dataset("level", Kind::Height, degrees, outline, 64, 0), |_| ([0.0; 3], 255));
    let selection = planet.selection(|_| true);
    let at = Geographic::from_degrees(Degrees(20.0), Degrees(30.0));
    let (heading, pitch) = (Degrees(50.0).into(), Degrees(pitch).into());
    let pose = Pose::from_eye(&body, at, Meters(altitude), heading, pitch);
    let view = pose.view(Degrees(fov).into(), [SIDE; 2], 1.0);

    let light = Light { toward_sun: sun, ambient: AMBIENT };
    let options = Options { atmosphere: Some(atmosphere), exposure: 1.5, ..Options::default() };
    let mut renderer = Renderer::new(gpu(), body);
    renderer.render(&view, &selection, &light, &options);
    let (image, aovs) = (renderer.read_color(), renderer.read_aovs());

    let air = Air::new(&body, atmosphere, view.eye, sun.normalize());
    let ground = BARE_COLOR.map(|code| ((code / 255.0 + 0.055) / 1.055).powf(2.4));
    let mut worst = 0.0_f64;
    for (i, pixel) in image.rgba.chunks_exact(4).enumerate() {
        let (x, y) = (i % SIDE as usize, i / SIDE as usize);
        let tangent = (view.vertical_fov.0 / 2.0).tan();
        let across = |at: usize| (2.0 * (at as f64 + 0.5) / f64::from(SIDE) - 1.0) * tangent;
        let mut direction =
            (view.orientation * DVec3::new(across(x), -across(y), -1.0)).normalize();
        let [longitude, latitude] = aovs.geographic[i];
        let (mut behind, mut end) = (DVec3::ZERO, f64::MAX);
        if !longitude.is_nan() {
            let place = Geographic::from_degrees(Degrees(longitude), Degrees(latitude));
            let offset = body.cartesian_from_geographic(place, Meters(0.0)) - view.eye;
            (direction, end) = (offset.normalize(), offset.length());
            let normal = surface_normal(place);
            let sunlight = air.sunlight(0.0, normal.dot(air.sun)) * normal.dot(air.sun).max(0.0);
            behind = DVec3::from_array(ground) * (AMBIENT + (1.0 - AMBIENT) * sunlight);
        }
        let seen = air.along(direction, end, STEPS);
        let expected = (behind * seen.transmittance + seen.light) * options.exposure;
        for channel in 0..3 {
            worst = worst.max((f64::from(pixel[channel]) - code(expected[channel])).abs());
        }
    }
    worst
}

#[test]
fn the_air_is_that_of_the_twin() {
    let earth = Ellipsoid::sphere(Meters(6_371_000.0)).unwrap();
    let mars = Ellipsoid::sphere(Meters(3_396_190.0)).unwrap();
    let zenith = surface_normal(Geographic::from_degrees(Degrees(20.0), Degrees(30.0)));
    let dusk = zenith.any_orthonormal_vector() + 0.05 * zenith;
    for (name, body, atmosphere, eye, sun) in [
        ("noon", earth, Atmosphere::EARTH, [1000.0, -10.0, 60.0], zenith + DVec3::Z),
        ("limb", earth, Atmosphere::EARTH, [400_000.0, -20.0, 60.0], zenith + DVec3::X),
        ("dusk", earth, Atmosphere::EARTH, [3000.0, 0.0, 60.0], dusk),
        ("mars", mars, Atmosphere::MARS, [2000.0, -5.0, 60.0], zenith - 0.5 * DVec3::Y),
        ("disc", mars, Atmosphere::MARS, [9e6, -90.0, 60.0], dusk),
        ("far disc", mars, Atmosphere::MARS, [1e9, -90.0, 0.5], zenith + dusk),
        ("far Earth", earth, Atmosphere::EARTH, [1e9, -90.0, 0.9], dusk),
    ] {
        let off = worst(body, atmosphere, eye, sun);
        println!("{name}: at most {off:.2} codes");
        assert!(off < 4.0, "{name}: {off}");
    }
}
