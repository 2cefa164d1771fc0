//! What can go wrong with a catalog.

use std::io;
use std::path::{Path, PathBuf};

use crate::archive::ArchiveError;

/// A catalog that cannot be read or changed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CatalogError {
    /// A folder without a manifest.
    #[error("no catalog in {}: there is no manifest", folder.display())]
    NotACatalog {
        /// The folder.
        folder: PathBuf,
    },

    /// A manifest that cannot be understood.
    #[error("the manifest {} is not valid: {reason}", path.display())]
    Manifest {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },

    /// A dataset that the catalog does not have.
    #[error("no dataset called {name} in {}", folder.display())]
    NoSuchDataset {
        /// The name asked for.
        name: String,
        /// The catalog.
        folder: PathBuf,
    },

    /// A group where one dataset was asked for.
    #[error("{name} is a group: name one of {}", members.join(", "))]
    Group {
        /// The name asked for.
        name: String,
        /// Its parts.
        members: Vec<String>,
    },

    /// The name of a part where that of a whole was asked for.
    #[error("{name} is a part of {group}, which is replaced and removed as a whole")]
    Part {
        /// The name asked for.
        name: String,
        /// The group.
        group: String,
    },

    /// A group whose part would have the name of another dataset.
    #[error("{group} would have a part called {name}, and there is another dataset of that name")]
    PartTaken {
        /// The part.
        name: String,
        /// The group.
        group: String,
    },

    /// A dataset that is there already.
    #[error(
        "a dataset called {name} is there already, made from something else: --force replaces it"
    )]
    Exists {
        /// Its name.
        name: String,
    },

    /// A name that cannot be a dataset's.
    #[error(
        "{name:?} cannot name a dataset: use 1 to 100 letters, digits, '-', '_' and '.', starting with a letter or digit"
    )]
    Name {
        /// The name given.
        name: String,
    },

    /// Another process builds a dataset of this name.
    #[error("another process is building {name} in this catalog")]
    Busy {
        /// The dataset.
        name: String,
    },

    /// A dataset of another body.
    #[error("the catalog shows {catalog}, the raster {raster}: one catalog holds one body")]
    OtherBody {
        /// The catalog's body.
        catalog: String,
        /// The raster's.
        raster: String,
    },

    /// An archive that the manifest names and the folder does not have.
    #[error("the archive {} is missing", path.display())]
    Missing {
        /// Where it should be.
        path: PathBuf,
    },

    /// An archive under the name of another.
    #[error("{} is not the archive of {dataset} that the manifest names", path.display())]
    OtherArchive {
        /// The file.
        path: PathBuf,
        /// The dataset.
        dataset: String,
    },

    /// An archive that is not as long as it was when it was published: what is whole of it is read.
    #[error("{} is damaged: of {expected} bytes it has {found}", path.display())]
    Length {
        /// The file.
        path: PathBuf,
        /// Its length now.
        found: u64,
        /// What the manifest says.
        expected: u64,
    },

    /// An archive that cannot be read.
    #[error("cannot read the archive {}", path.display())]
    Archive {
        /// The file.
        path: PathBuf,
        /// Why.
        source: ArchiveError,
    },

    /// The file system refused.
    #[error("cannot {action} {}", path.display())]
    Io {
        /// What was tried.
        action: &'static str,
        /// On what.
        path: PathBuf,
        /// What the system reported.
        source: io::Error,
    },
}

impl CatalogError {
    /// The file system refused to `action` the file or folder at `path`.
    #[must_use]
    pub fn io(action: &'static str, path: &Path, source: io::Error) -> Self {
        Self::Io { action, path: path.to_owned(), source }
    }
}
