//! `areoid view`.

use std::process::ExitCode;

use areoid_viewer::window::{WindowOptions, run};

use crate::args::{numbers, position};
use crate::failure::Failure;
use crate::place::Source;

/// Show a catalog in a window.
///
/// Drag with the left button, or use the arrow keys, to move the ground; turn the wheel, or press
/// plus and minus, to come nearer; drag with the right button, or with Shift, to turn and tilt. N
/// turns north ahead, E exaggerates heights, Esc ends.
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

    /// How far heights may be off on the screen, and how large the texels of a color may be.
    #[arg(long, value_name = "PIXELS", default_value_t = 1.0)]
    tolerance_px: f64,

    /// Memory for pages, in mebibytes.
    #[arg(long, value_name = "MIB", default_value_t = 1024)]
    memory_mib: usize,
}

impl Args {
    pub(crate) fn run(self) -> Result<ExitCode, Failure> {
        if !(self.tolerance_px > 0.0 && self.tolerance_px.is_finite()) || self.memory_mib == 0 {
            let reason = "--tolerance-px and --memory-mib must be positive";
            return Err(Failure::Misused(reason.to_owned()));
        }
        let start = position(self.start).map_err(Failure::Misused)?;
        let cache = self.source.open(self.memory_mib)?;
        let mut session = cache.session();
        let window = WindowOptions {
            title: format!("Areoid: {}", self.source.name()),
            ellipsoid: cache.body().ellipsoid,
            start,
            tolerance_px: self.tolerance_px,
        };
        run(window, |view| session.update(view))?;
        Ok(ExitCode::SUCCESS)
    }
}
