//! `areoid fly`: a flight, frame by frame, and what each took.
//!
//! ```text
//!   flight ─▶ replay ─┬─▶ figures ─▶ report, table
//!                     └─▶ film ────▶ pictures
//! ```

mod figures;
mod film;
mod replay;

use std::fs;
use std::io;
use std::path::PathBuf;
use std::process::ExitCode;

use areoid_cache::flight::Flight;
use areoid_viewer::Gpu;
use serde_json::json;

use self::figures::{Frame, Summary};
use self::film::Film;
pub(crate) use self::replay::Pace;
use self::replay::Replay;
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::output;
use crate::place::Source;
use crate::shot::Shot;

/// Replay a flight without a window, and say what its frames took.
///
/// A flight is a JSON file of keys, each a time, an eye and where it looks, between which the eye
/// moves smoothly: {"keys": [{"seconds": 0, "eye": [-133.8, 18.6, 900000], "look": [0, -90]}, ...]},
/// with longitude and latitude in degrees and meters above the reference surface, heading clockwise
/// from north and pitch up from the horizon.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    source: Source,

    /// The flight.
    #[arg(long, value_name = "F.json")]
    path: PathBuf,

    #[command(flatten)]
    shot: Shot,

    /// Frames, evenly over the flight, its first and its last moment among them [default: 30 for
    /// every second of the flight].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(MOST)))]
    frames: Option<u32>,

    /// When a frame is drawn.
    #[arg(long, value_enum, value_name = "PACE", default_value_t = Pace::Real)]
    pace: Pace,

    /// Where to write the figures of all frames and their summary, as JSON.
    #[arg(long, value_name = "F.json")]
    report: Option<PathBuf>,

    /// A folder for the pictures of all frames: frame-00000.png and so on. It appears once all are
    /// there. Where drawing is slow, writing them makes frames late: see --pace.
    #[arg(long, value_name = "DIR")]
    png: Option<PathBuf>,

    /// Replace the report, and the pictures of another flight in the folder.
    #[arg(long)]
    force: bool,

    /// Print the summary as JSON.
    #[arg(long)]
    json: bool,
}

/// Frames of a flight at most: their figures are in memory.
const MOST: u32 = 1_000_000;

/// Frames for a second of flight.
const RATE: f64 = 30.0;

impl Args {
    pub(crate) fn run(self) -> Result<ExitCode, Failure> {
        self.shot.check()?;
        let flight = self.flight()?;
        let frames = self.frames(&flight)?;
        if let Some(report) = self.report.as_ref().filter(|report| report.exists() && !self.force) {
            let reason = format!("{} exists: --force replaces it", report.display());
            return Err(io::Error::other(reason).into());
        }
        let interrupt = Interrupt::listen(|| output::say("stopping"))?;
        let film = self.png.as_ref().map(|folder| Film::begin(folder, frames, self.force));
        let mut film = film.transpose()?;
        let cache = self.source.open(self.shot.quality.memory_mib)?;
        let gpu = Gpu::headless()?;
        let replay =
            Replay { flight: &flight, frames, pace: self.pace, shot: &self.shot, gpu: &gpu };
        let all = replay.run(&cache, &interrupt, |number, renderer| match &mut film {
            Some(film) => film.add(number, renderer.read_color()),
            None => Ok(()),
        })?;

        let summary = Summary::new(&all.frames, all.took, &cache.stats());
        let [width, height] = self.shot.size;
        let mut document = json!({
            "flight": self.path, "flight_s": flight.seconds(), "pace": self.pace.to_string(),
            "width": width, "height": height, "adapter": gpu.description(), "summary": summary,
        });
        if let Some(film) = film {
            film.finish()?;
        }
        if let Some(report) = &self.report {
            document["frames"] = json!(all.frames);
            let bytes = serde_json::to_vec(&document).map_err(io::Error::from)?;
            output::write_file(report, &bytes)?;
        }
        if self.json {
            if let Some(document) = document.as_object_mut() {
                document.remove("frames");
            }
            output::json(&document)?;
        } else {
            output::line(summary.text(&gpu.description(), self.shot.size, flight.seconds()))?;
        }
        let met = |frame: &Frame| frame.missing == 0;
        let whole = all.failed == 0
            && cache.problems().is_empty()
            && (self.pace != Pace::Complete || all.frames.iter().all(met));
        Ok(if whole { ExitCode::SUCCESS } else { ExitCode::FAILURE })
    }

    fn flight(&self) -> Result<Flight, Failure> {
        let path = self.path.display();
        let text = fs::read_to_string(&self.path).map_err(|error| {
            io::Error::new(error.kind(), format!("cannot read the flight {path}: {error}"))
        })?;
        Flight::from_json(&text).map_err(|error| {
            let why = std::error::Error::source(&error)
                .map_or_else(String::new, |source| format!(": {source}"));
            io::Error::other(format!("{path}: {error}{why}")).into()
        })
    }

    fn frames(&self, flight: &Flight) -> Result<u32, Failure> {
        let natural = (RATE * flight.seconds()).round().max(1.0);
        match self.frames {
            Some(frames) => Ok(frames),
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "1 to MOST"
            )]
            None if natural <= f64::from(MOST) => Ok(natural as u32),
            None => {
                let seconds = flight.seconds();
                Err(Failure::Misused(format!(
                    "a flight of {seconds} s has more than {MOST} frames at {RATE} a second: say \
                     how many with --frames"
                )))
            }
        }
    }
}
