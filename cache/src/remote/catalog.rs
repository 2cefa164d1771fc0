//! A server's catalog, opened as a folder's would be.

use std::sync::Arc;

use areoid_formats::archive::{Archive, ArchiveError};
use areoid_formats::body::{Body, Ellipsoid};
use areoid_formats::units::Meters;
use serde::Deserialize;

use super::blocks::Blocks;
use super::client::{Client, RemoteError};
use super::source::HttpSource;
use crate::selection::DatasetInfo;

/// A catalog as a server tells of it.
#[derive(Debug, Deserialize)]
struct Told {
    generation: u64,
    body: ToldBody,
    datasets: Vec<ToldDataset>,
}

#[derive(Debug, Deserialize)]
struct ToldBody {
    name: String,
    a_m: f64,
    b_m: f64,
}

#[derive(Debug, Deserialize)]
struct ToldDataset {
    name: String,
    priority: i32,
    bytes: u64,
    content: String,
    file: String,
    error: Option<String>,
}

/// What a server serves.
#[derive(Debug)]
pub struct RemoteCatalog {
    /// How often the catalog has changed.
    pub generation: u64,
    /// The body that all datasets show.
    pub body: Body,
    /// The datasets, for [`Cache::with_archives`](crate::Cache::with_archives).
    pub datasets: Vec<(DatasetInfo, Arc<Archive>)>,
    /// Datasets that were left out, and why.
    pub problems: Vec<String>,
}

impl RemoteCatalog {
    /// Asks `client` for its catalog, and reads the ends of all archives; with `blocks`, what is read is
    /// kept on the disk. Waits.
    ///
    /// # Errors
    ///
    /// [`RemoteError`] if the server does not answer with a catalog.
    pub fn open(client: &Client, blocks: Option<&Arc<Blocks>>) -> Result<Self, RemoteError> {
        let path = "/v1/catalog";
        let nonsense = |reason: String| RemoteError::Answer { url: client.url(path), reason };
        let told: Told = serde_json::from_value(client.json(path)?)
            .map_err(|error| nonsense(error.to_string()))?;
        let ToldBody { name, a_m, b_m } = told.body;
        let ellipsoid = Ellipsoid::new(Meters(a_m), Meters(b_m))
            .map_err(|error| nonsense(error.to_string()))?;
        let (mut datasets, mut problems) = (Vec::new(), Vec::new());
        for told in told.datasets {
            let name = told.name.clone();
            match open(client, told, blocks) {
                Ok(dataset) => datasets.push(dataset),
                Err(reason) => problems.push(format!("{name}: {reason}")),
            }
        }
        let body = Body { name, ellipsoid };
        Ok(Self { generation: told.generation, body, datasets, problems })
    }
}

fn open(
    client: &Client,
    told: ToldDataset,
    blocks: Option<&Arc<Blocks>>,
) -> Result<(DatasetInfo, Arc<Archive>), String> {
    if let Some(reason) = told.error {
        return Err(reason);
    }
    // It names files of the disk cache.
    if told.content.len() != 16 || !told.content.bytes().all(|byte| byte.is_ascii_hexdigit()) {
        return Err("its content has no name".to_owned());
    }
    let source =
        HttpSource::new(client.clone(), &told.file, &told.content, told.bytes, blocks.cloned());
    let archive = Archive::open(Box::new(source)).map_err(|error| match error {
        ArchiveError::Read { what, source } => format!("cannot read {what}: {source}"),
        error => error.to_string(),
    })?;
    let description = archive.description();
    let info = DatasetInfo {
        name: told.name,
        kind: description.kind,
        grid: description.grid.clone(),
        priority: told.priority,
    };
    Ok((info, Arc::new(archive)))
}
