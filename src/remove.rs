//! `areoid remove`.

use std::path::PathBuf;
use std::process::ExitCode;

use areoid_formats::catalog::{RealDisk, remove_dataset};

use crate::failure::Failure;
use crate::output;

/// Remove a dataset, or all parts of a group, from a catalog.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The catalog.
    #[arg(value_name = "DIR")]
    catalog: PathBuf,

    /// The dataset or group.
    dataset: String,

    /// Print JSON.
    #[arg(long)]
    json: bool,
}

impl Args {
    pub(crate) fn run(self) -> Result<ExitCode, Failure> {
        let generation = remove_dataset(&RealDisk, &self.catalog, &self.dataset)?;
        if self.json {
            let removed = &self.dataset;
            output::json(&serde_json::json!({ "removed": removed, "generation": generation }))?;
        } else {
            output::line(format_args!("{}: removed", self.dataset))?;
        }
        Ok(ExitCode::SUCCESS)
    }
}
