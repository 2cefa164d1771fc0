//! A globe split into a band and two caps, beside the same globe on its own grid: heights against
//! the truth zone by zone, and across the blend.

use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use areoid_formats::archive::Archive;
use areoid_formats::catalog::Catalog;
use serde_json::Value;
use tempfile::TempDir;

use super::truth::{demo, polar_truth, truth};
use crate::support::areoid::{areoid_json, heights, ingest};
use crate::support::geotiff::{Samples, Writing};
use crate::support::levels::Edge;
use crate::support::raster::{Place, Random, Raster, pixel_center};

/// A raster ingested on its own grid, and split.
struct Both {
    _folder: TempDir,
    raster: PathBuf,
    native: PathBuf,
    split: PathBuf,
    /// What `ingest --grid split` printed.
    told: Value,
}

impl Both {
    fn new(folder: TempDir, raster: PathBuf, options: &[&str]) -> Self {
        let (native, split) = (folder.path().join("native"), folder.path().join("split"));
        ingest(&native, &raster, &[&["--name", "whole"], options].concat());
        let named = ["--name", "whole", "--grid", "split"];
        let told = ingest(&split, &raster, &[&named, options].concat());
        Self { _folder: folder, raster, native, split, told }
    }

    /// Errors of both against the truth, native first.
    fn errors(&self, truth: &[([f64; 2], f64)]) -> Vec<([f64; 2], [f64; 2])> {
        let points: Vec<[f64; 2]> = truth.iter().map(|(point, _)| *point).collect();
        let found = [&self.native, &self.split].map(|catalog| heights(catalog, &points, &[]));
        let errors = truth.iter().enumerate().map(|(at, (point, height))| {
            (*point, [0, 1].map(|which| (found[which][at].unwrap() - height).abs()))
        });
        errors.collect()
    }
}

/// Root mean squares of both between two parallels, either side of the equator.
fn rms(errors: &[([f64; 2], [f64; 2])], from: f64, to: f64) -> [f64; 2] {
    let inside = || errors.iter().filter(|(at, _)| (from..=to).contains(&at[1].abs()));
    let count = inside().count();
    assert!(count > 150, "{count} points from {from} to {to}");
    [0, 1].map(|which| {
        let squares: f64 = inside().map(|(_, errors)| errors[which].powi(2)).sum();
        (squares / count as f64).sqrt()
    })
}

const ZONES: [(f64, f64); 8] = [
    (0.0, 30.0),
    (30.0, 45.0),
    (45.0, 55.0),
    (55.0, 60.0),
    (60.0, 65.0),
    (65.0, 75.0),
    (75.0, 85.0),
    (85.0, 90.0),
];

/// A field that looks the same everywhere and in all directions: waves along many of them.
fn waves(longitude_rad: f64, latitude_rad: f64) -> f64 {
    let (sin, cos) = latitude_rad.sin_cos();
    let at = [cos * longitude_rad.cos(), cos * longitude_rad.sin(), sin];
    let mut random = Random(12);
    (0..80)
        .map(|_| {
            let (up, turn) = (2.0 * random.unit() - 1.0, TAU * random.unit());
            let flat = (1.0 - up * up).sqrt();
            let along = at[0] * flat * turn.cos() + at[1] * flat * turn.sin() + at[2] * up;
            // Eight pixels of half a degree, seen from the side.
            100.0 * (90.0 * along + TAU * random.unit()).sin()
        })
        .sum()
}

fn made_up() -> Both {
    let size = (360, 720);
    let areas = Place::Globe(Edge::PoleOnOutline, Edge::PoleOnOutline);
    let raster = Raster::new(areas, size, None, |row, col| {
        let (latitude, longitude) = pixel_center((row, col), size);
        waves(longitude, latitude) as f32
    });
    let folder = TempDir::new().unwrap();
    let file = Writing::of(&raster, Samples::Float32).write(&raster, folder.path(), "waves.tif");
    Both::new(folder, file, &["--page-size", "66"])
}

#[test]
#[expect(clippy::print_stdout, reason = "figures, for whoever asks for them")]
fn a_split_planet_is_no_worse_anywhere_and_better_at_the_poles() {
    let both = made_up();
    let mut random = Random(77);
    let truth: Vec<_> = (0..30_000)
        .map(|_| {
            let (longitude, sine) = (360.0 * random.unit() - 180.0, 2.0 * random.unit() - 1.0);
            // A sixth about the poles.
            let latitude = match random.bits() % 6 {
                0 => (90.0 - 10.0 * random.unit()).copysign(sine),
                _ => sine.asin().to_degrees(),
            };
            let height = waves(longitude.to_radians(), latitude.to_radians());
            ([longitude, latitude], height)
        })
        .collect();
    let errors = both.errors(&truth);
    for (from, to) in ZONES {
        let [native, split] = rms(&errors, from, to);
        println!("{from} to {to}: native {native:.3}, split {split:.3}");
        assert!(split <= native * 1.0001, "{from} to {to}: {split}, native {native}");
        assert!(from < 60.0 || split < 0.5 * native, "{from} to {to}: {split}, native {native}");
    }
}

#[test]
#[expect(clippy::print_stdout, reason = "figures, for whoever asks for them")]
fn mars_split_is_no_worse_in_any_zone_and_better_at_the_poles() {
    let raster = demo("mola_height_8ppd.tif");
    let both = Both::new(TempDir::new().unwrap(), raster, &[]);
    let errors = both.errors(&truth());
    for (from, to) in ZONES {
        let [native, split] = rms(&errors, from, to);
        println!("{from} to {to}: native {native:.3}, split {split:.3}");
        assert!(split <= native * 1.0001, "{from} to {to}: {split}, native {native}");
        assert!(from < 60.0 || split < 0.5 * native, "{from} to {to}: {split}, native {native}");
    }
    check_each_place(&both);
    println!("{}", both.told);
    check_laws(&both);
    check_saved(&both);
    check_blend(&both);
}

/// Against the field on a grid of neither, from the seam to the pole: also where a scarp lies along a
/// meridian, and the columns that crowd there have next to no error across it. Of places as small as
/// that scarp some are worse.
#[expect(clippy::print_stdout, reason = "figures, for whoever asks for them")]
fn check_each_place(both: &Both) {
    // Rings and sectors in degrees, places of which at most so many are worse, and by how much.
    let sizes = [((2.0, 30.0), 0, 0.8), ((1.0, 15.0), 3, 1.2)];
    let errors = ["north", "south"].map(|hemisphere| both.errors(&polar_truth(hemisphere)));
    for ((ring_deg, sector_deg), most, by) in sizes {
        let mut places: BTreeMap<(bool, i64, i64), (f64, [f64; 2])> = BTreeMap::new();
        for ([longitude, latitude], errors) in errors.iter().flatten() {
            let ring = (latitude.abs() / ring_deg).floor();
            // About the pole itself there is one.
            let is_pole = latitude.abs() > 88.0;
            let sector =
                if is_pole { 0.0 } else { (longitude.rem_euclid(360.0) / sector_deg).floor() };
            let place = (*latitude > 0.0, ring as i64, sector as i64);
            let (count, squares) = places.entry(place).or_default();
            *count += 1.0;
            (0..2).for_each(|which| squares[which] += errors[which].powi(2));
        }
        let mut ratios = Vec::new();
        for (place, (count, [native, split])) in places {
            assert!(count > 100.0, "{count} points in {place:?}");
            assert!(split / native > 0.0, "{split} and {native} in {place:?}");
            ratios.push(((split / native).sqrt(), place));
        }
        ratios.sort_by(|(one, _), (other, _)| other.total_cmp(one));
        let worse = ratios.iter().filter(|(ratio, _)| *ratio > 1.0).count();
        let (count, median) = (ratios.len(), ratios[ratios.len() / 2].0);
        println!("{ring_deg} by {sector_deg}: {worse} of {count} worse, median {median}");
        println!("{:?}", &ratios[..worse + 1]);
        assert!(count as f64 > 0.9 * 2.0 * 28.0 / ring_deg * 360.0 / sector_deg, "{count} places");
        assert!(worse <= most && ratios[0].0 < by, "{:?}", &ratios[..worse + 1]);
        assert!(median < 0.4, "{median}");
    }
}

/// Laws 1 to 4 of all parts, and all against the raster: the band is its pixels.
fn check_laws(both: &Both) {
    let (catalog, raster) = (both.split.to_str().unwrap(), both.raster.to_str().unwrap());
    let against = ["verify", catalog, "--against", raster, "--dataset", "whole"];
    for arguments in [&["verify", catalog][..], &against] {
        let report = areoid_json(arguments);
        assert_eq!(report["ok"], true, "{report}");
    }
    let levels = areoid_json(&against)["levels"].clone();
    for part in ["whole.band", "whole.north", "whole.south"] {
        let finest = levels.as_array().unwrap().iter().rfind(|level| level["dataset"] == part);
        let measured = finest.unwrap()["measured_max"].as_f64().unwrap();
        assert_eq!(measured == 0.0, part == "whole.band", "{part} is {measured} off");
    }
}

/// What is said of sizes is what the catalogs have.
fn check_saved(both: &Both) {
    let info =
        |catalog: &Path| areoid_json(&["info", catalog.to_str().unwrap()])["datasets"].clone();
    let [native, split] = [&both.native, &both.split].map(|catalog| info(catalog));
    let sum = |datasets: &Value, field: &dyn Fn(&Value) -> i64| -> i64 {
        datasets.as_array().unwrap().iter().map(field).sum()
    };
    let texels = |one: &Value| {
        one["grid"]["width"].as_i64().unwrap() * one["grid"]["height"].as_i64().unwrap()
    };
    let saved = sum(&native, &texels) - sum(&split, &texels);
    assert_eq!(both.told["saved_texels"], saved);
    let bytes = |one: &Value| one["bytes"].as_i64().unwrap();
    let (native, split) = (sum(&native, &bytes), sum(&split, &bytes));
    assert_eq!(both.told["bytes"], split);
    assert_eq!(both.told["saved_bytes"], native - split);
}

/// Along meridians through both seams: nothing but the raster's own roughness is to be seen.
#[expect(clippy::print_stdout, reason = "figures, for whoever asks for them")]
fn check_blend(both: &Both) {
    let parts = both.told["parts"].as_array().unwrap();
    let band = &parts[0]["grid"];
    let row = band["pixel_size"][1].as_f64().unwrap();
    let top = band["origin"][1].as_f64().unwrap();
    let bottom = top - row * band["height"].as_f64().unwrap();
    for (seam, outline) in [(60.0, top), (-60.0, bottom)] {
        // Eight samples a row, from beyond one outline to beyond the other.
        let span = 2.0 * (outline - seam);
        let count = (2.0 * span.abs() / row * 8.0) as usize;
        let (mut smooth, mut largest) = ([0.0; 2], [0.0_f64; 2]);
        for meridian in 0..24 {
            let longitude = 15.0 * f64::from(meridian) + 0.37;
            let points: Vec<[f64; 2]> = (0..count)
                .map(|at| [longitude, seam - span + 2.0 * span * at as f64 / count as f64])
                .collect();
            for (which, catalog) in [&both.native, &both.split].into_iter().enumerate() {
                let found = heights(catalog, &points, &[]);
                let found: Vec<f64> = found.into_iter().map(|height| height.unwrap()).collect();
                for three in found.windows(3) {
                    let second = three[0] - 2.0 * three[1] + three[2];
                    smooth[which] += second * second;
                    largest[which] = largest[which].max(second.abs());
                }
            }
        }
        println!("second differences at {seam}: {smooth:?}, at most {largest:?}");
        assert!(smooth[1] <= smooth[0] && largest[1] <= largest[0], "{smooth:?} {largest:?}");
    }
}

/// Where a part begins it weighs little: of what it is off the other, next to nothing shows.
#[test]
#[expect(clippy::print_stdout, reason = "figures, for whoever asks for them")]
fn no_part_begins_with_a_step() {
    let both = made_up();
    let longitudes: Vec<f64> = (0..200).map(|step| f64::from(step) * 1.8 - 179.3).collect();
    let of = |dataset: &str, latitudes: &[f64]| {
        let points: Vec<[f64; 2]> =
            longitudes.iter().zip(latitudes).map(|(lon, lat)| [*lon, *lat]).collect();
        heights(&both.split, &points, &["--dataset", dataset])
    };
    // Latitudes inside the part and outside it, which close in on its outline.
    let parts =
        [("whole.north", "whole.band", 70.0, 20.0), ("whole.band", "whole.north", 50.0, 89.0)];
    for (part, other, inside, outside) in parts {
        let mut inside = vec![inside; longitudes.len()];
        let mut outside = vec![outside; longitudes.len()];
        for _ in 0..40 {
            let middle: Vec<f64> =
                inside.iter().zip(&outside).map(|(one, other)| (one + other) / 2.0).collect();
            for (at, height) in of(part, &middle).into_iter().enumerate() {
                *(if height.is_some() { &mut inside[at] } else { &mut outside[at] }) = middle[at];
            }
        }
        let (begun, before) = (of("whole", &inside), of("whole", &outside));
        let (part_there, other_there) = (of(part, &inside), of(other, &inside));
        let (mut step, mut apart) = (0.0, 0.0);
        for at in 0..longitudes.len() {
            step += (begun[at].unwrap() - before[at].unwrap()).powi(2);
            apart += (part_there[at].unwrap() - other_there[at].unwrap()).powi(2);
        }
        let share = (step / apart).sqrt();
        let count = longitudes.len() as f64;
        println!("{part}: {} m of {}, {share}", (step / count).sqrt(), (apart / count).sqrt());
        assert!(apart > count && share < 0.1, "{part}: {share}");
    }
}

/// Colors, normals, pixels, means and limited ranges are what they are called.
#[test]
fn heights_of_caps_alone_are_fitted() {
    let globe = Place::Globe(Edge::PoleOnOutline, Edge::PoleOnOutline);
    let mut raster = Raster::new(globe, (360, 720), None, |row, col| ((row * col) % 251) as f32);
    raster.planes = vec![raster.planes[0].clone(); 3];
    let folder = TempDir::new().unwrap();
    let fitted = |samples: Samples, options: &[&str]| -> Vec<bool> {
        let file = Writing::of(&raster, samples).write(&raster, folder.path(), "globe.tif");
        let catalog = folder.path().join("catalog");
        let split = ["--grid", "split", "--page-size", "66", "--force", "--name", "globe"];
        ingest(&catalog, &file, &[&split, options].concat());
        let (_, archives) = Catalog::open_with_archives(&catalog).unwrap();
        let of = |archive: &Archive| archive.description().resampling.clone();
        let caps: Vec<_> = archives.iter().filter_map(of).collect();
        fs::remove_dir_all(&catalog).unwrap();
        caps.into_iter().map(|resampling| resampling.fitted).collect()
    };
    let heights = Samples::Float32;
    assert_eq!(fitted(heights, &[]), [true; 2]);
    assert_eq!(fitted(heights, &["--kernel", "cubic"]), [true; 2]);
    for options in [
        &["--limit-range"][..],
        &["--kernel", "nearest"],
        &["--kernel", "average"],
        &["--kind", "normal"],
    ] {
        assert_eq!(fitted(heights, options), [false; 2], "{options:?}");
    }
    assert_eq!(fitted(Samples::Color, &[]), [false; 2]);
}

/// What cannot be split is refused with one reason, and nothing is left of it.
#[test]
fn what_is_no_whole_globe_is_not_split() {
    let folder = TempDir::new().unwrap();
    let catalog = folder.path().join("catalog");
    let mut said = String::new();
    for (name, place, size) in [
        ("region", Place::Region, (300, 300)),
        ("belt", Place::Belt, (300, 600)),
        ("small", Place::Globe(Edge::PoleOnOutline, Edge::PoleOnOutline), (100, 200)),
        ("uneven", Place::Globe(Edge::PoleOnOutline, Edge::PoleOnOutline), (250, 501)),
    ] {
        let raster = Raster::new(place, size, None, |row, col| (row + col) as f32);
        let file = Writing::of(&raster, Samples::Float32).write(
            &raster,
            folder.path(),
            &format!("{name}.tif"),
        );
        let (file, to) = (file.to_str().unwrap(), catalog.to_str().unwrap());
        let split = ["ingest", file, "--catalog", to, "--grid", "split", "--page-size", "66"];
        let output = crate::support::areoid::areoid(&split);
        assert_eq!(output.status.code(), Some(1), "{name}");
        writeln!(said, "{name}: {}", String::from_utf8_lossy(&output.stderr)).unwrap();
        let sized = [&split[..], &["--pixel-size-m", "5000"]].concat();
        assert_eq!(crate::support::areoid::areoid(&sized).status.code(), Some(2), "{name}");
    }
    for reason in [
        "region: error: only a whole globe",
        "the raster does not go all around",
        "the raster does not reach the north pole",
        "a globe of 100 rows is too small to be split",
        "resample to a width of",
    ] {
        assert!(said.contains(reason), "{reason}: {said}");
    }
    assert!(!catalog.exists());
}
