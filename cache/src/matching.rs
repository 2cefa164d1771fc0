//! What a search found, against what is in memory: pages to draw, and what to ask for.

use std::sync::Arc;

use areoid_formats::archive::Payload;

use crate::coming::Showing;
use crate::found::{Found, Seen};
use crate::held::Held;
use crate::memo::Memo;
use crate::scene::Scene;
use crate::selection::{FailedPage, ResidentPage};
use crate::store::{PageName, Request, Store, Work};

/// What is there for a view.
#[derive(Default)]
pub(crate) struct Match {
    pub(crate) pages: Vec<Arc<ResidentPage>>,
    pub(crate) roots: Vec<Arc<ResidentPage>>,
    pub(crate) beneath: Vec<Arc<ResidentPage>>,
    pub(crate) missing: usize,
    /// Of them, those that would show beneath others.
    pub(crate) missing_beneath: usize,
    pub(crate) failed: Vec<FailedPage>,
    /// Numbers of the datasets of `pages` and `failed`, and their places in the scene: one for each of those, as
    /// they were found.
    pub(crate) datasets: Vec<(usize, usize)>,
    /// The largest error of `pages`; infinite where there is none for a wanted one.
    pub(crate) error_px: f64,
}

/// Room for comparing, kept from one to the next.
#[derive(Debug, Default)]
pub(crate) struct Matcher {
    /// By place in [`Found::seen`].
    marks: Vec<Mark>,
    needs: Vec<(usize, Work)>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Mark {
    used: bool,
    asked: bool,
    /// Its place among the roots that are there, from 1 on.
    root: usize,
    /// Missing pages for which it would stand in, and no other that is asked for.
    waiting: usize,
}

impl Seen {
    pub(crate) fn name(&self) -> PageName {
        PageName { dataset: self.number, page: self.page }
    }
}

impl Matcher {
    /// One page that stands in is asked for to so many that are missing.
    const FEW: usize = 8;

    /// The pages to draw; what to ask for is added to `requests`, in order of need.
    ///
    /// Of a wanted page that is not there, the nearest ancestor that is stands in. Where many are
    /// missing, the finest ancestors that [`Self::FEW`] of them have in common are asked for first, so
    /// that the picture is soon whole. A few come as soon without.
    pub(crate) fn compare(
        &mut self,
        Showing { scene, found }: &Showing,
        memo: &Memo,
        held: &Held,
        store: &mut Store,
        requests: &mut Vec<Request>,
    ) -> Match {
        self.begin(found);
        held.fetch();
        let mut result = Match::default();
        let failure = |name: PageName, error: &Arc<str>| FailedPage {
            dataset: name.dataset,
            page: name.page,
            error: Arc::clone(error),
        };
        for (place, seen) in found.seen.iter().enumerate() {
            if seen.parent.is_some() {
                continue;
            }
            let name = seen.name();
            match held.get(name, store) {
                Some(root) => {
                    result.roots.push(root);
                    self.marks[place].root = result.roots.len();
                }
                None if store.error(Work::Texels(name)).is_none() => self.ask(place, name),
                None => {}
            }
        }
        for &wanted in &found.wanted {
            let mut next = Some(wanted);
            // Until something can still be had, the one above would be the best there is.
            let mut is_best = true;
            let mut is_shown = false;
            while let Some(place) = next {
                let seen = &found.seen[place];
                if self.marks[place].used {
                    is_shown = true;
                    break;
                }
                let name = seen.name();
                let root = self.marks[place].root.checked_sub(1);
                let page = match root {
                    Some(root) => Some(Arc::clone(&result.roots[root])),
                    None => held.get(name, store),
                };
                if let Some(page) = page {
                    self.marks[place].used = true;
                    is_shown = true;
                    result.error_px = result.error_px.max(seen.pixels);
                    result.pages.push(page);
                    result.datasets.push((seen.number, seen.dataset));
                    break;
                }
                match store.error(Work::Texels(name)) {
                    Some(error) if place == wanted => {
                        result.failed.push(failure(name, error));
                        result.datasets.push((seen.number, seen.dataset));
                    }
                    Some(_) => {}
                    None if is_best => {
                        result.missing += 1;
                        self.marks[place].waiting += 1;
                        self.ask(place, name);
                        is_best = false;
                    }
                    None => {}
                }
                next = seen.parent;
            }
            if !is_shown {
                result.error_px = f64::INFINITY;
            }
        }
        for &place in &found.beneath {
            if self.marks[place].used {
                continue;
            }
            let name = found.seen[place].name();
            if let Some(page) = held.get(name, store) {
                // Where it shows its error is within the tolerance.
                let most_px = found.seen[place].pixels.min(found.tolerance_px);
                result.error_px = result.error_px.max(most_px);
                result.beneath.push(page);
                continue;
            }
            if let Some(error) = store.error(Work::Texels(name)) {
                result.failed.push(failure(name, error));
                result.datasets.push((name.dataset, found.seen[place].dataset));
            } else {
                result.missing += 1;
                result.missing_beneath += 1;
                self.ask(place, name);
            }
        }
        self.ask_for_few(found, store);
        for &place in &found.unindexed {
            let name = found.seen[place].name();
            match store.error(Work::Children(name)) {
                Some(error) => {
                    result.failed.push(failure(name, error));
                    result.datasets.push((name.dataset, found.seen[place].dataset));
                }
                None => {
                    result.missing += 1;
                    self.needs.push((place, Work::Children(name)));
                }
            }
        }
        for pages in [&mut result.pages, &mut result.beneath] {
            // Their names stand in as many places of memory: each is looked up once.
            pages.sort_by_cached_key(|page| (page.entry.page, page.dataset));
        }
        self.end(scene, memo, found, requests);
        result
    }

    /// Asks for what stands in for many.
    fn ask_for_few(&mut self, found: &Found, store: &Store) {
        // Children come after their parents.
        for (place, seen) in found.seen.iter().enumerate().rev() {
            let Some(parent) = seen.parent else { continue };
            let Mark { waiting, asked, .. } = self.marks[place];
            if waiting >= Self::FEW && !asked {
                let name = seen.name();
                if !store.holds(name) && store.error(Work::Texels(name)).is_none() {
                    self.ask(place, name);
                }
            }
            let is_served =
                self.marks[place].used || waiting >= Self::FEW && self.marks[place].asked;
            if !is_served {
                self.marks[parent].waiting += waiting;
            }
        }
    }

    /// What to ask for so that what was found will be there, of what `needs_load`; nothing is used by it.
    pub(crate) fn expect(
        &mut self,
        scene: &Scene,
        memo: &Memo,
        found: &Found,
        needs_load: impl Fn(Work) -> bool,
        requests: &mut Vec<Request>,
    ) {
        self.begin(found);
        for &place in found.wanted.iter().chain(&found.beneath) {
            let name = found.seen[place].name();
            if needs_load(Work::Texels(name)) {
                self.ask(place, name);
            }
        }
        for &place in &found.unindexed {
            let work = Work::Children(found.seen[place].name());
            if needs_load(work) {
                self.needs.push((place, work));
            }
        }
        self.end(scene, memo, found, requests);
    }

    fn begin(&mut self, found: &Found) {
        self.needs.clear();
        self.marks.clear();
        self.marks.resize(found.seen.len(), Mark::default());
    }

    fn ask(&mut self, place: usize, name: PageName) {
        if !self.marks[place].asked {
            self.marks[place].asked = true;
            self.needs.push((place, Work::Texels(name)));
        }
    }

    /// In order of need: roots, then coarse before fine, near before far, large error first.
    fn end(&mut self, scene: &Scene, memo: &Memo, found: &Found, requests: &mut Vec<Request>) {
        // Coarse is what has large texels, in steps of two: levels of two datasets do not compare. The
        // exponent of x √2 is the logarithm of x, rounded.
        let coarseness = |seen: &Seen| {
            (seen.texel_m.max(f64::MIN_POSITIVE) * std::f64::consts::SQRT_2).to_bits() >> 52
        };
        self.needs.sort_by(|&(one, one_work), &(other, other_work)| {
            let (a, b) = (&found.seen[one], &found.seen[other]);
            (a.parent.is_some().cmp(&b.parent.is_some()))
                .then(coarseness(b).cmp(&coarseness(a)))
                .then(a.distance.total_cmp(&b.distance))
                .then(b.pixels.total_cmp(&a.pixels))
                .then(one_work.cmp(&other_work))
        });
        requests.extend(self.needs.drain(..).filter_map(|(place, work)| {
            let seen = &found.seen[place];
            let dataset = &scene.datasets[seen.dataset];
            let parent = seen.parent.map(|parent| found.seen[parent].page);
            // What the last search found is remembered; what is known of an index stays so, too.
            let known = || dataset.pages.find_resident(seen.page).flatten();
            let entry = memo.entry(dataset, parent, seen.page).or_else(known)?;
            let stored = match entry.payload {
                Payload::Constant(_) => 0,
                Payload::Record { length, .. } => length as usize,
            };
            let bytes = match work {
                Work::Children(_) => 0,
                Work::Texels(_) => dataset.load_bytes(stored),
            };
            Some(Request { work, dataset: Arc::clone(dataset), entry, bytes })
        }));
    }
}
