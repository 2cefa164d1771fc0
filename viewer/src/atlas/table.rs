//! The page table: integers that lead the shaders from a place of a dataset to a slot.
//!
//! `shader/page_table.wgsl` draws it. Each level of a dataset has a window of pages about those in
//! memory; on a grid that wraps, the window may run over the seam.

use std::collections::HashMap;

use areoid_formats::address::{Level, PageAddress, PageKey};
use areoid_formats::pyramid::Pyramid;

use crate::map::Windows;

/// Integers in the header of a window.
const WINDOW_LEN: usize = 5;

/// Integers of the whole table at most: 64 MB. What is beyond shows coarser pages.
const MOST_LEN: u64 = 1 << 24;

/// Entries of one level at most: pages beyond show their ancestors.
const MOST_ENTRIES: u64 = 1 << 20;

const HOLDS: u32 = 1 << 31;
const WHOLE: u32 = 1 << 30;
const GRAY: u32 = 1 << 15;
const LEVEL_SHIFT: u32 = 16;
const PRESENCE_SHIFT: u32 = 24;

/// More slots an entry cannot name.
pub(crate) const MOST_SLOTS: u32 = GRAY;

/// The presence of a page that shows wholly.
pub(crate) const PRESENT: u8 = 63;

/// A page that lies in the atlas.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Shown {
    pub(crate) page: PageAddress,
    pub(crate) slot: u32,
    /// Whether that is one of the atlas of grays.
    pub(crate) gray: bool,
    /// Whether every texel is fully covered.
    pub(crate) whole: bool,
    /// Up to [`PRESENT`]: how far it shows, and not what was there before it.
    pub(crate) presence: u8,
}

/// Writes the windows of one dataset. Where there is no page, `roots` show.
pub(crate) fn append(
    table: &mut Vec<i32>,
    pyramid: &Pyramid,
    shown: &[Shown],
    roots: &[Shown],
) -> Windows {
    let entries: HashMap<PageKey, u32> =
        shown.iter().map(|shown| (PageKey::from(shown.page), entry(shown))).collect();
    let first_window = table.len();
    table.resize(first_window + WINDOW_LEN * (usize::from(pyramid.finest().0) + 1), 0);
    for level in pyramid.levels() {
        let mut window = Window::about(pyramid, level, shown);
        let entries_here = u64::from(window.rows) * u64::from(window.cols);
        if table.len() as u64 + entries_here > MOST_LEN {
            window = Window::EMPTY;
        }
        let header = first_window + WINDOW_LEN * usize::from(level.0);
        let start = table.len();
        let fields = [window.row, window.col, window.rows, window.cols].map(narrow);
        table[header..header + 4].copy_from_slice(&fields);
        table[header + 4] = i32::try_from(start).expect("a table is far smaller than 2^31");
        let (_, cols) = pyramid.pages(level).expect("the level is the pyramid's");
        for row in window.row..window.row + window.rows {
            for col in window.col..window.col + window.cols {
                let mut page = Some(PageAddress::new(level, row, col % cols));
                let mut found = 0;
                while let Some(asked) = page {
                    if let Some(&entry) = entries.get(&PageKey::from(asked)) {
                        found = entry;
                        break;
                    }
                    page = asked.parent();
                }
                table.push(found.cast_signed());
            }
        }
    }
    let deepest = shown.iter().map(|shown| i32::from(shown.page.level.0)).max().unwrap_or(0);
    let place = |length: usize| i32::try_from(length).expect("a table is far smaller than 2^31");
    let (rows, cols) = pyramid.pages(Level(0)).expect("every pyramid has a coarsest level");
    let most = u64::from(rows) * u64::from(cols);
    let has_roots = !roots.is_empty() && table.len() as u64 + most <= MOST_LEN;
    let first_root = if has_roots { place(table.len()) } else { -1 };
    if has_roots {
        table.resize(table.len() + (rows * cols) as usize, 0);
        for root in roots {
            let at = (root.page.row * cols + root.page.col).cast_signed() + first_root;
            table[at.unsigned_abs() as usize] = entry(root).cast_signed();
        }
    }
    Windows { first: place(first_window), deepest, roots: first_root }
}

fn entry(shown: &Shown) -> u32 {
    debug_assert!(shown.slot < MOST_SLOTS, "{} is a slot that no entry can name", shown.slot);
    let whole = if shown.whole { WHOLE } else { 0 };
    let gray = if shown.gray { GRAY } else { 0 };
    let presence = u32::from(shown.presence.min(PRESENT)) << PRESENCE_SHIFT;
    HOLDS | whole | presence | u32::from(shown.page.level.0) << LEVEL_SHIFT | gray | shown.slot
}

fn narrow(count: u32) -> i32 {
    i32::try_from(count).expect("a level has at most 2^28 pages in a row")
}

/// A rectangle of pages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Window {
    row: u32,
    col: u32,
    rows: u32,
    cols: u32,
}

impl Window {
    const EMPTY: Self = Self { row: 0, col: 0, rows: 0, cols: 0 };

    /// The least window that holds the pages of `level`, or an empty one.
    fn about(pyramid: &Pyramid, level: Level, shown: &[Shown]) -> Self {
        let (_, level_cols) = pyramid.pages(level).expect("the level is the pyramid's");
        let pages = || shown.iter().map(|shown| shown.page).filter(|page| page.level == level);
        let (Some(row), Some(last)) =
            (pages().map(|page| page.row).min(), pages().map(|page| page.row).max())
        else {
            return Self::EMPTY;
        };
        let mut occupied: Vec<u32> = pages().map(|page| page.col).collect();
        occupied.sort_unstable();
        occupied.dedup();
        let (first, end) = (occupied[0], occupied[occupied.len() - 1]);
        let (mut col, mut cols) = (first, end - first + 1);
        if pyramid.extent().wraps {
            // Leave out the widest gap: the window starts behind it.
            for pair in occupied.windows(2) {
                let rest = level_cols - (pair[1] - pair[0]) + 1;
                if rest < cols {
                    (col, cols) = (pair[1], rest);
                }
            }
        }
        let rows = last - row + 1;
        if u64::from(rows) * u64::from(cols) > MOST_ENTRIES {
            return Self::EMPTY;
        }
        Self { row, col, rows, cols }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use areoid_formats::pyramid::{Extent, PoleContact};
    use proptest::prelude::*;

    fn globe() -> Pyramid {
        let (north, south) = (PoleContact::Outline, PoleContact::Outline);
        let extent = Extent { width: 1920, height: 960, wraps: true, north, south };
        Pyramid::new(extent, 32).unwrap()
    }

    /// The shader's search, word for word.
    fn find(table: &[i32], first_window: usize, pyramid: &Pyramid, page: PageAddress) -> u32 {
        let mut asked = Some(page);
        while let Some(page) = asked {
            let header = first_window + WINDOW_LEN * usize::from(page.level.0);
            let cols = narrow(pyramid.pages(page.level).unwrap().1);
            let row = narrow(page.row) - table[header];
            let mut col = narrow(page.col) - table[header + 1];
            if col < 0 && pyramid.extent().wraps {
                col += cols;
            }
            let within = (0..table[header + 2]).contains(&row);
            if within && (0..table[header + 3]).contains(&col) {
                let at = table[header + 4] + row * table[header + 3] + col;
                return table[usize::try_from(at).unwrap()].cast_unsigned();
            }
            asked = page.parent();
        }
        0
    }

    #[test]
    fn a_window_runs_over_the_seam() {
        let pyramid = globe();
        let level = pyramid.finest();
        let cols = pyramid.pages(level).unwrap().1;
        let at = |row, col| Shown {
            page: PageAddress::new(level, row, col),
            slot: 0,
            gray: false,
            whole: true,
            presence: PRESENT,
        };
        let window = Window::about(&pyramid, level, &[at(3, 0), at(4, cols - 1), at(3, 2)]);
        assert_eq!(window, Window { row: 3, col: cols - 1, rows: 2, cols: 4 });
    }

    proptest! {
        #[test]
        fn every_place_leads_to_its_finest_ancestor(
            picks in prop::collection::vec((0..8_u8, any::<u32>(), any::<u32>()), 0..40),
            level in 0..8_u8, row in any::<u32>(), col in any::<u32>(),
        ) {
            let pyramid = globe();
            let place = |level: u8, row: u32, col: u32| {
                let level = Level(level.min(pyramid.finest().0));
                let (rows, cols) = pyramid.pages(level).unwrap();
                PageAddress::new(level, row % rows, col % cols)
            };
            let mut pages: Vec<_> = picks.iter().map(|&(l, r, c)| place(l, r, c)).collect();
            pages.sort();
            pages.dedup();
            let shown: Vec<Shown> = (0..).zip(&pages)
                .map(|(slot, &page)| {
                    Shown { page, slot, gray: false, whole: slot % 2 == 0, presence: 7 }
                })
                .collect();
            let mut table = vec![7; 3];
            let first = append(&mut table, &pyramid, &shown, &[]).first.unsigned_abs() as usize;

            let asked = place(level, row, col);
            let mut ancestor = Some(asked);
            let expected = loop {
                let Some(page) = ancestor else { break 0 };
                if let Some(shown) = shown.iter().find(|shown| shown.page == page) {
                    break entry(shown);
                }
                ancestor = page.parent();
            };
            prop_assert_eq!(find(&table, first, &pyramid, asked), expected);
        }
    }
}
