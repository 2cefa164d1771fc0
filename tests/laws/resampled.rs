//! Laws 1 to 4 on grids that are not their rasters' own: what is stored is held against the oracle's
//! levels of the stored leaves, and these against the raster.

use areoid_formats::archive::Archive;
use areoid_formats::grid::Outline;
use areoid_formats::page::Texels;
use areoid_formats::pyramid::PoleContact;
use tempfile::TempDir;

use crate::support::areoid::{assert_verified, ingest, only_archive};
use crate::support::geotiff::{Samples, Writing};
use crate::support::lawful::assert_levels_lawful;
use crate::support::levels::{Edge, Shape};
use crate::support::raster::{Codes, Place, Random, Raster};

const GLOBE: Place = Place::Globe(Edge::PoleOnOutline, Edge::PoleOnOutline);

/// The finest level of an archive as a raster.
fn leaves(archive: &Archive, step: Option<(f64, f64)>) -> Raster {
    let description = archive.description();
    let pyramid = description.grid.pyramid();
    let extent = pyramid.extent();
    let edge = |contact| match contact {
        PoleContact::None => Edge::Repeat,
        PoleContact::Outline => Edge::PoleOnOutline,
        PoleContact::Posts => Edge::PoleOnPosts,
    };
    let (width, height) = (extent.width as usize, extent.height as usize);
    let (north, south) = (edge(extent.north), edge(extent.south));
    let shape = Shape { width, height, wraps: extent.wraps, north, south };
    let channels = if description.kind == areoid_formats::page::Kind::Height { 1 } else { 3 };
    let mut planes = vec![vec![f32::NAN; width * height]; channels];
    let interior = pyramid.interior() as usize;
    for entry in archive.entries().unwrap() {
        if entry.page.level != pyramid.finest() {
            continue;
        }
        let page = archive.page(&entry).unwrap();
        let (rows, cols) = pyramid.interior_size(entry.page);
        for (row, col) in (0..rows as usize).flat_map(|r| (0..cols as usize).map(move |c| (r, c))) {
            if page.coverage_at(row + 1, col + 1) == 0 {
                continue;
            }
            let at = (row + 1) * page.side() + col + 1;
            let to = (entry.page.row as usize * interior + row) * width
                + entry.page.col as usize * interior
                + col;
            match page.texels() {
                Texels::Height(heights) => planes[0][to] = heights[at],
                Texels::Color(colors) => {
                    (0..3).for_each(|channel| planes[channel][to] = colors[at][channel].into());
                }
            }
        }
    }
    let (origin, pixel_size) = (description.grid.origin(), description.grid.pixel_size());
    let outline = Outline { origin, pixel_size, width: extent.width, height: extent.height };
    Raster { shape, outline, planes, step, codes: Codes::Colors, mip: description.mip }
}

/// Ingests a raster onto other grids, and holds every one against the laws; returns the archives.
fn check(raster: &Raster, samples: Samples, step: Option<(f64, f64)>) -> Vec<Archive> {
    let folder = TempDir::new().unwrap();
    let file = Writing::of(raster, samples).write(raster, folder.path(), "raster.tif");
    let mut archives = Vec::new();
    for options in [
        &["--grid", "polar-north", "--kernel", "spline"][..],
        &["--grid", "polar-south", "--kernel", "bilinear", "--mip", "kaiser"],
        &["--grid", "equirectangular", "--pixel-size-m", "700000", "--kernel", "average"],
        &["--pixel-size-m", "230000", "--kernel", "cubic", "--limit-range", "--mip", "kaiser"],
    ] {
        let catalog = folder.path().join(format!("catalog {}", archives.len()));
        ingest(&catalog, &file, &[options, &["--page-size", "18"]].concat());
        let archive = only_archive(&catalog);
        assert!(archive.description().resampling.is_some());
        assert_levels_lawful(&archive, &leaves(&archive, step));
        assert_verified(&catalog, &file);
        let summary = archive.summary().unwrap();
        let errors = summary.levels.iter().map(|level| level.source_error_max);
        assert!(errors.fold(0.0, f32::max) > 0.0, "{options:?} hits every pixel");
        archives.push(archive);
    }
    archives
}

/// Law 4 besides: kernels overshoot, but nothing shows of the sentinel.
#[test]
fn whole_heights_and_a_sentinel() {
    let mut random = Random(31);
    let raster = Raster::new(GLOBE, (64, 128), None, |row, col| {
        let hole = random.unit() < 0.05 || (row / 9 + col / 11) % 5 == 0;
        if hole { f32::NAN } else { (random.unit() * 900.0).round() as f32 }
    });
    for archive in check(&raster, Samples::Int16(-32768), Some((1.0, 0.0))) {
        for entry in archive.entries().unwrap() {
            let page = archive.page(&entry).unwrap();
            let Texels::Height(heights) = page.texels() else {
                panic!("{} is no height", entry.page)
            };
            for height in heights.iter().filter(|height| !height.is_nan()) {
                assert!((-900.0..=1800.0).contains(height), "{} shows {height}", entry.page);
            }
        }
    }
}

#[test]
fn floats_over_both_poles() {
    let mut random = Random(32);
    let raster = Raster::new(GLOBE, (48, 96), None, |row, col| {
        let slope = 30.0 * row as f64 + 200.0 * (col as f64 / 9.0).sin();
        (slope + random.unit()) as f32
    });
    check(&raster, Samples::Float32, None);
}

/// Without holes: beside those alpha is resampled, too, which the oracle has no word for.
#[test]
fn colors() {
    let mut random = Random(33);
    let mut raster =
        Raster::new(GLOBE, (40, 80), None, |_, _| (random.unit() * 255.0).round() as f32);
    let red = raster.planes[0].clone();
    raster.planes.push(red.iter().map(|red| 255.0 - red).collect());
    raster.planes.push(red.iter().map(|red| (red / 16.0).floor() * 16.0).collect());
    check(&raster, Samples::Color, None);
}

/// Resampled heights were rounded to the raster's whole meters first.
#[test]
fn heights_on_a_finer_step_keep_what_whole_meters_lose() {
    let mut random = Random(33);
    let raster = Raster::new(GLOBE, (32, 64), None, |_, _| (random.unit() * 900.0).round() as f32);
    let folder = TempDir::new().unwrap();
    let file =
        Writing::of(&raster, Samples::Int16(-32768)).write(&raster, folder.path(), "raster.tif");
    let catalog = folder.path().join("catalog");
    let options = ["--grid", "polar-north", "--page-size", "18", "--step-m", "0.125"];
    ingest(&catalog, &file, &options);
    let archive = only_archive(&catalog);
    let heights = archive.entries().unwrap().into_iter().flat_map(|entry| {
        let page = archive.page(&entry).unwrap();
        let Texels::Height(heights) = page.texels() else { panic!("{} is no height", entry.page) };
        heights.clone()
    });
    let heights: Vec<f32> = heights.filter(|height| !height.is_nan()).collect();
    assert!(heights.iter().all(|height| (height * 8.0).fract() == 0.0));
    let between = heights.iter().filter(|height| height.fract() != 0.0).count();
    assert!(between * 2 > heights.len(), "{between} of {}", heights.len());
}
