//! What can be wrong with a raster, sorted by whose fault it is.

use std::error::Error;
use std::path::{Path, PathBuf};

use super::crs::ParseCrsError;

/// A raster that cannot be opened or read.
///
/// The first four are faults of the *file*, the next four mean that nothing is wrong with it but
/// that this program cannot use it as it is, the last two are the machine's and whoever else uses
/// it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RasterError {
    /// The file is of no kind that is read here.
    #[error("{}: not a raster: expected {expected}, the file starts with {found}", path.display())]
    NotARaster {
        /// The file.
        path: PathBuf,
        /// Its first bytes, printably.
        found: String,
        /// The kinds that are read.
        expected: &'static str,
    },

    /// The file ends inside a structure.
    #[error("{}: {what} needs bytes {start}..{end}, but the file has {len}", path.display())]
    Truncated {
        /// The file.
        path: PathBuf,
        /// The structure being read.
        what: String,
        /// Where it starts, in bytes from the start of the file.
        start: u64,
        /// Where it should end.
        end: u64,
        /// Where the file ends.
        len: u64,
    },

    /// A field holds a value that the format forbids.
    #[error("{}: {field} at byte {offset} is {found}, expected {expected}", path.display())]
    Field {
        /// The file.
        path: PathBuf,
        /// The field's name, with its TIFF tag or geo key where it has one.
        field: String,
        /// Its offset in bytes from the start of the file.
        offset: u64,
        /// The value found.
        found: String,
        /// What the format allows there, in words.
        expected: String,
    },

    /// Compressed samples that do not decode.
    #[error("{}: {what} at byte {offset} is damaged", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The tile, strip or image.
        what: String,
        /// Where its data start, in bytes from the start of the file.
        offset: u64,
        /// What the decoder says.
        source: Box<dyn Error + Send + Sync>,
    },

    /// A file as the format allows it, of a kind that is not read here.
    #[error("{}: {found} is not supported; supported: {supported}", path.display())]
    NotSupported {
        /// The file.
        path: PathBuf,
        /// What the file has.
        found: String,
        /// What it could have.
        supported: String,
    },

    /// A coordinate reference system that is not understood.
    #[error("{}: the coordinate reference system of {origin} is not understood", path.display())]
    Crs {
        /// The raster.
        path: PathBuf,
        /// Who said so: an option, a file, the raster's keys.
        origin: String,
        /// What is the matter with it.
        source: ParseCrsError,
    },

    /// Nothing says where the raster lies.
    #[error("{}: no georeferencing: {}; looked for {}", path.display(), missing, names(looked_for))]
    NoGeoreference {
        /// The raster.
        path: PathBuf,
        /// What is missing and how to give it.
        missing: &'static str,
        /// The files that could have said it.
        looked_for: Vec<PathBuf>,
    },

    /// An option that does not fit, by itself or with this raster.
    #[error("{}: {option} is {found}, expected {expected}", path.display())]
    Option {
        /// The raster.
        path: PathBuf,
        /// The option's name on the command line.
        option: &'static str,
        /// What it was.
        found: String,
        /// What it may be.
        expected: String,
    },

    /// Somebody wrote to the file, or put another in its place.
    #[error("{} was modified while it was read: {change}", path.display())]
    Modified {
        /// The file.
        path: PathBuf,
        /// How it differs from what was opened.
        change: String,
    },

    /// A file that lies where none may be read for whoever asked.
    #[error("not in an allowed folder: {}", path.display())]
    Outside {
        /// The file, as it was named.
        path: PathBuf,
    },

    /// The operating system refused.
    #[error("cannot {action} {}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was tried.
        action: &'static str,
        /// Why it failed.
        source: std::io::Error,
    },
}

impl RasterError {
    /// An [`RasterError::Io`], for `map_err`.
    pub(crate) fn io(
        action: &'static str,
        path: &Path,
    ) -> impl FnOnce(std::io::Error) -> RasterError {
        move |source| RasterError::Io { path: path.to_owned(), action, source }
    }

    /// A [`RasterError::NotSupported`].
    pub(crate) fn not_supported(
        path: &Path,
        found: impl Into<String>,
        supported: impl Into<String>,
    ) -> RasterError {
        RasterError::NotSupported {
            path: path.to_owned(),
            found: found.into(),
            supported: supported.into(),
        }
    }

    /// A [`RasterError::Field`].
    pub(crate) fn field(
        path: &Path,
        field: impl Into<String>,
        offset: u64,
        found: impl ToString,
        expected: impl Into<String>,
    ) -> RasterError {
        RasterError::Field {
            path: path.to_owned(),
            field: field.into(),
            offset,
            found: found.to_string(),
            expected: expected.into(),
        }
    }
}

/// Paths as a sentence lists them.
fn names(paths: &[PathBuf]) -> String {
    let names: Vec<String> = paths.iter().map(|path| path.display().to_string()).collect();
    if names.is_empty() { "nothing".to_owned() } else { names.join(", ") }
}
