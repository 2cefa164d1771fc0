//! Children of the pages that recent searches refined: their volumes cost more than the rest of a
//! search.

use std::collections::hash_map::Entry;

use areoid_formats::address::{Level, PageAddress};
use areoid_formats::archive::PageEntry;
use rustc_hash::FxHashMap;

use crate::scene::{Dataset, Node};

/// What a part of a page says about the whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Verdict {
    Yes,
    No,
    /// Its own parts may tell.
    Unsure,
}

/// See the module. Datasets' numbers are for good: what is remembered outlives a scene.
#[derive(Debug, Default)]
pub(crate) struct Memo {
    children: FxHashMap<(usize, PageAddress), Family>,
    /// Of heights, in what is remembered.
    exaggeration: f64,
    clock: u64,
    /// It is gone through when there are more.
    most: usize,
    /// Changes of the datasets since it was gone through for them.
    changes: u32,
}

#[derive(Debug)]
struct Family {
    stamp: u64,
    terrain: Option<[f64; 2]>,
    nodes: Vec<Node>,
    /// Of each node.
    entries: Vec<PageEntry>,
}

impl Memo {
    /// Up to so many families are kept, whenever they were used.
    const MOST_FAMILIES: usize = 4096;

    /// Families that so many searches have not used may go.
    const RECENT: u64 = 16;

    /// Changes of the datasets after which those that are gone are looked for.
    const CHANGES: u32 = 64;

    /// A search begins, of terrain whose heights are taken so many times.
    pub(crate) fn begin(&mut self, exaggeration: f64) {
        self.clock += 1;
        if self.exaggeration != exaggeration {
            self.children.clear();
            self.exaggeration = exaggeration;
        }
    }

    /// Roots of a dataset that have data.
    pub(crate) fn roots<'a>(&'a mut self, dataset: &'a Dataset) -> &'a [Node] {
        /// What they are the children of: a level that no pyramid has.
        const ABOVE: PageAddress = PageAddress::new(Level(u8::MAX), 0, 0);
        let exaggeration = self.exaggeration;
        if exaggeration == 1.0 {
            return &dataset.roots;
        }
        self.family(dataset, ABOVE, || Some(dataset.entries.clone())).unwrap_or_default()
    }

    /// Children of a page that have data, or `None` if the index has to be read first.
    pub(crate) fn children(&mut self, dataset: &Dataset, page: PageAddress) -> Option<&[Node]> {
        self.family(dataset, page, || dataset.children(page))
    }

    /// The entry of a page that was found under another, or is a root.
    pub(crate) fn entry(
        &self,
        dataset: &Dataset,
        parent: Option<PageAddress>,
        page: PageAddress,
    ) -> Option<PageEntry> {
        let entries = match parent {
            Some(parent) => &self.children.get(&(dataset.number, parent))?.entries,
            None => &dataset.entries,
        };
        entries.iter().find(|entry| entry.page == page).copied()
    }

    fn family(
        &mut self,
        dataset: &Dataset,
        page: PageAddress,
        find: impl FnOnce() -> Option<Vec<PageEntry>>,
    ) -> Option<&[Node]> {
        let (stamp, terrain, exaggeration) = (self.clock, dataset.terrain(), self.exaggeration);
        match self.children.entry((dataset.number, page)) {
            Entry::Occupied(entry) => {
                let family = entry.into_mut();
                family.stamp = stamp;
                if family.terrain != terrain {
                    family.nodes = dataset.nodes(&family.entries, exaggeration);
                    family.terrain = terrain;
                }
                Some(&family.nodes)
            }
            Entry::Vacant(entry) => {
                let entries = find()?;
                let nodes = dataset.nodes(&entries, exaggeration);
                Some(&entry.insert(Family { stamp, terrain, nodes, entries }).nodes)
            }
        }
    }

    /// Whether all parts of a page that have data, at most so many levels below it, are known to be
    /// as wanted; and all of it has data, if `whole` asks for that. `judge` is told if no parts of a
    /// part can tell more.
    pub(crate) fn all_parts(
        &mut self,
        dataset: &Dataset,
        page: PageAddress,
        (levels, whole): (u32, bool),
        visited: &mut usize,
        judge: &impl Fn(&Node, bool) -> Verdict,
    ) -> bool {
        let pyramid = dataset.info.grid.pyramid();
        let finest = pyramid.finest();
        if levels == 0 || page.level == finest {
            return false;
        }
        let Some(children) = self.children(dataset, page) else { return false };
        if whole && children.len() < pyramid.children(page).count() {
            return false;
        }
        // A page has at most four.
        let mut unsure = [None; 4];
        for (child, place) in children.iter().zip(&mut unsure) {
            *visited += 1;
            let is_last = levels == 1 || child.page.level == finest;
            match judge(child, is_last) {
                Verdict::Yes => {}
                Verdict::No => return false,
                Verdict::Unsure => *place = Some(child.page),
            }
        }
        let mut unsure = unsure.into_iter().flatten();
        unsure.all(|part| self.all_parts(dataset, part, (levels - 1, whole), visited, judge))
    }

    /// Lets go of datasets that no scene to be searched has; once in [`Self::CHANGES`] times, as all
    /// has to be gone through.
    pub(crate) fn keep(&mut self, is_there: impl Fn(usize) -> bool) {
        self.changes += 1;
        if self.changes >= Self::CHANGES {
            self.changes = 0;
            self.children.retain(|(dataset, _), _| is_there(*dataset));
        }
    }

    /// A search has ended.
    pub(crate) fn end(&mut self) {
        if self.children.len() > self.most.max(Self::MOST_FAMILIES) {
            let clock = self.clock;
            self.children.retain(|_, family| family.stamp + Self::RECENT > clock);
            // What is in use is not gone through after each search.
            self.most = 2 * self.children.len();
        }
    }
}
