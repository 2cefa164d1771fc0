//! Bytes in memory that lie in a file, too, and are sent from there.
//!
//! What a socket is given from the process's memory is copied. What it is given from a file is not: it refers to the
//! memory in which the system has that part of the file, which a page that was read of late still is. So an answer
//! carries bytes in memory, proven, and beside them where the archive has the same. The connection's writes know such
//! bytes by their address ([`Outbox`]) and let the system take them from the file. Where that is not as it was when
//! they were read, where a disk would have to be waited for, and on systems without `sendfile`, they are sent from
//! memory.

use std::fs::File;
use std::io::{self, IoSlice};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, ready};

use areoid_formats::archive::{Archive, PageEntry};
use tokio::io::Interest;
use tokio::net::TcpStream;

use system::State;

/// Fewer bytes than that are copied faster than they are found in a file.
const WORTH_FINDING: usize = 32 << 10;

/// Where a page's bytes were read from.
#[derive(Clone, Copy, Debug)]
pub(super) struct Origin {
    entry: PageEntry,
    /// The file's, before they were read.
    state: State,
}

/// A part of a file, from its start on.
#[derive(Clone, Debug)]
pub(super) struct Filed {
    file: Arc<File>,
    start: u64,
}

impl Origin {
    /// Of a page that is about to be read.
    pub(super) fn of(archive: &Archive, entry: PageEntry) -> Option<Self> {
        let (file, _) = archive.file_of(&entry)?;
        Some(Self { entry, state: system::state(&file)? })
    }

    /// Where its bytes are now, of which there are so many: if the file was not touched since, and if its first
    /// and last are in memory, and so most probably those between.
    pub(super) fn now(&self, archive: &Archive, count: usize) -> Option<Filed> {
        let (file, start) = archive.file_of(&self.entry).filter(|_| count >= WORTH_FINDING)?;
        let is_as_it_was = system::state(&file).as_ref() == Some(&self.state);
        let is_there = |offset| system::is_in_memory(&file, offset);
        let is_there = is_as_it_was && is_there(start) && is_there(start + count as u64 - 1);
        is_there.then_some(Filed { file, start })
    }
}

/// What a connection is sending that is filed, too.
///
/// # Threads
///
/// Any thread may call anything.
#[derive(Debug, Default)]
pub(super) struct Outbox(Mutex<Vec<Sending>>);

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
    fn all(&self) -> MutexGuard<'_, Vec<Sending>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// `bytes` are those of `filed`, and stay where they are as long as what is returned.
    pub(super) fn know(self: &Arc<Self>, bytes: &[u8], filed: Filed) -> Known {
        let (address, count) = (bytes.as_ptr().addr(), bytes.len());
        self.all().push(Sending { address, count, filed });
        Known { outbox: Arc::clone(self), address }
    }

    fn find(&self, bytes: &[u8]) -> Option<Filed> {
        let address = bytes.as_ptr().addr();
        self.all().iter().find_map(|sending| {
            let before = address.checked_sub(sending.address)?;
            let is_of_it = before.checked_add(bytes.len())? <= sending.count;
            let start = sending.filed.start + before as u64;
            is_of_it.then(|| Filed { file: Arc::clone(&sending.filed.file), start })
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
            let filed = self.find(part).and_then(|filed| {
                match system::send_file(stream, &filed.file, filed.start, part.len()) {
                    Err(error) if error.kind() == io::ErrorKind::WouldBlock => Some(Err(error)),
                    // It was cut, or is no file to send from: there are the bytes in memory.
                    Ok(0) | Err(_) => None,
                    sent => Some(sent),
                }
            });
            let sent =
                filed.unwrap_or_else(|| system::send(stream, part, number + 1 < parts.len()));
            match sent {
                Ok(sent) => {
                    all += sent;
                    if sent < part.len() {
                        break;
                    }
                }
                // What went before counts; why no more did is found at the next call.
                Err(_) if all > 0 => break,
                Err(error) => return Err(error),
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

    use rustix::fs::{fstat, sendfile};
    use rustix::io::{ReadWriteFlags, preadv2};
    use rustix::net::SendFlags;
    use tokio::net::TcpStream;

    /// Length, and when the content and anything else of the file was last changed.
    pub(super) type State = (i64, [i64; 2], [u64; 2]);

    pub(super) fn state(file: &File) -> Option<State> {
        let stat = fstat(file).ok()?;
        let nanoseconds = [stat.st_mtime_nsec, stat.st_ctime_nsec];
        Some((stat.st_size, [stat.st_mtime, stat.st_ctime], nanoseconds))
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

    use tokio::io::AsyncReadExt as _;
    use tokio::net::TcpListener;

    use super::*;

    const COUNT: usize = 300_000;
    const START: u64 = 1000;

    /// Sends `head`, and bytes in memory that are said to be those of `file`; what arrives.
    async fn sent(head: &[u8], memory: &[u8], file: File) -> Vec<u8> {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let reading = tokio::spawn(async move {
            let mut all = Vec::new();
            let mut client = TcpStream::connect(address).await.unwrap();
            client.read_to_end(&mut all).await.unwrap();
            all
        });
        let (stream, _) = listener.accept().await.unwrap();
        let outbox = Arc::new(Outbox::default());
        let known = outbox.know(memory, Filed { file: Arc::new(file), start: START });
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
        reading.await.unwrap()
    }

    fn file_of(bytes: &[u8]) -> File {
        let mut file = tempfile::tempfile().unwrap();
        file.write_all(&vec![0; usize::try_from(START).unwrap()]).unwrap();
        file.write_all(bytes).unwrap();
        file
    }

    /// The file has other bytes than memory, so that it shows which were sent.
    #[tokio::test]
    async fn what_is_known_is_sent_from_its_file() {
        let memory: Vec<u8> = (0..251).cycle().take(COUNT).collect();
        let other: Vec<u8> = memory.iter().map(|byte| !byte).collect();
        let arrived = sent(b"head", &memory, file_of(&other)).await;
        assert!(arrived == [b"head", &other[..]].concat());
    }

    #[tokio::test]
    async fn what_a_file_has_no_more_is_sent_from_memory() {
        let memory: Vec<u8> = (0..251).cycle().take(COUNT).collect();
        for left in [0, 1, COUNT / 2] {
            let arrived = sent(b"head", &memory, file_of(&memory[..left])).await;
            assert!(arrived == [b"head", &memory[..]].concat(), "{left}");
        }
        let closed = File::options().write(true).open("/dev/null").unwrap();
        assert!(sent(b"", &memory, closed).await == memory);
    }
}
