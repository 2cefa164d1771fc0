//! The pages of a catalog, shared by all who draw it.

use std::collections::HashSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering::Relaxed};

use areoid_formats::address::PageAddress;
use areoid_formats::archive::Archive;
use areoid_formats::body::Body;
use areoid_formats::geodesy::Geographic;
use tokio::sync::oneshot;

use crate::engine::Engine;
use crate::follow::{self, Followed};
use crate::follow_server::{self, FollowedServer};
use crate::height::{self, Height};
use crate::open::{CacheError, Contents, newcomer, news, news_afar};
use crate::pages::PageSource;
use crate::place::{Place, Server};
use crate::remote::RemoteError;
use crate::scene::{Newcomer, Scene};
use crate::selection::{DatasetInfo, Datasets, ResidentPage};
use crate::session::Session;
use crate::single::{self, PageError};
use crate::stats::Stats;
use crate::store::{Limits, PageName};

/// How much a cache may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// Decoded pages, those being decoded included. Never passed.
    pub budget_bytes: usize,
    /// Of that, what loads under way may hold. One load may always run.
    pub in_flight_bytes: usize,
    /// Pages read or decoded at a time.
    pub concurrent_loads: usize,
}

impl Options {
    /// A budget, of which loads under way may hold a quarter.
    #[must_use]
    pub fn with_budget(budget_bytes: usize) -> Self {
        Self { budget_bytes, in_flight_bytes: budget_bytes / 4, concurrent_loads: 4 }
    }

    /// [`Self::with_budget`] for a place: more loads at a time where most of their time is spent on
    /// the way.
    #[must_use]
    pub fn for_place(place: &Place, budget_bytes: usize) -> Self {
        let concurrent_loads = if place.is_server() { 16 } else { 4 };
        Self { concurrent_loads, ..Self::with_budget(budget_bytes) }
    }
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
    /// Opens the catalog at a place, a folder or a server, as a skeleton: descriptions and the first
    /// blocks of indexes, no page. Returns at once.
    ///
    /// A dataset that cannot be opened is left out and told by [`Self::problems`]. What anybody
    /// changes in the catalog afterwards, every session sees within a second.
    ///
    /// While a server that was there once cannot be reached, sessions go on with the pages in memory
    /// and on the disk, coarser ones standing in for the others ([`Selection::failed`]), and with the
    /// datasets of before. When it is back, in whatever state, all is asked for again.
    ///
    /// [`Selection::failed`]: crate::Selection::failed
    #[must_use]
    pub fn open(place: impl Into<Place>, options: Options) -> Opening {
        let progress = Arc::new((AtomicUsize::new(0), AtomicUsize::new(0)));
        let (sender, result) = oneshot::channel();
        let (place, told) = (place.into(), Arc::clone(&progress));
        let thread = std::thread::Builder::new().name("areoid-open".to_owned());
        // If there is no thread, the sender is dropped, which says so.
        let _detached = thread.spawn(move || {
            let opened = open_place(place, options, &told);
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
        let sources = archives.into_iter().map(|(info, archive)| (info, archive as _));
        Self::with_sources(body, sources, options)
    }

    /// [`Self::with_archives`] of whatever has pages.
    ///
    /// # Errors
    ///
    /// The same.
    pub fn with_sources(
        body: Body,
        sources: impl IntoIterator<Item = (DatasetInfo, Arc<dyn PageSource>)>,
        options: Options,
    ) -> Result<Self, CacheError> {
        let (mut newcomers, mut problems) = (Vec::new(), Vec::new());
        for (info, pages) in sources {
            match newcomer(info, pages) {
                Ok(newcomer) => newcomers.push(newcomer),
                Err(error) => problems.push(error),
            }
        }
        Self::new(body, newcomers, problems, options)
    }

    fn new(
        body: Body,
        newcomers: Vec<Newcomer>,
        problems: Vec<CacheError>,
        options: Options,
    ) -> Result<Self, CacheError> {
        let scene = Scene::empty(body.clone()).changed(|_| false, newcomers);
        let limits =
            Limits { loads: options.concurrent_loads.max(1), bytes: options.in_flight_bytes };
        let engine = Engine::new(scene, options.budget_bytes, limits);
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
    pub fn datasets(&self) -> Datasets {
        self.engine.shared().scene().infos.clone()
    }

    /// Datasets that were left out when the cache was opened, and why.
    #[must_use]
    pub fn problems(&self) -> &[CacheError] {
        &self.problems
    }

    /// [Inserts](Self::insert_all) one dataset.
    ///
    /// # Errors
    ///
    /// [`CacheError::Index`]; nothing has changed then.
    pub fn insert(&self, info: DatasetInfo, pages: Arc<dyn PageSource>) -> Result<(), CacheError> {
        self.insert_all([(info, pages)])
    }

    /// Makes datasets visible to every session, in one step, and in the place of what a user could mean by their
    /// names or those of their groups. All parts of a group come together: those that were there go. Waits for
    /// their indices.
    ///
    /// # Errors
    ///
    /// [`CacheError::Index`]; nothing has changed then.
    pub fn insert_all(
        &self,
        datasets: impl IntoIterator<Item = (DatasetInfo, Arc<dyn PageSource>)>,
    ) -> Result<(), CacheError> {
        let (mut newcomers, mut names) = (Vec::new(), HashSet::new());
        for (info, pages) in datasets {
            names.extend([info.name.clone(), info.called().to_owned()]);
            newcomers.push(newcomer(info, pages)?);
        }
        self.engine.replace(&names, newcomers);
        Ok(())
    }

    /// Takes a dataset from every session, or all parts of a group, in one step; whether there was any. Waits
    /// while another thread replaces the datasets.
    pub fn remove(&self, name: &str) -> bool {
        let is_there = self.datasets().iter().any(|(_, info)| info.answers_to(name));
        if is_there {
            self.engine.change(|info| info.answers_to(name), Vec::new());
        }
        is_there
    }

    /// A way in for one more rendering context. Waits for the store.
    ///
    /// Sessions share half of the budget: each one more makes the others coarser.
    #[must_use]
    pub fn session(&self) -> Session {
        Session::new(Arc::clone(&self.engine), self.next_session.fetch_add(1, Relaxed))
    }

    /// A page, if it is in memory. Waits for the store.
    #[must_use]
    pub fn resident(&self, dataset: usize, page: PageAddress) -> Option<Arc<ResidentPage>> {
        self.engine.shared().store().touch(PageName { dataset, page })
    }

    /// A page, loaded if need be; `None` if it has no data, or is not the grid's.
    ///
    /// # Cancel safety
    ///
    /// Dropping the future withdraws the request.
    ///
    /// # Errors
    ///
    /// [`PageError`].
    pub async fn page(
        &self,
        dataset: usize,
        page: PageAddress,
    ) -> Result<Option<Arc<ResidentPage>>, PageError> {
        single::load(&self.engine, dataset, page).await
    }

    /// The height at a position by the finest data there is, loaded if need be, and by composition
    /// where datasets overlap; `None` where no dataset has one. What is drawn at the moment says
    /// [`Selection::height`](crate::Selection::height).
    ///
    /// # Cancel safety
    ///
    /// Dropping the future withdraws its requests.
    ///
    /// # Errors
    ///
    /// [`PageError`].
    pub async fn exact_height(&self, position: Geographic) -> Result<Option<Height>, PageError> {
        height::exact(&self.engine, position).await
    }

    /// Waits for a future of this cache on a thread without a runtime.
    ///
    /// # Panics
    ///
    /// If called from asynchronous code.
    pub fn wait_for<T>(&self, future: impl Future<Output = T>) -> T {
        self.engine.handle().block_on(future)
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
    /// [`CacheError::Catalog`] if the folder is no catalog, [`CacheError::Remote`] if the server cannot
    /// be reached or answers nonsense, or [`CacheError::Threads`].
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

fn open_place(
    place: Place,
    options: Options,
    progress: &(AtomicUsize, AtomicUsize),
) -> Result<Cache, CacheError> {
    let told = |opened, datasets| {
        progress.1.store(datasets, Relaxed);
        // Whoever opens several at a time may tell of them in any order.
        progress.0.fetch_max(opened, Relaxed);
    };
    match place {
        Place::Folder(folder) => {
            let news = news(&folder, &Contents::new(), told)?;
            let cache = Cache::new(news.body, news.newcomers, news.problems, options)?;
            let (generation, contents) = (news.generation, news.contents);
            follow::start(&cache.engine, Followed { folder, generation, contents });
            Ok(cache)
        }
        Place::Server(server) => open_server(&server, options, told),
    }
}

fn open_server(
    server: &Server,
    options: Options,
    told: impl Fn(usize, usize) + Sync,
) -> Result<Cache, CacheError> {
    let connection = server.connection()?;
    let Some((news, tag)) = news_afar(&connection, &Contents::new(), None, told)? else {
        let reason = "it has no catalog".to_owned();
        return Err(RemoteError::Answer { url: server.url.clone(), reason }.into());
    };
    let cache = Cache::new(news.body.clone(), news.newcomers, news.problems, options)?;
    // What was left out is asked for again.
    let tag = tag.filter(|_| cache.problems.is_empty());
    let followed = FollowedServer { connection, body: news.body, contents: news.contents, tag };
    follow_server::start(&cache.engine, followed);
    Ok(cache)
}
