//! Names of pages: a level, a row and a column.
//!
//! ```text
//!      level 0          level 1            level 2
//!    +---------+      +----+----+      +--+--+--+--+
//!    |         |      |0,0 |0,1 |      |0,0  ..    |  row 0 is the top: rows grow downward
//!    |   0,0   |      +----+----+      |           |
//!    |         |      |1,0 |1,1 |      |    .. 3,3 |
//!    +---------+      +----+----+      +--+--+--+--+
//! ```
//!
//! Level 0 is the **coarsest**. How many pages a level has is a matter of the
//! [`Pyramid`](crate::pyramid::Pyramid); an address alone knows only its parent and children.

use std::fmt;

use serde::{Deserialize, Serialize};

/// A depth in the pyramid: 0 is the coarsest level, and each further one doubles the resolution.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
pub struct Level(pub u8);

impl Level {
    /// The level twice as fine.
    #[must_use]
    pub const fn finer(self) -> Self {
        Self(self.0 + 1)
    }

    /// The level half as fine, or `None` above the coarsest.
    #[must_use]
    pub fn coarser(self) -> Option<Self> {
        self.0.checked_sub(1).map(Self)
    }
}

/// The page at `row`, `col` of `level`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PageAddress {
    /// Depth, 0 coarsest.
    pub level: Level,
    /// Pages from the top.
    pub row: u32,
    /// Pages from the left.
    pub col: u32,
}

impl PageAddress {
    /// The most rows or columns of pages that a [`PageKey`] can name.
    pub const MAX_PAGES_PER_SIDE: u32 = 1 << 28;

    /// Names a page.
    #[must_use]
    pub const fn new(level: Level, row: u32, col: u32) -> Self {
        Self { level, row, col }
    }

    /// The page that covers this one a level up, or `None` at level 0.
    #[must_use]
    pub fn parent(self) -> Option<Self> {
        Some(Self { level: self.level.coarser()?, row: self.row / 2, col: self.col / 2 })
    }

    /// The four places that cover this one a level down, row by row. At the lower and right rim of
    /// a level some of them lie outside: ask the pyramid.
    #[must_use]
    pub fn children(self) -> [Self; 4] {
        let level = self.level.finer();
        [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(row, col)| Self {
            level,
            row: 2 * self.row + row,
            col: 2 * self.col + col,
        })
    }
}

/// `3/5/2` is row 5, column 2 of level 3.
impl fmt::Display for PageAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}/{}", self.level.0, self.row, self.col)
    }
}

/// A page's place in the order of the index: by level, then along the Z-order curve.
///
/// ```text
///   63      56 55                                     0
///   +---------+---------------------------------------+
///   |  level  | row and column, bits interleaved:     |
///   |         | row in the odd bits, col in the even  |
///   +---------+---------------------------------------+
/// ```
///
/// A parent sorts before its children, and the four children of a page are neighbors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PageKey(u64);

impl PageKey {
    /// The number as the archive stores it.
    #[must_use]
    pub const fn get(self) -> u64 {
        self.0
    }

    /// The key that the archive stores as `raw`: every number is one.
    #[must_use]
    pub const fn from_raw(raw: u64) -> Self {
        Self(raw)
    }
}

/// # Panics
///
/// In debug builds, if a row or column is not below [`PageAddress::MAX_PAGES_PER_SIDE`]; no
/// pyramid has such pages.
impl From<PageAddress> for PageKey {
    fn from(page: PageAddress) -> Self {
        debug_assert!(page.row.max(page.col) < PageAddress::MAX_PAGES_PER_SIDE, "{page}");
        Self(u64::from(page.level.0) << 56 | spread(page.row) << 1 | spread(page.col))
    }
}

impl From<PageKey> for PageAddress {
    fn from(PageKey(key): PageKey) -> Self {
        let z_order = key & ((1 << 56) - 1);
        Self { level: Level((key >> 56) as u8), row: gather(z_order >> 1), col: gather(z_order) }
    }
}

/// Moves bit i to bit 2i.
const fn spread(value: u32) -> u64 {
    let mut x = value as u64;
    x = (x | x << 16) & 0x0000_ffff_0000_ffff;
    x = (x | x << 8) & 0x00ff_00ff_00ff_00ff;
    x = (x | x << 4) & 0x0f0f_0f0f_0f0f_0f0f;
    x = (x | x << 2) & 0x3333_3333_3333_3333;
    (x | x << 1) & 0x5555_5555_5555_5555
}

/// Moves bit 2i to bit i and drops the odd bits.
#[expect(clippy::cast_possible_truncation, reason = "the upper half is zero by then")]
const fn gather(value: u64) -> u32 {
    let mut x = value & 0x5555_5555_5555_5555;
    x = (x | x >> 1) & 0x3333_3333_3333_3333;
    x = (x | x >> 2) & 0x0f0f_0f0f_0f0f_0f0f;
    x = (x | x >> 4) & 0x00ff_00ff_00ff_00ff;
    x = (x | x >> 8) & 0x0000_ffff_0000_ffff;
    (x | x >> 16) as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_page() -> impl Strategy<Value = PageAddress> {
        let side = 0..PageAddress::MAX_PAGES_PER_SIDE;
        (0..=40_u8, side.clone(), side)
            .prop_map(|(level, row, col)| PageAddress::new(Level(level), row, col))
    }

    proptest! {
        #[test]
        fn a_key_names_one_page(page in any_page()) {
            prop_assert_eq!(PageAddress::from(PageKey::from(page)), page);
        }

        #[test]
        fn every_number_is_a_key(raw in any::<u64>()) {
            prop_assert_eq!(PageKey::from(PageAddress::from(PageKey(raw))), PageKey(raw));
        }

        #[test]
        fn parents_sort_before_their_children(page in any_page()) {
            for child in page.children() {
                prop_assert_eq!(child.parent(), Some(page));
                if child.row.max(child.col) < PageAddress::MAX_PAGES_PER_SIDE {
                    prop_assert!(PageKey::from(page) < PageKey::from(child));
                }
            }
        }
    }
}
