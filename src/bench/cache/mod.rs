//! `areoid bench cache`: arguments, and the chapters one after another.
//!
//! ```text
//!   planet, patches (made-up pages) ──┐
//!   flights ──────────────────────────┼─▶ frame     what an update costs its thread
//!                                     ├─▶ skipping  pages fetched over pages necessary
//!                                     ├─▶ ahead     what is there before it is needed
//!                                     ├─▶ budget    memory, and pages decoded twice
//!                                     ├─▶ eviction  which page goes, and is fetched again
//!                                     ├─▶ lookups   finding and loading a page, in process
//!                                     ├─▶ tree      many boxes, many changes
//!   service (a server, wrk, nginx) ───┴─▶ serve, live   pages over HTTP, and insertion meanwhile
//! ```

mod ahead;
mod budget;
mod eviction;
mod flights;
mod frame;
mod lookups;
mod patches;
mod planet;
mod replay;
mod service;
mod skipping;
mod tree;

#[cfg(feature = "viewer")]
pub(super) use replay::clock;

use std::fs;
use std::path::PathBuf;
use std::process::ExitCode;

use serde_json::json;

use self::service::Outside;
use super::peers::Peers;
use super::report::{Chapter, Report};
use crate::failure::Failure;
use crate::output;

/// The cache: what a frame costs, what is read and what is not, and what is there in time.
///
/// Writes cache.json and cache.md into the folder, and prints the tables. Pages are made up. Serving is
/// measured where wrk is installed, and compared with nginx if that is, too.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// The folder for results.
    #[arg(short, long, value_name = "DIR", default_value = "bench")]
    output: PathBuf,

    /// Only these chapters [default: all].
    #[arg(long, value_enum, value_name = "NAME", num_args = 1..)]
    chapter: Vec<ChapterArg>,

    /// How long each flight takes; those of the budgets together thirty times as long.
    #[arg(long, value_name = "SECONDS", default_value_t = 20.0)]
    seconds: f64,

    /// How large what is searched is: datasets, boxes and pages over those of the full size.
    #[arg(long, value_name = "SHARE", default_value_t = 1.0)]
    share: f64,

    /// Print the JSON instead of the tables.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum ChapterArg {
    /// What an update costs the thread that draws.
    Frame,
    /// Pages fetched over pages necessary.
    Skipping,
    /// What is in memory when it is first needed.
    Ahead,
    /// Memory in flight, and pages decoded twice.
    Budget,
    /// Which page goes when there is no room, and is fetched again.
    Eviction,
    /// Finding a page in memory, and loading one.
    Lookups,
    /// The tree over the datasets.
    Tree,
    /// Pages over HTTP, beside nginx.
    Serve,
    /// Pages over HTTP while a raster is inserted.
    Live,
}

/// What all chapters measure with.
#[derive(Clone, Copy, Debug)]
pub(super) struct Setting {
    /// Of a flight.
    pub(super) seconds: f64,
    /// Of the full size.
    pub(super) share: f64,
}

impl Setting {
    /// A share of a count, at least 1.
    pub(super) fn count(&self, full: u32) -> u32 {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a count")]
        let count = (f64::from(full) * self.share).ceil() as u32;
        count.max(1)
    }
}

impl Args {
    pub(super) fn run(self) -> Result<ExitCode, Failure> {
        let sound = |number: f64| number > 0.0 && number.is_finite();
        if !sound(self.seconds) || !sound(self.share) || self.share > 100.0 {
            let reason = "--seconds and --share must be positive, the share at most 100";
            return Err(Failure::Misused(reason.to_owned()));
        }
        fs::create_dir_all(&self.output)?;
        let setting = Setting { seconds: self.seconds, share: self.share };
        let all = [
            ChapterArg::Frame,
            ChapterArg::Skipping,
            ChapterArg::Ahead,
            ChapterArg::Budget,
            ChapterArg::Eviction,
            ChapterArg::Lookups,
            ChapterArg::Tree,
            ChapterArg::Serve,
            ChapterArg::Live,
        ];
        let wanted = if self.chapter.is_empty() { &all[..] } else { &self.chapter };
        let is_outside = |chapter| matches!(chapter, &ChapterArg::Serve | &ChapterArg::Live);
        let peers = if wanted.iter().any(is_outside) { Peers::servers() } else { Peers::none() };
        let outside = Outside { setting, folder: &self.output, peers: &peers };
        let mut chapters: Vec<Chapter> = Vec::new();
        for chapter in wanted {
            output::say(format!("{chapter:?} ..").to_lowercase());
            chapters.push(match chapter {
                ChapterArg::Frame => frame::measure(setting, &self.output)?,
                ChapterArg::Skipping => skipping::measure(setting)?,
                ChapterArg::Ahead => ahead::measure(setting)?,
                ChapterArg::Budget => budget::measure(setting)?,
                ChapterArg::Eviction => eviction::measure(setting)?,
                ChapterArg::Lookups => lookups::measure(setting, &self.output)?,
                ChapterArg::Tree => tree::measure(setting),
                ChapterArg::Serve => service::serve(&outside)?,
                ChapterArg::Live => service::live(&outside)?,
            });
        }
        super::timing::remove(&self.output.join("work"))?;
        let options = json!({ "seconds": self.seconds, "share": self.share });
        let title = "The cache, measured";
        let report = Report { title, options, peers, chapters };
        report.hand_out(&self.output, "cache", self.json)?;
        Ok(ExitCode::SUCCESS)
    }
}
