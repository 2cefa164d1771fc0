//! Triangles of the sphere, split where a caller wants detail, and never more than one level apart
//! across an edge.
//!
//! ```text
//!          c                 a triangle splits at the middles of its edges; an edge keeps its
//!         / \                middle and halves for both triangles that it divides, so that
//!    m2  +---+  m1           neighbors share corners by construction
//!       / \ / \
//!      a---+---b             an edge that one triangle alone has got is half of its parent edge,
//!          m0                which the coarser neighbor beyond owns whole
//! ```
//!
//! The tree is built anew for every view: it is a function of the view alone. So that nothing jumps
//! when a triangle splits, it says how far the vertices that a split brings have *come*: 0 as long as
//! they lie between those of before, 1 once they are where they belong. That rises with the parent's
//! excess, from the split on, and is done before a child splits. An edge's vertices have come as far as those of
//! the less split of its two triangles: from both sides the same.
//!
//! # References
//!
//! P-BDAM §4.2: what belongs to an edge is a function of the edge and the eye.

use glam::DVec3;

use super::sphere;

const NONE: u32 = u32::MAX;

/// A parent is so many times coarser than its children, at least: what a caller says of a child is
/// held to that.
const CHILD_RATIO: f64 = 1.5;

/// What a caller makes of a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Verdict {
    /// Out of sight, with everything in it.
    Hidden,
    /// So many times as coarse as it may be: from 1 on it splits. Steady in the view, or
    /// vertices jump.
    Coarse(f64),
}

/// An arc between two corners of the tree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Edge {
    /// Where it starts: a corner.
    pub(crate) start: u32,
    /// Where it ends.
    pub(crate) end: u32,
    /// Its middle, a corner too, or none as long as nobody asked.
    middle: u32,
    /// The first of its two halves.
    halves: u32,
    /// The edge that it is a half of.
    parent: u32,
    /// How many triangles of its own length have it.
    triangles: u8,
    /// How far its own vertices have come, 0 to 1.
    come: f64,
}

/// A triangle to draw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Patch {
    /// Counterclockwise from outside.
    pub(crate) corners: [u32; 3],
    /// How far the vertices that its parent lacks have come, 0 to 1.
    pub(crate) come: f64,
    /// From each corner to the next.
    pub(crate) edges: [PatchEdge; 3],
}

/// One side of a patch: a run along an edge that it shares with its neighbor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct PatchEdge {
    /// The edge whose points both sides use: the patch's own, or the coarser neighbor's.
    pub(crate) edge: u32,
    /// Where the side starts on it, in halves of the edge: 0, 1 or 2.
    pub(crate) first: u32,
    /// Where it ends.
    pub(crate) last: u32,
}

/// What a caller wrote down about a triangle, for when it is asked about its parts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Note {
    /// Where in a list of the caller's.
    pub(crate) first: u32,
    /// Where it ends there.
    pub(crate) end: u32,
}

/// A triangle that a caller is asked about.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Asked {
    /// Unit vectors, counterclockwise from outside.
    pub(crate) corners: [DVec3; 3],
    /// Their numbers in the tree.
    pub(crate) numbers: [u32; 3],
    /// Splits since the icosahedron.
    pub(crate) depth: u8,
    /// What was written down about the triangle that it is a part of; none at depth 0.
    pub(crate) parent: Option<Note>,
}

#[derive(Clone, Copy, Debug)]
struct Triangle {
    corners: [u32; 3],
    edges: [u32; 3],
    depth: u8,
    /// Of its parent first, then its own.
    note: Option<Note>,
    children: u32,
    hidden: bool,
    /// How far its own vertices have come.
    come: f64,
    /// How many times as coarse as it may be.
    excess: f64,
}

/// The triangles of one view. The buffers are kept from view to view.
#[derive(Debug, Default)]
pub(crate) struct Tree {
    corners: Vec<DVec3>,
    edges: Vec<Edge>,
    triangles: Vec<Triangle>,
    patches: Vec<Patch>,
}

impl Tree {
    /// Splits the sphere as `verdict` says of a triangle, and further where neighbors would be two
    /// levels apart.
    pub(crate) fn build(&mut self, mut verdict: impl FnMut(Asked) -> (Verdict, Note)) {
        self.seed();
        let mut next = 0;
        while next < self.triangles.len() {
            self.settle(next, &mut verdict);
            next += 1;
        }
        // A forced split may force the next one: sweep until none does.
        loop {
            let before = self.triangles.len();
            for index in 0..before {
                if self.must_split(index) {
                    self.split(index);
                }
            }
            if self.triangles.len() == before {
                break;
            }
            for index in before..self.triangles.len() {
                self.ask(index, &mut verdict);
            }
        }
        self.collect();
    }

    /// Unit vectors, by corner.
    pub(crate) fn corners(&self) -> &[DVec3] {
        &self.corners
    }

    /// All edges, by number.
    pub(crate) fn edge(&self, index: u32) -> &Edge {
        &self.edges[index as usize]
    }

    /// The triangles to draw.
    pub(crate) fn patches(&self) -> &[Patch] {
        &self.patches
    }

    fn seed(&mut self) {
        self.corners.clear();
        self.edges.clear();
        self.triangles.clear();
        self.patches.clear();
        self.corners.extend(sphere::icosahedron());
        for corners in sphere::FACES {
            let edges = [0, 1, 2].map(|side| {
                let (from, to) = (corners[side], corners[(side + 1) % 3]);
                let found = self.edges.iter().position(|edge| edge.joins(from, to));
                found.map_or_else(|| self.add_edge(from, to, NONE), count)
            });
            // None is coarser than those: their vertices have come from nowhere.
            self.add_triangle(corners, edges, 0, None, 1.0, f64::INFINITY);
        }
    }

    fn settle(&mut self, index: usize, verdict: &mut impl FnMut(Asked) -> (Verdict, Note)) {
        self.ask(index, verdict);
        let Triangle { hidden, excess, .. } = self.triangles[index];
        if !hidden && excess >= 1.0 {
            self.split(index);
        }
    }

    /// Asks about a triangle, and keeps what is said.
    fn ask(&mut self, index: usize, verdict: &mut impl FnMut(Asked) -> (Verdict, Note)) {
        let triangle = &mut self.triangles[index];
        let Triangle { corners: numbers, depth, note: parent, .. } = *triangle;
        let corners = numbers.map(|i| self.corners[i as usize]);
        let asked = Asked { corners, numbers, depth, parent };
        let (verdict, note) = verdict(asked);
        triangle.note = Some(note);
        match verdict {
            Verdict::Hidden => triangle.hidden = true,
            Verdict::Coarse(times) => triangle.excess = triangle.excess.min(times),
        }
    }

    /// Whether an edge of a leaf is split twice on its other side.
    fn must_split(&self, index: usize) -> bool {
        let triangle = &self.triangles[index];
        let twice = |&edge: &u32| {
            let halves = self.edges[edge as usize].halves;
            halves != NONE
                && [halves, halves + 1].iter().any(|&half| self.edges[half as usize].halves != NONE)
        };
        triangle.children == NONE && !triangle.hidden && triangle.edges.iter().any(twice)
    }

    fn split(&mut self, index: usize) {
        let Triangle { corners, edges, depth, note, excess, .. } = self.triangles[index];
        let come = ((excess - 1.0) / (CHILD_RATIO - 1.0)).clamp(0.0, 1.0);
        let most = excess / CHILD_RATIO;
        let middles = edges.map(|edge| self.middle(edge));
        let halves = [0, 1, 2].map(|side| self.halves_from(edges[side], corners[side]));
        let inner = [0, 1, 2].map(|side| {
            // Across the corner at which the side ends.
            self.add_edge(middles[side], middles[(side + 1) % 3], NONE)
        });
        self.triangles[index].children = count(self.triangles.len());
        for side in 0..3 {
            let before = (side + 2) % 3;
            self.add_triangle(
                [corners[side], middles[side], middles[before]],
                [halves[side].0, inner[before], halves[before].1],
                depth + 1,
                note,
                come,
                most,
            );
        }
        self.add_triangle(middles, inner, depth + 1, note, come, most);
    }

    /// The middle of an edge, as a corner.
    fn middle(&mut self, edge: u32) -> u32 {
        let Edge { start, end, middle, .. } = self.edges[edge as usize];
        if middle != NONE {
            return middle;
        }
        let [a, b] = [start, end].map(|i| self.corners[i as usize]);
        let middle = count(self.corners.len());
        self.corners.push(sphere::midpoint(a, b));
        self.edges[edge as usize].middle = middle;
        middle
    }

    /// The two halves of an edge, the one at corner `from` first.
    fn halves_from(&mut self, edge: u32, from: u32) -> (u32, u32) {
        let middle = self.middle(edge);
        let Edge { start, end, halves, .. } = self.edges[edge as usize];
        let first = if halves == NONE {
            let first = self.add_edge(start, middle, edge);
            self.add_edge(middle, end, edge);
            self.edges[edge as usize].halves = first;
            first
        } else {
            halves
        };
        if from == start { (first, first + 1) } else { (first + 1, first) }
    }

    fn add_edge(&mut self, start: u32, end: u32, parent: u32) -> u32 {
        let (middle, halves) = (NONE, NONE);
        self.edges.push(Edge { start, end, middle, halves, parent, triangles: 0, come: 1.0 });
        count(self.edges.len() - 1)
    }

    /// A triangle whose excess is `most` at most.
    fn add_triangle(
        &mut self,
        corners: [u32; 3],
        edges: [u32; 3],
        depth: u8,
        note: Option<Note>,
        come: f64,
        most: f64,
    ) {
        for edge in edges {
            let edge = &mut self.edges[edge as usize];
            edge.triangles += 1;
            edge.come = edge.come.min(come);
        }
        let (children, hidden, excess) = (NONE, false, most);
        self.triangles.push(Triangle {
            corners,
            edges,
            depth,
            note,
            children,
            hidden,
            come,
            excess,
        });
    }

    fn collect(&mut self) {
        for index in 0..self.triangles.len() {
            let Triangle { corners, edges, children, hidden, come, .. } = self.triangles[index];
            if children != NONE || hidden {
                continue;
            }
            let edges = [0, 1, 2].map(|side| self.side(edges[side], corners[side]));
            self.patches.push(Patch { corners, come, edges });
        }
    }

    /// The side of a patch on `edge` that starts at corner `from`.
    fn side(&mut self, edge: u32, from: u32) -> PatchEdge {
        let Edge { start, parent, triangles, .. } = self.edges[edge as usize];
        let forward = start == from;
        if triangles > 1 || parent == NONE {
            self.middle(edge);
            let (first, last) = if forward { (0, 2) } else { (2, 0) };
            return PatchEdge { edge, first, last };
        }
        // The half that starts where its parent starts is the first.
        let offset = u32::from(self.edges[parent as usize].halves != edge);
        let (first, last) = if forward { (offset, offset + 1) } else { (offset + 1, offset) };
        PatchEdge { edge: parent, first, last }
    }
}

impl Edge {
    /// The corner halfway, on every edge that a patch uses.
    pub(crate) fn middle(&self) -> u32 {
        self.middle
    }

    /// How far the vertices have come that half as many would lack, 0 to 1.
    pub(crate) fn come(&self) -> f64 {
        self.come
    }

    fn joins(&self, a: u32, b: u32) -> bool {
        (self.start == a && self.end == b) || (self.start == b && self.end == a)
    }
}

fn count(length: usize) -> u32 {
    u32::try_from(length).expect("a tree that fits in memory has fewer than 2^32 of anything")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashMap;

    /// Splits toward one place of the sphere.
    fn toward(target: DVec3, most: u8) -> Tree {
        let mut tree = Tree::default();
        tree.build(|Asked { corners, depth, .. }| {
            let size = corners[0].distance(corners[1]);
            let near = sphere::distance_to_triangle(target, corners) < 0.3 * size;
            let excess = if depth < most && near { 1e30 } else { 0.0 };
            (Verdict::Coarse(excess), Note::default())
        });
        tree
    }

    #[test]
    fn patches_tile_the_sphere() {
        let tree = toward(DVec3::new(0.3, -0.4, 0.86).normalize(), 9);
        let mut solid_angle = 0.0;
        for patch in tree.patches() {
            let [a, b, c] = patch.corners.map(|i| tree.corners()[i as usize]);
            let edges = 1.0 + a.dot(b) + b.dot(c) + c.dot(a);
            solid_angle += 2.0 * a.dot(b.cross(c)).atan2(edges);
        }
        assert!((solid_angle - 4.0 * std::f64::consts::PI).abs() < 1e-9);
    }

    /// Both sides of every edge walk the same points of the same edge: each half of an edge is
    /// covered by exactly two sides, once in each direction.
    #[test]
    fn neighbors_share_their_edges() {
        for target in [DVec3::Z, DVec3::new(1.0, 0.01, 0.02).normalize()] {
            let tree = toward(target, 12);
            let mut halves: HashMap<(u32, u32), [u32; 2]> = HashMap::new();
            for patch in tree.patches() {
                for side in patch.edges {
                    let backward = usize::from(side.first > side.last);
                    for half in side.first.min(side.last)..side.first.max(side.last) {
                        halves.entry((side.edge, half)).or_default()[backward] += 1;
                    }
                }
            }
            assert!(halves.values().all(|&sides| sides == [1, 1]));
        }
    }

    #[test]
    fn a_side_starts_and_ends_at_corners_of_its_patch() {
        let tree = toward(DVec3::NEG_Z, 8);
        for patch in tree.patches() {
            for (i, side) in patch.edges.iter().enumerate() {
                let edge = tree.edge(side.edge);
                let corner = [edge.start, edge.middle(), edge.end];
                assert_eq!(corner[side.first as usize], patch.corners[i]);
                assert_eq!(corner[side.last as usize], patch.corners[(i + 1) % 3]);
            }
        }
    }
}
