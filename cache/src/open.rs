//! A catalog's folder, opened dataset by dataset.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use areoid_formats::archive::ArchiveError;
use areoid_formats::body::Body;
use areoid_formats::catalog::{Catalog, CatalogError};

use crate::pages::PageSource;
use crate::scene::Newcomer;
use crate::selection::DatasetInfo;

/// Why a cache could not be opened, or a dataset not be added.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CacheError {
    /// The catalog, or an archive of it.
    #[error(transparent)]
    Catalog(#[from] CatalogError),

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
    Threads(#[source] std::io::Error),

    /// The opening was given up, or panicked.
    #[error("opening the catalog was given up")]
    GivenUp,
}

/// What a generation of a catalog has: the content of each dataset by its name.
pub(crate) type Contents = BTreeMap<String, String>;

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
/// A dataset that cannot be opened is left out, of the contents too, and told in the problems.
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
            let content = (record.name.clone(), record.content.clone());
            if known.get(&record.name) == Some(&record.content) {
                news.contents.extend([content]);
                continue;
            }
            match catalog.archive(record) {
                Ok(archive) => {
                    let info = DatasetInfo {
                        name: record.name.clone(),
                        kind: record.kind,
                        grid: archive.description().grid.clone(),
                        priority: record.priority,
                    };
                    match newcomer(info, Arc::new(archive)) {
                        Ok(newcomer) => {
                            news.newcomers.push(newcomer);
                            news.contents.extend([content]);
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

/// A dataset to be. Waits for its index.
pub(crate) fn newcomer(
    info: DatasetInfo,
    pages: Arc<dyn PageSource>,
) -> Result<Newcomer, CacheError> {
    let dataset = info.name.clone();
    Newcomer::new(info, pages).map_err(|source| CacheError::Index { dataset, source })
}
