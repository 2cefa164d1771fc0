//! What views will need in a moment, looked for beside the threads that draw.
//!
//! A session posts where its view will be; a thread that may wait searches there, and puts what it
//! finds behind all that is needed now. A session has one search under way, and the newest post waits.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::found::Found;
use crate::matching::Matcher;
use crate::memo::Memo;
use crate::scene::Scene;
use crate::search::{Hidden, Wish, search};
use crate::store::{Request, Store};
use crate::view::View;

/// Where to look.
#[derive(Clone, Debug)]
pub(crate) struct Task {
    pub(crate) scene: Arc<Scene>,
    pub(crate) view: View,
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

#[derive(Debug)]
struct Place {
    task: Option<Task>,
    /// None while a search is under way.
    room: Option<Box<Room>>,
}

/// The searches of all sessions.
#[derive(Debug, Default)]
pub(crate) struct Lookouts {
    /// By session.
    places: BTreeMap<u64, Place>,
}

impl Lookouts {
    /// Posts a search, instead of one that has not begun.
    pub(crate) fn post(&mut self, session: u64, task: Task) {
        let place = self
            .places
            .entry(session)
            .or_insert_with(|| Place { task: None, room: Some(Box::default()) });
        place.task = Some(task);
    }

    /// Forgets a session, and what it posted.
    pub(crate) fn remove(&mut self, session: u64) {
        self.places.remove(&session);
    }

    /// A search to be done now, if there is one.
    pub(crate) fn next(&mut self) -> Option<Look> {
        self.places.iter_mut().find_map(|(&session, place)| {
            let task = place.task.take()?;
            let Some(room) = place.room.take() else {
                place.task = Some(task);
                return None;
            };
            Some(Look { session, task, room })
        })
    }

    /// A search has been done.
    pub(crate) fn done(&mut self, look: Look) {
        if let Some(place) = self.places.get_mut(&look.session) {
            place.room = Some(look.room);
        }
    }
}

impl Look {
    /// Searches: this takes a while, and needs no store.
    pub(crate) fn search(&mut self) {
        let Room { memo, found, scene, .. } = &mut *self.room;
        let Task { scene: now, view, hidden, allowance, blends, .. } = &self.task;
        if *scene != now.generation {
            memo.keep(|number| now.place(number).is_some());
            *scene = now.generation;
        }
        let views = std::slice::from_ref(view);
        let wish = Wish { views, hidden, allowance: *allowance, blends: *blends, only: None };
        search(now, memo, wish, found);
    }

    /// Puts what was found behind what is needed now.
    pub(crate) fn ask(&mut self, store: &mut Store) {
        let Room { matcher, found, .. } = &mut *self.room;
        let mut needs: Vec<Request> = Vec::new();
        matcher.expect(&self.task.scene, found, store, &mut needs);
        if self.task.is_far {
            store.advise(needs);
        } else {
            store.replace_ahead(self.session, needs);
        }
    }
}
