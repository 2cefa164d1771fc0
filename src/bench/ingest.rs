//! `areoid bench ingest`: arguments, and the chapters one after another.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use areoid_formats::archive::Archive;
use areoid_formats::catalog::Catalog;
use serde_json::{Value, json};

use super::peers::Peers;
use super::rasters::{Look, Recipe};
use super::report::{Chapter, Report, Table, cores};
use super::{pairs, scaling, size, tightness, timing, warp};
use crate::failure::Failure;
use crate::output;

/// Ingest: time, memory, tightness of bounds and size, beside libvips with LZ4 and beside GDAL
/// where those are installed.
///
/// Writes ingest.json and ingest.md into the folder, and prints the tables. Rasters of made-up
/// terrain are kept in the folder and used again.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The folder for results, rasters and what is made on the way.
    #[arg(short, long, value_name = "DIR", default_value = "bench")]
    output: PathBuf,

    /// Counted runs of everything that is timed.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..))]
    runs: u16,

    /// How much: full takes an hour, small has a 64th of its pixels.
    #[arg(long, value_enum, default_value = "full")]
    size: Size,

    /// Only these chapters [default: all].
    #[arg(long, value_enum, value_name = "NAME", num_args = 1..)]
    chapter: Vec<ChapterArg>,

    /// Measure tightness and size on these rasters, too [default: the demo's Mars, if it is under
    /// the current folder].
    #[arg(long, value_name = "FILE", num_args = 1..)]
    raster: Vec<PathBuf>,

    /// A Python whose `osgeo` warps, beside the gdalwarp on the path.
    #[arg(long, value_name = "FILE")]
    python: Option<PathBuf>,

    /// Print the JSON instead of the tables.
    #[arg(long)]
    json: bool,

    /// Millions of pixels of the main map, instead of a size.
    #[arg(long, hide = true)]
    megapixels: Option<f64>,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Size {
    Full,
    Small,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum ChapterArg {
    /// Make the rasters, and measure nothing.
    Rasters,
    /// Time beside others, run by run.
    Pairs,
    /// Bounds over exact errors.
    Tightness,
    /// Bytes at zero error, and decoding them.
    Size,
    /// From small maps to large ones.
    Scaling,
    /// From one map to another.
    Warp,
}

/// Where a raster of Mars is, if the current folder is the project's.
const DEMO: &str = "demo/mars/mola_height_8ppd.tif";

/// Megapixels of the main map at full size: 16384 by 8192.
const FULL_MEGAPIXELS: f64 = 134.217_728;

/// What all chapters measure with.
#[derive(Debug)]
pub(super) struct Setting {
    pub(super) folder: PathBuf,
    /// This program.
    pub(super) areoid: PathBuf,
    pub(super) runs: usize,
    pub(super) cores: usize,
    /// Over those of the full size.
    pub(super) pixels_share: f64,
    /// Rasters that were not made here.
    pub(super) given: Vec<PathBuf>,
    pub(super) peers: Peers,
}

impl Args {
    pub(super) fn run(self) -> Result<ExitCode, Failure> {
        let megapixels = self.megapixels.unwrap_or(match self.size {
            Size::Full => FULL_MEGAPIXELS,
            Size::Small => FULL_MEGAPIXELS / 64.0,
        });
        if !(megapixels > 0.0 && megapixels.is_finite()) {
            return Err(Failure::Misused("--megapixels must be positive".to_owned()));
        }
        let mut given = self.raster;
        if given.is_empty() && Path::new(DEMO).is_file() {
            given.push(DEMO.into());
        }
        fs::create_dir_all(&self.output)?;
        let setting = Setting {
            folder: self.output,
            areoid: std::env::current_exe()?,
            runs: self.runs.into(),
            cores: cores(),
            pixels_share: megapixels / FULL_MEGAPIXELS,
            given,
            peers: Peers::find(self.python.as_deref()),
        };
        let all = [
            ChapterArg::Pairs,
            ChapterArg::Tightness,
            ChapterArg::Size,
            ChapterArg::Scaling,
            ChapterArg::Warp,
        ];
        let wanted = if self.chapter.is_empty() { &all[..] } else { &self.chapter };
        let mut chapters = Vec::new();
        for chapter in wanted {
            output::say(format!("{chapter:?} ..").to_lowercase());
            chapters.push(match chapter {
                ChapterArg::Rasters => rasters(&setting)?,
                ChapterArg::Pairs => pairs::measure(&setting)?,
                ChapterArg::Tightness => tightness::measure(&setting)?,
                ChapterArg::Size => size::measure(&setting)?,
                ChapterArg::Scaling => scaling::measure(&setting)?,
                ChapterArg::Warp => warp::measure(&setting)?,
            });
        }
        timing::remove(&setting.work())?;

        let options = json!({
            "runs": setting.runs,
            "megapixels": megapixels,
            "rasters": setting.given,
        });
        let title = "Ingest, measured";
        let report = Report { title, options, peers: setting.peers.clone(), chapters };
        report.hand_out(&setting.folder, "ingest", self.json)?;
        Ok(ExitCode::SUCCESS)
    }
}

impl Setting {
    /// Where rasters are kept.
    pub(super) fn rasters(&self) -> PathBuf {
        self.folder.join("rasters")
    }

    /// Where things are that are gone in the end.
    pub(super) fn work(&self) -> PathBuf {
        self.folder.join("work")
    }

    /// A map that is so large at full size.
    pub(super) fn map(&self, full_megapixels: f64) -> (u32, u32) {
        global_size(full_megapixels * self.pixels_share)
    }

    /// The main map.
    pub(super) fn main_map(&self) -> (u32, u32) {
        self.map(FULL_MEGAPIXELS)
    }

    /// `areoid ingest` of a raster into a catalog.
    pub(super) fn ingest(&self, raster: &Path, catalog: &Path) -> Command {
        let mut command = Command::new(&self.areoid);
        command.arg("ingest").arg(raster).arg("--catalog").arg(catalog).arg("--json");
        command
    }

    /// Ingests a raster into a new catalog in the folder of work: what it says, and its archive.
    pub(super) fn ingested(&self, raster: &Path) -> Result<(Value, Archive), Failure> {
        let catalog = self.work().join("catalog");
        timing::remove(&catalog)?;
        fs::create_dir_all(self.work())?;
        let said = said(&mut self.ingest(raster, &catalog))?;
        let (_, archives) = Catalog::open_with_archives(&catalog)?;
        let archive = archives.into_iter().next().ok_or_else(|| {
            io::Error::other(format!("no dataset was made of {}", raster.display()))
        })?;
        Ok((said, archive))
    }
}

/// What one of our own commands prints as JSON.
pub(super) fn said(command: &mut Command) -> io::Result<Value> {
    let output = command.output()?;
    if !output.status.success() {
        return Err(io::Error::other(String::from_utf8_lossy(&output.stderr).trim().to_owned()));
    }
    Ok(serde_json::from_slice(&output.stdout)?)
}

/// A file's name without its ending.
pub(super) fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

/// Width and height of a global map of nearly so many megapixels that halves evenly down to its
/// coarsest level, which may have three pages in a row.
pub(super) fn global_size(megapixels: f64) -> (u32, u32) {
    const ROOT_COLS: f64 = 1530.0;
    let width = (2e6 * megapixels).sqrt();
    let halvings = (width / ROOT_COLS).log2().ceil().max(0.0);
    // A turn by 180 degrees must fall on a column at the coarsest level, too; a map that is smaller
    // than such a level has levels of its own if its width halves.
    let even = if halvings == 0.0 { 16.0 } else { 2.0 * halvings.exp2() };
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a width")]
    let width = ((width / even).round().max(1.0) * even) as u32;
    (width, width / 2)
}

/// All rasters of the book.
fn rasters(setting: &Setting) -> Result<Chapter, Failure> {
    let recipes = pairs::recipes(setting)
        .into_iter()
        .chain(tightness::recipes(setting))
        .chain(scaling::recipes(setting));
    let mut files: Vec<Value> = Vec::new();
    let mut rows = Vec::new();
    for recipe in recipes {
        let path = recipe.make(&setting.rasters())?;
        let bytes = fs::metadata(&path)?.len();
        let samples = if recipe.look == Look::Color { 3.0 } else { 2.0 };
        let share = bytes as f64 / (1e6 * samples * recipe.megapixels());
        rows.push(row(&recipe, bytes, share));
        files.push(json!({ "path": path, "bytes": bytes, "of_raw": share }));
    }
    let head = vec!["raster", "Mpx", "MB", "of raw"];
    Ok(Chapter {
        name: "rasters",
        title: "Rasters",
        notes: Vec::new(),
        tables: vec![Table { title: "Made-up terrain".to_owned(), head, rows }],
        targets: Vec::new(),
        data: json!(files),
    })
}

fn row(recipe: &Recipe, bytes: u64, share: f64) -> Vec<String> {
    let megabytes = format!("{:.1}", bytes as f64 / 1e6);
    vec![recipe.name(), format!("{:.1}", recipe.megapixels()), megabytes, format!("{share:.3}")]
}

#[cfg(test)]
mod tests {
    use super::*;
    use areoid_formats::pyramid::{Extent, PoleContact, Pyramid};

    #[test]
    fn maps_of_the_book_halve_to_their_coarsest_level() {
        assert_eq!(global_size(FULL_MEGAPIXELS), (16_384, 8_192));
        assert_eq!(global_size(933.12), (43_200, 21_600));
        assert_eq!(global_size(50.0), (10_000, 5_000));
        for tenths in 1..20_000_u32 {
            let (width, height) = global_size(f64::from(tenths) / 10.0);
            let pole = PoleContact::Outline;
            let extent = Extent { width, height, wraps: true, north: pole, south: pole };
            assert!(Pyramid::new(extent, 512).is_ok(), "{width} x {height}");
        }
    }
}
