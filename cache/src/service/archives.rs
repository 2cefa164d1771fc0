//! Archives as files: ranges of their bytes, in pieces. What is read here is not proven: whoever reads
//! it has the checksums.

use std::io;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

use bytes::Bytes;
use hyper::header::{ACCEPT_RANGES, CONTENT_TYPE, HeaderMap, HeaderValue};
use hyper::{Method, Response, StatusCode};
use tokio::sync::mpsc;
use tokio::task::spawn_blocking;

use super::answer::{self, Answer, Content, IMMUTABLE, is_known, tag, tagged};
use super::hub::Hub;
use super::ranges::{partial, wanted};
use super::snapshot::Served;

/// Bytes read at a time; a slow client holds three of them.
const PIECE_BYTES: u64 = 256 << 10;

/// `/v1/archives/{file}`
pub(super) async fn archive(
    hub: &Arc<Hub>,
    file: &str,
    method: &Method,
    asked: &HeaderMap,
) -> Answer {
    let now = hub.now();
    // A file is called by its dataset's name, and by its content.
    let served = file.rsplit_once('-').and_then(|(name, _)| now.datasets.get(name));
    let Some(served) = served.filter(|served| served.record.file == file) else {
        return answer::not_found(format_args!("there is no {file} (any more)"));
    };
    let length = match &served.archive {
        Ok(archive) => archive.len(),
        Err(reason) => return answer::error(StatusCode::INTERNAL_SERVER_ERROR, reason),
    };
    let tag = tag(&served.record.content);
    // Only of a body that is to be sent.
    let is_sent = method == Method::GET && !is_known(asked, &tag);
    let wanted = match is_sent.then(|| wanted(asked, &tag, length)).transpose() {
        Ok(wanted) => wanted.flatten(),
        Err(unsatisfiable) => return unsatisfiable.answer(),
    };
    let range = wanted.clone().unwrap_or(0..length);
    let content = if !is_sent {
        Content::pieces(mpsc::channel(1).1, Some(range.end - range.start))
    } else {
        match first(served, range.clone()).await {
            Ok(piece) => rest(hub, served, range.clone(), piece),
            Err(error) => {
                hub.metrics.damaged.fetch_add(1, Relaxed);
                let reason = format!("cannot read {file}: {error}");
                return answer::error(StatusCode::INTERNAL_SERVER_ERROR, reason);
            }
        }
    };
    let mut answer = Response::new(content);
    let headers = answer.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static("application/octet-stream"));
    headers.insert(ACCEPT_RANGES, HeaderValue::from_static("bytes"));
    if let Some(range) = wanted {
        answer = partial(answer, &range, length);
    }
    tagged(answer, asked, &tag, IMMUTABLE)
}

fn piece(served: &Served, range: &Range<u64>) -> io::Result<Bytes> {
    let archive = served.archive.as_ref().map_err(|reason| io::Error::other(reason.clone()))?;
    let length =
        usize::try_from((range.end - range.start).min(PIECE_BYTES)).map_err(io::Error::other)?;
    let mut piece = vec![0; length];
    archive.source().read_exact_at(&mut piece, range.start)?;
    Ok(piece.into())
}

/// The first piece, so that a file that cannot be read is an error and not half an answer.
async fn first(served: &Arc<Served>, range: Range<u64>) -> io::Result<Bytes> {
    let served = Arc::clone(served);
    spawn_blocking(move || piece(&served, &range)).await.map_err(io::Error::other)?
}

/// The first piece and those behind it, each read when the one before last has been sent.
fn rest(hub: &Arc<Hub>, served: &Arc<Served>, range: Range<u64>, first: Bytes) -> Content {
    let length = range.end - range.start;
    hub.metrics.bytes.fetch_add(length, Relaxed);
    if first.len() as u64 == length {
        return Content::whole(first);
    }
    let (sender, pieces) = mpsc::channel(1);
    let served = Arc::clone(served);
    tokio::spawn(async move {
        let mut start = range.start + first.len() as u64;
        let mut next = Ok(first);
        loop {
            let failed = next.is_err();
            // Whoever asked may have gone.
            if sender.send(next).await.is_err() || failed || start >= range.end {
                return;
            }
            let (served, left) = (Arc::clone(&served), start..range.end);
            let read = spawn_blocking(move || piece(&served, &left)).await;
            next = read.map_err(io::Error::other).flatten();
            start += next.as_ref().map_or(0, |piece| piece.len() as u64);
        }
    });
    Content::pieces(pieces, Some(length))
}
