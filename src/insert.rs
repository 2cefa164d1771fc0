//! `areoid insert`.

use std::path::PathBuf;
use std::process::ExitCode;

use areoid_cache::insertion::Lifetime;
use areoid_cache::insertion_request::InsertRequest;
use areoid_cache::remote::{self, Client};

use crate::failure::Failure;
use crate::ingest_options::IngestOptions;
use crate::output;
use crate::remove::read_token;

/// Turn rasters into a dataset of a running server, and wait until everybody sees it.
///
/// The server reads the rasters itself: paths are sent to it as absolute ones, and must lie in a
/// folder that it was started with as --allow.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    options: IngestOptions,

    /// The server's admin listener.
    #[arg(long, value_name = "URL")]
    server: String,

    /// A file whose first line is the server's token.
    #[arg(long, value_name = "FILE")]
    token_file: PathBuf,

    /// It lives until the server ends, and leaves no file.
    #[arg(long)]
    temporary: bool,

    /// Print a summary as JSON.
    #[arg(long)]
    json: bool,
}

impl Args {
    pub(crate) fn run(self) -> Result<ExitCode, Failure> {
        self.options.check()?;
        let lifetime = if self.temporary { Lifetime::Temporary } else { Lifetime::Kept };
        let mut request = InsertRequest::new(&self.options.request(PathBuf::new()), lifetime);
        for raster in &mut request.rasters {
            *raster = std::path::absolute(&*raster)?;
        }
        let (server, token) = (Client::new(&self.server)?, read_token(&self.token_file)?);
        let inserted = remote::insert(&server, &token, &request, |percent| {
            if !self.json {
                output::say(format_args!("{percent} %"));
            }
        })?;
        if self.json {
            output::json(&inserted)?;
        } else {
            let (name, generation) = (&inserted["dataset"], &inserted["generation"]);
            let name = name.as_str().unwrap_or_default();
            output::line(format_args!("{name}: visible in generation {generation}"))?;
        }
        Ok(ExitCode::SUCCESS)
    }
}
