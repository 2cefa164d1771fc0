//! Connections: how many, how long, HTTP/1.1 or h2c, and their end.

use std::convert::Infallible;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use hyper::body::Incoming;
use hyper::server::conn::{http1, http2};
use hyper::service::service_fn;
use hyper::{Request, StatusCode};
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use tokio::io::AsyncWriteExt as _;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::{sleep, timeout};
use tracing::{debug, trace};

use super::answer::{self, Answer};
use super::filed::Outbox;
use super::hub::{Hub, stopped};
use super::lanes::{Counted, Handed, Lane};
use super::stream::Patient;
use super::watch::{Over, Watch};

/// What a connection may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Connections at a time; one more is told that there are too many.
    pub connections: usize,
    /// Requests at a time, each until its answer is sent.
    pub requests: usize,
    /// How long a request's header may take to come, idle time included.
    pub header: Duration,
    /// How long a client may take nothing of what is sent to it, or less than 256 KiB of it.
    pub stalled: Duration,
    /// Insertions at a time: one under way, and those that wait for it.
    pub insertions: usize,
    /// How long requests in flight have when the service is asked to end.
    pub drain: Duration,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            connections: 4096,
            requests: 1024,
            header: Duration::from_secs(30),
            stalled: Duration::from_secs(30),
            insertions: 16,
            drain: Duration::from_secs(10),
        }
    }
}

/// Bytes of a header, and of what is buffered of a connection.
const HEADER_BYTES: u32 = 32 << 10;
/// Headers of a request.
const HEADERS: usize = 64;
/// Requests at a time on one connection of HTTP/2.
const STREAMS: u32 = 64;
/// How long a client may take to hear that its connection ends.
const GOODBYE: Duration = Duration::from_secs(5);
/// How long to wait when the system has no descriptor left.
const BREATH: Duration = Duration::from_millis(50);
/// What a connection too many is told.
const REFUSAL: &[u8] = b"HTTP/1.1 503 Service Unavailable\r\nretry-after: 1\r\nconnection: close\r\ncontent-length: 0\r\n\r\n";

/// Takes connections until the service stops, for this thread's lane or another's; they end by themselves.
/// Each answers with `respond`.
pub(super) async fn accept<F, R>(
    listener: TcpListener,
    mut lane: Lane,
    hub: Arc<Hub>,
    places: Arc<Semaphore>,
    limits: Limits,
    respond: F,
) where
    F: Fn(Request<Incoming>, SocketAddr) -> R + Clone + Send + Sync + 'static,
    R: Future<Output = Answer> + Send + 'static,
{
    let mut stopping = hub.stopping.subscribe();
    loop {
        let accepted = tokio::select! {
            biased;
            () = stopped(&mut stopping) => return,
            Handed { stream, peer, place, counted } = lane.handed() => {
                if let Ok(stream) = TcpStream::from_std(stream) {
                    begin(stream, peer, (place, counted), &hub, limits, respond.clone());
                }
                continue;
            }
            accepted = listener.accept() => accepted,
        };
        let (stream, peer) = match accepted {
            Ok(accepted) => accepted,
            Err(error) => {
                // Without descriptors the next try fails as fast: those in use will be given back.
                hub.metrics.accept_errors.fetch_add(1, Relaxed);
                debug!(error = &error as &dyn std::error::Error, "connection not taken");
                sleep(BREATH).await;
                continue;
            }
        };
        let Ok(place) = Arc::clone(&places).try_acquire_owned() else {
            hub.metrics.refused.fetch_add(1, Relaxed);
            refuse(stream);
            continue;
        };
        let counted = lane.count();
        if lane.has(&counted) {
            begin(stream, peer, (place, counted), &hub, limits, respond.clone());
        } else {
            // If it is not taken any more, the service ends.
            lane.hand(stream, peer, place, counted);
        }
    }
}

/// Serves a connection on this thread.
fn begin<F, R>(
    stream: TcpStream,
    peer: SocketAddr,
    (place, counted): (OwnedSemaphorePermit, Counted),
    hub: &Arc<Hub>,
    limits: Limits,
    respond: F,
) where
    F: Fn(Request<Incoming>, SocketAddr) -> R + Clone + Send + Sync + 'static,
    R: Future<Output = Answer> + Send + 'static,
{
    let hub = Arc::clone(hub);
    tokio::spawn(async move {
        hub.metrics.connections.fetch_add(1, Relaxed);
        let respond = move |request| respond(request, peer);
        let ended = connection(stream, Arc::new(counted), &hub, limits, respond);
        if let Err(error) = ended.await {
            trace!(%peer, error, "connection ended");
        }
        hub.metrics.connections.fetch_sub(1, Relaxed);
        drop(place);
    });
}

/// Says that there are too many, if the client takes it at once.
fn refuse(stream: TcpStream) {
    // A fresh connection has room for so little.
    let _ = stream.try_write(REFUSAL);
}

async fn connection<F, R>(
    mut stream: TcpStream,
    counted: Arc<Counted>,
    hub: &Arc<Hub>,
    limits: Limits,
    respond: F,
) -> Result<(), String>
where
    F: Fn(Request<Incoming>) -> R + Clone + Send + 'static,
    R: Future<Output = Answer> + Send + 'static,
{
    stream.set_nodelay(true).map_err(|error| error.to_string())?;
    let mut stopping = hub.stopping.subscribe();
    let spoken = tokio::select! {
        spoken = timeout(limits.header, is_http2(&stream)) => spoken,
        () = stopped(&mut stopping) => return Ok(()),
    };
    let Ok(Some(is_http2)) = spoken else {
        // Nothing was asked.
        let _ = stream.shutdown().await;
        return Ok(());
    };
    let watch = Watch::new(limits.stalled);
    let watched = Arc::clone(&watch);
    // HTTP/2 sends small pieces.
    let counter = Arc::clone(&hub.metrics.filed_bytes);
    let outbox = (!is_http2).then(|| Outbox::new(Arc::clone(&counted), counter));
    let io = TokioIo::new(Patient::new(stream, limits.stalled, outbox.clone()));
    let service = service_fn(move |request| {
        let (asked, outbox) = (watched.request(), outbox.clone());
        let answer = (header_bytes(&request) <= HEADER_BYTES as usize).then(|| respond(request));
        async move {
            let answer = match answer {
                Some(answer) => answer.await,
                None => {
                    let reason = format!("the header has more than {HEADER_BYTES} bytes");
                    answer::error(StatusCode::REQUEST_HEADER_FIELDS_TOO_LARGE, reason)
                }
            };
            Ok::<_, Infallible>(answer.map(|content| content.watched(asked, outbox)))
        }
    });
    // HTTP/1.1 has a clock of its own for headers.
    let idle = is_http2.then_some(limits.header);
    // Both kinds of connection, told to end when the service stops or nothing is asked any more.
    macro_rules! serve {
        ($connection:expr) => {{
            let mut connection = std::pin::pin!($connection);
            let served = tokio::select! {
                served = connection.as_mut() => served,
                () = stopped(&mut stopping) => {
                    connection.as_mut().graceful_shutdown();
                    connection.await
                }
                over = watch.over(idle) => match over {
                    Over::Slow => return Err("what was sent was not taken".to_owned()),
                    Over::Idle => {
                        connection.as_mut().graceful_shutdown();
                        timeout(GOODBYE, connection).await.unwrap_or(Ok(()))
                    }
                }
            };
            served.map_err(|error| error.to_string())
        }};
    }
    if is_http2 {
        serve!(
            http2::Builder::new(TokioExecutor::new())
                .timer(TokioTimer::new())
                .max_concurrent_streams(STREAMS)
                .max_header_list_size(HEADER_BYTES)
                .keep_alive_interval(Some(limits.header))
                .keep_alive_timeout(limits.stalled)
                .serve_connection(io, service)
        )
    } else {
        serve!(
            http1::Builder::new()
                .timer(TokioTimer::new())
                .header_read_timeout(limits.header)
                .max_buf_size(HEADER_BYTES as usize)
                .max_headers(HEADERS)
                .serve_connection(io, service)
        )
    }
}

/// Bytes of a request's header, about as many as were sent. A connection reads more than it is to buffer if they
/// come at once.
fn header_bytes(request: &Request<Incoming>) -> usize {
    const BETWEEN: usize = ": \r\n".len();
    let line = request.uri().path_and_query().map_or(0, |path| path.as_str().len());
    let fields = request.headers().iter();
    fields.map(|(name, value)| name.as_str().len() + value.len() + BETWEEN).sum::<usize>() + line
}

/// Whether the client speaks HTTP/2 from its first bytes on; `None` if it says nothing.
async fn is_http2(stream: &TcpStream) -> Option<bool> {
    const PREFACE: &[u8] = b"PRI ";
    let mut first = [0; PREFACE.len()];
    loop {
        let count = stream.peek(&mut first).await.ok().filter(|&count| count > 0)?;
        if first[..count] != PREFACE[..count] {
            return Some(false);
        }
        if count == PREFACE.len() {
            return Some(true);
        }
        // Half of a preface is there, and `peek` would not wait for the rest.
        sleep(Duration::from_millis(5)).await;
    }
}
