//! A server's catalog: what it lists, and the archives of that, opened.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;

use areoid_formats::archive::ArchiveError;
use areoid_formats::body::{Body, Ellipsoid};
use areoid_formats::catalog::DatasetRecord;
use areoid_formats::units::Meters;
use serde::Deserialize;

use super::blocks::{Blocks, is_content};
use super::client::{Client, RemoteError};
use super::pages::RemotePages;
use super::source::HttpSource;
use crate::locks::lock;
use crate::selection::DatasetInfo;

/// Archives opened at a time: each takes a few answers, one after another.
const AT_A_TIME: usize = 8;

/// A catalog as a server tells of it.
#[derive(Debug, Deserialize)]
struct Told {
    generation: u64,
    body: ToldBody,
    datasets: Vec<Listed>,
}

#[derive(Debug, Deserialize)]
struct ToldBody {
    name: String,
    a_m: f64,
    b_m: f64,
}

/// A dataset as a server tells of it.
#[derive(Debug, Deserialize)]
pub(crate) struct Listed {
    pub(crate) name: String,
    group: Option<String>,
    pub(crate) priority: i32,
    bytes: u64,
    pub(crate) content: String,
    file: String,
    error: Option<String>,
}

/// What a server lists.
#[derive(Debug)]
pub(crate) struct Listing {
    pub(crate) generation: u64,
    pub(crate) body: Body,
    pub(crate) datasets: Vec<Listed>,
    /// What names this state of the list.
    pub(crate) tag: Option<String>,
}

/// What a server serves.
#[derive(Debug)]
pub struct RemoteCatalog {
    /// How often the catalog has changed.
    pub generation: u64,
    /// The body that all datasets show.
    pub body: Body,
    /// The datasets.
    pub datasets: Vec<RemoteDataset>,
    /// Datasets that were left out, and why.
    pub problems: Vec<RemoteError>,
}

/// A dataset of a server.
#[derive(Debug)]
pub struct RemoteDataset {
    /// What a viewer has to know of it.
    pub info: DatasetInfo,
    /// Its pages, for [`Cache::with_sources`](crate::Cache::with_sources).
    pub pages: Arc<RemotePages>,
}

impl RemoteDataset {
    /// Whether `name` means it: its own name, or that of its group.
    #[must_use]
    pub fn answers_to(&self, name: &str) -> bool {
        self.info.name == name || self.info.group.as_deref() == Some(name)
    }
}

impl RemoteCatalog {
    /// Asks `client` for its catalog, and reads the ends of all archives; with `blocks`, what is read is
    /// kept on the disk. Waits. What changes on the server afterwards it does not follow: a
    /// [`Cache`](crate::Cache) does.
    ///
    /// # Errors
    ///
    /// [`RemoteError`] if the server does not answer with a catalog.
    pub fn open(client: &Client, blocks: Option<&Arc<Blocks>>) -> Result<Self, RemoteError> {
        let Listing { generation, body, datasets: listed, .. } = Listing::ask(client, None)?
            .ok_or_else(|| nonsense(client, "it is what it was".to_owned()))?;
        let (mut datasets, mut problems) = (Vec::new(), Vec::new());
        for opened in each(&listed, |listed| listed.open(client, blocks), |_| {}) {
            match opened {
                Ok(dataset) => datasets.push(dataset),
                Err(error) => problems.push(error),
            }
        }
        Ok(Self { generation, body, datasets, problems })
    }
}

const CATALOG: &str = "/v1/catalog";

fn nonsense(client: &Client, reason: String) -> RemoteError {
    RemoteError::Answer { url: client.url(CATALOG), reason }
}

impl Listing {
    /// Asks for the list; `None` if it still has the tag `known`. Waits.
    pub(crate) fn ask(client: &Client, known: Option<&str>) -> Result<Option<Self>, RemoteError> {
        let Some((told, tag)) = client.json_unless(CATALOG, known)? else { return Ok(None) };
        let told: Told =
            serde_json::from_value(told).map_err(|error| nonsense(client, error.to_string()))?;
        let Told { generation, body: ToldBody { name, a_m, b_m }, datasets } = told;
        let ellipsoid = Ellipsoid::new(Meters(a_m), Meters(b_m))
            .map_err(|error| nonsense(client, error.to_string()))?;
        let names: BTreeSet<&str> = datasets.iter().map(|listed| listed.name.as_str()).collect();
        if names.len() < datasets.len() {
            return Err(nonsense(client, "two datasets have one name".to_owned()));
        }
        Ok(Some(Self { generation, body: Body { name, ellipsoid }, datasets, tag }))
    }
}

impl Listed {
    /// Reads the ends of its archive. Waits.
    pub(crate) fn open(
        &self,
        client: &Client,
        blocks: Option<&Arc<Blocks>>,
    ) -> Result<RemoteDataset, RemoteError> {
        let dataset = || self.name.clone();
        if let Some(reason) = &self.error {
            return Err(RemoteError::Unreadable { dataset: dataset(), reason: reason.clone() });
        }
        // Its content names files of the disk cache, its file a URL.
        let is_plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
        let is_sound = is_content(&self.content)
            && self.name.chars().all(is_plain)
            && self.file == DatasetRecord::file_of(&self.name, &self.content);
        if !is_sound {
            return Err(nonsense(client, format!("{:?} has names like none", self.name)));
        }
        let kept = blocks.cloned();
        let source = HttpSource::new(client.clone(), &self.file, &self.content, self.bytes, kept);
        let failed = |source: ArchiveError| RemoteError::Archive {
            dataset: dataset(),
            url: client.address().to_owned(),
            source,
        };
        let pages = RemotePages::open(source).map_err(failed)?;
        let description = pages.archive().description();
        let content = pages.archive().content().map(|content| format!("{content:016x}"));
        if description.dataset != self.name || content.as_ref() != Some(&self.content) {
            return Err(nonsense(client, format!("the archive of {} is another's", self.name)));
        }
        let info = DatasetInfo {
            name: dataset(),
            group: self.group.clone(),
            kind: description.kind,
            grid: description.grid.clone(),
            priority: self.priority,
        };
        Ok(RemoteDataset { info, pages: Arc::new(pages) })
    }
}

/// `open` of each in its place, some at a time; `told` hears how many are done.
pub(crate) fn each<L: Sync, T: Send>(
    listed: &[L],
    open: impl Fn(&L) -> T + Sync,
    told: impl Fn(usize) + Sync,
) -> Vec<T> {
    let (next, done) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let opened = Mutex::new(Vec::with_capacity(listed.len()));
    let work = || {
        while let Some((place, listed)) = {
            let place = next.fetch_add(1, Relaxed);
            listed.get(place).map(|listed| (place, listed))
        } {
            let result = open(listed);
            lock(&opened).push((place, result));
            told(done.fetch_add(1, Relaxed) + 1);
        }
    };
    thread::scope(|scope| {
        for _ in 1..AT_A_TIME.min(listed.len()) {
            // Without a thread the others do its work.
            let _ = thread::Builder::new().spawn_scoped(scope, work);
        }
        work();
    });
    let mut opened = opened.into_inner().unwrap_or_else(PoisonError::into_inner);
    opened.sort_by_key(|(place, _)| *place);
    opened.into_iter().map(|(_, result)| result).collect()
}
