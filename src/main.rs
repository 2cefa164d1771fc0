//! The command line: arguments to calls, results to text.

mod args;
mod bench;
mod failure;
#[cfg(feature = "viewer")]
mod fly;
mod height;
mod info;
mod ingest;
mod ingest_options;
mod insert;
mod interrupt;
mod npy;
mod output;
mod page;
#[cfg(feature = "viewer")]
mod place;
mod progress;
mod quantile;
mod remove;
mod resources;
mod serve;
#[cfg(feature = "viewer")]
mod shot;
#[cfg(feature = "viewer")]
mod snapshot;
mod verify;
#[cfg(feature = "viewer")]
mod view;

use std::process::ExitCode;

use clap::Parser as _;

fn main() -> ExitCode {
    match args::Cli::parse().run() {
        Ok(code) => code,
        Err(failure) => failure.report(),
    }
}
