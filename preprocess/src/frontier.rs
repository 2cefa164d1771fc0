//! The pages that a build has begun and not done with: in memory, or on disk where that is short.
//!
//! ```text
//!   insert ──▶ here ◀── fetch ── away (in the scratch file)
//!               │ └──── shrink ──▶
//!               └ take, forget ──▶ gone
//! ```
//!
//! Pages of a raster's frontier grow with its perimeter. They are fetched before the step that looks
//! at them and may be sent away behind it, those first that were not looked at for longest. What is
//! here may also be saved: a checkpoint saves everything.

use std::collections::{HashMap, HashSet};
use std::io;
use std::sync::Arc;

use areoid_formats::address::PageAddress;
use areoid_formats::bound::{Cells, Span};
use bytemuck::Zeroable as _;
use rayon::prelude::*;

use crate::scratch::{Scratch, Slot};
use crate::texel::Texel;
use crate::tile::Tile;

/// What is kept of a page.
#[derive(Clone, Debug, PartialEq)]
pub struct Kept<S: Texel> {
    /// Its texels. A leaf that is not settled yet has its alpha for coverage.
    pub tile: Tile<S>,
    /// Its intervals, once it is whole, unless they are all zero.
    pub cells: Option<Cells<S::Cell>>,
}

/// The pages under construction; those without a valid texel are not in it.
///
/// Threads may share it for reading; changes take it for themselves.
#[derive(Debug)]
pub struct Frontier<S: Texel> {
    pages: HashMap<PageAddress, Place<S>>,
    scratch: Arc<Scratch>,
    budget_bytes: u64,
    bytes_here: u64,
    /// Counts calls of [`Self::fetch`].
    now: u64,
}

#[derive(Debug)]
enum Place<S: Texel> {
    Here { kept: Box<Kept<S>>, saved: Option<Slot>, used: u64 },
    Away(Slot),
}

impl<S: Texel> Frontier<S> {
    /// No pages yet, and none here beyond `budget_bytes` after [`Self::shrink`].
    #[must_use]
    pub fn new(scratch: Arc<Scratch>, budget_bytes: u64) -> Self {
        Self { pages: HashMap::new(), scratch, budget_bytes, bytes_here: 0, now: 0 }
    }

    /// Holds the pages that a note names, and no others.
    pub fn restore(&mut self, noted: &[(PageAddress, Slot)]) {
        self.pages = noted.iter().map(|&(page, slot)| (page, Place::Away(slot))).collect();
        self.bytes_here = 0;
    }

    /// Whether `slot` has a page of `side` texels, with an interior of `size` rows and columns.
    #[must_use]
    pub fn is_saved(&self, slot: Slot, side: usize, size: (u32, u32)) -> bool {
        let kept = self.scratch.get(slot).ok().and_then(|bytes| Kept::<S>::from_bytes(&bytes));
        kept.is_some_and(|Kept { tile, .. }| {
            (tile.side, tile.rows, tile.cols) == (side, size.0 as usize, size.1 as usize)
        })
    }

    /// Whether no page is held.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.pages.is_empty()
    }

    /// Takes a page in.
    pub fn insert(&mut self, page: PageAddress, kept: Kept<S>) {
        self.bytes_here += kept.bytes();
        let place = Place::Here { kept: Box::new(kept), saved: None, used: self.now };
        let before = self.pages.insert(page, place);
        debug_assert!(before.is_none(), "a page is taken out before it is put back");
    }

    /// A page, `None` if it has no valid texel.
    ///
    /// # Panics
    ///
    /// If it was not fetched.
    #[must_use]
    pub fn get(&self, page: PageAddress) -> Option<&Kept<S>> {
        match self.pages.get(&page)? {
            Place::Here { kept, .. } => Some(kept),
            Place::Away(_) => panic!("pages are fetched before they are looked at"),
        }
    }

    /// Takes a page out to change it.
    ///
    /// # Panics
    ///
    /// If it was not fetched.
    pub fn take(&mut self, page: PageAddress) -> Option<Kept<S>> {
        match self.pages.remove(&page)? {
            Place::Here { kept, saved, .. } => {
                saved.into_iter().for_each(|slot| self.scratch.free(slot));
                self.bytes_here -= kept.bytes();
                Some(*kept)
            }
            Place::Away(_) => panic!("pages are fetched before they are taken"),
        }
    }

    /// Drops a page, if it is there.
    pub fn forget(&mut self, page: PageAddress) {
        match self.pages.remove(&page) {
            Some(Place::Here { kept, saved, .. }) => {
                saved.into_iter().for_each(|slot| self.scratch.free(slot));
                self.bytes_here -= kept.bytes();
            }
            Some(Place::Away(slot)) => self.scratch.free(slot),
            None => {}
        }
    }

    /// Brings pages here.
    ///
    /// # Errors
    ///
    /// Those of the scratch file.
    pub fn fetch(&mut self, pages: &HashSet<PageAddress>) -> io::Result<()> {
        self.now += 1;
        let mut away = Vec::new();
        for &page in pages {
            match self.pages.get_mut(&page) {
                Some(Place::Here { used, .. }) => *used = self.now,
                Some(Place::Away(slot)) => away.push((page, *slot)),
                None => {}
            }
        }
        let read = |(page, slot)| {
            let kept = Kept::from_bytes(&self.scratch.get(slot)?);
            let kept = kept.ok_or_else(|| io::Error::from(io::ErrorKind::InvalidData))?;
            Ok((page, slot, kept))
        };
        let back: Vec<_> = away.into_par_iter().map(read).collect::<io::Result<_>>()?;
        for (page, slot, kept) in back {
            self.bytes_here += kept.bytes();
            let (kept, saved) = (Box::new(kept), Some(slot));
            self.pages.insert(page, Place::Here { kept, saved, used: self.now });
        }
        Ok(())
    }

    /// Sends pages away until the rest fits the budget, those of `soon` last.
    ///
    /// # Errors
    ///
    /// Those of the scratch file.
    pub fn shrink(&mut self, soon: &HashSet<PageAddress>) -> io::Result<()> {
        if self.bytes_here <= self.budget_bytes {
            return Ok(());
        }
        let mut here: Vec<(bool, u64, PageAddress, u64)> = Vec::new();
        for (&page, place) in &self.pages {
            if let Place::Here { kept, used, .. } = place {
                here.push((soon.contains(&page), *used, page, kept.bytes()));
            }
        }
        here.sort_unstable();
        let mut excess = self.bytes_here - self.budget_bytes;
        let mut leaving = Vec::new();
        for (_, _, page, bytes) in here {
            if excess == 0 {
                break;
            }
            excess = excess.saturating_sub(bytes);
            leaving.push(page);
        }
        self.save(&leaving)?;
        for page in leaving {
            if let Some(Place::Here { kept, saved: Some(slot), .. }) = self.pages.get(&page) {
                self.bytes_here -= kept.bytes();
                let slot = *slot;
                self.pages.insert(page, Place::Away(slot));
            }
        }
        Ok(())
    }

    /// Saves every page, and says where.
    ///
    /// # Errors
    ///
    /// Those of the scratch file.
    pub fn save_all(&mut self) -> io::Result<Vec<(PageAddress, Slot)>> {
        let all: Vec<PageAddress> = self.pages.keys().copied().collect();
        self.save(&all)?;
        let slot = |place: &Place<S>| match place {
            Place::Here { saved, .. } => *saved,
            Place::Away(slot) => Some(*slot),
        };
        let saved = self.pages.iter().filter_map(|(&page, place)| Some((page, slot(place)?)));
        let mut saved: Vec<_> = saved.collect();
        saved.sort_unstable_by_key(|(page, _)| *page);
        Ok(saved)
    }

    fn save(&mut self, pages: &[PageAddress]) -> io::Result<()> {
        let unsaved = |&page: &PageAddress| match self.pages.get(&page) {
            Some(Place::Here { kept, saved: None, .. }) => Some((page, &**kept)),
            _ => None,
        };
        let unsaved: Vec<_> = pages.iter().filter_map(unsaved).collect();
        let write = |&(page, kept): &(PageAddress, &Kept<S>)| Ok((page, kept.save(&self.scratch)?));
        let slots: Vec<(PageAddress, Slot)> =
            unsaved.par_iter().map(write).collect::<io::Result<_>>()?;
        for (page, slot) in slots {
            if let Some(Place::Here { saved, .. }) = self.pages.get_mut(&page) {
                *saved = Some(slot);
            }
        }
        Ok(())
    }
}

/// What is in the bytes of a page, before its arrays.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
struct Head {
    side: u64,
    rows: u64,
    cols: u64,
    /// 1 originals, 2 coverage, 4 spans, 8 cells.
    parts: u64,
    /// Binary logarithm of the cells' unit.
    unit_log2: u64,
    /// The range of the texels, each end in the first bytes.
    range: [[u8; 4]; 2],
}

impl<S: Texel> Kept<S> {
    /// Memory it takes, in bytes.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.arrays().iter().map(|array| array.len() as u64).sum()
    }

    fn arrays(&self) -> Vec<&[u8]> {
        let Tile { planes, original, coverage, spans, .. } = &self.tile;
        let planes = planes.iter().chain(original.iter().flatten());
        let mut arrays: Vec<&[u8]> = planes.map(|plane| bytemuck::cast_slice(plane)).collect();
        arrays.extend(coverage.as_deref());
        for span in spans.iter().flatten() {
            arrays.extend(
                [&span.least, &span.greatest].map(|ends| bytemuck::cast_slice::<S, u8>(ends)),
            );
        }
        if let Some(cells) = &self.cells {
            arrays.extend(
                [&cells.low, &cells.high].map(|ends| bytemuck::cast_slice::<S::Cell, u8>(ends)),
            );
        }
        arrays
    }

    fn save(&self, scratch: &Scratch) -> io::Result<Slot> {
        let Tile { side, rows, cols, original, coverage, spans, range, .. } = &self.tile;
        let flags = [original.is_some(), coverage.is_some(), spans.is_some(), self.cells.is_some()];
        let parts = flags.iter().rev().fold(0, |parts, &flag| parts << 1 | u64::from(flag));
        let [side, rows, cols] = [*side, *rows, *cols].map(|size| size as u64);
        let unit_log2 = self.cells.as_ref().map_or(0, |cells| cells.unit_log2.into());
        let mut head = Head { side, rows, cols, parts, unit_log2, range: [[0; 4]; 2] };
        for (bytes, end) in head.range.iter_mut().zip([range.0, range.1]) {
            bytes[..size_of::<S>()].copy_from_slice(bytemuck::bytes_of(&end));
        }
        let mut arrays = self.arrays();
        arrays.insert(0, bytemuck::bytes_of(&head));
        scratch.put(&arrays)
    }

    /// What [`Self::save`] stored; `None` if the bytes are something else.
    fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let mut head = Head::zeroed();
        let (front, mut rest) = bytes.split_at_checked(size_of::<Head>())?;
        bytemuck::bytes_of_mut(&mut head).copy_from_slice(front);
        let size = |size: u64| usize::try_from(size).ok();
        let (side, rows, cols) = (size(head.side)?, size(head.rows)?, size(head.cols)?);
        let has = |part: u32| head.parts >> part & 1 == 1;
        let (texels, inside) = (side.checked_mul(side)?, rows.checked_mul(cols)?);

        let planes = read_arrays(&mut rest, S::CHANNELS, texels)?;
        let original =
            if has(0) { Some(read_arrays(&mut rest, S::CHANNELS, texels)?) } else { None };
        let coverage = if has(1) { read_arrays(&mut rest, 1, texels)?.pop() } else { None };
        let spans = if has(2) {
            let ends = read_arrays(&mut rest, 2 * S::CHANNELS, texels)?;
            Some(pairs(ends, |least, greatest| Span { least, greatest }))
        } else {
            None
        };
        let cells = if has(3) {
            let unit_log2 = u32::try_from(head.unit_log2).ok()?;
            let mut ends = || read_arrays(&mut rest, 1, inside)?.pop();
            let (low, high) = (ends()?, ends()?);
            Some(Cells { rows, cols, unit_log2, low, high })
        } else {
            None
        };
        let [least, greatest] =
            head.range.map(|bytes| bytemuck::pod_read_unaligned(&bytes[..size_of::<S>()]));
        let range = (least, greatest);
        let tile = Tile { side, rows, cols, planes, original, coverage, spans, range };
        rest.is_empty().then_some(Self { tile, cells })
    }
}

/// The next `count` arrays of `length` elements.
fn read_arrays<T: bytemuck::Pod>(
    rest: &mut &[u8],
    count: usize,
    length: usize,
) -> Option<Vec<Vec<T>>> {
    let bytes = length.checked_mul(size_of::<T>())?;
    (0..count)
        .map(|_| {
            let (array, behind) = rest.split_at_checked(bytes)?;
            *rest = behind;
            Some(bytemuck::pod_collect_to_vec(array))
        })
        .collect()
}

fn pairs<T, U>(ends: Vec<T>, join: impl Fn(T, T) -> U) -> Vec<U> {
    let mut ends = ends.into_iter();
    std::iter::from_fn(|| Some(join(ends.next()?, ends.next()?))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use areoid_formats::address::Level;

    fn kept<S: Texel>(texels: impl Fn(usize) -> S, cell: S::Cell, parts: u8) -> Kept<S> {
        let (side, rows, cols) = (10, 8, 5);
        let plane = |from: usize| (from..from + side * side).map(&texels).collect::<Vec<S>>();
        let planes = |from: usize| (0..S::CHANNELS).map(|channel| plane(from + channel)).collect();
        let has = |part: u8| parts >> part & 1 == 1;
        let span = |channel| Span { least: plane(channel + 7), greatest: plane(channel + 9) };
        let ends = vec![cell; rows * cols];
        let cells = Cells { rows, cols, unit_log2: 3, low: ends.clone(), high: ends };
        Kept {
            tile: Tile {
                side,
                rows,
                cols,
                planes: planes(0),
                original: has(0).then(|| planes(3)),
                coverage: has(1).then(|| (0..100).collect()),
                spans: has(2).then(|| (0..S::CHANNELS).map(span).collect()),
                range: (texels(1), texels(2)),
            },
            cells: has(3).then_some(cells),
        }
    }

    fn scratch() -> Arc<Scratch> {
        Arc::new(Scratch::new(tempfile::tempfile().unwrap(), &[]).unwrap())
    }

    fn comes_back<S: Texel>(texels: impl Fn(usize) -> S + Copy, cell: S::Cell) {
        let page = |number: u32| PageAddress::new(Level(3), number, 1);
        let original: Vec<Kept<S>> = (0..16).map(|parts| kept(texels, cell, parts)).collect();
        let mut frontier = Frontier::new(scratch(), 0);
        for (number, kept) in (0..).zip(&original) {
            frontier.insert(page(number), kept.clone());
        }
        frontier.shrink(&HashSet::new()).unwrap();
        assert_eq!(frontier.bytes_here, 0);
        frontier.fetch(&(0..16).map(page).collect()).unwrap();
        for (number, kept) in (0..).zip(&original) {
            assert_eq!(frontier.get(page(number)), Some(kept), "{number}");
        }
    }

    #[test]
    fn pages_come_back_bit_for_bit() {
        comes_back(|at| at as f32 * 0.1, 0.25_f32);
        comes_back(|at| i16::try_from(at).unwrap() - 50, -9_i16);
        comes_back(|at| u8::try_from(at).unwrap(), -9_i16);
    }

    #[test]
    fn what_was_looked_at_longest_ago_goes_first_and_what_comes_soon_last() {
        let page = |col: u32| PageAddress::new(Level(1), 0, col);
        let some = kept(|at| u8::try_from(at).unwrap(), 0, 0);
        let mut frontier = Frontier::new(scratch(), 2 * some.bytes());
        (0..4).for_each(|col| frontier.insert(page(col), some.clone()));
        frontier.fetch(&HashSet::from([page(0)])).unwrap();
        frontier.shrink(&HashSet::from([page(3)])).unwrap();
        let here = |col: u32| matches!(frontier.pages[&page(col)], Place::Here { .. });
        assert_eq!([0, 1, 2, 3].map(here), [true, false, false, true]);
    }

    #[test]
    fn damaged_bytes_are_refused() {
        let scratch = scratch();
        let slot = kept(|at| at as f32, 1.0_f32, 15).save(&scratch).unwrap();
        let bytes = scratch.get(slot).unwrap();
        assert!(Kept::<f32>::from_bytes(&bytes).is_some());
        let head = size_of::<Head>();
        for length in [0, head - 1, head, 500, bytes.len() - 1] {
            assert_eq!(Kept::<f32>::from_bytes(&bytes[..length]), None);
        }
    }
}
