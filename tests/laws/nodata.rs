//! Law 4: what stands for no data is never blended, filtered or shown.

use areoid_formats::page::Texels;
use tempfile::TempDir;

use crate::support::areoid::{heights, ingest, only_archive};
use crate::support::geotiff::{Samples, Writing};
use crate::support::levels::Edge;
use crate::support::raster::{Place, Random, Raster};

/// Heights within ±100 m, a fifth of them missing, the antimeridian and a pole among those.
fn holey(place: Place, size: (usize, usize)) -> Raster {
    let mut random = Random(21);
    Raster::new(place, size, None, |row, col| {
        let height = (200.0 * random.unit() - 100.0).round() as f32;
        let hole = random.unit() < 0.1 || (row / 6 + col / 6) % 4 == 0 || row < 3;
        if hole { f32::NAN } else { height }
    })
}

#[test]
fn sentinels_leave_no_trace() {
    let globe = Place::Globe(Edge::PoleOnOutline, Edge::PoleOnOutline);
    for (place, size) in [(Place::Region, (77, 95)), (globe, (64, 128))] {
        for samples in [
            Samples::Int16(-32768),
            Samples::Int16(32767),
            Samples::Float32,
            Samples::Float32With(3.4e38),
            Samples::Float32With(-3.4028235e38),
        ] {
            let raster = holey(place, size);
            let folder = TempDir::new().unwrap();
            let file = Writing::of(&raster, samples).write(&raster, folder.path(), "holey.tif");
            for mip in ["mean", "kaiser"] {
                let catalog = folder.path().join(mip);
                ingest(&catalog, &file, &["--page-size", "18", "--mip", mip]);
                check_texels(&catalog);
                check_heights(&catalog, &raster);
            }
        }
    }
}

/// Every texel and every figure of every page lies within the range of the valid samples.
fn check_texels(catalog: &std::path::Path) {
    let archive = only_archive(catalog);
    for entry in archive.entries().unwrap() {
        let page = archive.page(&entry).unwrap();
        let Texels::Height(texels) = page.texels() else { panic!("{} is no height", entry.page) };
        for (at, texel) in texels.iter().enumerate() {
            let covered = page.coverage().is_none_or(|coverage| coverage[at] != 0);
            assert_eq!(covered, !texel.is_nan(), "{}", entry.page);
            assert!(!covered || texel.abs() <= 100.0, "{} shows {texel}", entry.page);
        }
        for figure in [entry.min, entry.max, entry.lowest, entry.highest] {
            assert!(figure.is_nan() || figure.abs() <= 100.0, "{}: {figure}", entry.page);
        }
        // Intervals add up to a little more than the 200 m between any two heights.
        assert!(entry.bound <= 400.0, "{}: {}", entry.page, entry.bound);
    }
}

/// At a missing pixel's center there is no height; anywhere else none outside the range.
fn check_heights(catalog: &std::path::Path, raster: &Raster) {
    let [left, top] = raster.outline.origin;
    let [pixel_x, pixel_y] = raster.outline.pixel_size;
    let at = |x: f64, y: f64| [left + x * pixel_x, top - y * pixel_y];
    let (width, height) = (raster.shape.width, raster.shape.height);
    let centers: Vec<[f64; 2]> = (0..width * height)
        .map(|place| at((place % width) as f64 + 0.5, (place / width) as f64 + 0.5))
        .collect();
    for (sample, found) in raster.planes[0].iter().zip(heights(catalog, &centers, &[])) {
        match found {
            Some(found) => assert!((found - f64::from(*sample)).abs() < 1e-6, "{found}, {sample}"),
            None => assert!(sample.is_nan(), "{sample} is missing"),
        }
    }
    let mut random = Random(4);
    let anywhere: Vec<[f64; 2]> = (0..2000)
        .map(|_| at(random.unit() * width as f64, random.unit() * height as f64))
        .collect();
    for level in ["0", "1", "2", "3"] {
        for found in heights(catalog, &anywhere, &["--level", level]).into_iter().flatten() {
            assert!(found.abs() <= 100.0 + 1e-9, "{found} at level {level}");
        }
    }
}
