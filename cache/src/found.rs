//! What a search has found so far, and what it looks at next.

use std::collections::BinaryHeap;

use areoid_formats::address::PageAddress;

use crate::view::{Lens, Sight};

/// A page in sight.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    /// Its dataset's place in the scene.
    pub(crate) dataset: usize,
    /// Its dataset's number.
    pub(crate) number: usize,
    pub(crate) page: PageAddress,
    /// At least the ground meters of one of its texels, and at most those of its parent's.
    pub(crate) texel_m: f64,
    /// Whether its middle is surely in the picture, or all of it.
    pub(crate) is_in: bool,
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
    pub(crate) is_in: bool,
}

impl Glance {
    /// Of a page of a dataset, by its place in the scene and its number.
    pub(crate) fn seen(
        self,
        (dataset, number): (usize, usize),
        page: PageAddress,
        parent: Option<usize>,
    ) -> Seen {
        let Self { texel_m, distance, error_m, pixels, is_in } = self;
        Seen { dataset, number, page, texel_m, is_in, parent, distance, error_m, pixels }
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
    /// Room for branches of the tree, and for slots of datasets and whether all of each is in sight.
    pub(crate) room: (Vec<usize>, Vec<(usize, bool)>),
    /// Pages that gave way to their children, and their least error where they are seen, over the
    /// largest with which they still show.
    pub(crate) refined: Vec<(usize, f64)>,
}

/// What is next: a page to give way to its children, a root to be drawn at all, or datasets to be
/// looked at.
///
/// The next is the one with the largest error; of equals, the later step, and of its kind the one found
/// first. All of that is one number, from the most significant bits down: heaps compare a lot, and move what
/// they compare. Errors of which single precision makes one are equal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Candidate(u64);

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
    /// The greatest place: fewer than that of anything have room in memory.
    const LAST: usize = (1 << 31) - 1;

    /// Of an error in pixels that is not negative. One that is no number is none.
    pub(crate) fn new(pixels: f64, place: usize, step: Step) -> Self {
        #[expect(clippy::cast_possible_truncation, reason = "the nearest, and from there up")]
        let nearest = pixels.max(0.0) as f32;
        let least = if f64::from(nearest) < pixels { nearest.next_up() } else { nearest };
        // Of numbers that are not negative, the bits are ordered as they are.
        let error = u64::from(least.abs().to_bits());
        Self(error << 33 | (step as u64) << 31 | (Self::LAST - place) as u64)
    }

    /// At least the error, and that of whatever comes after.
    pub(crate) fn pixels(self) -> f64 {
        f64::from(f32::from_bits((self.0 >> 33) as u32))
    }

    pub(crate) fn place(self) -> usize {
        Self::LAST - (self.0 << 33 >> 33) as u32 as usize
    }

    pub(crate) fn step(self) -> Step {
        match self.0 >> 31 & 3 {
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
        let exact = [0.0, 0.5, 1.0, 1e9, f64::from(f32::MAX), f64::INFINITY];
        let mut last = None;
        for pixels in exact {
            for step in steps {
                for place in [(1 << 31) - 1, 7, 1, 0] {
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
        // Between what single precision knows, up.
        for pixels in [f64::MIN_POSITIVE, 1e-20, 0.1, 1.0_f64.next_up(), 123.456, 1e38, f64::MAX] {
            let candidate = Candidate::new(pixels, 0, Step::Refine);
            assert!(candidate.pixels() >= pixels, "{pixels}");
            let most = (pixels * (1.0 + 2.0_f64.powi(-23))).max(1e-44);
            assert!(candidate.pixels() <= most || pixels > 1e38, "{pixels}");
            assert!(candidate >= Candidate::new(pixels.next_down(), 0, Step::Refine));
        }
    }
}
