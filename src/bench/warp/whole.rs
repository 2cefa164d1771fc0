//! The whole job: a polar raster into pages of a straight map, compressed.

use std::io;
use std::path::Path;

use areoid_formats::catalog::Catalog;
use serde_json::{Value, json};

use super::gdal;
use super::ways::{Places, Program, Way, onto};
use crate::bench::ingest::{Setting, said};
use crate::bench::pairs::find;
use crate::bench::report::{Relation, Spread, Table, Target};
use crate::bench::timing::{self, Contender, Runs, race};
use crate::failure::Failure;

/// At most so much of the others' processor time.
const LIMIT: f64 = 0.5;

/// What is ingested with, the default first.
const OURS: [&str; 3] = ["spline", "bilinear", "cubic"];

/// What the others resample with.
const THEIRS: [&str; 2] = ["bilinear", "cubic"];

/// Kernels of an ingest, each with the one it is held against: the same; for splines, which others do
/// not interpolate with, the cubic.
const SHARED: [(&str, &str); 3] =
    [("bilinear", "bilinear"), ("cubic", "cubic"), ("spline", "cubic")];

pub(super) struct Job {
    pub(super) table: Table,
    pub(super) targets: Vec<Target>,
    pub(super) data: Value,
}

/// Measures: an ingest, against gdalwarp onto the very grid of its dataset, libvips and LZ4 in a row.
pub(super) fn measure(setting: &Setting, raster: &Path) -> Result<Job, Failure> {
    let ingest = |kernel: &str, catalog: &Path| {
        let mut command = setting.ingest(raster, catalog);
        command.args(["--grid", "equirectangular", "--kernel", kernel]);
        command
    };
    let catalog = setting.work().join("catalog");
    timing::remove(&catalog)?;
    std::fs::create_dir_all(setting.work())?;
    said(&mut ingest(OURS[0], &catalog))?;
    let (_, archives) = Catalog::open_with_archives(&catalog)?;
    let archive = archives.into_iter().next().ok_or_else(|| io::Error::other("no dataset"))?;
    let grid = &archive.description().grid;
    let extent = grid.pyramid().extent();
    let size = (extent.width, extent.height);
    let ([left, top], [pixel_x, pixel_y]) = (grid.origin(), grid.pixel_size());
    let outline =
        [left, top - pixel_y * f64::from(size.1), left + pixel_x * f64::from(size.0), top];
    let proj = grid.crs().proj_string();

    let folder = setting.work().join("whole");
    let mut contenders: Vec<Contender> = OURS
        .iter()
        .map(|&kernel| Contender {
            name: our_name(kernel),
            steps: vec![ingest(kernel, &folder.join("catalog"))],
            folder: folder.clone(),
        })
        .collect();
    for program in [Program::Python, Program::GdalWarp] {
        for kernel in THEIRS {
            let warped = folder.join("warped.tif");
            let mut arguments = onto(&proj, outline, size);
            arguments.extend(["-r", kernel].map(str::to_owned));
            arguments.extend([raster, &warped].map(|path| path.to_string_lossy().into_owned()));
            let warp = match program {
                Program::GdalWarp => setting.peers.warp(&arguments),
                _ => setting.peers.python_warp(&arguments),
            };
            let pages = setting.peers.dzsave_and_lz4(&warped, &folder, setting.cores);
            if let (Some(warp), Some(pages)) = (warp, pages) {
                let steps = std::iter::once(warp).chain(pages).collect();
                let name = their_name(program, kernel);
                contenders.push(Contender { name, steps, folder: folder.clone() });
            }
        }
    }
    let runs = race(&mut contenders, setting.runs)?;
    let megapixels = f64::from(size.0) * f64::from(size.1) / 1e6;
    let text = |spread: Option<Spread>, digits| {
        spread.map_or_else(|| "–".to_owned(), |spread| spread.text(digits))
    };
    // Ours over theirs, kernel by kernel, in a line of theirs.
    let ratios = |theirs: &Runs| {
        let programs = [Program::Python, Program::GdalWarp].into_iter();
        let pairs = programs.flat_map(|program| SHARED.map(|pair| (program, pair)));
        let ratios = pairs.filter_map(|(program, (our, their))| {
            let ours = find(&runs, &our_name(our))?;
            let ratio =
                ours.cpu_ratio(theirs).filter(|_| theirs.name == their_name(program, their));
            Some(format!("{our} {}", ratio?.text(2)))
        });
        ratios.collect::<Vec<_>>().join(", ")
    };
    let rows = runs.iter().map(|runs| {
        if let Some(reason) = &runs.failed {
            return vec![runs.name.clone(), reason.clone()];
        }
        vec![
            runs.name.clone(),
            text(runs.spread(|taken| taken.wall_s), 2),
            text(runs.spread(|taken| taken.cpu_s), 2),
            text(runs.spread(|taken| megapixels / taken.cpu_s), 1),
            ratios(runs),
        ]
    });
    let table = Table {
        title: format!("Polar raster into compressed pages of {megapixels:.0} Mpx"),
        head: vec!["", "wall s", "CPU s", "Mpx per CPU-s", "Areoid's CPU over it"],
        rows: rows.collect(),
    };
    let targets = SHARED.map(|(our, their)| {
        let (ours, theirs) = (our_name(our), their_name(gdal(setting), their));
        let ratio = find(&runs, &ours).zip(find(&runs, &theirs));
        let ratio = ratio.and_then(|(ours, theirs)| ours.cpu_ratio(theirs));
        let what = format!("whole job: CPU of {our} over {theirs}");
        Target::new(what, Relation::AtMost, LIMIT, ratio.map(|ratio| ratio.median))
    });
    let data = json!({ "whole": runs, "megapixels": megapixels });
    Ok(Job { table, targets: targets.into(), data })
}

fn our_name(kernel: &str) -> String {
    format!("areoid ingest, {kernel}")
}

fn their_name(program: Program, kernel: &'static str) -> String {
    format!("{} + vips dzsave + lz4 -1", Way { program, kernel, places: Places::Own }.name())
}
