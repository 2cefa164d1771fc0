//! Bytes in memory that lie in a file, too, and are sent from there.
//!
//! What a socket is given from the process's memory is copied. What it is given from a file is not: it
//! refers to the memory in which the system has that part of the file, which a page that was read of late
//! still is. So an answer carries bytes in memory, proven, and beside them where the archive has the same.
//! The connection's writes know such bytes by their address ([`Outbox`]) and let the system take them from
//! the file. Where that is not what it was when they were read, where a disk would have to be waited for,
//! and where a system or its file system cannot tell, they are sent from memory.
//!
//! So they are to a thread's only connection. A copy costs as much as the many small pieces of a file, but its
//! bytes reach the client sooner. With several connections, copies push one another out of the processor's
//! caches.
//!
//! The file is looked at before each piece that is sent of it. What changes in it until the client's system
//! has the piece, and what a medium that is read anew makes of it without a change of its times, is the
//! client's to find: it has the checksum.

use std::fs::File;
use std::io::{self, IoSlice};
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard, Weak};
use std::task::{Context, Poll, ready};

use areoid_formats::archive::{Archive, PageEntry};
use tokio::io::Interest;
use tokio::net::TcpStream;

use super::lanes::Counted;
use crate::locks::lock;
use system::State;

/// Fewer bytes than that are copied faster than they are found in a file.
const WORTH_FINDING: usize = 32 << 10;

/// At most so many are sent from a file at a time: what lies between two bytes in memory most probably is,
/// too.
const PIECE: usize = 1 << 20;

/// Where a page's bytes were read from.
#[derive(Clone, Copy, Debug)]
pub(super) struct Origin {
    entry: PageEntry,
    /// The file's, before they were read.
    state: State,
}

/// A part of a file, from its start on. It keeps no file open.
#[derive(Clone, Debug)]
pub(super) struct Filed {
    file: Weak<File>,
    state: State,
    start: u64,
}

impl Origin {
    /// Of a page that is about to be read.
    pub(super) fn of(archive: &Archive, entry: PageEntry) -> Option<Self> {
        let (file, _) = archive.file_of(&entry)?;
        Some(Self { entry, state: system::state(&file)? })
    }

    /// Where its bytes are, of which there are so many, if it is worth to know that.
    pub(super) fn filed(&self, archive: &Archive, count: usize) -> Option<Filed> {
        if count < WORTH_FINDING {
            return None;
        }
        let (file, start) = archive.file_of(&self.entry)?;
        Some(Filed { file: Arc::downgrade(&file), state: self.state, start })
    }
}

impl Filed {
    /// Sends at most so many bytes, up to [`PIECE`], or none where they are better sent from memory.
    fn send(&self, stream: &TcpStream, count: usize) -> Option<usize> {
        let file = self.file.upgrade()?;
        let is_there = |offset| system::is_in_memory(&file, offset);
        // A file system that cannot tell is asked nothing else.
        let is_there = is_there(self.start) && is_there(self.start + count as u64 - 1);
        let is_as_it_was = is_there && system::state(&file).as_ref() == Some(&self.state);
        let sent = is_as_it_was.then(|| system::send_file(stream, &file, self.start, count))?;
        // A socket that is full says so again.
        sent.ok().filter(|&sent| sent > 0)
    }
}

/// What a connection is sending that is filed, too.
///
/// # Threads
///
/// Any thread may call anything.
#[derive(Debug)]
pub(super) struct Outbox {
    all: Mutex<Vec<Sending>>,
    /// The connection, among those of its thread.
    counted: Arc<Counted>,
    /// Bytes that were sent from files, of all connections.
    counter: Arc<AtomicU64>,
}

#[derive(Debug)]
struct Sending {
    /// The address of the first byte.
    address: usize,
    count: usize,
    filed: Filed,
}

/// Bytes that are known to a connection, until this is dropped.
#[derive(Debug)]
pub(super) struct Known {
    outbox: Arc<Outbox>,
    address: usize,
}

impl Outbox {
    /// Of a connection that begins.
    pub(super) fn new(counted: Arc<Counted>, counter: Arc<AtomicU64>) -> Arc<Self> {
        Arc::new(Self { all: Mutex::default(), counted, counter })
    }

    fn all(&self) -> MutexGuard<'_, Vec<Sending>> {
        lock(&self.all)
    }

    /// `bytes` are those of `filed`, and stay where they are as long as what is returned; nothing is where
    /// they are better sent from memory.
    pub(super) fn know(self: &Arc<Self>, bytes: &[u8], filed: Filed) -> Option<Known> {
        if self.counted.is_alone() {
            return None;
        }
        let (address, count) = (bytes.as_ptr().addr(), bytes.len());
        self.all().push(Sending { address, count, filed });
        Some(Known { outbox: Arc::clone(self), address })
    }

    fn find(&self, bytes: &[u8]) -> Option<Filed> {
        let address = bytes.as_ptr().addr();
        self.all().iter().find_map(|sending| {
            let before = address.checked_sub(sending.address)?;
            let is_of_it = before.checked_add(bytes.len())? <= sending.count;
            let start = sending.filed.start + before as u64;
            is_of_it.then(|| Filed { start, ..sending.filed.clone() })
        })
    }

    /// Writes to a socket as `AsyncWrite::poll_write_vectored` does, from files where it can.
    pub(super) fn poll_write(
        &self,
        stream: &TcpStream,
        context: &mut Context<'_>,
        parts: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        loop {
            ready!(stream.poll_write_ready(context))?;
            match stream.try_io(Interest::WRITABLE, || self.write(stream, parts)) {
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                written => return Poll::Ready(written),
            }
        }
    }

    /// How many bytes, from the first on, the socket has taken.
    fn write(&self, stream: &TcpStream, parts: &[IoSlice<'_>]) -> io::Result<usize> {
        let mut all = 0;
        for (number, part) in parts.iter().enumerate() {
            let has_more = number + 1 < parts.len();
            let mut rest: &[u8] = part;
            while !rest.is_empty() {
                let count = rest.len().min(PIECE);
                let sent = match self.find(rest).and_then(|filed| filed.send(stream, count)) {
                    Some(sent) => {
                        self.counter.fetch_add(sent as u64, Relaxed);
                        Ok(sent)
                    }
                    None => system::send(stream, rest, has_more),
                };
                match sent {
                    Ok(sent) => {
                        (all, rest) = (all + sent, &rest[sent..]);
                        if sent < count {
                            return Ok(all);
                        }
                    }
                    // What went before counts; why no more did is found at the next call.
                    Err(_) if all > 0 => return Ok(all),
                    Err(error) => return Err(error),
                }
            }
        }
        Ok(all)
    }

    /// Whether anything is being sent that is filed.
    pub(super) fn is_in_use(&self) -> bool {
        !self.all().is_empty()
    }
}

impl Drop for Known {
    fn drop(&mut self) {
        let mut all = self.outbox.all();
        // The same bytes may be sent twice over.
        if let Some(place) = all.iter().position(|sending| sending.address == self.address) {
            all.swap_remove(place);
        }
    }
}

#[cfg(target_os = "linux")]
mod system {
    use std::fs::File;
    use std::io::{self, IoSliceMut};
    use std::os::unix::fs::MetadataExt as _;

    use rustix::fs::sendfile;
    use rustix::io::{ReadWriteFlags, preadv2};
    use rustix::net::SendFlags;
    use tokio::net::TcpStream;

    /// Which file it is, its length, and when the content and anything else of it was last changed.
    pub(super) type State = ([u64; 3], [i64; 4]);

    pub(super) fn state(file: &File) -> Option<State> {
        let now = file.metadata().ok()?;
        let times = [now.mtime(), now.mtime_nsec(), now.ctime(), now.ctime_nsec()];
        Some(([now.dev(), now.ino(), now.size()], times))
    }

    /// Whether a byte can be read without waiting.
    pub(super) fn is_in_memory(file: &File, offset: u64) -> bool {
        let mut byte = [0];
        let mut buffers = [IoSliceMut::new(&mut byte)];
        preadv2(file, &mut buffers, offset, ReadWriteFlags::NOWAIT) == Ok(1)
    }

    pub(super) fn send(stream: &TcpStream, bytes: &[u8], has_more: bool) -> io::Result<usize> {
        let more = if has_more { SendFlags::MORE } else { SendFlags::empty() };
        let flags = more | SendFlags::NOSIGNAL | SendFlags::DONTWAIT;
        Ok(rustix::net::send(stream, bytes, flags)?)
    }

    pub(super) fn send_file(
        stream: &TcpStream,
        file: &File,
        mut start: u64,
        count: usize,
    ) -> io::Result<usize> {
        Ok(sendfile(stream, file, Some(&mut start), count)?)
    }
}

#[cfg(not(target_os = "linux"))]
mod system {
    use std::fs::File;
    use std::io;

    use tokio::net::TcpStream;

    #[derive(Clone, Copy, Debug, PartialEq)]
    pub(super) enum State {}

    pub(super) fn state(_: &File) -> Option<State> {
        None
    }

    pub(super) fn is_in_memory(_: &File, _: u64) -> bool {
        false
    }

    pub(super) fn send(stream: &TcpStream, bytes: &[u8], _: bool) -> io::Result<usize> {
        stream.try_write(bytes)
    }

    pub(super) fn send_file(_: &TcpStream, _: &File, _: u64, _: usize) -> io::Result<usize> {
        Err(io::ErrorKind::Unsupported.into())
    }
}

#[cfg(target_os = "linux")]
#[cfg(test)]
mod tests {
    use std::future::poll_fn;
    use std::io::Write as _;
    use std::os::unix::fs::FileExt as _;

    use tokio::io::AsyncReadExt as _;
    use tokio::net::TcpListener;

    use super::super::lanes::Lane;
    use super::*;

    const COUNT: usize = 300_000;
    const START: u64 = 1000;

    /// Sends `head`, and bytes in memory that are said to be those of `file`, to which something is done
    /// then; what arrives, and how many of its bytes came from the file.
    async fn sent(
        head: &[u8],
        memory: &[u8],
        file: File,
        then: impl FnOnce(&File),
    ) -> (Vec<u8>, usize) {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let reading = tokio::spawn(async move {
            let mut all = Vec::new();
            let mut client = TcpStream::connect(address).await.unwrap();
            client.read_to_end(&mut all).await.unwrap();
            all
        });
        let (stream, _) = listener.accept().await.unwrap();
        let counter = Arc::<AtomicU64>::default();
        let lane = Lane::all(1).remove(0);
        let (counted, _other) = (Arc::new(lane.count()), lane.count());
        let outbox = Outbox::new(counted, Arc::clone(&counter));
        let (state, file) = (system::state(&file).unwrap(), Arc::new(file));
        let filed = Filed { file: Arc::downgrade(&file), state, start: START };
        let known = outbox.know(memory, filed).unwrap();
        then(&file);
        let (mut head, mut body) = (head, memory);
        while !(head.is_empty() && body.is_empty()) {
            let parts = [IoSlice::new(head), IoSlice::new(body)];
            let parts = if head.is_empty() { &parts[1..] } else { &parts[..] };
            let count =
                poll_fn(|context| outbox.poll_write(&stream, context, parts)).await.unwrap();
            assert!(count > 0);
            let of_head = count.min(head.len());
            head = &head[of_head..];
            body = &body[count - of_head..];
        }
        assert!(outbox.is_in_use());
        drop(known);
        assert!(!outbox.is_in_use());
        drop(stream);
        (reading.await.unwrap(), usize::try_from(counter.load(Relaxed)).unwrap())
    }

    fn file_of(bytes: &[u8]) -> File {
        let mut file = tempfile::tempfile().unwrap();
        file.write_all(&vec![0; usize::try_from(START).unwrap()]).unwrap();
        file.write_all(bytes).unwrap();
        file
    }

    /// The file has other bytes than memory, so that it shows which were sent. All of it is in memory.
    #[tokio::test]
    async fn what_is_known_is_sent_from_its_file() {
        let memory: Vec<u8> = (0..251).cycle().take(COUNT).collect();
        let other: Vec<u8> = memory.iter().map(|byte| !byte).collect();
        let file = file_of(&other);
        if !system::is_in_memory(&file, START) {
            return;
        }
        let (arrived, from_file) = sent(b"head", &memory, file, |_| {}).await;
        assert!(arrived == [b"head", &other[..]].concat());
        assert_eq!(from_file, COUNT);
    }

    #[test]
    fn the_only_connection_of_a_thread_knows_of_no_file() {
        let memory = [7; COUNT];
        let file = Arc::new(file_of(&memory));
        let state = system::state(&file).unwrap();
        let filed = Filed { file: Arc::downgrade(&file), state, start: START };
        let lane = Lane::all(1).remove(0);
        let outbox = Outbox::new(Arc::new(lane.count()), Arc::default());
        assert!(outbox.know(&memory, filed.clone()).is_none() && !outbox.is_in_use());
        let other = lane.count();
        assert!(outbox.know(&memory, filed.clone()).is_some());
        drop(other);
        assert!(outbox.know(&memory, filed).is_none());
    }

    #[tokio::test]
    async fn what_a_file_has_no_more_is_sent_from_memory() {
        let memory: Vec<u8> = (0..251).cycle().take(COUNT).collect();
        for left in [0, 1, COUNT / 2] {
            let arrived = sent(b"head", &memory, file_of(&memory[..left]), |_| {}).await.0;
            assert!(arrived == [b"head", &memory[..]].concat(), "{left}");
        }
        let closed = File::options().write(true).open("/dev/null").unwrap();
        assert!(sent(b"", &memory, closed, |_| {}).await == (memory, 0));
    }

    #[tokio::test]
    async fn a_file_that_was_touched_is_not_sent_from() {
        let memory: Vec<u8> = (0..251).cycle().take(COUNT).collect();
        let other: Vec<u8> = memory.iter().map(|byte| !byte).collect();
        let touches: [fn(&File); 2] = [
            |file| file.write_all_at(b"x", START + 1000).unwrap(),
            |file| file.set_len(START + COUNT as u64 + 1).unwrap(),
        ];
        for touch in touches {
            assert!(sent(b"", &memory, file_of(&other), touch).await == (memory.clone(), 0));
        }
    }
}
