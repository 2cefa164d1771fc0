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
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "small numbers that are not below 0"
)]
mod tests {
    use areoid_formats::body::Ellipsoid;
    use areoid_formats::grid::Outline;
    use areoid_formats::page::Kind;
    use areoid_formats::projection::{Crs, Projection};
    use areoid_formats::pyramid::{Extent, PoleContact};
    use bytemuck::{Pod, Zeroable};

    use super::*;
    use crate::map::DatasetMap;
    use crate::render::testing::{Given, compute};
    use crate::shader::SURFACE;
    use crate::style::Part;
    use crate::testing::{Random, dataset, gpu};

    fn globe() -> Pyramid {
        let (north, south) = (PoleContact::Outline, PoleContact::Outline);
        let extent = Extent { width: 1920, height: 960, wraps: true, north, south };
        Pyramid::new(extent, 32).unwrap()
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

    /// Without a GPU: each level's window has, for each of its pages, the finest at most as fine.
    #[test]
    fn entries_name_the_finest_page_that_is_not_finer() {
        let pyramid = globe();
        let mut random = Random(0xe27);
        let mut below = |count: u32| (random.next() * f64::from(count)) as u32;
        for _ in 0..50 {
            let mut pages: Vec<PageAddress> = (0..below(40))
                .map(|_| {
                    let level = Level(below(u32::from(pyramid.finest().0) + 1) as u8);
                    let (rows, cols) = pyramid.pages(level).unwrap();
                    PageAddress::new(level, below(rows), below(cols))
                })
                .collect();
            pages.sort();
            pages.dedup();
            let shown = |(slot, page): (u32, &PageAddress)| Shown {
                page: *page,
                slot,
                gray: false,
                whole: true,
                presence: PRESENT,
            };
            let shown: Vec<Shown> = (0..).zip(&pages).map(shown).collect();
            let mut table = Vec::new();
            append(&mut table, &pyramid, &shown, &[]);
            let mut named = 0;
            for level in pyramid.levels() {
                let header = WINDOW_LEN * usize::from(level.0);
                let [row, col, rows, cols, start] =
                    [0, 1, 2, 3, 4].map(|i| table[header + i].unsigned_abs());
                let all = (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col)));
                for (place, (down, right)) in all.enumerate() {
                    let page = PageAddress::new(
                        level,
                        row + down,
                        (col + right) % pyramid.pages(level).unwrap().1,
                    );
                    let lineage = std::iter::successors(Some(page), |page| page.parent());
                    let mut found =
                        lineage.filter_map(|page| shown.iter().find(|one| one.page == page));
                    let expected = found.next().map_or(0, entry);
                    assert_eq!(table[start as usize + place].cast_unsigned(), expected, "{page}");
                    named += usize::from(shown.iter().any(|one| one.page == page));
                }
            }
            assert_eq!(named, shown.len());
        }
    }

    /// A question to `find_page` and its answer.
    #[repr(C)]
    #[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
    struct Probe {
        texel: [i32; 2],
        fraction: [f32; 2],
        tap: [i32; 2],
        t: [f32; 2],
        level: i32,
        entry: u32,
    }

    const PROBE: &str = "
struct Probe { texel: vec2i, fraction: vec2f, tap: vec2i, t: vec2f, level: i32, entry: u32 }
@group(1) @binding(0) var<storage, read_write> probes: array<Probe>;
@compute @workgroup_size(64)
fn probe(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= arrayLength(&probes) { return; }
    let asked = probes[id.x];
    let found = find_page(dataset_list[0], MapPoint(asked.texel, asked.fraction, true), asked.level);
    probes[id.x].entry = found.entry;
    probes[id.x].tap = found.tap;
    probes[id.x].t = found.t;
}
";

    /// What `find_page` is to find, by looking at every page.
    fn expected(pyramid: &Pyramid, shown: &[Shown], roots: &[Shown], probe: &Probe) -> Probe {
        let side = pyramid.interior();
        let halvings = |level: Level| u32::from(pyramid.finest().0 - level.0);
        let page_at = |level: Level| {
            let (rows, cols) = pyramid.pages(level).unwrap();
            let [col, row] =
                probe.texel.map(|texel| (texel.unsigned_abs() >> halvings(level)) / side);
            PageAddress::new(level, row.min(rows - 1), col.min(cols - 1))
        };
        let at = |level: Level| shown.iter().find(|shown| shown.page == page_at(level));
        let asked = Level(u8::try_from(probe.level).unwrap());
        let mut coarser = (0..=asked.0).rev().map(Level);
        let mut finer = (asked.0 + 1..=pyramid.finest().0).map(Level);
        let root = || roots.iter().find(|root| root.page == page_at(Level(0)));
        let Some(found) = coarser.find_map(at).or_else(|| finer.find_map(at)).or_else(root) else {
            return Probe { tap: [0; 2], t: [0.0; 2], entry: 0, ..*probe };
        };
        let scale = f64::from(1 << halvings(found.page.level));
        let (mut tap, mut t) = ([0; 2], [0.0; 2]);
        for (axis, number) in [found.page.col, found.page.row].into_iter().enumerate() {
            let texel = f64::from(probe.texel[axis]) + f64::from(probe.fraction[axis]);
            // The border puts the center of the first texel at 1.
            let place = texel / scale - f64::from(number * side) + 0.5;
            let whole = place.floor().clamp(0.0, f64::from(side));
            (tap[axis], t[axis]) = (whole as i32, (place - whole) as f32);
        }
        Probe { tap, t, entry: entry(found), ..*probe }
    }

    #[test]
    fn the_shader_finds_the_page_that_shows_a_place() {
        let body = Ellipsoid::WGS84;
        let degrees = Crs::new(Projection::Geographic, body);
        let outline =
            Outline { origin: [-180.0, 90.0], pixel_size: [0.1875; 2], width: 1920, height: 960 };
        let info = dataset("globe", Kind::Height, degrees, outline, 32, 0);
        let pyramid = info.grid.pyramid();
        let finest = pyramid.finest();
        let mut random = Random(0x7ab1e);
        let mut below = |count: u32| (random.next() * f64::from(count)) as u32;
        let [mut nothing, mut by_root, mut by_finer] = [0; 3];
        for round in 0..60 {
            let mut pages: Vec<PageAddress> = (0..below(40))
                .map(|_| {
                    // Sometimes fine ones alone.
                    let coarsest = if round % 3 == 0 { finest.0 - 2 } else { 0 };
                    let level = Level(coarsest + below(u32::from(finest.0 - coarsest) + 1) as u8);
                    let (rows, cols) = pyramid.pages(level).unwrap();
                    PageAddress::new(level, below(rows), below(cols))
                })
                .collect();
            pages.sort();
            pages.dedup();
            let shown = |(slot, page): (u32, &PageAddress)| {
                let (gray, whole) = (slot.is_multiple_of(5), slot.is_multiple_of(2));
                Shown { page: *page, slot, gray, whole, presence: 7 }
            };
            let shown: Vec<Shown> = (0..).zip(&pages).map(shown).collect();
            let (rows, cols) = pyramid.pages(Level(0)).unwrap();
            let all = (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col)));
            let root = |(row, col)| Shown {
                page: PageAddress::new(Level(0), row, col),
                slot: 1000 + row * cols + col,
                gray: false,
                whole: true,
                presence: PRESENT,
            };
            let roots: Vec<Shown> =
                if round % 2 == 0 { all.map(root).collect() } else { Vec::new() };
            let mut table = vec![7; 3];
            let windows = append(&mut table, pyramid, &shown, &roots);
            let datasets = [DatasetMap::new(&info).mirrored(&windows, &Part::of(Kind::Height), 0)];
            let asked: Vec<Probe> = (0..500)
                .map(|_| Probe {
                    texel: [below(1920), below(960)].map(u32::cast_signed),
                    fraction: [(); 2].map(|()| below(1 << 10) as f32 / 1024.0),
                    level: below(u32::from(finest.0) + 1).cast_signed(),
                    ..Zeroable::zeroed()
                })
                .collect();
            let source = [SURFACE, &[PROBE]].concat().join("\n");
            let given = Given { datasets: &datasets, table: &table, ..Given::default() };
            let found: Vec<Probe> = compute(gpu(), &source, given, &asked);
            for (found, asked) in found.iter().zip(&asked) {
                let expected = expected(pyramid, &shown, &roots, asked);
                let off = |axis: usize| (found.t[axis] - expected.t[axis]).abs();
                assert!(off(0) < 1e-5 && off(1) < 1e-5, "{found:?}, {expected:?}");
                assert_eq!(Probe { t: expected.t, ..*found }, expected, "{pages:?}");
                nothing += u32::from(found.entry == 0);
                by_root += u32::from(found.entry & 0x7fff >= 1000);
                by_finer += u32::from(
                    found.entry != 0 && (found.entry >> 16 & 0xff) > found.level.cast_unsigned(),
                );
            }
        }
        assert!(nothing > 100 && by_root > 100 && by_finer > 100, "{nothing} {by_root} {by_finer}");
    }
}
