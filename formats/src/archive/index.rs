//! The index: a static search tree of 64 KiB blocks, used where it lies.
//!
//! ```text
//!   root ──────▶ (first key, checksum) of each block below
//!                 │
//!                 ├─▶ inner blocks: the same, one level down
//!                 │
//!                 └─▶ leaf blocks: entries of 64 bytes, sorted by key
//! ```
//!
//! Blocks of a height lie one after another, leaves first, the root last; the children of block b
//! are the blocks b·4092 … of the height below, so no block stores a position. The trailer holds
//! the checksum of the root, and each block those of its children: one touched block is proven by
//! the few above it, and opening an archive reads none.

use super::bytes::{checksum, put, u32_at, u64_at};
use super::entry::{ENTRY_LEN, PageEntry};
use crate::address::PageKey;

/// Size of a block in bytes.
pub const BLOCK_LEN: usize = 64 * 1024;
/// Entries in a full leaf block.
pub const ENTRIES_PER_LEAF: usize = (BLOCK_LEN - BLOCK_HEAD_LEN) / ENTRY_LEN;
/// Children of a full inner block.
pub const CHILDREN_PER_BLOCK: usize = (BLOCK_LEN - BLOCK_HEAD_LEN) / CHILD_LEN;

const BLOCK_HEAD_LEN: usize = 64;
const CHILD_LEN: usize = 16;
const BLOCK_MAGIC: [u8; 4] = *b"ArIx";
const HEIGHT_AT: usize = 4;
const COUNT_AT: usize = 8;
const ARCHIVE_AT: usize = 16;
const _: () = assert!(ENTRIES_PER_LEAF * ENTRY_LEN == BLOCK_LEN - BLOCK_HEAD_LEN);
const _: () = assert!(CHILDREN_PER_BLOCK * CHILD_LEN == BLOCK_LEN - BLOCK_HEAD_LEN);

/// The shape of an index: how many blocks stand at each height, leaves first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct IndexShape {
    entries: u64,
    blocks: Vec<u64>,
}

impl IndexShape {
    /// The shape of an index of `entries` pages. Without pages there are no blocks.
    #[must_use]
    pub fn new(entries: u64) -> Self {
        let mut blocks = Vec::new();
        let mut count = entries.div_ceil(ENTRIES_PER_LEAF as u64);
        while count > 0 {
            blocks.push(count);
            if count == 1 {
                break;
            }
            count = count.div_ceil(CHILDREN_PER_BLOCK as u64);
        }
        Self { entries, blocks }
    }

    /// Blocks in all.
    #[must_use]
    pub fn block_count(&self) -> u64 {
        self.blocks.iter().sum()
    }

    /// The height of the root above the leaves, or `None` if there are no blocks.
    #[must_use]
    pub fn root_height(&self) -> Option<usize> {
        self.blocks.len().checked_sub(1)
    }

    /// Blocks at `height`.
    #[must_use]
    pub fn blocks_at(&self, height: usize) -> u64 {
        self.blocks.get(height).copied().unwrap_or(0)
    }

    /// The number of block `block` of `height` in the order of the file, or `None` if there is no
    /// such block.
    #[must_use]
    pub fn position(&self, height: usize, block: u64) -> Option<u64> {
        let below = self.blocks.iter().take(height).sum::<u64>();
        (block < self.blocks_at(height)).then_some(below + block)
    }

    /// How many items block `block` of `height` holds: as many as fit, but for the last.
    #[must_use]
    pub fn items_in(&self, height: usize, block: u64) -> usize {
        let (all, room) = match height.checked_sub(1) {
            None => (self.entries, ENTRIES_PER_LEAF),
            Some(below) => (self.blocks_at(below), CHILDREN_PER_BLOCK),
        };
        let before = block.saturating_mul(room as u64);
        usize::try_from(all.saturating_sub(before)).unwrap_or(room).min(room)
    }
}

/// Writes the blocks of an index, leaves first, and returns them with the checksum of the root (0
/// without pages).
///
/// `entries` are sorted by key.
#[must_use]
pub fn build(entries: &[PageEntry], archive: u64) -> (Vec<u8>, u64) {
    let mut bytes = Vec::new();
    let mut level: Vec<(u64, u64)> = Vec::new();
    for chunk in entries.chunks(ENTRIES_PER_LEAF) {
        let items = chunk.iter().map(PageEntry::to_bytes);
        level.push(push_block(&mut bytes, 0, archive, items));
    }
    let mut height = 0;
    while level.len() > 1 {
        height += 1;
        level = level
            .chunks(CHILDREN_PER_BLOCK)
            .map(|children| {
                let items = children.iter().map(|(key, sum)| {
                    let mut child = [0; CHILD_LEN];
                    put(&mut child, 0, &key.to_le_bytes());
                    put(&mut child, 8, &sum.to_le_bytes());
                    child
                });
                push_block(&mut bytes, height, archive, items)
            })
            .collect();
    }
    let root = level.first().map_or(0, |&(_, sum)| sum);
    (bytes, root)
}

/// Appends a block and returns its first key and its checksum.
fn push_block<const N: usize>(
    bytes: &mut Vec<u8>,
    height: u32,
    archive: u64,
    items: impl ExactSizeIterator<Item = [u8; N]>,
) -> (u64, u64) {
    let start = bytes.len();
    bytes.resize(start + BLOCK_LEN, 0);
    let block = &mut bytes[start..];
    put(block, 0, &BLOCK_MAGIC);
    put(block, HEIGHT_AT, &height.to_le_bytes());
    #[expect(clippy::cast_possible_truncation, reason = "a block holds a few thousand items")]
    let count = items.len() as u32;
    put(block, COUNT_AT, &count.to_le_bytes());
    put(block, ARCHIVE_AT, &archive.to_le_bytes());
    for (place, item) in items.enumerate() {
        put(block, BLOCK_HEAD_LEN + place * N, &item);
    }
    (u64_at(block, BLOCK_HEAD_LEN), checksum(block))
}

/// A block whose checksum held.
#[derive(Clone, Debug)]
pub struct Block(Box<[u8]>);

/// What an inner block says of one child.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Child {
    /// Its place among the block's children.
    pub place: usize,
    /// Its checksum.
    pub checksum: u64,
}

impl Block {
    /// Takes `bytes` as the block of archive `archive` that holds `items` items of `height` and has
    /// the checksum `expected`, or `None` if they are not.
    #[must_use]
    pub fn parse(
        bytes: Box<[u8]>,
        archive: u64,
        height: usize,
        items: usize,
        expected: u64,
    ) -> Option<Self> {
        let room = if height == 0 { ENTRIES_PER_LEAF } else { CHILDREN_PER_BLOCK };
        let whole = bytes.len() == BLOCK_LEN
            && checksum(&bytes) == expected
            && bytes.starts_with(&BLOCK_MAGIC)
            && u64_at(&bytes, ARCHIVE_AT) == archive
            && usize::try_from(u32_at(&bytes, HEIGHT_AT)) == Ok(height)
            && usize::try_from(u32_at(&bytes, COUNT_AT)) == Ok(items)
            && items <= room;
        whole.then_some(Self(bytes))
    }

    fn count(&self) -> usize {
        u32_at(&self.0, COUNT_AT) as usize
    }

    /// The key of item `place`, of `N` bytes.
    fn key<const N: usize>(&self, place: usize) -> PageKey {
        PageKey::from_raw(u64_at(&self.0, BLOCK_HEAD_LEN + place * N))
    }

    /// How many items of `N` bytes have a key up to `key`.
    fn rank<const N: usize>(&self, key: PageKey) -> usize {
        let (mut low, mut high) = (0, self.count());
        while low < high {
            let middle = low.midpoint(high);
            if self.key::<N>(middle) <= key { low = middle + 1 } else { high = middle }
        }
        low
    }

    /// In an inner block, the child that holds `key` if any does.
    #[must_use]
    pub fn child(&self, key: PageKey) -> Option<Child> {
        self.nth_child(self.rank::<CHILD_LEN>(key).checked_sub(1)?)
    }

    /// In an inner block, child number `place`.
    #[must_use]
    pub fn nth_child(&self, place: usize) -> Option<Child> {
        (place < self.count()).then(|| Child {
            place,
            checksum: u64_at(&self.0, BLOCK_HEAD_LEN + place * CHILD_LEN + 8),
        })
    }

    /// In a leaf block, the entry of `key`.
    #[must_use]
    pub fn entry(&self, key: PageKey) -> Option<PageEntry> {
        let place = self.rank::<ENTRY_LEN>(key).checked_sub(1)?;
        (self.key::<ENTRY_LEN>(place) == key).then(|| self.nth_entry(place))
    }

    /// In a leaf block, all entries in order.
    pub fn entries(&self) -> impl Iterator<Item = PageEntry> + '_ {
        (0..self.count()).map(|place| self.nth_entry(place))
    }

    fn nth_entry(&self, place: usize) -> PageEntry {
        PageEntry::from_bytes(&super::bytes::array_at(&self.0, BLOCK_HEAD_LEN + place * ENTRY_LEN))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_index_grows_by_a_height_when_a_block_is_full() {
        let height = |entries| IndexShape::new(entries).root_height();
        let leaf = ENTRIES_PER_LEAF as u64;
        let inner = CHILDREN_PER_BLOCK as u64;
        assert_eq!((leaf, inner), (1023, 4092));
        assert_eq!(height(0), None);
        assert_eq!((height(1), height(leaf), height(leaf + 1)), (Some(0), Some(0), Some(1)));
        assert_eq!((height(leaf * inner), height(leaf * inner + 1)), (Some(1), Some(2)));
        let shape = IndexShape::new(leaf * inner + 1);
        assert_eq!(shape.block_count(), inner + 1 + 2 + 1);
        assert_eq!(shape.position(1, 1), Some(inner + 2));
        assert_eq!((shape.position(1, 2), shape.position(3, 0)), (None, None));
        assert_eq!((shape.items_in(0, 0), shape.items_in(0, inner)), (ENTRIES_PER_LEAF, 1));
        assert_eq!((shape.items_in(1, 0), shape.items_in(1, 1)), (CHILDREN_PER_BLOCK, 1));
        assert_eq!((shape.items_in(2, 0), shape.items_in(2, 1)), (2, 0));
    }
}
