//! Thousands of small datasets all over a planet, whose pages are computed when they are asked for:
//! an index of any size that takes no memory.

use std::sync::Arc;
use std::thread;
use std::time::Duration;

use areoid_cache::{DatasetInfo, PageSource};
use areoid_formats::address::PageAddress;
use areoid_formats::archive::{ArchiveError, PageEntry};
use areoid_formats::grid::{Grid, Outline};
use areoid_formats::page::{Kind, Page};
use areoid_formats::projection::{Crs, Projection};

use super::planet::{body, chance, entry, narrow, texels};
use crate::failure::Failure;

/// Texels along the side of a page.
const PAGE_SIDE: u32 = 512;

/// Leaves along the side of a patch.
const LEAVES: u32 = 100;

/// Degrees along the side of a patch.
const DEGREES: f64 = 2.0;

/// One of them.
#[derive(Debug)]
pub(super) struct Patch {
    pub(super) info: DatasetInfo,
    delay: Duration,
}

/// `count` patches, evenly over the planet.
///
/// # References
///
/// * The spiral of R. Swinbank and R. J. Purser, *Fibonacci grids*, 2006.
pub(super) fn patches(count: u32, delay: Duration) -> Result<Vec<Arc<Patch>>, Failure> {
    (0..count).map(|number| patch(number, count, delay)).collect()
}

/// One more, anywhere between them.
pub(super) fn patch(number: u32, count: u32, delay: Duration) -> Result<Arc<Patch>, Failure> {
    let golden = 180.0 * (3.0 - 5.0_f64.sqrt());
    let longitude = (golden * f64::from(number)).rem_euclid(360.0) - 180.0;
    let sine = (2.0 * f64::from(number) + 1.0) / f64::from(count) - 1.0;
    let most = 90.0 - DEGREES;
    let latitude = sine.clamp(-1.0, 1.0).asin().to_degrees().clamp(-most, most);
    let side = LEAVES * (PAGE_SIDE - 2);
    let outline = Outline {
        origin: [longitude, latitude + DEGREES / 2.0],
        pixel_size: [DEGREES / f64::from(side); 2],
        width: side,
        height: side,
    };
    let crs = Crs::new(Projection::Geographic, body().ellipsoid);
    let grid = Grid::from_outline(crs, outline, PAGE_SIDE)
        .map_err(|error| std::io::Error::other(error.to_string()))?
        .grid;
    let name = format!("patch-{number}");
    let info = DatasetInfo { name, group: None, kind: Kind::Height, grid, priority: 0 };
    Ok(Arc::new(Patch { info, delay }))
}

impl Patch {
    /// Pages of all levels.
    pub(super) fn pages(&self) -> u64 {
        let pyramid = self.info.grid.pyramid();
        let levels = pyramid.levels().filter_map(|level| pyramid.pages(level));
        levels.map(|(rows, cols)| u64::from(rows) * u64::from(cols)).sum()
    }

    fn entry(&self, page: PageAddress) -> Option<PageEntry> {
        let pyramid = self.info.grid.pyramid();
        if !pyramid.contains(page) {
            return None;
        }
        let mut entry = entry(page);
        // Ranges nest: deeper pages have narrower ones.
        let depth = f64::from(page.level.0);
        let reach = narrow(2000.0 / (1.0 + depth));
        (entry.lowest, entry.highest) = (-reach, reach);
        (entry.min, entry.max) = (-reach, reach);
        if page.level != pyramid.finest() {
            let halvings = f64::from(pyramid.halvings(page.level));
            let texel = self.info.grid.nominal_pixel().0 * halvings.exp2();
            // At least twice that of the children, whatever chance says.
            entry.bound = narrow(0.06 * texel * (0.7 + 0.6 * chance(page)));
        }
        Some(entry)
    }
}

impl PageSource for Patch {
    fn find_resident(&self, page: PageAddress) -> Option<Option<PageEntry>> {
        Some(self.entry(page))
    }

    fn find(&self, page: PageAddress) -> Result<Option<PageEntry>, ArchiveError> {
        Ok(self.entry(page))
    }

    fn payload(&self, _: &PageEntry) -> Result<Vec<u8>, ArchiveError> {
        thread::sleep(self.delay);
        Ok(Vec::new())
    }

    fn decode(&self, entry: &PageEntry, _: &[u8]) -> Result<Page, ArchiveError> {
        Ok(texels(&self.info, entry))
    }
}
