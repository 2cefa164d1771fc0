//! An archive under construction in a catalog's folder.
//!
//! ```text
//!   build/NAME.part      the archive so far, locked by the process that writes it
//!   build/NAME.scratch   pages that wait for their neighbors
//!   build/NAME.note      where the work stood; what it speaks of is in the other two
//! ```

use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use super::disk::Disk;
use super::error::CatalogError;
use super::manifest::check_name;
use crate::storage::FileSource;

pub(super) const ARCHIVES: &str = "archives";
const BUILDS: &str = "build";

const PART: &str = "part";
const SCRATCH: &str = "scratch";
const NOTE: &str = "note";
/// A note that is being written.
const NEW_NOTE: &str = "note-new";

/// What stands beside the archive; the note first, which speaks of the others.
const BESIDE: [&str; 3] = [NOTE, NEW_NOTE, SCRATCH];

/// An archive under construction.
///
/// It is a [`Write`] sink. The file is locked as long as this lives: two processes cannot build
/// one dataset at once, and a file that can be locked belongs to nobody.
pub struct Build<'a> {
    pub(super) disk: &'a dyn Disk,
    pub(super) folder: PathBuf,
    name: String,
    file: File,
}

impl<'a> Build<'a> {
    /// Starts a build of `name` in the catalog at `folder`, which need not exist yet. Leftovers of
    /// an earlier build are discarded.
    ///
    /// # Errors
    ///
    /// [`CatalogError::Name`], [`CatalogError::Busy`], or [`CatalogError::Io`].
    pub fn start(disk: &'a dyn Disk, folder: &Path, name: &str) -> Result<Self, CatalogError> {
        let mut build = Self::resume(disk, folder, name)?;
        build.cut(0)?;
        Ok(build)
    }

    /// Goes on with a build of `name`, if one was left; else starts one.
    ///
    /// # Errors
    ///
    /// Those of [`Self::start`].
    pub fn resume(disk: &'a dyn Disk, folder: &Path, name: &str) -> Result<Self, CatalogError> {
        check_name(name)?;
        create_folders(disk, &folder.join(BUILDS))?;
        create_folders(disk, &folder.join(ARCHIVES))?;
        let path = path_of(folder, name, PART);
        let file = disk
            .open_or_create(&path)
            .map_err(|source| CatalogError::io("create", &path, source))?;
        let busy = || CatalogError::Busy { name: name.to_owned() };
        match file.try_lock() {
            Ok(()) => {}
            Err(fs::TryLockError::WouldBlock) => return Err(busy()),
            Err(fs::TryLockError::Error(error)) => {
                return Err(CatalogError::io("lock", &path, error));
            }
        }
        // Between opening and locking another builder may have renamed this very file.
        if !same_file(&file, &path) {
            return Err(busy());
        }
        Ok(Self { disk, folder: folder.to_owned(), name: name.to_owned(), file })
    }

    /// Cuts the archive to its first `length` bytes, behind which the next are written. With none
    /// left, what was noted of it is discarded too.
    ///
    /// # Errors
    ///
    /// [`CatalogError::Io`].
    pub fn cut(&mut self, length: u64) -> Result<(), CatalogError> {
        if length == 0 {
            for beside in BESIDE {
                self.remove(beside)?;
            }
        }
        let path = self.path();
        let cut = self.disk.truncate(&mut self.file, length);
        cut.map_err(|source| CatalogError::io("cut", &path, source))
    }

    /// What is written so far, for reading.
    ///
    /// # Errors
    ///
    /// [`CatalogError::Io`].
    pub fn source(&self) -> Result<FileSource, CatalogError> {
        let source = self.file.try_clone().and_then(FileSource::new);
        source.map_err(|source| CatalogError::io("read", &self.path(), source))
    }

    /// A file beside the archive for whatever the build needs to put aside.
    ///
    /// # Errors
    ///
    /// [`CatalogError::Io`].
    pub fn scratch(&self) -> Result<File, CatalogError> {
        let path = path_of(&self.folder, &self.name, SCRATCH);
        let file = self.disk.open_or_create(&path);
        file.map_err(|source| CatalogError::io("create", &path, source))
    }

    /// Makes what is written so far durable, then keeps `note`, in the place of the one before.
    ///
    /// # Errors
    ///
    /// [`CatalogError::Io`].
    pub fn note(&mut self, note: &[u8]) -> Result<(), CatalogError> {
        let path = path_of(&self.folder, &self.name, NOTE);
        let temporary = path_of(&self.folder, &self.name, NEW_NOTE);
        let (disk, file) = (self.disk, &self.file);
        let write = || {
            disk.sync_file(file)?;
            let mut file = disk.open_or_create(&temporary)?;
            disk.truncate(&mut file, 0)?;
            disk.append(&mut file, note)?;
            disk.sync_file(&file)?;
            disk.rename(&temporary, &path)?;
            disk.sync_folder(&self.folder.join(BUILDS))
        };
        write().map_err(|source| CatalogError::io("write", &path, source))
    }

    /// The note kept last, if there is one.
    ///
    /// # Errors
    ///
    /// [`CatalogError::Io`].
    pub fn last_note(&self) -> Result<Option<Vec<u8>>, CatalogError> {
        let path = path_of(&self.folder, &self.name, NOTE);
        match fs::read(&path) {
            Ok(note) => Ok(Some(note)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(CatalogError::io("read", &path, error)),
        }
    }

    /// Gives the build up and removes its files.
    ///
    /// # Errors
    ///
    /// [`CatalogError::Io`].
    pub fn discard(self) -> Result<(), CatalogError> {
        self.tidy();
        let path = self.path();
        self.disk.remove(&path).map_err(|source| CatalogError::io("remove", &path, source))
    }

    /// Waits, whenever it is called, until what the archive is by then is on the medium.
    ///
    /// An error that it returns is lost to whoever else waits: the build must not be published.
    ///
    /// # Errors
    ///
    /// [`CatalogError::Io`].
    pub fn syncing(&self) -> Result<impl Fn() -> io::Result<()> + Send + use<'a>, CatalogError> {
        let file = self.file.try_clone();
        let file = file.map_err(|source| CatalogError::io("sync", &self.path(), source))?;
        let disk = self.disk;
        Ok(move || disk.sync_file(&file))
    }

    /// Waits until the archive is on the medium.
    pub(super) fn sync(&self) -> Result<(), CatalogError> {
        let synced = self.disk.sync_file(&self.file);
        synced.map_err(|source| CatalogError::io("sync", &self.path(), source))
    }

    /// Where the archive lies.
    pub(super) fn path(&self) -> PathBuf {
        path_of(&self.folder, &self.name, PART)
    }

    /// Removes what stands beside the archive. What cannot be removed is, by the next build of this
    /// name.
    pub(super) fn tidy(&self) {
        for beside in BESIDE {
            let _ = self.remove(beside);
        }
    }

    fn remove(&self, extension: &str) -> Result<(), CatalogError> {
        remove(self.disk, &path_of(&self.folder, &self.name, extension))
    }
}

impl std::fmt::Debug for Build<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Build").field("path", &self.path()).finish_non_exhaustive()
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

fn path_of(folder: &Path, name: &str, extension: &str) -> PathBuf {
    folder.join(BUILDS).join(format!("{name}.{extension}"))
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

/// Removes a file, if it is there.
pub(super) fn remove(disk: &dyn Disk, path: &Path) -> Result<(), CatalogError> {
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
