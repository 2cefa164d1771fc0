//! Datasets in JSON: what `areoid info --json` prints and the service answers.

use areoid_formats::archive::{Archive, ArchiveError};
use areoid_formats::body::Body;
use areoid_formats::catalog::DatasetRecord;
use areoid_formats::grid::Grid;
use areoid_formats::projection::Projection;
use areoid_formats::pyramid::{PoleContact, Pyramid};
use serde_json::{Value, json};

/// A body: its name and radii.
#[must_use]
pub fn body(body: &Body) -> Value {
    json!({ "name": body.name, "a_m": body.ellipsoid.a().0, "b_m": body.ellipsoid.b().0 })
}

/// What the manifest alone says of a dataset that cannot be read.
#[must_use]
pub fn unreadable(record: &DatasetRecord, error: &str) -> Value {
    json!({
        "name": record.name,
        "group": record.group,
        "kind": record.kind.name(),
        "priority": record.priority,
        "bytes": record.bytes,
        "error": error,
    })
}

/// A dataset, its grid and its levels. May wait for the index.
///
/// # Errors
///
/// [`ArchiveError::Read`] if the medium fails.
pub fn dataset(record: &DatasetRecord, archive: &Archive) -> Result<Value, ArchiveError> {
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
        "border": Pyramid::BORDER,
        "step": description.quantum.step,
        "mip": description.mip.name(),
        "levels": levels,
        "pages": archive.page_count()?,
        "bytes": record.bytes,
        "source": record.source,
    }))
}

/// A grid: its map, its place and its size.
#[must_use]
pub fn grid(grid: &Grid) -> Value {
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
