//! The made-up planet: heights and colors on one map, and heights split at the poles.

use std::io;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;

use areoid_cache::{Cache, DatasetInfo, Options};
use areoid_formats::archive::Archive;
use areoid_formats::body::Body;
use areoid_formats::catalog::Catalog;

use crate::bench::ingest::{global_size, said};
use crate::bench::rasters::{Look, Recipe};
use crate::bench::timing;
use crate::failure::Failure;

/// Catalogs that are made when they are first needed.
#[derive(Debug)]
pub(super) struct World {
    folder: PathBuf,
    map: (u32, u32),
}

/// A dataset that can be cached.
pub(super) type Named = (DatasetInfo, Arc<Archive>);

impl World {
    /// A planet whose map has so many megapixels, in the folder of results.
    pub(super) fn new(folder: &Path, megapixels: f64) -> Result<Self, Failure> {
        timing::remove(&folder.join("work"))?;
        Ok(Self { folder: folder.to_owned(), map: global_size(megapixels) })
    }

    /// Heights and colors, in a catalog.
    pub(super) fn whole(&self) -> Result<PathBuf, Failure> {
        let catalog = self.work().join("whole");
        if !catalog.exists() {
            self.ingest(Look::Height, &catalog, &["--name", "height"])?;
            self.ingest(Look::Color, &catalog, &["--name", "color"])?;
        }
        Ok(catalog)
    }

    /// Heights on a band and two caps, in a catalog.
    pub(super) fn split(&self) -> Result<PathBuf, Failure> {
        let catalog = self.work().join("split");
        if !catalog.exists() {
            self.ingest(Look::Height, &catalog, &["--name", "height", "--grid", "split"])?;
        }
        Ok(catalog)
    }

    /// Where things are that are gone in the end.
    pub(super) fn work(&self) -> PathBuf {
        self.folder.join("work")
    }

    fn ingest(&self, look: Look, catalog: &Path, options: &[&str]) -> Result<(), Failure> {
        let raster = Recipe::tiled(look, self.map).make(&self.folder.join("rasters"))?;
        let mut command = Command::new(std::env::current_exe()?);
        command.arg("ingest").arg(raster).arg("--catalog").arg(catalog).args(options);
        said(command.arg("--json"))?;
        Ok(())
    }
}

/// The datasets of a catalog, `times` each, as if they had been ingested so often.
pub(super) fn datasets(catalog: &Path, times: usize) -> Result<(Body, Vec<Named>), Failure> {
    let (_, archives) = Catalog::open_with_archives(catalog)?;
    let body = archives.first().map(|archive| archive.description().body.clone());
    let body = body.ok_or_else(|| io::Error::other("a catalog without datasets"))?;
    let archives = archives.into_iter().map(Arc::new);
    let named = archives.flat_map(|archive| {
        (0..times).map(move |number| {
            let description = archive.description();
            let info = DatasetInfo {
                name: format!("{}-{number}", description.dataset),
                group: None,
                kind: description.kind,
                grid: description.grid.clone(),
                priority: description.priority,
            };
            (info, Arc::clone(&archive))
        })
    });
    Ok((body, named.collect()))
}

/// A cache of them.
pub(super) fn cache(
    (body, named): (Body, Vec<Named>),
    budget_bytes: usize,
) -> Result<Cache, Failure> {
    Ok(Cache::with_archives(body, named, Options::with_budget(budget_bytes))?)
}
