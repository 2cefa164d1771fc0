//! With files that are only memory, which Linux has.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, IoSlice};
use std::os::unix::fs::FileExt as _;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, PoisonError, RwLock};
use std::task::{Context, Poll};

use memmap2::{Mmap, MmapOptions};
use rustix::fs::{FallocateFlags, MemfdFlags, fallocate, memfd_create, sendfile};
use rustix::net::{SendFlags, send};
use tokio::io::Interest;
use tokio::net::TcpStream;

use bytes::Bytes;

use super::crowd::Crowd;

/// Shorter ones are copied as fast.
const LEAST_BYTES: usize = 32 << 10;

/// Ranges begin at multiples of that; no system has larger pages of memory that are not asked for.
const ALIGNED: u64 = 64 << 10;

thread_local! {
    static CROWD: Cell<Crowd> = const { Cell::new(Crowd::NONE) };
}

/// # Threads
///
/// Any thread may call anything.
#[derive(Debug)]
pub(in super::super) struct Shelf {
    shared: Option<Arc<Shared>>,
}

#[derive(Debug)]
struct Shared {
    file: File,
    /// Where the next range begins.
    next: AtomicU64,
    /// By the addresses that they are mapped to: lengths, and offsets in the file.
    ranges: RwLock<BTreeMap<usize, (usize, u64)>>,
}

impl Shelf {
    /// One that keeps nothing if the system has no such files.
    pub(in super::super) fn new() -> Self {
        let file = memfd_create("areoid-pages", MemfdFlags::CLOEXEC).ok();
        let shared = file.map(|file| Shared {
            file: File::from(file),
            next: AtomicU64::new(0),
            ranges: RwLock::default(),
        });
        Self { shared: shared.map(Arc::new) }
    }

    /// The same bytes, where they can be sent from; as they are if they are few or the system
    /// gives no place.
    pub(in super::super) fn put(&self, bytes: Vec<u8>) -> Bytes {
        let shelved = self.shared.as_ref().filter(|_| bytes.len() >= LEAST_BYTES);
        match shelved.map(|shared| Shelved::new(shared, &bytes)) {
            Some(Ok(shelved)) => Bytes::from_owner(shelved),
            Some(Err(_)) | None => Bytes::from(bytes),
        }
    }

    /// Writes what `parts` begin with, as much as the socket takes; `None` if the bytes at their end
    /// are better copied, or not kept here. `last` is the connection's own, 0 at first.
    pub(in super::super) fn poll_send(
        &self,
        socket: &TcpStream,
        context: &mut Context<'_>,
        parts: &[IoSlice<'_>],
        last: &mut u64,
    ) -> Option<Poll<io::Result<usize>>> {
        let (head, body) = match parts {
            [body] => (None, body),
            [head, body] => (Some(head), body),
            _ => return None,
        };
        if body.len() < LEAST_BYTES {
            return None;
        }
        let shared = self.shared.as_ref()?;
        let offset = shared.offset(body)?;
        let crowd = CROWD.get().count(last, body.len());
        CROWD.set(crowd);
        if crowd.is_large() {
            let write = || match head {
                // The body is asked for next: the system waits for it.
                Some(head) => send(socket, head, SendFlags::MORE),
                None => sendfile(socket, &shared.file, Some(&mut offset.clone()), body.len()),
            };
            return Some(poll_write(socket, context, || Ok(write()?)));
        }
        None
    }
}

fn poll_write(
    socket: &TcpStream,
    context: &mut Context<'_>,
    write: impl Fn() -> io::Result<usize>,
) -> Poll<io::Result<usize>> {
    loop {
        std::task::ready!(socket.poll_write_ready(context))?;
        match socket.try_io(Interest::WRITABLE, &write) {
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
            written => return Poll::Ready(written),
        }
    }
}

impl Shared {
    /// Where in the file `bytes` lie.
    fn offset(&self, bytes: &[u8]) -> Option<u64> {
        let address = bytes.as_ptr().addr();
        let ranges = self.ranges.read().unwrap_or_else(PoisonError::into_inner);
        let (start, (length, offset)) = ranges.range(..=address).next_back()?;
        let within = address - start;
        (within + bytes.len() <= *length).then_some(offset + within as u64)
    }
}

/// Bytes in the file. Its parts are let go of in this order: an address must not be found once it may
/// be another's.
struct Shelved {
    _found: Found,
    map: Mmap,
    _range: Range,
}

impl Shelved {
    fn new(shared: &Arc<Shared>, bytes: &[u8]) -> io::Result<Self> {
        let length = (bytes.len() as u64).next_multiple_of(ALIGNED);
        let offset = shared.next.fetch_add(length, Relaxed);
        let range = Range { offset, length, shared: Arc::clone(shared) };
        shared.file.write_all_at(bytes, offset)?;
        let mut options = MmapOptions::new();
        options.offset(offset).len(bytes.len());
        #[expect(unsafe_code, reason = "what the system is to send must lie in a file")]
        // SAFETY: nobody else has the file, and each range of it is written once, before it is mapped;
        // it is given back when its map is gone.
        let map = unsafe { options.map(&shared.file) }?;
        let address = map.as_ptr().addr();
        let mut ranges = shared.ranges.write().unwrap_or_else(PoisonError::into_inner);
        ranges.insert(address, (bytes.len(), offset));
        drop(ranges);
        let found = Found { address, shared: Arc::clone(shared) };
        Ok(Self { _found: found, map, _range: range })
    }
}

impl AsRef<[u8]> for Shelved {
    fn as_ref(&self) -> &[u8] {
        &self.map
    }
}

/// A place in the table.
struct Found {
    address: usize,
    shared: Arc<Shared>,
}

impl Drop for Found {
    fn drop(&mut self) {
        let mut ranges = self.shared.ranges.write().unwrap_or_else(PoisonError::into_inner);
        ranges.remove(&self.address);
    }
}

/// Memory that the file takes.
struct Range {
    offset: u64,
    length: u64,
    shared: Arc<Shared>,
}

impl Drop for Range {
    fn drop(&mut self) {
        let hole = FallocateFlags::PUNCH_HOLE | FallocateFlags::KEEP_SIZE;
        // If it stays, it is lost until the process ends: there is nothing else to be done.
        let _ = fallocate(&self.shared.file, hole, self.offset, self.length);
    }
}

#[cfg(test)]
mod tests {
    use std::io::{IoSlice, Read as _};

    use tokio::net::{TcpListener, TcpStream};

    use super::*;

    fn bytes(seed: u8, length: usize) -> Vec<u8> {
        (0..length).map(|place| (place * 31 / 7).to_le_bytes()[0] ^ seed).collect()
    }

    /// Sends `parts` until the socket has all of them; how many calls were the shelf's.
    async fn send(shelf: &Shelf, socket: &TcpStream, parts: [&[u8]; 2], crowd: &mut u64) -> usize {
        let (mut sent, mut by_shelf, all) = (0, 0, parts[0].len() + parts[1].len());
        while sent < all {
            let left = match sent.checked_sub(parts[0].len()) {
                Some(within) => vec![IoSlice::new(&parts[1][within..])],
                None => vec![IoSlice::new(&parts[0][sent..]), IoSlice::new(parts[1])],
            };
            let written = std::future::poll_fn(|context| {
                match shelf.poll_send(socket, context, &left, crowd) {
                    Some(sending) => sending.map(|written| Some(written.unwrap())),
                    None => Poll::Ready(None),
                }
            });
            match written.await {
                Some(written) => (sent, by_shelf) = (sent + written, by_shelf + 1),
                None => {
                    socket.writable().await.unwrap();
                    sent += socket.try_write_vectored(&left).unwrap_or(0);
                }
            }
        }
        by_shelf
    }

    #[tokio::test]
    async fn what_is_sent_is_what_was_kept_copied_or_not() {
        let shelf = Shelf::new();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let mut client = std::net::TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let (socket, _) = listener.accept().await.unwrap();
        let reading = std::thread::spawn(move || {
            let mut all = Vec::new();
            client.read_to_end(&mut all).unwrap();
            all
        });
        let (mut expected, mut by_shelf) = (Vec::new(), Vec::new());
        for round in 0..8 {
            let length = (1 << 20) - 4097 * usize::from(round);
            // Kept and dropped in turn: ranges come and go beside one another.
            let (kept, body) = (shelf.put(bytes(!round, 100_000)), shelf.put(bytes(round, length)));
            let crowded = (0..8).fold(Crowd::NONE, |crowd, _| crowd.count(&mut 0, 1 << 20));
            CROWD.set(if round % 2 == 1 { crowded } else { Crowd::NONE });
            by_shelf.push(send(&shelf, &socket, [b"head", &body], &mut 0).await > 0);
            drop(kept);
            expected.extend(b"head");
            expected.extend(bytes(round, length));
        }
        assert_eq!(by_shelf, [false, true].repeat(4));
        drop(socket);
        assert!(reading.join().unwrap() == expected);
    }

    #[test]
    fn what_is_dropped_takes_no_memory_and_is_not_found() {
        let shelf = Shelf::new();
        let shared = shelf.shared.as_ref().unwrap();
        let blocks = || std::os::unix::fs::MetadataExt::blocks(&shared.file.metadata().unwrap());
        let kept = [shelf.put(bytes(1, 1 << 20)), shelf.put(bytes(2, 1 << 20))];
        assert!(blocks() * 512 >= 2 << 20);
        let (part, whole) = (kept[1].slice(1000..), shared.offset(&kept[1]));
        assert_eq!(shared.offset(&part), whole.map(|offset| offset + 1000));
        assert_eq!(shared.offset(&bytes(2, 1 << 20)), None);
        drop(kept);
        assert!(blocks() * 512 < 2 << 20 && shared.offset(&part).is_some());
        drop(part);
        assert_eq!(blocks(), 0);
        assert!(shared.ranges.read().unwrap().is_empty());
    }
}
