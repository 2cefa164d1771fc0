//! Changing a catalog: one atomic step a change.

use std::cell::Cell;
use std::fs::{self, File};
use std::io;
use std::path::Path;

use glam::DVec3;

use super::build::{ARCHIVES, Build, remove};
use super::disk::Disk;
use super::error::CatalogError;
use super::manifest::{self, DatasetRecord, Manifest};
use crate::address::{Level, PageAddress};
use crate::archive::{Archive, Description, Source};
use crate::body::Body;
use crate::bounds::Aabb;
use crate::page::Kind;
use crate::storage::FileSource;
use crate::units::Meters;
use crate::volume::Volume;

const LOCK: &str = "catalog.lock";
const TEMPORARY: &str = "manifest-";

/// What becomes of a dataset that is there already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Existing {
    /// It stays, and what was to replace it is refused.
    Keep,
    /// It is replaced.
    Replace,
}

/// What the manifest is to say of a finished build.
#[derive(Clone, Debug, PartialEq)]
pub struct NewDataset {
    /// The dataset's name.
    pub name: String,
    /// What its texels are.
    pub kind: Kind,
    /// Higher covers lower.
    pub priority: i32,
    /// The body it shows.
    pub body: Body,
    /// Length of the archive in bytes.
    pub bytes: u64,
    /// The archive's content, from [`Written`](crate::archive::Written).
    pub content: u64,
    /// What it was made from.
    pub source: Source,
    /// What becomes of a dataset of this name that has another content.
    pub existing: Existing,
}

/// Makes a finished build a dataset of its catalog, replacing one of its name if it may, and
/// returns the generation that has it.
///
/// # Errors
///
/// [`CatalogError`]; the catalog then is as it was, or has the dataset if what failed came after
/// the link: making it durable, or sweeping. A build that was refused is discarded; one that the
/// file system had no room for is left to go on with.
pub fn publish_build(build: Build<'_>, dataset: NewDataset) -> Result<u64, CatalogError> {
    build.sync()?;
    let (disk, folder, path) = (build.disk, build.folder.as_path(), build.path());
    let archives = folder.join(ARCHIVES);
    let target = archives.join(dataset.file());

    let in_place = Cell::new(false);
    let step = |newest| dataset.put_in(newest, &path, || build.source());
    // Once the manifest is written only names change, which takes no room. What stands beside the
    // archive goes while the name of the build is still ours.
    let ready = || {
        // A second try after a lost race finds the file in place.
        if in_place.get() {
            return Ok(());
        }
        build.tidy();
        disk.rename(&path, &target).map_err(|source| CatalogError::io("rename", &path, source))?;
        in_place.set(true);
        disk.sync_folder(&archives).map_err(|source| CatalogError::io("sync", &archives, source))
    };
    let published = change(disk, folder, step, ready);
    let refused = !matches!(published, Ok(_) | Err(CatalogError::Io { .. }));
    if refused && !in_place.get() {
        // If it cannot be removed, the next build of this name discards it; the first error says
        // more.
        let _ = build.discard();
    }
    published
}

/// Makes a [`stray`](super::stray) a dataset of its catalog, as [`publish_build`] does a build.
///
/// # Errors
///
/// [`CatalogError::Missing`] if another change has swept it meanwhile; else as for a build.
pub fn publish_stray(
    disk: &dyn Disk,
    folder: &Path,
    dataset: &NewDataset,
) -> Result<u64, CatalogError> {
    let archives = folder.join(ARCHIVES);
    let path = archives.join(dataset.file());
    let source = || match File::open(&path).and_then(FileSource::new) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            Err(CatalogError::Missing { path: path.clone() })
        }
        opened => opened.map_err(|source| CatalogError::io("open", &path, source)),
    };
    let step = |newest| dataset.put_in(newest, &path, source);
    // Whoever put it in its place may have been killed before its name was on the medium.
    let ready = || {
        disk.sync_folder(&archives).map_err(|source| CatalogError::io("sync", &archives, source))
    };
    change(disk, folder, step, ready)
}

impl NewDataset {
    /// The name of its archive.
    fn file(&self) -> String {
        DatasetRecord::file_of(&self.name, &format!("{:016x}", self.content))
    }

    /// The manifest that has it, in place of one of its name; its archive is `source`, at `path`.
    fn put_in(
        &self,
        newest: Option<Manifest>,
        path: &Path,
        source: impl Fn() -> Result<FileSource, CatalogError>,
    ) -> Result<Manifest, CatalogError> {
        let mut manifest = newest.unwrap_or_else(|| Manifest::empty(self.body.clone()));
        if manifest.datasets.is_empty() {
            manifest.body = self.body.clone();
        }
        if !manifest.body.same_as(&self.body) {
            return Err(CatalogError::OtherBody {
                catalog: manifest.body.name,
                raster: self.body.name.clone(),
            });
        }
        let file = self.file();
        let before = manifest.datasets.iter().find(|record| record.name == self.name);
        // Whoever began this build may have looked before another was published.
        if self.existing == Existing::Keep && before.is_some_and(|record| record.file != file) {
            return Err(CatalogError::Exists { name: self.name.clone() });
        }
        let bounds = bounds_of(source()?, path, &manifest.body)?;
        let item = before.map_or_else(|| manifest.free_item(), |record| record.item);
        let record = DatasetRecord {
            name: self.name.clone(),
            item,
            file,
            kind: self.kind,
            priority: self.priority,
            bytes: self.bytes,
            content: format!("{:016x}", self.content),
            source: self.source.clone(),
        };
        manifest.put_in(record, bounds);
        Ok(manifest)
    }
}

/// Removes the dataset called `name` and returns the generation without it.
///
/// # Errors
///
/// [`CatalogError::NotACatalog`], [`CatalogError::NoSuchDataset`], or [`CatalogError::Io`].
pub fn remove_dataset(disk: &dyn Disk, folder: &Path, name: &str) -> Result<u64, CatalogError> {
    // Asked first without the lock, whose file would make a catalog of any folder.
    super::Catalog::open(folder)?.dataset(name)?;
    let step = |newest: Option<Manifest>| {
        let mut manifest =
            newest.ok_or_else(|| CatalogError::NotACatalog { folder: folder.to_owned() })?;
        if manifest.take_out(name).is_none() {
            let folder = folder.to_owned();
            return Err(CatalogError::NoSuchDataset { name: name.to_owned(), folder });
        }
        Ok(manifest)
    };
    change(disk, folder, step, || Ok(()))
}

/// A box around the dataset whose archive `source` is, at `path`.
///
/// Colors lie on terrain that the dataset does not know: a hundredth of the body's radius up and
/// down holds that of any planet. So it is around the whole body where the archive has no root.
fn bounds_of(source: FileSource, path: &Path, body: &Body) -> Result<Aabb, CatalogError> {
    let failed = |source| CatalogError::Archive { path: path.to_owned(), source };
    let archive = Archive::open(Box::new(source)).map_err(failed)?;
    let Description { grid, kind, .. } = archive.description();
    let margin = Meters(body.ellipsoid.a().0 / 100.0);

    let mut whole = Aabb::EMPTY;
    let (rows, cols) = grid.pyramid().pages(Level(0)).unwrap_or_default();
    for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
        let page = PageAddress::new(Level(0), row, col);
        let Some(root) = archive.find(page).map_err(failed)? else { continue };
        let (lowest, highest) = match kind {
            Kind::Height => (Meters(root.lowest.into()), Meters(root.highest.into())),
            Kind::Color | Kind::Normal => (Meters(-margin.0), margin),
        };
        whole = whole.union(&Volume::new(grid, page, lowest, highest).aabb());
    }
    if whole.is_empty() {
        let corner = DVec3::splat(body.ellipsoid.a().0 + margin.0);
        whole = Aabb::new(-corner, corner);
    }
    Ok(whole)
}

/// Publishes the generation that `step` makes of the newest one. `ready` is called when its manifest
/// is written and only lacks its name.
fn change(
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
