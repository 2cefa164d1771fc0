//! What the holder of a token asks of a server's admin listener.

use std::io::{BufRead as _, BufReader};

use serde_json::Value;

use super::client::{Client, RemoteError};
use crate::insertion_request::InsertRequest;

/// Inserts and waits until the dataset is visible; `watch` hears how many percent are done. Answers with
/// what was made.
///
/// # Errors
///
/// Any [`RemoteError`]: with [`RemoteError::Network`] the insertion may be going on.
pub fn insert(
    admin: &Client,
    token: &str,
    request: &InsertRequest,
    mut watch: impl FnMut(u64),
) -> Result<Value, RemoteError> {
    let url = admin.url("/v1/datasets");
    let nonsense = |reason: String| RemoteError::Answer { url: url.clone(), reason };
    let body = serde_json::to_string(request).map_err(|error| nonsense(error.to_string()))?;
    let asked = admin
        .agent()
        .post(&url)
        .config()
        .timeout_recv_response(None)
        .timeout_recv_body(None)
        .build();
    let asked = asked.header("authorization", format!("Bearer {token}"));
    let answer = asked.send(body).map_err(|error| Client::failed(&url, error))?;
    let answer = Client::accepted(&url, answer)?;
    for line in BufReader::new(answer.into_body().into_reader()).lines() {
        let line = line.map_err(|source| RemoteError::Network { url: url.clone(), source })?;
        let line: Value =
            serde_json::from_str(&line).map_err(|error| nonsense(error.to_string()))?;
        if let Some(percent) = line["percent"].as_u64() {
            watch(percent);
        } else if let Some(reason) = line["error"].as_str() {
            let (url, reason) = (url.clone(), reason.to_owned());
            return Err(RemoteError::Refused { url, status: 200, reason });
        } else if line["inserted"].is_object() {
            return Ok(line["inserted"].clone());
        }
    }
    Err(nonsense("it ends before the insertion does".to_owned()))
}

/// Removes a dataset, or all parts of a group. Answers with its name and the generation without it.
///
/// # Errors
///
/// Any [`RemoteError`].
pub fn remove(admin: &Client, token: &str, dataset: &str) -> Result<Value, RemoteError> {
    let url = admin.url(&format!("/v1/datasets/{dataset}"));
    let asked = admin.agent().delete(&url).header("authorization", format!("Bearer {token}"));
    let answer = asked.call().map_err(|error| Client::failed(&url, error))?;
    let text = Client::accepted(&url, answer)?.body_mut().read_to_string();
    let text = text.map_err(|error| Client::failed(&url, error))?;
    serde_json::from_str(&text)
        .map_err(|error| RemoteError::Answer { url, reason: error.to_string() })
}
