//! A tree of boxes over the datasets of a catalog, to which one can be added while it is used.
//!
//! ```text
//!              [  a  b  c  d  ]
//!              /              \         every inner node is the least box around
//!        [ a  b ]           [ c  d ]    its two children; leaves are datasets
//! ```
//!
//! What a tree costs is the sum of the surface areas of its inner nodes, in units of the root's:
//! the expected number of inner nodes that a random query opens (the surface area heuristic). A new
//! box goes where it adds the least, found by branch and bound, and on the way back up nodes trade
//! children with their grandchildren's where that saves area. Building anew sorts along each axis
//! and takes the best cut.
//!
//! # References
//!
//! * White 2011, chapter 4: a BVH over datasets, with live insertion. He descends greedily; the
//!   branch and bound, and the rotations, keep the tree as good as one built anew.
//! * J. Bittner, M. Hapala and V. Havran, *Incremental BVH construction for ray tracing*, Computers
//!   & Graphics 47, 2015: branch and bound from the root.

mod build;
mod stored;

use std::collections::{BTreeMap, BinaryHeap};
use std::hint::black_box;

use serde::{Deserialize, Serialize};

use crate::bounds::Aabb;
use stored::Stored;

/// A tree of boxes, each with a number that the caller chose, or [`Self::renumber`] gave it.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(try_from = "Stored", into = "Stored")]
pub struct Bvh {
    nodes: Vec<Node>,
    /// Of each node, if it has one.
    parents: Vec<Option<usize>>,
    root: Option<usize>,
    free: Vec<usize>,
    /// Where the leaf of each item is.
    leaves: BTreeMap<u32, usize>,
}

/// What a query reads: a line of a processor's cache, whose misses are most of what it costs.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
struct Node {
    bounds: Aabb,
    /// The greatest extent of the items below, in meters.
    largest_m: f64,
    /// Two children, or an item and [`Self::LEAF`].
    parts: [u32; 2],
}

#[derive(Clone, Copy, Debug)]
enum Content {
    Leaf(u32),
    Inner([usize; 2]),
}

/// A part of a tree, for whoever walks it in an order of its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Branch {
    /// A box around all of its items.
    pub bounds: Aabb,
    /// The greatest extent of one of them, in meters: the diagonal of its box, or what
    /// [`Bvh::set_extent`] was told.
    pub largest_m: f64,
    /// What it is made of.
    pub parts: Parts,
}

/// What a [`Branch`] is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Parts {
    /// One item.
    Item(u32),
    /// Two more branches, for [`Bvh::branch`].
    Branches([usize; 2]),
}

/// A place a new box may go to, by the least that it can cost there.
struct Candidate {
    node: usize,
    /// What the ancestors grow by.
    inherited: f64,
    least: f64,
}

const _: () = assert!(size_of::<Node>() == 64);

impl Node {
    /// The index that no child has.
    const LEAF: u32 = u32::MAX;

    fn leaf(item: u32, bounds: Aabb) -> Self {
        let largest_m = bounds.diagonal();
        Self { bounds, largest_m, parts: [item, Self::LEAF] }
    }

    fn inner(children: [usize; 2], bounds: Aabb, largest_m: f64) -> Self {
        let parts = children.map(|child| u32::try_from(child).expect("fewer than 2^32 nodes"));
        Self { bounds, largest_m, parts }
    }

    fn content(&self) -> Content {
        match self.parts {
            [item, Self::LEAF] => Content::Leaf(item),
            children => Content::Inner(children.map(|child| child as usize)),
        }
    }
}

impl Bvh {
    /// The tree of `items`, built at once. Of two boxes with one number the later counts.
    #[must_use]
    pub fn build(items: impl IntoIterator<Item = (u32, Aabb)>) -> Self {
        let items: BTreeMap<u32, Aabb> = items.into_iter().collect();
        build::build(items.into_iter().collect())
    }

    /// Boxes in the tree.
    #[must_use]
    pub fn len(&self) -> usize {
        self.leaves.len()
    }

    /// Whether there is no box.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.leaves.is_empty()
    }

    /// The box around everything; empty if there is nothing.
    #[must_use]
    pub fn bounds(&self) -> Aabb {
        self.root.map_or(Aabb::EMPTY, |root| self.nodes[root].bounds)
    }

    /// The box of `item`, if it is in the tree.
    #[must_use]
    pub fn get(&self, item: u32) -> Option<Aabb> {
        self.leaves.get(&item).map(|&leaf| self.nodes[leaf].bounds)
    }

    /// Surface areas of the inner nodes in units of the root's: what a query has to open.
    #[must_use]
    pub fn cost(&self) -> f64 {
        let whole = self.bounds().half_area();
        if whole == 0.0 {
            return 0.0;
        }
        let mut total = 0.0;
        self.walk(|node| {
            if let Content::Inner(_) = node.content() {
                total += node.bounds.half_area();
            }
            true
        });
        total / whole
    }

    /// Calls `found` with every item whose box, and all boxes around it, `keep` returns true for.
    pub fn visit(&self, mut keep: impl FnMut(&Aabb) -> bool, mut found: impl FnMut(u32)) {
        self.walk(|node| {
            let kept = keep(&node.bounds);
            if let (true, Content::Leaf(item)) = (kept, node.content()) {
                found(item);
            }
            kept
        });
    }

    /// The branch that is the whole tree, for [`Self::branch`].
    #[must_use]
    pub fn trunk(&self) -> Option<usize> {
        self.root
    }

    /// A branch of this very tree.
    ///
    /// # Panics
    ///
    /// If the tree has no such branch.
    #[must_use]
    pub fn branch(&self, index: usize) -> Branch {
        let node = &self.nodes[index];
        let Node { bounds, largest_m, .. } = *node;
        let parts = match node.content() {
            Content::Leaf(item) => Parts::Item(item),
            Content::Inner(children) => Parts::Branches(children),
        };
        Branch { bounds, largest_m, parts }
    }

    /// Asks memory for a branch, for [`Self::branch`]. Asked for together, a few come in little more than the
    /// time of one.
    ///
    /// # Panics
    ///
    /// If the tree has no such branch.
    #[inline]
    pub fn fetch(&self, index: usize) {
        black_box(self.nodes[index].largest_m);
    }

    /// The items whose boxes meet `bounds`, in ascending order.
    #[must_use]
    pub fn meeting(&self, bounds: &Aabb) -> Vec<u32> {
        let mut items = Vec::new();
        self.visit(|node| node.meets(bounds), |item| items.push(item));
        items.sort_unstable();
        items
    }

    /// Adds a box, in place of the one that `item` had before.
    pub fn insert(&mut self, item: u32, bounds: Aabb) {
        self.remove(item);
        let leaf = self.add(Node::leaf(item, bounds), None);
        self.leaves.insert(item, leaf);
        let Some(sibling) = self.best_sibling(&bounds) else {
            self.root = Some(leaf);
            return;
        };

        let parent = self.parents[sibling];
        let above = self.add(self.around([sibling, leaf]), parent);
        self.replace_child(parent, sibling, above);
        self.parents[sibling] = Some(above);
        self.parents[leaf] = Some(above);
        self.refit(parent);
    }

    /// Says how large an item is, in meters, if that is not the diagonal of its box: until it is inserted
    /// anew, and not in what is written down. Of an item that is not in the tree nothing is noted.
    pub fn set_extent(&mut self, item: u32, extent_m: f64) {
        let Some(&leaf) = self.leaves.get(&item) else { return };
        self.nodes[leaf].largest_m = extent_m;
        let mut next = self.parents[leaf];
        while let Some(index) = next {
            if let Content::Inner([one, other]) = self.nodes[index].content() {
                self.nodes[index] = self.around([one, other]);
            }
            next = self.parents[index];
        }
    }

    /// Gives items other numbers, from 0 on, in the order in which a walk through the tree comes to them: mostly
    /// what has near numbers lies near. Returns their numbers of before in that order.
    pub fn renumber(&mut self) -> Vec<u32> {
        let mut before = Vec::with_capacity(self.len());
        self.walk(|node| {
            if let Content::Leaf(item) = node.content() {
                before.push(item);
            }
            true
        });
        let places: Vec<usize> = before.iter().map(|item| self.leaves[item]).collect();
        self.leaves = (0..).zip(places).collect();
        for (&item, &leaf) in &self.leaves {
            self.nodes[leaf].parts = [item, Node::LEAF];
        }
        before
    }

    /// Removes a box; whether there was one.
    pub fn remove(&mut self, item: u32) -> bool {
        let Some(leaf) = self.leaves.remove(&item) else { return false };
        self.free.push(leaf);
        let Some(parent) = self.parents[leaf] else {
            self.root = None;
            return true;
        };
        let Content::Inner([one, other]) = self.nodes[parent].content() else {
            unreachable!("a parent has children");
        };
        let sibling = if one == leaf { other } else { one };
        let above = self.parents[parent];
        self.parents[sibling] = above;
        self.replace_child(above, parent, sibling);
        self.free.push(parent);
        self.refit(above);
        true
    }

    /// Visits nodes from the root down for as long as `open` returns true.
    fn walk(&self, mut open: impl FnMut(&Node) -> bool) {
        // A stack of our own: an unlucky tree is deep.
        let mut pending: Vec<usize> = self.root.into_iter().collect();
        while let Some(index) = pending.pop() {
            let node = &self.nodes[index];
            if let (true, Content::Inner([one, other])) = (open(node), node.content()) {
                pending.extend([other, one]);
            }
        }
    }

    /// The node beside which a new box adds the least area, or `None` in an empty tree.
    fn best_sibling(&self, bounds: &Aabb) -> Option<usize> {
        let area = bounds.half_area();
        let mut best = (f64::INFINITY, None);
        let mut candidates = BinaryHeap::new();
        candidates.extend(self.root.map(|node| Candidate { node, inherited: 0.0, least: area }));
        while let Some(Candidate { node: index, inherited, least }) = candidates.pop() {
            if least >= best.0 {
                break;
            }
            let node = &self.nodes[index];
            let joined = node.bounds.union(bounds).half_area();
            if inherited + joined < best.0 {
                best = (inherited + joined, Some(index));
            }
            if let Content::Inner(children) = node.content() {
                let inherited = inherited + joined - node.bounds.half_area();
                let least = inherited + area;
                if least < best.0 {
                    candidates.extend(children.map(|node| Candidate { node, inherited, least }));
                }
            }
        }
        // Boxes that are no numbers compare with nothing: they go beside the root.
        best.1.or(self.root)
    }

    /// Makes boxes fit again, from `start` to the root.
    fn refit(&mut self, start: Option<usize>) {
        let mut next = start;
        while let Some(index) = next {
            if let Content::Inner([one, other]) = self.nodes[index].content() {
                self.nodes[index] = self.around([one, other]);
                self.rotate(index);
            }
            next = self.parents[index];
        }
    }

    /// Lets a child of `index` trade places with a child of the other one, if that saves area.
    fn rotate(&mut self, index: usize) {
        let Content::Inner(children) = self.nodes[index].content() else { return };
        let mut best = (0.0, None);
        for (child, sibling) in [(children[0], children[1]), (children[1], children[0])] {
            let Content::Inner(grandchildren) = self.nodes[sibling].content() else { continue };
            let area = self.nodes[sibling].bounds.half_area();
            for (kept, traded) in
                [(grandchildren[0], grandchildren[1]), (grandchildren[1], grandchildren[0])]
            {
                let joined = self.nodes[child].bounds.union(&self.nodes[kept].bounds);
                let saved = area - joined.half_area();
                if saved > best.0 {
                    best = (saved, Some((child, sibling, traded)));
                }
            }
        }
        let Some((child, sibling, traded)) = best.1 else { return };
        self.replace_child(Some(index), child, traded);
        self.replace_child(Some(sibling), traded, child);
        self.parents[traded] = Some(index);
        self.parents[child] = Some(sibling);
        if let Content::Inner(children) = self.nodes[sibling].content() {
            self.nodes[sibling] = self.around(children);
        }
    }

    /// The node of two others.
    fn around(&self, children: [usize; 2]) -> Node {
        let [one, other] = children.map(|child| &self.nodes[child]);
        let largest_m = one.largest_m.max(other.largest_m);
        Node::inner(children, one.bounds.union(&other.bounds), largest_m)
    }

    /// Puts `new` where `old` was: below `parent`, or at the root.
    fn replace_child(&mut self, parent: Option<usize>, old: usize, new: usize) {
        let Some(parent) = parent else {
            self.root = Some(new);
            return;
        };
        let node = &mut self.nodes[parent];
        // A parent has children: a leaf is none.
        if let Content::Inner(children) = node.content() {
            let children = children.map(|child| if child == old { new } else { child });
            *node = Node::inner(children, node.bounds, node.largest_m);
        }
    }

    fn add(&mut self, node: Node, parent: Option<usize>) -> usize {
        match self.free.pop() {
            Some(index) => {
                (self.nodes[index], self.parents[index]) = (node, parent);
                index
            }
            None => {
                self.nodes.push(node);
                self.parents.push(parent);
                self.nodes.len() - 1
            }
        }
    }
}

/// Trees are equal if they hold the same boxes under the same numbers, whatever their shapes.
impl PartialEq for Bvh {
    fn eq(&self, other: &Self) -> bool {
        self.len() == other.len()
            && self.leaves.keys().all(|&item| self.get(item) == other.get(item))
    }
}

/// The least cost is the greatest in the heap.
impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        other.least.total_cmp(&self.least)
    }
}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Candidate {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Candidate {}

#[cfg(test)]
mod tests;
