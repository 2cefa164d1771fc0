//! A tree from all its boxes at once: at every node the cut with the least surface area.

use super::{Bvh, Content, Node};
use crate::bounds::Aabb;

/// Boxes that still want a subtree, and where it hangs.
struct Pending {
    items: Vec<(u32, Aabb)>,
    parent: Option<usize>,
}

pub(super) fn build(items: Vec<(u32, Aabb)>) -> Bvh {
    let mut tree = Bvh::default();
    let mut pending = vec![Pending { items, parent: None }];
    while let Some(Pending { mut items, parent }) = pending.pop() {
        let bounds = items.iter().fold(Aabb::EMPTY, |all, (_, one)| all.union(one));
        let diagonals = items.iter().map(|(_, one)| one.diagonal());
        let largest_m = diagonals.fold(0.0, f64::max);
        let index = tree.nodes.len();
        match items.as_slice() {
            [] => return tree,
            &[(item, bounds)] => {
                tree.nodes.push(Node { parent, ..Node::leaf(item, bounds) });
                tree.leaves.insert(item, index);
            }
            _ => {
                let right = split(&mut items);
                // The children put themselves in their places.
                let content = Content::Inner([index; 2]);
                tree.nodes.push(Node { bounds, largest_m, parent, content });
                pending.push(Pending { items: right, parent: Some(index) });
                pending.push(Pending { items, parent: Some(index) });
            }
        }
        match parent {
            None => tree.root = Some(index),
            Some(parent) => {
                if let Content::Inner(children) = &mut tree.nodes[parent].content {
                    let place = usize::from(children[0] != parent);
                    children[place] = index;
                }
            }
        }
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
