//! `areoid view`.

mod host;
mod saver;

use std::path::PathBuf;
use std::process::ExitCode;

use areoid_viewer::window::{WindowOptions, run};
use host::CacheHost;

use crate::args::{numbers, position};
use crate::failure::Failure;
use crate::place::Source;
use crate::shot::{Quality, read_style};

/// Show a catalog in a window.
///
/// Drag with the left button, or use the arrow keys, to move the ground; turn the wheel, or press
/// plus and minus, to come nearer; drag with the right button, or with Shift, to turn and tilt. Drag a
/// raster onto the window to insert it.
///
/// Keys: N turns north ahead, E exaggerates heights, L changes the light, A shows the atmosphere,
/// C colors by height, D shows levels, datasets, pages and what stands in, V shows two places, two
/// eyes or a wall of three screens, B puts a bookmark and 1 to 9 go to one, R begins and ends to record a flight, P saves a
/// screenshot, H hides the panel, Esc ends.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    source: Source,

    /// Above which place to start, in degrees.
    #[arg(
        long,
        value_name = "LON,LAT",
        allow_hyphen_values = true,
        value_parser = numbers::<2>,
        default_value = "0,0"
    )]
    start: [f64; 2],

    #[command(flatten)]
    quality: Quality,

    /// How datasets take part at first: weights, order, ramp, as the README has it.
    #[arg(long, value_name = "F.json")]
    style: Option<PathBuf>,
}

impl Args {
    pub(crate) fn run(self) -> Result<ExitCode, Failure> {
        self.quality.check()?;
        let start = position(self.start).map_err(Failure::Misused)?;
        let cache = self.source.open(self.quality.memory_mib)?;
        let style = read_style(self.style.as_deref(), &cache)?;
        let window = WindowOptions {
            title: format!("Areoid: {}", self.source.name()),
            ellipsoid: cache.body().ellipsoid,
            budget_bytes: self.quality.memory_bytes(),
            start,
            tolerance_px: self.quality.tolerance_px,
            style,
        };
        run(window, CacheHost::new(cache, self.source.folder()))?;
        Ok(ExitCode::SUCCESS)
    }
}
