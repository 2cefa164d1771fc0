//! Requests to a server: kept-alive connections, time-outs, answers in JSON.

use std::io::{self, Read as _};
use std::sync::Arc;
use std::time::Duration;

use areoid_formats::archive::ArchiveError;
use serde_json::Value;
use ureq::http::{Response, StatusCode, Uri};
use ureq::{Agent, Body};

use super::link::{Link, is_nobody};

/// A request that was not answered as it should be.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RemoteError {
    /// The server cannot be reached, or went away.
    #[error("no answer from {url}")]
    Network {
        /// What was asked for.
        url: String,
        /// Why.
        source: io::Error,
    },
    /// The server refuses, and says why.
    #[error("{url} answers {status}: {reason}")]
    Refused {
        /// What was asked for.
        url: String,
        /// The status, a number of HTTP.
        status: u16,
        /// In the server's words.
        reason: String,
    },
    /// The answer is not what this version understands.
    #[error("the answer of {url} makes no sense: {reason}")]
    Answer {
        /// What was asked for.
        url: String,
        /// What is wrong with it.
        reason: String,
    },
    /// A dataset that the server lists, and cannot read itself.
    #[error("the server cannot read {dataset}: {reason}")]
    Unreadable {
        /// Its name.
        dataset: String,
        /// In the server's words.
        reason: String,
    },
    /// The archive of a dataset that the server lists.
    #[error("cannot read {dataset} of {url}")]
    Archive {
        /// Its name.
        dataset: String,
        /// The server.
        url: String,
        /// Why.
        source: ArchiveError,
    },
    /// The folder that keeps what was read.
    #[error("cannot keep anything in {folder}")]
    Disk {
        /// The folder.
        folder: String,
        /// Why.
        source: io::Error,
    },
    /// It is no address of a server.
    #[error("{url} is not the address of a server, such as http://127.0.0.1:8360")]
    Url {
        /// The address.
        url: String,
    },
}

/// How long to wait for a connection.
pub(super) const CONNECT: Duration = Duration::from_secs(3);
/// How long to wait for an answer to begin, and then for its end.
pub(super) const ANSWER: Duration = Duration::from_secs(15);
/// Connections kept open.
const KEPT: usize = 16;
/// Bytes of an answer in JSON.
const JSON_BYTES: u64 = 64 << 20;
/// Bytes of an answer that says why there is none.
const REASON_BYTES: u64 = 64 << 10;

/// A server. All threads may ask at once, and each waits for its answer.
///
/// An answer that has been read to its end leaves its connection to the next request. Proxies that
/// the environment names are not asked.
#[derive(Clone, Debug)]
pub struct Client {
    agent: Agent,
    base: String,
    link: Arc<Link>,
}

/// An answer in JSON, and its tag.
pub(super) type Tagged = (Value, Option<String>);

impl Client {
    /// The server at `url`, such as `http://127.0.0.1:8360`. Asks nothing yet.
    ///
    /// # Errors
    ///
    /// [`RemoteError::Url`].
    pub fn new(url: &str) -> Result<Self, RemoteError> {
        let base = url.trim_end_matches('/').to_owned();
        let is_address = |uri: &Uri| {
            uri.scheme_str() == Some("http") && uri.host().is_some_and(|host| !host.is_empty())
        };
        if !base.parse().is_ok_and(|uri| is_address(&uri)) {
            return Err(RemoteError::Url { url: url.to_owned() });
        }
        let config = Agent::config_builder()
            .timeout_connect(Some(CONNECT))
            .timeout_recv_response(Some(ANSWER))
            .timeout_recv_body(Some(ANSWER))
            .max_idle_connections_per_host(KEPT)
            .http_status_as_error(false)
            .max_redirects(0)
            .proxy(None)
            .build();
        Ok(Self { agent: config.into(), base, link: Arc::new(Link::new()) })
    }

    /// The server's address, as it was given but for slashes at its end.
    #[must_use]
    pub fn address(&self) -> &str {
        &self.base
    }

    pub(crate) fn link(&self) -> &Link {
        &self.link
    }

    pub(super) fn agent(&self) -> &Agent {
        &self.agent
    }

    pub(super) fn url(&self, path: &str) -> String {
        format!("{}{path}", self.base)
    }

    pub(super) fn failed(url: &str, error: ureq::Error) -> RemoteError {
        RemoteError::Network { url: url.to_owned(), source: error.into_io() }
    }

    /// The answer, if the server does not refuse.
    pub(super) fn accepted(
        url: &str,
        mut answer: Response<Body>,
    ) -> Result<Response<Body>, RemoteError> {
        let status: StatusCode = answer.status();
        if status.is_success() {
            return Ok(answer);
        }
        let text = answer.body_mut().with_config().limit(REASON_BYTES).read_to_string();
        let text = text.unwrap_or_default();
        let told: Option<Value> = serde_json::from_str(&text).ok();
        let told = told.as_ref().and_then(|told| told["error"].as_str());
        let reason = told.unwrap_or("no reason given").to_owned();
        Err(RemoteError::Refused { url: url.to_owned(), status: status.as_u16(), reason })
    }

    /// What is at `path`, which is JSON.
    ///
    /// # Errors
    ///
    /// Any [`RemoteError`].
    pub fn json(&self, path: &str) -> Result<Value, RemoteError> {
        match self.json_unless(path, None)? {
            Some((value, _)) => Ok(value),
            None => Err(RemoteError::Answer {
                url: self.url(path),
                reason: "it is what it was, though nobody said what that is".to_owned(),
            }),
        }
    }

    /// [`Self::json`] with its tag; `None` if it still has the tag `known`.
    pub(super) fn json_unless(
        &self,
        path: &str,
        known: Option<&str>,
    ) -> Result<Option<Tagged>, RemoteError> {
        let url = self.url(path);
        let mut asked = self.agent.get(&url);
        if let Some(known) = known {
            asked = asked.header("if-none-match", known);
        }
        let answer = asked.call().map_err(|error| {
            if is_nobody(&error) {
                self.link.lose(&format!("{url}: {error}"));
            }
            Self::failed(&url, error)
        })?;
        self.link.find();
        if answer.status() == StatusCode::NOT_MODIFIED {
            return Ok(None);
        }
        let answer = Self::accepted(&url, answer)?;
        let tag = answer.headers().get("etag").and_then(|tag| tag.to_str().ok());
        let (tag, mut text) = (tag.map(str::to_owned), Vec::new());
        let read = answer.into_body().into_reader().take(JSON_BYTES).read_to_end(&mut text);
        read.map_err(|source| RemoteError::Network { url: url.clone(), source })?;
        match serde_json::from_slice(&text) {
            Ok(value) => Ok(Some((value, tag))),
            Err(error) => Err(RemoteError::Answer { url, reason: error.to_string() }),
        }
    }
}
