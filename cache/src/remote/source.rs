//! The bytes of an archive on a server, read by ranges.

use std::fmt;
use std::io;
use std::sync::Arc;

use areoid_formats::storage::ByteSource;

use super::blocks::{Blocks, key};
use super::client::Client;
use super::kept::{Kept, RANGE_BYTES};
use super::range::Ranges;

/// An archive on a server: of one content, for ever.
///
/// # Threads
///
/// As [`ByteSource`] has it. What several want at once is asked for once where it is kept on the
/// disk. A read of a mebibyte takes at most four times the client's time-outs.
pub struct HttpSource {
    ranges: Ranges,
    len: u64,
    kept: Option<Kept>,
}

impl fmt::Debug for HttpSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("HttpSource")
            .field("url", &self.ranges.url())
            .field("len", &self.len)
            .finish_non_exhaustive()
    }
}

impl HttpSource {
    /// The archive `file` of `len` bytes and `content`, as a server's catalog names it. Asks nothing yet.
    #[must_use]
    pub fn new(
        client: Client,
        file: &str,
        content: &str,
        len: u64,
        blocks: Option<Arc<Blocks>>,
    ) -> Self {
        let key = key(content, client.address());
        let kept = blocks.map(|blocks| Kept::new(blocks, key, len));
        Self { ranges: Ranges::new(client, file, content), len, kept }
    }

    /// What is kept on the disk, if anything is.
    pub(super) fn kept(&self) -> Option<&Kept> {
        self.kept.as_ref()
    }

    /// [`ByteSource::read_exact_at`], for as long as it `is_wanted`: its error
    /// [`is_given_up`](super::range::is_given_up) else.
    pub(super) fn read_while(
        &self,
        buffer: &mut [u8],
        offset: u64,
        is_wanted: &dyn Fn() -> bool,
    ) -> io::Result<()> {
        let end = offset.checked_add(buffer.len() as u64);
        if end.is_none_or(|end| end > self.len) {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        if let Some(kept) = &self.kept {
            let fetch = |run: &mut [u8], start, is_wanted: &dyn Fn() -> bool| {
                self.ranges.read(run, start, is_wanted)
            };
            return kept.read(buffer, offset, is_wanted, &fetch);
        }
        let mut at = offset;
        for piece in buffer.chunks_mut(usize::try_from(RANGE_BYTES).map_err(io::Error::other)?) {
            self.ranges.read(piece, at, is_wanted)?;
            at += piece.len() as u64;
        }
        Ok(())
    }
}

impl ByteSource for HttpSource {
    fn len(&self) -> u64 {
        self.len
    }

    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        self.read_while(buffer, offset, &|| true)
    }
}
