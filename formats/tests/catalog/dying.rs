//! A disk that does what it is told on a real folder until its steps are used up; from then on every
//! call fails, as nothing a killed process still wanted happens.

use std::fs::File;
use std::io;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use areoid_formats::catalog::{Disk, RealDisk};

/// What happens to the append that has no step left.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Last {
    /// Nothing of it.
    Undone,
    /// The first half of its bytes is written.
    Torn,
}

/// The file system, until `steps` are used up.
#[derive(Debug)]
pub(crate) struct Dying {
    steps: usize,
    taken: AtomicUsize,
    last: Last,
    /// What was done, in words.
    pub(crate) log: Mutex<Vec<String>>,
}

impl Dying {
    pub(crate) fn after(steps: usize, last: Last) -> Self {
        Self { steps, taken: AtomicUsize::new(0), last, log: Mutex::default() }
    }

    fn step(&self, what: &str, path: &Path) -> io::Result<()> {
        if self.taken.fetch_add(1, Ordering::Relaxed) >= self.steps {
            return Err(io::Error::other("killed"));
        }
        self.log.lock().unwrap().push(format!("{what} {}", path.display()));
        Ok(())
    }

    pub(crate) fn died(&self) -> bool {
        self.taken.load(Ordering::Relaxed) > self.steps
    }
}

impl Disk for Dying {
    fn create_folders(&self, path: &Path) -> io::Result<()> {
        self.step("create", path)?;
        RealDisk.create_folders(path)
    }

    fn open_or_create(&self, path: &Path) -> io::Result<File> {
        self.step("open", path)?;
        RealDisk.open_or_create(path)
    }

    fn truncate(&self, file: &mut File, length: u64) -> io::Result<()> {
        self.step("truncate", Path::new(""))?;
        RealDisk.truncate(file, length)
    }

    fn append(&self, file: &mut File, bytes: &[u8]) -> io::Result<()> {
        let alive = self.step("append", Path::new(""));
        if alive.is_err()
            && self.last == Last::Torn
            && self.taken.load(Ordering::Relaxed) == self.steps + 1
        {
            RealDisk.append(file, &bytes[..bytes.len() / 2])?;
        }
        alive?;
        RealDisk.append(file, bytes)
    }

    fn sync_file(&self, file: &File) -> io::Result<()> {
        self.step("sync file", Path::new(""))?;
        RealDisk.sync_file(file)
    }

    fn sync_folder(&self, path: &Path) -> io::Result<()> {
        self.step("sync", path)?;
        RealDisk.sync_folder(path)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.step("rename", to)?;
        RealDisk.rename(from, to)
    }

    fn link(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.step("link", to)?;
        RealDisk.link(from, to)
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        self.step("remove", path)?;
        RealDisk.remove(path)
    }
}
