//! Answers: a body that is in memory or comes in pieces, errors in JSON, validators.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll};

use bytes::Bytes;
use hyper::body::{Body, Frame, SizeHint};
use hyper::header::{
    CACHE_CONTROL, CONTENT_LENGTH, CONTENT_TYPE, ETAG, HeaderMap, HeaderValue, IF_NONE_MATCH,
    RETRY_AFTER, WWW_AUTHENTICATE,
};
use hyper::{Response, StatusCode};
use serde_json::{Value, json};
use tokio::sync::{OwnedSemaphorePermit, mpsc};

/// For what never changes under its URL.
pub(super) const IMMUTABLE: HeaderValue =
    HeaderValue::from_static("public, max-age=31536000, immutable");
/// For what is to be asked for again, with its tag.
pub(super) const REVALIDATE: HeaderValue = HeaderValue::from_static("no-cache");

/// The body of an answer. It holds its request's place among those in flight.
#[derive(Debug)]
pub(super) struct Content {
    from: From,
    _permit: Option<OwnedSemaphorePermit>,
}

#[derive(Debug)]
enum From {
    Memory(Option<Bytes>),
    /// Pieces, and how many bytes are to come, if that is known.
    Pieces(mpsc::Receiver<io::Result<Bytes>>, Option<u64>),
}

pub(super) type Answer = Response<Content>;

impl Content {
    pub(super) fn whole(bytes: impl Into<Bytes>) -> Self {
        let bytes: Bytes = bytes.into();
        Self { from: From::Memory((!bytes.is_empty()).then_some(bytes)), _permit: None }
    }

    pub(super) fn pieces(pieces: mpsc::Receiver<io::Result<Bytes>>, length: Option<u64>) -> Self {
        Self { from: From::Pieces(pieces, length), _permit: None }
    }

    pub(super) fn holding(self, permit: OwnedSemaphorePermit) -> Self {
        Self { _permit: Some(permit), ..self }
    }

    fn length(&self) -> Option<u64> {
        match &self.from {
            From::Memory(bytes) => Some(bytes.as_ref().map_or(0, Bytes::len) as u64),
            From::Pieces(_, length) => *length,
        }
    }
}

impl Body for Content {
    type Data = Bytes;
    type Error = io::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<io::Result<Frame<Bytes>>>> {
        match &mut self.from {
            From::Memory(bytes) => Poll::Ready(bytes.take().map(|bytes| Ok(Frame::data(bytes)))),
            From::Pieces(pieces, length) => pieces.poll_recv(context).map(|piece| {
                let short = length.is_some_and(|left| left > 0);
                match piece {
                    None if short => Some(Err(io::ErrorKind::UnexpectedEof.into())),
                    None => None,
                    Some(piece) => {
                        if let (Ok(piece), Some(left)) = (&piece, length) {
                            *left = left.saturating_sub(piece.len() as u64);
                        }
                        Some(piece.map(Frame::data))
                    }
                }
            }),
        }
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
        if self.status == StatusCode::UNAUTHORIZED {
            answer.headers_mut().insert(WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
        }
        answer
    }
}

pub(super) fn not_found(what: impl std::fmt::Display) -> Answer {
    error(StatusCode::NOT_FOUND, what)
}

/// There is too much to do just now.
pub(super) fn overloaded() -> Answer {
    let mut answer = error(StatusCode::SERVICE_UNAVAILABLE, "too many requests are in flight");
    answer.headers_mut().insert(RETRY_AFTER, HeaderValue::from_static("1"));
    answer
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
