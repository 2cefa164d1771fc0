//! The pages of a selection brought to the GPU, and the table that finds them.

use areoid_cache::{Datasets, ResidentPage, Selection};
use areoid_formats::address::PageKey;
use areoid_formats::archive::Payload;
use areoid_formats::page::Kind;

use crate::atlas::slots::PageName;
use crate::atlas::table::{self, Shown};
use crate::atlas::texture::Atlas;
use crate::gpu::Gpu;
use crate::map::DatasetMap;
use crate::mirror;

/// What of a selection is on the GPU.
#[derive(Debug)]
pub(crate) struct Resident {
    pub(crate) heights: Atlas,
    pub(crate) colors: Atlas,
    budget_bytes: u64,
    datasets: Option<Datasets>,
    /// Places in `datasets`: heights first, each kind from the highest priority down.
    order: Vec<usize>,
    /// By place in `order`.
    pub(crate) maps: Vec<DatasetMap>,
    pub(crate) height_count: u32,
    pub(crate) mirrored: Vec<mirror::Dataset>,
    pub(crate) table: Vec<i32>,
    /// By place in `datasets`.
    shown: Vec<Vec<Shown>>,
}

/// What [`Resident::bring`] did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Brought {
    /// Pages written to the GPU.
    pub(crate) uploaded: usize,
    /// Pages put off to the next frame by the limit on uploads.
    pub(crate) put_off: usize,
    /// Pages without a slot: their ancestors stand in.
    pub(crate) left_out: usize,
}

impl Resident {
    pub(crate) fn new(gpu: &Gpu, budget_bytes: u64) -> Self {
        Self {
            heights: Atlas::new(gpu, Kind::Height, 8, budget_bytes),
            colors: Atlas::new(gpu, Kind::Color, 8, budget_bytes),
            budget_bytes,
            datasets: None,
            order: Vec::new(),
            maps: Vec::new(),
            height_count: 0,
            mirrored: Vec::new(),
            table: Vec::new(),
            shown: Vec::new(),
        }
    }

    /// Writes what is new of a selection, at most `limit_bytes` of it, and the table anew.
    pub(crate) fn bring(&mut self, gpu: &Gpu, selection: &Selection, limit_bytes: u64) -> Brought {
        self.follow_datasets(gpu, selection);
        self.heights.next_turn();
        self.colors.next_turn();
        self.shown.iter_mut().for_each(Vec::clear);

        let mut brought = Brought::default();
        let mut left_bytes = limit_bytes;
        // First what is there, so that no new page takes its place.
        for page in &selection.pages {
            let name = name_of(page);
            match selection.datasets[page.dataset].kind {
                Kind::Height => self.heights.keep(name),
                _ => self.colors.keep(name),
            };
        }
        for page in &selection.pages {
            let name = name_of(page);
            let atlas = match selection.datasets[page.dataset].kind {
                Kind::Height => &mut self.heights,
                Kind::Color => &mut self.colors,
                Kind::Normal => continue,
            };
            let resident = atlas.keep(name);
            let bytes = page.page.bytes() as u64;
            let slot = if resident.is_some() {
                resident
            } else if left_bytes == 0 {
                brought.put_off += 1;
                continue;
            } else {
                left_bytes = left_bytes.saturating_sub(bytes);
                brought.uploaded += 1;
                atlas.place(gpu, name, &page.page)
            };
            let Some(slot) = slot else {
                brought.left_out += 1;
                continue;
            };
            let whole = page.page.coverage().is_none();
            let place = selection.datasets.place(page.dataset);
            let place = place.expect("a page's dataset stands beside it");
            self.shown[place].push(Shown { page: page.entry.page, slot, whole });
        }
        self.write_table(selection);
        brought
    }

    /// Sorts the datasets and fits the atlases to their pages.
    fn follow_datasets(&mut self, gpu: &Gpu, selection: &Selection) {
        if self.datasets.as_ref().is_some_and(|known| known.is(&selection.datasets)) {
            return;
        }
        let datasets: Vec<_> = selection.datasets.iter().map(|(_, info)| info).collect();
        let side_of = |kind| {
            let sides = datasets.iter().filter(|info| info.kind == kind);
            sides.map(|info| info.grid.pyramid().page_side()).max().unwrap_or(8)
        };
        for (atlas, kind) in [(&mut self.heights, Kind::Height), (&mut self.colors, Kind::Color)] {
            if atlas.side() < side_of(kind) {
                *atlas = Atlas::new(gpu, kind, side_of(kind), self.budget_bytes);
            }
        }
        self.order = (0..datasets.len()).filter(|&i| datasets[i].kind != Kind::Normal).collect();
        self.order.sort_by_key(|&i| {
            (datasets[i].kind == Kind::Color, std::cmp::Reverse(datasets[i].priority))
        });
        self.maps = self.order.iter().map(|&i| DatasetMap::new(datasets[i])).collect();
        let heights = self.order.iter().filter(|&&i| datasets[i].kind == Kind::Height).count();
        self.height_count = u32::try_from(heights).expect("a catalog has fewer datasets than 2^32");
        self.shown.clear();
        self.shown.resize_with(datasets.len(), Vec::new);
        self.datasets = Some(selection.datasets.clone());
    }

    fn write_table(&mut self, selection: &Selection) {
        self.table.clear();
        self.mirrored.clear();
        let infos: Vec<_> = selection.datasets.iter().map(|(_, info)| info).collect();
        for (&dataset, map) in self.order.iter().zip(&self.maps) {
            let info = infos[dataset];
            let first = table::append(&mut self.table, info.grid.pyramid(), &self.shown[dataset]);
            let first = i32::try_from(first).expect("a table is far smaller than 2^31");
            self.mirrored.push(map.mirrored(first, info.priority));
        }
    }
}

fn name_of(page: &ResidentPage) -> PageName {
    let checksum = match page.entry.payload {
        Payload::Constant(texel) => u64::from(u32::from_le_bytes(texel.0)),
        Payload::Record { checksum, .. } => checksum,
    };
    PageName { dataset: page.dataset, page: PageKey::from(page.entry.page), checksum }
}
