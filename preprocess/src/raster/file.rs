//! Reading a file by position: any thread, no shared cursor, no allocation larger than the file.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use super::error::RasterError;

/// An open file and its length.
///
/// Reads name their position, so any number of threads may read at once.
#[derive(Debug)]
pub(crate) struct PositionedFile {
    file: File,
    path: PathBuf,
    len: u64,
}

impl PositionedFile {
    /// Opens a regular file.
    pub(crate) fn open(path: &Path) -> Result<Self, RasterError> {
        // Asked first: opening a pipe would wait for a writer.
        let metadata = std::fs::metadata(path).map_err(RasterError::io("open", path))?;
        if !metadata.is_file() {
            let found = if metadata.is_dir() { "a folder" } else { "no regular file" };
            return Err(RasterError::not_supported(path, found, "a raster file"));
        }
        let file = File::open(path).map_err(RasterError::io("open", path))?;
        Ok(Self { file, path: path.to_owned(), len: metadata.len() })
    }

    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// The file's length in bytes.
    pub(crate) const fn len(&self) -> u64 {
        self.len
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
        let end = start.checked_add(count).filter(|&end| end <= self.len);
        let (Some(_), Ok(count)) = (end, usize::try_from(count)) else {
            return Err(RasterError::Truncated {
                path: self.path.clone(),
                what: what(),
                start,
                end: start.saturating_add(count),
                len: self.len,
            });
        };
        // Zeros are needed only where the buffer grows.
        bytes.resize(count, 0);
        read_exact_at(&self.file, bytes, start).map_err(RasterError::io("read", &self.path))
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

/// A small text file, such as a world file; `None` if there is none.
///
/// Bytes that are no UTF-8 become replacement characters.
pub(crate) fn read_text(path: &Path) -> Result<Option<String>, RasterError> {
    const MOST_BYTES: u64 = 1 << 20;
    let file = match File::open(path) {
        Ok(file) => file,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(RasterError::io("open", path)(error)),
    };
    let mut bytes = Vec::new();
    file.take(MOST_BYTES).read_to_end(&mut bytes).map_err(RasterError::io("read", path))?;
    Ok(Some(String::from_utf8_lossy(&bytes).into_owned()))
}
