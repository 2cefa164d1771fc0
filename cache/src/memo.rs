//! Children of the pages that recent searches refined: their volumes cost more than the rest of a
//! search.

use std::collections::hash_map::Entry;

use areoid_formats::address::PageAddress;
use rustc_hash::FxHashMap;

use crate::scene::{Dataset, Node};

/// See the module. Datasets' numbers are for good: what is remembered outlives a scene.
#[derive(Debug, Default)]
pub(crate) struct Memo {
    children: FxHashMap<(usize, PageAddress), Family>,
    clock: u64,
    used: usize,
}

#[derive(Debug)]
struct Family {
    stamp: u64,
    terrain: Option<[f64; 2]>,
    nodes: Vec<Node>,
}

impl Memo {
    /// More than so many families, and twice what the last search used, are not kept.
    const MOST_FAMILIES: usize = 16_384;

    /// A search begins.
    pub(crate) fn begin(&mut self) {
        self.clock += 1;
        self.used = 0;
    }

    /// Children of a page that have data, or `None` if the index has to be read first.
    pub(crate) fn children(&mut self, dataset: &Dataset, page: PageAddress) -> Option<&[Node]> {
        self.used += 1;
        let (stamp, terrain) = (self.clock, dataset.terrain());
        match self.children.entry((dataset.number, page)) {
            Entry::Occupied(entry) => {
                let family = entry.into_mut();
                family.stamp = stamp;
                if family.terrain != terrain {
                    family.nodes =
                        family.nodes.iter().map(|node| dataset.node(node.entry)).collect();
                    family.terrain = terrain;
                }
                Some(&family.nodes)
            }
            Entry::Vacant(entry) => {
                let nodes = dataset.children(page)?;
                Some(&entry.insert(Family { stamp, terrain, nodes }).nodes)
            }
        }
    }

    /// A search has ended.
    pub(crate) fn end(&mut self) {
        if self.children.len() > Self::MOST_FAMILIES.max(2 * self.used) {
            let clock = self.clock;
            self.children.retain(|_, family| family.stamp == clock);
        }
    }
}
