//! A planet of made-up pages whose true surface is known: points of it, leaf by leaf.
//!
//! Heights are a sum of waves over the sphere, of all lengths down to a leaf's. Leaves know the
//! range of their points, and coarser pages those of what is under them; bounds grow with the texels
//! and differ from page to page, as those of a planet do.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::thread;
use std::time::Duration;

use areoid_cache::{DatasetInfo, PageSource};
use areoid_formats::address::{Level, PageAddress};
use areoid_formats::archive::{ArchiveError, PageEntry, Payload};
use areoid_formats::body::{Body, Ellipsoid};
use areoid_formats::grid::{Grid, TexelPoint};
use areoid_formats::page::{Kind, Page, Texels};
use areoid_formats::units::Meters;
use glam::DVec3;

/// Points along a leaf's side, corners included.
const STEPS: u32 = 6;

/// The pages of one dataset.
#[derive(Debug)]
pub(super) struct Planet {
    pub(super) info: DatasetInfo,
    pub(super) entries: HashMap<PageAddress, PageEntry>,
    /// Of each leaf, points of the surface.
    pub(super) leaves: HashMap<PageAddress, Vec<DVec3>>,
    /// Of a load.
    pub(super) delay: Duration,
    pub(super) loads: AtomicU64,
}

/// Mars's sphere.
pub(super) fn body() -> Body {
    Body::parse("mars").expect("a body that has a name")
}

impl Planet {
    pub(super) fn new(name: &str, grid: Grid, delay: Duration) -> Arc<Self> {
        let info = DatasetInfo {
            name: name.to_owned(),
            group: None,
            kind: Kind::Height,
            grid,
            priority: 0,
        };
        let (entries, leaves, loads) = (HashMap::new(), HashMap::new(), AtomicU64::new(0));
        let mut planet = Self { info, entries, leaves, delay, loads };
        let (rows, cols) = planet.info.grid.pyramid().pages(Level(0)).expect("a coarsest level");
        for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
            planet.fill(PageAddress::new(Level(0), row, col));
        }
        Arc::new(planet)
    }

    /// Makes the entry of a page and all below it.
    fn fill(&mut self, page: PageAddress) -> PageEntry {
        let pyramid = self.info.grid.pyramid();
        let mut entry = entry(page);
        if page.level == pyramid.finest() {
            let points = self.points(page);
            let radius = body().ellipsoid.a().0;
            let heights = points.iter().map(|point| narrow(point.length() - radius));
            (entry.lowest, entry.highest) = heights
                .fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), height| {
                    (low.min(height), high.max(height))
                });
            // Between the points it is not known.
            entry.lowest -= 1.0;
            entry.highest += 1.0;
            self.leaves.insert(page, points);
        } else {
            let (mut lowest, mut highest) = (f32::INFINITY, f32::NEG_INFINITY);
            for child in pyramid.children(page).collect::<Vec<_>>() {
                let child = self.fill(child);
                lowest = lowest.min(child.lowest);
                highest = highest.max(child.highest);
                entry.bound = entry.bound.max(child.bound);
            }
            (entry.lowest, entry.highest) = (lowest, highest);
            let pyramid = self.info.grid.pyramid();
            let halvings = f64::from(pyramid.halvings(page.level));
            let texel = self.info.grid.nominal_pixel().0 * halvings.exp2();
            // Of MOLA's levels the largest bounds are 0.07 to 0.18 texels.
            entry.bound += narrow(0.03 * texel * (0.3 + chance(page)));
        }
        (entry.min, entry.max) = (entry.lowest, entry.highest);
        self.entries.insert(page, entry);
        entry
    }

    /// Points of the surface over a leaf, along its sides too.
    fn points(&self, page: PageAddress) -> Vec<DVec3> {
        let grid = &self.info.grid;
        let interior = f64::from(grid.pyramid().interior());
        let (rows, cols) = grid.pyramid().interior_size(page);
        let steps = f64::from(STEPS - 1);
        let places = (0..STEPS).flat_map(|row| (0..STEPS).map(move |col| (row, col)));
        places
            .filter_map(|(row, col)| {
                let texel = TexelPoint {
                    x: f64::from(page.col) * interior + f64::from(col) / steps * f64::from(cols),
                    y: f64::from(page.row) * interior + f64::from(row) / steps * f64::from(rows),
                };
                let position = grid.geographic_from_texel(page.level, texel)?;
                let normal = areoid_formats::geodesy::surface_normal(position);
                let height = Meters(height(normal));
                let ellipsoid: Ellipsoid = body().ellipsoid;
                Some(ellipsoid.cartesian_from_geographic(position, height))
            })
            .collect()
    }
}

/// An entry of a record that is nowhere.
pub(super) fn entry(page: PageAddress) -> PageEntry {
    PageEntry {
        page,
        payload: Payload::Record { offset: 0, length: 2048, checksum: 0 },
        valid_fraction: 1.0,
        min: 0.0,
        max: 0.0,
        lowest: 0.0,
        highest: 0.0,
        bound: 0.0,
        source_error: 0.0,
        full: true,
    }
}

/// Made-up texels of a page.
pub(super) fn texels(info: &DatasetInfo, entry: &PageEntry) -> Page {
    let side = info.grid.pyramid().page_side() as usize;
    Page::new(side, Texels::Height(vec![entry.lowest; side * side]), None)
}

#[expect(clippy::cast_possible_truncation, reason = "meters of made-up terrain")]
pub(super) fn narrow(meters: f64) -> f32 {
    meters as f32
}

/// A number from 0 to 1 that a page has.
pub(super) fn chance(page: PageAddress) -> f64 {
    let mut bits = u64::from(page.level.0) << 56 ^ u64::from(page.row) << 28 ^ u64::from(page.col);
    // SplitMix64 (Steele, Lea and Flood 2014).
    bits = bits.wrapping_add(0x9e37_79b9_7f4a_7c15);
    bits = (bits ^ bits >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    bits = (bits ^ bits >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    f64::from(u32::try_from((bits ^ bits >> 31) >> 32).unwrap_or(0)) / f64::from(u32::MAX)
}

/// Meters over the sphere.
fn height(normal: DVec3) -> f64 {
    let mut total = 0.0;
    for octave in 0..7_i32 {
        let frequency = 2.0 * 2.0_f64.powi(octave);
        let tilt = f64::from(octave);
        let axis = DVec3::new(tilt.cos(), (1.7 * tilt).sin(), (0.9 * tilt + 0.3).cos());
        let across = DVec3::new((2.3 * tilt).sin(), tilt.cos(), 0.7);
        total += 3000.0 / frequency
            * (frequency * normal.dot(axis) + tilt).sin()
            * (frequency * normal.dot(across)).cos();
    }
    total
}

impl PageSource for Planet {
    fn find_resident(&self, page: PageAddress) -> Option<Option<PageEntry>> {
        Some(self.entries.get(&page).copied())
    }

    fn find(&self, page: PageAddress) -> Result<Option<PageEntry>, ArchiveError> {
        Ok(self.entries.get(&page).copied())
    }

    fn payload(&self, _: &PageEntry) -> Result<Vec<u8>, ArchiveError> {
        thread::sleep(self.delay);
        Ok(Vec::new())
    }

    fn decode(&self, entry: &PageEntry, _: &[u8]) -> Result<Page, ArchiveError> {
        self.loads.fetch_add(1, Relaxed);
        Ok(texels(&self.info, entry))
    }
}
