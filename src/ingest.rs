//! `areoid ingest`.

use std::borrow::Cow;
use std::error::Error;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use areoid_formats::archive::MipRule;
use areoid_formats::catalog::RealDisk;
use areoid_formats::codec::Quantum;
use areoid_formats::geodesy::LatitudeKind;
use areoid_formats::page::Kind;
use areoid_formats::projection::Pole;
use areoid_formats::pyramid::{Extent, Pyramid};
use areoid_formats::units::Meters;
use areoid_preprocess::build::Progress;
use areoid_preprocess::estimate::{Estimate, Measured};
use areoid_preprocess::ingest::{
    Event, Existing, IngestError, Outcome, PartMade, Reading, Request, TargetGrid, Unfinished,
    ingest,
};
use areoid_preprocess::resample::kernel::{Kernel, RangeLimit};
use areoid_preprocess::resample::target::TargetMap;
use serde_json::json;

use crate::args::numbers;
use crate::failure::Failure;
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

/// What to ingest, and how: the same for a catalog and for a server.
#[derive(Debug, clap::Args)]
pub(crate) struct IngestOptions {
    /// Rasters: `GeoTIFF` or `BigTIFF`; JPEG or PNG with a world file.
    #[arg(required = true, value_name = "RASTER")]
    rasters: Vec<PathBuf>,

    /// The dataset's name [default: the stem of the first raster, with .normal behind it for normals].
    #[arg(long)]
    name: Option<String>,

    /// What the dataset shows: the samples as heights or as colors, or the normals of the ground whose
    /// heights they are [default: height for one band, color for three or four].
    #[arg(long, value_enum)]
    kind: Option<KindArg>,

    /// The body: mercury, venus, earth, moon, mars, mars-ellipsoid, or its radii in meters
    /// [default: what the raster says].
    #[arg(long, value_name = "NAME|A,B")]
    body: Option<String>,

    /// The grid of the dataset: the rasters' own, or one they are resampled to. A whole globe can be
    /// split into three datasets that are named, replaced and removed as one: NAME.band on its own
    /// grid, and about the poles NAME.north and NAME.south, where all meridians crowd on its own.
    #[arg(long, value_enum, default_value = "native")]
    grid: GridArg,

    /// Store heights on a step of so many meters, within the bound; 0 is lossless [default: the
    /// raster's own quantum].
    #[arg(long, allow_hyphen_values = true, value_name = "METERS", value_parser = step)]
    step_m: Option<f64>,

    /// Texels along a page's side, its border included.
    #[arg(long, value_name = "TEXELS", default_value_t = 512, value_parser = page_side)]
    page_size: u32,

    /// The sample that stands for no data [default: what the raster says].
    #[arg(long, allow_hyphen_values = true, value_name = "VALUE")]
    nodata: Option<f64>,

    /// The coordinate system: EPSG:n, a PROJ string, WKT, or a file that holds one
    /// [default: what the raster says].
    #[arg(long, allow_hyphen_values = true, value_name = "TEXT|FILE")]
    crs: Option<String>,

    /// What the raster's latitudes are [default: planetocentric for a map on a sphere of an
    /// ellipsoidal body, else planetographic].
    #[arg(long, value_enum)]
    latitudes: Option<LatitudesArg>,

    /// Where the raster's outer edges lie, in degrees or meters of its coordinate system
    /// [default: what the raster says].
    #[arg(long, allow_hyphen_values = true, value_name = "W,S,E,N", value_parser = numbers::<4>)]
    extent: Option<[f64; 4]>,

    /// Datasets of higher priority cover those of lower.
    #[arg(long, allow_hyphen_values = true, default_value_t = 0)]
    priority: i32,

    /// How texels between pixels are found on another grid [default: spline]; a raster's own grid
    /// needs none.
    #[arg(long, value_enum, value_name = "KERNEL")]
    kernel: Option<KernelArg>,

    /// The degree of the spline kernel: 3 or 5.
    #[arg(long, value_name = "DEGREE", default_value_t = 5, value_parser = spline_degree)]
    spline_degree: u8,

    /// Keep resampled texels within the range of the pixels around them.
    #[arg(long)]
    limit_range: bool,

    /// Meters to a texel, where the grid's map is truest [default: those of the rasters].
    #[arg(long, value_name = "METERS", value_parser = pixel_size)]
    pixel_size_m: Option<f64>,

    /// How coarser levels are made of finer ones: by the mean of two by two texels, or by a low-pass
    /// over twelve by twelve (Kaiser's window on a sinc), which keeps more of what a level can show and
    /// less of what it cannot. Beside missing texels it is the mean.
    #[arg(long, value_enum, value_name = "RULE", default_value = "mean")]
    mip: MipArg,

    /// Memory to use: what exceeds it waits in a file beside the archive. Two work units must fit,
    /// of 64 leaves each.
    #[arg(long, value_name = "MIB", default_value_t = 2048)]
    memory_mib: u64,

    /// Threads [default: one a core].
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,

    /// Replace a dataset of this name that was made from something else.
    #[arg(long)]
    force: bool,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum KindArg {
    Height,
    Color,
    Normal,
}

#[derive(Clone, Copy, Debug, PartialEq, clap::ValueEnum)]
enum GridArg {
    Native,
    Equirectangular,
    PolarNorth,
    PolarSouth,
    Split,
}

/// A kernel, without the degree of a spline.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum KernelArg {
    Nearest,
    Bilinear,
    Cubic,
    Lanczos,
    Spline,
    Average,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum MipArg {
    Mean,
    Kaiser,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum LatitudesArg {
    Planetographic,
    Planetocentric,
}

impl KernelArg {
    /// The kernel, of degree `spline_degree` if it is a spline: 3, else 5.
    pub(crate) fn kernel(self, spline_degree: u8) -> Kernel {
        match self {
            Self::Nearest => Kernel::Nearest,
            Self::Bilinear => Kernel::Bilinear,
            Self::Cubic => Kernel::Cubic,
            Self::Lanczos => Kernel::Lanczos,
            Self::Spline if spline_degree == 3 => Kernel::CubicSpline,
            Self::Spline => Kernel::QuinticSpline,
            Self::Average => Kernel::Average,
        }
    }
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
                    "warning: two work units need more than --memory-mib {}: {} is the least",
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

impl IngestOptions {
    /// Refuses what makes no sense, and warns of what has no effect.
    pub(crate) fn check(&self) -> Result<(), Failure> {
        if self.grid == GridArg::Split && self.pixel_size_m.is_some() {
            let reason = "--grid split keeps the raster's own pixels: leave out --pixel-size-m";
            return Err(Failure::Misused(reason.to_owned()));
        }
        let own_grid = self.grid == GridArg::Native && self.pixel_size_m.is_none();
        if self.kernel.is_some() && own_grid {
            output::say("warning: --kernel has no effect on the raster's own grid");
        }
        Ok(())
    }

    /// The ingest into `catalog`, which discards what is unfinished.
    pub(crate) fn request(self, catalog: PathBuf) -> Request {
        Request {
            rasters: self.rasters,
            catalog,
            name: self.name,
            kind: self.kind.map(|kind| match kind {
                KindArg::Height => Kind::Height,
                KindArg::Color => Kind::Color,
                KindArg::Normal => Kind::Normal,
            }),
            step_m: self.step_m,
            grid: match self.grid {
                GridArg::Native => TargetGrid::One(TargetMap::Native),
                GridArg::Equirectangular => TargetGrid::One(TargetMap::Equirectangular),
                GridArg::PolarNorth => TargetGrid::One(TargetMap::Polar(Pole::North)),
                GridArg::PolarSouth => TargetGrid::One(TargetMap::Polar(Pole::South)),
                GridArg::Split => TargetGrid::Split,
            },
            pixel_size: self.pixel_size_m.map(Meters),
            kernel: self.kernel.unwrap_or(KernelArg::Spline).kernel(self.spline_degree),
            limit: if self.limit_range { RangeLimit::Taps } else { RangeLimit::None },
            mip: match self.mip {
                MipArg::Mean => MipRule::Mean,
                MipArg::Kaiser => MipRule::Kaiser,
            },
            page_side: self.page_size,
            priority: self.priority,
            threads: self.threads.map(usize::from),
            existing: if self.force { Existing::Replace } else { Existing::Keep },
            unfinished: Unfinished::Discard,
            memory_bytes: self.memory_mib.saturating_mul(1 << 20),
            note_every: Duration::from_secs(15),
            reading: Reading {
                crs: self.crs,
                extent: self.extent,
                nodata: self.nodata,
                body: self.body,
                latitudes: self.latitudes.map(|latitudes| match latitudes {
                    LatitudesArg::Planetographic => LatitudeKind::Planetographic,
                    LatitudesArg::Planetocentric => LatitudeKind::Planetocentric,
                }),
                within: None,
            },
        }
    }
}

/// A step that heights can be stored on, or 0.
fn step(text: &str) -> Result<f64, String> {
    let step: f64 = text.parse().map_err(|error| format!("{error}"))?;
    Quantum::new(step, 0.0).map_err(|_| "expected 0, or 1e-30 to 1e28".to_owned())?;
    Ok(step)
}

/// Texels along a page's side.
fn page_side(text: &str) -> Result<u32, String> {
    let side: u32 = text.parse().map_err(|error| format!("{error}"))?;
    if Pyramid::is_page_side(side) {
        Ok(side)
    } else {
        Err("expected an even number from 8 to 4096".to_owned())
    }
}

/// A degree that there is a spline of.
fn spline_degree(text: &str) -> Result<u8, String> {
    match text {
        "3" => Ok(3),
        "5" => Ok(5),
        _ => Err("expected 3 or 5".to_owned()),
    }
}

/// A positive number of meters.
fn pixel_size(text: &str) -> Result<f64, String> {
    let meters: f64 = text.parse().map_err(|error| format!("{error}"))?;
    let positive = meters > 0.0 && meters.is_finite();
    if positive { Ok(meters) } else { Err("expected a positive number".to_owned()) }
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
        "saved_bytes": outcome.saved.map(|saved| saved.bytes),
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
        let (texels, bytes) = (told(saved.texels), told(saved.bytes));
        let _ = write!(text, "\n  beside one pyramid {texels} texels, and about {bytes} bytes");
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
