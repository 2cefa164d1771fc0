//! Decoded pages on a hard budget, and the loads that bring them: plain data, no threads.
//!
//! ```text
//!   resident (by last use)            reserved for loads under way
//!   [############## evictable][pinned ####]+[####]  <= budget, at every moment
//! ```
//!
//! A page is pinned while anybody else holds it: the table's own [`Arc`] is then not the only one.
//! Nobody can come to hold it but through the table, so that a count of one is final as long as the
//! table is not asked.
//!
//! A session's requests are those of its last update: older ones lose. Where memory or loads are
//! short, sessions take turns, and what is only expected to be needed waits for all of them.

use std::collections::{BTreeMap, HashSet, VecDeque};
use std::num::NonZeroUsize;
use std::ops::Bound;
use std::sync::Arc;
use std::time::Duration;

use areoid_formats::address::PageAddress;
use areoid_formats::archive::{PageEntry, Payload};
use lru::LruCache;
use rustc_hash::{FxBuildHasher, FxHashMap};
use tokio::time::Instant;

use crate::scene::Dataset;
use crate::selection::ResidentPage;
use crate::stats::Stats;

/// Which page of which dataset.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) struct PageName {
    pub(crate) dataset: usize,
    pub(crate) page: PageAddress,
}

/// Something to be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) enum Work {
    /// What the index says of the children of a page.
    Children(PageName),
    /// The texels of a page.
    Texels(PageName),
}

impl Work {
    pub(crate) fn name(self) -> PageName {
        match self {
            Self::Children(name) | Self::Texels(name) => name,
        }
    }
}

/// A wish for a load.
#[derive(Clone, Debug)]
pub(crate) struct Request {
    pub(crate) work: Work,
    pub(crate) dataset: Arc<Dataset>,
    /// The entry of the page.
    pub(crate) entry: PageEntry,
    /// The most memory that the load can take, its result included.
    pub(crate) bytes: usize,
}

/// How a load ended.
#[derive(Debug)]
pub(crate) enum Outcome {
    /// What was read: nothing to keep for an index.
    Loaded(Option<Arc<ResidentPage>>),
    Failed(Arc<str>),
    /// Nobody wanted it any more.
    Cancelled,
}

/// How much may be loaded at a time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    pub(crate) loads: usize,
    pub(crate) bytes: usize,
}

#[derive(Debug)]
struct Slot {
    page: Arc<ResidentPage>,
    /// Loaded ahead of any need, and not needed yet.
    ahead: bool,
}

#[derive(Debug)]
struct Loading {
    bytes: usize,
    ahead: bool,
}

/// Why there is no page, and when to try again.
#[derive(Debug)]
struct Failure {
    error: Arc<str>,
    times: u32,
    again: Instant,
}

#[derive(Debug, Default)]
struct Queue {
    /// Most urgent first.
    requests: VecDeque<Request>,
    /// What will be needed if the view goes on as it does.
    ahead: VecDeque<Request>,
    /// Of the last update, those that have been started included.
    wanted: HashSet<Work, FxBuildHasher>,
    wanted_ahead: HashSet<Work, FxBuildHasher>,
    /// Held so that they stay.
    roots: Vec<Arc<ResidentPage>>,
}

/// See the module.
#[derive(Debug)]
pub(crate) struct Store {
    /// By last use.
    slots: LruCache<PageName, Slot, FxBuildHasher>,
    loading: FxHashMap<Work, Loading>,
    failed: FxHashMap<Work, Failure>,
    /// By session.
    queues: BTreeMap<u64, Queue>,
    last_served: u64,
    limits: Limits,
    /// Bytes loaded or being loaded ahead of any need, and not needed yet.
    ahead_bytes: usize,
    /// What media are to be told next.
    advice: Vec<Request>,
    is_advising: bool,
    /// What they have been told, and has not been loaded since.
    advised: LruCache<PageName, (), FxBuildHasher>,
    /// Whether the next load has to wait for memory that nothing under way will free.
    pub(crate) stalled: bool,
    pub(crate) stats: Stats,
}

impl Store {
    /// The part of the budget that may hold what is not needed yet.
    const AHEAD: usize = 4;

    /// Pages that media were told of and that are remembered.
    const ADVISED: NonZeroUsize = NonZeroUsize::new(4096).expect("not 0");

    pub(crate) fn new(budget_bytes: usize, limits: Limits) -> Self {
        Self {
            slots: LruCache::unbounded_with_hasher(FxBuildHasher),
            loading: FxHashMap::default(),
            failed: FxHashMap::default(),
            queues: BTreeMap::new(),
            last_served: 0,
            limits,
            ahead_bytes: 0,
            advice: Vec::new(),
            is_advising: false,
            advised: LruCache::with_hasher(Self::ADVISED, FxBuildHasher),
            stalled: false,
            stats: Stats { budget_bytes, ..Stats::default() },
        }
    }

    pub(crate) fn add_session(&mut self, session: u64) {
        self.queues.insert(session, Queue::default());
    }

    pub(crate) fn remove_session(&mut self, session: u64) {
        self.queues.remove(&session);
    }

    /// The page, if it is in memory; it becomes the most recently used.
    pub(crate) fn touch(&mut self, name: PageName) -> Option<Arc<ResidentPage>> {
        let slot = self.slots.get_mut(&name)?;
        if slot.ahead {
            slot.ahead = false;
            self.stats.ahead_used += 1;
            self.ahead_bytes -= slot.page.page.bytes();
        }
        Some(Arc::clone(&slot.page))
    }

    /// Whether the page is in memory, which uses it in no way.
    pub(crate) fn holds(&self, name: PageName) -> bool {
        self.slots.contains(&name)
    }

    /// Why something cannot be had, unless it is time to try again.
    pub(crate) fn error(&self, work: Work) -> Option<&Arc<str>> {
        if self.failed.is_empty() {
            return None;
        }
        let failure = self.failed.get(&work)?;
        (Instant::now() < failure.again).then_some(&failure.error)
    }

    /// Whether something is not there, or not known to be, and may be had.
    pub(crate) fn needs_load(&self, work: Work) -> bool {
        let is_there = matches!(work, Work::Texels(name) if self.holds(name));
        !is_there && self.error(work).is_none()
    }

    /// Whether nothing more will come of a request: it is there, or cannot be had.
    pub(crate) fn is_settled(&self, request: &Request) -> bool {
        let is_there = match request.work {
            Work::Texels(name) => self.holds(name),
            Work::Children(name) => {
                let mut children = request.dataset.info.grid.pyramid().children(name.page);
                children.all(|child| request.dataset.pages.find_resident(child).is_some())
            }
        };
        is_there || self.error(request.work).is_some()
    }

    /// Whether something that failed may be tried again since a moment between two.
    pub(crate) fn has_attempt(&self, after: Instant, until: Instant) -> bool {
        self.failed.values().any(|failure| failure.again > after && failure.again <= until)
    }

    /// Replaces what a session asks for.
    pub(crate) fn replace_requests(&mut self, session: u64, requests: Vec<Request>) {
        let queue = self.queues.entry(session).or_default();
        queue.wanted.clear();
        queue.wanted.extend(requests.iter().map(|request| request.work));
        queue.requests = requests.into();
        self.stalled = false;
    }

    /// Replaces what a session expects to ask for; one that is gone expects nothing.
    pub(crate) fn replace_ahead(&mut self, session: u64, requests: Vec<Request>) {
        let Some(queue) = self.queues.get_mut(&session) else { return };
        queue.wanted_ahead.clear();
        queue.wanted_ahead.extend(requests.iter().map(|request| request.work));
        queue.ahead = requests.into();
    }

    /// Notes what media are to be told of: pages that will probably be asked for, each once; nothing while
    /// one is slow to hear what it is told.
    pub(crate) fn advise(&mut self, requests: impl IntoIterator<Item = Request>) {
        if self.is_advising {
            return;
        }
        for request in requests {
            if let Work::Texels(name) = request.work
                && self.advised.put(name, ()).is_none()
            {
                self.stats.advised += 1;
                self.advice.push(request);
            }
        }
    }

    /// What media are to be told, once; none while they are told of others.
    pub(crate) fn take_advice(&mut self) -> Vec<Request> {
        if self.is_advising {
            return Vec::new();
        }
        let advice = std::mem::take(&mut self.advice);
        self.is_advising = !advice.is_empty();
        advice
    }

    /// Media have been told.
    pub(crate) fn end_advice(&mut self) {
        self.is_advising = false;
    }

    /// Holds on to roots, of all sessions a tenth of the budget at most.
    pub(crate) fn pin_roots(&mut self, session: u64, roots: &mut Vec<Arc<ResidentPage>>) {
        let bytes = |roots: &[Arc<ResidentPage>]| -> usize {
            roots.iter().map(|root| root.page.bytes()).sum()
        };
        let others = self.queues.iter().filter(|(other, _)| **other != session);
        let mut total: usize = others.map(|(_, queue)| bytes(&queue.roots)).sum();
        let most = self.stats.budget_bytes / 10;
        roots.retain(|root| {
            let fits = total + root.page.bytes() <= most;
            total += if fits { root.page.bytes() } else { 0 };
            fits
        });
        std::mem::swap(&mut self.queues.entry(session).or_default().roots, roots);
    }

    /// The roots that are pinned for a session.
    pub(crate) fn roots(&self, session: u64) -> &[Arc<ResidentPage>] {
        self.queues.get(&session).map_or(&[], |queue| &queue.roots)
    }

    /// Whether a load may start, as far as that can be told without trying.
    pub(crate) fn is_waiting(&self) -> bool {
        let mut requests =
            self.queues.values().flat_map(|queue| queue.requests.iter().chain(&queue.ahead));
        self.loading.len() < self.limits.loads && requests.any(|request| !self.has(request.work))
    }

    /// The next load to start, its memory reserved: the most urgent one of each session in turn.
    pub(crate) fn next(&mut self) -> Option<Request> {
        if self.loading.len() >= self.limits.loads {
            return None;
        }
        let mut starved = false;
        if let Some(request) = self.next_of(false, &mut starved) {
            return Some(request);
        }
        self.stalled = starved && self.loading.is_empty();
        // What may be needed later takes half of the loads, and nothing that is needed now.
        let is_idle = !starved && self.loading.len() < self.limits.loads.div_ceil(2);
        if is_idle { self.next_of(true, &mut false) } else { None }
    }

    fn next_of(&mut self, ahead: bool, starved: &mut bool) -> Option<Request> {
        let later = (Bound::Excluded(self.last_served), Bound::Unbounded);
        let after = self.queues.range(later).map(|(session, _)| *session);
        let before = self.queues.range(..=self.last_served).map(|(session, _)| *session);
        let turn: Vec<u64> = after.chain(before).collect();
        for session in turn {
            while let Some(request) = self.front(session, ahead) {
                let (work, bytes) = (request.work, request.bytes);
                if self.has(work) {
                    self.pop(session, ahead);
                } else if self.may_start(bytes, ahead) && self.reserve(bytes) {
                    self.loading.insert(work, Loading { bytes, ahead });
                    self.ahead_bytes += if ahead { bytes } else { 0 };
                    self.last_served = session;
                    return self.pop(session, ahead);
                } else {
                    *starved = true;
                    break;
                }
            }
        }
        None
    }

    /// Whether a session wants a load, now or soon.
    pub(crate) fn is_wanted(&self, work: Work) -> bool {
        let mut queues = self.queues.values();
        queues.any(|queue| queue.wanted.contains(&work) || queue.wanted_ahead.contains(&work))
    }

    /// Ends a load if nobody wants it any more; whether it did.
    pub(crate) fn cancel_if_unwanted(&mut self, work: Work) -> bool {
        let is_unwanted = !self.is_wanted(work);
        if is_unwanted {
            self.finish(work, Outcome::Cancelled);
        }
        is_unwanted
    }

    /// Ends a load.
    pub(crate) fn finish(&mut self, work: Work, outcome: Outcome) {
        let Some(Loading { bytes: reserved, ahead }) = self.loading.remove(&work) else { return };
        self.stats.reserved_bytes -= reserved;
        self.ahead_bytes -= if ahead { reserved } else { 0 };
        if !matches!(outcome, Outcome::Cancelled | Outcome::Failed(_)) {
            self.failed.remove(&work);
        }
        match outcome {
            Outcome::Cancelled => self.stats.cancelled += 1,
            Outcome::Failed(error) => self.fail(work, error),
            Outcome::Loaded(None) => self.stats.index_loads += 1,
            Outcome::Loaded(Some(page)) => {
                self.stats.loads += 1;
                let advised = self.advised.pop(&work.name()).is_some();
                self.stats.advised_used += u64::from(advised);
                if let Payload::Record { length, .. } = page.entry.payload {
                    self.stats.loaded_bytes += u64::from(length);
                }
                let bytes = page.page.bytes();
                assert!(bytes <= reserved, "a page of {bytes} bytes was promised {reserved}");
                // Somebody may have come to need it meanwhile.
                let needed = self.queues.values().any(|queue| queue.wanted.contains(&work));
                let ahead = ahead && !needed;
                if ahead {
                    self.ahead_bytes += bytes;
                    self.stats.ahead += 1;
                }
                self.slots.put(work.name(), Slot { page, ahead });
                self.stats.pages += 1;
                self.stats.bytes += bytes;
            }
        }
        self.check();
    }

    /// Drops the pages of datasets that are no more, unless they are in use.
    pub(crate) fn forget(&mut self, is_gone: impl Fn(usize) -> bool) {
        let unused = self.slots.iter().filter(|(_, slot)| Arc::strong_count(&slot.page) == 1);
        let gone: Vec<PageName> =
            unused.map(|(name, _)| *name).filter(|name| is_gone(name.dataset)).collect();
        for name in gone {
            self.evict(name);
        }
        self.failed.retain(|work, _| !is_gone(work.name().dataset));
    }

    /// Lets everything that failed be tried again as if for the first time.
    pub(crate) fn forgive(&mut self) {
        self.failed.clear();
    }

    fn fail(&mut self, work: Work, error: Arc<str>) {
        const FIRST: Duration = Duration::from_secs(1);
        const LAST: Duration = Duration::from_secs(60);
        self.stats.errors += 1;
        let times = self.failed.get(&work).map_or(0, |failure| failure.times);
        let wait = FIRST.saturating_mul(1 << times.min(16)).min(LAST);
        let failure = Failure { error, times: times + 1, again: Instant::now() + wait };
        self.failed.insert(work, failure);
    }

    fn may_start(&self, bytes: usize, ahead: bool) -> bool {
        let in_flight = self.stats.reserved_bytes;
        let flies = in_flight == 0 || in_flight + bytes <= self.limits.bytes;
        flies && (!ahead || self.ahead_bytes + bytes <= self.stats.budget_bytes / Self::AHEAD)
    }

    /// Makes room for `bytes` and takes it; whether there was any.
    fn reserve(&mut self, bytes: usize) -> bool {
        let Stats { budget_bytes, bytes: held, reserved_bytes, .. } = self.stats;
        let mut room = budget_bytes - held - reserved_bytes;
        if room < bytes {
            let mut victims = Vec::new();
            for (name, slot) in self.slots.iter().rev() {
                if Arc::strong_count(&slot.page) == 1 {
                    room += slot.page.page.bytes();
                    victims.push(*name);
                    if room >= bytes {
                        break;
                    }
                }
            }
            // Nothing is dropped in vain.
            if room < bytes {
                return false;
            }
            room = budget_bytes - held - reserved_bytes;
            for name in victims {
                room += self.evict(name);
            }
        }
        if room < bytes {
            return false;
        }
        self.stats.reserved_bytes += bytes;
        self.check();
        true
    }

    /// Drops a page that nobody holds; the bytes that this frees.
    fn evict(&mut self, name: PageName) -> usize {
        let Some(Slot { page, ahead }) = self.slots.pop(&name) else { return 0 };
        match Arc::try_unwrap(page) {
            Ok(page) => {
                let bytes = page.page.bytes();
                if ahead {
                    self.ahead_bytes -= bytes;
                    self.stats.ahead_wasted += 1;
                }
                self.stats.evictions += 1;
                self.stats.pages -= 1;
                self.stats.bytes -= bytes;
                bytes
            }
            // In use; or somebody kept a weak reference and used it now.
            Err(page) => {
                self.slots.put(name, Slot { page, ahead });
                0
            }
        }
    }

    /// Law 11.
    fn check(&mut self) {
        let stats = &mut self.stats;
        stats.peak_bytes = stats.peak_bytes.max(stats.bytes + stats.reserved_bytes);
        assert!(stats.peak_bytes <= stats.budget_bytes, "the budget is passed: {stats:?}");
    }

    fn has(&self, work: Work) -> bool {
        let resident = matches!(work, Work::Texels(name) if self.slots.contains(&name));
        resident || self.loading.contains_key(&work) || self.error(work).is_some()
    }

    fn front(&self, session: u64, ahead: bool) -> Option<&Request> {
        let queue = self.queues.get(&session)?;
        if ahead { queue.ahead.front() } else { queue.requests.front() }
    }

    fn pop(&mut self, session: u64, ahead: bool) -> Option<Request> {
        let queue = self.queues.get_mut(&session)?;
        if ahead { queue.ahead.pop_front() } else { queue.requests.pop_front() }
    }
}
