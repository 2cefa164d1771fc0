//! One rendering context: views go in, the best pages in memory come out.

use std::sync::atomic::Ordering::Relaxed;
use std::sync::{Arc, MutexGuard};
use std::time::Duration;

use areoid_formats::bounds::Aabb;
use tokio::sync::watch;
use tokio::time::Instant;

use crate::coming::{Coming, Showing};
use crate::engine::{ADOPT_WITHIN, Engine};
use crate::found::Found;
use crate::held::Held;
use crate::lookout::Task;
use crate::matching::{Match, Matcher};
use crate::memo::Memo;
use crate::motion::Motion;
use crate::scene::Scene;
use crate::search::{Hidden, Wish, search};
use crate::selection::{DatasetInfo, ResidentPage, Selection};
use crate::store::{Request, Store};
use crate::view::{Lens, View};

/// A rendering context's way into the cache.
///
/// # Threads
///
/// A session belongs to one thread at a time. [`Self::update`] and [`Self::update_all`] are for
/// the thread that draws; the others wait. Dropping a session takes the cache's locks for a moment.
///
/// # Changes
///
/// When datasets come, go or are replaced, a session goes on drawing those of before until
/// those of now lack no more of the pages that the view needs, or [`Self::ADOPT_WITHIN`] has passed:
/// nothing flashes up, and there is no hole. A selection is wholly of before or wholly of now.
#[derive(Debug)]
pub struct Session {
    engine: Arc<Engine>,
    number: u64,
    shown: Showing,
    next: Option<Coming>,
    /// Whether the last search was of what is to be shown next.
    is_trial: bool,
    memo: Memo,
    matcher: Matcher,
    views: Vec<View>,
    /// Whether these have to be searched for anew, if they are asked for again.
    is_stale: bool,
    /// Of each view.
    motions: Vec<Motion>,
    /// Whether there is something to do for those who load and look ahead.
    is_asking: bool,
    /// When it was last looked ahead, and how often it was.
    looked: Option<Instant>,
    looks: u32,
    hidden: Hidden,
    exaggeration: f64,
    /// Whether pages are loaded that are only expected to be needed; so at first.
    pub look_ahead: bool,
    /// Whether [`Selection::beneath`] is asked for: mostly a third more pages. Not so at first.
    pub blends: bool,
    last: Arc<Selection>,
    held: Held,
    news: watch::Receiver<u64>,
    budget_bytes: usize,
}

impl Session {
    /// How long a session draws datasets that have been replaced or removed.
    pub const ADOPT_WITHIN: Duration = ADOPT_WITHIN;

    /// How far the view is expected to go on as it does.
    const LOOK_AHEAD: Duration = Duration::from_millis(500);

    /// The same, for what media are told to bring nearer.
    const LOOK_FAR_AHEAD: Duration = Duration::from_secs(2);

    /// How often it is looked ahead at most, and of how many looks one goes far.
    const LOOK_EVERY: Duration = Duration::from_millis(50);
    const FAR_OF: u32 = 10;

    pub(crate) fn new(engine: Arc<Engine>, number: u64) -> Self {
        let shared = engine.shared();
        let (scene, news) = (shared.scene(), shared.subscribe());
        let budget_bytes = {
            let mut store = shared.store();
            store.add_session(number);
            store.stats.budget_bytes
        };
        shared.sessions.fetch_add(1, Relaxed);
        let last = Arc::new(Selection::none(scene.generation));
        Self {
            engine,
            number,
            shown: Showing { scene, found: Found::default() },
            next: None,
            is_trial: false,
            memo: Memo::default(),
            matcher: Matcher::default(),
            views: Vec::new(),
            is_stale: false,
            motions: Vec::new(),
            is_asking: false,
            looked: None,
            looks: 0,
            hidden: Hidden::default(),
            exaggeration: 1.0,
            look_ahead: true,
            blends: false,
            last,
            held: Held::default(),
            news,
            budget_bytes,
        }
    }

    /// From the next update on, nothing is loaded or shown of the datasets that `hides` names: those
    /// that a user has switched off. It is asked about datasets in sight, in each search.
    pub fn hide(&mut self, hides: impl Fn(&DatasetInfo) -> bool + Send + Sync + 'static) {
        self.hidden = Hidden(Some(Arc::new(hides)));
        self.is_stale = true;
    }

    /// From the next update on, heights are taken so many times, 0 or more: their errors are as many times as
    /// large, and terrain that is out of sight may come into it. What is no such number is taken for 1.
    pub fn exaggerate(&mut self, times: f64) {
        let times = if times.is_finite() && times >= 0.0 { times } else { 1.0 };
        if times != self.exaggeration {
            self.exaggeration = times;
            self.is_stale = true;
        }
    }

    /// [`Self::update_all`] of one view.
    pub fn update(&mut self, view: &View) -> Arc<Selection> {
        self.update_all(std::slice::from_ref(view))
    }

    /// The best pages in memory for `views`, which one search serves: the eyes of a stereo pair, the
    /// tiles of a wall. What is missing is asked for, in order of need; what the views before asked
    /// for and these do not is no longer.
    ///
    /// It never waits: not for a disk, not for a decoder, not for a lock. In the rare moment in
    /// which another thread works on the tables, the last selection is returned once more. While
    /// neither the views nor anything else changes it allocates nothing.
    pub fn update_all(&mut self, views: &[View]) -> Arc<Selection> {
        let now = Instant::now();
        self.motions.resize_with(views.len(), Motion::default);
        for (motion, view) in self.motions.iter_mut().zip(views) {
            motion.observe(view, now);
        }
        let is_same = self.views == views && !self.is_stale;
        if is_same && self.next.is_none() && !self.has_news() {
            return Arc::clone(&self.last);
        }
        self.search(views, now);
        let engine = Arc::clone(&self.engine);
        if self.settle_on(|| engine.shared().try_store(), now) {
            if std::mem::take(&mut self.is_asking) {
                engine.shared().wake();
            }
        } else {
            // It is tried again even if the views stay.
            self.is_stale = true;
            self.engine.repeated.fetch_add(1, Relaxed);
        }
        Arc::clone(&self.last)
    }

    /// Whether anything happened since the last [`Self::update`] or [`Self::settled`] began that
    /// may change the selection of an unchanged view. Never waits.
    #[must_use]
    pub fn has_news(&self) -> bool {
        let is_ready = self.next.as_ref().is_some_and(Coming::is_ready);
        is_ready || self.news.has_changed().unwrap_or(false)
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
            let now = Instant::now();
            self.search(std::slice::from_ref(view), now);
            // It speaks of this view's requests from the second look on.
            let stalled = asked && engine.shared().store().stalled;
            self.settle_on(|| Some(engine.shared().store()), now);
            engine.shared().wake();
            asked = true;
            if self.next.as_ref().is_some_and(Coming::is_ready) {
                continue;
            }
            let is_met = self.last.missing == 0 && self.next.is_none();
            if is_met || stalled || self.news.changed().await.is_err() {
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

    fn search(&mut self, views: &[View], now: Instant) {
        self.news.mark_unchanged();
        self.is_stale = false;
        self.views.clear();
        self.views.extend_from_slice(views);
        if let Some(scene) = self.engine.shared().try_scene() {
            self.expect(scene, views, now);
        }
        let (exaggeration, hidden) = (self.exaggeration, &self.hidden);
        let (allowance, blends) = (self.allowance(), self.blends);
        let all = Wish { views, exaggeration, hidden, allowance, blends, only: None };
        let is_first = self.is_first();
        let may_be_shown = |next: &Coming| next.is_ready() || next.is_late(now) || is_first;
        self.is_trial = self.next.as_ref().is_some_and(may_be_shown);
        let mut visited = 0;
        match &mut self.next {
            Some(Coming { showing: Showing { scene, found }, .. }) if self.is_trial => {
                search(scene, &mut self.memo, all, found);
                visited += found.visited;
            }
            next => {
                let Showing { scene, found } = &mut self.shown;
                search(scene, &mut self.memo, all, found);
                visited += found.visited;
                if let Some(next) = next {
                    visited += next.search(&mut self.memo, all, found.tolerance_px);
                }
            }
        }
        self.engine.visited.fetch_add(visited as u64, Relaxed);
    }

    /// Searches what is shown, for the views that were searched for last.
    fn search_shown(&mut self) {
        let (views, exaggeration, hidden) = (&self.views, self.exaggeration, &self.hidden);
        let (allowance, blends) = (self.allowance(), self.blends);
        let wish = Wish { views, exaggeration, hidden, allowance, blends, only: None };
        let Showing { scene, found } = &mut self.shown;
        search(scene, &mut self.memo, wish, found);
        self.engine.visited.fetch_add(found.visited as u64, Relaxed);
    }

    /// Whether nothing was ever shown.
    fn is_first(&self) -> bool {
        self.last.pages.is_empty() && self.last.generation == 0
    }

    /// How far from the body's center ground is at least that a view moves above.
    fn ground_m(&self, scene: &Scene) -> f64 {
        scene.radii(self.exaggeration.min(1.0))[0].0
    }

    fn allowance(&self) -> usize {
        let sessions = self.engine.shared().sessions.load(Relaxed).max(1);
        self.budget_bytes / 2 / sessions
    }

    /// Notes that `scene` is the one to be shown; at once, if what has changed is out of sight.
    fn expect(&mut self, scene: Arc<Scene>, views: &[View], now: Instant) {
        let known = self.next.as_ref().map_or(&self.shown, |next| &next.showing);
        if Arc::ptr_eq(&scene, &known.scene) {
            return;
        }
        let (radii, shift_m) = (scene.radii(self.exaggeration), scene.shift_m(self.exaggeration));
        let lenses: Vec<Lens> = views.iter().map(|view| Lens::new(view, radii)).collect();
        let is_unseen =
            |bounds: Aabb| lenses.iter().all(|lens| lens.misses_box(&bounds.grown(shift_m)));
        if self.shown.scene.changes(&scene).is_some_and(|mut changes| changes.all(is_unseen)) {
            self.shown.scene = scene;
            self.memo.keep(|number| self.shown.scene.place(number).is_some());
            self.next = None;
            return;
        }
        self.next = Some(Coming::new(scene, &self.shown.scene, self.next.take(), now));
    }

    /// Matches what was found with what is there, selects from it, and asks for the rest; whether `lock` gave
    /// the tables.
    fn settle_on<'a>(
        &mut self,
        lock: impl Fn() -> Option<MutexGuard<'a, Store>>,
        now: Instant,
    ) -> bool {
        let Some(mut store) = lock() else { return false };
        let mut trial = None;
        if let Some(next) = self.next.as_ref().filter(|_| self.is_trial) {
            let mut requests = Vec::new();
            let (memo, held) = (&self.memo, &self.held);
            let after = self.matcher.compare(&next.showing, memo, held, &mut store, &mut requests);
            // In a view that has hardly moved, the picture lacks what it lacked a frame ago.
            let ground_m = self.ground_m(&next.showing.scene);
            let is_steady = self.motions.iter().all(|motion| motion.is_steady(ground_m));
            let is_as_whole = is_steady && after.missing <= self.last.missing;
            if after.missing == 0 || is_as_whole || self.is_first() || next.is_late(now) {
                self.adopt();
                self.select(&mut store, after, requests, now);
                return true;
            }
            // Which of both states lacks more, the same view has to tell.
            drop(store);
            self.search_shown();
            let Some(again) = lock() else { return false };
            (store, trial) = (again, Some((after, requests)));
        }
        let mut requests = Vec::new();
        let (memo, held) = (&self.memo, &self.held);
        let matched = self.matcher.compare(&self.shown, memo, held, &mut store, &mut requests);
        match (trial, &mut self.next) {
            (Some((after, others)), _) if after.missing <= matched.missing => {
                self.adopt();
                self.select(&mut store, after, others, now);
                return true;
            }
            (Some((_, others)), Some(next)) => {
                next.fail(&others);
                // What the picture lacks comes before what the next one will.
                requests.extend(others);
            }
            (_, Some(next)) => next.ask(&mut self.matcher, &self.memo, &store, &mut requests),
            (_, None) => {}
        }
        self.select(&mut store, matched, requests, now);
        true
    }

    /// Shows what was to be shown next.
    fn adopt(&mut self) {
        if let Some(next) = self.next.take() {
            self.shown = next.showing;
            self.memo.keep(|number| self.shown.scene.place(number).is_some());
        }
    }

    /// Turns what there is of what was found into a selection, and what there is not into requests.
    fn select(&mut self, store: &mut Store, matched: Match, requests: Vec<Request>, now: Instant) {
        let Showing { found, .. } = &self.shown;
        let Match { pages, roots: mut pinned, beneath, missing, failed, .. } = matched;
        let (mut datasets, mut error_px) = (matched.datasets, matched.error_px);
        let stats = &mut store.stats;
        let missed = (missing - matched.missing_beneath).min(found.wanted.len());
        stats.hits += (found.wanted.len() - missed) as u64;
        stats.misses += missing as u64;
        store.pin_roots(self.number, &mut pinned);
        store.replace_requests(self.number, requests);
        let found = &self.shown.found;
        let wanted = found.wanted.iter().chain(&found.beneath);
        let wanted = wanted.map(|&place| found.seen[place].name());
        self.held.renew(pages.iter().chain(&beneath), wanted, store);
        if missing == 0 && self.next.is_none() && self.look_ahead {
            self.look_ahead(store, now);
        }
        self.is_asking |= store.is_waiting();

        let Showing { scene, found } = &self.shown;
        // Roots for which there is no room are not among those found.
        if self.views.first().is_some_and(|view| found.tolerance_px > view.tolerance_px) {
            error_px = error_px.max(found.tolerance_px);
        }
        let before = &self.last;
        let roots = roots_beside(&pages, store.roots(self.number));
        let same_pages = are_same(&before.pages, &pages)
            && are_same(&before.roots, &roots)
            && are_same(&before.beneath, &beneath);
        datasets.sort_unstable();
        datasets.dedup();
        // A number stands for one dataset for good.
        let numbers = datasets.iter().map(|(number, _)| *number);
        let datasets = if before.datasets.numbers().eq(numbers) {
            before.datasets.clone()
        } else {
            scene.infos.some(&datasets)
        };
        let same = same_pages && before.datasets.is(&datasets);
        self.last = Arc::new(Selection {
            generation: before.generation + u64::from(!same),
            scene: scene.generation,
            datasets,
            pages,
            roots,
            beneath,
            missing,
            failed,
            tolerance_px: found.tolerance_px,
            error_px,
            visited: found.visited,
            wanted: found.wanted.len(),
            culled: found.culled,
        });
    }

    /// Has it looked where the view will be in a moment, for what it will need there; or, more rarely, where
    /// it will be after that, for what media are to be told of.
    fn look_ahead(&mut self, store: &mut Store, now: Instant) {
        if self.looked.is_some_and(|last| now < last + Self::LOOK_EVERY) {
            return;
        }
        self.looked = Some(now);
        self.looks = self.looks.wrapping_add(1);
        let is_far = self.looks.is_multiple_of(Self::FAR_OF);
        let reach = if is_far { Self::LOOK_FAR_AHEAD } else { Self::LOOK_AHEAD };
        let scene = &self.shown.scene;
        let ground_m = self.ground_m(scene);
        let mut moves = false;
        let mut expect = |(motion, view): (&Motion, &View)| {
            let expected = motion.predict(reach, ground_m);
            moves |= expected.is_some();
            expected.unwrap_or(*view)
        };
        let views: Vec<View> = self.motions.iter().zip(&self.views).map(&mut expect).collect();
        if moves {
            if let Some(mut lookouts) = self.engine.shared().try_lookouts() {
                let (scene, hidden) = (Arc::clone(scene), self.hidden.clone());
                let (exaggeration, allowance, blends) =
                    (self.exaggeration, self.allowance(), self.blends);
                let task = Task { scene, views, exaggeration, hidden, allowance, blends, is_far };
                lookouts.post(self.number, task);
                self.is_asking = true;
            }
        } else {
            store.replace_ahead(self.number, Vec::new());
        }
    }
}

impl Drop for Session {
    fn drop(&mut self) {
        let shared = self.engine.shared();
        shared.sessions.fetch_sub(1, Relaxed);
        {
            let mut store = shared.store();
            self.held.renew([].iter(), [].into_iter(), &mut store);
            store.remove_session(self.number);
        }
        shared.lookouts().remove(self.number);
        // What it held may make room for others.
        self.last = Arc::new(Selection::none(self.last.scene));
        shared.wake();
    }
}

fn are_same(some: &[Arc<ResidentPage>], others: &[Arc<ResidentPage>]) -> bool {
    some.len() == others.len()
        && some.iter().zip(others).all(|(one, other)| Arc::ptr_eq(one, other))
}

/// Those of `roots` that stand above some of `pages`, which are sorted, and are not among them.
fn roots_beside(
    pages: &[Arc<ResidentPage>],
    roots: &[Arc<ResidentPage>],
) -> Vec<Arc<ResidentPage>> {
    let name = |page: &ResidentPage| (page.entry.page, page.dataset);
    let is_shown =
        |root: &ResidentPage| pages.binary_search_by_key(&name(root), |page| name(page)).is_ok();
    let mut finer: Vec<usize> =
        pages.iter().filter(|page| page.entry.page.level.0 > 0).map(|page| page.dataset).collect();
    finer.sort_unstable();
    let stands_above = |root: &ResidentPage| finer.binary_search(&root.dataset).is_ok();
    roots.iter().filter(|root| stands_above(root) && !is_shown(root)).cloned().collect()
}
