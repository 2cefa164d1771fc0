//! The pages of a catalog, shared by all who draw it.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering::Relaxed};

use areoid_formats::archive::{Archive, ArchiveError};
use areoid_formats::body::Body;
use areoid_formats::catalog::{Catalog, CatalogError};
use tokio::sync::oneshot;

use crate::engine::Engine;
use crate::scene::Scene;
use crate::selection::DatasetInfo;
use crate::session::Session;
use crate::store::Stats;

/// How much a cache may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// Decoded pages, those being decoded included. Never passed.
    pub budget_bytes: usize,
    /// Pages read or decoded at a time.
    pub concurrent_loads: usize,
}

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

/// The pages of a catalog in memory, and the threads that load them.
///
/// # Threads
///
/// All methods may be called from any thread. Those that say so wait; the thread that draws uses
/// [`Session::update`] alone. Dropping the last of the cache and its sessions abandons loads
/// under way without waiting for them.
#[derive(Debug)]
pub struct Cache {
    engine: Arc<Engine>,
    body: Body,
    next_session: AtomicU64,
    problems: Vec<CacheError>,
}

/// A catalog that is being opened.
#[derive(Debug)]
pub struct Opening {
    progress: Arc<(AtomicUsize, AtomicUsize)>,
    result: oneshot::Receiver<Result<Cache, CacheError>>,
}

/// How far an [`Opening`] has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// Datasets opened.
    pub opened: usize,
    /// Datasets of the catalog; 0 until the manifest is read.
    pub datasets: usize,
}

impl Cache {
    /// Opens the catalog in `folder` as a skeleton: descriptions and the first blocks of indexes,
    /// no page. Returns at once.
    ///
    /// A dataset that cannot be opened is left out and told by [`Self::problems`].
    #[must_use]
    pub fn open(folder: &Path, options: Options) -> Opening {
        let progress = Arc::new((AtomicUsize::new(0), AtomicUsize::new(0)));
        let (sender, result) = oneshot::channel();
        let (folder, told) = (folder.to_owned(), Arc::clone(&progress));
        let thread = std::thread::Builder::new().name("areoid-open".to_owned());
        // If there is no thread, the sender is dropped, which says so.
        let _detached = thread.spawn(move || {
            let opened = open_catalog(&folder, options, &told);
            // Nobody may be waiting any more.
            let _unwanted = sender.send(opened);
        });
        Opening { progress, result }
    }

    /// A cache of archives that are open already. Reads the blocks of their indexes that lead to
    /// the roots, and waits for that.
    ///
    /// # Errors
    ///
    /// [`CacheError::Threads`]. An archive whose index cannot be read is left out and told by
    /// [`Self::problems`].
    pub fn with_archives(
        body: Body,
        archives: Vec<(DatasetInfo, Arc<Archive>)>,
        options: Options,
    ) -> Result<Self, CacheError> {
        let mut scene = Scene::empty(body.clone());
        let mut problems = Vec::new();
        for (info, archive) in archives {
            let dataset = info.name.clone();
            match scene.with(info, archive) {
                Ok(with) => scene = with,
                Err(source) => problems.push(CacheError::Index { dataset, source }),
            }
        }
        let engine = Engine::new(scene, options.budget_bytes, options.concurrent_loads);
        let engine = Arc::new(engine.map_err(CacheError::Threads)?);
        Ok(Self { engine, body, next_session: AtomicU64::new(1), problems })
    }

    /// The body that all datasets show.
    #[must_use]
    pub fn body(&self) -> &Body {
        &self.body
    }

    /// The datasets of now. Waits while another thread replaces them.
    #[must_use]
    pub fn datasets(&self) -> Arc<[DatasetInfo]> {
        Arc::clone(&self.engine.shared().scene().infos)
    }

    /// Datasets that were left out when the cache was opened, and why.
    #[must_use]
    pub fn problems(&self) -> &[CacheError] {
        &self.problems
    }

    /// Makes one more dataset visible to every session, in one step. Waits for its index.
    ///
    /// # Errors
    ///
    /// [`CacheError::Index`]; nothing has changed then.
    pub fn insert(&self, info: DatasetInfo, archive: Arc<Archive>) -> Result<(), CacheError> {
        loop {
            let before = self.engine.shared().scene();
            let after = before
                .with(info.clone(), Arc::clone(&archive))
                .map_err(|source| CacheError::Index { dataset: info.name.clone(), source })?;
            if self.engine.shared().replace_scene(&before, after) {
                return Ok(());
            }
        }
    }

    /// A way in for one more rendering context. Waits for the store.
    ///
    /// Sessions share half of the budget: each one more makes the others coarser.
    #[must_use]
    pub fn session(&self) -> Session {
        Session::new(Arc::clone(&self.engine), self.next_session.fetch_add(1, Relaxed))
    }

    /// What happened so far. Waits for the store.
    #[must_use]
    pub fn stats(&self) -> Stats {
        Stats {
            visited: self.engine.visited.load(Relaxed),
            repeated: self.engine.repeated.load(Relaxed),
            ..self.engine.shared().stats()
        }
    }

    #[cfg(test)]
    pub(crate) fn engine(&self) -> &Engine {
        &self.engine
    }
}

impl Opening {
    /// How far it is. Never waits.
    #[must_use]
    pub fn progress(&self) -> Progress {
        Progress { opened: self.progress.0.load(Relaxed), datasets: self.progress.1.load(Relaxed) }
    }

    /// The cache, once it is open.
    ///
    /// # Cancel safety
    ///
    /// Dropping the future abandons the opening: the cache is dropped when it is open.
    ///
    /// # Errors
    ///
    /// [`CacheError::Catalog`] if the folder is no catalog, or [`CacheError::Threads`].
    pub async fn finished(self) -> Result<Cache, CacheError> {
        self.result.await.unwrap_or(Err(CacheError::GivenUp))
    }

    /// [`Self::finished`] for a thread without a runtime.
    ///
    /// # Errors
    ///
    /// The same.
    ///
    /// # Panics
    ///
    /// If called from asynchronous code.
    pub fn wait(self) -> Result<Cache, CacheError> {
        self.result.blocking_recv().unwrap_or(Err(CacheError::GivenUp))
    }
}

fn open_catalog(
    folder: &Path,
    options: Options,
    progress: &(AtomicUsize, AtomicUsize),
) -> Result<Cache, CacheError> {
    loop {
        let catalog = Catalog::open(folder)?;
        progress.0.store(0, Relaxed);
        progress.1.store(catalog.datasets().len(), Relaxed);
        let (mut archives, mut problems) = (Vec::new(), Vec::new());
        let mut outdated = false;
        for record in catalog.datasets() {
            match catalog.archive(record) {
                Ok(archive) => {
                    let info = DatasetInfo {
                        name: record.name.clone(),
                        kind: record.kind,
                        grid: archive.description().grid.clone(),
                        priority: record.priority,
                    };
                    archives.push((info, Arc::new(archive)));
                }
                Err(error) => {
                    // A file that is missing may be one that a newer generation dropped.
                    outdated |= matches!(error, CatalogError::Missing { .. });
                    problems.push(error.into());
                }
            }
            progress.0.fetch_add(1, Relaxed);
        }
        if outdated && Catalog::open(folder)?.generation() > catalog.generation() {
            continue;
        }
        let mut cache = Cache::with_archives(catalog.body().clone(), archives, options)?;
        cache.problems.splice(0..0, problems);
        return Ok(cache);
    }
}
