//! In what order pages are made: a function of the grid and nothing else.
//!
//! ```text
//!   read ──▶ settled ──▶ whole
//!   (leaf)   its coverage   its window: all it
//!            is known       borders on is settled
//! ```
//!
//! Leaves are read in work units of 8 × 8, units and leaves along the Z-order curve. A leaf is
//! *settled* when everything within the feather's reach has been read, a coarser page when its
//! children are. A page is *whole*, and its record can be written, when every page it borders on
//! is settled and its children are whole. [`Schedule`] says after each unit what has become
//! settled and whole, finest level first and by key within a level, and what is not needed any
//! more. Where parents are made of more than their children, they wait for the pages around these,
//! too. No texel is touched here.

use std::collections::HashMap;

use areoid_formats::address::{Level, PageAddress, PageKey};
use areoid_formats::pyramid::{PoleContact, Pyramid};

/// What one work unit brings.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Step {
    /// Leaves to read.
    pub read: Vec<PageAddress>,
    /// Pages that become settled, finest level first.
    pub settled: Vec<PageAddress>,
    /// Pages that become whole, finest level first.
    pub whole: Vec<PageAddress>,
    /// Leaves whose validity nobody needs after this step.
    pub forget_read: Vec<PageAddress>,
    /// Pages whose interior nobody needs after this step.
    pub forget_settled: Vec<PageAddress>,
    /// Pages whose window and intervals nobody needs after this step.
    pub forget_whole: Vec<PageAddress>,
}

/// The steps of a build, one for each work unit.
#[derive(Debug)]
pub struct Schedule {
    pyramid: Pyramid,
    unit_pages: u32,
    halo: u32,
    mip_reach: u32,
    /// Keys of the units still to come, in reverse.
    units: Vec<PageKey>,
    /// How much each page still waits for; pages that nothing has happened to are absent.
    unread: HashMap<PageAddress, usize>,
    unsettled_feeders: HashMap<PageAddress, usize>,
    unsettled_sources: HashMap<PageAddress, usize>,
    unfinished_children: HashMap<PageAddress, usize>,
    /// How many still need each page.
    readers: HashMap<PageAddress, usize>,
    viewers: HashMap<PageAddress, usize>,
}

impl Schedule {
    /// The schedule of `pyramid` in units of `unit_pages` leaves a side, with coverage that
    /// depends on the validity of everything up to `halo` texels away at the finest level, and
    /// parents that are made of everything up to `mip_reach` texels away from their children.
    ///
    /// # Panics
    ///
    /// Never: every pyramid has a finest level.
    #[must_use]
    pub fn new(pyramid: &Pyramid, unit_pages: u32, halo: u32, mip_reach: u32) -> Self {
        let (rows, cols) = pyramid.pages(pyramid.finest()).expect("a pyramid has a finest level");
        let (rows, cols) = (rows.div_ceil(unit_pages), cols.div_ceil(unit_pages));
        let unit = |row, col| PageKey::from(PageAddress::new(Level(0), row, col));
        let mut units: Vec<PageKey> =
            (0..rows).flat_map(|row| (0..cols).map(move |col| unit(row, col))).collect();
        units.sort_unstable_by_key(|&key| std::cmp::Reverse(key));
        Self {
            pyramid: pyramid.clone(),
            unit_pages,
            halo,
            mip_reach,
            units,
            unread: HashMap::new(),
            unsettled_feeders: HashMap::new(),
            unsettled_sources: HashMap::new(),
            unfinished_children: HashMap::new(),
            readers: HashMap::new(),
            viewers: HashMap::new(),
        }
    }

    /// Units still to come.
    #[must_use]
    pub fn remaining(&self) -> usize {
        self.units.len()
    }

    /// The leaves of a unit, along the curve.
    fn leaves(&self, unit: PageKey) -> Vec<PageAddress> {
        let unit = PageAddress::from(unit);
        let (row, col) = (unit.row * self.unit_pages, unit.col * self.unit_pages);
        let level = self.pyramid.finest();
        let mut leaves: Vec<PageAddress> = (row..row + self.unit_pages)
            .flat_map(|row| {
                (col..col + self.unit_pages).map(move |col| PageAddress::new(level, row, col))
            })
            .filter(|&page| self.pyramid.contains(page))
            .collect();
        leaves.sort_unstable_by_key(|&page| PageKey::from(page));
        leaves
    }

    fn settle_leaves(&mut self, step: &mut Step) {
        for &leaf in &step.read {
            self.readers.insert(leaf, users(&self.pyramid, leaf, self.halo).len());
            for user in users(&self.pyramid, leaf, self.halo) {
                let (pyramid, halo) = (&self.pyramid, self.halo);
                if count_down(&mut self.unread, user, || pyramid.sources(user, halo).len()) {
                    step.settled.push(user);
                }
            }
        }
        sort(&mut step.settled);
        for &page in &step.settled {
            self.expect_viewers(page);
            for source in self.pyramid.sources(page, self.halo) {
                if count_down_known(&mut self.readers, source) {
                    step.forget_read.push(source);
                }
            }
        }
    }

    /// Settles parents of what is settled, level by level.
    fn settle_parents(&mut self, step: &mut Step) {
        let mut start = 0;
        while start < step.settled.len() {
            let end = step.settled.len();
            let mut parents = Vec::new();
            for page in step.settled[start..end].iter().copied() {
                for parent in fed(&self.pyramid, page, self.mip_reach) {
                    let (pyramid, reach) = (&self.pyramid, self.mip_reach);
                    let feeders = || feeders(pyramid, parent, reach).len();
                    if count_down(&mut self.unsettled_feeders, parent, feeders) {
                        parents.push(parent);
                    }
                }
            }
            sort(&mut parents);
            for &parent in &parents {
                self.expect_viewers(parent);
                for feeder in feeders(&self.pyramid, parent, self.mip_reach) {
                    if count_down_known(&mut self.viewers, feeder) {
                        step.forget_settled.push(feeder);
                    }
                }
            }
            step.settled.append(&mut parents);
            start = end;
        }
    }

    /// A settled page is looked at by the windows that show it, and by the parents made of it.
    fn expect_viewers(&mut self, page: PageAddress) {
        let windows = users(&self.pyramid, page, Pyramid::BORDER).len();
        let parents = fed(&self.pyramid, page, self.mip_reach).len();
        self.viewers.insert(page, windows + parents);
    }

    fn finish_pages(&mut self, step: &mut Step) {
        let mut ready: HashMap<Level, Vec<PageAddress>> = HashMap::new();
        for &page in &step.settled {
            for user in users(&self.pyramid, page, Pyramid::BORDER) {
                let pyramid = &self.pyramid;
                let sources = || pyramid.sources(user, Pyramid::BORDER).len();
                if count_down(&mut self.unsettled_sources, user, sources) {
                    let is_leaf = user.level == pyramid.finest();
                    let children = || 1 + pyramid.children(user).count();
                    if is_leaf || count_down(&mut self.unfinished_children, user, children) {
                        ready.entry(user.level).or_default().push(user);
                    }
                }
            }
        }
        let mut level = Some(self.pyramid.finest());
        while let Some(current) = level {
            let mut pages = ready.remove(&current).unwrap_or_default();
            sort(&mut pages);
            for &page in &pages {
                for source in self.pyramid.sources(page, Pyramid::BORDER) {
                    if count_down_known(&mut self.viewers, source) {
                        step.forget_settled.push(source);
                    }
                }
                step.forget_whole.extend(self.pyramid.children(page));
                if let Some(parent) = page.parent() {
                    let pyramid = &self.pyramid;
                    let children = || 1 + pyramid.children(parent).count();
                    if count_down(&mut self.unfinished_children, parent, children) {
                        ready.entry(parent.level).or_default().push(parent);
                    }
                } else {
                    step.forget_whole.push(page);
                }
            }
            step.whole.append(&mut pages);
            level = current.coarser();
        }
    }
}

impl Iterator for Schedule {
    type Item = Step;

    fn next(&mut self) -> Option<Step> {
        let unit = self.units.pop()?;
        let mut step = Step { read: self.leaves(unit), ..Step::default() };
        self.settle_leaves(&mut step);
        self.settle_parents(&mut step);
        self.finish_pages(&mut step);
        Some(step)
    }
}

/// Counts `page` down, from `start` if this is the first time; true, and forgotten, at zero.
fn count_down(
    counts: &mut HashMap<PageAddress, usize>,
    page: PageAddress,
    start: impl FnOnce() -> usize,
) -> bool {
    counts.entry(page).or_insert_with(start);
    count_down_known(counts, page)
}

/// [`count_down`] for a page that was counted before.
fn count_down_known(counts: &mut HashMap<PageAddress, usize>, page: PageAddress) -> bool {
    let count = counts.get_mut(&page).expect("nothing is used before it is there");
    *count -= 1;
    let done = *count == 0;
    if done {
        counts.remove(&page);
    }
    done
}

fn sort(pages: &mut [PageAddress]) {
    pages.sort_unstable_by_key(|&page| PageKey::from(page));
}

/// The pages whose texels a parent is made of: its children, and those that show within `mip_reach`
/// texels of them. Sorted.
#[must_use]
pub fn feeders(pyramid: &Pyramid, parent: PageAddress, mip_reach: u32) -> Vec<PageAddress> {
    if mip_reach == 0 {
        return pyramid.children(parent).collect();
    }
    let sources = pyramid.children(parent).flat_map(|child| pyramid.sources(child, mip_reach));
    let mut feeders: Vec<PageAddress> = sources.collect();
    feeders.sort_unstable();
    feeders.dedup();
    feeders
}

/// The parents that have `page` among their [`feeders`].
fn fed(pyramid: &Pyramid, page: PageAddress, mip_reach: u32) -> Vec<PageAddress> {
    if mip_reach == 0 {
        return page.parent().into_iter().collect();
    }
    let parents = users(pyramid, page, mip_reach).into_iter().filter_map(PageAddress::parent);
    let mut parents: Vec<PageAddress> = parents.collect();
    parents.sort_unstable();
    parents.dedup();
    parents
}

/// The pages that have `page` among their [`sources`](Pyramid::sources) at `halo`.
fn users(pyramid: &Pyramid, page: PageAddress, halo: u32) -> Vec<PageAddress> {
    let (rows, cols) = pyramid.pages(page.level).expect("the page is this pyramid's");
    // A window and its halo reach so many pages; one more where the last page is a sliver.
    let reach = (halo + pyramid.interior()).div_ceil(pyramid.interior()) + 1;
    let inside = |at: u32, count: u32| at >= 2 * reach && at + 2 * reach < count;
    if inside(page.row, rows) && inside(page.col, cols) {
        // Among whole pages, far from every edge, who sees is seen.
        return pyramid.sources(page, halo);
    }
    let extent = pyramid.extent();
    let near_north = extent.north != PoleContact::None && page.row <= 2 * reach;
    let near_south = extent.south != PoleContact::None && page.row + 2 * reach + 1 >= rows;

    let around = |col: u32| {
        let (first, last) = (i64::from(col) - i64::from(reach), i64::from(col + reach));
        (first..=last).filter_map(|col| {
            let inside = (0..i64::from(cols)).contains(&col);
            let col = col.rem_euclid(i64::from(cols));
            (inside || extent.wraps).then(|| u32::try_from(col).expect("a column of the level"))
        })
    };
    let mut users = Vec::new();
    for row in page.row.saturating_sub(2 * reach)..(page.row + 2 * reach + 1).min(rows) {
        let shown = pyramid.source_rows(page.level, row, halo).map(|rows| rows.contains(&page.row));
        if shown == [false; 2] {
            continue;
        }
        let mut candidates: Vec<u32> = Vec::new();
        if row.abs_diff(page.row) <= reach {
            candidates.extend(around(page.col));
        }
        if near_north && row <= 2 * reach || near_south && row + 2 * reach + 1 >= rows {
            // Half a turn away, a column more where that falls between two.
            let half_turn = (page.col + cols / 2) % cols;
            candidates.extend(around(half_turn).chain(around((half_turn + 1) % cols)));
        }
        candidates.sort_unstable();
        candidates.dedup();
        let shows = |col: u32| {
            let mut ways = shown.into_iter().zip([false, true]).filter(|&(shown, _)| shown);
            ways.any(|(_, turned)| {
                pyramid.source_cols(page.level, col, halo, turned).contains(&page.col)
            })
        };
        let cols = candidates.into_iter().filter(|&col| shows(col));
        users.extend(cols.map(|col| PageAddress::new(page.level, row, col)));
    }
    users
}

#[cfg(test)]
mod tests;
