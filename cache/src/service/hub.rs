//! What all connections share: the snapshot, pages in memory, events, counters.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, RwLock};

use areoid_formats::address::PageAddress;
use areoid_formats::catalog::{Catalog, CatalogError};
use quick_cache::Weighter;
use quick_cache::sync::Cache;
use serde_json::json;
use tokio::sync::{Semaphore, broadcast, watch};
use tracing::debug;

use super::listen::Limits;
use super::metrics::{Gauges, Metrics};
use super::pages::StoredPage;
use super::snapshot::{Served, Snapshot, make_room};
use crate::locks::{lock, read, write};

/// Which page of what is served.
pub(super) type PageKey = (u64, PageAddress);

/// The bytes that a stored page takes.
#[derive(Clone, Debug)]
pub(super) struct PageBytes;

impl Weighter<PageKey, Arc<StoredPage>> for PageBytes {
    fn weight(&self, _: &PageKey, page: &Arc<StoredPage>) -> u64 {
        page.weight()
    }
}

/// Heights looked up at a time: each reads and decodes a page or more.
pub(super) const HEIGHTS: usize = 4;

/// Heights that wait for others: they hold places of requests in flight.
const HEIGHTS_WAITING: usize = 64;

/// Events that a client may be behind before it is told to ask for the catalog again.
const EVENTS: usize = 256;

/// The service's state.
///
/// # Threads
///
/// Any thread may call anything. [`Self::refresh`] and [`Self::add`] wait for a disk.
#[derive(Debug)]
pub(super) struct Hub {
    folder: PathBuf,
    now: RwLock<Arc<Snapshot>>,
    /// Held by the one thread that makes the next snapshot.
    changing: Mutex<()>,
    pub(super) pages: Cache<PageKey, Arc<StoredPage>, PageBytes>,
    pub(super) events: broadcast::Sender<Arc<str>>,
    pub(super) stopping: watch::Sender<bool>,
    /// How many insertions are under way or waiting.
    pub(super) inserting: watch::Sender<usize>,
    pub(super) metrics: Metrics,
    pub(super) in_flight: Arc<Semaphore>,
    most_in_flight: usize,
    /// Heights that are looked up at a time.
    pub(super) heights: Arc<Semaphore>,
    /// Those and others that wait for them.
    pub(super) heights_asked: Semaphore,
    /// Clients that listen to events.
    pub(super) listeners: Arc<Semaphore>,
    event: AtomicU64,
}

impl Hub {
    pub(super) fn open(
        folder: &Path,
        memory_bytes: u64,
        limits: Limits,
    ) -> Result<Self, CatalogError> {
        let now = RwLock::new(Arc::new(Snapshot::newest(folder, None)?));
        let pages = usize::try_from(memory_bytes / (128 << 10)).unwrap_or(usize::MAX);
        Ok(Self {
            folder: folder.to_owned(),
            now,
            changing: Mutex::new(()),
            pages: Cache::with_weighter(pages.clamp(16, 1 << 20), memory_bytes, PageBytes),
            events: broadcast::Sender::new(EVENTS),
            stopping: watch::Sender::new(false),
            inserting: watch::Sender::new(0),
            metrics: Metrics::default(),
            in_flight: Arc::new(Semaphore::new(limits.requests)),
            most_in_flight: limits.requests,
            heights: Arc::new(Semaphore::new(HEIGHTS)),
            heights_asked: Semaphore::new(HEIGHTS + HEIGHTS_WAITING),
            listeners: Arc::new(Semaphore::new(limits.connections)),
            event: AtomicU64::new(0),
        })
    }

    pub(super) fn now(&self) -> Arc<Snapshot> {
        Arc::clone(&read(&self.now))
    }

    pub(super) fn folder(&self) -> &Path {
        &self.folder
    }

    pub(super) fn is_stopping(&self) -> bool {
        *self.stopping.borrow()
    }

    /// Shows the newest generation, if it is newer than what is shown, or can be read where that could
    /// not.
    pub(super) fn refresh(&self) -> Result<(), CatalogError> {
        let shown = self.now();
        let newest = Catalog::newest_generation(&self.folder)?;
        if shown.unread() == 0 && newest.is_none_or(|newest| newest <= shown.generation) {
            return Ok(());
        }
        let _changing = lock(&self.changing);
        let before = self.now();
        let next = Snapshot::newest(&self.folder, Some(&before))?;
        if next.generation > before.generation
            || next.generation == before.generation && next.unread() < before.unread()
        {
            self.show(&before, next);
        }
        Ok(())
    }

    /// Shows what is not in the catalog, too, in the place of what is not and is called alike; not if the catalog
    /// has something that is. Whether it is shown.
    pub(super) fn add(&self, added: Vec<Arc<Served>>) -> bool {
        self.change_temporary(|datasets| {
            make_room(datasets, added.iter().map(|served| &served.record));
            let means = |kept: &Served, new: &Served| {
                kept.record.answers_to(&new.record.name)
                    || kept.record.answers_to(new.record.called())
            };
            let mut kept = datasets.values().filter(|served| !served.temporary);
            let is_taken = kept.any(|kept| added.iter().any(|new| means(kept, new)));
            if !is_taken {
                let named = |served: Arc<Served>| (served.record.name.clone(), served);
                datasets.extend(added.into_iter().map(named));
            }
            !is_taken
        })
    }

    /// Takes away what is temporary and answers to `name`; whether there was any.
    ///
    /// # Errors
    ///
    /// [`CatalogError::Part`]: parts of a group go together.
    pub(super) fn take(&self, name: &str) -> Result<bool, CatalogError> {
        let now = self.now();
        let part = now.datasets.get(name).filter(|served| served.temporary);
        if let Some(group) = part.and_then(|served| served.record.group.clone()) {
            return Err(CatalogError::Part { name: name.to_owned(), group });
        }
        Ok(self.change_temporary(|datasets| {
            let all = datasets.len();
            datasets.retain(|_, served| !(served.temporary && served.record.answers_to(name)));
            datasets.len() < all
        }))
    }

    fn change_temporary(
        &self,
        change: impl FnOnce(&mut std::collections::BTreeMap<String, Arc<Served>>) -> bool,
    ) -> bool {
        let _changing = lock(&self.changing);
        let before = self.now();
        let mut datasets = before.datasets.clone();
        let changed = change(&mut datasets);
        if changed {
            self.show(&before, Snapshot::new(before.generation, before.body.clone(), datasets));
        }
        changed
    }

    /// The one step that counts, and word of it.
    fn show(&self, before: &Snapshot, next: Snapshot) {
        let next = Arc::new(next);
        *write(&self.now) = Arc::clone(&next);
        debug!(generation = next.generation, datasets = next.datasets.len(), "catalog changed");
        for (name, served) in &next.datasets {
            match before.datasets.get(name) {
                Some(had) if had.serial == served.serial => {}
                Some(_) => self.tell("replaced", name, &next),
                None => self.tell("inserted", name, &next),
            }
        }
        for name in before.datasets.keys().filter(|name| !next.datasets.contains_key(*name)) {
            self.tell("removed", name, &next);
        }
    }

    fn tell(&self, event: &str, dataset: &str, next: &Snapshot) {
        let id = self.event.fetch_add(1, Relaxed);
        let data = json!({ "dataset": dataset, "generation": next.generation });
        // Nobody may be listening.
        let _ = self.events.send(format!("id: {id}\nevent: {event}\ndata: {data}\n\n").into());
    }

    pub(super) fn metrics_text(&self) -> String {
        let now = self.now();
        self.metrics.text(Gauges {
            in_flight: self.most_in_flight - self.in_flight.available_permits(),
            memory_bytes: self.pages.weight(),
            budget_bytes: self.pages.capacity(),
            generation: now.generation,
            datasets: now.datasets.len(),
            inserting: *self.inserting.borrow(),
        })
    }
}

/// Waits until the service stops.
///
/// # Cancel safety
///
/// Nothing is lost.
pub(super) async fn stopped(stopping: &mut watch::Receiver<bool>) {
    // A hub that is gone has stopped.
    let _ = stopping.wait_for(|stopping| *stopping).await;
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use areoid_formats::catalog::{DatasetRecord, RealDisk, remove_dataset};
    use shuttle::thread;

    use super::*;
    use crate::locks::model::{check, orders};
    use crate::tests::globe_in_a_catalog;

    fn guest(of: &DatasetRecord, name: &str) -> Vec<Arc<Served>> {
        let record = DatasetRecord { name: name.to_owned(), ..of.clone() };
        vec![Served::new(record, Err("not read".to_owned()), true)]
    }

    /// Datasets are added, taken away and removed from the disk at once: whoever listened, and then looked, knows
    /// by the events what there is in the end.
    #[test]
    fn events_tell_what_became_of_a_snapshot_in_any_order() {
        check(orders(300), || {
            let folder = globe_in_a_catalog();
            let hub = Arc::new(Hub::open(folder.path(), 1 << 20, Limits::default()).unwrap());
            let globe = hub.now().datasets["globe"].record.clone();
            let names = |hub: &Hub| hub.now().datasets.keys().cloned().collect::<BTreeSet<_>>();
            let adds = |names: [&'static str; 3], takes: &'static str| {
                let (hub, globe) = (Arc::clone(&hub), globe.clone());
                thread::spawn(move || {
                    for name in names {
                        assert!(hub.add(guest(&globe, name)));
                    }
                    hub.take(takes).unwrap();
                })
            };
            let one = adds(["a", "b", "c"], "b");
            let other = adds(["b", "c", "d"], "a");
            let (removing, path) = (Arc::clone(&hub), folder.path().to_owned());
            let removes = thread::spawn(move || {
                remove_dataset(&RealDisk, &path, "globe").unwrap();
                removing.refresh().unwrap();
            });
            let listening = Arc::clone(&hub);
            let listens = thread::spawn(move || {
                let events = listening.events.subscribe();
                let before = listening.now();
                for _ in 0..3 {
                    thread::yield_now();
                    assert!(listening.now().generation >= before.generation);
                }
                (events, before)
            });
            let (mut events, before) = listens.join().unwrap();
            for thread in [one, other, removes] {
                thread.join().unwrap();
            }
            let mut known: BTreeSet<String> = before.datasets.keys().cloned().collect();
            while let Ok(event) = events.try_recv() {
                let (_, data) = event.split_once("data: ").unwrap();
                let data: serde_json::Value = serde_json::from_str(data).unwrap();
                let name = data["dataset"].as_str().unwrap().to_owned();
                if event.contains("event: removed") {
                    known.remove(&name);
                } else {
                    known.insert(name);
                }
            }
            assert_eq!(known, names(&hub));
            assert!(known.contains("d") && !known.contains("globe"), "{known:?}");
        });
    }

    /// It was published while what is temporary was built.
    #[test]
    fn what_is_temporary_does_not_stand_beside_what_is_kept_and_called_alike() {
        let folder = globe_in_a_catalog();
        let hub = Hub::open(folder.path(), 1 << 20, Limits::default()).unwrap();
        let kept = hub.now().datasets["globe"].record.clone();
        let add = |name: &str, group: Option<&str>| {
            let (name, group) = (name.to_owned(), group.map(str::to_owned));
            let record = DatasetRecord { name, group, ..kept.clone() };
            hub.add(vec![Served::new(record, Err("not read".to_owned()), true)])
        };
        assert!(!add("globe", None) && !add("globe.band", Some("globe")));
        assert_eq!(hub.now().datasets.keys().collect::<Vec<_>>(), ["globe"]);
        assert!(!hub.now().datasets["globe"].temporary);
        assert!(add("guest", None));
        assert_eq!(hub.now().datasets.keys().collect::<Vec<_>>(), ["globe", "guest"]);
    }
}
