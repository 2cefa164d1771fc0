//! Pages as they are stored: read by position, proven by their checksum, kept in memory by bytes.

use std::str::FromStr;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Instant;

use areoid_formats::address::{Level, PageAddress};
use areoid_formats::archive::{Archive, ArchiveError, PageEntry, Payload};
use bytes::Bytes;
use hyper::header::{CONTENT_TYPE, HeaderMap, HeaderName, HeaderValue};
use hyper::{Response, StatusCode};
use tokio::task::spawn_blocking;
use tracing::debug;

use super::answer::{self, Answer, Content, IMMUTABLE, tag, tagged};
use super::filed::Origin;
use super::hub::Hub;
use super::snapshot::Served;
use crate::words::in_words;

/// A page in memory, and what its answers say.
#[derive(Debug)]
pub(super) struct StoredPage {
    headers: HeaderMap,
    tag: HeaderValue,
    bytes: Bytes,
    origin: Option<Origin>,
}

impl StoredPage {
    /// What a page takes beside its bytes: headers, and its place in the table.
    const OVERHEAD_BYTES: u64 = 2048;

    fn new(entry: &PageEntry, bytes: Vec<u8>, origin: Option<Origin>) -> Self {
        let mut headers = HeaderMap::new();
        let mut put = |name: &'static str, text: String| {
            let value = HeaderValue::try_from(text).expect("numbers are printable");
            headers.insert(HeaderName::from_static(name), value);
        };
        put("areoid-min", entry.min.to_string());
        put("areoid-max", entry.max.to_string());
        put("areoid-lowest", entry.lowest.to_string());
        put("areoid-highest", entry.highest.to_string());
        put("areoid-bound", entry.bound.to_string());
        put("areoid-source-error", entry.source_error.to_string());
        put("areoid-valid-fraction", entry.valid_fraction.to_string());
        put("areoid-full", entry.full.to_string());
        let tag = match entry.payload {
            Payload::Record { checksum, .. } => {
                put("areoid-checksum", format!("{checksum:016x}"));
                tag(format_args!("{checksum:016x}"))
            }
            Payload::Constant(texel) => {
                let texel = u32::from_le_bytes(texel.0).swap_bytes();
                put("areoid-constant", format!("{texel:08x}"));
                tag(format_args!("constant-{texel:08x}"))
            }
        };
        headers.insert(CONTENT_TYPE, HeaderValue::from_static("application/octet-stream"));
        Self { headers, tag, bytes: Bytes::from(bytes), origin }
    }

    pub(super) fn weight(&self) -> u64 {
        self.bytes.len() as u64 + Self::OVERHEAD_BYTES
    }

    fn answer(&self, hub: &Hub, archive: &Archive, asked: &HeaderMap) -> Answer {
        hub.metrics.bytes.fetch_add(self.bytes.len() as u64, Relaxed);
        let filed = self.origin.and_then(|origin| origin.filed(archive, self.bytes.len()));
        let mut answer = Response::new(Content::whole(self.bytes.clone()).filed(filed));
        *answer.headers_mut() = self.headers.clone();
        tagged(answer, asked, &self.tag, IMMUTABLE)
    }
}

/// Why there is no page.
#[derive(Debug, thiserror::Error)]
enum NoPage {
    #[error("no valid texel")]
    Empty,
    #[error(transparent)]
    Archive(#[from] ArchiveError),
    #[error("the reading was given up")]
    GivenUp,
}

/// `/v1/pages/{name}/{content}/{level}/{row}/{col}`
pub(super) async fn page(hub: &Arc<Hub>, path: [&str; 5], asked: &HeaderMap) -> Answer {
    let [name, content, level, row, col] = path;
    let served = hub.now().datasets.get(name).map(Arc::clone);
    let Some(served) = served.filter(|served| served.record.content == content) else {
        return answer::not_found(format_args!(
            "there is no {name} of content {content} (any more)"
        ));
    };
    let archive = match &served.archive {
        Ok(archive) => archive,
        Err(reason) => return answer::error(StatusCode::INTERNAL_SERVER_ERROR, reason),
    };
    let address = match (number(level), number(row), number(col)) {
        (Some(level), Some(row), Some(col)) => PageAddress { level: Level(level), row, col },
        _ => return answer::error(StatusCode::BAD_REQUEST, "level, row and column are numbers"),
    };
    if !archive.description().grid.pyramid().contains(address) {
        return answer::not_found(format_args!(
            "no page {name}/{level}/{row}/{col}: outside its level"
        ));
    }
    let key = (served.serial, address);
    if let Some(page) = hub.pages.get(&key) {
        hub.metrics.hits.fetch_add(1, Relaxed);
        return page.answer(hub, archive, asked);
    }
    if archive.find_resident(address) == Some(None) {
        return empty();
    }
    let read = hub.pages.get_or_insert_async(&key, read(hub, &served, address)).await;
    match read {
        Ok(page) => page.answer(hub, archive, asked),
        Err(NoPage::Empty) => empty(),
        Err(error) => {
            hub.metrics.damaged.fetch_add(1, Relaxed);
            debug!(page = %format_args!("{name}/{level}/{row}/{col}"), error = &error as &dyn std::error::Error, "page not read");
            let file = &served.record.file;
            let reason = format!("{name}/{level}/{row}/{col} of {file}: {}", in_words(&error));
            answer::error(StatusCode::INTERNAL_SERVER_ERROR, reason)
        }
    }
}

/// A number as it is printed: a page has one URL.
fn number<N: FromStr>(text: &str) -> Option<N> {
    let is_printed =
        text.bytes().all(|byte| byte.is_ascii_digit()) && (text == "0" || !text.starts_with('0'));
    text.parse().ok().filter(|_| is_printed)
}

fn empty() -> Answer {
    let mut answer = Response::new(Content::whole(Bytes::new()));
    *answer.status_mut() = StatusCode::NO_CONTENT;
    answer.headers_mut().insert(hyper::header::CACHE_CONTROL, IMMUTABLE);
    answer
}

/// Reads a page on a thread that may wait.
///
/// # Cancel safety
///
/// Dropped, the read comes to its end and is forgotten.
async fn read(
    hub: &Arc<Hub>,
    served: &Arc<Served>,
    page: PageAddress,
) -> Result<Arc<StoredPage>, NoPage> {
    let (counted, served) = (Arc::clone(hub), Arc::clone(served));
    hub.metrics.reading.fetch_add(1, Relaxed);
    let read = spawn_blocking(move || {
        let start = Instant::now();
        let found =
            served.archive.as_ref().map_or(Err(NoPage::GivenUp), |archive| stored(archive, page));
        let nanos = u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX);
        counted.metrics.read_nanos.fetch_add(nanos, Relaxed);
        counted.metrics.faults.fetch_add(1, Relaxed);
        counted.metrics.reading.fetch_sub(1, Relaxed);
        found
    });
    read.await.unwrap_or(Err(NoPage::GivenUp)).map(Arc::new)
}

fn stored(archive: &Archive, page: PageAddress) -> Result<StoredPage, NoPage> {
    let entry = archive.find(page)?.ok_or(NoPage::Empty)?;
    // What counts is read after the file was looked at; where that is not open, a read opens it.
    let (mut origin, mut bytes) = (Origin::of(archive, entry), archive.payload(&entry)?);
    if origin.is_none() && !bytes.is_empty() {
        origin = Origin::of(archive, entry);
        if origin.is_some() {
            bytes = archive.payload(&entry)?;
        }
    }
    Ok(StoredPage::new(&entry, bytes, origin))
}
