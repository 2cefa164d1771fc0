//! What a search has found so far, and what it looks at next.

use std::collections::BinaryHeap;

use areoid_formats::archive::PageEntry;
use glam::DVec3;

use crate::scene::Node;
use crate::view::{Lens, Sight};

/// A page in sight.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    /// Its dataset's place in the scene.
    pub(crate) dataset: usize,
    /// Its dataset's number.
    pub(crate) number: usize,
    pub(crate) entry: PageEntry,
    /// At least the ground meters of one of its texels, and at most those of its parent's.
    pub(crate) texel_m: f64,
    /// The middle of its volume.
    pub(crate) middle: DVec3,
    /// Its place in [`Found::seen`].
    pub(crate) parent: Option<usize>,
    /// From the nearest eye that sees it.
    pub(crate) distance: f64,
    /// At most what it is off by, in meters on the ground or in exaggerated height.
    pub(crate) error_m: f64,
    /// Its error on the screen, in pixels of the first view.
    pub(crate) pixels: f64,
}

/// What there is to say of a page that is seen.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Glance {
    pub(crate) texel_m: f64,
    pub(crate) distance: f64,
    pub(crate) error_m: f64,
    pub(crate) pixels: f64,
}

impl Glance {
    /// Of a page of a dataset, by its place in the scene and its number.
    pub(crate) fn seen(
        self,
        (dataset, number): (usize, usize),
        node: &Node,
        parent: Option<usize>,
    ) -> Seen {
        let Self { texel_m, distance, error_m, pixels } = self;
        let (entry, middle) = (node.entry, node.volume.bounds().center);
        Seen { dataset, number, entry, texel_m, middle, parent, distance, error_m, pixels }
    }
}

/// A root in sight.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Root {
    /// Its dataset's slot in the scene.
    pub(crate) slot: usize,
    /// Its place among the dataset's roots.
    pub(crate) root: usize,
    pub(crate) glance: Glance,
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
    pub(crate) roots: Vec<Root>,
    pub(crate) root_sights: Vec<Sight>,
    pub(crate) heap: BinaryHeap<Candidate>,
    pub(crate) lenses: Vec<Lens>,
    /// Room for branches of the tree, and for slots of datasets.
    pub(crate) room: [Vec<usize>; 2],
    /// Pages that gave way to their children, and their least error where they are seen, over the
    /// largest with which they still show.
    pub(crate) refined: Vec<(usize, f64)>,
}

/// What is next: a page to give way to its children, a root to be drawn at all, or datasets to be
/// looked at.
///
/// The next is the one with the largest error; of equals, the later step, and of its kind the one found
/// first. All of that is one number, from the most significant bits down: heaps compare a lot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Candidate(u128);

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Step {
    /// `place` is one in `seen`.
    Refine,
    /// `place` is one in `roots`.
    Draw,
    /// `place` is a branch of the tree over the datasets.
    Climb,
    /// The same, and all of it is in sight of one of the views.
    Sweep,
}

impl Found {
    /// Forgets what was found, and keeps the room for it.
    pub(crate) fn clear(&mut self) {
        let Self { seen, wanted, unindexed, beneath, sights, roots, root_sights, heap, .. } = self;
        [wanted, unindexed, beneath].into_iter().for_each(Vec::clear);
        [sights, root_sights].into_iter().for_each(Vec::clear);
        seen.clear();
        roots.clear();
        heap.clear();
        self.refined.clear();
        (self.tolerance_px, self.visited, self.culled) = (f64::INFINITY, 0, 0);
    }

    /// A page takes part: it is wanted if it is sharp enough, and else takes its turn among the others.
    pub(crate) fn take_in(&mut self, place: usize) {
        let pixels = self.seen[place].pixels;
        if pixels <= self.tolerance_px {
            self.wanted.push(place);
        } else {
            self.heap.push(Candidate::new(pixels, place, Step::Refine));
        }
    }
}

impl Candidate {
    /// Of an error in pixels that is not negative. One that is no number is none.
    pub(crate) fn new(pixels: f64, place: usize, step: Step) -> Self {
        // Of numbers that are not negative, the bits are ordered as they are.
        let error = u128::from(pixels.max(0.0).to_bits() & !(1 << 63));
        Self(error << 64 | (step as u128) << 62 | (Self::LAST - place as u128))
    }

    const LAST: u128 = (1 << 62) - 1;

    pub(crate) fn pixels(self) -> f64 {
        f64::from_bits((self.0 >> 64) as u64)
    }

    pub(crate) fn place(self) -> usize {
        (Self::LAST - (self.0 & Self::LAST)) as usize
    }

    pub(crate) fn step(self) -> Step {
        match self.0 >> 62 & 3 {
            0 => Step::Refine,
            1 => Step::Draw,
            2 => Step::Climb,
            _ => Step::Sweep,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn candidates_are_what_they_were_made_of_and_in_order() {
        let steps = [Step::Refine, Step::Draw, Step::Climb, Step::Sweep];
        let errors = [0.0, f64::MIN_POSITIVE, 0.5, 1.0, 1e9, f64::MAX, f64::INFINITY];
        let mut last = None;
        for pixels in errors {
            for step in steps {
                for place in [usize::MAX >> 2, 7, 1, 0] {
                    let candidate = Candidate::new(pixels, place, step);
                    let found = (candidate.pixels(), candidate.place(), candidate.step());
                    assert_eq!(found, (pixels, place, step));
                    assert!(last < Some(candidate), "{found:?}");
                    last = Some(candidate);
                }
            }
        }
        assert!(Candidate::new(f64::NAN, 0, Step::Refine).pixels() == 0.0);
        assert_eq!(Candidate::new(-0.0, 3, Step::Draw), Candidate::new(0.0, 3, Step::Draw));
    }
}
