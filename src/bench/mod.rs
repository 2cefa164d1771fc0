//! `areoid bench`: the benchmark book. A book has chapters, a chapter has targets.
//!
//! ```text
//!   terrain ─▶ geotiff ─▶ rasters ─┬─▶ pairs      ingest against what others do, run by run
//!                                  ├─▶ tightness  bounds against exact errors
//!   timing, peers ─────────────────┼─▶ size       bytes at zero error, and how fast they decode
//!                                  ├─▶ scaling    time and memory from small maps to large
//!   waves ─────────────────────────┴─▶ warp       resampling: time and error beside gdalwarp
//!                                        └─▶ report: JSON, tables, targets
//! ```
//!
//! What is timed runs as a process of its own, this program included, so that all are measured in
//! the same way.

mod cache;
mod decode;
mod geotiff;
mod ingest;
mod pairs;
mod peers;
mod processors;
mod rasters;
mod report;
mod resample;
mod scaling;
mod size;
mod terrain;
mod tightness;
mod timing;
#[cfg(feature = "viewer")]
mod view;
mod warp;
mod waves;

use std::process::ExitCode;

use crate::failure::Failure;

/// Measure this program, on this machine, beside others that are installed.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    book: Book,
}

#[derive(Debug, clap::Subcommand)]
enum Book {
    Ingest(ingest::Args),
    Cache(cache::Args),
    #[cfg(feature = "viewer")]
    View(view::Args),
    #[command(hide = true)]
    Decode(decode::Args),
    #[command(hide = true)]
    Resample(resample::Args),
}

impl Args {
    pub(crate) fn run(self) -> Result<ExitCode, Failure> {
        match self.book {
            Book::Ingest(args) => args.run(),
            Book::Cache(args) => args.run(),
            #[cfg(feature = "viewer")]
            Book::View(args) => args.run(),
            Book::Decode(args) => args.run(),
            Book::Resample(args) => args.run(),
        }
    }
}
