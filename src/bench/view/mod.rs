//! `areoid bench view`: arguments, and the chapters one after another.
//!
//! ```text
//!   world (ingested terrain) ─┬─▶ flights  known flights, beside their authors' figures
//!                             └─▶ stage ─▶ cost, loads, skipping   what a frame costs
//! ```

mod cost;
mod flights;
mod loads;
mod skipping;
mod stage;
mod world;

use std::fs;
use std::path::PathBuf;
use std::process::ExitCode;

use areoid_viewer::Gpu;
use serde_json::json;

use self::world::World;
use super::peers::Peers;
use super::report::{Chapter, Report};
use super::timing;
use crate::failure::Failure;
use crate::fly::Pace;
use crate::output;
use crate::shot;

/// The viewer: what known flights show in time, and what a frame costs.
///
/// Writes view.json and view.md into the folder, and prints the tables. Planets are made up, unless
/// one is given, and kept in the folder. Without a GPU the processor draws, and shares itself with
/// all else: then ratios tell, and times do not.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The folder for results, rasters and what is made on the way.
    #[arg(short, long, value_name = "DIR", default_value = "bench")]
    output: PathBuf,

    /// Only these chapters [default: all].
    #[arg(long, value_enum, value_name = "NAME", num_args = 1..)]
    chapter: Vec<ChapterArg>,

    /// The catalog of Mars that the flights pass over, a folder or the address of a server [default:
    /// a made-up one].
    #[arg(long, value_name = "DIR|URL")]
    catalog: Option<String>,

    /// Size of the pictures in pixels.
    #[arg(long, value_name = "WxH", default_value = "640x360", value_parser = shot::size)]
    size: [u32; 2],

    /// Frames of each flight [default: 30 for every second of it].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    frames: Option<u32>,

    /// When a frame of a flight is drawn.
    #[arg(long, value_enum, value_name = "PACE", default_value_t = Pace::Real)]
    pace: Pace,

    /// How often each frame of the other chapters is drawn.
    #[arg(long, value_name = "N", default_value_t = 40, value_parser = clap::value_parser!(u32).range(1..))]
    rounds: u32,

    /// Size of the made-up planet's map.
    #[arg(long, value_name = "NUMBER", default_value_t = 8.4)]
    megapixels: f64,

    /// Print the JSON instead of the tables.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum ChapterArg {
    /// White 2011's three scenes, and Kooima 2008's descent and return.
    Flights,
    /// A frame over the cheapest picture, many datasets over one, a pole over the equator.
    Cost,
    /// A frame while pages are loaded over one while none is.
    Loads,
    /// What a picture is made of, beside what of it shows.
    Skipping,
}

/// What all chapters measure with.
#[derive(Debug)]
struct Setting {
    gpu: Gpu,
    world: World,
    catalog: Option<String>,
    size: [u32; 2],
    frames: Option<u32>,
    pace: Pace,
    rounds: u32,
}

impl Args {
    pub(super) fn run(self) -> Result<ExitCode, Failure> {
        if !(self.megapixels > 0.0 && self.megapixels <= 10_000.0) {
            return Err(Failure::Misused("--megapixels must be positive".to_owned()));
        }
        fs::create_dir_all(&self.output)?;
        let setting = Setting {
            gpu: Gpu::headless()?,
            world: World::new(&self.output, self.megapixels)?,
            catalog: self.catalog,
            size: self.size,
            frames: self.frames,
            pace: self.pace,
            rounds: self.rounds,
        };
        let all = [ChapterArg::Flights, ChapterArg::Cost, ChapterArg::Loads, ChapterArg::Skipping];
        let wanted = if self.chapter.is_empty() { &all[..] } else { &self.chapter };
        let mut chapters: Vec<Chapter> = Vec::new();
        for chapter in wanted {
            output::say(format!("{chapter:?} ..").to_lowercase());
            chapters.push(match chapter {
                ChapterArg::Flights => flights::measure(&setting)?,
                ChapterArg::Cost => cost::measure(&setting)?,
                ChapterArg::Loads => loads::measure(&setting)?,
                ChapterArg::Skipping => skipping::measure(&setting)?,
            });
        }
        timing::remove(&self.output.join("work"))?;
        let options = json!({
            "adapter": setting.gpu.description(), "size": self.size, "rounds": self.rounds,
            "megapixels": self.megapixels, "pace": self.pace.to_string(), "catalog": setting.catalog,
        });
        let title = "The viewer, measured";
        let report = Report { title, options, peers: Peers::none(), chapters };
        report.hand_out(&self.output, "view", self.json)?;
        Ok(ExitCode::SUCCESS)
    }
}

impl Setting {
    /// What was drawn with, as a note.
    fn drawn_with(&self) -> String {
        let [width, height] = self.size;
        format!("Pictures of {width}x{height} pixels, drawn with {}.", self.gpu.description())
    }
}
