//! Loads on threads that may wait: at most so many at a time, the most urgent first.
//!
//! ```text
//!   sessions ──wake──▶ dispatcher ──reserve──▶ blocking thread: read ▶ prove ▶ decode ──▶ store
//!                          ▲                                                      │
//!                          └──────────────── wake, news ◀─────────────────────────┘
//! ```
//!
//! The store's lock is held for table work alone, never across a read or a decode.

use std::sync::atomic::AtomicUsize;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use areoid_formats::archive::ArchiveError;
use tokio::runtime::Handle;
use tokio::sync::{Notify, watch};
use tokio::time::{Instant, sleep};
use tracing::{debug, trace};

use crate::locks::{lock, step, try_lock};
use crate::lookout::{Look, Lookouts};
use crate::scene::Scene;
use crate::selection::ResidentPage;
use crate::stats::Stats;
use crate::store::{Limits, Outcome, PageName, Request, Store, Work};
use crate::words::in_words;

/// Threads that may wait.
pub(crate) trait Threads {
    /// Has one of them do something.
    fn start(&self, work: impl FnOnce() + Send + 'static);
}

impl Threads for Handle {
    fn start(&self, work: impl FnOnce() + Send + 'static) {
        self.spawn_blocking(work);
    }
}

/// What sessions and loads share.
#[derive(Debug)]
pub(crate) struct Shared {
    store: Mutex<Store>,
    scene: Mutex<Arc<Scene>>,
    /// Scenes of before: whoever draws must not be the last to let go of one.
    retired: Mutex<Vec<Arc<Scene>>>,
    lookouts: Mutex<Lookouts>,
    wake: Notify,
    /// Counts everything that may change a selection.
    news: watch::Sender<u64>,
    pub(crate) sessions: AtomicUsize,
}

impl Shared {
    pub(crate) fn new(scene: Scene, budget_bytes: usize, limits: Limits) -> Self {
        Self {
            store: Mutex::new(Store::new(budget_bytes, limits)),
            scene: Mutex::new(Arc::new(scene)),
            retired: Mutex::default(),
            lookouts: Mutex::default(),
            wake: Notify::new(),
            news: watch::Sender::new(0),
            sessions: AtomicUsize::new(0),
        }
    }

    /// Waits for whoever else works on the tables: microseconds, but never for the frame.
    pub(crate) fn store(&self) -> MutexGuard<'_, Store> {
        // Every change leaves the tables whole before it can panic, but for a passed budget.
        lock(&self.store)
    }

    /// The tables, if nobody works on them.
    pub(crate) fn try_store(&self) -> Option<MutexGuard<'_, Store>> {
        try_lock(&self.store)
    }

    /// What sessions look ahead for, unless somebody else is at it.
    pub(crate) fn try_lookouts(&self) -> Option<MutexGuard<'_, Lookouts>> {
        try_lock(&self.lookouts)
    }

    pub(crate) fn lookouts(&self) -> MutexGuard<'_, Lookouts> {
        lock(&self.lookouts)
    }

    pub(crate) fn scene(&self) -> Arc<Scene> {
        Arc::clone(&lock(&self.scene))
    }

    /// The datasets of now, if nobody is just replacing them.
    pub(crate) fn try_scene(&self) -> Option<Arc<Scene>> {
        try_lock(&self.scene).map(|scene| Arc::clone(&scene))
    }

    /// Makes another scene visible to every session, unless it does not follow from the present
    /// one; whether it did.
    pub(crate) fn replace_scene(&self, before: &Arc<Scene>, after: Scene) -> bool {
        let mut scene = lock(&self.scene);
        let current = Arc::ptr_eq(&scene, before);
        if current {
            let before = std::mem::replace(&mut *scene, Arc::new(after));
            lock(&self.retired).push(before);
        }
        let after = Arc::clone(&scene);
        drop(scene);
        if current {
            self.store().forget(|number| after.place(number).is_none());
            self.tell();
        }
        current
    }

    pub(crate) fn stats(&self) -> Stats {
        self.store().stats
    }

    pub(crate) fn subscribe(&self) -> watch::Receiver<u64> {
        self.news.subscribe()
    }

    /// There are requests, or memory for them.
    pub(crate) fn wake(&self) {
        step();
        self.wake.notify_one();
    }

    pub(crate) fn tell(&self) {
        step();
        self.news.send_modify(|news| *news = news.wrapping_add(1));
    }

    /// Starts loads for as long as the runtime lives.
    ///
    /// # Cancel safety
    ///
    /// Dropping it between loads starts no more; those under way end in the store.
    pub(crate) async fn dispatch(self: Arc<Self>, threads: impl Threads) {
        loop {
            self.wake.notified().await;
            self.start(&threads);
        }
    }

    /// Starts as many loads as may run, looks ahead, and tells media what may come. For whoever can wait
    /// for threads to be started.
    pub(crate) fn start(self: &Arc<Self>, threads: &impl Threads) {
        while let Some(request) = self.next() {
            let shared = Arc::clone(self);
            let load = Load { shared, work: request.work, ended: false };
            threads.start(move || load.run(&request));
        }
        while let Some(look) = self.next_look() {
            let shared = Arc::clone(self);
            threads.start(move || shared.look(look));
        }
        let advice = self.store().take_advice();
        if !advice.is_empty() {
            let shared = Arc::clone(self);
            threads.start(move || shared.advise(&advice));
        }
    }

    fn next_look(&self) -> Option<Look> {
        self.lookouts().next()
    }

    fn look(&self, mut look: Look) {
        let mut ended = Ended { shared: self, look: None };
        look.search();
        // Whoever draws finds the tables free in between.
        let requests = look.requests(|work| self.store().needs_load(work));
        look.ask(requests, &mut self.store());
        ended.look = Some(look);
    }

    fn advise(&self, advice: &[Request]) {
        for request in advice {
            request.dataset.pages.advise(&request.entry);
        }
        self.store().end_advice();
        self.wake();
    }

    /// The next load to start; if there is none for want of memory, sessions are told.
    fn next(&self) -> Option<Request> {
        let (request, stalled) = {
            let mut store = self.store();
            (store.next(), store.stalled)
        };
        if request.is_none() && stalled {
            self.tell();
        }
        request
    }
}

impl Shared {
    /// How often it is looked for what may be tried again or let go of.
    const LOOK_EVERY: Duration = Duration::from_millis(250);

    /// Tells sessions when what failed may be tried again, and lets go of scenes that nobody draws
    /// any more, for as long as the runtime lives.
    ///
    /// # Cancel safety
    ///
    /// It may be dropped at any time.
    pub(crate) async fn tidy(self: Arc<Self>) {
        let mut last = Instant::now();
        loop {
            sleep(Self::LOOK_EVERY).await;
            let now = Instant::now();
            let is_due = self.store().has_attempt(last, now);
            if is_due {
                self.tell();
            }
            last = now;
            self.let_go();
        }
    }

    /// Lets go of scenes that nobody draws any more, and of what was on the screen when its dataset went.
    pub(crate) fn let_go(&self) {
        let mut retired = lock(&self.retired);
        let unused = |scene: &mut Arc<Scene>| Arc::strong_count(scene) == 1;
        let unused: Vec<_> = retired.extract_if(.., unused).collect();
        drop(retired);
        if !unused.is_empty() {
            let now = self.scene();
            self.store().forget(|number| now.place(number).is_none());
        }
    }
}

/// The end of a search ahead: given up, if it has none.
struct Ended<'a> {
    shared: &'a Shared,
    look: Option<Look>,
}

impl Drop for Ended<'_> {
    fn drop(&mut self) {
        self.shared.lookouts().end(self.look.take());
        self.shared.wake();
    }
}

/// A load under way. Dropped before its end, it fails: memory and waiters are not forgotten.
struct Load {
    shared: Arc<Shared>,
    work: Work,
    ended: bool,
}

impl Load {
    fn run(mut self, request: &Request) {
        let PageName { dataset, page } = self.work.name();
        let outcome = match self.read(request) {
            Ok(outcome) => outcome,
            Err(error) => {
                debug!(dataset, %page, error = &error as &dyn std::error::Error, "load failed");
                Outcome::Failed(in_words(&error).into())
            }
        };
        self.ended = true;
        if let Outcome::Cancelled = outcome {
            // Ended in the store already, in one step with the look at who wants it.
            return;
        }
        self.shared.store().finish(self.work, outcome);
        trace!(dataset, %page, "loaded");
    }

    fn read(&self, request: &Request) -> Result<Outcome, ArchiveError> {
        let PageName { dataset, page } = self.work.name();
        let pages = &request.dataset.pages;
        if self.shared.store().cancel_if_unwanted(self.work) {
            return Ok(Outcome::Cancelled);
        }
        if let Work::Children(_) = self.work {
            for child in request.dataset.info.grid.pyramid().children(page) {
                pages.find(child)?;
            }
            return Ok(Outcome::Loaded(None));
        }
        let is_wanted = || self.shared.store().is_wanted(self.work);
        let payload = loop {
            let payload = pages.payload_while(&request.entry, &is_wanted)?;
            if self.shared.store().cancel_if_unwanted(self.work) {
                return Ok(Outcome::Cancelled);
            }
            // Given up, it may be wanted again.
            if let Some(payload) = payload {
                break payload;
            }
        };
        let texels = pages.decode(&request.entry, &payload)?;
        let resident = ResidentPage { dataset, entry: request.entry, page: texels };
        Ok(Outcome::Loaded(Some(Arc::new(resident))))
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        // A second end could be that of the next load of the same page.
        if !self.ended {
            let failed = Outcome::Failed("the load was given up".into());
            self.shared.store().finish(self.work, failed);
        }
        self.shared.wake();
        self.shared.tell();
    }
}
