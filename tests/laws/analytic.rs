//! An analytic planet: heights against the truth, the poles and the antimeridian among all places.

use tempfile::TempDir;

use crate::support::areoid::{heights, ingest};
use crate::support::geotiff::{Samples, Writing};
use crate::support::levels::Edge;
use crate::support::raster::{Place, Random, Raster, pixel_center, planet};

/// The greatest error at `points`, in meters.
fn greatest(catalog: &std::path::Path, points: &[[f64; 2]]) -> f64 {
    let errors = points.iter().zip(heights(catalog, points, &[])).map(|(point, found)| {
        let [longitude, latitude] = point.map(f64::to_radians);
        (found.unwrap() - planet(longitude, latitude)).abs()
    });
    errors.fold(0.0, f64::max)
}

/// Points in a box of degrees.
fn points(random: &mut Random, west: f64, south: f64, east: f64, north: f64) -> Vec<[f64; 2]> {
    let mut between = |low: f64, high: f64| low + random.unit() * (high - low);
    (0..4000).map(|_| [between(west, east), between(south, north)]).collect()
}

#[test]
fn heights_are_the_truth_within_the_error_of_interpolation() {
    let size = (360, 720);
    let areas = Place::Globe(Edge::PoleOnOutline, Edge::PoleOnOutline);
    let raster = Raster::new(areas, size, None, |row, col| {
        let (latitude, longitude) = pixel_center((row, col), size);
        planet(longitude, latitude) as f32
    });
    let folder = TempDir::new().unwrap();
    let file = Writing::of(&raster, Samples::Float32).write(&raster, folder.path(), "planet.tif");
    let catalog = folder.path().join("catalog");
    ingest(&catalog, &file, &["--page-size", "130"]);

    // Bilinear: h²/8 of the second derivatives, at most degree · (degree + 1) of the height's
    // 6000 m in sum, and 2⁻²⁴ of them for float32.
    let pixel_rad = 0.5_f64.to_radians();
    let interpolation = 6000.0 * (pixel_rad * pixel_rad / 8.0 * 72.0 + 2.0_f64.powi(-24));
    let mut random = Random(30);
    let mut error = |west, south, east, north| {
        greatest(&catalog, &points(&mut random, west, south, east, north))
    };
    let elsewhere = error(-170.0, -60.0, 170.0, 60.0);
    assert!(elsewhere > 0.0 && elsewhere < interpolation, "{elsewhere}");
    for (place, error) in [
        ("the north pole", error(-180.0, 88.0, 180.0, 90.0)),
        ("the south pole", error(-180.0, -90.0, 180.0, -88.0)),
        ("the last row at the north pole", error(-180.0, 89.75, 180.0, 90.0)),
        ("the last row at the south pole", error(-180.0, -90.0, 180.0, -89.75)),
        ("the antimeridian", error(179.0, -90.0, 181.0, 90.0)),
        ("the last column at the antimeridian", error(179.75, -80.0, 180.25, 80.0)),
    ] {
        assert!(error <= 1.2 * elsewhere, "{error} at {place}, {elsewhere} elsewhere");
    }
}

/// On the seams themselves, from both sides and in any turn, a place has one height.
#[test]
fn the_seams_have_one_height() {
    for (rows, cols, south) in [(96, 192, Edge::PoleOnOutline), (97, 192, Edge::PoleOnPosts)] {
        let raster = Raster::new(Place::Globe(south, south), (rows, cols), None, |row, col| {
            let latitude = match south {
                Edge::PoleOnPosts => 90.0 - 180.0 * row as f64 / (rows - 1) as f64,
                _ => 90.0 - 180.0 * (row as f64 + 0.5) / rows as f64,
            };
            let longitude = 360.0 * (col as f64 + 0.5) / cols as f64 - 180.0;
            planet(longitude.to_radians(), latitude.to_radians()) as f32
        });
        let folder = TempDir::new().unwrap();
        let file = Writing::of(&raster, Samples::Float32).write(&raster, folder.path(), "p.tif");
        let catalog = folder.path().join("catalog");
        ingest(&catalog, &file, &["--page-size", "18"]);
        for level in ["0", "1", "2", "9"] {
            let at = |points: &[[f64; 2]]| -> Vec<f64> {
                let found = heights(&catalog, points, &["--level", level]);
                found.into_iter().map(|height| height.unwrap()).collect()
            };
            let latitudes = (-900..=900).map(|tenth| f64::from(tenth) / 10.0);
            let seam = |longitude: f64| -> Vec<[f64; 2]> {
                latitudes.clone().map(|latitude| [longitude, latitude]).collect()
            };
            let here = at(&seam(180.0));
            for longitude in [-180.0, 540.0, 180.0 - 1e-9, -180.0 + 1e-9, 180.0 - 1e-13] {
                for (one, other) in here.iter().zip(at(&seam(longitude))) {
                    assert!((one - other).abs() < 1e-3, "{one} and {other} at {longitude}");
                }
            }
            for pole in [90.0, -90.0] {
                let around: Vec<[f64; 2]> =
                    (0..720).map(|half| [f64::from(half) / 2.0, pole]).collect();
                let inside: Vec<[f64; 2]> =
                    around.iter().map(|point| [point[0], pole * (1.0 - 1e-12)]).collect();
                let (on, near) = (at(&around), at(&inside));
                for (one, other) in on.iter().zip(&near) {
                    assert!((one - other).abs() < 1e-3, "{one} and {other} at {pole}");
                }
                // Across an outline at the pole, what lies half a turn away is the same place.
                for (half, one) in on.iter().enumerate() {
                    let other = on[(half + 360) % 720];
                    let same = south == Edge::PoleOnPosts || (one - other).abs() < 1e-3;
                    assert!(same, "{one} and {other} half a turn apart at {pole}");
                }
            }
        }
    }
}
