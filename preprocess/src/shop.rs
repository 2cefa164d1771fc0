//! One work unit after another: leaves in, finished pages out.
//!
//! ```text
//!   read ──▶ settle leaves ──▶ settle parents ──▶ border, finish ──▶ written in order
//!            coverage, step     mean or low-pass    neighbors' texels
//!                               of children
//! ```
//!
//! Within a step the pages of a level are made in parallel, each from pages that do not change
//! meanwhile; so nothing depends on threads or time.

use std::collections::{HashMap, HashSet};
use std::io;
use std::sync::Arc;

use areoid_formats::address::PageAddress;
use areoid_formats::archive::{Description, MipRule, PageEntry};
use areoid_formats::pyramid::Pyramid;
use rayon::prelude::*;

use crate::border::Border;
use crate::build_error::BuildError;
use crate::feather::{self, Validity};
use crate::frontier::{Frontier, Kept};
use crate::lowpass;
use crate::mip::{self, Spans};
use crate::note::{Note, NotedValidity};
use crate::raster::RasterError;
use crate::schedule::{Step, feeders};
use crate::scratch::{Scratch, Slot};
use crate::texel::{Mean, Texel};
use crate::tile::{Closed, Raw, Tile};
use crate::whole::{self, Payloads, Whole, WholeChild};

/// What is under construction.
pub(crate) struct Shop<'a, S: Texel> {
    description: &'a Description,
    spans: Spans,
    pages_together: usize,
    scratch: Arc<Scratch>,
    frontier: Frontier<S>,
    /// Of the leaves that a feather may still reach.
    validity: HashMap<PageAddress, Validity>,
    /// Of the pages whose parents are not whole.
    entries: HashMap<PageAddress, PageEntry>,
    /// Pages that one of their two uses is over for: as a neighbor and what parents are made of, and
    /// as a child to be held against.
    half_done: HashSet<PageAddress>,
    /// Slots of the last note that are not the frontier's.
    noted_bits: Vec<Slot>,
}

/// A page that has become whole, and what is written of it: nothing if it has no valid texel.
pub(crate) type Finished = (PageAddress, Option<(PageEntry, Vec<u8>)>);

/// Who knows how far a leaf is from its source, or is told that nobody asks.
pub(crate) type Measure<'a> =
    &'a (dyn Fn(PageAddress, Option<&Closed<'_>>) -> Result<Option<f32>, RasterError> + Sync);

impl<'a, S: Texel> Shop<'a, S> {
    pub(crate) fn new(
        description: &'a Description,
        spans: Spans,
        scratch: Arc<Scratch>,
        frontier_bytes: u64,
        pages_together: usize,
    ) -> Self {
        Self {
            description,
            spans,
            pages_together: pages_together.max(1),
            frontier: Frontier::new(Arc::clone(&scratch), frontier_bytes),
            scratch,
            validity: HashMap::new(),
            entries: HashMap::new(),
            half_done: HashSet::new(),
            noted_bits: Vec::new(),
        }
    }

    /// Goes back to where `note` was written; false, and unchanged, if the scratch file is not the
    /// one it speaks of.
    pub(crate) fn restore(&mut self, note: &Note) -> bool {
        let pyramid = self.pyramid();
        let leaves = note.validity.iter().map(|(leaf, _)| leaf);
        let pages = note.pages.iter().map(|(page, _)| page).chain(&note.half_done).chain(leaves);
        if !pages
            .chain(note.entries.iter().map(|entry| &entry.page))
            .all(|&page| pyramid.contains(page))
        {
            return false;
        }
        let (mut validity, mut noted_bits) = (HashMap::new(), Vec::new());
        for &(page, noted) in &note.validity {
            let known = match noted {
                NotedValidity::Empty => Validity::Empty,
                NotedValidity::Full => Validity::Full,
                NotedValidity::Mixed { cols, bits: slot } => {
                    let Ok(bits) = self.scratch.get(slot) else { return false };
                    let (rows, page_cols) = pyramid.interior_size(page);
                    let length = Validity::length(rows as usize, cols);
                    if cols != page_cols as usize || bits.len() != length {
                        return false;
                    }
                    noted_bits.push(slot);
                    Validity::Mixed { cols, bits }
                }
            };
            validity.insert(page, known);
        }
        let side = pyramid.page_side() as usize;
        let size = |page| pyramid.interior_size(page);
        if !note.pages.iter().all(|&(page, slot)| self.frontier.is_saved(slot, side, size(page))) {
            return false;
        }
        self.noted_bits = noted_bits;
        self.validity = validity;
        self.frontier.restore(&note.pages);
        self.entries = note.entries.iter().map(|entry| (entry.page, *entry)).collect();
        self.half_done = note.half_done.iter().copied().collect();
        true
    }

    /// Saves everything, and says what a later process needs to go on.
    pub(crate) fn note(&mut self, archive: u64, units: u64) -> io::Result<Note> {
        let pages = self.frontier.save_all()?;
        let bits = |bits: &[u8]| self.scratch.put(&[bits]);
        let validity = self.validity.iter();
        let validity =
            validity.map(|(&page, validity)| Ok((page, NotedValidity::of(validity, bits)?)));
        let validity = validity.collect::<io::Result<_>>()?;
        let entries = self.entries.values().copied().collect();
        let half_done = self.half_done.iter().copied().collect();
        Ok(Note { archive, units, pages, entries, validity, half_done })
    }

    /// Tells that `note` is kept, and the one before it forgotten.
    pub(crate) fn noted(&mut self, note: &Note) {
        self.scratch.name(&note.slots());
        let in_frontier: HashSet<u64> = note.pages.iter().map(|(_, slot)| slot.offset).collect();
        let bits = note.slots().into_iter().filter(|slot| !in_frontier.contains(&slot.offset));
        let before = std::mem::replace(&mut self.noted_bits, bits.collect());
        before.into_iter().for_each(|slot| self.scratch.free(slot));
    }

    /// Does a step. `measure` is asked for the source error of each leaf that becomes whole; `give`
    /// gets the pages that did, in order.
    pub(crate) fn take(
        &mut self,
        step: &Step,
        raws: Vec<(PageAddress, Option<Raw>)>,
        measure: Measure<'_>,
        payloads: Payloads,
        mut give: impl FnMut(Finished) -> Result<(), BuildError>,
    ) -> Result<(), BuildError> {
        self.take_in(raws);
        // A few pages at a time, so that what they look at is here and not much else.
        for level in step.settled.chunk_by(|one, other| one.level == other.level) {
            for pages in level.chunks(self.pages_together) {
                self.fetch(pages, &[])?;
                if pages[0].level == self.pyramid().finest() {
                    self.settle_leaves(pages)?;
                } else {
                    self.settle_parents(pages);
                }
                self.frontier.shrink(&HashSet::new()).map_err(BuildError::Scratch)?;
            }
        }
        for level in step.whole.chunk_by(|one, other| one.level == other.level) {
            for pages in level.chunks(self.pages_together) {
                self.fetch(&[], pages)?;
                for finished in self.finish_pages(pages, measure, payloads)? {
                    give(finished)?;
                }
                self.frontier.shrink(&HashSet::new()).map_err(BuildError::Scratch)?;
            }
        }
        for page in &step.forget_read {
            self.validity.remove(page);
        }
        for &page in &step.forget_whole {
            self.entries.remove(&page);
            self.use_is_over(page);
        }
        step.forget_settled.iter().for_each(|&page| self.use_is_over(page));
        Ok(())
    }

    /// Whether nothing is under construction any more.
    pub(crate) fn is_done(&self) -> bool {
        self.frontier.is_empty()
            && self.validity.is_empty()
            && self.entries.is_empty()
            && self.half_done.is_empty()
    }

    fn pyramid(&self) -> &'a Pyramid {
        self.description.grid.pyramid()
    }

    /// Brings the pages here that are looked at when `settled` are settled and `whole` finished.
    fn fetch(&mut self, settled: &[PageAddress], whole: &[PageAddress]) -> Result<(), BuildError> {
        let pyramid = self.pyramid();
        let mut pages: HashSet<PageAddress> = settled.iter().copied().collect();
        let reach = lowpass::reach(self.description.mip);
        for &page in settled {
            pages.extend(feeders(pyramid, page, reach));
        }
        for &page in whole {
            pages.extend(pyramid.children(page));
            pages.extend(pyramid.sources(page, Pyramid::BORDER));
        }
        self.frontier.fetch(&pages).map_err(BuildError::Scratch)
    }

    fn use_is_over(&mut self, page: PageAddress) {
        if self.half_done.remove(&page) {
            self.frontier.forget(page);
        } else {
            self.half_done.insert(page);
        }
    }

    fn take_in(&mut self, raws: Vec<(PageAddress, Option<Raw>)>) {
        let pyramid = self.pyramid();
        let side = pyramid.page_side() as usize;
        for (page, raw) in raws {
            let (rows, cols) = pyramid.interior_size(page);
            let (rows, cols) = (rows as usize, cols as usize);
            let Some(Raw { planes, alpha }) = raw else {
                self.validity.insert(page, Validity::Empty);
                continue;
            };
            let planes = S::channels(planes, alpha.as_deref());
            let (original, spans, range) = (None, None, S::NOTHING);
            let coverage = alpha;
            let tile = Tile { side, rows, cols, planes, original, coverage, spans, range };
            let validity = tile.coverage.as_ref().map_or(Validity::Full, |alpha| {
                Validity::of(cols, (0..rows).map(|row| &alpha[tile.row(row)]))
            });
            self.validity.insert(page, validity);
            self.frontier.insert(page, Kept { tile, cells: None });
        }
    }

    /// Takes pages out, changes them in parallel, puts them back, and says in their order what came
    /// of it. Pages that are not there are passed over.
    fn change<T: Send, R: Send>(
        &mut self,
        pages: Vec<(PageAddress, T)>,
        change: impl Fn(&Self, PageAddress, T, &mut Kept<S>) -> Result<R, BuildError> + Sync,
    ) -> Result<Vec<R>, BuildError> {
        let taken: Vec<_> = pages
            .into_iter()
            .filter_map(|(page, with)| Some((page, with, self.frontier.take(page)?)))
            .collect();
        let changed: Vec<_> = taken
            .into_par_iter()
            .map(|(page, with, mut kept)| {
                let result = change(self, page, with, &mut kept)?;
                Ok((page, kept, result))
            })
            .collect::<Result<_, BuildError>>()?;
        let put_back = |(page, kept, result)| {
            self.frontier.insert(page, kept);
            result
        };
        Ok(changed.into_iter().map(put_back).collect())
    }

    /// Gives leaves their coverage, and puts them on the dataset's step.
    fn settle_leaves(&mut self, leaves: &[PageAddress]) -> Result<(), BuildError> {
        let leaves = leaves.iter().map(|&leaf| (leaf, ())).collect();
        self.change(leaves, |shop, page, (), kept| {
            let Tile { planes, original, coverage, .. } = &mut kept.tile;
            let validity = |leaf| &shop.validity[&leaf];
            *coverage = feather::coverage(shop.pyramid(), page, coverage.as_deref(), validity);
            let quantum = shop.description.quantum;
            let settled = S::to_step(planes, quantum);
            *original = settled.ok_or(BuildError::Step { page, step: quantum.step })?;
            Ok(())
        })?;
        Ok(())
    }

    fn settle_parents(&mut self, parents: &[PageAddress]) {
        let pyramid = self.pyramid();
        let mean = Mean::of(self.description);
        let tile_of = |page| self.frontier.get(page).map(|kept| &kept.tile);
        let settled: Vec<_> = parents
            .par_iter()
            .map(|&page| {
                let children: Vec<_> = pyramid
                    .children(page)
                    .filter_map(|child| Some((place_of(child), tile_of(child)?)))
                    .collect();
                let (rows, cols) = pyramid.interior_size(page);
                let (side, size) = (pyramid.page_side() as usize, (rows as usize, cols as usize));
                let mut tile = mip::parent(side, size, &children, mean, self.spans)?;
                if self.description.mip == MipRule::Kaiser {
                    lowpass::refine(&mut tile, (pyramid, page), tile_of, mean);
                }
                Some(tile)
            })
            .collect();
        for (&page, tile) in parents.iter().zip(settled) {
            if let Some(tile) = tile {
                self.frontier.insert(page, Kept { tile, cells: None });
            }
        }
    }

    /// Finishes pages of one level.
    fn finish_pages(
        &mut self,
        pages: &[PageAddress],
        measure: Measure<'_>,
        payloads: Payloads,
    ) -> Result<Vec<Finished>, BuildError> {
        let pyramid = self.pyramid();
        let are_leaves = pages[0].level == pyramid.finest();
        let tile_of = |page| self.frontier.get(page).map(|kept| &kept.tile);
        let quantum = self.description.quantum;
        let borders: Vec<(PageAddress, Border<S>)> = pages
            .par_iter()
            .map(|&page| (page, Border::around(pyramid, page, tile_of, quantum)))
            .collect();

        for (page, border) in &borders {
            if self.frontier.get(*page).is_none() && !border.is_empty() {
                // Nothing inside, but something that shows at the edge.
                let (rows, cols) = pyramid.interior_size(*page);
                let size = (rows as usize, cols as usize);
                let tile = Tile::blank(pyramid.page_side() as usize, size);
                self.frontier.insert(*page, Kept { tile, cells: None });
            }
        }
        if are_leaves {
            let empty = pages.par_iter().filter(|&&page| self.frontier.get(page).is_none());
            empty.try_for_each(|&page| measure(page, None).map(|_| ()))?;
        }
        let wholes = self.change(borders, |shop, page, border, kept| {
            kept.tile.close(&border);
            let source_error =
                if are_leaves { measure(page, Some(&kept.tile.closed()))? } else { None };
            let Whole { entry, payload, cells, range } =
                shop.finish(page, &kept.tile, source_error, payloads)?;
            kept.cells = cells;
            kept.tile.range = range;
            Ok((entry, payload))
        })?;
        let mut wholes = wholes.into_iter().peekable();
        let with_its_whole = |&page| {
            let whole = wholes.next_if(|(entry, _)| entry.page == page);
            if let Some((entry, _)) = &whole {
                self.entries.insert(page, *entry);
            }
            (page, whole)
        };
        Ok(pages.iter().map(with_its_whole).collect())
    }

    fn finish(
        &self,
        page: PageAddress,
        tile: &Tile<S>,
        source_error: Option<f32>,
        payloads: Payloads,
    ) -> Result<Whole<S>, BuildError> {
        let children: Vec<WholeChild<'_, S>> = self
            .pyramid()
            .children(page)
            .filter_map(|child| {
                let (row, col) = place_of(child);
                let entry = self.entries.get(&child)?;
                let Kept { tile, cells } = self.frontier.get(child)?;
                Some(WholeChild { row, col, tile, cells: cells.as_ref(), entry })
            })
            .collect();
        whole::finish(self.description, page, tile, &children, source_error, payloads)
            .map_err(|source| BuildError::Encode { page, source })
    }
}

/// Where a child lies under its parent.
fn place_of(child: PageAddress) -> (usize, usize) {
    ((child.row % 2) as usize, (child.col % 2) as usize)
}
