//! Pages of the picture before that go on showing beside those that have just come.
//!
//! ```text
//!   finer pages have come       the page before stays beneath them while they fade in
//!   a coarser page has come     it shows at once, and the pages before fade out over it
//! ```

use std::collections::{HashMap, HashSet};
use std::iter;

use areoid_formats::address::{PageAddress, PageKey};

use crate::atlas::slots::PageName;
use crate::atlas::table::{PRESENT, Shown};

/// A page that a picture shows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Trace {
    pub(crate) name: PageName,
    /// Which of the atlases it lies in.
    pub(crate) atlas: usize,
    pub(crate) shown: Shown,
    /// When it began to show, in seconds.
    pub(crate) since: f64,
}

/// Adds to what a picture shows, `traces`, what lingers of the picture before. `find` says where a page
/// is now, if it still is, and how far it shows by its age; traces stand beside the places of their
/// datasets.
pub(crate) fn add(
    traces: &mut Vec<(usize, Trace)>,
    before: &[Trace],
    mut find: impl FnMut(&Trace) -> Option<(usize, Shown)>,
) {
    let key = |dataset: usize, page: PageAddress| (dataset, PageKey::from(page));
    let now: HashSet<PageName> = traces.iter().map(|(_, trace)| trace.name).collect();
    let mut coming = HashMap::new();
    let mut beneath = HashSet::new();
    for (index, (_, trace)) in traces.iter().enumerate() {
        let (dataset, Shown { page, presence, .. }) = (trace.name.dataset, trace.shown);
        if presence < PRESENT {
            coming.insert(key(dataset, page), index);
            beneath.extend(ancestors(page).map(|page| key(dataset, page)));
        }
    }
    let mut covered = Vec::new();
    for old in before.iter().filter(|old| !now.contains(&old.name)) {
        let (dataset, page) = (old.name.dataset, old.shown.page);
        let over = ancestors(page).find_map(|page| coming.get(&key(dataset, page)).copied());
        if over.is_none() && !beneath.contains(&key(dataset, page)) {
            continue;
        }
        let Some((place, mut shown)) = find(old) else { continue };
        if let Some(over) = over {
            shown.presence = shown.presence.min(PRESENT - traces[over].1.shown.presence);
            covered.push(over);
        }
        traces.push((place, Trace { shown, ..*old }));
    }
    for over in covered {
        traces[over].1.shown.presence = PRESENT;
    }
}

fn ancestors(page: PageAddress) -> impl Iterator<Item = PageAddress> {
    iter::successors(page.parent(), |page| page.parent())
}
