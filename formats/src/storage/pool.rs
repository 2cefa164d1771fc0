//! Files that are open only while they are read: a catalog has more of them than a process may.

use std::fs::File;
use std::io;
use std::num::NonZeroUsize;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, LazyLock, Mutex, MutexGuard, PoisonError};

use lru::LruCache;

use super::{ByteSource, advise, read_exact_at};

/// Open files, of which the one that was not read for the longest is closed for another.
#[derive(Debug)]
pub struct Descriptors {
    open: Mutex<Open>,
}

#[derive(Debug)]
struct Open {
    files: LruCache<u64, Arc<File>>,
    next: u64,
}

/// A file read by position, as [`FileSource`](super::FileSource) is, which is open when it was read of
/// late, and else opened again.
///
/// Its length is that of when it was first opened. What lies under its path must not become another file:
/// archives are called by their content.
#[derive(Debug)]
pub struct PooledFile {
    pool: Arc<Descriptors>,
    number: u64,
    path: PathBuf,
    len: u64,
}

impl Descriptors {
    /// The share of the descriptors that a process may have which hold archives, and how many do at least
    /// and at most.
    const SHARE: u64 = 4;
    const MOST: [u64; 2] = [16, 4096];

    /// At most so many are open at a time, beside those just being read.
    #[must_use]
    pub fn new(most: usize) -> Arc<Self> {
        let most = NonZeroUsize::new(most).unwrap_or(NonZeroUsize::MIN);
        Arc::new(Self { open: Mutex::new(Open { files: LruCache::new(most), next: 0 }) })
    }

    /// Those of this process: a part of what the system allows it when it is first asked.
    #[must_use]
    pub fn of_process() -> Arc<Self> {
        static POOL: LazyLock<Arc<Descriptors>> = LazyLock::new(|| {
            let [least, most] = Descriptors::MOST;
            let share = (allowed() / Descriptors::SHARE).clamp(least, most);
            Descriptors::new(usize::try_from(share).unwrap_or(usize::MAX))
        });
        Arc::clone(&POOL)
    }

    /// Opens a file for reading.
    ///
    /// # Errors
    ///
    /// Whatever the system says of it.
    pub fn open(self: &Arc<Self>, path: &Path) -> io::Result<PooledFile> {
        let file = self.open_anyway(path)?;
        let len = file.metadata()?.len();
        let number = {
            let mut open = self.lock();
            open.next += 1;
            open.next
        };
        self.keep(number, &Arc::new(file));
        Ok(PooledFile { pool: Arc::clone(self), number, path: path.to_owned(), len })
    }

    /// Opens a file, closing those of the pool where the system has no descriptor left.
    fn open_anyway(&self, path: &Path) -> io::Result<File> {
        let opened = File::open(path);
        if opened.as_ref().is_err_and(is_exhausted) {
            let all: Vec<_> = {
                let mut open = self.lock();
                std::iter::from_fn(|| open.files.pop_lru()).collect()
            };
            drop(all);
            return File::open(path);
        }
        opened
    }

    fn keep(&self, number: u64, file: &Arc<File>) {
        // Closed when the lock is free again.
        let closed = self.lock().files.push(number, Arc::clone(file));
        drop(closed);
    }

    fn lock(&self) -> MutexGuard<'_, Open> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl PooledFile {
    fn file(&self) -> io::Result<Arc<File>> {
        if let Some(file) = self.pool.lock().files.get(&self.number) {
            return Ok(Arc::clone(file));
        }
        // Whoever opens it at the same time has another of it for a moment.
        let file = Arc::new(self.pool.open_anyway(&self.path)?);
        self.pool.keep(self.number, &file);
        Ok(file)
    }
}

impl ByteSource for PooledFile {
    fn len(&self) -> u64 {
        self.len
    }

    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        read_exact_at(&*self.file()?, buffer, offset)
    }

    fn advise(&self, range: Range<u64>) {
        if let Ok(file) = self.file() {
            advise(&file, range);
        }
    }

    fn open_file(&self) -> Option<Arc<File>> {
        self.pool.lock().files.get(&self.number).map(Arc::clone)
    }
}

impl Drop for PooledFile {
    fn drop(&mut self) {
        let closed = self.pool.lock().files.pop(&self.number);
        drop(closed);
    }
}

/// Whether there are no descriptors left, of the process or of the system.
#[cfg(unix)]
fn is_exhausted(error: &io::Error) -> bool {
    use rustix::io::Errno;
    let code = error.raw_os_error();
    [Errno::MFILE, Errno::NFILE].iter().any(|errno| code == Some(errno.raw_os_error()))
}

#[cfg(not(unix))]
fn is_exhausted(_: &io::Error) -> bool {
    false
}

/// How many descriptors the process may have.
#[cfg(unix)]
fn allowed() -> u64 {
    use rustix::process::{Resource, getrlimit};
    getrlimit(Resource::Nofile).current.unwrap_or(u64::MAX)
}

/// As many as are usual, where the system does not tell.
#[cfg(not(unix))]
fn allowed() -> u64 {
    1024
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn byte(file: &PooledFile, offset: u64) -> io::Result<u8> {
        let mut byte = [0];
        file.read_exact_at(&mut byte, offset)?;
        Ok(byte[0])
    }

    #[test]
    fn files_are_closed_for_others_and_opened_again() {
        let folder = tempfile::tempdir().unwrap();
        let pool = Descriptors::new(3);
        let path = |number: u8| folder.path().join(number.to_string());
        let files: Vec<PooledFile> = (0..10)
            .map(|number| {
                fs::write(path(number), [number, 100 + number]).unwrap();
                pool.open(&path(number)).unwrap()
            })
            .collect();
        let open = || pool.lock().files.len();
        for turn in 0..100_u8 {
            let number = turn.wrapping_mul(7) % 10;
            let file = &files[usize::from(number)];
            assert_eq!((byte(file, 0).unwrap(), byte(file, 1).unwrap()), (number, 100 + number));
            assert_eq!(open(), 3);
        }
        // One that is open outlives its name, one that is not is an error of its own.
        byte(&files[4], 0).unwrap();
        assert!(files[4].open_file().is_some());
        assert!(files[5].open_file().is_none());
        (0..10).for_each(|number| fs::remove_file(path(number)).unwrap());
        assert_eq!(byte(&files[4], 1).unwrap(), 104);
        let error = byte(&files[5], 0).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::NotFound);
        drop(files);
        assert_eq!(open(), 0);
    }

    /// A file may be cut while it is closed.
    #[test]
    fn a_file_that_was_cut_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let [one, other] = ["one", "other"].map(|name| folder.path().join(name));
        fs::write(&one, [7; 10]).unwrap();
        fs::write(&other, [7; 10]).unwrap();
        let pool = Descriptors::new(1);
        let (file, _other) = (pool.open(&one).unwrap(), pool.open(&other).unwrap());
        fs::write(&one, [7; 5]).unwrap();
        assert_eq!((file.len(), byte(&file, 4).unwrap()), (10, 7));
        assert_eq!(byte(&file, 5).unwrap_err().kind(), io::ErrorKind::UnexpectedEof);
    }
}
