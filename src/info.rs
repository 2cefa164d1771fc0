//! `areoid info`.

use std::path::PathBuf;
use std::process::ExitCode;

use areoid_formats::archive::Archive;
use areoid_formats::catalog::{Catalog, CatalogError, DatasetRecord};
use areoid_formats::grid::Grid;
use areoid_formats::projection::Projection;
use areoid_formats::pyramid::PoleContact;
use serde_json::{Value, json};

use crate::failure::Failure;
use crate::output;

/// Say what a catalog holds.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The catalog.
    #[arg(value_name = "DIR")]
    catalog: PathBuf,

    /// Only this dataset, or the parts of this group.
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
        let chosen: Vec<_> = catalog
            .datasets()
            .iter()
            .zip(&archives)
            .filter(|(record, _)| self.dataset.as_ref().is_none_or(|name| record.answers_to(name)))
            .map(|(record, archive)| match archive {
                Ok(archive) => dataset(record, archive),
                Err(error) => Ok(unreadable(record, error)),
            })
            .collect::<Result<_, Failure>>()?;
        let whole = chosen.iter().all(|dataset| dataset.get("error").is_none());
        if self.json {
            let body = catalog.body();
            output::json(&json!({
                "body": {
                    "name": body.name,
                    "a_m": body.ellipsoid.a().0,
                    "b_m": body.ellipsoid.b().0,
                },
                "generation": catalog.generation(),
                "datasets": chosen,
            }))?;
        } else {
            text(&catalog, &chosen)?;
        }
        Ok(if whole { ExitCode::SUCCESS } else { ExitCode::FAILURE })
    }
}

/// What the manifest alone says of a dataset.
fn unreadable(record: &DatasetRecord, error: &CatalogError) -> Value {
    json!({
        "name": record.name,
        "group": record.group,
        "kind": record.kind.name(),
        "priority": record.priority,
        "bytes": record.bytes,
        "error": error.to_string(),
    })
}

fn dataset(record: &DatasetRecord, archive: &Archive) -> Result<Value, Failure> {
    let description = archive.description();
    let (grid, pyramid) = (&description.grid, description.grid.pyramid());
    let summary = archive.summary();
    let levels: Vec<Value> = pyramid
        .levels()
        .filter_map(|level| Some((level, pyramid.size(level)?)))
        .map(|(level, size)| {
            let known = summary.and_then(|summary| summary.levels.get(usize::from(level.0)));
            json!({
                "level": level.0,
                "width": size.width,
                "height": size.height,
                "pages": known.map(|known| known.pages),
                "constant": known.map(|known| known.constant),
                "bytes": known.map(|known| known.bytes),
                "bound_max": known.map(|known| known.bound_max),
            })
        })
        .collect();
    Ok(json!({
        "name": record.name,
        "group": record.group,
        "kind": record.kind.name(),
        "priority": record.priority,
        "grid": self::grid(grid),
        "page_size": pyramid.page_side(),
        "border": areoid_formats::pyramid::Pyramid::BORDER,
        "step": description.quantum.step,
        "mip": description.mip.name(),
        "levels": levels,
        "pages": archive.page_count()?,
        "bytes": record.bytes,
        "source": record.source,
    }))
}

/// A grid as `info` and `ingest` tell of it.
pub(crate) fn grid(grid: &Grid) -> Value {
    let extent = grid.pyramid().extent();
    let poles = match (extent.north != PoleContact::None, extent.south != PoleContact::None) {
        (true, true) => "both",
        (true, false) => "north",
        (false, true) => "south",
        (false, false) => "none",
    };
    json!({
        "projection": match grid.crs().projection {
            Projection::PolarStereographic(_) => "polar_stereographic",
            Projection::Equirectangular(_) => "equirectangular",
            Projection::Geographic => "geographic",
        },
        "crs": grid.crs().proj_string(),
        "origin": grid.origin(),
        "pixel_size": grid.pixel_size(),
        "width": extent.width,
        "height": extent.height,
        "wraps": extent.wraps,
        "reaches_pole": poles != "none",
        "poles": poles,
    })
}

fn text(catalog: &Catalog, datasets: &[Value]) -> Result<(), Failure> {
    let body = catalog.body();
    output::line(format_args!(
        "{} ({} x {} m), generation {}",
        body.name,
        body.ellipsoid.a().0,
        body.ellipsoid.b().0,
        catalog.generation()
    ))?;
    for dataset in datasets {
        if let Some(error) = dataset.get("error") {
            let name = dataset["name"].as_str().unwrap_or_default();
            output::line(format_args!("\n{name}: {}", error.as_str().unwrap_or_default()))?;
            continue;
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
