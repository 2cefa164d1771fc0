//! Resampling beside gdalwarp: processor time, and error against fields that are known everywhere.
//!
//! ```text
//!   terrain with holes, 16 bits ─▶ every way ─▶ processor seconds
//!   plane waves, float ─────────▶ every way ─▶ error by wavelength and zone
//!   terrain with holes ─▶ ingest into pages | gdalwarp, dzsave, lz4 ─▶ the whole job
//! ```

mod accuracy;
mod ways;
mod whole;

use std::fs;
use std::io;
use std::path::PathBuf;

use rayon::prelude::*;
use serde_json::json;

use self::accuracy::{ByWave, Errors, WAVELENGTHS_PX, ZONES};
use self::ways::{Direction, EXACT, Places, Program, SHARED, Way};
use super::geotiff::{Blocks, Format, Place};
use super::ingest::Setting;
use super::pairs::find;
use super::rasters::with_holes;
use super::report::{Chapter, Relation, Table, Target};
use super::terrain::{MISSING, Terrain};
use super::timing::{Contender, Runs, race};
use crate::failure::Failure;
use crate::output;

/// Pixels along a side of the polar map at full size.
const SIDE: f64 = 8192.0;

/// The maps whose errors are measured have so many times fewer pixels along a side.
const SMALLER: u32 = 4;

/// At least so many times GDAL's texels per processor second, kernel for kernel.
const FASTER: f64 = 3.0;

/// Errors may be so many times those of GDAL's exact places.
const NO_HIGHER: f64 = 1.01;

/// What the pole and the antimeridian are held against, and how many times its errors theirs may be. Places
/// as large as that at the pole hold so few waves that they differ by some percent.
const LIKE: [(&str, f64); 2] = [
    ("the largest of places like it", 1.05),
    ("a meridian that lies like it, of a field turned with the maps", NO_HIGHER),
];

/// Two steps of an f32, in % of the signal.
const ROUNDING_PERCENT: f64 = 100.0 * 2.0 * f32::EPSILON as f64;

/// The spline's error at wavelengths, in percent of the signal: place among them, and limit.
const SPLINE_RMS: [(usize, f64); 2] = [(1, 0.005), (2, 0.05)];

/// The kernel of an ingest that is not told one.
const DEFAULT: Way = Way::new(Program::Areoid, "spline 5", Places::Own);

/// Measures.
pub(super) fn measure(setting: &Setting) -> Result<Chapter, Failure> {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a width")]
    let side = (SIDE * setting.pixels_share.sqrt()).round().max(256.0) as u32;
    let side = side.next_multiple_of(64);
    let ways = Way::all();
    let (mut tables, mut targets, mut data) = (Vec::new(), Vec::new(), Vec::new());
    let large = Direction::both(side);
    for (direction, small) in large.into_iter().zip(Direction::both(side / SMALLER)) {
        let raster = terrain(setting, direction.source)?;
        output::say(format!("running {}", direction.name));
        let runs = race(&mut contenders(setting, &direction, &ways, &raster), setting.runs)?;
        output::say(format!("errors of {}", direction.name));
        let errors = accuracy::measure(setting, &small, &ways)?;
        tables.push(speeds(&direction, &runs));
        tables.extend(ZONES.iter().enumerate().map(|(zone, name)| {
            let title = format!("{}, {name}: root mean square (largest) error, %", direction.name);
            Table { title, head: head(), rows: rows(&ways, &errors, zone) }
        }));
        targets.extend(faster(setting, &direction, &runs));
        targets.extend(no_higher(&direction, &ways, &errors));
        targets.extend(of_our_own(&direction, &ways, &errors));
        data.push(json!({
            "direction": direction.name,
            "megapixels": direction.megapixels(),
            "runs": runs,
            "wavelengths_px": WAVELENGTHS_PX,
            "zones": ZONES,
            "errors_percent": ways.iter().zip(&errors)
                .map(|(way, errors)| json!({ "way": way.name(), "errors": errors }))
                .collect::<Vec<_>>(),
        }));
    }
    let job = whole::measure(setting, &terrain(setting, large[0].source)?)?;
    tables.push(job.table);
    targets.extend(job.targets);
    data.push(job.data);
    Ok(Chapter {
        name: "warp",
        title: "Resampling beside others",
        notes: vec![
            "Speed: whole meters in 16 bits with holes, DEFLATE in tiles, to a file without compression; all \
             cores, in turn. Error: 48 plane waves through the sphere, as floating point, on \
             maps a quarter as wide; in percent of the field's root mean square. A wavelength is in \
             pixels where those are largest. Exact: every place one by one (`-et 0`)."
                .to_owned(),
        ],
        tables,
        targets,
        data: json!(data),
    })
}

/// Terrain with holes in 16 bits; nothing past a polar map's equator.
fn terrain(setting: &Setting, (place, size): (Place, (u32, u32))) -> io::Result<PathBuf> {
    let (width, height) = size;
    let name = match place {
        Place::North { .. } => "polar",
        Place::Globe | Place::Half => "straight",
    };
    let path = setting.rasters().join(format!("warp1_{name}_{width}x{height}.tif"));
    if path.is_file() {
        return Ok(path);
    }
    output::say(format!("making {}", path.display()));
    fs::create_dir_all(setting.rasters())?;
    let unfinished = path.with_extension("tmp");
    let blocks = Blocks::Tiles(512);
    let missing = Some(MISSING);
    let format = Format { width, height, bands: 1, sample_bytes: 2, missing, place, blocks };
    let (heights, holes) = (Terrain::heights(width, height), Terrain::holes(width, height));
    format.write(&unfinished, |rows| {
        let row = |row: u32| {
            let mut samples = with_holes(&heights.rows(row..row + 1), &holes.rows(row..row + 1));
            for (col, sample) in (0..width).zip(samples.chunks_exact_mut(2)) {
                if place.position(size, row, col).latitude < 0.0 && place != Place::Globe {
                    sample.copy_from_slice(&MISSING.to_le_bytes());
                }
            }
            samples
        };
        rows.into_par_iter().map(row).collect::<Vec<_>>().concat()
    })?;
    fs::rename(&unfinished, &path)?;
    Ok(path)
}

fn contenders(
    setting: &Setting,
    direction: &Direction,
    ways: &[Way],
    raster: &std::path::Path,
) -> Vec<Contender> {
    let contender = |&way: &Way| {
        let folder = setting.work().join("warp");
        let step = direction.command(setting, way, raster, &folder.join("out.tif"))?;
        Some(Contender { name: way.name(), steps: vec![step], folder })
    };
    ways.iter().filter_map(contender).collect()
}

/// The GDAL that is compared with: the one that was named, else the one on the path.
fn gdal(setting: &Setting) -> Program {
    let named = setting.peers.python_warp(&[]).is_some();
    if named { Program::Python } else { Program::GdalWarp }
}

fn faster(setting: &Setting, direction: &Direction, runs: &[Runs]) -> Vec<Target> {
    let theirs = gdal(setting);
    let ratio = |our: Way, their: Way| {
        let (our, their) = (find(runs, &our.name())?, find(runs, &their.name())?);
        Some(1.0 / our.cpu_ratio(their)?.median)
    };
    let mut targets: Vec<Target> = SHARED
        .iter()
        .map(|&(kernel, same)| {
            let our = Way::new(Program::Areoid, same, Places::Own);
            let their = Way::new(theirs, kernel, Places::Own);
            let what = format!("{}: speed of {same} over {}", direction.name, their.name());
            Target::new(what, Relation::AtLeast, FASTER, ratio(our, their))
        })
        .collect();
    let cubic = Way::new(theirs, "cubic", Places::Own);
    let what = format!("{}: speed of {} over {}", direction.name, DEFAULT.name(), cubic.name());
    targets.push(Target::new(what, Relation::AtLeast, 1.0, ratio(DEFAULT, cubic)));
    targets
}

/// The largest ratios of errors over all wavelengths and zones. Errors of the last bits of f32 are all
/// the same.
fn no_higher(direction: &Direction, ways: &[Way], errors: &[Option<ByWave>]) -> Vec<Target> {
    let mut targets = Vec::new();
    for program in [Program::GdalWarp, Program::Python] {
        for (kernel, same) in SHARED {
            let exact = Way::new(program, kernel, Places::Exact);
            let our = Way::new(Program::Areoid, same, Places::Own);
            let Some(theirs) = errors_of(exact, ways, errors) else { continue };
            let ours = errors_of(our, ways, errors);
            for (figure, name) in FIGURES {
                let worst = ours.and_then(|ours| {
                    let pairs = ours.iter().flatten().zip(theirs.iter().flatten());
                    let figure = |errors| figure(errors).max(ROUNDING_PERCENT);
                    worst(pairs.map(|(our, their)| figure(our) / figure(their)))
                });
                let what = format!(
                    "{}: {name} error of {same} over {}, worst",
                    direction.name,
                    exact.name()
                );
                targets.push(Target::new(what, Relation::AtMost, NO_HIGHER, worst));
            }
        }
    }
    targets
}

/// What is held against nobody: texels that are missing, the pole and the antimeridian against places
/// like them elsewhere and places found against exact ones, and the spline's own errors.
fn of_our_own(direction: &Direction, ways: &[Way], errors: &[Option<ByWave>]) -> Vec<Target> {
    let ours = || ways.iter().zip(errors).filter(|(way, _)| way.program == Program::Areoid);
    let all = || ours().filter_map(|(_, errors)| errors.as_ref()).flatten();
    let missing = all().flatten().map(|errors| errors.missing).sum::<u64>();
    let what = format!("{}: texels missing, all kernels of areoid", direction.name);
    let mut targets = vec![Target::new(what, Relation::AtMost, 0.0, Some(missing as f64))];
    for (zone, name) in ZONES.iter().enumerate().skip(1) {
        for kernel in EXACT {
            let [own, exact] = [Places::Own, Places::Exact]
                .map(|places| errors_of(Way::new(Program::Areoid, kernel, places), ways, errors));
            let ratios = own.zip(exact).map(|(own, exact)| {
                let pairs = own.iter().zip(exact);
                pairs.map(move |(own, exact)| own[zone].rms / exact[zone].rms)
            });
            let what = format!(
                "{}, {name}: root mean square error of {kernel} over its exact places, worst",
                direction.name
            );
            targets.push(Target::new(what, Relation::AtMost, NO_HIGHER, ratios.and_then(worst)));
        }
        for (way, errors) in ours().filter(|(way, _)| way.places == Places::Own) {
            let ratios = errors.as_ref().map(|errors| {
                errors.iter().map(|zones| {
                    let figure = |error: f64| error.max(ROUNDING_PERCENT);
                    figure(zones[zone].rms) / figure(zones[zone].like_it)
                })
            });
            let (like_it, limit) = LIKE[zone - 1];
            let what = format!(
                "{}, {name}: root mean square error of {} over {like_it}, worst",
                direction.name, way.kernel
            );
            targets.push(Target::new(what, Relation::AtMost, limit, ratios.and_then(worst)));
        }
    }
    for (wave, limit) in SPLINE_RMS {
        let found = errors_of(DEFAULT, ways, errors)
            .and_then(|errors| worst(errors[wave].iter().map(|zone| zone.rms)));
        let what = format!(
            "{}: {} error at {} px, %, worst zone",
            direction.name,
            DEFAULT.name(),
            WAVELENGTHS_PX[wave]
        );
        targets.push(Target::new(what, Relation::AtMost, limit, found));
    }
    targets
}

type Figure = fn(&Errors) -> f64;

/// The figures of errors that are compared.
const FIGURES: [(Figure, &str); 2] =
    [(|errors| errors.rms, "root mean square"), (|errors| errors.max, "largest")];

fn errors_of<'a>(way: Way, ways: &[Way], errors: &'a [Option<ByWave>]) -> Option<&'a ByWave> {
    errors[ways.iter().position(|&one| one == way)?].as_ref()
}

/// The greatest; `None` where there is none, or one was not measured, as of zones without texels on
/// tiny maps.
fn worst(values: impl Iterator<Item = f64>) -> Option<f64> {
    values.map(|value| (!value.is_nan()).then_some(value)).reduce(|worst, value| {
        let (worst, value) = worst.zip(value)?;
        Some(value.max(worst))
    })?
}

fn speeds(direction: &Direction, all: &[Runs]) -> Table {
    let rows = all.iter().map(|runs| {
        if let Some(reason) = &runs.failed {
            return vec![runs.name.clone(), reason.clone()];
        }
        let text = |spread: Option<super::report::Spread>, digits| {
            spread.map_or_else(|| "–".to_owned(), |spread| spread.text(digits))
        };
        vec![
            runs.name.clone(),
            text(runs.spread(|taken| taken.wall_s), 2),
            text(runs.spread(|taken| taken.cpu_s), 2),
            text(runs.spread(|taken| direction.megapixels() / taken.cpu_s), 1),
            text(runs.spread(|taken| taken.peak_anonymous_bytes as f64 / super::pairs::MIB), 0),
        ]
    });
    let head = vec!["", "wall s", "CPU s", "Mpx per CPU-s", "memory MiB"];
    let title = format!("{}, {:.0} Mpx", direction.name, direction.megapixels());
    Table { title, head, rows: rows.collect() }
}

fn head() -> Vec<&'static str> {
    vec!["", "273 px", "16 px", "8 px", "4 px", "2.5 px", "missing"]
}

fn rows(ways: &[Way], errors: &[Option<ByWave>], zone: usize) -> Vec<Vec<String>> {
    let there = ways.iter().zip(errors).filter_map(|(way, errors)| Some((way, errors.as_ref()?)));
    there
        .map(|(way, errors)| {
            let mut row = vec![way.name()];
            row.extend(errors.iter().map(|zones| {
                let errors = &zones[zone];
                format!("{} ({})", digits(errors.rms), digits(errors.max))
            }));
            row.push(errors.iter().map(|zones| zones[zone].missing).max().unwrap_or(0).to_string());
            row
        })
        .collect()
}

/// Two digits that mean something.
fn digits(percent: f64) -> String {
    if percent >= 10.0 {
        return format!("{percent:.0}");
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few digits")]
    let places = (1.0 - percent.max(1e-9).log10().floor()).max(0.0) as usize;
    format!("{percent:.places$}")
}
