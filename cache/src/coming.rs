//! A state of the datasets that is known of and not shown yet.
//!
//! What is new in it is searched for and loaded beside what is shown. Once that is there, a trial searches
//! all of it, instead of what is shown: if that lacks no more than the picture does, it is shown from then
//! on; else what it lacked is loaded, too, before the next trial.

use std::sync::Arc;
use std::time::Duration;

use tokio::time::Instant;

use crate::engine::ADOPT_WITHIN;
use crate::found::Found;
use crate::matching::Matcher;
use crate::memo::Memo;
use crate::scene::Scene;
use crate::search::{Only, Wish, search};
use crate::store::{Request, Store};

/// A state of the datasets, and what the views see of it.
#[derive(Debug)]
pub(crate) struct Showing {
    pub(crate) scene: Arc<Scene>,
    pub(crate) found: Found,
}

/// See the module.
#[derive(Debug)]
pub(crate) struct Coming {
    /// When it was heard of, or of one that has not been shown either.
    since: Instant,
    /// What is found is of the newcomers alone, but in a trial, and where it is not known which those are.
    pub(crate) showing: Showing,
    /// Places of datasets that the state shown has not; `None` if others may lie elsewhere.
    newcomers: Option<Vec<usize>>,
    /// What it lacked in the last trial.
    lacks: Vec<Request>,
    /// Whether a trial may find that it lacks nothing.
    is_ready: bool,
}

impl Coming {
    const WITHIN: Duration = ADOPT_WITHIN;

    /// The state after the one that is shown, instead of one that was to be shown before.
    pub(crate) fn new(
        scene: Arc<Scene>,
        shown: &Scene,
        before: Option<Self>,
        now: Instant,
    ) -> Self {
        // The clock runs from the first change that is not shown yet.
        let (since, found) = match before {
            Some(before) => (before.since, before.showing.found),
            None => (now, Found::default()),
        };
        let newcomers = scene.newcomers(shown);
        // Where others have moved, only a trial can tell.
        let is_ready = newcomers.as_ref().is_none_or(Vec::is_empty);
        Self { since, showing: Showing { scene, found }, newcomers, lacks: Vec::new(), is_ready }
    }

    /// Whether what is new in it is there.
    pub(crate) fn is_ready(&self) -> bool {
        self.is_ready
    }

    /// Whether it is to be shown with what there is.
    pub(crate) fn is_late(&self, now: Instant) -> bool {
        now >= self.since + Self::WITHIN
    }

    /// Searches what is new in it, as sharply as what is shown is seen; what was looked at.
    pub(crate) fn search(&mut self, memo: &mut Memo, wish: Wish<'_>, tolerance_px: f64) -> usize {
        let Self { showing: Showing { scene, found }, newcomers: Some(places), .. } = self else {
            return 0;
        };
        let only = Some(Only { places, tolerance_px });
        search(scene, memo, Wish { only, ..wish }, found);
        found.visited
    }

    /// Asks for what it lacks, behind what the picture does.
    pub(crate) fn ask(
        &mut self,
        matcher: &mut Matcher,
        memo: &Memo,
        store: &Store,
        requests: &mut Vec<Request>,
    ) {
        let mut others = Vec::new();
        let Showing { scene, found } = &self.showing;
        matcher.expect(scene, memo, found, |work| store.needs_load(work), &mut others);
        self.lacks.retain(|request| !store.is_settled(request));
        self.is_ready = others.is_empty() && self.lacks.is_empty();
        requests.append(&mut others);
        requests.extend(self.lacks.iter().cloned());
    }

    /// A trial found that it lacks these, and more than the picture does.
    pub(crate) fn fail(&mut self, lacks: &[Request]) {
        self.lacks = lacks.to_vec();
        self.is_ready = false;
    }
}
