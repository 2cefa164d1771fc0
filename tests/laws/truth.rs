//! Mars: heights against 20,000 exact values of the field that the demo raster was made from, and
//! against plain bilinear interpolation of the raster, written out here once more.

use std::fs::File;
use std::path::{Path, PathBuf};

use tempfile::TempDir;
use tiff::decoder::{Decoder, DecodingResult};

use crate::support::areoid::{assert_verified, heights, ingest};

/// Pixels of the demo raster.
const SIZE: (usize, usize) = (1440, 2880);

pub(super) fn demo(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("demo/mars").join(name)
}

/// The samples of a demo raster, rows downward.
fn samples(name: &str, size: (u32, u32)) -> Vec<i16> {
    let mut decoder = Decoder::new(File::open(demo(name)).unwrap()).unwrap();
    assert_eq!(decoder.dimensions().unwrap(), size);
    let DecodingResult::I16(samples) = decoder.read_image().unwrap() else {
        panic!("the raster is int16")
    };
    samples
}

/// Plain bilinear interpolation: rows turned over the poles, columns wrapped.
fn bilinear(samples: &[i16], [longitude, latitude]: [f64; 2]) -> f64 {
    let (rows, cols) = SIZE;
    let (x, y) = (longitude * 8.0 - 0.5, (90.0 - latitude) * 8.0 - 0.5);
    let (left, top) = (x.floor(), y.floor());
    let (right_weight, below_weight) = (x - left, y - top);
    let sample = |row: i64, col: i64| {
        let (rows, cols) = (rows as i64, cols as i64);
        let (row, turn) = match row {
            row if row < 0 => (-1 - row, cols / 2),
            row if row >= rows => (2 * rows - 1 - row, cols / 2),
            row => (row, 0),
        };
        f64::from(samples[(row * cols + (col + turn).rem_euclid(cols)) as usize])
    };
    let (row, col) = (top as i64, left as i64);
    let across =
        |row| sample(row, col) * (1.0 - right_weight) + sample(row, col + 1) * right_weight;
    across(row) * (1.0 - below_weight) + across(row + 1) * below_weight
}

/// Position and height of the exact values.
pub(super) fn truth() -> Vec<([f64; 2], f64)> {
    let text = std::fs::read_to_string(demo("truth_points.csv")).unwrap();
    let numbers =
        |line: &str| -> Vec<f64> { line.split(',').map(|n| n.parse().unwrap()).collect() };
    text.lines()
        .skip(1)
        .map(|line| match numbers(line)[..] {
            [longitude, latitude, height] => ([longitude, latitude], height),
            _ => panic!("{line}"),
        })
        .collect()
}

/// Positions and heights of the same field on a map of a pole, to half a meter: a quarter of its pixels.
pub(super) fn polar_truth(hemisphere: &str) -> Vec<([f64; 2], f64)> {
    const SIDE: usize = 1024;
    const MISSING: i16 = -32768;
    let samples = samples(&format!("mola_{hemisphere}_polar_4km.tif"), (1024, 1024));
    let places = (0..SIDE).flat_map(|row| (0..SIDE).map(move |col| (row, col)));
    let shown = places.filter(|(row, col)| samples[row * SIDE + col] != MISSING);
    shown
        .map(|(row, col)| {
            // Meters at the pole, on a plane that touches the sphere there.
            let [east, up] = [col as f64 - 511.5, 511.5 - row as f64].map(|pixels| pixels * 4000.0);
            let from_pole = 2.0 * (east.hypot(up) / (2.0 * 3_396_190.0)).atan();
            let (sign, longitude) = match hemisphere {
                "north" => (1.0, east.atan2(-up)),
                _ => (-1.0, east.atan2(up)),
            };
            let latitude = sign * (90.0 - from_pole.to_degrees());
            ([longitude.to_degrees(), latitude], f64::from(samples[row * SIDE + col]))
        })
        .collect()
}

/// The error that a share of the errors does not pass.
fn quantile(errors: &mut [f64], share: f64) -> f64 {
    errors.sort_by(f64::total_cmp);
    errors[((errors.len() - 1) as f64 * share) as usize]
}

#[test]
fn mars_is_as_high_as_it_is() {
    let folder = TempDir::new().unwrap();
    let catalog = folder.path().join("catalog");
    ingest(&catalog, &demo("mola_height_8ppd.tif"), &["--name", "raster"]);
    assert_verified(&catalog, &demo("mola_height_8ppd.tif"));
    let samples = samples("mola_height_8ppd.tif", (2880, 1440));

    let truth = truth();
    assert_eq!(truth.len(), 20_000);
    let points: Vec<[f64; 2]> = truth.iter().map(|(point, _)| *point).collect();
    let found: Vec<f64> =
        heights(&catalog, &points, &[]).into_iter().map(|height| height.unwrap()).collect();

    for (point, found) in points.iter().zip(&found) {
        let expected = bilinear(&samples, *point);
        assert!((found - expected).abs() < 1e-6, "{found} at {point:?}, bilinear {expected}");
    }

    // A tenth of the points was put on and beside the poles and two meridians.
    let seam = |[longitude, latitude]: [f64; 2]| {
        latitude.abs() > 89.0 || longitude % 180.0 < 0.5 || longitude % 180.0 > 179.5
    };
    let errors = |choose: &dyn Fn([f64; 2]) -> bool| -> Vec<f64> {
        let pairs = truth.iter().zip(&found).filter(|((point, _), _)| choose(*point));
        pairs.map(|((_, height), found)| (found - height).abs()).collect()
    };
    for (place, mut errors, least) in
        [("anywhere", errors(&|_| true), 19_000), ("on poles and meridians", errors(&seam), 1500)]
    {
        assert!(errors.len() > least, "{} points {place}", errors.len());
        let (median, most) = (quantile(&mut errors, 0.5), quantile(&mut errors, 0.99));
        assert!(median <= 3.2 && most <= 65.0, "{place}: median {median}, 99 % within {most}");
    }

    // At the pixels' centers the raster comes back.
    let (rows, cols) = SIZE;
    let some: Vec<usize> = (0..rows * cols).step_by(37).collect();
    let centers: Vec<[f64; 2]> = some
        .iter()
        .map(|at| [(at % cols) as f64 / 8.0 + 0.0625, 90.0 - (at / cols) as f64 / 8.0 - 0.0625])
        .collect();
    for (at, found) in some.iter().zip(heights(&catalog, &centers, &[])) {
        assert!((found.unwrap() - f64::from(samples[*at])).abs() < 1e-6, "pixel {at}");
    }
}
