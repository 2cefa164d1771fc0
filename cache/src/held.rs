//! The pages of a session's last selection, by name.
//!
//! Most of them are those of the next one, too, and are found here: in the tables of the store there is many
//! times as much memory between a name and its page, far from the processor.

use std::hint::black_box;
use std::sync::Arc;

use rustc_hash::FxHashMap;

use crate::selection::ResidentPage;
use crate::store::{PageName, Store};

/// See the module.
#[derive(Debug, Default)]
pub(crate) struct Held {
    pages: FxHashMap<PageName, Hold>,
    /// How many selections there were.
    now: u64,
}

#[derive(Debug, Default)]
struct Hold {
    /// `None` if it was wanted, and not there.
    page: Option<Arc<ResidentPage>>,
    /// The last selection that had it, and the last that would have had it.
    shown: u64,
    wanted: u64,
}

impl Held {
    /// A page that is held is used in the store, too, once in so many selections. Else those on the screen would be
    /// the store's oldest, and whoever makes room would have to pass over all of them.
    const TURNS: u64 = 16;

    /// Asks memory for all pages, for [`Self::get`]: `Bvh::fetch`.
    pub(crate) fn fetch(&self) {
        for page in self.pages.values().filter_map(|hold| hold.page.as_ref()) {
            // What counts its owners, and what it is called.
            black_box((Arc::strong_count(page), page.dataset));
        }
    }

    /// The page, if it is in memory.
    pub(crate) fn get(&self, name: PageName, store: &mut Store) -> Option<Arc<ResidentPage>> {
        let PageName { dataset, page } = name;
        let turn =
            (dataset as u64 % Self::TURNS) + u64::from(page.row) + u64::from(page.col) + self.now;
        match self.pages.get(&name) {
            Some(Hold { page: Some(page), .. }) if !turn.is_multiple_of(Self::TURNS) => {
                Some(Arc::clone(page))
            }
            _ => store.touch(name),
        }
    }

    /// Takes the pages of a new selection in the place of the last one's, and counts what is wanted now and was not
    /// before. Pages that are no longer held were used just now, as far as the store is concerned.
    pub(crate) fn renew<'a>(
        &mut self,
        shown: impl Iterator<Item = &'a Arc<ResidentPage>>,
        wanted: impl Iterator<Item = PageName>,
        store: &mut Store,
    ) {
        let before = self.now;
        self.now += 1;
        let now = self.now;
        let mut used = 0;
        for page in shown {
            let name = PageName { dataset: page.dataset, page: page.entry.page };
            let hold = self.pages.entry(name).or_default();
            hold.shown = now;
            hold.page.get_or_insert_with(|| Arc::clone(page));
            used += 1;
        }
        for name in wanted {
            let hold = self.pages.entry(name).or_default();
            if hold.wanted == now {
                continue;
            }
            used += usize::from(hold.shown != now);
            if hold.wanted != before || before == 0 {
                store.stats.first_wanted += 1;
                // Nothing that is held leaves the store.
                let is_there = hold.page.is_some() || store.holds(name);
                store.stats.first_resident += u64::from(is_there);
            }
            hold.wanted = now;
        }
        // What is held is in the store, and so shown where it is wanted: none is to be let go but those left over.
        if used < self.pages.len() {
            self.pages.retain(|name, hold| {
                if hold.shown != now && hold.page.take().is_some() {
                    store.touch(*name);
                }
                hold.shown == now || hold.wanted == now
            });
        }
    }
}
