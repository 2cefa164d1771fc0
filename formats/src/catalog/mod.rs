//! A catalog: a folder of archives, and the manifest that says which of them count.
//!
//! `FORMAT.md`, which documents [`archive`](crate::archive), has the folder's layout, the manifest and
//! the steps of a change. The one step that makes it is the link of the new manifest: a process
//! killed at any instant leaves the old generation or the new one.
//!
//! Readers take no lock. A reader that misses a file has an old manifest and reads the newest.

mod disk;
mod error;
mod manifest;

mod build;
mod change;
mod publish;
mod stray;

use std::io;
use std::path::{Path, PathBuf};

pub use build::Build;
pub use disk::{Disk, RealDisk};
pub use error::CatalogError;
pub use manifest::{DatasetRecord, Manifest, check_name};
pub use publish::{
    Existing, Finished, NewDataset, publish_archives, publish_build, publish_builds, publish_stray,
    remove_dataset,
};
pub use stray::stray;

use crate::archive::Archive;
use crate::body::Body;
use crate::bvh::Bvh;
use crate::storage::Descriptors;

/// One generation of a catalog, as it was when it was opened.
#[derive(Clone, Debug)]
pub struct Catalog {
    folder: PathBuf,
    manifest: Manifest,
}

impl Catalog {
    /// Opens the newest generation of the catalog in `folder`.
    ///
    /// # Errors
    ///
    /// [`CatalogError::NotACatalog`] if the folder has no manifest, or any other.
    pub fn open(folder: &Path) -> Result<Self, CatalogError> {
        let manifest = manifest::newest(folder)?
            .ok_or_else(|| CatalogError::NotACatalog { folder: folder.to_owned() })?;
        Ok(Self { folder: folder.to_owned(), manifest })
    }

    /// The newest generation in `folder`, without reading its manifest; `None` if there is none, or
    /// just now none to be seen.
    ///
    /// # Errors
    ///
    /// [`CatalogError::Io`] if the folder cannot be listed.
    pub fn newest_generation(folder: &Path) -> Result<Option<u64>, CatalogError> {
        Ok(manifest::generations(folder)?.into_iter().max())
    }

    /// Opens the newest generation together with all of its archives.
    ///
    /// # Errors
    ///
    /// Any [`CatalogError`]. A dataset replaced or removed meanwhile is none: the newer generation
    /// is opened instead.
    pub fn open_with_archives(folder: &Path) -> Result<(Self, Vec<Archive>), CatalogError> {
        loop {
            let catalog = Self::open(folder)?;
            let archives = catalog.datasets().iter().map(|record| catalog.archive(record));
            match archives.collect() {
                Ok(archives) => return Ok((catalog, archives)),
                Err(CatalogError::Missing { .. })
                    if Self::open(folder)?.generation() > catalog.generation() => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// Opens the newest generation with the archive of each dataset, or why there is none: damage
    /// to one dataset is no reason not to read the others.
    ///
    /// # Errors
    ///
    /// Any [`CatalogError`] of the catalog itself.
    pub fn open_each(
        folder: &Path,
    ) -> Result<(Self, Vec<Result<Archive, CatalogError>>), CatalogError> {
        loop {
            let catalog = Self::open(folder)?;
            let archives: Vec<_> =
                catalog.datasets().iter().map(|record| catalog.archive(record)).collect();
            let missing = |archive| matches!(archive, &Err(CatalogError::Missing { .. }));
            if archives.iter().any(missing)
                && Self::open(folder)?.generation() > catalog.generation()
            {
                continue;
            }
            return Ok((catalog, archives));
        }
    }

    /// How often the catalog has changed.
    #[must_use]
    pub fn generation(&self) -> u64 {
        self.manifest.generation
    }

    /// The body that all of its datasets show.
    #[must_use]
    pub fn body(&self) -> &Body {
        &self.manifest.body
    }

    /// The datasets, by name.
    #[must_use]
    pub fn datasets(&self) -> &[DatasetRecord] {
        &self.manifest.datasets
    }

    /// A box around each dataset, by its [`item`](DatasetRecord::item): what a view meets is found
    /// without opening an archive.
    #[must_use]
    pub fn bvh(&self) -> &Bvh {
        &self.manifest.bvh
    }

    /// What `name` means: a dataset, all parts of a group, or the one part of that name.
    ///
    /// # Errors
    ///
    /// [`CatalogError::NoSuchDataset`].
    pub fn named(&self, name: &str) -> Result<Vec<&DatasetRecord>, CatalogError> {
        let records = self.datasets().iter();
        let found: Vec<_> = records.filter(|record| record.answers_to(name)).collect();
        if found.is_empty() {
            let (name, folder) = (name.to_owned(), self.folder.clone());
            return Err(CatalogError::NoSuchDataset { name, folder });
        }
        Ok(found)
    }

    /// The one dataset whose own name is `name`.
    ///
    /// # Errors
    ///
    /// [`CatalogError::Group`], [`CatalogError::NoSuchDataset`].
    pub fn dataset(&self, name: &str) -> Result<&DatasetRecord, CatalogError> {
        let found = self.named(name)?;
        let whole = found.iter().find(|record| record.name == name);
        whole.copied().ok_or_else(|| CatalogError::Group {
            name: name.to_owned(),
            members: found.iter().map(|record| record.name.clone()).collect(),
        })
    }

    /// Refuses a name that a new dataset, of `group` if it is a part of one, could not have,
    /// replacing whatever the user calls the same: what [`publish_archives`] would refuse, before
    /// anything is built.
    ///
    /// # Errors
    ///
    /// [`CatalogError::Part`], [`CatalogError::PartTaken`].
    pub fn check_free(&self, name: &str, group: Option<&str>) -> Result<(), CatalogError> {
        self.manifest.check_free(name, group)
    }

    /// Where the archive of a dataset lies.
    #[must_use]
    pub fn archive_path(&self, record: &DatasetRecord) -> PathBuf {
        self.folder.join(build::ARCHIVES).join(&record.file)
    }

    /// Opens the archive of a dataset, with one of the [`Descriptors::of_process`]: however many datasets
    /// are open, files are few.
    ///
    /// # Errors
    ///
    /// [`CatalogError::Missing`] if the file is gone: a newer generation may have dropped it.
    /// [`CatalogError::OtherArchive`] if it is not the archive that the manifest names.
    pub fn archive(&self, record: &DatasetRecord) -> Result<Archive, CatalogError> {
        let path = self.archive_path(record);
        let file = match Descriptors::of_process().open(&path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                return Err(CatalogError::Missing { path });
            }
            opened => opened,
        };
        let source = file.map_err(|source| CatalogError::io("open", &path, source))?;
        let archive = match Archive::open(Box::new(source)) {
            Ok(archive) => archive,
            Err(source) => return Err(CatalogError::Archive { path, source }),
        };
        let description = archive.description();
        let content = archive.content().map(|content| format!("{content:016x}"));
        let same = description.dataset == record.name
            && description.kind == record.kind
            // Without a whole trailer the archive is damaged, not another.
            && content.is_none_or(|content| content == record.content);
        if !same {
            let dataset = record.name.clone();
            return Err(CatalogError::OtherArchive { path, dataset });
        }
        Ok(archive)
    }

    /// Whether an archive that opened is as long as it should be: one that was cut is read as far as it
    /// is whole, and without its end may have no pages at all.
    ///
    /// # Errors
    ///
    /// [`CatalogError::Length`].
    pub fn check_length(
        &self,
        record: &DatasetRecord,
        archive: &Archive,
    ) -> Result<(), CatalogError> {
        let (found, expected) = (archive.len(), record.bytes);
        if found == expected {
            return Ok(());
        }
        Err(CatalogError::Length { path: self.archive_path(record), found, expected })
    }
}
