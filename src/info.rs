//! `areoid info`.

use std::path::Path;
use std::process::ExitCode;

use areoid_cache::describe;
use areoid_cache::place::Place;
use areoid_cache::remote::Client;
use areoid_formats::catalog::Catalog;
use serde_json::{Value, json};

use crate::failure::Failure;
use crate::output;

/// Say what a catalog holds.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The catalog: its folder, or the address of its server.
    #[arg(value_name = "DIR|URL")]
    catalog: Place,

    /// Only this dataset, or the parts of this group.
    dataset: Option<String>,

    /// Print JSON.
    #[arg(long)]
    json: bool,
}

impl Args {
    pub(crate) fn run(self) -> Result<ExitCode, Failure> {
        let described = match &self.catalog {
            Place::Folder(folder) => self.of_folder(folder)?,
            Place::Server(server) => self.of_server(&Client::new(&server.url)?)?,
        };
        let datasets = described["datasets"].as_array().map_or(&[][..], Vec::as_slice);
        let is_whole =
            |dataset: &Value| ["error", "damage"].iter().all(|key| dataset.get(key).is_none());
        let whole = datasets.iter().all(is_whole);
        if self.json {
            output::json(&described)?;
        } else {
            text(&described, datasets)?;
        }
        Ok(if whole { ExitCode::SUCCESS } else { ExitCode::FAILURE })
    }

    fn of_folder(&self, folder: &Path) -> Result<Value, Failure> {
        let (catalog, archives) = Catalog::open_each(folder)?;
        if let Some(name) = &self.dataset {
            catalog.named(name)?;
        }
        let chosen: Vec<_> = catalog
            .datasets()
            .iter()
            .zip(&archives)
            .filter(|(record, _)| self.dataset.as_ref().is_none_or(|name| record.answers_to(name)))
            .map(|(record, archive)| match archive {
                Ok(archive) => {
                    let mut described = describe::dataset(record, archive)?;
                    if let Err(damage) = catalog.check_length(record, archive) {
                        described["damage"] = json!(damage.to_string());
                    }
                    Ok(described)
                }
                Err(error) => Ok(describe::unreadable(record, &error.to_string())),
            })
            .collect::<Result<_, Failure>>()?;
        Ok(json!({
            "body": describe::body(catalog.body()),
            "generation": catalog.generation(),
            "datasets": chosen,
        }))
    }

    fn of_server(&self, server: &Client) -> Result<Value, Failure> {
        let mut described = server.json("/v1/catalog")?;
        if let (Some(name), Some(datasets)) = (&self.dataset, described["datasets"].as_array_mut())
        {
            datasets.retain(|dataset| dataset["name"] == **name || dataset["group"] == **name);
            if datasets.is_empty() {
                let reason = format!("{} has no dataset {name:?}", server.address());
                return Err(Failure::Failed(reason.into()));
            }
        }
        Ok(described)
    }
}

fn text(described: &Value, datasets: &[Value]) -> Result<(), Failure> {
    let body = &described["body"];
    let radius = |axis: &str| body[axis].as_f64().unwrap_or(f64::NAN);
    output::line(format_args!(
        "{} ({} x {} m), generation {}",
        body["name"].as_str().unwrap_or_default(),
        radius("a_m"),
        radius("b_m"),
        described["generation"],
    ))?;
    for dataset in datasets {
        if let Some(error) = dataset.get("error") {
            let name = dataset["name"].as_str().unwrap_or_default();
            output::line(format_args!("\n{name}: {}", error.as_str().unwrap_or_default()))?;
            continue;
        }
        if let Some(damage) = dataset["damage"].as_str() {
            output::line(format_args!("\n{damage}"))?;
        }
        let grid = &dataset["grid"];
        output::line(format_args!(
            "\n{}{}: {}, {} x {}, {} pages, {} bytes{}\n  {}",
            dataset["name"].as_str().unwrap_or_default(),
            dataset["group"].as_str().map(|group| format!(", part of {group}")).unwrap_or_default(),
            dataset["kind"].as_str().unwrap_or_default(),
            grid["width"],
            grid["height"],
            dataset["pages"],
            dataset["bytes"],
            match dataset["mip"].as_str() {
                Some("mean") | None => String::new(),
                Some(rule) => format!(", coarser levels by the {rule} rule"),
            },
            grid["crs"].as_str().unwrap_or_default(),
        ))?;
        for level in dataset["levels"].as_array().into_iter().flatten() {
            output::line(format_args!(
                "  level {}: {} x {}, {} pages, bound {}",
                level["level"], level["width"], level["height"], level["pages"], level["bound_max"]
            ))?;
        }
    }
    Ok(())
}
