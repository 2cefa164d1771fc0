//! Pictures of real rasters, to look at: run with `AREOID_DATA` and `AREOID_GALLERY` set to
//! folders, `cargo test gallery -- --ignored`.

use std::path::PathBuf;

use areoid_cache::Selection;
use areoid_formats::body::{Body, Ellipsoid};
use areoid_formats::geodesy::{Geographic, surface_normal};
use areoid_formats::grid::Outline;
use areoid_formats::page::Kind;
use areoid_formats::projection::{Crs, PolarScale, PolarStereographic, Pole, Projection};
use areoid_formats::units::{Degrees, Meters, Radians};

use super::{Planet, dataset};
use crate::camera::Pose;
use crate::{Gpu, Light, Options, Renderer};

const NONE: i32 = -32768;

fn data(name: &str) -> PathBuf {
    PathBuf::from(std::env::var("AREOID_DATA").unwrap()).join(name)
}

fn heights(name: &str) -> (u32, u32, Vec<i32>) {
    let file = std::fs::File::open(data(name)).unwrap();
    let mut decoder = tiff::decoder::Decoder::new(file).unwrap();
    let (width, height) = decoder.dimensions().unwrap();
    let tiff::decoder::DecodingResult::I16(texels) = decoder.read_image().unwrap() else {
        panic!("int16 expected")
    };
    (width, height, texels.into_iter().map(i32::from).collect())
}

/// Coverage that falls to the outline of a square cap over 48 texels.
fn cap_coverage(value: i32, row: u32, col: u32, side: u32) -> u8 {
    let (row, col) = (f64::from(row), f64::from(col));
    let middle = f64::from(side) / 2.0 - 0.5;
    let edge = middle - (row - middle).hypot(col - middle);
    let share = (edge / 48.0).clamp(0.0, 1.0);
    if value == NONE { 0 } else { 1 + (254.0 * share) as u8 }
}

pub(crate) fn mars() -> (Ellipsoid, Selection) {
    let body = Body::parse("mars").unwrap().ellipsoid;
    let mut planet = Planet::default();
    let degrees = Crs::new(Projection::Geographic, body);
    let (width, height, texels) = heights("mola_height_8ppd.tif");
    let outline = Outline { origin: [0.0, 90.0], pixel_size: [0.125; 2], width, height };
    planet.add_texels(dataset("mola", Kind::Height, degrees, outline, 512, 0), |row, col| {
        ([texels[(row * width + col) as usize] as f32, 0.0, 0.0], 255)
    });
    for (pole, name) in
        [(Pole::North, "mola_north_polar_4km.tif"), (Pole::South, "mola_south_polar_4km.tif")]
    {
        let (side, _, texels) = heights(name);
        let map = PolarStereographic {
            pole,
            central_meridian: Radians(0.0),
            scale: PolarScale::AtPole(1.0),
            false_easting: Meters(0.0),
            false_northing: Meters(0.0),
        };
        let crs = Crs::new(Projection::PolarStereographic(map), body);
        let outline = Outline {
            origin: [-2_048_000.0, 2_048_000.0],
            pixel_size: [4000.0; 2],
            width: side,
            height: side,
        };
        planet.add_texels(dataset(name, Kind::Height, crs, outline, 512, 0), |row, col| {
            let value = texels[(row * side + col) as usize];
            ([value as f32, 0.0, 0.0], cap_coverage(value, row, col, side))
        });
    }
    let picture = image::open(data("viking_color.jpg")).unwrap().to_rgb8();
    let outline =
        Outline { origin: [0.0, 90.0], pixel_size: [360.0 / 2048.0; 2], width: 2048, height: 1024 };
    planet.add_texels(dataset("viking", Kind::Color, degrees, outline, 512, 0), |row, col| {
        (picture.get_pixel(col, row).0.map(f32::from), 255)
    });
    (body, planet.selection(|_| true))
}

#[test]
#[ignore = "draws for the eye"]
fn gallery_of_mars() {
    let folder = PathBuf::from(std::env::var("AREOID_GALLERY").unwrap());
    let (body, selection) = mars();
    let gpu = Gpu::headless().unwrap();
    println!("{}", gpu.description());
    let mut renderer = Renderer::new(&gpu, body);
    let at = |longitude, latitude| Geographic::from_degrees(Degrees(longitude), Degrees(latitude));
    let scenes = [
        ("disc", at(-70.0, -5.0), 9e6, 0.0, -90.0, 45.0, 1.0),
        ("pole", at(0.0, 90.0), 3e6, 0.0, -90.0, 45.0, 1.0),
        ("south", at(30.0, -89.0), 1.5e6, 0.0, -90.0, 45.0, 1.0),
        ("meridian", at(0.0, 10.0), 2e6, 0.0, -90.0, 45.0, 1.0),
        ("canyon", at(-70.0, -18.0), 60e3, 0.0, -12.0, 60.0, 1.0),
        ("olympus", at(-134.0, 8.0), 300e3, 0.0, -20.0, 45.0, 3.0),
        ("ground", at(-60.0, -12.0), 6e3, 0.0, 0.0, 60.0, 1.0),
    ];
    for (name, place, altitude, heading, pitch, fov, exaggeration) in scenes {
        let pose = Pose::from_eye(
            &body,
            place,
            Meters(altitude),
            Degrees(heading).into(),
            Degrees(pitch).into(),
        );
        let view = pose.view(Degrees(fov).into(), [1280, 720], 1.0);
        let sun = surface_normal(Geographic {
            longitude: Radians(place.longitude.0 - 0.9),
            latitude: Radians(0.3),
        });
        let light = Light { toward_sun: sun, ambient: 0.05 };
        let options = Options { vertical_exaggeration: exaggeration, ..Options::default() };
        let start = std::time::Instant::now();
        let first = renderer.render(&view, &selection, &light, &options);
        let built = start.elapsed();
        let picture = renderer.read_color();
        println!("{name}: {first:?} cpu {built:?} all {:?}", start.elapsed());
        let (width, height) = (picture.width, picture.height);
        image::RgbaImage::from_raw(width, height, picture.rgba)
            .unwrap()
            .save(folder.join(format!("{name}.png")))
            .unwrap();
    }
}

#[test]
#[ignore = "needs a display and a hand"]
fn window_of_mars() {
    let (ellipsoid, selection) = mars();
    let selection = std::sync::Arc::new(selection);
    let start = Geographic::from_degrees(Degrees(-70.0), Degrees(-5.0));
    let options = crate::window::WindowOptions {
        title: "Mars".to_owned(),
        ellipsoid,
        start,
        tolerance_px: 2.0,
    };
    crate::window::run(options, |_| selection.clone()).unwrap();
}
