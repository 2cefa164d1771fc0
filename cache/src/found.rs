//! What a search has found so far, and what it looks at next.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use crate::scene::Node;
use crate::view::{Lens, Sight};

/// A page in sight.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    /// Its dataset's place in the scene.
    pub(crate) dataset: usize,
    pub(crate) node: Node,
    /// Its place in [`Found::seen`].
    pub(crate) parent: Option<usize>,
    /// From the nearest eye that sees it.
    pub(crate) distance: f64,
    /// At most what it is off by, in meters on the ground or in height.
    pub(crate) error_m: f64,
    /// Its error on the screen, in pixels of the first view.
    pub(crate) pixels: f64,
}

/// What a search found; kept for the next one, so that it need not be allocated again.
#[derive(Debug, Default)]
pub(crate) struct Found {
    /// Wanted pages and all of their ancestors: a parent stands before its children.
    pub(crate) seen: Vec<Seen>,
    /// The wanted ones, as places in `seen`.
    pub(crate) wanted: Vec<usize>,
    /// The wanted ones whose children are not known yet.
    pub(crate) unindexed: Vec<usize>,
    /// Ancestors of the wanted ones that show beneath them, as places in `seen`.
    pub(crate) beneath: Vec<usize>,
    pub(crate) tolerance_px: f64,
    pub(crate) visited: usize,
    pub(crate) culled: usize,
    /// One for each view, of each in `seen`.
    pub(crate) sights: Vec<Sight>,
    pub(crate) roots: Vec<Seen>,
    pub(crate) root_sights: Vec<Sight>,
    pub(crate) heap: BinaryHeap<Candidate>,
    pub(crate) lenses: Vec<Lens>,
    /// Pages that gave way to their children, and their least error where they are seen, over the
    /// largest with which they still show.
    pub(crate) refined: Vec<(usize, f64)>,
}

/// What is next: a page to give way to its children, a root to be drawn at all, or datasets to be
/// looked at.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Candidate {
    pub(crate) pixels: f64,
    pub(crate) place: usize,
    pub(crate) step: Step,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Step {
    /// `place` is one in `seen`.
    Refine,
    /// `place` is one in `roots`.
    Draw,
    /// `place` is a dataset's slot.
    Open,
    /// `place` is a branch of the tree over the datasets.
    Climb,
}

impl Found {
    /// Forgets what was found, and keeps the room for it.
    pub(crate) fn clear(&mut self) {
        let Self { seen, wanted, unindexed, beneath, sights, roots, root_sights, heap, .. } = self;
        [wanted, unindexed, beneath].into_iter().for_each(Vec::clear);
        [seen, roots].into_iter().for_each(Vec::clear);
        [sights, root_sights].into_iter().for_each(Vec::clear);
        heap.clear();
        self.refined.clear();
        (self.tolerance_px, self.visited, self.culled) = (f64::INFINITY, 0, 0);
    }
}

/// The next is the one with the largest error; of equals, the one found first.
impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> Ordering {
        let pixels = self.pixels.total_cmp(&other.pixels);
        pixels.then(self.step.cmp(&other.step)).then(other.place.cmp(&self.place))
    }
}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Candidate {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Candidate {}
