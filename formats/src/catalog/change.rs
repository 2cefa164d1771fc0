//! One atomic step from a generation to the next.

use std::fs;
use std::io;
use std::path::Path;

use super::build::{ARCHIVES, remove};
use super::disk::Disk;
use super::error::CatalogError;
use super::manifest::{self, Manifest};

const LOCK: &str = "catalog.lock";
const TEMPORARY: &str = "manifest-";

/// Publishes the generation that `step` makes of the newest one. `ready` is called when its manifest
/// is written and only lacks its name.
pub(super) fn change(
    disk: &dyn Disk,
    folder: &Path,
    step: impl Fn(Option<Manifest>) -> Result<Manifest, CatalogError>,
    ready: impl Fn() -> Result<(), CatalogError>,
) -> Result<u64, CatalogError> {
    let lock_path = folder.join(LOCK);
    let lock = disk
        .open_or_create(&lock_path)
        .and_then(|lock| lock.lock().map(|()| lock))
        .map_err(|source| CatalogError::io("lock", &lock_path, source))?;
    loop {
        let newest = manifest::newest(folder)?;
        let before = newest.as_ref().map_or(0, |manifest| manifest.generation);
        let generation = before.checked_add(1).ok_or_else(|| {
            let path = folder.join(manifest::file_name(before));
            CatalogError::Manifest { path, reason: "no generation can follow it".to_owned() }
        })?;
        let manifest = Manifest { generation, ..step(newest)? };
        if link_manifest(disk, folder, &manifest, &ready)? {
            sweep(disk, folder, &manifest)?;
            drop(lock);
            return Ok(generation);
        }
    }
}

/// Writes `manifest` and links it to its name; false if another writer has taken it.
fn link_manifest(
    disk: &dyn Disk,
    folder: &Path,
    manifest: &Manifest,
    ready: impl Fn() -> Result<(), CatalogError>,
) -> Result<bool, CatalogError> {
    let temporary = folder.join(format!("{TEMPORARY}{}", std::process::id()));
    let target = folder.join(manifest::file_name(manifest.generation));
    let write = || {
        let mut file = disk.open_or_create(&temporary)?;
        disk.truncate(&mut file, 0)?;
        disk.append(&mut file, &manifest.to_bytes())?;
        disk.sync_file(&file)
    };
    let written = write().map_err(|source| CatalogError::io("write", &temporary, source));
    if let Err(error) = written.and_then(|()| ready()) {
        // If it stays, the next change sweeps it.
        let _ = disk.remove(&temporary);
        return Err(error);
    }
    let linked = match disk.link(&temporary, &target) {
        Ok(()) => true,
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => false,
        Err(source) => return Err(CatalogError::io("link", &target, source)),
    };
    disk.remove(&temporary).map_err(|source| CatalogError::io("remove", &temporary, source))?;
    disk.sync_folder(folder).map_err(|source| CatalogError::io("sync", folder, source))?;
    Ok(linked)
}

/// Removes older manifests, temporary ones of killed writers, and archives that `manifest` does
/// not name. All of that is nobody's while the catalog's lock is held.
fn sweep(disk: &dyn Disk, folder: &Path, manifest: &Manifest) -> Result<(), CatalogError> {
    for generation in manifest::generations(folder)? {
        if generation < manifest.generation {
            remove(disk, &folder.join(manifest::file_name(generation)))?;
        }
    }
    for name in names_in(folder)?.filter(|name| name.starts_with(TEMPORARY)) {
        remove(disk, &folder.join(name))?;
    }
    let archives = folder.join(ARCHIVES);
    let named = |name: &String| manifest.datasets.iter().any(|record| record.file == *name);
    for name in names_in(&archives)?.filter(|name| !named(name)) {
        remove(disk, &archives.join(name))?;
    }
    Ok(())
}

fn names_in(folder: &Path) -> Result<impl Iterator<Item = String>, CatalogError> {
    let listing =
        fs::read_dir(folder).map_err(|source| CatalogError::io("list", folder, source))?;
    Ok(listing.filter_map(|entry| entry.ok()?.file_name().into_string().ok()))
}
