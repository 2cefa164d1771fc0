//! Blocks of archives on the disk, for the next time: of immutable content, so that none is ever stale.
//!
//! ```text
//!   folder/CONTENT@SERVER-NUMBER    XXH3 of the rest, 8 bytes; the rest
//! ```
//!
//! What one server says is never taken for what another has, even if both call it by one name.
//!
//! A block appears whole, by a rename; one whose length or checksum is wrong is not there. Before the bound
//! would be passed, the longest unused go, down to nine tenths. Files of other names are let alone.

use std::fs::{self, File};
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, SystemTime};

use xxhash_rust::xxh3::xxh3_64;

use crate::locks::lock;

/// Bytes of a block, but of an archive's last.
pub(super) const BLOCK_BYTES: u64 = 128 << 10;

/// Bytes of the checksum before a block.
const SUM_BYTES: u64 = size_of::<u64>() as u64;

/// The part of the bound that is written between two looks at what others have written.
const LOOKS: u64 = 16;

/// A use is noted where the last one noted is so long ago.
const NOTED: Duration = Duration::from_secs(60);

/// What a block that is being written has in its name.
const NEW: &str = ".new-";

/// A folder of blocks. All threads may read and write.
///
/// The bound holds at every moment for one process; of several that share a folder, each may pass it
/// by what the others write while it writes a sixteenth of it.
#[derive(Debug)]
pub struct Blocks {
    folder: PathBuf,
    most_bytes: u64,
    state: Mutex<State>,
}

/// Held while a block is written.
#[derive(Debug, Default)]
struct State {
    /// Bytes in the folder: never fewer than there are, as far as this process knows.
    held: u64,
    /// Bytes written since the last look.
    written: u64,
    names: u64,
}

impl Blocks {
    /// Keeps at most `most_bytes` in `folder`, which is made if it is not there.
    ///
    /// # Errors
    ///
    /// If it cannot be made.
    pub fn open(folder: &Path, most_bytes: u64) -> io::Result<Self> {
        fs::create_dir_all(folder)?;
        let blocks = Self { folder: folder.to_owned(), most_bytes, state: Mutex::default() };
        let mut state = State::default();
        blocks.look(&mut state, 0);
        Ok(Self { state: Mutex::new(state), ..blocks })
    }

    fn path(&self, key: &str, number: u64) -> PathBuf {
        self.folder.join(format!("{key}-{number}"))
    }

    /// Whether there is a block, whole or not.
    pub(super) fn has(&self, key: &str, number: u64) -> bool {
        self.path(key, number).exists()
    }

    /// The block of `length` bytes, if it is there and whole.
    pub(super) fn read(&self, key: &str, number: u64, length: usize) -> Option<Vec<u8>> {
        let file = File::open(self.path(key, number)).ok()?;
        let used = file.metadata().ok()?.modified().ok();
        let mut bytes = Vec::with_capacity(length + size_of::<u64>());
        (&file).take(length as u64 + SUM_BYTES + 1).read_to_end(&mut bytes).ok()?;
        let sum = u64::from_le_bytes(*bytes.first_chunk()?);
        bytes.drain(..size_of::<u64>());
        if bytes.len() != length || xxh3_64(&bytes) != sum {
            return None;
        }
        if used.and_then(|used| used.elapsed().ok()).is_some_and(|age| age > NOTED) {
            // Where it cannot be noted, the oldest written go first.
            let _ = file.set_modified(SystemTime::now());
        }
        Some(bytes)
    }

    /// Keeps a block, if the disk lets it.
    pub(super) fn write(&self, key: &str, number: u64, bytes: &[u8]) {
        let length = bytes.len() as u64 + SUM_BYTES;
        if length > self.most_bytes {
            return;
        }
        let mut state = lock(&self.state);
        if state.held + length > self.most_bytes || state.written > self.most_bytes / LOOKS {
            self.look(&mut state, length);
        }
        state.held += length;
        state.written += length;
        state.names += 1;
        let (process, name) = (std::process::id(), state.names);
        let new = self.folder.join(format!("{key}-{number}{NEW}{process}-{name}"));
        let whole = [&xxh3_64(bytes).to_le_bytes()[..], bytes].concat();
        let written =
            fs::write(&new, whole).and_then(|()| fs::rename(&new, self.path(key, number)));
        if written.is_err() {
            // A cache that cannot be written is one that is not there.
            let _ = fs::remove_file(&new);
        }
    }

    /// Drops a block whose bytes are not what they should be.
    pub(super) fn forget(&self, key: &str, number: u64) {
        // It may be gone already.
        let _ = fs::remove_file(self.path(key, number));
    }

    /// Drops all blocks of a key.
    pub(super) fn forget_all(&self, key: &str) {
        for (_, _, path) in self.listed() {
            let name = path.file_name().and_then(|name| name.to_str());
            let rest = name.and_then(|name| name.strip_prefix(key));
            if rest.is_some_and(|rest| rest.starts_with('-')) {
                let _ = fs::remove_file(path);
            }
        }
    }

    /// Counts what is there, and makes room for `length` bytes if there is none.
    fn look(&self, state: &mut State, length: u64) {
        let mut all = self.listed();
        state.held = all.iter().map(|(_, bytes, _)| bytes).sum();
        state.written = 0;
        if state.held + length <= self.most_bytes {
            return;
        }
        all.sort();
        let enough = (self.most_bytes / 10 * 9).saturating_sub(length);
        for (_, bytes, path) in all {
            if state.held <= enough {
                return;
            }
            // Another process may have done so.
            let _ = fs::remove_file(path);
            state.held -= bytes;
        }
    }

    /// All blocks, and what killed processes were writing: last use, bytes, path.
    fn listed(&self) -> Vec<(SystemTime, u64, PathBuf)> {
        let Ok(listing) = fs::read_dir(&self.folder) else { return Vec::new() };
        let block = |entry: io::Result<fs::DirEntry>| {
            let entry = entry.ok()?;
            entry.file_name().to_str().filter(|name| is_block(name))?;
            let about = entry.metadata().ok().filter(fs::Metadata::is_file)?;
            Some((about.modified().ok()?, about.len(), entry.path()))
        };
        listing.filter_map(block).collect()
    }
}

/// What the blocks of a content of a server are called, but for their numbers.
pub(super) fn key(content: &str, server: &str) -> String {
    let mut key = format!("{content}@");
    for byte in server.bytes() {
        if byte.is_ascii_alphanumeric() || byte == b'.' {
            key.push(char::from(byte));
        } else {
            key.push_str(&format!("_{byte:02x}"));
        }
    }
    key
}

/// Whether a file of this name is one of ours.
fn is_block(name: &str) -> bool {
    let digits = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    let named = name.split_once('@').filter(|(content, _)| is_content(content));
    named
        .and_then(|(_, rest)| rest.split_once('-'))
        .is_some_and(|(_, rest)| digits(rest.split_once(NEW).map_or(rest, |(number, _)| number)))
}

/// Whether `text` names a content: 16 hexadecimal digits.
pub(super) fn is_content(text: &str) -> bool {
    text.len() == 16 && text.bytes().all(|byte| matches!(byte, b'0'..=b'9' | b'a'..=b'f'))
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: &str = "0123456789abcdef@here";

    fn bytes_in(folder: &Path) -> u64 {
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().metadata().unwrap().len()).sum()
    }

    #[test]
    fn the_bound_holds_after_every_write_and_the_longest_unused_goes_first() {
        let folder = tempfile::tempdir().unwrap();
        let blocks = Blocks::open(folder.path(), 1000).unwrap();
        let aged = |number: u64, seconds: u64| {
            let file = File::options().write(true).open(blocks.path(KEY, number)).unwrap();
            file.set_modified(SystemTime::now() - Duration::from_secs(seconds)).unwrap();
        };
        for number in 0..9 {
            blocks.write(KEY, number, &[7; 92]);
            aged(number, 1000 - number);
        }
        // Used again, the first outlives the second.
        assert_eq!(blocks.read(KEY, 0, 92).unwrap(), [7; 92]);
        for number in 9..40 {
            blocks.write(KEY, number, &[7; 92]);
            assert!(bytes_in(folder.path()) <= 1000, "{number}: {}", bytes_in(folder.path()));
            if number == 10 {
                assert!(blocks.has(KEY, 0) && !blocks.has(KEY, 1));
            }
        }
        assert!(bytes_in(folder.path()) >= 800);
        // What does not fit at all is not kept, and nothing is dropped for it.
        blocks.write(KEY, 99, &[7; 993]);
        assert!(!blocks.has(KEY, 99) && bytes_in(folder.path()) >= 800);
    }

    #[test]
    fn a_block_that_is_not_what_was_written_is_not_there() {
        let folder = tempfile::tempdir().unwrap();
        let blocks = Blocks::open(folder.path(), 1 << 20).unwrap();
        blocks.write(KEY, 3, b"some bytes");
        let path = blocks.path(KEY, 3);
        let whole = fs::read(&path).unwrap();
        assert_eq!(blocks.read(KEY, 3, 10).unwrap(), b"some bytes");
        for other in [9, 11, 0] {
            assert_eq!(blocks.read(KEY, 3, other), None, "of another length");
        }
        for at in 0..whole.len() {
            let mut damaged = whole.clone();
            damaged[at] ^= 1;
            fs::write(&path, damaged).unwrap();
            assert_eq!(blocks.read(KEY, 3, 10), None, "byte {at}");
            fs::write(&path, &whole[..at]).unwrap();
            assert_eq!(blocks.read(KEY, 3, 10), None, "cut at {at}");
        }
    }

    #[test]
    fn a_block_is_of_one_server() {
        let folder = tempfile::tempdir().unwrap();
        let blocks = Blocks::open(folder.path(), 1 << 20).unwrap();
        let keys = ["http://one:80", "http://one:8", "http://one:8-0", "http://one_3a8"]
            .map(|server| key("0123456789abcdef", server));
        for (byte, key) in (0..).zip(&keys) {
            blocks.write(key, 0, &[byte; 3]);
        }
        for (byte, key) in (0..).zip(&keys) {
            assert_eq!(blocks.read(key, 0, 3).unwrap(), [byte; 3], "{key}");
        }
        blocks.forget_all(&keys[1]);
        assert_eq!(keys.each_ref().map(|key| blocks.has(key, 0)), [true, false, true, true]);
    }

    /// A folder that holds other things as well, by mistake.
    #[test]
    fn other_files_are_let_alone() {
        let folder = tempfile::tempdir().unwrap();
        let others = [
            "thesis.tex",
            "0123456789abcdef",
            "0123456789abcdef-7",
            "0123456789abcdef@here-",
            "a@b-1",
        ];
        for name in others {
            fs::write(folder.path().join(name), [0; 500]).unwrap();
        }
        let left = folder.path().join(format!("{KEY}-7{NEW}1-1"));
        fs::write(&left, [0; 500]).unwrap();
        let blocks = Blocks::open(folder.path(), 400).unwrap();
        for number in 0..9 {
            blocks.write(KEY, number, &[7; 92]);
        }
        blocks.forget_all(KEY);
        assert!(!left.exists(), "what a killed process left");
        for name in others {
            assert!(folder.path().join(name).exists(), "{name}");
        }
        assert!(!blocks.has(KEY, 8));
    }
}
