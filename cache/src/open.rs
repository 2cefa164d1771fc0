//! A catalog, opened dataset by dataset: a folder's, or a server's.

use std::collections::BTreeMap;
use std::io;
use std::path::Path;
use std::sync::Arc;

use areoid_formats::archive::ArchiveError;
use areoid_formats::body::Body;
use areoid_formats::catalog::{Catalog, CatalogError};

use crate::pages::PageSource;
use crate::place::Connection;
use crate::remote::{Listing, RemoteError, each};
use crate::scene::Newcomer;
use crate::selection::DatasetInfo;

/// Why a cache could not be opened, or a dataset not be added.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CacheError {
    /// The catalog, or an archive of it.
    #[error(transparent)]
    Catalog(#[from] CatalogError),

    /// A server, or an archive of it.
    #[error(transparent)]
    Remote(#[from] RemoteError),

    /// The index of an archive.
    #[error("cannot read the index of {dataset}")]
    Index {
        /// The dataset.
        dataset: String,
        /// Why.
        source: ArchiveError,
    },

    /// The system gave no threads.
    #[error("cannot start threads to load pages")]
    Threads(#[source] io::Error),

    /// The opening was given up, or panicked.
    #[error("opening the catalog was given up")]
    GivenUp,
}

/// What a generation of a catalog has: content and priority of each dataset by its name.
pub(crate) type Contents = BTreeMap<String, (String, i32)>;

/// What has come since some contents, and what all are now.
pub(crate) struct News {
    pub(crate) generation: u64,
    pub(crate) body: Body,
    pub(crate) contents: Contents,
    pub(crate) newcomers: Vec<Newcomer>,
    pub(crate) problems: Vec<CacheError>,
}

/// Opens what the newest generation has and `known` does not; `told` hears of each dataset, with how
/// many there are.
///
/// A dataset that cannot be opened is left out, of the contents too, and told in the problems. One
/// that was cut short is told, and opened as far as it is whole.
pub(crate) fn news(
    folder: &Path,
    known: &Contents,
    told: impl Fn(usize, usize),
) -> Result<News, CacheError> {
    loop {
        let catalog = Catalog::open(folder)?;
        let count = catalog.datasets().len();
        let mut news = News {
            generation: catalog.generation(),
            body: catalog.body().clone(),
            contents: Contents::new(),
            newcomers: Vec::new(),
            problems: Vec::new(),
        };
        told(0, count);
        let mut outdated = false;
        for (opened, record) in catalog.datasets().iter().enumerate() {
            let version = (record.content.clone(), record.priority);
            if known.get(&record.name) == Some(&version) {
                news.contents.insert(record.name.clone(), version);
                continue;
            }
            match catalog.archive(record) {
                Ok(archive) => {
                    let length = catalog.check_length(record, &archive);
                    news.problems.extend(length.err().map(CacheError::from));
                    let info = DatasetInfo {
                        name: record.name.clone(),
                        group: record.group.clone(),
                        kind: record.kind,
                        grid: archive.description().grid.clone(),
                        priority: record.priority,
                    };
                    match newcomer(info, Arc::new(archive)) {
                        Ok(newcomer) => {
                            news.newcomers.push(newcomer);
                            news.contents.insert(record.name.clone(), version);
                        }
                        Err(error) => news.problems.push(error),
                    }
                }
                Err(error) => {
                    // A file that is missing may be one that a newer generation dropped.
                    outdated |= matches!(error, CatalogError::Missing { .. });
                    news.problems.push(error.into());
                }
            }
            told(opened + 1, count);
        }
        if !outdated || Catalog::open(folder)?.generation() == news.generation {
            return Ok(news);
        }
    }
}

/// [`news`] of a server, and the tag of its list; `None` if the list still has the tag `tag`.
///
/// # Errors
///
/// Also if the server goes while it is asked: what is known of it then is no state of its catalog.
pub(crate) fn news_afar(
    server: &Connection,
    known: &Contents,
    tag: Option<&str>,
    told: impl Fn(usize, usize) + Sync,
) -> Result<Option<(News, Option<String>)>, CacheError> {
    /// What is listed may be gone when it is opened, but not time and again.
    const LISTS: u32 = 4;
    let Connection { client, blocks } = server;
    for lists in 1.. {
        let tag = tag.filter(|_| lists == 1);
        let Some(listing) = Listing::ask(client, tag)? else { return Ok(None) };
        let Listing { generation, body, datasets: listed, tag } = listing;
        let version = |place: usize| (listed[place].content.clone(), listed[place].priority);
        let (mut contents, mut newcomers, mut problems) = (Contents::new(), Vec::new(), Vec::new());
        let mut fresh = Vec::new();
        for (place, one) in listed.iter().enumerate() {
            if known.get(&one.name) == Some(&version(place)) {
                contents.insert(one.name.clone(), version(place));
            } else {
                fresh.push(place);
            }
        }
        told(contents.len(), listed.len());
        let open = |&place: &usize| {
            let dataset = listed[place].open(client, blocks.as_ref())?;
            newcomer(dataset.info, dataset.pages)
        };
        let opened =
            each(&fresh, open, |done| told(listed.len() - fresh.len() + done, listed.len()));
        for (&place, opened) in fresh.iter().zip(opened) {
            match opened {
                Ok(newcomer) => {
                    newcomers.push(newcomer);
                    contents.insert(listed[place].name.clone(), version(place));
                }
                Err(problem) => problems.push(problem),
            }
        }
        if client.link().is_lost()
            && let Some(problem) = problems.pop()
        {
            return Err(problem);
        }
        if lists == LISTS || !problems.iter().any(is_missing) {
            let news = News { generation, body, contents, newcomers, problems };
            return Ok(Some((news, tag)));
        }
    }
    unreachable!("the last list is taken")
}

/// Whether a newer list may not have what could not be opened.
fn is_missing(problem: &CacheError) -> bool {
    match problem {
        CacheError::Remote(RemoteError::Archive { source, .. })
        | CacheError::Index { source, .. } => {
            matches!(source, ArchiveError::Read { source, .. } if source.kind() == io::ErrorKind::NotFound)
        }
        _ => false,
    }
}

/// A dataset to be. Waits for its index.
pub(crate) fn newcomer(
    info: DatasetInfo,
    pages: Arc<dyn PageSource>,
) -> Result<Newcomer, CacheError> {
    let dataset = info.name.clone();
    Newcomer::new(info, pages).map_err(|source| CacheError::Index { dataset, source })
}
