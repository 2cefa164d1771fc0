//! A connection that ends when its client does not take what is sent to it.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll, ready};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::time::{Instant, Sleep, sleep_until};

use super::filed::Outbox;

/// A stream whose writes fail when nothing could be written for a while.
///
/// Its end waits for the client's: a socket that is closed with requests unread in it is reset, and
/// answers that are still under way are lost.
#[derive(Debug)]
pub(super) struct Patient {
    stream: TcpStream,
    patience: Duration,
    /// What is to be sent from files, if it can be.
    outbox: Option<Arc<Outbox>>,
    /// Until when the write that waits may, or the end.
    waiting: Option<Pin<Box<Sleep>>>,
    is_ending: bool,
}

/// How long the client's end is waited for.
const LINGER: Duration = Duration::from_secs(5);

impl Patient {
    pub(super) fn new(stream: TcpStream, patience: Duration, outbox: Option<Arc<Outbox>>) -> Self {
        Self { stream, patience, outbox, waiting: None, is_ending: false }
    }

    fn judge<T>(
        &mut self,
        written: Poll<io::Result<T>>,
        context: &mut Context<'_>,
    ) -> Poll<io::Result<T>> {
        if written.is_ready() {
            self.waiting = None;
            return written;
        }
        let patience = self.patience;
        let waiting =
            self.waiting.get_or_insert_with(|| Box::pin(sleep_until(Instant::now() + patience)));
        ready!(waiting.as_mut().poll(context));
        Poll::Ready(Err(io::ErrorKind::TimedOut.into()))
    }
}

impl AsyncRead for Patient {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, buffer)
    }
}

impl AsyncWrite for Patient {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.judge(written, context)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        parts: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let this = &mut *self;
        let written = match &this.outbox {
            Some(outbox) if outbox.is_in_use() => outbox.poll_write(&this.stream, context, parts),
            _ => Pin::new(&mut this.stream).poll_write_vectored(context, parts),
        };
        self.judge(written, context)
    }

    fn is_write_vectored(&self) -> bool {
        true
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let flushed = Pin::new(&mut self.stream).poll_flush(context);
        self.judge(flushed, context)
    }

    fn poll_shutdown(self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let Self { stream, waiting, is_ending, .. } = self.get_mut();
        if !*is_ending {
            ready!(Pin::new(&mut *stream).poll_shutdown(context))?;
            *is_ending = true;
            *waiting = Some(Box::pin(sleep_until(Instant::now() + LINGER)));
        }
        loop {
            let mut unread = [0; 4096];
            let mut unread = ReadBuf::new(&mut unread);
            match Pin::new(&mut *stream).poll_read(context, &mut unread) {
                Poll::Ready(Ok(())) if !unread.filled().is_empty() => {}
                // It has ended, one way or another.
                Poll::Ready(_) => return Poll::Ready(Ok(())),
                Poll::Pending => break,
            }
        }
        waiting.as_mut().map_or(Poll::Ready(Ok(())), |end| end.as_mut().poll(context).map(Ok))
    }
}
