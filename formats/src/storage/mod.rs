//! Where bytes come from: a file, a piece of memory, or whatever answers reads by position.

mod pool;

use std::fmt;
use std::fs::File;
use std::io;
use std::ops::Range;
use std::sync::Arc;

pub use pool::{Descriptors, PooledFile};

/// The bytes of one archive, read by position.
///
/// # Contract
///
/// * **Whole.** A read fills the buffer or fails: there are no short reads.
/// * **Shared.** Reads come from any thread, in any number, and do not disturb one another.
/// * **Blocking.** A read may wait for a disk: never call it from the thread that draws.
pub trait ByteSource: fmt::Debug + Send + Sync {
    /// Length in bytes when the source was opened.
    fn len(&self) -> u64;

    /// Whether there are no bytes at all.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Fills `buffer` from `offset`.
    ///
    /// # Errors
    ///
    /// [`io::ErrorKind::UnexpectedEof`] past the end, also if the medium was truncated since it
    /// was opened; or whatever the medium reports.
    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()>;

    /// Says that some bytes will probably be read soon: a medium that can may begin to fetch them. Whatever
    /// it does, it does not fail.
    fn advise(&self, range: Range<u64>) {
        let _ = range;
    }

    /// The file that has these bytes, from its first on, if there is one and it is open just now. What is
    /// read from it is what the medium holds by then.
    fn open_file(&self) -> Option<Arc<File>> {
        None
    }
}

/// A file read by position, without a cursor and without a map: a file truncated underneath ends
/// in an error, never in `SIGBUS`.
#[derive(Debug)]
pub struct FileSource {
    file: Arc<File>,
    len: u64,
}

impl FileSource {
    /// Reads `file`, which must be open for reading.
    ///
    /// # Errors
    ///
    /// If its length cannot be asked.
    pub fn new(file: File) -> io::Result<Self> {
        let len = file.metadata()?.len();
        Ok(Self { file: Arc::new(file), len })
    }
}

impl ByteSource for FileSource {
    fn len(&self) -> u64 {
        self.len
    }

    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        read_exact_at(&self.file, buffer, offset)
    }

    fn advise(&self, range: Range<u64>) {
        advise(&self.file, range);
    }

    fn open_file(&self) -> Option<Arc<File>> {
        Some(Arc::clone(&self.file))
    }
}

#[cfg(unix)]
fn read_exact_at(file: &File, buffer: &mut [u8], offset: u64) -> io::Result<()> {
    let end = offset.saturating_add(buffer.len() as u64);
    std::os::unix::fs::FileExt::read_exact_at(file, buffer, offset).map_err(|error| {
        match error.kind() {
            io::ErrorKind::UnexpectedEof => {
                io::Error::new(error.kind(), format!("the file ends before byte {end}"))
            }
            _ => error,
        }
    })
}

#[cfg(windows)]
fn read_exact_at(file: &File, mut buffer: &mut [u8], mut offset: u64) -> io::Result<()> {
    while !buffer.is_empty() {
        match std::os::windows::fs::FileExt::seek_read(file, buffer, offset)? {
            0 => return Err(io::ErrorKind::UnexpectedEof.into()),
            read => {
                buffer = &mut buffer[read..];
                offset += read as u64;
            }
        }
    }
    Ok(())
}

/// Begins to read ahead; it is advice, and what becomes of it is not asked.
#[cfg(any(target_os = "linux", target_os = "android"))]
fn advise(file: &File, range: Range<u64>) {
    // A length of 0 would mean all up to the end.
    if let Some(length) = std::num::NonZeroU64::new(range.end.saturating_sub(range.start)) {
        let _ = rustix::fs::fadvise(file, range.start, Some(length), rustix::fs::Advice::WillNeed);
    }
}

#[cfg(not(any(target_os = "linux", target_os = "android")))]
fn advise(_: &File, _: Range<u64>) {}

impl ByteSource for Vec<u8> {
    fn len(&self) -> u64 {
        self.as_slice().len() as u64
    }

    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        let bytes = usize::try_from(offset)
            .ok()
            .and_then(|start| self.get(start..start.checked_add(buffer.len())?));
        buffer.copy_from_slice(bytes.ok_or(io::ErrorKind::UnexpectedEof)?);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(source: &dyn ByteSource) {
        let mut buffer = [0; 3];
        source.read_exact_at(&mut buffer, 1).unwrap();
        assert_eq!(&buffer, b"bcd");
        source.read_exact_at(&mut [], 4).unwrap();
        for offset in [2, 4, 5, u64::MAX] {
            let error = source.read_exact_at(&mut buffer, offset).unwrap_err();
            let past =
                matches!(error.kind(), io::ErrorKind::UnexpectedEof | io::ErrorKind::InvalidInput);
            assert!(past, "{offset}: {error}");
        }
        assert_eq!((source.len(), source.is_empty()), (4, false));
        if let Some(file) = source.open_file() {
            let mut all = [0; 4];
            read_exact_at(&file, &mut all, 0).unwrap();
            assert_eq!(&all, b"abcd");
        }
    }

    #[test]
    fn every_source_keeps_the_contract() {
        check(&b"abcd".to_vec());
        let mut file = tempfile::tempfile().unwrap();
        io::Write::write_all(&mut file, b"abcd").unwrap();
        check(&FileSource::new(file).unwrap());
        let mut file = tempfile::NamedTempFile::new().unwrap();
        io::Write::write_all(&mut file, b"abcd").unwrap();
        check(&Descriptors::new(1).open(file.path()).unwrap());
    }

    /// What is not in memory is fetched because it was advised, without a read; where the system shows
    /// what it has in memory.
    #[cfg(target_os = "linux")]
    #[test]
    fn what_is_advised_is_fetched() {
        use std::io::IoSliceMut;
        use std::time::{Duration, Instant};

        use rustix::fs::{Advice, fadvise};
        use rustix::io::{Errno, ReadWriteFlags, preadv2};

        let mut file = tempfile::tempfile().unwrap();
        io::Write::write_all(&mut file, &vec![7; 1 << 20]).unwrap();
        file.sync_all().unwrap();
        let source = FileSource::new(file).unwrap();
        let at_once = |offset: u64| {
            let mut byte = [0];
            let mut buffers = [IoSliceMut::new(&mut byte)];
            preadv2(&*source.file, &mut buffers, offset, ReadWriteFlags::NOWAIT)
        };
        fadvise(&*source.file, 0, None, Advice::DontNeed).unwrap();
        let far = 700_000;
        if at_once(far) != Err(Errno::AGAIN) {
            return;
        }
        source.advise(0..0);
        assert_eq!(at_once(far), Err(Errno::AGAIN));
        source.advise(far..far + 100_000);
        let start = Instant::now();
        while at_once(far + 99_999).is_err() {
            assert!(start.elapsed() < Duration::from_secs(20), "nothing came");
            std::thread::yield_now();
        }
    }
}
