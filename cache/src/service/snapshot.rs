//! What the service shows at one moment: readers hold one snapshot or the next, never a mixture.

use std::collections::{BTreeMap, HashSet};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use areoid_formats::archive::Archive;
use areoid_formats::body::Body;
use areoid_formats::catalog::{Catalog, CatalogError, DatasetRecord};
use bytes::Bytes;
use hyper::header::HeaderValue;
use serde_json::{Value, json};
use tracing::warn;
use xxhash_rust::xxh3::xxh3_64;

use super::answer::tag;
use crate::describe;

/// A dataset that is served.
#[derive(Debug)]
pub(super) struct Served {
    /// No other ever served has it.
    pub(super) serial: u64,
    pub(super) record: DatasetRecord,
    /// Or why it cannot be read.
    pub(super) archive: Result<Archive, String>,
    /// Whether it lives until the service ends.
    pub(super) temporary: bool,
    pub(super) json: Value,
}

impl Served {
    /// Opens nothing, but may read the index.
    pub(super) fn new(
        record: DatasetRecord,
        archive: Result<Archive, String>,
        temporary: bool,
    ) -> Arc<Self> {
        static SERIALS: AtomicU64 = AtomicU64::new(0);
        let described = archive.as_ref().map_err(String::clone).and_then(|archive| {
            describe::dataset(&record, archive).map_err(|error| error.to_string())
        });
        let mut json = described.unwrap_or_else(|error| describe::unreadable(&record, &error));
        json["content"] = json!(record.content);
        json["file"] = json!(record.file);
        json["temporary"] = json!(temporary);
        if let Some(found) =
            archive.as_ref().ok().map(Archive::len).filter(|&len| len != record.bytes)
        {
            let (file, expected) = (&record.file, record.bytes);
            warn!(
                file,
                found, expected, "an archive is not as long as it was when it was published"
            );
            json["damage"] =
                json!(format!("{file} is damaged: of {expected} bytes it has {found}"));
        }
        Arc::new(Self { serial: SERIALS.fetch_add(1, Relaxed), record, archive, temporary, json })
    }
}

/// All that is served.
#[derive(Debug)]
pub(super) struct Snapshot {
    /// That of the manifest.
    pub(super) generation: u64,
    pub(super) body: Body,
    pub(super) datasets: BTreeMap<String, Arc<Served>>,
    /// The catalog in JSON, and its tag.
    pub(super) json: Bytes,
    pub(super) tag: HeaderValue,
}

/// Takes away what is temporary and could be meant by the name of something that comes; a group as a whole.
pub(super) fn make_room<'a>(
    datasets: &mut BTreeMap<String, Arc<Served>>,
    coming: impl Iterator<Item = &'a DatasetRecord>,
) {
    let names: HashSet<&str> =
        coming.flat_map(|record| [record.name.as_str(), record.called()]).collect();
    let goes = |record: &DatasetRecord| {
        names.contains(record.name.as_str()) || names.contains(record.called())
    };
    let temporary =
        datasets.values().filter(|served| served.temporary).map(|served| &served.record);
    let gone: HashSet<String> =
        temporary.filter(|record| goes(record)).map(|record| record.called().to_owned()).collect();
    datasets.retain(|_, served| !(served.temporary && gone.contains(served.record.called())));
}

impl Snapshot {
    pub(super) fn new(
        generation: u64,
        body: Body,
        datasets: BTreeMap<String, Arc<Served>>,
    ) -> Self {
        let all: Vec<&Value> = datasets.values().map(|served| &served.json).collect();
        let json = json!({
            "generation": generation,
            "body": describe::body(&body),
            "datasets": all,
        });
        let json = Bytes::from(json.to_string());
        let tag = tag(format_args!("{:016x}", xxh3_64(&json)));
        Self { generation, body, datasets, json, tag }
    }

    /// Datasets that could not be opened.
    pub(super) fn unread(&self) -> usize {
        self.datasets.values().filter(|served| served.archive.is_err()).count()
    }

    /// Opens the newest generation in `folder`, keeping what `before` has of it.
    pub(super) fn newest(folder: &Path, before: Option<&Self>) -> Result<Self, CatalogError> {
        loop {
            let catalog = Catalog::open(folder)?;
            let mut outdated = false;
            let mut datasets = BTreeMap::new();
            for record in catalog.datasets() {
                let had = before.and_then(|before| before.datasets.get(&record.name));
                let same = had
                    .filter(|had| had.record == *record && had.archive.is_ok() && !had.temporary);
                let served = match same {
                    Some(same) => Arc::clone(same),
                    None => {
                        let archive = catalog.archive(record);
                        outdated |= matches!(archive, Err(CatalogError::Missing { .. }));
                        let archive = archive.map_err(|error| error.to_string());
                        Served::new(record.clone(), archive, false)
                    }
                };
                datasets.insert(record.name.clone(), served);
            }
            if outdated && Catalog::open(folder)?.generation() > catalog.generation() {
                continue;
            }
            // What is temporary stays, but where the catalog has taken its name.
            let mut temporary = before.map_or_else(BTreeMap::new, |before| before.datasets.clone());
            temporary.retain(|_, served| served.temporary);
            make_room(&mut temporary, catalog.datasets().iter());
            datasets.append(&mut temporary);
            return Ok(Self::new(catalog.generation(), catalog.body().clone(), datasets));
        }
    }
}
