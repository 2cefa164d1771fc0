//! The bytes of an archive on a server, read by ranges.
//!
//! ```text
//!   read ──▶ blocks of the disk cache ──▶ one range of all that is missing ──▶ retried, in bounded time
//! ```

use std::fmt;
use std::io::{self, Read as _};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use areoid_formats::storage::ByteSource;

use super::blocks::{BLOCK_BYTES, Blocks};
use super::client::Client;

/// How often a read is tried, with waits of 0.1, 0.2 and 0.4 s between.
const TRIES: u32 = 4;
const FIRST_WAIT: Duration = Duration::from_millis(100);
/// How long reads fail at once after one that failed: a vanished network is not asked by every page.
const SILENCE: Duration = Duration::from_secs(1);
/// Bytes asked for at a time.
const RANGE_BYTES: u64 = 8 << 20;

/// An archive on a server: of one content, for ever.
///
/// # Threads
///
/// As [`ByteSource`] has it. A read takes at most four times the client's time-outs.
pub struct HttpSource {
    client: Client,
    url: String,
    len: u64,
    blocks: Option<Arc<Blocks>>,
    content: String,
    /// What went wrong last, until when it is believed.
    silent: Mutex<Option<(Instant, String)>>,
}

impl fmt::Debug for HttpSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("HttpSource")
            .field("url", &self.url)
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
        let url = client.url(&format!("/v1/archives/{file}"));
        Self { client, url, len, blocks, content: content.to_owned(), silent: Mutex::new(None) }
    }

    /// Bytes from `start` to `end`, from the server.
    fn fetch(&self, start: u64, end: u64) -> io::Result<Vec<u8>> {
        let mut silent = self.silent.lock().unwrap_or_else(PoisonError::into_inner).clone();
        if let Some((_, reason)) = silent.take_if(|(until, _)| Instant::now() < *until) {
            return Err(io::Error::new(io::ErrorKind::NotConnected, reason));
        }
        let mut wait = FIRST_WAIT;
        for attempt in 1.. {
            match self.try_fetch(start, end) {
                Ok(bytes) => return Ok(bytes),
                Err(error) if attempt == TRIES || error.kind() == io::ErrorKind::NotFound => {
                    let error = io::Error::new(error.kind(), format!("{}: {error}", self.url));
                    let believed = Some((Instant::now() + SILENCE, error.to_string()));
                    *self.silent.lock().unwrap_or_else(PoisonError::into_inner) = believed;
                    return Err(error);
                }
                Err(_) => thread::sleep(wait),
            }
            wait *= 2;
        }
        unreachable!("the last try returns")
    }

    fn try_fetch(&self, start: u64, end: u64) -> io::Result<Vec<u8>> {
        let asked = self.client.agent().get(&self.url);
        let asked = asked.header("range", format!("bytes={start}-{}", end - 1));
        let answer = asked.call().map_err(ureq::Error::into_io)?;
        match answer.status().as_u16() {
            206 => {}
            404 => {
                return Err(io::Error::new(io::ErrorKind::NotFound, "the server has it no more"));
            }
            status => return Err(io::Error::other(format!("the server answers {status}"))),
        }
        let tag = answer.headers().get("etag").and_then(|tag| tag.to_str().ok());
        if tag.map(|tag| tag.trim_matches('"')) != Some(self.content.as_str()) {
            return Err(io::Error::new(io::ErrorKind::InvalidData, "another archive answers"));
        }
        let length = usize::try_from(end - start).map_err(io::Error::other)?;
        let mut bytes = Vec::with_capacity(length);
        // One more is asked for: a connection is kept when the end of its answer was seen.
        answer.into_body().into_reader().take(end - start + 1).read_to_end(&mut bytes)?;
        if bytes.len() != length {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        Ok(bytes)
    }

    /// The block of a number, from the disk or the server.
    fn block(&self, blocks: &Blocks, number: u64) -> io::Result<Vec<u8>> {
        if let Some(bytes) = blocks.read(&self.content, number) {
            return Ok(bytes);
        }
        let start = number * BLOCK_BYTES;
        let bytes = self.fetch(start, (start + BLOCK_BYTES).min(self.len))?;
        blocks.write(&self.content, number, &bytes);
        Ok(bytes)
    }
}

impl ByteSource for HttpSource {
    fn len(&self) -> u64 {
        self.len
    }

    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        let end = offset.checked_add(buffer.len() as u64).filter(|&end| end <= self.len);
        let end = end.ok_or(io::ErrorKind::UnexpectedEof)?;
        let mut at = offset;
        let mut left = buffer;
        while at < end {
            let bytes = match &self.blocks {
                Some(blocks) => {
                    let number = at / BLOCK_BYTES;
                    let block = self.block(blocks, number)?;
                    let skipped =
                        usize::try_from(at - number * BLOCK_BYTES).map_err(io::Error::other)?;
                    block.get(skipped..).ok_or(io::ErrorKind::UnexpectedEof)?.to_vec()
                }
                None => self.fetch(at, end.min(at + RANGE_BYTES))?,
            };
            let count = bytes.len().min(left.len());
            let (now, later) = left.split_at_mut(count);
            now.copy_from_slice(&bytes[..count]);
            (left, at) = (later, at + count as u64);
        }
        Ok(())
    }
}
