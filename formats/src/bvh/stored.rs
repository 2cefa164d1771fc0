//! A tree as it is written down: its nodes from the root, left before right.
//!
//! Inner nodes are `null`: their boxes follow from the leaves. Nothing read back can make a tree
//! that is none.

use serde::{Deserialize, Serialize};

use super::{Bvh, Content, Node};
use crate::bounds::Aabb;

#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Stored(Vec<Option<Leaf>>);

#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct Leaf {
    item: u32,
    bounds: Aabb,
}

/// Why stored nodes are no tree.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum StoredError {
    #[error("the nodes do not make one tree")]
    Shape,
    #[error("an item is in the tree twice: {0}")]
    Twice(u32),
    #[error("a box is empty or no number, that of item {0}")]
    Box(u32),
}

impl From<Bvh> for Stored {
    fn from(tree: Bvh) -> Self {
        let mut nodes = Vec::new();
        tree.walk(|node| {
            nodes.push(match node.content() {
                Content::Leaf(item) => Some(Leaf { item, bounds: node.bounds }),
                Content::Inner(_) => None,
            });
            true
        });
        Self(nodes)
    }
}

impl TryFrom<Stored> for Bvh {
    type Error = StoredError;

    fn try_from(stored: Stored) -> Result<Self, StoredError> {
        let mut tree = Self::default();
        // Backward, two finished subtrees are the children of the inner node before them.
        let mut finished: Vec<usize> = Vec::new();
        for leaf in stored.0.into_iter().rev() {
            let index = tree.nodes.len();
            let node = match leaf {
                Some(Leaf { item, bounds }) => {
                    let ordered = (0..3).all(|axis| {
                        let (min, max) = (bounds.min[axis], bounds.max[axis]);
                        min.is_finite() && max.is_finite() && min <= max
                    });
                    if !ordered {
                        return Err(StoredError::Box(item));
                    }
                    if tree.leaves.insert(item, index).is_some() {
                        return Err(StoredError::Twice(item));
                    }
                    Node::leaf(item, bounds)
                }
                None => {
                    let (Some(one), Some(other)) = (finished.pop(), finished.pop()) else {
                        return Err(StoredError::Shape);
                    };
                    tree.parents[one] = Some(index);
                    tree.parents[other] = Some(index);
                    tree.around([one, other])
                }
            };
            tree.add(node, None);
            finished.push(index);
        }
        tree.root = finished.pop();
        if finished.is_empty() { Ok(tree) } else { Err(StoredError::Shape) }
    }
}
