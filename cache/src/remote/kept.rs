//! An archive of a server as far as it is kept on the disk: what is missing is asked for and kept.
//!
//! ```text
//!   read ──▶ blocks on the disk ──▶ one range of those that are missing, by one thread ──▶ kept
//! ```

use std::io;
use std::sync::Arc;

use super::blocks::{BLOCK_BYTES, Blocks};
use super::claims::Claims;

/// Bytes asked for at a time.
pub(super) const RANGE_BYTES: u64 = 1 << 20;

/// See the module. Any thread may call anything; what several want at once is asked for once.
#[derive(Debug)]
pub(super) struct Kept {
    blocks: Arc<Blocks>,
    /// What the archive's blocks are called.
    key: String,
    /// Bytes of the archive.
    len: u64,
    claims: Claims,
}

/// Fills a buffer from an offset for as long as it is wanted.
pub(super) type Fetch<'a> = dyn Fn(&mut [u8], u64, &dyn Fn() -> bool) -> io::Result<()> + 'a;

impl Kept {
    /// An archive of `len` bytes.
    pub(super) fn new(blocks: Arc<Blocks>, key: String, len: u64) -> Self {
        Self { blocks, key, len, claims: Claims::default() }
    }

    /// Drops what is kept of `length` bytes from `offset`.
    pub(super) fn forget(&self, offset: u64, length: u64) {
        let last = offset.saturating_add(length).min(self.len).saturating_sub(1);
        for number in offset / BLOCK_BYTES..=last / BLOCK_BYTES {
            self.blocks.forget(&self.key, number);
        }
    }

    /// Drops all that is kept.
    pub(super) fn forget_all(&self) {
        self.blocks.forget_all(&self.key);
    }

    /// Where a block starts and ends.
    fn extent(&self, number: u64) -> (u64, u64) {
        let start = number * BLOCK_BYTES;
        (start, (start + BLOCK_BYTES).min(self.len))
    }

    /// Fills `buffer` from `offset`, both within the archive, for as long as it `is_wanted`: with what is kept,
    /// and what is fetched and kept from now on.
    ///
    /// # Errors
    ///
    /// [`given_up`](super::range::given_up), and those of `fetch`.
    pub(super) fn read(
        &self,
        buffer: &mut [u8],
        offset: u64,
        is_wanted: &dyn Fn() -> bool,
        fetch: &Fetch<'_>,
    ) -> io::Result<()> {
        let end = offset + buffer.len() as u64;
        let mut at = offset;
        while at < end {
            let number = at / BLOCK_BYTES;
            let (start, block_end) = self.extent(number);
            let length = length(start, block_end)?;
            if let Some(block) = self.blocks.read(&self.key, number, length) {
                at = copy(buffer, offset, &block, start, at);
                continue;
            }
            let behind = ((end - 1) / BLOCK_BYTES + 1).min(number + RANGE_BYTES / BLOCK_BYTES);
            let is_there = |number| self.blocks.has(&self.key, number);
            let Some(claim) = self.claims.claim(number..behind, is_there, is_wanted)? else {
                continue;
            };
            // It may have come between the look and the claim.
            if let Some(block) = self.blocks.read(&self.key, number, length) {
                at = copy(buffer, offset, &block, start, at);
                continue;
            }
            let (_, run_end) = self.extent(claim.numbers.end - 1);
            let mut run = vec![0; self::length(start, run_end)?];
            fetch(&mut run, start, &|| is_wanted() || claim.is_waited_for())?;
            let block_bytes = self::length(0, BLOCK_BYTES)?;
            for (number, block) in claim.numbers.clone().zip(run.chunks(block_bytes)) {
                self.blocks.write(&self.key, number, block);
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

#[cfg(test)]
mod tests {
    use std::ops::Range;
    use std::sync::Mutex;
    use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering::Relaxed};

    use shuttle::thread;

    use super::super::range::{given_up, is_given_up};
    use super::*;
    use crate::locks::model::{check, orders};

    const LEN: u64 = 5 * BLOCK_BYTES + 1000;

    /// What the archive has at a place.
    fn byte(at: u64) -> u8 {
        (at / 977 % 251) as u8
    }

    /// A server, and what it was asked for and has not been told to give up.
    #[derive(Default)]
    struct Server {
        asked: Mutex<Vec<Range<u64>>>,
        answers: AtomicUsize,
    }

    impl Server {
        fn fetch(
            &self,
            run: &mut [u8],
            start: u64,
            is_wanted: &dyn Fn() -> bool,
        ) -> io::Result<()> {
            let range = start..start + run.len() as u64;
            {
                let mut asked = self.asked.lock().unwrap();
                let is_apart = |of: &Range<u64>| range.end <= of.start || of.end <= range.start;
                assert!(asked.iter().all(is_apart), "{range:?} of {asked:?} is asked for twice");
                asked.push(range.clone());
            }
            let mut answer = Ok(());
            for _ in 0..3 {
                thread::yield_now();
                if !is_wanted() {
                    answer = Err(given_up());
                    break;
                }
            }
            if answer.is_err() {
                self.asked.lock().unwrap().retain(|asked| *asked != range);
            } else {
                run.iter_mut().zip(start..).for_each(|(to, at)| *to = byte(at));
                self.answers.fetch_add(1, Relaxed);
            }
            answer
        }
    }

    /// Several threads read what overlaps, and one gives up: nothing is asked for twice, unless it was given up,
    /// and all who go on get all of it.
    #[test]
    fn what_several_want_is_asked_for_once_in_any_order() {
        let [fewest, given_up] = [usize::MAX, 0].map(AtomicUsize::new).map(Arc::new);
        let (fewest_seen, given_up_seen) = (Arc::clone(&fewest), Arc::clone(&given_up));
        check(orders(800), move || {
            let folder = tempfile::tempdir().unwrap();
            let blocks = Arc::new(Blocks::open(folder.path(), 1 << 30).unwrap());
            let kept = Arc::new(Kept::new(blocks, "0123456789abcdef@here".to_owned(), LEN));
            let (server, bored) = (Arc::new(Server::default()), Arc::new(AtomicBool::new(false)));
            let reads =
                [(0..LEN, false), (100..BLOCK_BYTES * 3, true), (BLOCK_BYTES * 2..LEN, false)];
            let readers = reads.map(|(range, gives_up)| {
                let (kept, server, bored) =
                    (Arc::clone(&kept), Arc::clone(&server), Arc::clone(&bored));
                let count = Arc::clone(&given_up_seen);
                thread::spawn(move || {
                    let mut buffer = vec![0; length(range.start, range.end).unwrap()];
                    let is_wanted = || !gives_up || !bored.load(Relaxed);
                    let fetch = |run: &mut [u8], start, is_wanted: &dyn Fn() -> bool| {
                        server.fetch(run, start, is_wanted)
                    };
                    match kept.read(&mut buffer, range.start, &is_wanted, &fetch) {
                        Ok(()) => {
                            let is_right = |(at, &found): (u64, &u8)| found == byte(at);
                            assert!(range.zip(&buffer).all(is_right), "not what the server has");
                        }
                        Err(error) => {
                            assert!(gives_up && is_given_up(&error), "{error}");
                            count.fetch_add(1, Relaxed);
                        }
                    }
                })
            });
            for _ in 0..4 {
                thread::yield_now();
            }
            bored.store(true, Relaxed);
            for reader in readers {
                reader.join().unwrap();
            }
            fewest_seen.fetch_min(server.answers.load(Relaxed), Relaxed);
        });
        assert_eq!(fewest.load(Relaxed), 1, "all of it is one range");
        assert!(given_up.load(Relaxed) > 10, "{given_up:?}");
    }
}
