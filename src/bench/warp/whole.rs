//! The whole job: a polar raster into pages of a straight map, compressed.

use std::io;
use std::path::Path;

use areoid_formats::catalog::Catalog;
use serde_json::{Value, json};

use super::ways::onto;
use crate::bench::ingest::{Setting, said};
use crate::bench::pairs::find;
use crate::bench::report::{Relation, Spread, Table, Target};
use crate::bench::timing::{self, Contender, race};
use crate::failure::Failure;

/// At most so much of the others' processor time.
const LIMIT: f64 = 0.5;

/// What is ingested with: the default, and the others' kernel.
const KERNELS: [&str; 2] = ["spline", "bilinear"];

pub(super) struct Job {
    pub(super) table: Table,
    pub(super) target: Target,
    pub(super) data: Value,
}

/// Measures: an ingest, against gdalwarp (bilinear) onto the very grid of its dataset, libvips and
/// LZ4 in a row.
pub(super) fn measure(setting: &Setting, raster: &Path) -> Result<Job, Failure> {
    let ingest = |kernel: &str, catalog: &Path| {
        let mut command = setting.ingest(raster, catalog);
        command.args(["--grid", "equirectangular", "--kernel", kernel]);
        command
    };
    let catalog = setting.work().join("catalog");
    timing::remove(&catalog)?;
    std::fs::create_dir_all(setting.work())?;
    said(&mut ingest(KERNELS[0], &catalog))?;
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
    let mut contenders: Vec<Contender> = KERNELS
        .iter()
        .map(|&kernel| Contender {
            name: format!("areoid ingest, {kernel}"),
            steps: vec![ingest(kernel, &folder.join("catalog"))],
            folder: folder.clone(),
        })
        .collect();
    for (name, is_python) in [("python osgeo", true), ("gdalwarp", false)] {
        let warped = folder.join("warped.tif");
        let mut arguments = onto(&proj, outline, size);
        arguments.extend(["-r", "bilinear"].map(str::to_owned));
        arguments.extend([raster, &warped].map(|path| path.to_string_lossy().into_owned()));
        let warp = if is_python {
            setting.peers.python_warp(&arguments)
        } else {
            setting.peers.warp(&arguments)
        };
        let pages = setting.peers.dzsave_and_lz4(&warped, &folder, setting.cores);
        if let (Some(warp), Some(pages)) = (warp, pages) {
            let name = format!("{name} bilinear + vips dzsave + lz4 -1");
            let steps = std::iter::once(warp).chain(pages).collect();
            contenders.push(Contender { name, steps, folder: folder.clone() });
        }
    }
    let runs = race(&mut contenders, setting.runs)?;
    let megapixels = f64::from(size.0) * f64::from(size.1) / 1e6;
    let text = |spread: Option<Spread>, digits| {
        spread.map_or_else(|| "–".to_owned(), |spread| spread.text(digits))
    };
    let ours = &runs[0];
    let rows = runs.iter().map(|runs| {
        if let Some(reason) = &runs.failed {
            return vec![runs.name.clone(), reason.clone()];
        }
        vec![
            runs.name.clone(),
            text(runs.spread(|taken| taken.wall_s), 2),
            text(runs.spread(|taken| taken.cpu_s), 2),
            text(runs.spread(|taken| megapixels / taken.cpu_s), 1),
            text(ours.cpu_ratio(runs), 2),
        ]
    });
    let table = Table {
        title: format!("Polar raster into compressed pages of {megapixels:.0} Mpx"),
        head: vec!["", "wall s", "CPU s", "Mpx per CPU-s", "Areoid's CPU over it"],
        rows: rows.collect(),
    };
    let theirs = contenders.get(KERNELS.len()).and_then(|contender| find(&runs, &contender.name));
    let ratio = theirs.and_then(|theirs| ours.cpu_ratio(theirs)).map(|ratio| ratio.median);
    let target =
        Target::new("whole job: CPU over gdalwarp + vips + lz4", Relation::AtMost, LIMIT, ratio);
    let data = json!({ "whole": runs, "megapixels": megapixels });
    Ok(Job { table, target, data })
}
