//! Laws 1 to 4 on rasters as they come: read from files by the command line, every page held
//! against brute force, and `areoid verify` content with each.

use areoid_formats::grid::Outline;
use tempfile::TempDir;

use crate::support::areoid::{assert_verified, ingest, only_archive};
use crate::support::geotiff::{Samples, Writing};
use crate::support::lawful::{Tightness, assert_lawful};
use crate::support::levels::Edge;
use crate::support::raster::{Place, Random, Raster, pixel_center, planet};

const METERS: Option<(f64, f64)> = Some((1.0, 0.0));

/// Whole meters of a planet with ten meters of noise.
fn globe(rows: usize, cols: usize) -> Raster {
    let mut random = Random(5);
    let place = Place::Globe(Edge::PoleOnOutline, Edge::PoleOnOutline);
    Raster::new(place, (rows, cols), METERS, |row, col| {
        let (latitude, longitude) = pixel_center((row, col), (rows, cols));
        (planet(longitude, latitude) + 20.0 * random.unit() - 10.0).round() as f32
    })
}

/// Writes, ingests, verifies, and holds every page against the oracle.
fn check(raster: &Raster, writing: Writing, options: &[&str]) -> Vec<Tightness> {
    let folder = TempDir::new().unwrap();
    let file = writing.write(raster, folder.path(), "raster.tif");
    let catalog = folder.path().join("catalog");
    ingest(&catalog, &file, options);
    assert_verified(&catalog, &file);
    assert_lawful(&only_archive(&catalog), raster)
}

#[test]
fn a_globe_that_halves_evenly() {
    let raster = globe(1024, 2048);
    let tightness = check(&raster, Writing::of(&raster, Samples::Int16(i16::MIN)), &[]);
    assert_eq!(tightness.len(), 4);
    assert_eq!((tightness[0].bound, tightness[0].exact), (0.0, 0.0));
    // A loose bound makes views fetch pages that they do not need.
    for level in &tightness[1..] {
        assert!(level.bound < 1.5 * level.exact, "{tightness:?}");
    }
}

#[test]
fn a_globe_that_stops_at_three_pages_by_two() {
    let raster = globe(1350, 2700);
    let tightness = check(&raster, Writing::of(&raster, Samples::Int16(i16::MIN)), &[]);
    assert_eq!(tightness.len(), 2);
    assert!(tightness[1].bound < 1.01 * tightness[1].exact, "{tightness:?}");
}

#[test]
fn a_region_with_holes() {
    let mut random = Random(9);
    let raster = Raster::new(Place::Region, (500, 700), METERS, |row, col| {
        let (x, y) = (col as f64 / 40.0, row as f64 / 30.0);
        let hole = (x * 1.3).sin() * (y * 1.7).cos() > 0.85 || random.unit() < 0.002;
        let height = 800.0 * x.sin() * y.cos() + 30.0 * random.unit();
        if hole { f32::NAN } else { height.round() as f32 }
    });
    let writing = Writing::of(&raster, Samples::Int16(-32768));
    check(&raster, writing, &["--page-size", "66"]);
    check(&raster, writing, &["--page-size", "512"]);
    let stepped = Raster { step: Some((10.0, 0.0)), ..raster };
    check(&stepped, writing, &["--page-size", "66", "--step-m", "10"]);
}

#[test]
fn a_polar_map_with_nan_outside_a_disc() {
    let mut random = Random(11);
    let raster = Raster::new(Place::Region, (333, 401), None, |row, col| {
        let (x, y) = (col as f64 - 200.0, row as f64 - 166.0);
        let inside = x * x + y * y < 150.0 * 150.0 && x * x + y * y > 20.0 * 20.0;
        let height = 1000.0 * (x / 30.0).sin() * (y / 50.0).cos() + random.unit();
        if inside { height as f32 } else { f32::NAN }
    });
    let outline = Outline {
        origin: [-2_005_000.0, 1_665_000.0],
        pixel_size: [10_000.0; 2],
        ..raster.outline
    };
    for samples in [Samples::Float32, Samples::Float32With(3.4e38)] {
        let writing = Writing { outline, projected: Some(3031), ..Writing::of(&raster, samples) };
        check(&raster, writing, &["--page-size", "66"]);
    }
}

#[test]
fn a_globe_of_posts_whose_last_column_repeats_the_first() {
    for (rows, cols) in [(181, 360), (361, 720)] {
        let mut random = Random(13);
        let place = Place::Globe(Edge::PoleOnPosts, Edge::PoleOnPosts);
        let raster = Raster::new(place, (rows, cols), METERS, |row, col| {
            let latitude = (90.0 - 180.0 * row as f64 / (rows - 1) as f64).to_radians();
            let longitude = (360.0 * col as f64 / cols as f64).to_radians();
            let noise = if row == 0 || row == rows - 1 { 0.0 } else { 20.0 * random.unit() };
            (planet(longitude, latitude) + noise).round() as f32
        });
        for points in [false, true] {
            let writing =
                Writing { points, closed: true, ..Writing::of(&raster, Samples::Int16(i16::MIN)) };
            check(&raster, writing, &["--page-size", "66"]);
        }
    }
}
