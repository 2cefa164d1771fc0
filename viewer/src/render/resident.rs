//! The pages of a selection brought to the GPU, and the table that finds them.

use std::collections::HashMap;

use areoid_cache::{Datasets, ResidentPage, Selection};
use areoid_formats::address::PageKey;
use areoid_formats::archive::Payload;

use super::linger::{self, Trace};
use crate::atlas::slots::PageName;
use crate::atlas::table::{self, PRESENT, Shown};
use crate::atlas::texture::{Atlas, Content};
use crate::atlas::uploads::{Allowance, Uploads};
use crate::gpu::Gpu;
use crate::map::Maps;
use crate::mirror;
use crate::style::{Part, Style};

/// The time of a frame, in seconds since any moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Clock {
    pub(crate) seconds: f64,
    /// How long a page takes to show wholly.
    pub(crate) fade_seconds: f64,
}

impl Clock {
    /// How far a page shows that came at `since`.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped")]
    fn presence(&self, since: f64) -> u8 {
        let share = (self.seconds - since) / self.fade_seconds;
        if self.fade_seconds > 0.0 {
            (share * f64::from(PRESENT)).clamp(0.0, f64::from(PRESENT)) as u8
        } else {
            PRESENT
        }
    }
}

/// What of a selection is on the GPU.
#[derive(Debug)]
pub(crate) struct Resident {
    /// By content.
    atlases: [Atlas; 4],
    uploads: Uploads,
    budget_bytes: u64,
    datasets: Option<Datasets>,
    style: Style,
    /// Datasets that take part, as places in `datasets`, sorted like `maps`.
    order: Vec<(usize, Part)>,
    pub(crate) maps: Maps,
    pub(crate) mirrored: Vec<mirror::Dataset>,
    pub(crate) table: Vec<i32>,
    /// Where in `table` the bounds of the slots of heights start.
    pub(crate) slot_bounds: i32,
    /// By slot of heights, in meters.
    bounds: Vec<f32>,
    /// By place in `datasets`; none for those that do not take part.
    shown: Vec<Option<Vec<Shown>>>,
    /// By place in `datasets`: what shows where `shown` has nothing.
    roots: Vec<Vec<Shown>>,
    /// What the picture before showed.
    before: Vec<Trace>,
}

/// What [`Resident::bring`] did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Brought {
    /// Pages written to the GPU.
    pub(crate) uploaded: usize,
    /// Bytes of their texels in memory.
    pub(crate) uploaded_bytes: u64,
    /// Pages put off to the next frame by the limits on uploads.
    pub(crate) put_off: usize,
    /// Pages without a slot: their ancestors stand in.
    pub(crate) left_out: usize,
    /// Pages that do not show wholly yet.
    pub(crate) coming: usize,
}

impl Resident {
    pub(crate) fn new(gpu: &Gpu, budget_bytes: u64) -> Self {
        Self {
            atlases: Content::ALL.map(|content| Atlas::new(gpu, content, 8, budget_bytes)),
            uploads: Uploads::new(gpu),
            budget_bytes,
            datasets: None,
            style: Style::default(),
            order: Vec::new(),
            maps: Maps::default(),
            mirrored: Vec::new(),
            table: Vec::new(),
            slot_bounds: 0,
            bounds: Vec::new(),
            shown: Vec::new(),
            roots: Vec::new(),
            before: Vec::new(),
        }
    }

    /// The textures in the order of their bindings. They change where [`Self::sizes`] does.
    pub(crate) fn views(&self) -> Vec<wgpu::TextureView> {
        self.atlases.iter().flat_map(Atlas::views).collect()
    }

    /// Sides and layers of the atlases.
    pub(crate) fn sizes(&self) -> [(u32, u32); 4] {
        self.atlases.each_ref().map(|atlas| (atlas.side(), atlas.layers()))
    }

    /// Writes what is new of a selection, as far as a frame may, and the table anew.
    pub(crate) fn bring(
        &mut self,
        gpu: &Gpu,
        selection: &Selection,
        style: &Style,
        clock: Clock,
        mut allowance: Allowance,
    ) -> Brought {
        self.follow_datasets(gpu, selection, style);
        for atlas in &mut self.atlases {
            atlas.next_turn();
        }
        self.shown.iter_mut().flatten().for_each(Vec::clear);
        self.roots.iter_mut().for_each(Vec::clear);
        self.roots.resize_with(self.shown.len(), Vec::new);

        let mut brought = Brought::default();
        // First what is there, so that no new page takes its place.
        let pages = || selection.beneath.iter().chain(&selection.pages);
        for page in selection.roots.iter().chain(pages()) {
            self.atlases[content_of(selection, page) as usize].keep(name_of(page));
        }
        let before = std::mem::take(&mut self.before);
        let ages: HashMap<PageName, f64> =
            before.iter().map(|trace| (trace.name, trace.since)).collect();
        let mut traces = Vec::with_capacity(selection.pages.len() + selection.beneath.len());
        for page in &selection.roots {
            // They show where there is no room for others, and are few.
            let mut unlimited = Allowance::UNLIMITED;
            let trace = self.place(gpu, selection, page, &mut unlimited, &mut brought);
            if let Some((place, trace)) = trace {
                self.roots[place].push(trace.shown);
            }
        }
        for page in pages() {
            let trace = self.place(gpu, selection, page, &mut allowance, &mut brought);
            let Some((place, mut trace)) = trace else { continue };
            trace.since = ages.get(&trace.name).copied().unwrap_or(clock.seconds);
            trace.shown.presence = clock.presence(trace.since);
            brought.coming += usize::from(trace.shown.presence < PRESENT);
            traces.push((place, trace));
        }
        if brought.coming > 0 {
            linger::add(&mut traces, &before, |trace| {
                let place = selection.datasets.place(trace.name.dataset)?;
                self.shown[place].as_ref()?;
                let atlas = &mut self.atlases[trace.atlas];
                let slot = atlas.keep(trace.name)?;
                Some((place, Shown { slot, presence: clock.presence(trace.since), ..trace.shown }))
            });
        }
        for (place, trace) in &traces {
            self.shown[*place].as_mut().expect("it takes part").push(trace.shown);
        }
        self.before = traces.into_iter().map(|(_, trace)| trace).collect();
        self.uploads.submit(gpu);
        self.write_table(selection);
        brought
    }

    /// A page's slot, written if it is new and there is room, and the place of its dataset; none if
    /// that takes no part.
    fn place(
        &mut self,
        gpu: &Gpu,
        selection: &Selection,
        page: &ResidentPage,
        allowance: &mut Allowance,
        brought: &mut Brought,
    ) -> Option<(usize, Trace)> {
        let place = selection.datasets.place(page.dataset);
        let place = place.expect("a page's dataset stands beside it");
        self.shown[place].as_ref()?;
        let (content, name) = (content_of(selection, page), name_of(page));
        let atlas = content as usize;
        let slot = if let Some(slot) = self.atlases[atlas].keep(name) {
            slot
        } else if !allowance.has_more() {
            brought.put_off += 1;
            return None;
        } else if let Some(slot) =
            self.atlases[atlas].place(gpu, &mut self.uploads, name, &page.page)
        {
            let bytes = page.page.bytes() as u64;
            allowance.take(bytes);
            brought.uploaded += 1;
            brought.uploaded_bytes += bytes;
            slot
        } else {
            brought.left_out += 1;
            return None;
        };
        if content == Content::Heights {
            let slot = slot as usize;
            self.bounds.resize(self.bounds.len().max(slot + 1), 0.0);
            self.bounds[slot] = page.entry.bound;
        }
        let whole = page.page.coverage().is_none();
        let gray = content == Content::Grays;
        let shown = Shown { page: page.entry.page, slot, gray, whole, presence: PRESENT };
        Some((place, Trace { name, atlas, shown, since: 0.0 }))
    }

    /// Sorts the datasets and fits the atlases to their pages.
    fn follow_datasets(&mut self, gpu: &Gpu, selection: &Selection, style: &Style) {
        let is_known = self.datasets.as_ref().is_some_and(|known| known.is(&selection.datasets));
        if is_known && self.style == *style {
            return;
        }
        let datasets: Vec<_> = selection.datasets.iter().map(|(_, info)| info).collect();
        for (atlas, content) in self.atlases.iter_mut().zip(Content::ALL) {
            let sides = datasets.iter().filter(|info| info.kind == content.kind());
            let side = sides.map(|info| info.grid.pyramid().page_side()).max().unwrap_or(8);
            if atlas.side() < side {
                *atlas = Atlas::new(gpu, content, side, self.budget_bytes);
            }
        }
        let parts = datasets.iter().enumerate().flat_map(|(place, info)| {
            let parts = style.parts(&info.name, info.kind, info.priority);
            parts.map(move |part| (place, part))
        });
        self.order = parts.collect();
        self.order
            .sort_by_key(|(_, part)| (part.plane, std::cmp::Reverse(part.priority), part.series));
        self.maps = Maps::new(self.order.iter().map(|&(place, part)| (datasets[place], part)));
        self.shown.clear();
        self.shown.resize_with(datasets.len(), || None);
        for &(place, _) in &self.order {
            self.shown[place] = Some(Vec::new());
        }
        self.datasets = Some(selection.datasets.clone());
        self.style.clone_from(style);
    }

    fn write_table(&mut self, selection: &Selection) {
        self.table.clear();
        self.mirrored.clear();
        let infos: Vec<_> = selection.datasets.iter().collect();
        for ((dataset, part), map) in self.order.iter().zip(self.maps.iter()) {
            let shown = self.shown[*dataset].as_deref().unwrap_or_default();
            let (number, info) = infos[*dataset];
            let pyramid = info.grid.pyramid();
            let windows = table::append(&mut self.table, pyramid, shown, &self.roots[*dataset]);
            self.mirrored.push(map.mirrored(&windows, part, number));
        }
        self.slot_bounds = count(self.table.len());
        self.table.extend(self.bounds.iter().map(|bound| bound.to_bits().cast_signed()));
    }
}

fn count(length: usize) -> i32 {
    i32::try_from(length).expect("a table is far smaller than 2^31")
}

/// Which of the atlases a page belongs to.
fn content_of(selection: &Selection, page: &ResidentPage) -> Content {
    Content::of(selection.datasets[page.dataset].kind, &page.page)
}

fn name_of(page: &ResidentPage) -> PageName {
    let checksum = match page.entry.payload {
        Payload::Constant(texel) => u64::from(u32::from_le_bytes(texel.0)),
        Payload::Record { checksum, .. } => checksum,
    };
    PageName { dataset: page.dataset, page: PageKey::from(page.entry.page), checksum }
}
