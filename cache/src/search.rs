//! Which pages a view needs: a refinement from the roots, the largest error on the screen first.
//!
//! A page whose error is above the tolerance gives way to its children; what is left are the
//! *wanted* pages. Because the worst page is always the next to give way, the search can end
//! anywhere: what it has then is the best picture for its bytes, and the error of the page it
//! ended at is the tolerance that it meets.
//!
//! Bounds and volumes nest, boxes do not: distance and angle are kept at least as favorable as the
//! parent's, so that errors fall from parent to child and the order above is one.
//!
//! # References
//!
//! * `ARCHITECTURE.md`: the error on the screen, and what is out of sight, cheapest first.
//! * White 2011, chapter 4: the search over a BVH of datasets with a quadtree each.

use std::cmp::Ordering;
use std::collections::{BinaryHeap, HashMap};

use areoid_formats::address::PageAddress;
use areoid_formats::archive::PageEntry;
use areoid_formats::page::Kind;
use areoid_formats::volume::Horizon;

use crate::scene::{Node, Scene};
use crate::view::{Lens, View};

/// A page in sight.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seen {
    pub(crate) dataset: usize,
    pub(crate) node: Node,
    /// Its place in [`Found::seen`].
    pub(crate) parent: Option<usize>,
    pub(crate) distance: f64,
    cosine: f64,
    /// Its error on the screen.
    pub(crate) pixels: f64,
}

/// What a search found.
#[derive(Debug, Default)]
pub(crate) struct Found {
    /// Wanted pages and all of their ancestors: a parent stands before its children.
    pub(crate) seen: Vec<Seen>,
    /// The wanted ones, as places in `seen`.
    pub(crate) wanted: Vec<usize>,
    /// The wanted ones whose children are not known yet.
    pub(crate) unindexed: Vec<usize>,
    pub(crate) tolerance_px: f64,
    pub(crate) visited: usize,
    pub(crate) culled: usize,
}

/// Children of the pages that recent searches refined. Volumes cost more than the rest of a
/// search.
#[derive(Debug, Default)]
pub(crate) struct Memo {
    children: HashMap<(usize, PageAddress), (u64, Vec<Node>)>,
    clock: u64,
    used: usize,
}

/// Bytes of a decoded page.
pub(crate) fn page_bytes(scene: &Scene, dataset: usize, entry: &PageEntry) -> usize {
    let info = &scene.infos[dataset];
    let side = info.grid.pyramid().page_side() as usize;
    let per_texel = match info.kind {
        Kind::Height => size_of::<f32>(),
        Kind::Color | Kind::Normal => 3,
    };
    side * side * (per_texel + usize::from(!entry.full))
}

/// The pages that `view` needs, with their ancestors within `allowance` bytes.
pub(crate) fn search(scene: &Scene, memo: &mut Memo, view: &View, allowance: usize) -> Found {
    memo.begin();
    let lens = Lens::new(view);
    let horizon = Horizon::new(view.eye, scene.inscribed_radius());
    let search = Search { scene, lens: &lens, horizon };
    let mut found = Found { tolerance_px: view.tolerance_px, ..Found::default() };

    let mut roots = search.roots(&mut found);
    // If not even the roots fit, those that matter least stay away.
    roots.sort_by(|one, other| other.pixels.total_cmp(&one.pixels));
    let mut bytes = 0;
    let mut heap = BinaryHeap::new();
    for root in roots {
        let more = page_bytes(scene, root.dataset, &root.node.entry);
        if bytes + more > allowance {
            found.tolerance_px = f64::INFINITY;
            break;
        }
        bytes += more;
        heap.push(Candidate { pixels: root.pixels, place: found.seen.len() });
        found.seen.push(root);
    }

    let mut children = Vec::new();
    while let Some(Candidate { pixels, place }) = heap.pop() {
        let parent = found.seen[place];
        let page = parent.node.entry.page;
        let finest = scene.infos[parent.dataset].grid.pyramid().finest();
        if pixels <= found.tolerance_px {
            // So are all the others.
            found.wanted.push(place);
            found.wanted.extend(heap.drain().map(|candidate| candidate.place));
            break;
        }
        if page.level == finest {
            found.wanted.push(place);
            continue;
        }
        let Some(nodes) = memo.children(scene, parent.dataset, page) else {
            found.wanted.push(place);
            found.unindexed.push(place);
            continue;
        };
        let known = !nodes.is_empty();
        children.clear();
        for &node in nodes {
            children.extend(search.look_at(
                parent.dataset,
                node,
                Some((place, parent)),
                &mut found,
            ));
        }
        let more: usize = children
            .iter()
            .map(|child: &Seen| page_bytes(scene, child.dataset, &child.node.entry))
            .sum();
        if !known {
            found.wanted.push(place);
        } else if bytes + more > allowance {
            found.tolerance_px = pixels;
            found.wanted.push(place);
        } else {
            bytes += more;
            for &child in &children {
                heap.push(Candidate { pixels: child.pixels, place: found.seen.len() });
                found.seen.push(child);
            }
        }
    }
    search.drop_unseen(memo, &mut found);
    memo.end();
    found
}

struct Search<'a> {
    scene: &'a Scene,
    lens: &'a Lens,
    horizon: Option<Horizon>,
}

impl Search<'_> {
    /// Boxes are thick whose height is more than this part of their width.
    const THICK: f64 = 12.0;

    /// The roots in sight, through the tree over the datasets.
    fn roots(&self, found: &mut Found) -> Vec<Seen> {
        let greatest = self.scene.greatest_radius();
        let mut datasets = Vec::new();
        self.scene.tree.visit(
            |bounds| {
                let hidden =
                    self.horizon.is_some_and(|horizon| horizon.hides_box(bounds, greatest));
                !hidden && !bounds.outside(&self.lens.frustum)
            },
            |dataset| datasets.push(dataset as usize),
        );
        datasets.sort_unstable();
        let mut roots = Vec::new();
        for dataset in datasets {
            for &entry in &self.scene.datasets[dataset].roots {
                let node = self.scene.node(dataset, entry);
                roots.extend(self.look_at(dataset, node, None, found));
            }
        }
        roots
    }

    /// Drops wanted pages of which no child is in sight: a thick box reaches around corners that
    /// its four parts do not. Children without data say nothing about what the page shows there.
    fn drop_unseen(&self, memo: &mut Memo, found: &mut Found) {
        let mut wanted = std::mem::take(&mut found.wanted);
        wanted.retain(|&place| {
            let Seen { dataset, node, .. } = found.seen[place];
            let half = node.volume.bounds().half;
            let (page, pyramid) = (node.entry.page, self.scene.infos[dataset].grid.pyramid());
            if page.level == pyramid.finest() || Self::THICK * half.z < half.x.min(half.y) {
                return true;
            }
            let Some(children) = memo.children(self.scene, dataset, page) else { return true };
            found.visited += children.len();
            let known = children.len() == pyramid.children(page).count();
            let unseen = known && children.iter().all(|child| self.is_out_of_sight(child));
            found.culled += usize::from(unseen);
            !unseen
        });
        found.wanted = wanted;
    }

    fn is_out_of_sight(&self, node: &Node) -> bool {
        let hidden = self.horizon.is_some_and(|horizon| node.volume.hidden_by(&horizon));
        hidden || node.volume.outside(&self.lens.frustum) || node.entry.valid_fraction <= 0.0
    }

    /// A page as it is seen, or `None` if it is not.
    fn look_at(
        &self,
        dataset: usize,
        node: Node,
        parent: Option<(usize, Seen)>,
        found: &mut Found,
    ) -> Option<Seen> {
        found.visited += 1;
        let volume = &node.volume;
        if self.is_out_of_sight(&node) {
            found.culled += 1;
            return None;
        }
        let mut distance = volume.distance_from(self.lens.eye).0;
        let mut cosine = volume.least_cosine(self.lens.eye, self.lens.axis);
        cosine = cosine.max(self.lens.corner_cosine);
        let mut texel_m = node.texel_m;
        if let Some((_, parent)) = parent {
            distance = distance.max(parent.distance);
            cosine = cosine.max(parent.cosine);
            texel_m = texel_m.min(parent.node.texel_m);
        }
        let bound = f64::from(node.entry.bound);
        let error_m = match self.scene.infos[dataset].kind {
            Kind::Height => bound,
            // Less than half a code is not seen.
            Kind::Color | Kind::Normal if bound < 0.5 => 0.0,
            Kind::Color | Kind::Normal => texel_m,
        };
        let pixels = self.lens.pixels(error_m, distance, cosine);
        let node = Node { texel_m, ..node };
        let parent = parent.map(|(place, _)| place);
        Some(Seen { dataset, node, parent, distance, cosine, pixels })
    }
}

impl Memo {
    /// More than so many lists, and twice what the last search used, are not kept.
    const MOST_LISTS: usize = 16_384;

    /// Forgets everything: volumes may have changed.
    pub(crate) fn clear(&mut self) {
        self.children.clear();
    }

    fn begin(&mut self) {
        self.clock += 1;
        self.used = 0;
    }

    fn children(&mut self, scene: &Scene, dataset: usize, page: PageAddress) -> Option<&[Node]> {
        use std::collections::hash_map::Entry;
        self.used += 1;
        match self.children.entry((dataset, page)) {
            Entry::Occupied(entry) => {
                let (stamp, nodes) = entry.into_mut();
                *stamp = self.clock;
                Some(nodes)
            }
            Entry::Vacant(entry) => {
                let nodes = scene.children(dataset, page)?;
                Some(&entry.insert((self.clock, nodes)).1)
            }
        }
    }

    fn end(&mut self) {
        if self.children.len() > Self::MOST_LISTS.max(2 * self.used) {
            let clock = self.clock;
            self.children.retain(|_, (stamp, _)| *stamp == clock);
        }
    }
}

/// The next to give way is the one with the largest error; of equals, the one found first.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    pixels: f64,
    place: usize,
}

impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> Ordering {
        self.pixels.total_cmp(&other.pixels).then(other.place.cmp(&self.place))
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
