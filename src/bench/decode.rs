//! Decoding a raster once: the least that any ingest of it has to do.

use std::path::PathBuf;
use std::process::ExitCode;

use areoid_preprocess::raster::{self, ReadOptions};

use crate::failure::Failure;
use crate::output;

/// Decode every block of a raster once, on one thread.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    raster: PathBuf,
}

impl Args {
    pub(super) fn run(self) -> Result<ExitCode, Failure> {
        let raster = raster::open(&self.raster, &ReadOptions::default())?;
        let (across, down) = raster.info().blocks();
        let mut pixels = 0;
        for row in 0..down {
            for col in 0..across {
                let block = raster.read_block(col, row)?;
                pixels += u64::from(block.width) * u64::from(block.height);
            }
        }
        output::line(format_args!("{pixels} pixels"))?;
        Ok(ExitCode::SUCCESS)
    }
}
