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

use std::collections::{BTreeMap, HashMap, HashSet, VecDeque};
use std::sync::Arc;

use areoid_formats::address::PageAddress;
use areoid_formats::archive::PageEntry;

use crate::selection::ResidentPage;

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
#[derive(Clone, Copy, Debug)]
pub(crate) struct Request {
    pub(crate) work: Work,
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

/// Counts since the cache was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Stats {
    /// Pages read and decoded.
    pub loads: u64,
    /// Blocks of an index asked for.
    pub index_loads: u64,
    /// Wanted pages that were in memory, summed over updates.
    pub hits: u64,
    /// Wanted pages that were not, summed over updates.
    pub misses: u64,
    /// Pages dropped to make room.
    pub evictions: u64,
    /// Loads given up because no view wanted them any more.
    pub cancelled: u64,
    /// Loads that failed, each page once.
    pub errors: u64,
    /// Pages that searches looked at.
    pub visited: u64,
    /// Updates that found the store in use and repeated the last selection.
    pub repeated: u64,
    /// Pages in memory.
    pub pages: usize,
    /// Their bytes.
    pub bytes: usize,
    /// Bytes reserved for loads under way.
    pub reserved_bytes: usize,
    /// The most that both have been together.
    pub peak_bytes: usize,
    /// What they may be.
    pub budget_bytes: usize,
}

#[derive(Debug)]
struct Slot {
    page: Arc<ResidentPage>,
    used: u64,
}

#[derive(Debug, Default)]
struct Queue {
    /// Most urgent first.
    requests: VecDeque<Request>,
    /// Of the last update, those that have been started included.
    wanted: HashSet<Work>,
    /// Held so that they stay.
    roots: Vec<Arc<ResidentPage>>,
}

/// See the module.
#[derive(Debug)]
pub(crate) struct Store {
    slots: HashMap<PageName, Slot>,
    /// By last use, oldest first.
    order: BTreeMap<u64, PageName>,
    clock: u64,
    loading: HashMap<Work, usize>,
    failed: HashMap<Work, Arc<str>>,
    /// By session.
    queues: BTreeMap<u64, Queue>,
    last_served: u64,
    /// Whether the next load has to wait for memory that nothing under way will free.
    pub(crate) stalled: bool,
    pub(crate) stats: Stats,
}

impl Store {
    pub(crate) fn new(budget_bytes: usize) -> Self {
        Self {
            slots: HashMap::new(),
            order: BTreeMap::new(),
            clock: 0,
            loading: HashMap::new(),
            failed: HashMap::new(),
            queues: BTreeMap::new(),
            last_served: 0,
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
        self.order.remove(&slot.used);
        self.clock += 1;
        slot.used = self.clock;
        self.order.insert(self.clock, name);
        Some(Arc::clone(&slot.page))
    }

    pub(crate) fn error(&self, work: Work) -> Option<&Arc<str>> {
        self.failed.get(&work)
    }

    /// Replaces what a session asks for.
    pub(crate) fn replace_requests(&mut self, session: u64, requests: Vec<Request>) {
        let queue = self.queues.entry(session).or_default();
        queue.wanted.clear();
        queue.wanted.extend(requests.iter().map(|request| request.work));
        queue.requests = requests.into();
        self.stalled = false;
    }

    /// Holds on to roots, of all sessions a tenth of the budget at most.
    pub(crate) fn pin_roots(&mut self, session: u64, roots: Vec<Arc<ResidentPage>>) {
        let bytes = |roots: &[Arc<ResidentPage>]| -> usize {
            roots.iter().map(|root| root.page.bytes()).sum()
        };
        let others = self.queues.iter().filter(|(other, _)| **other != session);
        let mut total: usize = others.map(|(_, queue)| bytes(&queue.roots)).sum();
        let most = self.stats.budget_bytes / 10;
        let fitting = roots.into_iter().filter(|root| {
            let fits = total + root.page.bytes() <= most;
            total += if fits { root.page.bytes() } else { 0 };
            fits
        });
        let fitting = fitting.collect();
        self.queues.entry(session).or_default().roots = fitting;
    }

    /// The next load to start, its memory reserved: the most urgent one of each session in turn.
    pub(crate) fn next(&mut self, most_loads: usize) -> Option<Request> {
        if self.loading.len() >= most_loads {
            return None;
        }
        let after = self.queues.range(self.last_served + 1..).map(|(session, _)| *session);
        let before = self.queues.range(..=self.last_served).map(|(session, _)| *session);
        let turn: Vec<u64> = after.chain(before).collect();
        let mut starved = false;
        for session in turn {
            while let Some(request) = self.front(session) {
                if self.has(request.work) {
                    self.pop(session);
                } else if self.reserve(request.bytes) {
                    self.pop(session);
                    self.loading.insert(request.work, request.bytes);
                    self.last_served = session;
                    return Some(request);
                } else {
                    starved = true;
                    break;
                }
            }
        }
        self.stalled = starved && self.loading.is_empty();
        None
    }

    /// Ends a load if nobody wants it any more; whether it did.
    pub(crate) fn cancel_if_unwanted(&mut self, work: Work) -> bool {
        let wanted = self.queues.values().any(|queue| queue.wanted.contains(&work));
        if !wanted {
            self.finish(work, Outcome::Cancelled);
        }
        !wanted
    }

    /// Ends a load.
    pub(crate) fn finish(&mut self, work: Work, outcome: Outcome) {
        let Some(reserved) = self.loading.remove(&work) else { return };
        self.stats.reserved_bytes -= reserved;
        match outcome {
            Outcome::Cancelled => self.stats.cancelled += 1,
            Outcome::Failed(error) => {
                self.stats.errors += 1;
                self.failed.insert(work, error);
            }
            Outcome::Loaded(None) => self.stats.index_loads += 1,
            Outcome::Loaded(Some(page)) => {
                self.stats.loads += 1;
                let bytes = page.page.bytes();
                assert!(bytes <= reserved, "a page of {bytes} bytes was promised {reserved}");
                self.clock += 1;
                self.order.insert(self.clock, work.name());
                self.slots.insert(work.name(), Slot { page, used: self.clock });
                self.stats.pages += 1;
                self.stats.bytes += bytes;
            }
        }
        self.check();
    }

    /// Makes room for `bytes` and takes it; whether there was any.
    fn reserve(&mut self, bytes: usize) -> bool {
        let room = |stats: &Stats| stats.budget_bytes - stats.bytes - stats.reserved_bytes;
        if room(&self.stats) < bytes {
            let mut room = room(&self.stats);
            let mut victims = Vec::new();
            for (&used, name) in &self.order {
                let page = &self.slots[name].page;
                if Arc::strong_count(page) == 1 {
                    room += page.page.bytes();
                    victims.push((used, *name));
                    if room >= bytes {
                        break;
                    }
                }
            }
            // Nothing is dropped in vain.
            if room < bytes {
                return false;
            }
            for (used, name) in victims {
                self.evict(used, name);
            }
        }
        if room(&self.stats) < bytes {
            return false;
        }
        self.stats.reserved_bytes += bytes;
        self.check();
        true
    }

    fn evict(&mut self, used: u64, name: PageName) {
        let Some(slot) = self.slots.remove(&name) else { return };
        match Arc::try_unwrap(slot.page) {
            Ok(page) => {
                self.order.remove(&used);
                self.stats.evictions += 1;
                self.stats.pages -= 1;
                self.stats.bytes -= page.page.bytes();
            }
            // Somebody kept a weak reference and used it now.
            Err(page) => {
                self.slots.insert(name, Slot { page, used });
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
        let resident = matches!(work, Work::Texels(name) if self.slots.contains_key(&name));
        resident || self.loading.contains_key(&work) || self.failed.contains_key(&work)
    }

    fn front(&self, session: u64) -> Option<Request> {
        self.queues.get(&session)?.requests.front().copied()
    }

    fn pop(&mut self, session: u64) {
        if let Some(queue) = self.queues.get_mut(&session) {
            queue.requests.pop_front();
        }
    }

    #[cfg(test)]
    pub(crate) fn holds(&self, name: PageName) -> bool {
        self.slots.contains_key(&name)
    }
}
