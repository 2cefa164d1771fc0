//! `areoid remove`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use areoid_cache::remote::{self, Client};
use areoid_formats::catalog::{RealDisk, remove_dataset};

use crate::failure::Failure;
use crate::output;

/// Remove a dataset, or all parts of a group, from a catalog or a server.
#[derive(Debug, clap::Args)]
#[command(
    override_usage = "areoid remove [--json] <DIR> <DATASET>\n       areoid remove [--json] --server <URL> --token-file <FILE> <DATASET>"
)]
pub(crate) struct Args {
    /// The catalog, unless there is a server; then the dataset or group.
    #[arg(value_name = "DIR DATASET", required = true, num_args = 1..=2)]
    names: Vec<PathBuf>,

    /// A server's admin listener, instead of a catalog.
    #[arg(long, value_name = "URL", requires = "token_file")]
    server: Option<String>,

    /// A file whose first line is the server's token.
    #[arg(long, value_name = "FILE", requires = "server")]
    token_file: Option<PathBuf>,

    /// Print JSON.
    #[arg(long)]
    json: bool,
}

impl Args {
    pub(crate) fn run(self) -> Result<ExitCode, Failure> {
        let (dataset, generation) = match (&self.names[..], self.server, self.token_file) {
            ([dataset], Some(server), Some(token)) => {
                let dataset = text(dataset)?;
                let removed =
                    remote::remove(&Client::new(&server)?, &read_token(&token)?, dataset)?;
                (dataset, removed["generation"].as_u64().unwrap_or_default())
            }
            ([catalog, dataset], None, None) => {
                let dataset = text(dataset)?;
                (dataset, remove_dataset(&RealDisk, catalog, dataset)?)
            }
            _ => {
                let reason = "expected DIR DATASET, or --server URL --token-file FILE DATASET";
                return Err(Failure::Misused(reason.to_owned()));
            }
        };
        if self.json {
            output::json(&serde_json::json!({ "removed": dataset, "generation": generation }))?;
        } else {
            output::line(format_args!("{dataset}: removed"))?;
        }
        Ok(ExitCode::SUCCESS)
    }
}

fn text(name: &Path) -> Result<&str, Failure> {
    let reason = || Failure::Misused(format!("no dataset is called {}", name.display()));
    name.to_str().ok_or_else(reason)
}

/// The first line of a file that holds a server's token.
pub(crate) fn read_token(path: &Path) -> Result<String, Failure> {
    let text = std::fs::read_to_string(path).map_err(|error| {
        std::io::Error::new(error.kind(), format!("cannot read {}: {error}", path.display()))
    })?;
    Ok(text.lines().next().unwrap_or_default().trim().to_owned())
}
