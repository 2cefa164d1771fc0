//! Requests to a server: kept-alive connections, time-outs, answers in JSON.

use std::io::{self, Read as _};
use std::time::Duration;

use serde_json::Value;
use ureq::http::{Response, StatusCode};
use ureq::{Agent, Body};

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
    /// It is no address of a server.
    #[error("{url} is not the address of a server: it starts with http://")]
    Url {
        /// The address.
        url: String,
    },
}

/// How long to wait for a connection.
const CONNECT: Duration = Duration::from_secs(3);
/// How long to wait for an answer to begin, and for each request in all.
const ANSWER: Duration = Duration::from_secs(15);
/// Connections kept open.
const KEPT: usize = 16;
/// Bytes of an answer in JSON.
const JSON_BYTES: u64 = 64 << 20;

/// A server. All threads may ask at once, and each waits for its answer.
#[derive(Clone, Debug)]
pub struct Client {
    agent: Agent,
    base: String,
}

impl Client {
    /// The server at `url`, such as `http://127.0.0.1:8360`. Asks nothing yet.
    ///
    /// # Errors
    ///
    /// [`RemoteError::Url`].
    pub fn new(url: &str) -> Result<Self, RemoteError> {
        let base = url.trim_end_matches('/').to_owned();
        if base.strip_prefix("http://").is_none_or(str::is_empty) {
            return Err(RemoteError::Url { url: url.to_owned() });
        }
        let config = Agent::config_builder()
            .timeout_connect(Some(CONNECT))
            .timeout_recv_response(Some(ANSWER))
            .timeout_recv_body(Some(ANSWER))
            .max_idle_connections_per_host(KEPT)
            .http_status_as_error(false)
            .max_redirects(0)
            .build();
        Ok(Self { agent: config.into(), base })
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
        let text = answer.body_mut().with_config().limit(JSON_BYTES).read_to_string();
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
        let url = self.url(path);
        let answer = self.agent.get(&url).call().map_err(|error| Self::failed(&url, error))?;
        let mut text = Vec::new();
        let answer = Self::accepted(&url, answer)?;
        let read = answer.into_body().into_reader().take(JSON_BYTES).read_to_end(&mut text);
        read.map_err(|source| RemoteError::Network { url: url.clone(), source })?;
        let reason = |error: serde_json::Error| error.to_string();
        serde_json::from_slice(&text)
            .map_err(|error| RemoteError::Answer { url, reason: reason(error) })
    }
}
