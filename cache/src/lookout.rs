//! What views will need in a moment, looked for beside the threads that draw.
//!
//! A session posts where its view will be; a thread that may wait searches there, and puts what it
//! finds behind all that is needed now. One search is under way, and of each session the newest post waits.

use std::collections::BTreeMap;
use std::ops::Bound;
use std::sync::Arc;

use crate::found::Found;
use crate::matching::Matcher;
use crate::memo::Memo;
use crate::scene::Scene;
use crate::search::{Hidden, Wish, search};
use crate::store::{Request, Store, Work};
use crate::view::View;

/// Where to look.
#[derive(Clone, Debug)]
pub(crate) struct Task {
    pub(crate) scene: Arc<Scene>,
    pub(crate) views: Vec<View>,
    pub(crate) exaggeration: f64,
    pub(crate) hidden: Hidden,
    pub(crate) allowance: usize,
    pub(crate) blends: bool,
    /// Whether media are told of it alone, and nothing is loaded.
    pub(crate) is_far: bool,
}

/// Room for searches, kept from one to the next.
#[derive(Debug, Default)]
struct Room {
    memo: Memo,
    matcher: Matcher,
    found: Found,
    /// The generation of the scene searched last.
    scene: u64,
}

/// A search that is to be done, or is being done.
#[derive(Debug)]
pub(crate) struct Look {
    session: u64,
    task: Task,
    room: Box<Room>,
}

#[derive(Debug, Default)]
struct Place {
    task: Option<Task>,
    /// None while a search is under way.
    room: Option<Box<Room>>,
}

/// The searches of all sessions, of which one is done at a time.
#[derive(Debug, Default)]
pub(crate) struct Lookouts {
    /// By session.
    places: BTreeMap<u64, Place>,
    is_busy: bool,
    last_served: u64,
}

impl Lookouts {
    /// Posts a search, instead of one that has not begun.
    pub(crate) fn post(&mut self, session: u64, task: Task) {
        self.places.entry(session).or_default().task = Some(task);
    }

    /// Forgets a session, and what it posted.
    pub(crate) fn remove(&mut self, session: u64) {
        self.places.remove(&session);
    }

    /// A search to be done now, if there is one and none is being done: of each session in turn.
    pub(crate) fn next(&mut self) -> Option<Look> {
        if self.is_busy {
            return None;
        }
        let is_posted = |(session, place): (&u64, &Place)| place.task.is_some().then_some(*session);
        let later = (Bound::Excluded(self.last_served), Bound::Unbounded);
        let next = self.places.range(later).find_map(is_posted);
        let session = next.or_else(|| self.places.iter().find_map(is_posted))?;
        let place = self.places.get_mut(&session)?;
        let (task, room) = (place.task.take()?, place.room.take().unwrap_or_default());
        (self.is_busy, self.last_served) = (true, session);
        Some(Look { session, task, room })
    }

    /// A search has ended, or was given up.
    pub(crate) fn end(&mut self, look: Option<Look>) {
        self.is_busy = false;
        if let Some(Look { session, room, .. }) = look
            && let Some(place) = self.places.get_mut(&session)
        {
            place.room = Some(room);
        }
    }
}

impl Look {
    /// Searches: this takes a while, and needs no store.
    pub(crate) fn search(&mut self) {
        let Room { memo, found, scene, .. } = &mut *self.room;
        let Task { scene: now, views, hidden, .. } = &self.task;
        let Task { exaggeration, allowance, blends, .. } = self.task;
        if *scene != now.generation {
            memo.keep(|number| now.place(number).is_some());
            *scene = now.generation;
        }
        let wish = Wish { views, exaggeration, hidden, allowance, blends, only: None };
        search(now, memo, wish, found);
    }

    /// What to ask for, of what was found, that `needs_load`.
    pub(crate) fn requests(&mut self, needs_load: impl Fn(Work) -> bool) -> Vec<Request> {
        let Room { memo, matcher, found, .. } = &mut *self.room;
        let mut requests = Vec::new();
        matcher.expect(&self.task.scene, memo, found, needs_load, &mut requests);
        requests
    }

    /// Puts requests behind what is needed now.
    pub(crate) fn ask(&self, requests: Vec<Request>, store: &mut Store) {
        if self.task.is_far {
            store.advise(requests);
        } else {
            store.replace_ahead(self.session, requests);
        }
    }
}

#[cfg(test)]
mod tests {
    use areoid_formats::body::Body;
    use areoid_formats::units::Radians;
    use glam::{DMat3, DVec3};

    use super::*;

    fn task(tolerance_px: f64) -> Task {
        let scene = Arc::new(Scene::empty(Body::parse("mars").unwrap()));
        let view = View {
            eye: DVec3::X,
            orientation: DMat3::IDENTITY,
            vertical_fov: Radians(1.0),
            viewport: [1; 2],
            tolerance_px,
        };
        let (exaggeration, hidden) = (1.0, Hidden::default());
        Task {
            scene,
            views: vec![view],
            exaggeration,
            hidden,
            allowance: 0,
            blends: false,
            is_far: false,
        }
    }

    fn next(lookouts: &mut Lookouts) -> Option<(u64, f64, Look)> {
        lookouts.next().map(|look| (look.session, look.task.views[0].tolerance_px, look))
    }

    #[test]
    fn one_search_is_done_at_a_time_and_the_newest_of_each_session_in_turn() {
        let mut lookouts = Lookouts::default();
        for (session, tolerance_px) in [(1, 1.0), (2, 2.0), (1, 3.0), (3, 4.0)] {
            lookouts.post(session, task(tolerance_px));
        }
        let (session, tolerance_px, look) = next(&mut lookouts).unwrap();
        assert_eq!((session, tolerance_px), (1, 3.0));
        lookouts.post(1, task(5.0));
        assert!(next(&mut lookouts).is_none(), "two at a time");
        lookouts.end(Some(look));
        let (session, tolerance_px, look) = next(&mut lookouts).unwrap();
        assert_eq!((session, tolerance_px), (2, 2.0));
        // It is gone before its search ends, and so is another before it begins.
        lookouts.remove(2);
        lookouts.remove(3);
        lookouts.end(Some(look));
        let (session, tolerance_px, _given_up) = next(&mut lookouts).unwrap();
        assert_eq!((session, tolerance_px), (1, 5.0));
        lookouts.end(None);
        assert!(next(&mut lookouts).is_none());
        assert_eq!(lookouts.places.keys().collect::<Vec<_>>(), [&1]);
        lookouts.post(1, task(6.0));
        assert!(next(&mut lookouts).is_some(), "after one that was given up there is none");
    }
}
