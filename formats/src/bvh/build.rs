//! A tree from all its boxes at once: at every node the cut with the least surface area.

use super::{Bvh, Node};
use crate::bounds::Aabb;

/// Boxes that still want a subtree, and where it hangs.
struct Pending {
    items: Vec<(u32, Aabb)>,
    index: usize,
    parent: Option<usize>,
}

/// Siblings lie side by side: whoever looks at one looks at the other.
pub(super) fn build(items: Vec<(u32, Aabb)>) -> Bvh {
    let mut tree = Bvh::default();
    let Some(&(item, bounds)) = items.first() else { return tree };
    // Room for a node that is not known yet.
    let blank = Node::leaf(item, bounds);
    tree.add(blank, None);
    tree.root = Some(0);
    let mut pending = vec![Pending { items, index: 0, parent: None }];
    while let Some(Pending { mut items, index, parent }) = pending.pop() {
        if let &[(item, bounds)] = items.as_slice() {
            (tree.nodes[index], tree.parents[index]) = (Node::leaf(item, bounds), parent);
            tree.leaves.insert(item, index);
            continue;
        }
        let bounds = items.iter().fold(Aabb::EMPTY, |all, (_, one)| all.union(one));
        let diagonals = items.iter().map(|(_, one)| one.diagonal());
        let largest_m = diagonals.fold(0.0, f64::max);
        let right = split(&mut items);
        let children = [(); 2].map(|()| tree.add(blank, None));
        tree.nodes[index] = Node::inner(children, bounds, largest_m);
        tree.parents[index] = parent;
        let parent = Some(index);
        pending.push(Pending { items: right, index: children[1], parent });
        pending.push(Pending { items, index: children[0], parent });
    }
    tree
}

/// Cuts two or more boxes in two, and returns the second part.
fn split(items: &mut Vec<(u32, Aabb)>) -> Vec<(u32, Aabb)> {
    let mut best = (f64::INFINITY, 0, items.len() / 2);
    let mut areas_after = vec![0.0; items.len()];
    for axis in 0..3 {
        sort(items, axis);
        let mut after = Aabb::EMPTY;
        for (place, (_, bounds)) in items.iter().enumerate().rev() {
            after = after.union(bounds);
            areas_after[place] = after.half_area();
        }
        let mut before = Aabb::EMPTY;
        for place in 1..items.len() {
            before = before.union(&items[place - 1].1);
            let (left, right) = (place as f64, (items.len() - place) as f64);
            let cost = before.half_area() * left + areas_after[place] * right;
            if cost < best.0 {
                best = (cost, axis, place);
            }
        }
    }
    sort(items, best.1);
    items.split_off(best.2)
}

fn sort(items: &mut [(u32, Aabb)], axis: usize) {
    // By number where centers agree: the tree depends on its boxes alone.
    items.sort_unstable_by(|(one, a), (other, b)| {
        a.center()[axis].total_cmp(&b.center()[axis]).then(one.cmp(other))
    });
}
