//! A server's word that its catalog has changed: a stream of server-sent events.
//!
//! What an event says is not taken for what there is: whoever hears one asks for the catalog.

use std::io;
use std::time::Duration;

use bytes::Bytes;
use http_body_util::{BodyExt as _, Empty};
use hyper::body::Incoming;
use hyper::client::conn::http1;
use hyper::header::{ACCEPT, HOST};
use hyper::{Request, StatusCode, Uri};
use hyper_util::rt::TokioIo;
use tokio::net::TcpStream;
use tokio::task::JoinSet;
use tokio::time::timeout;

use super::client::{ANSWER, CONNECT, Client, RemoteError};

/// A server says every 15 s that it is alive.
const SILENT: Duration = Duration::from_secs(40);

/// Bytes of the longest line.
const LINE_BYTES: usize = 64 << 10;

/// A stream of events. Dropped, it closes its connection.
#[derive(Debug)]
pub(crate) struct Events {
    url: String,
    body: Incoming,
    /// What serves the connection, ended with it.
    _connection: JoinSet<()>,
    lines: Lines,
}

impl Events {
    /// Asks for the events, and hears of all that come after that.
    ///
    /// # Cancel safety
    ///
    /// Dropping it closes the connection.
    ///
    /// # Errors
    ///
    /// [`RemoteError::Network`], or [`RemoteError::Refused`] if somebody answers without events.
    pub(crate) async fn connect(client: &Client) -> Result<Self, RemoteError> {
        let url = client.url("/v1/events");
        let failed = |source: io::Error| RemoteError::Network { url: url.clone(), source };
        let late = |_| failed(io::ErrorKind::TimedOut.into());
        let other = |error: hyper::Error| failed(io::Error::other(error));
        let uri: Uri = url.parse().map_err(|_| RemoteError::Url { url: url.clone() })?;
        let host = uri.host().ok_or_else(|| RemoteError::Url { url: url.clone() })?;
        let named = uri.port().map_or(host.to_owned(), |port| format!("{host}:{port}"));
        let address = (host.trim_matches(['[', ']']), uri.port_u16().unwrap_or(80));
        let stream = timeout(CONNECT, TcpStream::connect(address)).await.map_err(late)?;
        let stream = TokioIo::new(stream.map_err(failed)?);
        let (mut sender, connection) = http1::handshake(stream).await.map_err(other)?;
        let mut serving = JoinSet::new();
        serving.spawn(async move {
            // Whoever reads the body hears of it, too.
            let _ = connection.await;
        });
        let path = uri.path_and_query().map_or("/", |path| path.as_str());
        let request = Request::get(path).header(HOST, named).header(ACCEPT, "text/event-stream");
        let request = request.body(Empty::<Bytes>::new());
        let request = request.map_err(|error| failed(io::Error::other(error)))?;
        let answer = timeout(ANSWER, sender.send_request(request)).await.map_err(late)?;
        let answer = answer.map_err(other)?;
        if answer.status() != StatusCode::OK {
            let (status, reason) = (answer.status().as_u16(), "no events".to_owned());
            return Err(RemoteError::Refused { url, status, reason });
        }
        let body = answer.into_body();
        Ok(Self { url, body, _connection: serving, lines: Lines::default() })
    }

    /// Waits for the next event after which the catalog may be another.
    ///
    /// # Cancel safety
    ///
    /// No event is lost.
    ///
    /// # Errors
    ///
    /// [`RemoteError`] if the stream has ended, is silent for too long, or is none of events.
    pub(crate) async fn next(&mut self) -> Result<(), RemoteError> {
        loop {
            let frame = timeout(SILENT, self.body.frame()).await;
            let url = self.url.clone();
            let frame = match frame {
                Ok(Some(Ok(frame))) => frame,
                Ok(Some(Err(error))) => {
                    return Err(RemoteError::Network { url, source: io::Error::other(error) });
                }
                Ok(None) => {
                    let source = io::ErrorKind::UnexpectedEof.into();
                    return Err(RemoteError::Network { url, source });
                }
                Err(_) => {
                    let source = io::ErrorKind::TimedOut.into();
                    return Err(RemoteError::Network { url, source });
                }
            };
            let Some(data) = frame.data_ref() else { continue };
            match self.lines.read(data) {
                None => {
                    let reason = "a line does not end".to_owned();
                    return Err(RemoteError::Answer { url, reason });
                }
                Some(0) => {}
                Some(_) => return Ok(()),
            }
        }
    }
}

/// Lines of a stream of events, as they come.
#[derive(Debug, Default)]
struct Lines {
    line: Vec<u8>,
    /// Whether the event that is being read is one of those.
    counts: bool,
}

impl Lines {
    /// How many events that may change the catalog end in `bytes`; `None` if a line is too long.
    fn read(&mut self, bytes: &[u8]) -> Option<usize> {
        let mut events = 0;
        for piece in bytes.split_inclusive(|&byte| byte == b'\n') {
            let (piece, ends) =
                piece.strip_suffix(b"\n").map_or((piece, false), |piece| (piece, true));
            if self.line.len() + piece.len() > LINE_BYTES {
                return None;
            }
            self.line.extend_from_slice(piece);
            if !ends {
                continue;
            }
            let line = self.line.trim_ascii_end();
            if line.is_empty() {
                events += usize::from(self.counts);
                self.counts = false;
            } else if let Some(event) = line.strip_prefix(b"event:") {
                self.counts = matches!(
                    event.trim_ascii(),
                    b"hello" | b"inserted" | b"replaced" | b"removed" | b"missed"
                );
            }
            self.line.clear();
        }
        Some(events)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_are_counted_wherever_they_are_cut() {
        let text = b"event: hello\ndata: {}\n\n: alive\n\nid: 1\r\nevent: inserted\r\ndata: {\"a\": 1}\r\n\r\n\
            event: of another age\ndata: x\n\nevent:missed\ndata: {}\n\nevent: removed\n";
        for cut in 0..=text.len() {
            let mut lines = Lines::default();
            let (one, other) = text.split_at(cut);
            let events = lines.read(one).unwrap() + lines.read(other).unwrap();
            assert_eq!(events, 3, "cut at {cut}");
            assert_eq!(lines.read(b"\n"), Some(1), "the last one ends");
        }
    }

    #[test]
    fn a_line_without_end_takes_no_memory_without_end() {
        let mut lines = Lines::default();
        let pieces = (0..).take_while(|_| lines.read(&[b'x'; 1000]).is_some()).count();
        assert_eq!(pieces, LINE_BYTES / 1000);
        assert_eq!(Lines::default().read(&vec![b'x'; LINE_BYTES + 1]), None);
    }
}
