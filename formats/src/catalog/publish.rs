//! Changing a catalog: one atomic step a change.

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use glam::DVec3;

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

pub(super) const ARCHIVES: &str = "archives";
const BUILDS: &str = "build";
const LOCK: &str = "catalog.lock";
const TEMPORARY: &str = "manifest-";

/// An archive under construction in a catalog's folder.
///
/// It is a [`Write`] sink. The file is locked as long as this lives: two processes cannot build
/// one dataset at once, and a file that can be locked belongs to nobody.
pub struct Build<'a> {
    disk: &'a dyn Disk,
    folder: PathBuf,
    path: PathBuf,
    file: File,
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
}

impl<'a> Build<'a> {
    /// Starts a build of `name` in the catalog at `folder`, which need not exist yet. Leftovers of
    /// an earlier build are discarded.
    ///
    /// # Errors
    ///
    /// [`CatalogError::Name`], [`CatalogError::Busy`], or [`CatalogError::Io`].
    pub fn start(disk: &'a dyn Disk, folder: &Path, name: &str) -> Result<Self, CatalogError> {
        check_name(name)?;
        create_folders(disk, &folder.join(BUILDS))?;
        create_folders(disk, &folder.join(ARCHIVES))?;
        let path = folder.join(BUILDS).join(format!("{name}.part"));
        let failed = |action| move |path: &Path, source| CatalogError::io(action, path, source);
        let file = disk.open_or_create(&path).map_err(|error| failed("create")(&path, error))?;
        match file.try_lock() {
            Ok(()) => {}
            Err(fs::TryLockError::WouldBlock) => {
                return Err(CatalogError::Busy { name: name.to_owned() });
            }
            Err(fs::TryLockError::Error(error)) => return Err(failed("lock")(&path, error)),
        }
        // Between opening and locking another builder may have renamed this very file.
        if !same_file(&file, &path) {
            return Err(CatalogError::Busy { name: name.to_owned() });
        }
        disk.truncate(&file).map_err(|error| failed("empty")(&path, error))?;
        Ok(Self { disk, folder: folder.to_owned(), path, file })
    }

    /// Gives the build up and removes its file.
    ///
    /// # Errors
    ///
    /// [`CatalogError::Io`].
    pub fn discard(self) -> Result<(), CatalogError> {
        self.disk
            .remove(&self.path)
            .map_err(|source| CatalogError::io("remove", &self.path, source))
    }
}

impl std::fmt::Debug for Build<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Build").field("path", &self.path).finish_non_exhaustive()
    }
}

impl Write for Build<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.disk.append(&mut self.file, bytes)?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Makes a finished build a dataset of its catalog, replacing one of its name, and returns the
/// generation that has it.
///
/// # Errors
///
/// [`CatalogError`]; the catalog then is as it was, or has the dataset if what failed came after
/// the link: making it durable, or sweeping.
pub fn publish_build(build: Build<'_>, dataset: NewDataset) -> Result<u64, CatalogError> {
    let Build { disk, folder, path, file } = build;
    disk.sync_file(&file).map_err(|source| CatalogError::io("sync", &path, source))?;
    let content = format!("{:016x}", dataset.content);
    let name = DatasetRecord::file_of(&dataset.name, &content);
    let archives = folder.join(ARCHIVES);
    let target = archives.join(&name);

    let mut in_place = false;
    let published = change(disk, &folder, |newest| {
        let mut manifest = newest.unwrap_or_else(|| Manifest::empty(dataset.body.clone()));
        if manifest.datasets.is_empty() {
            manifest.body = dataset.body.clone();
        }
        if !manifest.body.same_as(&dataset.body) {
            return Err(CatalogError::OtherBody {
                catalog: manifest.body.name,
                raster: dataset.body.name.clone(),
            });
        }
        // A second try after a lost race finds the file in place.
        if !in_place {
            disk.rename(&path, &target)
                .map_err(|source| CatalogError::io("rename", &path, source))?;
            disk.sync_folder(&archives)
                .map_err(|source| CatalogError::io("sync", &archives, source))?;
            in_place = true;
        }
        let bounds = bounds_of(&target, &manifest.body)?;
        let before = manifest.datasets.iter().find(|record| record.name == dataset.name);
        let item = before.map_or_else(|| manifest.free_item(), |record| record.item);
        let record = DatasetRecord {
            name: dataset.name.clone(),
            item,
            file: name.clone(),
            kind: dataset.kind,
            priority: dataset.priority,
            bytes: dataset.bytes,
            content: content.clone(),
            source: dataset.source.clone(),
        };
        manifest.put_in(record, bounds);
        Ok(manifest)
    });
    if published.is_err() && !in_place {
        // If it cannot be removed, the next build of this name discards it; the first error says
        // more.
        let _ = disk.remove(&path);
    }
    published
}

/// Removes the dataset called `name` and returns the generation without it.
///
/// # Errors
///
/// [`CatalogError::NotACatalog`], [`CatalogError::NoSuchDataset`], or [`CatalogError::Io`].
pub fn remove_dataset(disk: &dyn Disk, folder: &Path, name: &str) -> Result<u64, CatalogError> {
    // Asked first without the lock, whose file would make a catalog of any folder.
    super::Catalog::open(folder)?.dataset(name)?;
    change(disk, folder, |newest| {
        let mut manifest =
            newest.ok_or_else(|| CatalogError::NotACatalog { folder: folder.to_owned() })?;
        if manifest.take_out(name).is_none() {
            let folder = folder.to_owned();
            return Err(CatalogError::NoSuchDataset { name: name.to_owned(), folder });
        }
        Ok(manifest)
    })
}

/// Creates `path` and the folders above it that are not there, durably: a new folder's name is
/// synced in the folder above it.
fn create_folders(disk: &dyn Disk, path: &Path) -> Result<(), CatalogError> {
    let missing: Vec<&Path> = path.ancestors().take_while(|folder| !folder.is_dir()).collect();
    disk.create_folders(path).map_err(|source| CatalogError::io("create", path, source))?;
    for parent in missing.into_iter().filter_map(Path::parent) {
        let parent = if parent.as_os_str().is_empty() { Path::new(".") } else { parent };
        disk.sync_folder(parent).map_err(|source| CatalogError::io("sync", parent, source))?;
    }
    Ok(())
}

/// A box around the dataset whose archive is at `path`.
///
/// Colors lie on terrain that the dataset does not know: a hundredth of the body's radius up and
/// down holds that of any planet. So it is around the whole body where the archive has no root.
fn bounds_of(path: &Path, body: &Body) -> Result<Aabb, CatalogError> {
    let opened = File::open(path).and_then(FileSource::new);
    let source = opened.map_err(|source| CatalogError::io("open", path, source))?;
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

/// Publishes the generation that `step` makes of the newest one.
fn change(
    disk: &dyn Disk,
    folder: &Path,
    mut step: impl FnMut(Option<Manifest>) -> Result<Manifest, CatalogError>,
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
        if link_manifest(disk, folder, &manifest)? {
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
) -> Result<bool, CatalogError> {
    let temporary = folder.join(format!("{TEMPORARY}{}", std::process::id()));
    let target = folder.join(manifest::file_name(manifest.generation));
    let write = || {
        let mut file = disk.open_or_create(&temporary)?;
        disk.truncate(&file)?;
        disk.append(&mut file, &manifest.to_bytes())?;
        disk.sync_file(&file)
    };
    write().map_err(|source| CatalogError::io("write", &temporary, source))?;
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

fn remove(disk: &dyn Disk, path: &Path) -> Result<(), CatalogError> {
    match disk.remove(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            Err(CatalogError::io("remove", path, error))
        }
        _ => Ok(()),
    }
}

#[cfg(unix)]
fn same_file(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt as _;
    let identity = |data: fs::Metadata| (data.dev(), data.ino());
    matches!((file.metadata(), fs::metadata(path)), (Ok(one), Ok(other)) if identity(one.clone()) == identity(other.clone()))
}

#[cfg(not(unix))]
fn same_file(_file: &File, path: &Path) -> bool {
    path.exists()
}

/// Refuses names that are not plain file names on every system.
pub(super) fn check_name(name: &str) -> Result<(), CatalogError> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    let plain = (1..=100).contains(&name.len())
        && name.chars().all(allowed)
        && name.starts_with(|c: char| c.is_ascii_alphanumeric());
    if plain { Ok(()) } else { Err(CatalogError::Name { name: name.to_owned() }) }
}
