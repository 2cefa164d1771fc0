//! The few things a catalog does to a disk, so that a test can stop it before any of them.

use std::fs::{self, File};
use std::io::{self, Seek as _, Write};
use std::path::Path;

/// Changes to a file system.
///
/// # Contract
///
/// * **Atomic.** `rename` and `link` happen wholly or not at all; `link` fails with
///   [`io::ErrorKind::AlreadyExists`] if the new name is taken.
/// * **Durable.** What `sync_file` and `sync_folder` return from survives a power failure.
///
/// The test twin in `formats/tests/catalog/dying.rs` fails from a chosen step on, as a killed process
/// would.
pub trait Disk: Send + Sync {
    /// Creates the folder and those above it, if they are not there.
    ///
    /// # Errors
    ///
    /// Whatever the system reports.
    fn create_folders(&self, path: &Path) -> io::Result<()>;

    /// Opens a file for reading and writing, creating it if it is not there and keeping what is.
    ///
    /// # Errors
    ///
    /// Whatever the system reports.
    fn open_or_create(&self, path: &Path) -> io::Result<File>;

    /// Cuts an open file to `length` bytes, to which the next [`Self::append`] appends.
    ///
    /// # Errors
    ///
    /// Whatever the system reports.
    fn truncate(&self, file: &mut File, length: u64) -> io::Result<()>;

    /// Appends to an open file.
    ///
    /// # Errors
    ///
    /// Whatever the system reports.
    fn append(&self, file: &mut File, bytes: &[u8]) -> io::Result<()>;

    /// Waits until the contents of a file are on the medium.
    ///
    /// # Errors
    ///
    /// Whatever the system reports.
    fn sync_file(&self, file: &File) -> io::Result<()>;

    /// Waits until the names in a folder are on the medium.
    ///
    /// # Errors
    ///
    /// Whatever the system reports.
    fn sync_folder(&self, path: &Path) -> io::Result<()>;

    /// Gives a file another name, replacing a file of that name.
    ///
    /// # Errors
    ///
    /// Whatever the system reports.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;

    /// Gives a file a second name, if that is not taken.
    ///
    /// # Errors
    ///
    /// Whatever the system reports.
    fn link(&self, from: &Path, to: &Path) -> io::Result<()>;

    /// Removes a name.
    ///
    /// # Errors
    ///
    /// Whatever the system reports.
    fn remove(&self, path: &Path) -> io::Result<()>;
}

/// The file system.
#[derive(Clone, Copy, Debug, Default)]
pub struct RealDisk;

impl Disk for RealDisk {
    fn create_folders(&self, path: &Path) -> io::Result<()> {
        fs::create_dir_all(path)
    }

    fn open_or_create(&self, path: &Path) -> io::Result<File> {
        File::options().read(true).write(true).create(true).truncate(false).open(path)
    }

    fn truncate(&self, file: &mut File, length: u64) -> io::Result<()> {
        file.set_len(length)?;
        file.seek(io::SeekFrom::Start(length)).map(drop)
    }

    fn append(&self, file: &mut File, bytes: &[u8]) -> io::Result<()> {
        file.write_all(bytes)
    }

    fn sync_file(&self, file: &File) -> io::Result<()> {
        file.sync_all()
    }

    fn sync_folder(&self, path: &Path) -> io::Result<()> {
        // Windows has no way to sync a folder, and does not need one.
        if cfg!(unix) { File::open(path)?.sync_all() } else { Ok(()) }
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        fs::rename(from, to)
    }

    fn link(&self, from: &Path, to: &Path) -> io::Result<()> {
        fs::hard_link(from, to)
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        fs::remove_file(path)
    }
}
