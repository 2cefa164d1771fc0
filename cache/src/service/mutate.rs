//! Insertions behind the service: one at a time, told of in lines of JSON until it is visible.

use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

use areoid_preprocess::build::Proceed;
use areoid_preprocess::ingest::{Event, IngestError, Request};
use bytes::Bytes;
use serde_json::{Value, json};
use tokio::sync::{OwnedSemaphorePermit, mpsc};
use tokio::task::spawn_blocking;
use tracing::{info, warn};

use super::admin::{Gate, Inserting};
use super::answer::{Answer, Content};
use super::hub::Hub;
use super::snapshot::Served;
use crate::insertion::{self, InsertError, Inserted, Lifetime};
use crate::words::in_words;

/// Begins, and answers with what comes of it. It goes on if the client does not listen any more.
pub(super) fn insert(
    hub: Arc<Hub>,
    gate: Arc<Gate>,
    place: OwnedSemaphorePermit,
    request: Request,
    lifetime: Lifetime,
) -> Answer {
    let (sender, pieces) = mpsc::channel(16);
    let inserting = Inserting::new(&hub);
    tokio::spawn(async move {
        let (_inserting, _place) = (inserting, place);
        let _turn = gate.turn.lock().await;
        let teller = sender.clone();
        let working = Arc::clone(&hub);
        let worked = spawn_blocking(move || {
            let mut told = 0;
            let watch = |event: Event| {
                if let Some((percent, line)) =
                    progress(&event).filter(|(percent, _)| *percent != told)
                {
                    told = percent;
                    // A client that does not keep up misses some.
                    let _ = teller.try_send(Ok(line));
                }
                if working.is_stopping() { Proceed::No } else { Proceed::Yes }
            };
            if working.is_stopping() {
                return Err(IngestError::Interrupted.into());
            }
            let body = working.now().body.clone();
            let inserted = insertion::insert(request, lifetime, &body, watch)?;
            show(&working, inserted)
        });
        let counted = &hub.metrics;
        let end = match worked.await {
            Ok(Ok(done)) => {
                counted.inserted.fetch_add(1, Relaxed);
                info!(dataset = %done["dataset"], "inserted");
                json!({ "inserted": done })
            }
            Ok(Err(error)) => {
                counted.insertions_failed.fetch_add(1, Relaxed);
                warn!(error = &error as &dyn std::error::Error, "not inserted");
                json!({ "error": in_words(&error) })
            }
            Err(_) => {
                counted.insertions_failed.fetch_add(1, Relaxed);
                json!({ "error": "the insertion failed" })
            }
        };
        let _ = sender.send(Ok(line(&end))).await;
    });
    let mut answer = hyper::Response::new(Content::pieces(pieces, None));
    let kind = hyper::header::HeaderValue::from_static("application/x-ndjson");
    answer.headers_mut().insert(hyper::header::CONTENT_TYPE, kind);
    answer
}

/// The step that makes it visible.
fn show(hub: &Hub, inserted: Inserted) -> Result<Value, InsertError> {
    let Inserted { outcome, temporary } = inserted;
    let is_temporary = !temporary.is_empty();
    if is_temporary {
        let served = temporary.into_iter();
        let served = served.map(|(record, archive)| Served::new(record, Ok(archive), true));
        if !hub.add(served.collect()) {
            return Err(InsertError::Taken { name: outcome.dataset });
        }
    } else {
        hub.refresh()?;
    }
    Ok(json!({
        "dataset": outcome.dataset,
        "parts": outcome.parts.iter().map(|part| &part.name).collect::<Vec<_>>(),
        "bytes": outcome.bytes,
        "seconds": outcome.seconds,
        "already_there": outcome.already_there,
        "temporary": is_temporary,
        "generation": hub.now().generation,
    }))
}

/// How far it is in percent, and the line that says so.
fn progress(event: &Event) -> Option<(usize, Bytes)> {
    let Event::Building(progress) = event else { return None };
    let percent = (100 * progress.units_done).checked_div(progress.units)?;
    Some((percent, line(&json!({ "percent": percent }))))
}

fn line(value: &Value) -> Bytes {
    format!("{value}\n").into()
}
