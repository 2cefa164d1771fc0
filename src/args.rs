//! The arguments: their documentation is the manual.

use std::process::ExitCode;

use areoid_formats::geodesy::Geographic;
use areoid_formats::units::Degrees;
use clap::{Parser, Subcommand};

use crate::failure::Failure;

/// Planetary rasters into bordered pages with proven error bounds, streamed to whoever draws the
/// planet.
///
/// Results go to stdout, everything else to stderr. Exit 0: done; 1: failed; 2: misused.
#[derive(Debug, Parser)]
#[command(version, max_term_width = 100)]
pub(crate) struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Ingest(crate::ingest::Args),
    Insert(crate::insert::Args),
    Info(crate::info::Args),
    Page(crate::page::Args),
    Height(crate::height::Args),
    Verify(crate::verify::Args),
    Remove(crate::remove::Args),
    Serve(crate::serve::Args),
    Bench(crate::bench::Args),
    #[cfg(feature = "viewer")]
    Snapshot(crate::snapshot::Args),
    #[cfg(feature = "viewer")]
    View(crate::view::Args),
    #[cfg(feature = "viewer")]
    Fly(crate::fly::Args),
}

impl Cli {
    pub(crate) fn run(self) -> Result<ExitCode, Failure> {
        match self.command {
            Command::Ingest(args) => args.run(),
            Command::Insert(args) => args.run(),
            Command::Info(args) => args.run(),
            Command::Page(args) => args.run(),
            Command::Height(args) => args.run(),
            Command::Verify(args) => args.run(),
            Command::Remove(args) => args.run(),
            Command::Serve(args) => args.run(),
            Command::Bench(args) => args.run(),
            #[cfg(feature = "viewer")]
            Command::Snapshot(args) => args.run(),
            #[cfg(feature = "viewer")]
            Command::View(args) => args.run(),
            #[cfg(feature = "viewer")]
            Command::Fly(args) => args.run(),
        }
    }
}

/// `N` numbers with commas between them.
pub(crate) fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|n| n.trim().parse::<f64>()).collect();
    let numbers = numbers.map_err(|error| format!("{text:?}: {error}"))?;
    if numbers.iter().any(|number| !number.is_finite()) {
        return Err(format!("{text:?}: every number must be finite"));
    }
    let count = numbers.len();
    numbers.try_into().map_err(|_| format!("expected {N} numbers with commas, found {count}"))
}

/// A longitude of any turn and a latitude, in degrees.
pub(crate) fn position([longitude, latitude]: [f64; 2]) -> Result<Geographic, String> {
    if !(longitude.is_finite() && (-90.0..=90.0).contains(&latitude)) {
        return Err(format!("{longitude},{latitude} is no position: latitudes are -90 to 90"));
    }
    // Whole turns are exact in degrees, not in radians.
    Ok(Geographic::from_degrees(Degrees(longitude % 360.0), Degrees(latitude)))
}
