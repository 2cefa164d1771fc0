//! Reading a file by position: any thread, no shared cursor, no allocation larger than the file.

use std::fs::{File, Metadata};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use super::error::RasterError;
use super::fence::Fence;

/// An open file and its length.
///
/// Reads name their position, so any number of threads may read at once.
#[derive(Debug)]
pub(crate) struct PositionedFile {
    file: File,
    witness: Witness,
}

impl PositionedFile {
    /// Opens a regular file, which must lie `within`.
    pub(crate) fn open(path: &Path, within: Option<&Fence>) -> Result<Self, RasterError> {
        // Asked first: opening a pipe would wait for a writer.
        let metadata = std::fs::metadata(path).map_err(RasterError::io("open", path))?;
        if !metadata.is_file() {
            let found = if metadata.is_dir() { "a folder" } else { "no regular file" };
            return Err(RasterError::not_supported(path, found, "a raster file"));
        }
        let file = File::open(path).map_err(RasterError::io("open", path))?;
        within.map_or(Ok(()), |fence| fence.check(&file, path))?;
        let witness = Witness::of(&file, path)?;
        Ok(Self { file, witness })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.witness.path
    }

    /// The file's length in bytes.
    pub(crate) const fn len(&self) -> u64 {
        self.witness.state.len
    }

    /// Checks that neither the open file nor the one that now has its name differs from what was
    /// opened.
    pub(crate) fn check_unchanged(&self) -> Result<(), RasterError> {
        let metadata = self.file.metadata().map_err(RasterError::io("look at", self.path()))?;
        self.witness.compare(&metadata)?;
        self.witness.check_unchanged()
    }

    /// Bytes `start..start + count` of the file, which are `what` in the error if they are not all
    /// there.
    pub(crate) fn read(&self, what: &str, start: u64, count: u64) -> Result<Vec<u8>, RasterError> {
        let mut bytes = Vec::new();
        self.read_into(|| what.to_owned(), start, count, &mut bytes)?;
        Ok(bytes)
    }

    /// Like [`Self::read`], in place of what `bytes` holds.
    pub(crate) fn read_into(
        &self,
        what: impl FnOnce() -> String,
        start: u64,
        count: u64,
        bytes: &mut Vec<u8>,
    ) -> Result<(), RasterError> {
        let end = start.checked_add(count).filter(|&end| end <= self.len());
        let (Some(_), Ok(count)) = (end, usize::try_from(count)) else {
            return Err(RasterError::Truncated {
                path: self.path().to_owned(),
                what: what(),
                start,
                end: start.saturating_add(count),
                len: self.len(),
            });
        };
        // Zeros are needed only where the buffer grows.
        bytes.resize(count, 0);
        read_exact_at(&self.file, bytes, start).map_err(RasterError::io("read", self.path()))
    }
}

#[cfg(unix)]
fn read_exact_at(file: &File, bytes: &mut [u8], start: u64) -> std::io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, bytes, start)
}

#[cfg(windows)]
fn read_exact_at(file: &File, mut bytes: &mut [u8], mut start: u64) -> std::io::Result<()> {
    while !bytes.is_empty() {
        match std::os::windows::fs::FileExt::seek_read(file, bytes, start)? {
            0 => return Err(std::io::ErrorKind::UnexpectedEof.into()),
            count => {
                bytes = &mut bytes[count..];
                start += count as u64;
            }
        }
    }
    Ok(())
}

/// A file as it was when it was opened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Witness {
    path: PathBuf,
    state: State,
}

/// What changes if somebody writes to a file or puts another in its place.
#[derive(Clone, Debug, PartialEq, Eq)]
struct State {
    /// Device and inode, where there are such.
    identity: Option<(u64, u64)>,
    len: u64,
    modified: Option<SystemTime>,
    /// Seconds and nanoseconds of the last change, also of names and rights, where that is known.
    changed: Option<(i64, i64)>,
}

impl Witness {
    /// What `file`, opened at `path`, is now.
    fn of(file: &File, path: &Path) -> Result<Self, RasterError> {
        let metadata = file.metadata().map_err(RasterError::io("look at", path))?;
        Ok(Self { path: path.to_owned(), state: State::of(&metadata) })
    }

    /// Checks that the file that now has the name is the one that was opened, as it was.
    pub(crate) fn check_unchanged(&self) -> Result<(), RasterError> {
        match std::fs::metadata(&self.path) {
            Ok(metadata) => self.compare(&metadata),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                Err(self.modified("it is gone".to_owned()))
            }
            Err(error) => Err(RasterError::io("look at", &self.path)(error)),
        }
    }

    fn compare(&self, now: &Metadata) -> Result<(), RasterError> {
        let (then, now) = (&self.state, &State::of(now));
        if then.identity != now.identity {
            return Err(self.modified("another file has its name".to_owned()));
        }
        if then.len != now.len {
            return Err(self.modified(format!("it had {} bytes and has {}", then.len, now.len)));
        }
        if then != now {
            return Err(self.modified("it was written to or removed".to_owned()));
        }
        Ok(())
    }

    fn modified(&self, change: String) -> RasterError {
        RasterError::Modified { path: self.path.clone(), change }
    }
}

impl State {
    fn of(metadata: &Metadata) -> Self {
        #[cfg(unix)]
        let (identity, changed) = {
            use std::os::unix::fs::MetadataExt;
            let changed = (metadata.ctime(), metadata.ctime_nsec());
            (Some((metadata.dev(), metadata.ino())), Some(changed))
        };
        #[cfg(not(unix))]
        let (identity, changed) = (None, None);
        Self { identity, len: metadata.len(), modified: metadata.modified().ok(), changed }
    }
}

/// A small text file, such as a world file, which must lie `within`; `None` if there is none.
///
/// Bytes that are no UTF-8 become replacement characters.
pub(crate) fn read_text(
    path: &Path,
    within: Option<&Fence>,
) -> Result<Option<(String, Witness)>, RasterError> {
    const MOST_BYTES: u64 = 1 << 20;
    let file = match File::open(path) {
        Ok(file) => file,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(RasterError::io("open", path)(error)),
    };
    within.map_or(Ok(()), |fence| fence.check(&file, path))?;
    let witness = Witness::of(&file, path)?;
    let mut bytes = Vec::new();
    file.take(MOST_BYTES).read_to_end(&mut bytes).map_err(RasterError::io("read", path))?;
    Ok(Some((String::from_utf8_lossy(&bytes).into_owned(), witness)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn opened(bytes: &[u8]) -> (tempfile::TempDir, PathBuf, PositionedFile) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.tif");
        std::fs::write(&path, bytes).unwrap();
        let file = PositionedFile::open(&path, None).unwrap();
        (folder, path, file)
    }

    fn change(file: &PositionedFile) -> String {
        file.check_unchanged().unwrap_err().to_string()
    }

    #[test]
    fn reading_changes_nothing() {
        let (_folder, _, file) = opened(b"twelve bytes");
        assert_eq!(file.read("all", 0, 12).unwrap(), b"twelve bytes");
        file.check_unchanged().unwrap();
    }

    #[test]
    fn a_file_written_to_replaced_or_gone_is_told() {
        let (_folder, path, file) = opened(b"twelve bytes");
        std::fs::write(&path, b"now thirteen!").unwrap();
        let message = change(&file);
        assert!(message.ends_with("was modified while it was read: it had 12 bytes and has 13"));

        // The same length, and another time.
        let (_folder, path, file) = opened(b"twelve bytes");
        std::fs::write(&path, b"other twelve").unwrap();
        let later = SystemTime::now() + Duration::from_nanos(1500);
        File::options().write(true).open(&path).unwrap().set_modified(later).unwrap();
        assert!(change(&file).ends_with("it was written to or removed"), "{}", change(&file));

        let (folder, path, file) = opened(b"twelve bytes");
        let other = folder.path().join("b.tif");
        std::fs::write(&other, b"twelve bytes").unwrap();
        std::fs::rename(&other, &path).unwrap();
        assert!(file.check_unchanged().is_err());
        std::fs::remove_file(&path).unwrap();
        assert!(file.check_unchanged().is_err());

        let (_folder, path, file) = opened(b"twelve bytes");
        std::fs::remove_file(&path).unwrap();
        assert!(file.check_unchanged().is_err());
    }

    /// Whoever sets the time back cannot set the time of the change back.
    #[cfg(unix)]
    #[test]
    fn a_time_set_back_hides_nothing() {
        let (_folder, path, file) = opened(b"twelve bytes");
        let then = std::fs::metadata(&path).unwrap().modified().unwrap();
        // The clock of files may tick in milliseconds.
        while std::fs::metadata(&path).unwrap().modified().unwrap() == then {
            std::fs::write(&path, b"other twelve").unwrap();
        }
        File::options().write(true).open(&path).unwrap().set_modified(then).unwrap();
        assert!(change(&file).ends_with("it was written to or removed"));
    }
}
