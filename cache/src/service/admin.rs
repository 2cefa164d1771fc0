//! What an administrator may ask: state and counters without a token, changes with one.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

use areoid_formats::catalog::{CatalogError, RealDisk, remove_dataset};
use areoid_preprocess::raster::Fence;
use bytes::Bytes;
use http_body_util::{BodyExt as _, LengthLimitError, Limited};
use hyper::body::Incoming;
use hyper::header::{AUTHORIZATION, HeaderMap, HeaderValue};
use hyper::{Method, Request, StatusCode};
use serde_json::json;
use subtle::ConstantTimeEq as _;
use tokio::sync::Semaphore;
use tokio::task::spawn_blocking;
use tracing::info;

use super::answer::{self, Answer, Refusal};
use super::hub::Hub;
use super::mutate;
use super::options::{Admin, ServiceError};
use crate::insertion_request::InsertRequest;
use crate::words::in_words;

/// Bytes of a request's body.
const BODY_BYTES: usize = 64 << 10;

/// A token shorter than that is found by trying.
const TOKEN_CHARACTERS: usize = 16;

/// Who may change what.
#[derive(Debug)]
pub(super) struct Gate {
    token: Option<Vec<u8>>,
    /// Without symbolic links.
    allowed: Vec<PathBuf>,
    /// Those of insertions, under way or waiting.
    pub(super) places: Arc<Semaphore>,
    /// Held by the one insertion under way; others wait in turn.
    pub(super) turn: tokio::sync::Mutex<()>,
}

impl Gate {
    /// Reads the token, and refuses to be open to the world without one; with places for so many insertions.
    pub(super) fn open(admin: &Admin, insertions: usize) -> Result<Self, ServiceError> {
        let token = admin.token_file.as_ref().map(|path| read_token(path)).transpose()?;
        if token.is_none() && !admin.listen.ip().is_loopback() {
            return Err(ServiceError::Exposed { address: admin.listen });
        }
        let allowed = admin.allowed.iter().map(|folder| {
            let failed = |source| ServiceError::Path { path: folder.clone(), source };
            folder.canonicalize().map_err(failed)
        });
        let allowed = allowed.collect::<Result<_, _>>()?;
        let places = Arc::new(Semaphore::new(insertions));
        Ok(Self { token, allowed, places, turn: tokio::sync::Mutex::new(()) })
    }

    /// Refuses whoever has not the token.
    fn check(&self, asked: &HeaderMap) -> Result<(), Refusal> {
        let Some(token) = &self.token else {
            let reason = "nothing can be changed: the service was started without a token file";
            return Err(Refusal::new(StatusCode::FORBIDDEN, reason));
        };
        let given = asked.get(AUTHORIZATION).map(HeaderValue::as_bytes);
        let given = given.and_then(|given| given.split_at_checked(b"Bearer ".len()));
        let given = given.filter(|(scheme, _)| scheme.eq_ignore_ascii_case(b"Bearer "));
        // The length is no secret, the bytes are compared all, whichever differ.
        if given.is_some_and(|(_, given)| given.ct_eq(token).into()) {
            return Ok(());
        }
        Err(Refusal::new(StatusCode::UNAUTHORIZED, "this takes the token"))
    }

    /// The raster without symbolic links, if it lies where rasters may. Waits for the disk.
    pub(super) fn admit(&self, raster: &Path) -> Result<PathBuf, String> {
        // What is not allowed and what is not there are told apart by nobody.
        let refused = || format!("{} is not in an allowed folder, or not there", raster.display());
        if !raster.is_absolute() {
            return Err(format!("{} is not an absolute path", raster.display()));
        }
        let path = raster.canonicalize().map_err(|_| refused())?;
        let is_within = self.allowed.iter().any(|folder| path.starts_with(folder));
        if is_within && path.is_file() { Ok(path) } else { Err(refused()) }
    }
}

fn read_token(path: &Path) -> Result<Vec<u8>, ServiceError> {
    let text = fs::read_to_string(path)
        .map_err(|source| ServiceError::Path { path: path.to_owned(), source })?;
    let token = text.lines().next().unwrap_or_default().trim();
    if token.len() < TOKEN_CHARACTERS {
        return Err(ServiceError::Token { path: path.to_owned() });
    }
    Ok(token.as_bytes().to_vec())
}

/// Answers a request.
///
/// # Cancel safety
///
/// Dropped when the client goes: an insertion or removal under way comes to its end.
pub(super) async fn answer(hub: Arc<Hub>, gate: Arc<Gate>, request: Request<Incoming>) -> Answer {
    let is_head = request.method() == Method::HEAD;
    let path = request.uri().path().to_owned();
    let answer = match (request.method(), path.strip_prefix("/v1/datasets")) {
        (&Method::POST, Some("")) => {
            insert(hub, gate, request).await.unwrap_or_else(Refusal::answer)
        }
        (&Method::DELETE, Some(name)) if name.starts_with('/') => {
            match gate.check(request.headers()) {
                Ok(()) => remove(hub, name[1..].to_owned()).await,
                Err(refusal) => refusal.answer(),
            }
        }
        (_, Some(_)) => answer::error(StatusCode::METHOD_NOT_ALLOWED, "POST to it, or DELETE one"),
        (&Method::GET | &Method::HEAD, None) => match path.as_str() {
            "/livez" => answer::bytes("text/plain", "alive\n"),
            "/readyz" if hub.is_stopping() => {
                answer::error(StatusCode::SERVICE_UNAVAILABLE, "ending")
            }
            "/readyz" => answer::bytes("text/plain", "ready\n"),
            "/metrics" => answer::bytes("text/plain; version=0.0.4", hub.metrics_text()),
            _ => answer::not_found("nothing is here"),
        },
        _ => answer::not_found("nothing is here"),
    };
    if is_head { answer::head(answer) } else { answer }
}

async fn insert(
    hub: Arc<Hub>,
    gate: Arc<Gate>,
    request: Request<Incoming>,
) -> Result<Answer, Refusal> {
    gate.check(request.headers())?;
    let Ok(place) = Arc::clone(&gate.places).try_acquire_owned() else {
        hub.metrics.refused.fetch_add(1, Relaxed);
        let reason = "too many insertions are waiting";
        return Err(Refusal::new(StatusCode::SERVICE_UNAVAILABLE, reason));
    };
    let refused = |reason: String| Refusal::new(StatusCode::BAD_REQUEST, reason);
    let body = Limited::new(request.into_body(), BODY_BYTES).collect();
    let body = tokio::time::timeout(std::time::Duration::from_secs(10), body).await;
    let body: Bytes = match body {
        Ok(Ok(body)) => body.to_bytes(),
        Ok(Err(error)) if error.is::<LengthLimitError>() => {
            let reason = format!("the body has more than {BODY_BYTES} bytes");
            return Err(Refusal::new(StatusCode::PAYLOAD_TOO_LARGE, reason));
        }
        Ok(Err(error)) => return Err(refused(error.to_string())),
        Err(_) => return Err(Refusal::new(StatusCode::REQUEST_TIMEOUT, "the body did not come")),
    };
    let mut asked: InsertRequest =
        serde_json::from_slice(&body).map_err(|error| refused(error.to_string()))?;
    let (folder, admitting) = (hub.folder().to_owned(), Arc::clone(&gate));
    let admitted = spawn_blocking(move || {
        for raster in &mut asked.rasters {
            let admitted = admitting.admit(raster);
            *raster = admitted.map_err(|reason| Refusal::new(StatusCode::FORBIDDEN, reason))?;
        }
        // A coordinate system may be given by a file: here it may not.
        if asked.crs.as_deref().is_some_and(|crs| Path::new(crs).exists()) {
            return Err(Refusal::new(StatusCode::FORBIDDEN, "crs is text here, not a file"));
        }
        Ok(asked)
    });
    let asked = admitted.await.map_err(|error| refused(error.to_string()))??;
    let lifetime = asked.lifetime();
    let mut request = asked.request(folder).map_err(refused)?;
    // What was admitted may be something else by the time that it is opened, and files beside it are
    // opened, too.
    request.reading.within = Some(Fence::new(gate.allowed.clone()));
    Ok(mutate::insert(hub, gate, place, request, lifetime))
}

async fn remove(hub: Arc<Hub>, name: String) -> Answer {
    let removed = spawn_blocking(move || {
        let temporary = hub.take(&name)?;
        let removed = match remove_dataset(&RealDisk, hub.folder(), &name) {
            Err(CatalogError::NoSuchDataset { .. }) if temporary => Ok(()),
            removed => removed.map(|_| ()),
        };
        removed.and_then(|()| hub.refresh())?;
        info!(dataset = name, "removed");
        Ok((name, hub.now().generation))
    });
    match removed.await {
        Ok(Ok((name, generation))) => {
            answer::value(&json!({ "removed": name, "generation": generation }))
        }
        Ok(Err(error @ CatalogError::NoSuchDataset { .. })) => answer::not_found(error),
        Ok(Err(error @ CatalogError::Part { .. })) => answer::error(StatusCode::CONFLICT, error),
        Ok(Err(error)) => answer::error(StatusCode::INTERNAL_SERVER_ERROR, in_words(&error)),
        Err(error) => answer::error(StatusCode::INTERNAL_SERVER_ERROR, error),
    }
}

/// Counts an insertion for as long as it is held.
pub(super) struct Inserting(Arc<Hub>);

impl Inserting {
    pub(super) fn new(hub: &Arc<Hub>) -> Self {
        hub.inserting.send_modify(|count| *count += 1);
        Self(Arc::clone(hub))
    }
}

impl Drop for Inserting {
    fn drop(&mut self) {
        self.0.inserting.send_modify(|count| *count -= 1);
    }
}
