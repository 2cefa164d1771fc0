//! Which pages some views need: a refinement from the roots, the largest error on the screen first.
//!
//! A page whose error is above the tolerance gives way to its children; what is left are the
//! *wanted* pages. Because the worst page is always the next to give way, the search can end
//! anywhere: what it has then is the best picture for its bytes, and the error of the page it
//! ended at is the tolerance that it meets. A root that is not drawn at all is off by its own size
//! on the screen, and takes its turn among the others.
//!
//! Several views, of two eyes or of a wall's tiles, make one search: a page is as bad as it is in
//! the view that it is worst in.
//!
//! Between a page and its children a picture changes bit by bit: the page is *beneath* them, and
//! shows where its own error is not much above the tolerance. Where all of what is seen of it is nearer
//! than that, it is not needed.
//!
//! Bounds and volumes nest, boxes do not: distances are kept at least as favorable as the parent's, so
//! that errors fall from parent to child and the order above is one.
//!
//! # References
//!
//! * `ARCHITECTURE.md`: the error on the screen, and what is out of sight, cheapest first.
//! * White 2011, chapter 4: the search over a BVH of datasets with a quadtree each.

mod parts;

use std::collections::binary_heap::PeekMut;
use std::fmt;
use std::sync::Arc;

use areoid_formats::bounds::Position;
use areoid_formats::bvh::{Branch, Parts};
use areoid_formats::page::Kind;
use smallvec::SmallVec;

use crate::found::{Candidate, Found, Glance, Root, Seen, Step};
use crate::memo::{Memo, Verdict};
use crate::scene::{Leaf, Node, Scene};
use crate::selection::DatasetInfo;
use crate::view::{Lens, Sight, View};

/// So many branches of the tree are taken apart together: what of them and of their datasets is far from the
/// processor comes in the time of one.
const BUNCH: usize = 8;

/// Says which datasets are hidden.
type Hides = dyn Fn(&DatasetInfo) -> bool + Send + Sync;

/// Which datasets a session does not want to see; none by default.
#[derive(Clone, Default)]
pub(crate) struct Hidden(pub(crate) Option<Arc<Hides>>);

impl Hidden {
    fn hides<'a>(&self, info: impl FnOnce() -> &'a DatasetInfo) -> bool {
        self.0.as_ref().is_some_and(|hides| hides(info()))
    }
}

impl fmt::Debug for Hidden {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Hidden").field(&self.0.is_some()).finish()
    }
}

/// What is searched for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wish<'a> {
    /// None need nothing.
    pub(crate) views: &'a [View],
    /// How many times heights are taken.
    pub(crate) exaggeration: f64,
    pub(crate) hidden: &'a Hidden,
    /// Bytes of all pages in sight.
    pub(crate) allowance: usize,
    /// Whether pages are found that show beneath others.
    pub(crate) blends: bool,
    /// The datasets that are searched, if not all.
    pub(crate) only: Option<Only<'a>>,
}

/// Some datasets of a scene, to be seen as sharply as the others are.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Only<'a> {
    /// Their places in the scene.
    pub(crate) places: &'a [usize],
    pub(crate) tolerance_px: f64,
}

/// The pages that some views need of what is not hidden, with their ancestors within an allowance.
pub(crate) fn search(scene: &Scene, memo: &mut Memo, wish: Wish<'_>, found: &mut Found) {
    let Wish { views, exaggeration, hidden, allowance, blends, only } = wish;
    memo.begin(exaggeration);
    found.clear();
    let Some(first) = views.first() else {
        memo.end();
        return;
    };
    found.tolerance_px = first.tolerance_px;
    found.lenses.extend(views.iter().map(|view| Lens::new(view, scene.radii(exaggeration))));
    let mut lenses = std::mem::take(&mut found.lenses);
    let shift_m = scene.shift_m(exaggeration);
    let search = Search { scene, views, lenses: &lenses, exaggeration, shift_m, hidden, blends };

    if let Some(Only { places, tolerance_px }) = only {
        found.tolerance_px = found.tolerance_px.max(tolerance_px);
        let slots = places.iter().map(|&place| scene.datasets[place].slot as usize);
        slots.for_each(|slot| search.open((slot, false), memo, found));
    } else if let Some(trunk) = scene.tree.trunk() {
        found.visited = 1;
        found.heap.push(Candidate::new(f64::INFINITY, trunk, Step::Climb));
    }
    let mut bytes = 0;
    while let Some(candidate) = found.heap.pop() {
        let (pixels, place) = (candidate.pixels(), candidate.place());
        match candidate.step() {
            step @ (Step::Climb | Step::Sweep) => search.take_apart((place, step), memo, found),
            Step::Draw => {
                if !search.draw(place, (&mut bytes, allowance), memo, found) {
                    found.tolerance_px = found.tolerance_px.max(pixels);
                    // All that would come after is smaller yet, and sharp enough if it is drawn.
                    let drawn = |candidate: &Candidate| candidate.step() == Step::Refine;
                    found.wanted.extend(found.heap.drain().filter(drawn).map(Candidate::place));
                }
            }
            Step::Refine if pixels <= found.tolerance_px => found.wanted.push(place),
            Step::Refine => search.refine(place, (&mut bytes, allowance), memo, found),
        }
    }
    search.drop_unseen(memo, found);
    let shows = |&&(_, pixels): &&(usize, f64)| pixels < found.tolerance_px;
    found.beneath.extend(found.refined.iter().filter(shows).map(|(place, _)| place));
    memo.end();
    lenses.clear();
    found.lenses = lenses;
}

struct Search<'a> {
    scene: &'a Scene,
    views: &'a [View],
    lenses: &'a [Lens],
    exaggeration: f64,
    /// How far that moves any point at most.
    shift_m: f64,
    hidden: &'a Hidden,
    blends: bool,
}

impl Search<'_> {
    /// How many more levels of the tree are passed at once where all is in sight: at most what is smaller than a
    /// pixel could be left out there.
    const SWEPT: usize = 2;

    /// Pixels to a texel, to a pixel of tolerance, up to which a page of colors shows where a pixel's
    /// footprint is round: its children begin to show at 1.
    const WIDEST_TEXEL: f64 = 2.0;

    /// A footprint up to so many times as long as wide is seen as sharp as it is wide, one of 64 times
    /// eight times less so; ground may lean away as much as makes it twice as long.
    const LONGEST: f64 = 8.0 / 2.0;
    const LEAST_SHARP: f64 = 8.0;

    /// Puts branches of the tree over the datasets among what is to come, by the largest that one of
    /// their datasets can be on the screen, and those that are a dataset among `items`. What is `whole` is known to
    /// be in sight of one of the views.
    fn climb(
        &self,
        branches: &[usize],
        whole: bool,
        items: &mut Vec<(usize, bool)>,
        found: &mut Found,
    ) {
        let tree = &self.scene.tree;
        branches.iter().for_each(|&branch| tree.fetch(branch));
        found.visited += branches.len();
        for &branch in branches {
            let Branch { bounds, largest_m, parts } = tree.branch(branch);
            let bounds = bounds.grown(self.shift_m);
            if let Parts::Item(slot) = parts {
                if whole || self.lenses.iter().any(|lens| !lens.misses_box(&bounds)) {
                    items.push((slot as usize, whole));
                }
                continue;
            }
            let mut step = if whole { Step::Sweep } else { Step::Climb };
            let sights = self.lenses.iter().map(|lens| {
                // Of several views, what one sees wholly another may not see at all.
                if !whole || self.lenses.len() > 1 {
                    match lens.position_of_box(&bounds) {
                        Position::Outside => return Sight::NONE,
                        Position::Within => step = Step::Sweep,
                        Position::Across => {}
                    }
                }
                lens.sight_of_box(&bounds)
            });
            let pixels = self.worst(largest_m + 2.0 * self.shift_m, sights);
            if pixels >= Lens::SMALLEST_PX {
                found.heap.push(Candidate::new(pixels, branch, step));
            }
        }
    }

    /// Takes a branch of the tree apart, and those with it that would be next, but for its parts; one that
    /// is wholly in sight [`Self::SWEPT`] levels deeper.
    fn take_apart(&self, branch: (usize, Step), memo: &mut Memo, found: &mut Found) {
        let tree = &self.scene.tree;
        let mut children = SmallVec::<[usize; 2 * BUNCH]>::new();
        let (mut whole, mut items) = std::mem::take(&mut found.room);
        let mut next = Some(branch);
        while let Some((branch, step)) = next {
            match tree.branch(branch).parts {
                Parts::Item(slot) => items.push((slot as usize, step == Step::Sweep)),
                Parts::Branches(parts) if step == Step::Sweep => whole.extend(parts),
                Parts::Branches(parts) => children.extend(parts),
            }
            let is_full = children.len() + whole.len() >= 2 * BUNCH;
            let first = found.heap.peek_mut();
            let first = first.filter(|first| !is_full && first.step() >= Step::Climb);
            next = first.map(|first| {
                let first = PeekMut::pop(first);
                (first.place(), first.step())
            });
        }
        let mut passed = 0;
        for _ in 0..Self::SWEPT {
            let level = passed..whole.len();
            whole[level.clone()].iter().for_each(|&branch| tree.fetch(branch));
            passed = level.end;
            for place in level {
                match tree.branch(whole[place]).parts {
                    Parts::Item(slot) => items.push((slot as usize, true)),
                    Parts::Branches(parts) => whole.extend(parts),
                }
            }
        }
        found.visited += passed;
        self.climb(&children, false, &mut items, found);
        self.climb(&whole[passed..], true, &mut items, found);
        items.iter().for_each(|&(slot, _)| self.scene.fetch(slot));
        items.drain(..).for_each(|item| self.open(item, memo, found));
        whole.clear();
        found.room = (whole, items);
    }

    /// Looks at the roots of the dataset in a slot, which may be known to be in sight of one of the views as a whole.
    fn open(&self, (slot, whole): (usize, bool), memo: &mut Memo, found: &mut Found) {
        if self.hidden.hides(|| &self.scene.dataset(slot).info) {
            return;
        }
        let leaf = self.scene.leaf(slot);
        let mut sights = std::mem::take(&mut found.root_sights);
        for (root, node) in self.roots(slot, leaf, memo).iter().enumerate() {
            let mark = sights.len();
            let glance = self.look_at(leaf.kind, node, (None, whole), &mut sights, found);
            let Some(glance) = glance else { continue };
            // Nearer than its own size, it is as large as can be.
            let size = self.worst(node.extent_m(), sights[mark..].iter().copied());
            if size < Lens::SMALLEST_PX {
                sights.truncate(mark);
                continue;
            }
            let (pixels, place) = (size.max(glance.pixels), found.roots.len());
            found.heap.push(Candidate::new(pixels, place, Step::Draw));
            found.roots.push(Root { slot, root, glance });
        }
        found.root_sights = sights;
    }

    /// The roots of the dataset in a slot.
    fn roots<'a>(&'a self, slot: usize, leaf: &'a Leaf, memo: &'a mut Memo) -> &'a [Node] {
        match &leaf.root {
            Some(root) if self.exaggeration == 1.0 => std::slice::from_ref(root),
            _ => memo.roots(self.scene.dataset(slot)),
        }
    }

    /// Takes a root in, if there is room for it; whether there was.
    fn draw(
        &self,
        place: usize,
        (bytes, allowance): (&mut usize, usize),
        memo: &mut Memo,
        found: &mut Found,
    ) -> bool {
        let Root { slot, root, glance } = found.roots[place];
        let leaf = self.scene.leaf(slot);
        let node = &self.roots(slot, leaf, memo)[root];
        let more = leaf.page_bytes(node);
        if *bytes + more > allowance {
            return false;
        }
        *bytes += more;
        let views = self.lenses.len();
        let (place, sights) = (found.seen.len(), place * views..(place + 1) * views);
        found.sights.extend_from_slice(&found.root_sights[sights]);
        found.seen.push(glance.seen((self.scene.slots[slot], leaf.number), node.page, None));
        found.take_in(place);
        true
    }

    /// Puts a page's children in its place, if they are known and there is room for them.
    fn refine(
        &self,
        place: usize,
        (bytes, allowance): (&mut usize, usize),
        memo: &mut Memo,
        found: &mut Found,
    ) {
        let parent = found.seen[place];
        let dataset = &self.scene.datasets[parent.dataset];
        let page = parent.page;
        if page.level == dataset.finest {
            found.wanted.push(place);
            return;
        }
        let Some(nodes) = memo.children(dataset, page) else {
            found.wanted.push(place);
            found.unindexed.push(place);
            return;
        };
        if nodes.is_empty() {
            found.wanted.push(place);
            return;
        }
        let (first, first_sight) = (found.seen.len(), found.sights.len());
        let mut sights = std::mem::take(&mut found.sights);
        let (mut more, mut sharper, mut least) = (0, 0.0_f64, f64::INFINITY);
        for node in nodes {
            let mark = sights.len();
            let glance = self.look_at(dataset.kind, node, (Some(place), false), &mut sights, found);
            if let Some(glance) = glance {
                let here = sights[mark..].iter().copied();
                sharper = sharper.max(self.worst(parent.error_m, here));
                more += dataset.page_bytes(node);
                if self.blends {
                    least = least.min(self.least(&parent, dataset.kind, node, &sights[mark..]));
                }
                let owner = (parent.dataset, parent.number);
                found.seen.push(glance.seen(owner, node.page, Some(place)));
            }
        }
        found.sights = sights;
        // What is seen of the page lies under the parts that are seen, and their boxes are tighter.
        let tolerance = found.tolerance_px;
        if sharper > tolerance
            && memo.all_parts(
                dataset,
                page,
                (Self::PARTS, false),
                &mut found.visited,
                &|part, is_last| {
                    if part.is_empty {
                        return Verdict::Yes;
                    }
                    let halvings = if is_last { Self::HALVINGS } else { 0 };
                    self.is_fine(&part.volume, (parent.error_m, tolerance), halvings)
                },
            )
        {
            sharper = tolerance;
        }
        if sharper <= tolerance || *bytes + more > allowance {
            found.seen.truncate(first);
            found.sights.truncate(first_sight);
            found.seen[place].pixels = sharper;
            found.tolerance_px = found.tolerance_px.max(sharper);
            found.wanted.push(place);
            return;
        }
        *bytes += more;
        if self.blends {
            found.refined.push((place, least));
        }
        (first..found.seen.len()).for_each(|place| found.take_in(place));
    }

    /// The least error of a page where a child of it is seen, over the largest with which it still shows.
    fn least(&self, parent: &Seen, kind: Kind, child: &Node, sights: &[Sight]) -> f64 {
        let widest = |view: &View, length: f64| match kind {
            Kind::Height => View::BLENDED,
            Kind::Color | Kind::Normal => {
                // Pictures are no sharper than their pixels.
                let pixel = (1.0 / view.tolerance_px).max(1.0);
                let stretch = (length / Self::LONGEST).clamp(1.0, Self::LEAST_SHARP);
                Self::WIDEST_TEXEL * pixel * stretch
            }
        };
        let all = self.lenses.iter().zip(self.views).zip(sights);
        let seen = all.filter(|(_, sight)| sight.is_seen());
        let least = seen.map(|((lens, view), _)| {
            let scale = self.views[0].tolerance_px / view.tolerance_px;
            let reach = lens.farthest(&child.volume);
            let length = lens.footprint_length(&child.volume, reach);
            lens.pixels(parent.error_m, reach) * scale / widest(view, length)
        });
        least.fold(f64::INFINITY, f64::min)
    }

    /// A page as it is seen, one sight for each view; or `None`, and none, if it is not. Its parent may be
    /// known, and that all of it is in sight of one of the views.
    fn look_at(
        &self,
        kind: Kind,
        node: &Node,
        (parent, whole): (Option<usize>, bool),
        sights: &mut Vec<Sight>,
        found: &mut Found,
    ) -> Option<Glance> {
        found.visited += 1;
        let mark = sights.len();
        let views = self.lenses.len();
        let mut texel_m = node.texel_m;
        if let Some(place) = parent {
            texel_m = texel_m.min(found.seen[place].texel_m);
        }
        let mut nearest = f64::INFINITY;
        for (number, lens) in self.lenses.iter().enumerate() {
            let above = parent.map(|place| sights[place * views + number]);
            let is_hopeless = node.is_empty || above.as_ref().is_some_and(|above| !above.is_seen());
            let mut sight = if is_hopeless {
                Sight::NONE
            } else if whole && views == 1 {
                lens.sight_at(&node.volume, Position::Within)
            } else {
                lens.sight(&node.volume)
            };
            if let Some(above) = above {
                sight = sight.within(&above);
            }
            nearest = nearest.min(sight.distance);
            sights.push(sight);
        }
        if nearest.is_infinite() {
            sights.truncate(mark);
            found.culled += 1;
            return None;
        }
        let bound = f64::from(node.bound);
        let error_m = match kind {
            // Of flattened terrain, heights are still told.
            Kind::Height => self.exaggeration.max(1.0) * bound,
            // Less than half a code is not seen.
            Kind::Color | Kind::Normal if bound < 0.5 => 0.0,
            Kind::Color | Kind::Normal => texel_m,
        };
        let pixels = self.worst(error_m, sights[mark..].iter().copied());
        let is_in = sights[mark..].iter().any(|sight| sight.is_whole)
            || self.lenses.iter().any(|lens| lens.shows(node.volume.bounds().center));
        Some(Glance { texel_m, distance: nearest, error_m, pixels, is_in })
    }

    /// How large a length is in the view in which it is largest for its tolerance, in pixels of the
    /// first one.
    fn worst(&self, length_m: f64, sights: impl Iterator<Item = Sight>) -> f64 {
        let first = self.views[0].tolerance_px;
        let all = self.lenses.iter().zip(self.views).zip(sights);
        let seen = all.filter(|(_, sight)| sight.is_seen());
        let pixels = seen.map(|((lens, view), sight)| {
            lens.pixels(length_m, sight.reach) * (first / view.tolerance_px)
        });
        pixels.fold(0.0, f64::max)
    }
}
