//! `areoid ingest`.

use std::borrow::Cow;
use std::error::Error;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use areoid_formats::catalog::RealDisk;
use areoid_formats::pyramid::Extent;
use areoid_preprocess::build::Progress;
use areoid_preprocess::estimate::{Estimate, Measured};
use areoid_preprocess::ingest::{
    Event, IngestError, Outcome, PartMade, Request, Unfinished, ingest,
};
use serde_json::json;

use crate::failure::Failure;
use crate::ingest_options::IngestOptions;
use crate::interrupt::Interrupt;
use crate::progress::{Bar, Screen};
use crate::resources::PeakMemory;
use crate::{output, resources};

/// Turn rasters into a dataset of a catalog.
///
/// The leaves of the dataset are the rasters' own pixels, unless another grid, another pixel size or
/// normals are asked for. Several rasters make a mosaic: a later one covers an earlier one where it
/// has data.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    options: IngestOptions,

    /// The catalog, a folder; it is made if it is not there.
    #[arg(long, value_name = "DIR")]
    catalog: PathBuf,

    /// How often to note where the work stands: about as much as --resume has to do again.
    #[arg(long, allow_hyphen_values = true, value_name = "SECONDS", default_value_t = 15.0, value_parser = seconds)]
    note_every_s: f64,

    /// Go on with an unfinished build of the same input and options. Without it such a build is
    /// discarded.
    #[arg(long)]
    resume: bool,

    /// Print a summary as JSON.
    #[arg(long)]
    json: bool,
}

impl Args {
    pub(crate) fn run(self) -> Result<ExitCode, Failure> {
        self.options.check()?;
        let as_json = self.json;
        let request = self.request();
        let peak = PeakMemory::watch();
        let screen = Arc::new(Screen::new(if as_json { Bar::Unwanted } else { Bar::Wanted }));
        let seen_by_handler = Arc::clone(&screen);
        let interrupt = Interrupt::listen(move || seen_by_handler.say_stopping())?;
        let outcome = ingest(&RealDisk, &request, |event| {
            screen.show(&event);
            match &event {
                Event::Estimated(estimate) => {
                    warn_of_full_disk(&screen, estimate, &request.catalog);
                }
                Event::ShortOfMemory { least_bytes } => screen.say(format!(
                    "warning: a step of the work needs more than --memory-mib {}: {} is the least",
                    request.memory_bytes >> 20,
                    least_bytes.div_ceil(1 << 20)
                )),
                _ => {}
            }
            interrupt.proceed()
        });
        screen.clear();
        let outcome = outcome.map_err(|error| failure(error, screen.progress()))?;
        if as_json {
            output::json(&summary(&outcome, peak.bytes()))?;
        } else {
            output::line(text(&outcome))?;
        }
        Ok(ExitCode::SUCCESS)
    }

    fn request(self) -> Request {
        Request {
            unfinished: if self.resume { Unfinished::Resume } else { Unfinished::Discard },
            note_every: Duration::from_secs_f64(self.note_every_s),
            ..self.options.request(self.catalog)
        }
    }
}

/// A number of seconds, up to a year.
fn seconds(text: &str) -> Result<f64, String> {
    let seconds: f64 = text.parse().map_err(|error| format!("{text:?}: {error}"))?;
    if (0.0..3.2e7).contains(&seconds) {
        Ok(seconds)
    } else {
        Err("expected 0 to a year".to_owned())
    }
}

/// Says beforehand that there is not enough room for what is expected.
fn warn_of_full_disk(screen: &Screen, estimate: &Estimate, catalog: &Path) {
    let (Some(measured), Some(free)) = (estimate.measured, resources::free_bytes(catalog)) else {
        return;
    };
    if free < measured.bytes {
        let gigabytes = |bytes: u64| bytes as f64 / 1e9;
        screen.say(format!(
            "warning: {:.2} GB are free where the catalog is, and about {:.2} GB to be written",
            gigabytes(free),
            gigabytes(measured.bytes)
        ));
    }
}

/// An ingest that did not come to its end, with how to go on if that is possible.
fn failure(error: IngestError, progress: Option<Progress>) -> Failure {
    let can_be_resumed = error.can_be_resumed();
    let reason: Box<dyn Error> = match progress {
        Some(Progress { units_done, units_resumed, units, .. }) if error.is_interruption() => {
            format!("interrupted after {} of {units} units", units_done.max(units_resumed)).into()
        }
        _ => error.into(),
    };
    if !can_be_resumed {
        return Failure::Failed(reason);
    }
    let arguments: Vec<_> = std::env::args_os().collect();
    let arguments = arguments.iter().map(|argument| argument.to_string_lossy());
    Failure::Unfinished { reason, command: command_to_go_on(arguments) }
}

/// The command line with `--resume`, for a POSIX shell.
fn command_to_go_on<'a>(arguments: impl Iterator<Item = Cow<'a, str>>) -> String {
    let mut arguments: Vec<_> = arguments.collect();
    // Behind `--` it would be a raster.
    let end = arguments.iter().position(|argument| argument == "--").unwrap_or(arguments.len());
    if !arguments[..end].iter().any(|argument| argument == "--resume") {
        arguments.insert(end, "--resume".into());
    }
    let quoted: Vec<_> = arguments.iter().map(|argument| quoted(argument)).collect();
    quoted.join(" ")
}

/// An argument as a POSIX shell reads it.
fn quoted(argument: &str) -> Cow<'_, str> {
    let plain = |c: char| c.is_ascii_alphanumeric() || "_./,:=@%+-".contains(c);
    if !argument.is_empty() && argument.chars().all(plain) {
        argument.into()
    } else {
        format!("'{}'", argument.replace('\'', r"'\''")).into()
    }
}

fn summary(outcome: &Outcome, peak: u64) -> serde_json::Value {
    let parts = outcome.parts.iter().map(|part| {
        json!({
            "name": part.name,
            "grid": areoid_cache::describe::grid(&part.grid),
            "pages": pages(part),
            "bytes": part.bytes,
        })
    });
    json!({
        "dataset": outcome.dataset,
        "parts": parts.collect::<Vec<_>>(),
        "saved_texels": outcome.saved.map(|saved| saved.texels),
        "saved_bytes": outcome.saved.and_then(|saved| saved.bytes),
        "already_there": outcome.already_there,
        "generation": outcome.generation,
        "pages": outcome.parts.iter().map(pages).sum::<u64>(),
        "bytes": outcome.bytes,
        "seconds": outcome.seconds,
        "cpu_seconds": resources::cpu_seconds(),
        "mpx_per_s": outcome.pixels as f64 / 1e6 / outcome.seconds,
        "peak_memory_bytes": peak,
        "decoded_blocks": outcome.decoded_blocks,
        "estimate": outcome.estimate.as_ref().map(estimate),
        "bound": largest(outcome, |level| level.bound_max),
        "source_error": largest(outcome, |level| level.source_error_max),
        "resumed_units": outcome.resumed_units,
    })
}

/// Bytes and seconds are null where nothing was measured.
fn estimate(estimate: &Estimate) -> serde_json::Value {
    let measured = estimate.measured;
    json!({
        "pages": estimate.pages,
        "bytes": measured.map(|measured| measured.bytes),
        "seconds": measured.map(|measured| measured.seconds),
        "decoded_blocks": measured.map_or(0, |measured| measured.decoded_blocks),
    })
}

fn largest(outcome: &Outcome, field: fn(&areoid_formats::archive::LevelSummary) -> f32) -> f32 {
    let levels = outcome.parts.iter().flat_map(|part| &part.summary.levels);
    levels.map(field).fold(0.0, f32::max)
}

/// Pages of all levels.
fn pages(part: &PartMade) -> u64 {
    part.summary.levels.iter().map(|level| level.pages).sum()
}

fn text(outcome: &Outcome) -> String {
    let all_pages: u64 = outcome.parts.iter().map(pages).sum();
    let Outcome { dataset, bytes, seconds, .. } = outcome;
    if outcome.already_there {
        return format!("{dataset}: already there, made from the same input: nothing to do");
    }
    let rate = outcome.pixels as f64 / 1e6 / seconds;
    let bound = largest(outcome, |level| level.bound_max);
    let error = largest(outcome, |level| level.source_error_max);
    let mut text = format!(
        "{dataset}: {all_pages} pages, {bytes} bytes in {seconds:.2} s ({rate:.1} Mpx/s); \
         coarsest bound {bound}, error against the source {error}; {} blocks decoded",
        outcome.decoded_blocks
    );
    if outcome.resumed_units > 0 {
        let _ = write!(text, ", {} units kept of an earlier build", outcome.resumed_units);
    }
    if let Some(measured) = outcome.estimate.and_then(|estimate| estimate.measured) {
        let Measured { bytes, seconds, .. } = measured;
        let _ = write!(text, "; expected were {bytes} bytes in {seconds:.2} s");
    }
    if let Some(saved) = outcome.saved {
        for part in &outcome.parts {
            let PartMade { name, bytes, .. } = part;
            let Extent { width, height, .. } = part.grid.pyramid().extent();
            let pages = pages(part);
            let _ = write!(text, "\n  {name}: {width} x {height}, {pages} pages, {bytes} bytes");
        }
        let _ = write!(text, "\n  beside one pyramid {} texels", told(saved.texels));
        if let Some(bytes) = saved.bytes {
            let _ = write!(text, ", and {} bytes", told(bytes));
        }
    }
    text
}

/// How much was saved, or not.
fn told(saved: i64) -> String {
    let what = if saved < 0 { "more" } else { "fewer" };
    format!("{} {what}", saved.unsigned_abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_to_go_on_is_one_a_shell_reads_back() {
        let go_on = |arguments: &[&str]| {
            command_to_go_on(arguments.iter().map(|&argument| Cow::Borrowed(argument)))
        };
        let plain = ["areoid", "ingest", "a/b.tif", "--extent", "-10,-34,10,8"];
        assert_eq!(go_on(&plain), "areoid ingest a/b.tif --extent -10,-34,10,8 --resume");
        let odd = ["areoid", "ingest", "--resume", "it's a map.tif", ""];
        assert_eq!(go_on(&odd), r"areoid ingest --resume 'it'\''s a map.tif' ''");
        let behind = ["areoid", "ingest", "--", "--resume"];
        assert_eq!(go_on(&behind), "areoid ingest --resume -- --resume");
    }
}
