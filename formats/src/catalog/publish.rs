//! Changing a catalog: what becomes a dataset, and what is one no longer.

use std::cell::Cell;
use std::collections::BTreeSet;
use std::fs::File;
use std::io;
use std::path::Path;

use glam::DVec3;

use super::build::{ARCHIVES, Build};
use super::change::change;
use super::disk::Disk;
use super::error::CatalogError;
use super::manifest::{self, DatasetRecord, Manifest, is_part};
use crate::address::{Level, PageAddress};
use crate::archive::{Archive, Description, Source};
use crate::body::Body;
use crate::bounds::Aabb;
use crate::page::Kind;
use crate::storage::FileSource;
use crate::units::Meters;
use crate::volume::Volume;

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
    /// The group that it is to be a part of.
    pub group: Option<String>,
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
    /// What becomes of a dataset or group that the user calls the same, if it has another content.
    pub existing: Existing,
}

/// Where a whole archive waits for its dataset.
#[derive(Debug)]
pub enum Finished<'a> {
    /// Where it was built.
    Build(Build<'a>),
    /// In its place among the archives: a [`stray`](super::stray), or what a dataset has already.
    InPlace,
}

/// Makes a finished build a dataset of its catalog, as [`publish_archives`] does.
///
/// # Errors
///
/// Those of [`publish_archives`].
///
/// # Panics
///
/// Where [`publish_archives`] does.
pub fn publish_build(build: Build<'_>, dataset: NewDataset) -> Result<u64, CatalogError> {
    publish_builds(vec![(build, dataset)])
}

/// Makes finished builds the parts of a group, as [`publish_archives`] does.
///
/// # Errors
///
/// Those of [`publish_archives`].
///
/// # Panics
///
/// Where [`publish_archives`] does.
pub fn publish_builds(builds: Vec<(Build<'_>, NewDataset)>) -> Result<u64, CatalogError> {
    let (first, _) = builds.first().expect("something to publish");
    let (disk, folder) = (first.disk, first.folder.clone());
    let finished = builds.into_iter().map(|(build, dataset)| (Finished::Build(build), dataset));
    publish_archives(disk, &folder, finished.collect())
}

/// Makes a [`stray`](super::stray) a dataset of its catalog, as [`publish_archives`] does.
///
/// # Errors
///
/// Those of [`publish_archives`].
///
/// # Panics
///
/// Where [`publish_archives`] does.
pub fn publish_stray(
    disk: &dyn Disk,
    folder: &Path,
    dataset: NewDataset,
) -> Result<u64, CatalogError> {
    publish_archives(disk, folder, vec![(Finished::InPlace, dataset)])
}

/// Makes whole archives what the user calls by one name, in one step: a dataset, or all parts of a
/// group. They take the place of what had the name before, dataset or group, if they may. Returns
/// the generation that has them.
///
/// # Errors
///
/// [`CatalogError`]; the catalog then is as it was, or has the datasets if what failed came after
/// the link: making it durable, or sweeping. Builds that were refused are discarded. Those that the
/// file system had no room for are left to go on with, and so are those beside an archive in its
/// place that another change has swept meanwhile: [`CatalogError::Missing`].
///
/// # Panics
///
/// If there are none, if the user would not call all of them the same, or if the name of a part is
/// not its group's, a dot, and more.
pub fn publish_archives(
    disk: &dyn Disk,
    folder: &Path,
    archives: Vec<(Finished<'_>, NewDataset)>,
) -> Result<u64, CatalogError> {
    check_names(&archives);
    let place = folder.join(ARCHIVES);
    let builds = || {
        archives.iter().filter_map(|(finished, dataset)| match finished {
            Finished::Build(build) => Some((build, place.join(dataset.file()))),
            Finished::InPlace => None,
        })
    };
    for (build, _) in builds() {
        build.sync()?;
    }

    let moved = Cell::new(0);
    let step = |newest| with_archives(newest, &place, &archives);
    // Once the manifest is written only names change, which takes no room. What stands beside an
    // archive goes while the name of its build is still ours. A second try after a lost race finds
    // the files in place; and whoever put a stray there may have been killed before its name was on
    // the medium.
    let ready = || {
        for (build, target) in builds().skip(moved.get()) {
            build.tidy();
            let path = build.path();
            let renamed = disk.rename(&path, &target);
            renamed.map_err(|source| CatalogError::io("rename", &path, source))?;
            moved.set(moved.get() + 1);
        }
        disk.sync_folder(&place).map_err(|source| CatalogError::io("sync", &place, source))
    };
    let published = change(disk, folder, step, ready);
    let is_refused =
        !matches!(published, Ok(_) | Err(CatalogError::Io { .. } | CatalogError::Missing { .. }));
    if is_refused {
        let builds = archives.into_iter().filter_map(|(finished, _)| match finished {
            Finished::Build(build) => Some(build),
            Finished::InPlace => None,
        });
        for build in builds.skip(moved.get()) {
            // If it cannot be removed, the next build of this name discards it; the first error
            // says more.
            let _ = build.discard();
        }
    }
    published
}

/// Panics unless the datasets are what the user calls by one name.
fn check_names(archives: &[(Finished<'_>, NewDataset)]) {
    let (_, first) = archives.first().expect("something to publish");
    for (_, dataset) in archives {
        let (name, group) = (&dataset.name, dataset.group.as_ref());
        assert!(group.is_none_or(|group| is_part(name, group)), "{name} in {group:?}");
        assert_eq!(dataset.called(), first.called(), "one change is to one name");
    }
}

/// The manifest that has the datasets, in place of what the user calls the same; those of their
/// archives that are in it lie in the folder `place`.
fn with_archives(
    newest: Option<Manifest>,
    place: &Path,
    archives: &[(Finished<'_>, NewDataset)],
) -> Result<Manifest, CatalogError> {
    let datasets = || archives.iter().map(|(_, dataset)| dataset);
    let (_, first) = archives.first().expect("something to publish");
    let mut manifest = newest.unwrap_or_else(|| Manifest::empty(first.body.clone()));
    if manifest.datasets.is_empty() {
        manifest.body = first.body.clone();
    }
    for dataset in datasets() {
        if !manifest.body.same_as(&dataset.body) {
            return Err(CatalogError::OtherBody {
                catalog: manifest.body.name,
                raster: dataset.body.name.clone(),
            });
        }
        manifest.check_free(&dataset.name, dataset.group.as_deref())?;
    }
    // Whoever began these builds may have looked before others were published.
    let before: BTreeSet<_> =
        manifest.parts(first.called()).map(|record| record.file.clone()).collect();
    let after: BTreeSet<_> = datasets().map(NewDataset::file).collect();
    let may_replace = datasets().all(|dataset| dataset.existing == Existing::Replace);
    if !may_replace && !before.is_empty() && before != after {
        return Err(CatalogError::Exists { name: first.called().to_owned() });
    }

    // What goes, goes first: a dataset that is replaced keeps its number, and no new one takes it.
    manifest.retain(|record| {
        record.called() != first.called() || datasets().any(|dataset| dataset.name == record.name)
    });
    for (finished, dataset) in archives {
        let path = place.join(dataset.file());
        let (path, source) = match finished {
            Finished::Build(build) => (build.path(), build.source()?),
            Finished::InPlace => (path.clone(), in_place(&path)?),
        };
        let bounds = bounds_of(source, &path, &manifest.body)?;
        let before = manifest.datasets.iter().find(|record| record.name == dataset.name);
        let item = before.map_or_else(|| manifest.free_item(), |record| record.item);
        manifest.put_in(dataset.record(item), bounds);
    }
    Ok(manifest)
}

/// An archive among the others, unless it is gone.
fn in_place(path: &Path) -> Result<FileSource, CatalogError> {
    match File::open(path).and_then(FileSource::new) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            Err(CatalogError::Missing { path: path.to_owned() })
        }
        opened => opened.map_err(|source| CatalogError::io("open", path, source)),
    }
}

impl NewDataset {
    /// What the user is to call it.
    fn called(&self) -> &str {
        self.group.as_ref().unwrap_or(&self.name)
    }

    /// The name of its archive.
    fn file(&self) -> String {
        DatasetRecord::file_of(&self.name, &format!("{:016x}", self.content))
    }

    fn record(&self, item: u32) -> DatasetRecord {
        DatasetRecord {
            name: self.name.clone(),
            group: self.group.clone(),
            item,
            file: self.file(),
            kind: self.kind,
            priority: self.priority,
            bytes: self.bytes,
            content: format!("{:016x}", self.content),
            source: self.source.clone(),
        }
    }
}

/// Removes the dataset called `name`, or all parts of the group, and returns the generation without
/// them.
///
/// # Errors
///
/// [`CatalogError::NotACatalog`], [`CatalogError::NoSuchDataset`], [`CatalogError::Part`], or
/// [`CatalogError::Io`].
pub fn remove_dataset(disk: &dyn Disk, folder: &Path, name: &str) -> Result<u64, CatalogError> {
    let step = |newest: Option<Manifest>| {
        let mut manifest =
            newest.ok_or_else(|| CatalogError::NotACatalog { folder: folder.to_owned() })?;
        let found = manifest.datasets.iter().find(|record| record.answers_to(name));
        match found.map(|record| &record.group) {
            None => {
                let folder = folder.to_owned();
                return Err(CatalogError::NoSuchDataset { name: name.to_owned(), folder });
            }
            Some(Some(group)) if group != name => {
                return Err(CatalogError::Part { name: name.to_owned(), group: group.clone() });
            }
            Some(_) => manifest.retain(|record| record.called() != name),
        }
        Ok(manifest)
    };
    // Asked first without the lock, whose file would make a catalog of any folder.
    step(manifest::newest(folder)?)?;
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
