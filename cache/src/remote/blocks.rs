//! Blocks of archives on the disk, for the next time: of immutable content, so that none is ever stale.
//!
//! ```text
//!   folder/CONTENT-NUMBER    XXH3 of the rest, 8 bytes; the rest
//! ```
//!
//! A block appears whole, by a rename; one whose checksum does not hold is not there. Several processes may
//! share a folder. Past the bound the oldest written go first, down to nine tenths.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::time::SystemTime;

use xxhash_rust::xxh3::xxh3_64;

/// Bytes of a block, but of an archive's last.
pub(super) const BLOCK_BYTES: u64 = 128 << 10;

/// Bytes that this process writes between two looks at how many there are.
const LOOK_BYTES: u64 = 16 << 20;

/// What a block that is being written has in its name.
const NEW: &str = ".new-";

/// A folder of blocks.
#[derive(Debug)]
pub struct Blocks {
    folder: PathBuf,
    most_bytes: u64,
    /// Written since the last look.
    written: AtomicU64,
    names: AtomicU64,
}

impl Blocks {
    /// Keeps about `most_bytes` in `folder`, which is made if it is not there.
    ///
    /// # Errors
    ///
    /// If it cannot be made.
    pub fn open(folder: &Path, most_bytes: u64) -> io::Result<Self> {
        fs::create_dir_all(folder)?;
        let blocks = Self {
            folder: folder.to_owned(),
            most_bytes,
            written: AtomicU64::new(0),
            names: AtomicU64::new(0),
        };
        blocks.shrink();
        Ok(blocks)
    }

    fn path(&self, content: &str, number: u64) -> PathBuf {
        self.folder.join(format!("{content}-{number}"))
    }

    /// The block, if it is there and whole.
    pub(super) fn read(&self, content: &str, number: u64) -> Option<Vec<u8>> {
        let mut bytes = fs::read(self.path(content, number)).ok()?;
        let sum = u64::from_le_bytes(*bytes.first_chunk()?);
        bytes.drain(..size_of::<u64>());
        (xxh3_64(&bytes) == sum).then_some(bytes)
    }

    /// Keeps a block, if the disk lets it.
    pub(super) fn write(&self, content: &str, number: u64, bytes: &[u8]) {
        let name = self.names.fetch_add(1, Relaxed);
        let new = self.folder.join(format!("{content}{NEW}{}-{name}", std::process::id()));
        let whole = [&xxh3_64(bytes).to_le_bytes()[..], bytes].concat();
        let written =
            fs::write(&new, whole).and_then(|()| fs::rename(&new, self.path(content, number)));
        if written.is_err() {
            // A cache that cannot be written is one that is not there.
            let _ = fs::remove_file(&new);
        }
        let length = bytes.len() as u64;
        if self.written.fetch_add(length, Relaxed) + length >= LOOK_BYTES.min(self.most_bytes / 10)
        {
            self.written.store(0, Relaxed);
            self.shrink();
        }
    }

    /// Removes the oldest, and what killed processes were writing, past the bound.
    fn shrink(&self) {
        let Ok(listing) = fs::read_dir(&self.folder) else { return };
        let mut all: Vec<(SystemTime, u64, PathBuf)> = listing
            .filter_map(|entry| {
                let entry = entry.ok()?;
                let about = entry.metadata().ok()?;
                Some((about.modified().ok()?, about.len(), entry.path()))
            })
            .collect();
        let mut bytes: u64 = all.iter().map(|(_, bytes, _)| bytes).sum();
        if bytes <= self.most_bytes {
            return;
        }
        all.sort();
        for (_, length, path) in all {
            if bytes <= self.most_bytes / 10 * 9 {
                return;
            }
            // Another process may have done so.
            let _ = fs::remove_file(path);
            bytes -= length;
        }
    }
}
