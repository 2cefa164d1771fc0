//! Answers: a body that is in memory or comes in pieces, errors in JSON, validators.

use std::io;
use std::ops::Range;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};

use bytes::{Buf, Bytes};
use hyper::body::{Body, Frame, SizeHint};
use hyper::header::{
    CACHE_CONTROL, CONTENT_LENGTH, CONTENT_TYPE, ETAG, HeaderMap, HeaderValue, IF_NONE_MATCH,
    RETRY_AFTER, WWW_AUTHENTICATE,
};
use hyper::{Response, StatusCode};
use serde_json::{Value, json};
use tokio::sync::{OwnedSemaphorePermit, mpsc};

use super::filed::{Filed, Known, Outbox};
use super::watch::{Asked, Waiting};

/// For what never changes under its URL.
pub(super) const IMMUTABLE: HeaderValue =
    HeaderValue::from_static("public, max-age=31536000, immutable");
/// For what is to be asked for again, with its tag.
pub(super) const REVALIDATE: HeaderValue = HeaderValue::from_static("no-cache");

/// The body of an answer. It holds its request's place among those in flight, and so do its pieces until
/// they are sent.
#[derive(Debug)]
pub(super) struct Content {
    from: From,
    permit: Option<Arc<OwnedSemaphorePermit>>,
    asked: Option<Arc<Asked>>,
    /// Where its bytes are, if they are in a file, too.
    filed: Option<Filed>,
    /// Of the connection, if it can send from files.
    outbox: Option<Arc<Outbox>>,
}

/// Bytes on their way to the client.
#[derive(Debug)]
pub(super) struct Piece {
    // Before the bytes, so that nothing is known of them when they are gone.
    _known: Option<Known>,
    bytes: Bytes,
    _waiting: Option<Waiting>,
    _permit: Option<Arc<OwnedSemaphorePermit>>,
    _asked: Option<Arc<Asked>>,
}

impl Buf for Piece {
    fn remaining(&self) -> usize {
        self.bytes.len()
    }

    fn chunk(&self) -> &[u8] {
        &self.bytes
    }

    fn advance(&mut self, count: usize) {
        self.bytes.advance(count);
    }
}

#[derive(Debug)]
enum From {
    Memory(Option<Bytes>),
    /// Pieces, and how many bytes are to come, if that is known.
    Pieces(mpsc::Receiver<io::Result<Bytes>>, Option<u64>),
}

pub(super) type Answer = Response<Content>;

impl Content {
    fn new(from: From) -> Self {
        Self { from, permit: None, asked: None, filed: None, outbox: None }
    }

    pub(super) fn whole(bytes: impl Into<Bytes>) -> Self {
        let bytes: Bytes = bytes.into();
        Self::new(From::Memory((!bytes.is_empty()).then_some(bytes)))
    }

    pub(super) fn pieces(pieces: mpsc::Receiver<io::Result<Bytes>>, length: Option<u64>) -> Self {
        Self::new(From::Pieces(pieces, length))
    }

    pub(super) fn holding(self, permit: OwnedSemaphorePermit) -> Self {
        Self { permit: Some(Arc::new(permit)), ..self }
    }

    /// Of bytes in memory that are in a file, too.
    pub(super) fn filed(self, filed: Option<Filed>) -> Self {
        Self { filed, ..self }
    }

    /// Of a request that its connection watches, and which that sends from files if it can.
    pub(super) fn watched(self, asked: Arc<Asked>, outbox: Option<Arc<Outbox>>) -> Self {
        Self { asked: Some(asked), outbox, ..self }
    }

    fn piece(&mut self, bytes: Bytes) -> Frame<Piece> {
        let filed = self.outbox.as_ref().zip(self.filed.take());
        Frame::data(Piece {
            _known: filed.and_then(|(outbox, filed)| outbox.know(&bytes, filed)),
            _waiting: self.asked.as_ref().map(|asked| asked.piece(bytes.len())),
            _permit: self.permit.clone(),
            _asked: self.asked.clone(),
            bytes,
        })
    }

    /// How many bytes it has, if they are in memory and there are any.
    pub(super) fn in_memory(&self) -> Option<u64> {
        self.length().filter(|_| matches!(self.from, From::Memory(Some(_))))
    }

    /// A part of what is in memory.
    pub(super) fn part(mut self, range: &Range<u64>) -> Self {
        if let From::Memory(Some(bytes)) = &mut self.from {
            let end =
                |end: u64| usize::try_from(end).map_or(bytes.len(), |end| end.min(bytes.len()));
            *bytes = bytes.slice(end(range.start)..end(range.end));
            // Files are known by all of their bytes.
            self.filed = None;
        }
        self
    }

    fn length(&self) -> Option<u64> {
        match &self.from {
            From::Memory(bytes) => Some(bytes.as_ref().map_or(0, Bytes::len) as u64),
            From::Pieces(_, length) => *length,
        }
    }
}

impl Body for Content {
    type Data = Piece;
    type Error = io::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<io::Result<Frame<Piece>>>> {
        let next = match &mut self.from {
            From::Memory(bytes) => Poll::Ready(bytes.take().map(Ok)),
            From::Pieces(pieces, length) => pieces.poll_recv(context).map(|piece| {
                let short = length.is_some_and(|left| left > 0);
                match piece {
                    None if short => Some(Err(io::ErrorKind::UnexpectedEof.into())),
                    None => None,
                    Some(piece) => {
                        if let (Ok(piece), Some(left)) = (&piece, length) {
                            *left = left.saturating_sub(piece.len() as u64);
                        }
                        Some(piece)
                    }
                }
            }),
        };
        next.map(|next| next.map(|piece| piece.map(|bytes| self.piece(bytes))))
    }

    fn is_end_stream(&self) -> bool {
        matches!(&self.from, From::Memory(None) | From::Pieces(_, Some(0)))
    }

    fn size_hint(&self) -> SizeHint {
        self.length().map_or_else(SizeHint::default, SizeHint::with_exact)
    }
}

/// An answer of some bytes.
pub(super) fn bytes(kind: &'static str, bytes: impl Into<Bytes>) -> Answer {
    let mut answer = Response::new(Content::whole(bytes));
    answer.headers_mut().insert(CONTENT_TYPE, HeaderValue::from_static(kind));
    answer
}

pub(super) fn value(value: &Value) -> Answer {
    bytes("application/json", value.to_string())
}

/// What went wrong, as `{"error": ..}`.
pub(super) fn error(status: StatusCode, reason: impl std::fmt::Display) -> Answer {
    let mut answer = value(&json!({ "error": reason.to_string() }));
    *answer.status_mut() = status;
    answer
}

/// Why a request is refused.
#[derive(Debug)]
pub(super) struct Refusal {
    status: StatusCode,
    reason: String,
}

impl Refusal {
    pub(super) fn new(status: StatusCode, reason: impl std::fmt::Display) -> Self {
        Self { status, reason: reason.to_string() }
    }

    pub(super) fn answer(self) -> Answer {
        let mut answer = error(self.status, self.reason);
        let more = match self.status {
            StatusCode::UNAUTHORIZED => Some((WWW_AUTHENTICATE, "Bearer")),
            StatusCode::SERVICE_UNAVAILABLE => Some((RETRY_AFTER, "1")),
            _ => None,
        };
        let more = more.map(|(name, value)| (name, HeaderValue::from_static(value)));
        answer.headers_mut().extend(more);
        answer
    }
}

pub(super) fn not_found(what: impl std::fmt::Display) -> Answer {
    error(StatusCode::NOT_FOUND, what)
}

/// There is too much to do just now.
pub(super) fn overloaded() -> Answer {
    Refusal::new(StatusCode::SERVICE_UNAVAILABLE, "too many requests are in flight").answer()
}

/// With a tag and how long it may be kept; without its body if whoever asks has it.
pub(super) fn tagged(
    mut answer: Answer,
    asked: &HeaderMap,
    tag: &HeaderValue,
    keep: HeaderValue,
) -> Answer {
    if is_known(asked, tag) {
        answer = Response::new(Content::whole(Bytes::new()));
        *answer.status_mut() = StatusCode::NOT_MODIFIED;
    }
    answer.headers_mut().insert(ETAG, tag.clone());
    answer.headers_mut().insert(CACHE_CONTROL, keep);
    answer
}

/// Whether `If-None-Match` names the tag.
pub(super) fn is_known(asked: &HeaderMap, tag: &HeaderValue) -> bool {
    let tag = tag.to_str().unwrap_or_default();
    asked.get_all(IF_NONE_MATCH).iter().filter_map(|value| value.to_str().ok()).any(|list| {
        list.split(',').map(str::trim).any(|one| one == "*" || one.trim_start_matches("W/") == tag)
    })
}

/// A strong tag. What is not printable is nobody's tag.
pub(super) fn tag(text: impl std::fmt::Display) -> HeaderValue {
    HeaderValue::try_from(format!("\"{text}\"")).unwrap_or(HeaderValue::from_static("\"\""))
}

/// The same answer without its body.
pub(super) fn head(answer: Answer) -> Answer {
    let (mut parts, content) = answer.into_parts();
    let has_length =
        parts.status != StatusCode::NO_CONTENT && parts.status != StatusCode::NOT_MODIFIED;
    if let Some(length) = content.length().filter(|_| has_length) {
        parts.headers.insert(CONTENT_LENGTH, HeaderValue::from(length));
    }
    Response::from_parts(parts, Content::whole(Bytes::new()))
}
