//! What anybody may ask: the public listener's requests.

use std::error::Error;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use areoid_formats::archive::Archive;
use areoid_formats::geodesy::Geographic;
use areoid_formats::query::HeightQuery;
use areoid_formats::units::Degrees;
use bytes::Bytes;
use hyper::body::Incoming;
use hyper::header::{ALLOW, CACHE_CONTROL, HeaderValue};
use hyper::{Method, Request, StatusCode};
use serde_json::{Value, json};
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::mpsc;
use tokio::task::spawn_blocking;
use tokio::time::timeout;
use xxhash_rust::xxh3::xxh3_64;

use super::answer::{self, Answer, Content, REVALIDATE, Refusal, tag, tagged};
use super::hub::{Hub, stopped};
use super::{archives, pages, ranges};
use crate::words::in_words;

/// Answers a request, or says at once that there are too many.
///
/// # Cancel safety
///
/// Dropped when the client goes: reads under way come to their end and are forgotten.
pub(super) async fn answer(hub: Arc<Hub>, request: Request<Incoming>) -> Answer {
    hub.metrics.requests.fetch_add(1, Relaxed);
    let Ok(permit) = Arc::clone(&hub.in_flight).try_acquire_owned() else {
        hub.metrics.refused.fetch_add(1, Relaxed);
        return answer::overloaded();
    };
    let is_head = request.method() == Method::HEAD;
    let answer = if is_head || request.method() == Method::GET {
        let answer = route(&hub, &request).await;
        if is_head { answer } else { ranges::cut(answer, request.headers()) }
    } else {
        let mut answer =
            answer::error(StatusCode::METHOD_NOT_ALLOWED, "this listener is read-only");
        answer.headers_mut().insert(ALLOW, HeaderValue::from_static("GET, HEAD"));
        answer
    };
    if answer.status().is_server_error() {
        hub.metrics.failed.fetch_add(1, Relaxed);
    }
    let answer = if is_head { answer::head(answer) } else { answer };
    // Streams of events last as long as their clients, and are counted by themselves.
    if request.uri().path() == EVENTS {
        return answer;
    }
    answer.map(|content| content.holding(permit))
}

const EVENTS: &str = "/v1/events";

async fn route(hub: &Arc<Hub>, request: &Request<Incoming>) -> Answer {
    let (path, asked) = (request.uri().path(), request.headers());
    let Some(path) = path.strip_prefix("/v1/") else { return answer::not_found("nothing is here") };
    let mut parts = [""; 6];
    let mut count = 0;
    for part in path.split('/') {
        let Some(place) = parts.get_mut(count) else { return answer::not_found("nothing is here") };
        (*place, count) = (part, count + 1);
    }
    match &parts[..count] {
        ["pages", page @ ..] if page.len() == 5 => {
            pages::page(hub, [page[0], page[1], page[2], page[3], page[4]], asked).await
        }
        ["archives", file] => archives::archive(hub, file, request.method(), asked).await,
        ["catalog"] => {
            let now = hub.now();
            let answer = answer::bytes("application/json", now.json.clone());
            tagged(answer, asked, &now.tag, REVALIDATE)
        }
        ["datasets", name] => match hub.now().datasets.get(*name) {
            Some(served) => {
                let text = served.json.to_string();
                let tag = tag(format_args!("{:016x}", xxh3_64(text.as_bytes())));
                tagged(answer::bytes("application/json", text), asked, &tag, REVALIDATE)
            }
            None => answer::not_found(format_args!("no dataset is called {name:?}")),
        },
        ["events"] if request.method() == Method::HEAD => {
            answer::bytes("text/event-stream", Bytes::new())
        }
        ["events"] => events(hub),
        ["height"] => {
            let found = height(hub, request.uri().query().unwrap_or_default()).await;
            found.map_or_else(Refusal::answer, |found| {
                let text = found.to_string();
                let tag = tag(format_args!("{:016x}", xxh3_64(text.as_bytes())));
                tagged(answer::bytes("application/json", text), asked, &tag, REVALIDATE)
            })
        }
        _ => answer::not_found("nothing is here"),
    }
}

/// How often a silent stream of events says that it is alive.
const HEART_BEAT: Duration = Duration::from_secs(15);

/// `/v1/events`
fn events(hub: &Arc<Hub>) -> Answer {
    let Ok(place) = Arc::clone(&hub.listeners).try_acquire_owned() else {
        hub.metrics.refused.fetch_add(1, Relaxed);
        return answer::overloaded();
    };
    let (sender, pieces) = mpsc::channel(4);
    let mut events = hub.events.subscribe();
    let mut stopping = hub.stopping.subscribe();
    let hello =
        format!("event: hello\ndata: {}\n\n", json!({ "generation": hub.now().generation }));
    tokio::spawn(async move {
        let (_place, mut next) = (place, Bytes::from(hello));
        loop {
            if sender.send(Ok(next)).await.is_err() {
                return;
            }
            next = tokio::select! {
                () = stopped(&mut stopping) => return,
                () = sender.closed() => return,
                event = timeout(HEART_BEAT, events.recv()) => match event {
                    Err(_) => Bytes::from_static(b": alive\n\n"),
                    Ok(Ok(event)) => Bytes::copy_from_slice(event.as_bytes()),
                    Ok(Err(RecvError::Lagged(_))) => Bytes::from_static(b"event: missed\ndata: {}\n\n"),
                    Ok(Err(RecvError::Closed)) => return,
                },
            };
        }
    });
    let mut answer = hyper::Response::new(Content::pieces(pieces, None));
    let headers = answer.headers_mut();
    headers.insert(hyper::header::CONTENT_TYPE, HeaderValue::from_static("text/event-stream"));
    headers.insert(CACHE_CONTROL, HeaderValue::from_static("no-store"));
    answer
}

/// How long a height may wait for others.
const PATIENCE: Duration = Duration::from_millis(500);

/// `/v1/height?lon=..&lat=..`
///
/// # Cancel safety
///
/// Dropped while it waits for others, nothing is looked up; later, that comes to its end and is forgotten.
async fn height(hub: &Arc<Hub>, query: &str) -> Result<Value, Refusal> {
    let refused = |reason| Refusal::new(StatusCode::BAD_REQUEST, reason);
    let number = |name: &str| {
        let value = query.split('&').find_map(|pair| pair.strip_prefix(name)?.strip_prefix('='));
        value.and_then(|value| value.parse::<f64>().ok()).filter(|value| value.is_finite())
    };
    let (Some(lon), Some(lat)) = (number("lon"), number("lat")) else {
        return Err(refused("expected ?lon=DEGREES&lat=DEGREES"));
    };
    if !(-90.0..=90.0).contains(&lat) {
        return Err(refused("latitudes are -90 to 90"));
    }
    let too_many = || {
        hub.metrics.refused.fetch_add(1, Relaxed);
        Refusal::new(StatusCode::SERVICE_UNAVAILABLE, "too many heights are looked up")
    };
    let _asked = hub.heights_asked.try_acquire().map_err(|_| too_many())?;
    let place = timeout(PATIENCE, Arc::clone(&hub.heights).acquire_owned()).await;
    let Ok(Ok(place)) = place else { return Err(too_many()) };
    let now = hub.now();
    let found = spawn_blocking(move || {
        let _place = place;
        let position = Geographic::from_degrees(Degrees(lon % 360.0), Degrees(lat));
        let served: Vec<_> =
            now.datasets.values().filter(|served| served.archive.is_ok()).collect();
        let archives = served.iter().filter_map(|served| served.archive.as_ref().ok());
        let archives: Vec<&Archive> = archives.collect();
        let found = HeightQuery::new(archives, None).height(position)?;
        let name = |&place: &usize| served[place].record.name.clone();
        Ok::<_, areoid_formats::archive::ArchiveError>(json!({
            "lon": lon,
            "lat": lat,
            "height_m": found.as_ref().map(|found| found.height_m),
            "bound_m": found.as_ref().map(|found| found.bound_m),
            "datasets": found.iter().flat_map(|found| &found.datasets).map(name).collect::<Vec<_>>(),
        }))
    });
    let failed =
        |reason: &dyn Error| Refusal::new(StatusCode::INTERNAL_SERVER_ERROR, in_words(reason));
    found.await.map_err(|error| failed(&error))?.map_err(|error| failed(&error))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::Limits;
    use crate::tests::globe_in_a_catalog;

    #[tokio::test(start_paused = true)]
    async fn heights_that_wait_too_long_and_listeners_too_many_are_told_so() {
        let folder = globe_in_a_catalog();
        let hub = Hub::open(folder.path(), 1 << 20, Limits { connections: 2, ..Limits::default() });
        let hub = Arc::new(hub.unwrap());
        let ask = || height(&hub, "lon=10&lat=20");
        let found = ask().await.unwrap();
        assert!(found["height_m"].is_number(), "{found}");
        let all = u32::try_from(hub.heights.available_permits()).unwrap();
        let taken = Arc::clone(&hub.heights).acquire_many_owned(all).await.unwrap();
        let refused = ask().await.unwrap_err().answer();
        assert_eq!(refused.status(), StatusCode::SERVICE_UNAVAILABLE);
        assert_eq!(refused.headers()["retry-after"], "1");
        drop(taken);
        assert_eq!(ask().await.unwrap(), found);
        let waiting = hub.heights_asked.available_permits();
        let waiting = hub.heights_asked.acquire_many(u32::try_from(waiting).unwrap()).await;
        let asked = tokio::time::Instant::now();
        assert_eq!(ask().await.unwrap_err().answer().status(), StatusCode::SERVICE_UNAVAILABLE);
        assert_eq!(asked.elapsed(), Duration::ZERO, "it waits");
        drop(waiting);
        assert_eq!(ask().await.unwrap(), found);

        let listen = || (0..3).map(|_| events(&hub)).collect::<Vec<_>>();
        let answers = listen();
        let statuses = answers.iter().map(|answer| answer.status().as_u16()).collect::<Vec<_>>();
        assert_eq!(statuses, [200, 200, 503]);
        drop(answers);
        while hub.listeners.available_permits() < 2 {
            tokio::task::yield_now().await;
        }
        assert!(listen()[1].status().is_success());
    }
}
