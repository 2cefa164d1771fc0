//! The bytes of an archive on a server, read by ranges.
//!
//! ```text
//!   read ──▶ blocks on the disk ──▶ one range of those that are missing, by one thread ──▶ kept
//! ```

use std::collections::BTreeMap;
use std::fmt;
use std::io;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use areoid_formats::storage::ByteSource;

use super::blocks::{BLOCK_BYTES, Blocks, key};
use super::client::Client;
use super::range::{LOOK_EVERY, Ranges, given_up};

/// Bytes asked for at a time.
const RANGE_BYTES: u64 = 1 << 20;

/// An archive on a server: of one content, for ever.
///
/// # Threads
///
/// As [`ByteSource`] has it. What several want at once is asked for once where it is kept on the
/// disk. A read of a mebibyte takes at most four times the client's time-outs.
pub struct HttpSource {
    ranges: Ranges,
    len: u64,
    /// What its blocks are called.
    key: String,
    blocks: Option<Arc<Blocks>>,
    /// By number, the blocks that somebody is asking for, and when others last waited for them.
    asked: Mutex<BTreeMap<u64, Option<Instant>>>,
    answered: Condvar,
}

impl fmt::Debug for HttpSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("HttpSource")
            .field("url", &self.ranges.url())
            .field("len", &self.len)
            .finish_non_exhaustive()
    }
}

/// Blocks that one thread asks for: others wait for it. Given up when dropped.
struct Claim<'a> {
    source: &'a HttpSource,
    /// From the first up to and without the last.
    numbers: std::ops::Range<u64>,
}

impl Claim<'_> {
    /// Whoever waits says so more often.
    const WAITED: Duration = LOOK_EVERY.saturating_mul(5);

    fn is_waited_for(&self) -> bool {
        let asked = self.source.asked.lock().unwrap_or_else(PoisonError::into_inner);
        let mut waited = asked.range(self.numbers.clone()).filter_map(|(_, waited)| *waited);
        waited.any(|waited| waited.elapsed() < Self::WAITED)
    }
}

impl Drop for Claim<'_> {
    fn drop(&mut self) {
        let mut asked = self.source.asked.lock().unwrap_or_else(PoisonError::into_inner);
        asked.retain(|number, _| !self.numbers.contains(number));
        drop(asked);
        self.source.answered.notify_all();
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
        let ranges = Ranges::new(client, file, content);
        let (asked, answered) = (Mutex::default(), Condvar::new());
        Self { ranges, len, key, blocks, asked, answered }
    }

    /// Whether something is kept on the disk.
    pub(super) fn is_kept(&self) -> bool {
        self.blocks.is_some()
    }

    /// Drops what is kept of `length` bytes from `offset`.
    pub(super) fn forget(&self, offset: u64, length: u64) {
        if let Some(blocks) = &self.blocks {
            let last = offset.saturating_add(length).min(self.len).saturating_sub(1);
            for number in offset / BLOCK_BYTES..=last / BLOCK_BYTES {
                blocks.forget(&self.key, number);
            }
        }
    }

    /// Drops all that is kept.
    pub(super) fn forget_all(&self) {
        if let Some(blocks) = &self.blocks {
            blocks.forget_all(&self.key);
        }
    }

    /// Where a block starts and ends.
    fn extent(&self, number: u64) -> (u64, u64) {
        let start = number * BLOCK_BYTES;
        (start, (start + BLOCK_BYTES).min(self.len))
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
        if let Some(blocks) = &self.blocks {
            return self.read_blocks(blocks, buffer, offset, is_wanted);
        }
        let mut at = offset;
        for piece in buffer.chunks_mut(length(0, RANGE_BYTES)?) {
            self.ranges.read(piece, at, is_wanted)?;
            at += piece.len() as u64;
        }
        Ok(())
    }

    /// Claims the block and those behind it up to the one at `last` that are missing, too; `None` after
    /// somebody else has asked for it. That is waited for as long as it `is_wanted`.
    fn claim(
        &self,
        blocks: &Blocks,
        (number, last): (u64, u64),
        is_wanted: &dyn Fn() -> bool,
    ) -> io::Result<Option<Claim<'_>>> {
        let mut asked = self.asked.lock().unwrap_or_else(PoisonError::into_inner);
        if asked.contains_key(&number) {
            while let Some(waited) = asked.get_mut(&number) {
                *waited = Some(Instant::now());
                let again = self.answered.wait_timeout(asked, LOOK_EVERY);
                drop(again.unwrap_or_else(PoisonError::into_inner));
                if !is_wanted() {
                    return Err(given_up());
                }
                asked = self.asked.lock().unwrap_or_else(PoisonError::into_inner);
            }
            return Ok(None);
        }
        let most = last.min(number + RANGE_BYTES / BLOCK_BYTES - 1);
        let is_free = |next: &u64| !asked.contains_key(next) && !blocks.has(&self.key, *next);
        let behind = (number + 1..=most).take_while(is_free).last();
        let numbers = number..behind.unwrap_or(number) + 1;
        asked.extend(numbers.clone().map(|number| (number, None)));
        Ok(Some(Claim { source: self, numbers }))
    }

    /// Fills `buffer` from `offset`, through the blocks.
    fn read_blocks(
        &self,
        blocks: &Blocks,
        buffer: &mut [u8],
        offset: u64,
        is_wanted: &dyn Fn() -> bool,
    ) -> io::Result<()> {
        let end = offset + buffer.len() as u64;
        let mut at = offset;
        while at < end {
            let number = at / BLOCK_BYTES;
            let (start, block_end) = self.extent(number);
            let length = length(start, block_end)?;
            if let Some(block) = blocks.read(&self.key, number, length) {
                at = copy(buffer, offset, &block, start, at);
                continue;
            }
            let last = (end - 1) / BLOCK_BYTES;
            let Some(claim) = self.claim(blocks, (number, last), is_wanted)? else { continue };
            // It may have come between the look and the claim.
            if let Some(block) = blocks.read(&self.key, number, length) {
                at = copy(buffer, offset, &block, start, at);
                continue;
            }
            let (_, run_end) = self.extent(claim.numbers.end - 1);
            let mut run = vec![0; self::length(start, run_end)?];
            let is_wanted = || is_wanted() || claim.is_waited_for();
            self.ranges.read(&mut run, start, &is_wanted)?;
            let block_bytes = self::length(0, BLOCK_BYTES)?;
            for (number, block) in claim.numbers.clone().zip(run.chunks(block_bytes)) {
                blocks.write(&self.key, number, block);
            }
            at = copy(buffer, offset, &run, start, at);
        }
        Ok(())
    }
}

fn length(start: u64, end: u64) -> io::Result<usize> {
    usize::try_from(end - start).map_err(io::Error::other)
}

/// Copies what `bytes`, which start at `start`, have of `buffer`, which starts at `offset`, from `at` on,
/// and says up to where that is. `at` lies in both, where `bytes` are whole.
fn copy(buffer: &mut [u8], offset: u64, bytes: &[u8], start: u64, at: u64) -> u64 {
    let [skipped, done] = [at - start, at - offset]
        .map(|length| usize::try_from(length).expect("it lies in a buffer in memory"));
    let (from, to) = (&bytes[skipped..], &mut buffer[done..]);
    let count = from.len().min(to.len());
    to[..count].copy_from_slice(&from[..count]);
    at + count as u64
}

impl ByteSource for HttpSource {
    fn len(&self) -> u64 {
        self.len
    }

    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        self.read_while(buffer, offset, &|| true)
    }
}
