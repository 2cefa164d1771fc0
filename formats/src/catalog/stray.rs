//! Whole archives that no manifest names: those of writers killed between putting one in its place and
//! linking the manifest.

use std::fs::{self, File};
use std::io;
use std::path::Path;

use super::build::ARCHIVES;
use super::error::CatalogError;
use super::manifest::{self, DatasetRecord};
use crate::archive::{Archive, Description};
use crate::storage::FileSource;

/// The whole archive of `description` that stands in its place in the catalog at `folder` and is
/// not in the newest manifest, if there is one.
///
/// It is like any archive there: on the medium before it had its name, and never changed. The next
/// change of the catalog sweeps it, unless that is [`publish_stray`](super::publish_stray).
///
/// # Errors
///
/// [`CatalogError::Io`] or [`CatalogError::Manifest`]; what cannot be read as an archive is none.
pub fn stray(folder: &Path, description: &Description) -> Result<Option<Archive>, CatalogError> {
    let archives = folder.join(ARCHIVES);
    let listing = match fs::read_dir(&archives) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        listing => listing.map_err(|source| CatalogError::io("list", &archives, source))?,
    };
    let newest = manifest::newest(folder)?;
    let named = |file: &str| {
        let datasets = newest.iter().flat_map(|manifest| &manifest.datasets);
        datasets.map(|record| &record.file).any(|name| name == file)
    };
    let start = format!("{}-", description.dataset);
    for entry in listing {
        let entry = entry.map_err(|source| CatalogError::io("list", &archives, source))?;
        let Ok(name) = entry.file_name().into_string() else { continue };
        if !name.starts_with(&start) || named(&name) {
            continue;
        }
        let source = File::open(entry.path()).and_then(FileSource::new);
        let Ok(archive) = source.map(|source| Archive::open(Box::new(source))) else { continue };
        let whole = archive.ok().filter(|archive| archive.description() == description);
        let Some((archive, content)) = whole.and_then(|a| a.content().map(|c| (a, c))) else {
            continue;
        };
        if DatasetRecord::file_of(&description.dataset, &format!("{content:016x}")) == name {
            return Ok(Some(archive));
        }
    }
    Ok(None)
}
