//! `areoid height`.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

use areoid_cache::place::Place;
use areoid_cache::remote::{Client, RemoteCatalog, RemotePages};
use areoid_formats::address::Level;
use areoid_formats::archive::Archive;
use areoid_formats::catalog::{Catalog, CatalogError};
use areoid_formats::query::{HeightAnswer, HeightQuery};
use serde_json::{Value, json};

use crate::args::{numbers, position};
use crate::failure::{Failure, say_why};
use crate::output;

/// Say how high the surface is: composed from all height datasets, with its bound.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The catalog: its folder, or the address of its server.
    #[arg(value_name = "DIR|URL")]
    catalog: Place,

    /// A position in degrees, longitude east.
    #[arg(
        long,
        value_name = "LON,LAT",
        allow_hyphen_values = true,
        value_parser = numbers::<2>,
        required_unless_present = "points",
        conflicts_with = "points"
    )]
    at: Option<[f64; 2]>,

    /// Positions: a CSV file with the header `lon,lat`.
    #[arg(long, value_name = "FILE")]
    points: Option<PathBuf>,

    /// Only this dataset, or the parts of this group.
    #[arg(long)]
    dataset: Option<String>,

    /// This level of each dataset instead of its finest.
    #[arg(long)]
    level: Option<u8>,

    /// Print JSON.
    #[arg(long)]
    json: bool,
}

impl Args {
    pub(crate) fn run(self) -> Result<ExitCode, Failure> {
        let points = match (&self.at, &self.points) {
            (Some(at), _) => vec![*at],
            (None, Some(path)) => read_points(path)?,
            (None, None) => Vec::new(),
        };
        let positions: Result<Vec<_>, _> = points.iter().map(|&point| position(point)).collect();
        let positions = positions.map_err(|reason| match &self.points {
            Some(path) => Failure::Failed(format!("{}: {reason}", path.display()).into()),
            None => Failure::Misused(reason),
        })?;

        let (near, far);
        let chosen: Vec<&Archive> = match &self.catalog {
            Place::Folder(folder) => {
                near = self.of_folder(folder)?;
                near.iter().collect()
            }
            Place::Server(server) => {
                far = self.of_server(&Client::new(&server.url)?)?;
                far.iter().map(|pages| pages.archive()).collect()
            }
        };
        let mut query = HeightQuery::new(chosen.iter().copied(), self.level.map(Level));
        let mut answers = Vec::with_capacity(points.len());
        for position in positions {
            answers.push(query.height(position)?);
        }

        let names = |answer: &HeightAnswer| -> Vec<&str> {
            let places = answer.datasets.iter();
            places.map(|&place| chosen[place].description().dataset.as_str()).collect()
        };
        let answers = points.iter().zip(&answers);
        if self.json {
            let points: Vec<Value> = answers
                .map(|([lon, lat], answer)| {
                    json!({
                        "lon": lon,
                        "lat": lat,
                        "height_m": answer.as_ref().map(|answer| answer.height_m),
                        "bound_m": answer.as_ref().map(|answer| answer.bound_m),
                        "datasets": answer.as_ref().map(names).unwrap_or_default(),
                    })
                })
                .collect();
            output::json(&json!({ "points": points }))?;
        } else {
            for ([lon, lat], answer) in answers {
                output::line(match answer {
                    Some(found) => format!(
                        "{lon},{lat}: {:.3} m ± {} ({})",
                        found.height_m,
                        found.bound_m,
                        names(found).join(", ")
                    ),
                    None => format!("{lon},{lat}: no data"),
                })?;
            }
        }
        Ok(ExitCode::SUCCESS)
    }

    fn of_folder(&self, folder: &Path) -> Result<Vec<Archive>, Failure> {
        let (catalog, archives) = Catalog::open_each(folder)?;
        if let Some(name) = &self.dataset {
            catalog.named(name)?;
        }
        let chosen = catalog
            .datasets()
            .iter()
            .zip(archives)
            .filter(|(record, _)| self.dataset.as_ref().is_none_or(|name| record.answers_to(name)))
            .map(|(record, archive)| {
                let archive = archive?;
                if let Err(damage) = catalog.check_length(record, &archive) {
                    // What is whole of it still answers.
                    say_why("warning", &damage);
                }
                Ok(archive)
            })
            .collect::<Result<_, CatalogError>>()?;
        Ok(chosen)
    }

    /// A dataset that cannot be read might have had the last word: without a name, it is an error.
    fn of_server(&self, server: &Client) -> Result<Vec<Arc<RemotePages>>, Failure> {
        let RemoteCatalog { datasets, mut problems, .. } = RemoteCatalog::open(server, None)?;
        let chosen: Vec<_> = datasets
            .into_iter()
            .filter(|found| self.dataset.as_ref().is_none_or(|name| found.answers_to(name)))
            .map(|found| found.pages)
            .collect();
        match (problems.pop(), &self.dataset) {
            (Some(problem), None) => Err(problem.into()),
            (problem, Some(name)) if chosen.is_empty() => Err(match problem {
                Some(problem) => problem.into(),
                None => {
                    let reason = format!("{} has no dataset {name:?}", server.address());
                    Failure::Failed(reason.into())
                }
            }),
            _ => Ok(chosen),
        }
    }
}

/// The positions in a CSV file whose first columns are `lon` and `lat`; more may follow.
fn read_points(path: &Path) -> Result<Vec<[f64; 2]>, Failure> {
    let name = path.display();
    let text = fs::read_to_string(path).map_err(|error| {
        std::io::Error::new(error.kind(), format!("cannot read {name}: {error}"))
    })?;
    let invalid = |reason: String| Failure::Failed(format!("{name}: {reason}").into());
    let mut lines = text.trim_start_matches('\u{feff}').lines();
    let header: Vec<&str> = lines.next().unwrap_or_default().split(',').map(str::trim).collect();
    if !header.starts_with(&["lon", "lat"]) {
        return Err(invalid(format!("expected the header lon,lat, found {:?}", header.join(","))));
    }
    let mut points = Vec::new();
    for (number, line) in lines.enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        let mut fields = line.split(',').map(|field| field.trim().parse::<f64>().ok());
        let (Some(Some(lon)), Some(Some(lat))) = (fields.next(), fields.next()) else {
            return Err(invalid(format!(
                "line {}: expected two numbers, found {line:?}",
                number + 2
            )));
        };
        points.push([lon, lat]);
    }
    Ok(points)
}
