//! One rendering context: a view goes in, the best pages in memory come out.

use std::cmp::Ordering;
use std::collections::HashSet;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

use areoid_formats::archive::Payload;
use tokio::sync::watch;

use crate::engine::Engine;
use crate::scene::Scene;
use crate::search::{Found, Memo, Seen, search};
use crate::selection::{FailedPage, ResidentPage, Selection};
use crate::store::{PageName, Request, Store, Work};
use crate::view::View;

/// A rendering context's way into the cache.
///
/// # Threads
///
/// A session belongs to one thread at a time. [`Self::update`] is for the thread that draws; the
/// others wait. Dropping a session takes the store's lock for a moment.
#[derive(Debug)]
pub struct Session {
    engine: Arc<Engine>,
    number: u64,
    scene: Arc<Scene>,
    memo: Memo,
    last: Arc<Selection>,
    news: watch::Receiver<u64>,
    budget_bytes: usize,
}

/// What a search found, against what is in memory.
#[derive(Default)]
struct Match {
    pages: Vec<Arc<ResidentPage>>,
    roots: Vec<Arc<ResidentPage>>,
    /// Places in [`Found::seen`], and what to read there.
    needs: Vec<(usize, Work)>,
    missing: usize,
    failed: Vec<FailedPage>,
}

impl Session {
    pub(crate) fn new(engine: Arc<Engine>, number: u64) -> Self {
        let shared = engine.shared();
        let (scene, news) = (shared.scene(), shared.subscribe());
        let budget_bytes = {
            let mut store = shared.store();
            store.add_session(number);
            store.stats.budget_bytes
        };
        shared.sessions.fetch_add(1, Relaxed);
        let last = Arc::new(Selection {
            generation: 0,
            datasets: Arc::clone(&scene.infos),
            pages: Vec::new(),
            missing: 0,
            failed: Vec::new(),
            tolerance_px: f64::INFINITY,
            visited: 0,
            wanted: 0,
            culled: 0,
        });
        Self { engine, number, scene, memo: Memo::default(), last, news, budget_bytes }
    }

    /// The best pages in memory for `view`. What is missing is asked for, in order of need; what
    /// the view before asked for and this one does not is no longer.
    ///
    /// It never waits: not for a disk, not for a decoder, not for a lock. In the rare moment in
    /// which another thread works on the tables, the last selection is returned once more.
    pub fn update(&mut self, view: &View) -> Arc<Selection> {
        let found = self.search(view);
        let engine = Arc::clone(&self.engine);
        if let Some(mut store) = engine.shared().try_store() {
            self.select(&found, &mut store);
            drop(store);
            engine.shared().wake();
        } else {
            self.engine.repeated.fetch_add(1, Relaxed);
        }
        Arc::clone(&self.last)
    }

    /// Whether anything happened since the last [`Self::update`] or [`Self::settled`] began that
    /// may change the selection of an unchanged view. Never waits.
    #[must_use]
    pub fn has_news(&self) -> bool {
        self.news.has_changed().unwrap_or(false)
    }

    /// The selection for `view` with nothing missing that can be had: pages that cannot be read are
    /// in [`Selection::failed`]. Pages stay missing only where other sessions hold so much that
    /// there is no memory for them.
    ///
    /// # Cancel safety
    ///
    /// Dropping the future stops waiting. Its requests stand until the next update.
    pub async fn settled(&mut self, view: &View) -> Arc<Selection> {
        let engine = Arc::clone(&self.engine);
        let mut asked = false;
        loop {
            let found = self.search(view);
            let stalled = {
                let mut store = engine.shared().store();
                // It speaks of this view's requests from the second look on.
                let stalled = store.stalled && asked;
                self.select(&found, &mut store);
                stalled
            };
            engine.shared().wake();
            asked = true;
            if self.last.missing == 0 || stalled || self.news.changed().await.is_err() {
                return Arc::clone(&self.last);
            }
        }
    }

    /// [`Self::settled`] for a thread without a runtime.
    ///
    /// # Panics
    ///
    /// If called from asynchronous code.
    pub fn settle(&mut self, view: &View) -> Arc<Selection> {
        let engine = Arc::clone(&self.engine);
        engine.handle().block_on(self.settled(view))
    }

    fn search(&mut self, view: &View) -> Found {
        self.news.mark_unchanged();
        if let Some(scene) = self.engine.shared().try_scene()
            && !Arc::ptr_eq(&scene, &self.scene)
        {
            self.scene = scene;
            self.memo.clear();
        }
        let sessions = self.engine.shared().sessions.load(Relaxed).max(1);
        let found = search(&self.scene, &mut self.memo, view, self.budget_bytes / 2 / sessions);
        self.engine.visited.fetch_add(found.visited as u64, Relaxed);
        found
    }

    /// Turns what was found into a selection and into requests.
    fn select(&mut self, found: &Found, store: &mut Store) {
        let Match { pages, roots, needs, missing, failed } = self.compare(found, store);
        let requests = self.requests(found, needs);
        store.stats.hits += (found.wanted.len() - missing.min(found.wanted.len())) as u64;
        store.stats.misses += missing as u64;
        store.pin_roots(self.number, roots);
        store.replace_requests(self.number, requests);

        let before = &self.last;
        let same = Arc::ptr_eq(&before.datasets, &self.scene.infos)
            && before.pages.len() == pages.len()
            && before.pages.iter().zip(&pages).all(|(one, other)| Arc::ptr_eq(one, other));
        self.last = Arc::new(Selection {
            generation: before.generation + u64::from(!same),
            datasets: Arc::clone(&self.scene.infos),
            pages,
            missing,
            failed,
            tolerance_px: found.tolerance_px,
            visited: found.visited,
            wanted: found.wanted.len(),
            culled: found.culled,
        });
    }

    fn compare(&self, found: &Found, store: &mut Store) -> Match {
        let mut result = Match::default();
        let mut used = vec![false; found.seen.len()];
        let mut asked = HashSet::new();
        let name_of = |seen: &Seen| PageName { dataset: seen.dataset, page: seen.node.entry.page };
        let failure = |name: PageName, error: &Arc<str>| FailedPage {
            dataset: name.dataset,
            page: name.page,
            error: Arc::clone(error),
        };

        for (place, seen) in found.seen.iter().enumerate() {
            if seen.parent.is_some() {
                continue;
            }
            let name = name_of(seen);
            match store.touch(name) {
                Some(root) => result.roots.push(root),
                None if store.error(Work::Texels(name)).is_none() => {
                    asked.insert(place);
                    result.needs.push((place, Work::Texels(name)));
                }
                None => {}
            }
        }
        for &wanted in &found.wanted {
            // The page, or else the nearest ancestor that is there; what is not, is asked for.
            let mut next = Some(wanted);
            while let Some(place) = next {
                let seen = &found.seen[place];
                let name = name_of(seen);
                if used[place] {
                    break;
                }
                if let Some(page) = store.touch(name) {
                    used[place] = true;
                    result.pages.push(page);
                    break;
                }
                let error = store.error(Work::Texels(name));
                if place == wanted {
                    match error {
                        Some(error) => result.failed.push(failure(name, error)),
                        None => result.missing += 1,
                    }
                }
                if error.is_none() && asked.insert(place) {
                    result.needs.push((place, Work::Texels(name)));
                }
                next = seen.parent;
            }
        }
        for &place in &found.unindexed {
            let name = name_of(&found.seen[place]);
            match store.error(Work::Children(name)) {
                Some(error) => result.failed.push(failure(name, error)),
                None => {
                    result.missing += 1;
                    result.needs.push((place, Work::Children(name)));
                }
            }
        }
        result.pages.sort_unstable_by_key(|page| (page.entry.page, page.dataset));
        result
    }

    /// In order of need: coarse before fine, near before far, large error first.
    fn requests(&self, found: &Found, mut needs: Vec<(usize, Work)>) -> Vec<Request> {
        // Coarse is what has large texels, in steps of two: levels of two datasets do not compare.
        let coarseness = |seen: &Seen| seen.node.texel_m.max(f64::MIN_POSITIVE).log2().round();
        needs.sort_by(|&(one, one_work), &(other, other_work)| -> Ordering {
            let (a, b) = (&found.seen[one], &found.seen[other]);
            (a.parent.is_some().cmp(&b.parent.is_some()))
                .then(coarseness(b).total_cmp(&coarseness(a)))
                .then(a.distance.total_cmp(&b.distance))
                .then(b.pixels.total_cmp(&a.pixels))
                .then(one_work.cmp(&other_work))
        });
        needs
            .into_iter()
            .map(|(place, work)| {
                let seen = &found.seen[place];
                let entry = seen.node.entry;
                let bytes = match (work, entry.payload) {
                    (Work::Children(_), _) => 0,
                    (Work::Texels(_), Payload::Constant(_)) => {
                        load_bytes(&self.scene, seen.dataset, 0)
                    }
                    (Work::Texels(_), Payload::Record { length, .. }) => {
                        load_bytes(&self.scene, seen.dataset, length as usize)
                    }
                };
                Request { work, entry, bytes }
            })
            .collect()
    }
}

/// The most that a load takes: the stored bytes, and texels with a coverage beside them.
fn load_bytes(scene: &Scene, dataset: usize, stored: usize) -> usize {
    let side = scene.infos[dataset].grid.pyramid().page_side() as usize;
    side * side * (size_of::<f32>() + 1) + stored
}

impl Drop for Session {
    fn drop(&mut self) {
        let shared = self.engine.shared();
        shared.sessions.fetch_sub(1, Relaxed);
        shared.store().remove_session(self.number);
        // What it held may make room for others.
        shared.wake();
    }
}
