//! `areoid verify`.

use std::error::Error;
use std::path::PathBuf;
use std::process::ExitCode;

use areoid_formats::archive::Archive;
use areoid_formats::catalog::Catalog;
use areoid_preprocess::ingest;
use areoid_preprocess::verify::{Report, verify};
use serde_json::{Value, json};

use crate::failure::Failure;
use crate::output;

/// Check every byte of a catalog and recompute what it promises.
///
/// Checksums; bounds, nesting, continuity and no-data (laws 1 to 4); with a raster, the error of
/// every level against it. Exit 1 on any breach.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The catalog.
    #[arg(value_name = "DIR")]
    catalog: PathBuf,

    /// Measure against the raster the dataset was made from: all of them, in their order, for a
    /// mosaic.
    #[arg(long, value_name = "RASTER", num_args = 1.., requires = "dataset")]
    against: Vec<PathBuf>,

    /// Only this dataset, or the parts of this group.
    #[arg(long)]
    dataset: Option<String>,

    /// Print JSON.
    #[arg(long)]
    json: bool,
}

impl Args {
    pub(crate) fn run(self) -> Result<ExitCode, Failure> {
        let (catalog, archives) = Catalog::open_each(&self.catalog)?;
        if let Some(name) = &self.dataset {
            catalog.named(name)?;
        }
        let mut problems: Vec<String> = Vec::new();
        let mut levels: Vec<Value> = Vec::new();
        for (record, archive) in catalog.datasets().iter().zip(&archives) {
            if self.dataset.as_ref().is_some_and(|name| !record.answers_to(name)) {
                continue;
            }
            let archive = match archive {
                Ok(archive) => archive,
                Err(error) => {
                    problems.push(format!("{}: {}", record.name, with_causes(error)));
                    continue;
                }
            };
            let report = if self.against.is_empty() {
                verify(archive, None)?
            } else {
                let origin = ingest::reopen(&self.against, archive)?;
                verify(archive, Some(&*origin))?
            };
            problems.extend(report.problems.iter().map(|p| format!("{}: {p}", record.name)));
            levels.extend(level_rows(archive, &report, !self.against.is_empty()));
        }

        let ok = problems.is_empty();
        if self.json {
            output::json(&json!({ "ok": ok, "problems": problems, "levels": levels }))?;
        } else {
            for row in &levels {
                output::line(format_args!(
                    "{} level {}: bound {}, exact {}{}",
                    row["dataset"].as_str().unwrap_or_default(),
                    row["level"],
                    row["bound_max"],
                    row["exact_max"],
                    match row.get("measured_max") {
                        Some(max) => format!(", measured {max} (rms {})", row["measured_rms"]),
                        None => String::new(),
                    }
                ))?;
            }
            problems.iter().try_for_each(output::line)?;
            output::line(if ok { "all is well" } else { "not all is well" })?;
        }
        Ok(if ok { ExitCode::SUCCESS } else { ExitCode::FAILURE })
    }
}

/// An error and its causes on one line.
fn with_causes(error: &dyn Error) -> String {
    let causes = std::iter::successors(Some(error), |&error| error.source());
    causes.map(ToString::to_string).collect::<Vec<_>>().join(": ")
}

fn level_rows(archive: &Archive, report: &Report, measured: bool) -> Vec<Value> {
    let rows = report.levels.iter().enumerate();
    rows.map(|(number, level)| {
        let mut row = json!({
            "dataset": archive.description().dataset,
            "level": number,
            "bound_max": level.bound_max,
            "exact_max": level.exact_max,
        });
        if measured {
            row["measured_max"] = json!(level.measured_max);
            row["measured_rms"] = json!(level.measured_rms);
        }
        row
    })
    .collect()
}
