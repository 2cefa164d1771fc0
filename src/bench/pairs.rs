//! Ingest against what others do with the same raster, in turn.
//!
//! Nobody else makes what an ingest makes. libvips makes pages with borders and all levels, without
//! bounds, checksums, wrapping or order; GDAL makes tiles and overviews without borders. Decoding
//! once is the floor.

use std::io;

use serde_json::json;

use super::ingest::Setting;
use super::rasters::{Look, Recipe};
use super::report::{Chapter, Relation, Table, Target};
use super::timing::{Contender, Runs, race};
use crate::output;

const AREOID: &str = "areoid ingest";
const DECODE: &str = "areoid decode";
const VIPS: &str = "vips dzsave + lz4 -1";
const COG: &str = "gdal COG ZSTD-1";
const GDAL_DECODE: &str = "gdal decode";

/// At most so much of each one's processor time.
const LIMITS: [(&str, f64); 4] = [(VIPS, 0.75), (COG, 0.4), (DECODE, 2.0), (GDAL_DECODE, 2.0)];

/// Share of the cores' time that an ingest should use.
const BUSY: f64 = 0.85;

/// What is ingested, and whether targets are set for it.
const RASTERS: [(Look, bool); 4] =
    [(Look::Height, true), (Look::Color, true), (Look::Height, false), (Look::Holes, true)];

/// The rasters: heights and colors in tiles, heights in strips, heights with holes.
pub(super) fn recipes(setting: &Setting) -> Vec<Recipe> {
    let map = setting.main_map();
    let recipe = |&(look, is_tiled)| match is_tiled {
        true => Recipe::tiled(look, map),
        false => Recipe::striped(look, map),
    };
    RASTERS.iter().map(recipe).collect()
}

/// Measures.
pub(super) fn measure(setting: &Setting) -> io::Result<Chapter> {
    let mut tables = Vec::new();
    let mut targets = Vec::new();
    let mut data = Vec::new();
    for (place, recipe) in recipes(setting).into_iter().enumerate() {
        let path = recipe.make(&setting.rasters())?;
        output::say(format!("running {}", recipe.name()));
        let runs = race(&mut contenders(setting, &path), setting.runs)?;
        tables.push(table(setting, &recipe, &runs));
        if place < 2 {
            targets.extend(targets_of(setting, &recipe, &runs));
        }
        data.push(json!({
            "raster": recipe.name(),
            "width": recipe.width,
            "height": recipe.height,
            "contenders": runs,
        }));
    }
    Ok(Chapter {
        name: "pairs",
        title: "Ingest beside others",
        notes: vec![
            "All run in turn, round after round, after one round that is not counted; ratios are \
             Areoid's over the other's within a round. Processor seconds are user and system time, \
             all threads and children. Median (least–greatest)."
                .to_owned(),
            "libvips 8 writes no headerless pages: its are uncompressed TIFFs, 242 bytes longer; \
             lz4 -1 then compresses them one by one, on all cores. GDAL's COG is ZSTD level 1 with \
             PREDICTOR=YES, average overviews and all cores. `gdal decode` is a gdal_translate into \
             memory, `areoid decode` decodes each block once: both on one thread."
                .to_owned(),
        ],
        tables,
        targets,
        data: json!(data),
    })
}

fn contenders(setting: &Setting, raster: &std::path::Path) -> Vec<Contender> {
    let folder = |name: &str| setting.work().join(name);
    let mut decode = std::process::Command::new(&setting.areoid);
    decode.args(["bench", "decode"]).arg(raster);
    let ours = setting.ingest(raster, &folder("areoid").join("catalog"));
    let peers = &setting.peers;
    let all = [
        (AREOID, "areoid", Some(vec![ours])),
        (DECODE, "decode", Some(vec![decode])),
        (VIPS, "vips", peers.dzsave_and_lz4(raster, &folder("vips"), setting.cores)),
        (COG, "cog", peers.cog(raster, &folder("cog"))),
        (GDAL_DECODE, "gdal", peers.decode(raster)),
    ];
    all.into_iter()
        .filter_map(|(name, place, steps)| {
            Some(Contender { name: name.to_owned(), steps: steps?, folder: folder(place) })
        })
        .collect()
}

pub(super) fn find<'a>(runs: &'a [Runs], name: &str) -> Option<&'a Runs> {
    runs.iter().find(|runs| runs.name == name)
}

fn targets_of(setting: &Setting, recipe: &Recipe, all: &[Runs]) -> Vec<Target> {
    let what = if recipe.look == Look::Color { "RGB" } else { "int16" };
    let Some(ours) = find(all, AREOID) else { return Vec::new() };
    let mut targets: Vec<Target> = LIMITS
        .iter()
        .map(|&(name, limit)| {
            let ratio = find(all, name).and_then(|other| ours.cpu_ratio(other));
            let median = ratio.map(|ratio| ratio.median);
            Target::new(format!("{what}: CPU over {name}"), Relation::AtMost, limit, median)
        })
        .collect();
    let busy = ours.spread(|taken| taken.cpu_s / (taken.wall_s * setting.cores as f64));
    let busy = busy.map(|busy| busy.median);
    targets.push(Target::new(format!("{what}: cores busy"), Relation::AtLeast, BUSY, busy));
    targets
}

fn table(setting: &Setting, recipe: &Recipe, all: &[Runs]) -> Table {
    let ours = find(all, AREOID);
    let rows = all.iter().map(|runs| {
        if let Some(reason) = &runs.failed {
            return vec![runs.name.clone(), reason.clone()];
        }
        let text = |spread: Option<super::report::Spread>, digits| {
            spread.map_or_else(|| "–".to_owned(), |spread| spread.text(digits))
        };
        let other = ours.filter(|ours| ours.name != runs.name);
        let cores = setting.cores as f64;
        vec![
            runs.name.clone(),
            text(runs.spread(|taken| taken.wall_s), 2),
            text(runs.spread(|taken| taken.cpu_s), 2),
            text(runs.spread(|taken| taken.system_s), 2),
            text(runs.spread(|taken| recipe.megapixels() / taken.cpu_s), 1),
            text(runs.spread(|taken| 100.0 * taken.cpu_s / (taken.wall_s * cores)), 0),
            text(runs.spread(|taken| taken.peak_anonymous_bytes as f64 / MIB), 0),
            text(other.and_then(|ours| ours.cpu_ratio(runs)), 2),
            text(other.and_then(|ours| ours.wall_ratio(runs)), 2),
        ]
    });
    let head = vec![
        "",
        "wall s",
        "CPU s",
        "of it system",
        "Mpx per CPU-s",
        "cores busy %",
        "memory MiB",
        "Areoid's CPU over it",
        "wall",
    ];
    Table { title: recipe.name(), head, rows: rows.collect() }
}

/// Bytes of a MiB.
pub(super) const MIB: f64 = 1_048_576.0;
