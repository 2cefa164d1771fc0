//! A planet in memory, and the cache put to the test on it.

mod asking;
mod changing;
mod crowds;
mod culling;
mod failing;
mod faulty;
mod frames;
mod held;
mod loading;
mod models;
mod opening;
mod orders;

use std::collections::HashMap;
use std::io;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, Condvar, Mutex};

use areoid_formats::address::{Level, PageAddress};
use areoid_formats::archive::record::RECORD_HEAD_LEN;
use areoid_formats::archive::{
    Archive, ArchiveWriter, ConstantTexel, Description, MipRule, PageEntry, Payload, Source,
};
use areoid_formats::body::Body;
use areoid_formats::codec::{Quantum, encode_heights};
use areoid_formats::geodesy::Geographic;
use areoid_formats::grid::{Grid, Outline};
use areoid_formats::page::Kind;
use areoid_formats::projection::{Crs, Projection};
use areoid_formats::storage::ByteSource;
use areoid_formats::units::{Degrees, Meters};
use glam::{DMat3, DVec3};

pub(crate) use self::opening::globe_in_a_catalog;
use crate::{Cache, DatasetInfo, Options, PageSource, Selection, Session, View};

/// A budget for all there is.
const PLENTY: usize = 64 << 20;
/// Decoded bytes of a page.
const PAGE: usize = 66 * 66 * 4;

fn mars() -> Body {
    Body::parse("mars").unwrap()
}

/// 171 pages of 66 x 66 on five levels.
fn globe() -> Grid {
    let outline = Outline {
        origin: [-180.0, 90.0],
        pixel_size: [360.0 / 1024.0; 2],
        width: 1024,
        height: 512,
    };
    let crs = Crs::new(Projection::Geographic, mars().ellipsoid);
    Grid::from_outline(crs, outline, 66).unwrap().grid
}

/// 85 pages about the north pole.
fn cap() -> Grid {
    let outline = Outline { origin: [-8e5, 8e5], pixel_size: [3125.0; 2], width: 512, height: 512 };
    let crs = Crs::from_proj_string("+proj=stere +lat_0=90 +R=3396190").unwrap();
    Grid::from_outline(crs, outline, 66).unwrap().grid
}

fn addresses(selection: &Selection) -> Vec<PageAddress> {
    selection.pages.iter().map(|page| page.entry.page).collect()
}

/// A number in [0, 1) that depends on the page and a salt.
fn chance(page: PageAddress, salt: u64) -> f64 {
    let mut state = u64::from(page.level.0)
        ^ (u64::from(page.row) << 8)
        ^ (u64::from(page.col) << 32)
        ^ (salt << 56);
    for _ in 0..2 {
        state = (state ^ (state >> 31)).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(27);
    }
    (state >> 11) as f64 / (1_u64 << 53) as f64
}

#[expect(clippy::cast_possible_truncation, reason = "any number near it will do")]
fn narrow(number: f64) -> f32 {
    number as f32
}

/// Entries whose heights, bounds and holes nest, for every page below `page`.
fn fill(grid: &Grid, page: PageAddress, entries: &mut HashMap<PageAddress, PageEntry>) {
    let pyramid = grid.pyramid();
    let mut entry = PageEntry {
        page,
        payload: Payload::Record { offset: 0, length: 0, checksum: 0 },
        valid_fraction: 0.0,
        min: f32::INFINITY,
        max: f32::NEG_INFINITY,
        lowest: f32::INFINITY,
        highest: f32::NEG_INFINITY,
        bound: 0.0,
        source_error: 0.0,
        full: true,
    };
    if page.level == pyramid.finest() {
        if chance(page, 1) < 0.1 {
            return;
        }
        // A few lone peaks among plains.
        let peak = if chance(page, 2) < 0.05 { 20_000.0 } else { 500.0 };
        entry.valid_fraction = 1.0;
        entry.min = narrow(-1000.0 * chance(page, 3));
        entry.max = entry.min + peak;
        (entry.lowest, entry.highest) = (entry.min, entry.max);
    } else {
        for child in pyramid.children(page).collect::<Vec<_>>() {
            fill(grid, child, entries);
            let Some(child) = entries.get(&child) else { continue };
            entry.valid_fraction += 0.25 * child.valid_fraction;
            entry.min = entry.min.min(child.min);
            entry.max = entry.max.max(child.max);
            (entry.lowest, entry.highest) = (entry.min, entry.max);
            entry.bound = entry.bound.max(child.bound);
            entry.full &= child.full;
        }
        let texel = grid.nominal_pixel().0 * f64::from(pyramid.halvings(page.level)).exp2();
        entry.bound += narrow(0.02 * texel * (0.3 + chance(page, 4)));
    }
    if entry.valid_fraction > 0.0 {
        entries.insert(page, entry);
    }
}

/// A globe of 2,700 pages.
fn fine_globe() -> Grid {
    let outline = Outline {
        origin: [-180.0, 90.0],
        pixel_size: [360.0 / 4096.0; 2],
        width: 4096,
        height: 2048,
    };
    let crs = Crs::new(Projection::Geographic, mars().ellipsoid);
    Grid::from_outline(crs, outline, 66).unwrap().grid
}

/// The bytes of an archive, and what is in it.
fn planet(name: &str, grid: Grid, kind: Kind) -> (Description, Vec<u8>) {
    let description = Description {
        dataset: name.to_owned(),
        kind,
        body: mars(),
        grid: grid.clone(),
        quantum: Quantum::NONE,
        priority: 0,
        feather_texels: 0,
        unit_pages: 8,
        resampling: None,
        mip: MipRule::Mean,
        source: Source::default(),
    };
    let mut entries = HashMap::new();
    let (rows, cols) = grid.pyramid().pages(Level(0)).unwrap();
    for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
        fill(&grid, PageAddress::new(Level(0), row, col), &mut entries);
    }
    let mut entries: Vec<PageEntry> = entries.into_values().collect();
    entries.sort_by_key(|entry| entry.page);
    let side = grid.pyramid().page_side() as usize;
    let mut writer = ArchiveWriter::new(Vec::new(), &description).unwrap();
    for mut entry in entries {
        if kind == Kind::Color {
            // Colors that agree with the finest ones from level 3 on, almost.
            entry.bound = if entry.page.level < Level(3) { 40.0 } else { 0.4 };
            entry.payload = Payload::Constant(ConstantTexel([90, 60, entry.page.level.0, 0]));
            writer.page(entry, &[]).unwrap();
            continue;
        }
        let texels: Vec<f32> =
            (0..side * side).map(|texel| entry.min + (texel % 7) as f32).collect();
        let payload = encode_heights(&texels, None, side, Quantum::NONE).unwrap();
        writer.page(entry, &payload).unwrap();
    }
    writer.end_unit().unwrap();
    (description, writer.finish().unwrap().0)
}

/// What reads have to pass.
#[derive(Debug, Default)]
pub(crate) struct Gate {
    /// Reads that may pass before the gate is shut; `None` for all.
    allowed: Mutex<Option<usize>>,
    opened: Condvar,
    failing: AtomicBool,
    /// Offset and length of all reads that passed.
    reads: Mutex<Vec<(u64, usize)>>,
    /// Where what it was told of begins, and whether it had been read before.
    told: Mutex<Vec<(u64, bool)>>,
}

impl Gate {
    pub(crate) fn allow(&self, reads: Option<usize>) {
        *self.allowed.lock().unwrap() = reads;
        self.opened.notify_all();
    }

    /// Reads that have passed.
    pub(crate) fn passed(&self) -> usize {
        self.reads.lock().unwrap().len()
    }

    pub(crate) fn fail(&self, failing: bool) {
        self.failing.store(failing, Relaxed);
    }

    fn pass(&self, offset: u64, len: usize) -> io::Result<()> {
        if self.failing.load(Relaxed) {
            return Err(io::Error::other("the medium is out of order"));
        }
        let mut allowed = self.allowed.lock().unwrap();
        while *allowed == Some(0) {
            allowed = self.opened.wait(allowed).unwrap();
        }
        if let Some(allowed) = allowed.as_mut() {
            *allowed -= 1;
        }
        self.reads.lock().unwrap().push((offset, len));
        Ok(())
    }
}

#[derive(Debug)]
struct GatedSource {
    bytes: Vec<u8>,
    gate: Arc<Gate>,
}

impl ByteSource for GatedSource {
    fn len(&self) -> u64 {
        ByteSource::len(&self.bytes)
    }

    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        self.gate.pass(offset, buffer.len())?;
        self.bytes.read_exact_at(buffer, offset)
    }

    fn advise(&self, range: Range<u64>) {
        let was_read = self.gate.reads.lock().unwrap().iter().any(|read| read.0 == range.start);
        self.gate.told.lock().unwrap().push((range.start, was_read));
    }
}

/// A dataset behind a gate that stands open.
pub(crate) struct Gated {
    info: DatasetInfo,
    pub(crate) archive: Arc<Archive>,
    pub(crate) gate: Arc<Gate>,
    pub(crate) entries: Vec<PageEntry>,
}

impl Gated {
    pub(crate) fn globe() -> Self {
        Self::new("globe", globe(), Kind::Height)
    }

    fn new(name: &str, grid: Grid, kind: Kind) -> Self {
        let (description, bytes) = planet(name, grid, kind);
        Self::from_bytes(description, bytes)
    }

    fn from_bytes(description: Description, bytes: Vec<u8>) -> Self {
        let gate = Arc::new(Gate::default());
        let entries = Archive::open(Box::new(bytes.clone())).unwrap().entries().unwrap();
        let source = GatedSource { bytes, gate: Arc::clone(&gate) };
        let info = DatasetInfo {
            name: description.dataset,
            group: None,
            kind: description.kind,
            grid: description.grid,
            priority: description.priority,
        };
        let archive = Arc::new(Archive::open(Box::new(source)).unwrap());
        Self { info, archive, gate, entries }
    }

    fn cache(&self, budget_bytes: usize, concurrent_loads: usize) -> Cache {
        let archives = vec![(self.info.clone(), Arc::clone(&self.archive))];
        let in_flight_bytes = budget_bytes;
        let options = Options { budget_bytes, in_flight_bytes, concurrent_loads };
        Cache::with_archives(mars(), archives, options).unwrap()
    }

    fn entry(&self, page: PageAddress) -> &PageEntry {
        self.entries.iter().find(|entry| entry.page == page).unwrap()
    }

    /// How often the payload of each page was read.
    fn page_reads(&self) -> HashMap<PageAddress, usize> {
        let reads = self.gate.reads.lock().unwrap();
        let mut counts = HashMap::new();
        for entry in &self.entries {
            let Payload::Record { offset, length, .. } = entry.payload else { continue };
            let read = (offset + RECORD_HEAD_LEN as u64, length as usize);
            let count = reads.iter().filter(|&&found| found == read).count();
            if count > 0 {
                counts.insert(entry.page, count);
            }
        }
        counts
    }
}

/// A view from above a place, `pitch` degrees from straight down toward the north.
fn view(longitude: f64, latitude: f64, altitude: f64, pitch: f64) -> View {
    let position = Geographic::from_degrees(Degrees(longitude), Degrees(latitude));
    let eye = mars().ellipsoid.cartesian_from_geographic(position, Meters(altitude));
    let up = eye.normalize();
    let east = DVec3::Z.cross(up).try_normalize().unwrap_or(DVec3::Y);
    let north = up.cross(east);
    let (sine, cosine) = pitch.to_radians().sin_cos();
    let backward = up * cosine - north * sine;
    View {
        eye,
        orientation: DMat3::from_cols(east, backward.cross(east), backward),
        vertical_fov: Degrees(45.0).into(),
        viewport: [640, 400],
        tolerance_px: 1.0,
    }
}
