//! What an ingest will make and take, told before it begins.
//!
//! ```text
//!   ┌─────────────────────┐      ┌──┬──┬──┬──┬──┬──┐
//!   │                 ▪▪  │      │▪ │▪ │▪ │▪ │▪ │▪ │   three pairs of leaves, one from each third
//!   │   ▪▪                │ ──▶  └──┴──┴──┴──┴──┴──┘   of the rows: decoded, and built into an
//!   │          ▪▪         │       ▀▀▀▀▀ ▀▀▀▀▀ ▀▀▀▀▀    archive in memory with the pages above
//!   └─────────────────────┘
//! ```
//!
//! Decoding counts by its blocks and all else by its leaves: a block that a pair looks into is
//! decoded whole. Strips are read for one row of leaves alone.
//!
//! # Precision
//!
//! Within a factor of 1.5 where the terrain is of one kind and the machine does nothing else. The
//! last wait for the medium is not in it.

use std::sync::Arc;
use std::time::{Duration, Instant};

use areoid_formats::address::PageAddress;
use areoid_formats::archive::Description;
use areoid_formats::grid::{Grid, Outline};
use areoid_formats::pyramid::Pyramid;

use crate::build::{self, Leaves, Means, Proceed};
use crate::origin::Origin;
use crate::raster::RasterError;
use crate::scratch::Scratch;
use crate::tile::Raw;

/// Rasters of fewer pixels are done before anyone asks.
pub const WORTH_MEASURING_PX: u64 = 256 << 20;

/// Leaves measured.
const LEAVES: u32 = 6;

/// The share of the pixels that may be decoded to measure: one in so many.
const SHARE: u64 = 16;

/// What an ingest is expected to make and take.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Texels of the finest level.
    pub texels: u64,
    /// Pages of all levels: exact if none is empty.
    pub pages: u64,
    /// What was measured on a few leaves; `None` for small rasters, and where it would cost too
    /// much.
    pub measured: Option<Measured>,
}

/// What a few leaves say of all.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// Length of the whole archive, in bytes.
    pub bytes: u64,
    /// Wall-clock seconds that the build will take from here.
    pub seconds: f64,
    /// Blocks decoded to measure, and once more by the build.
    pub decoded_blocks: u64,
}

impl Estimate {
    /// What the grid alone says.
    #[must_use]
    pub fn of(pyramid: &Pyramid) -> Self {
        let extent = pyramid.extent();
        let pages = pyramid.levels().filter_map(|level| pyramid.pages(level));
        Self {
            texels: u64::from(extent.width) * u64::from(extent.height),
            pages: pages.map(|(rows, cols)| u64::from(rows) * u64::from(cols)).sum(),
            measured: None,
        }
    }

    /// Of several builds, one after another. Where some were measured, those that were not are taken
    /// to be like them, texel for texel.
    #[must_use]
    pub fn together(parts: &[Self]) -> Self {
        let texels = parts.iter().map(|part| part.texels).sum();
        let known = || parts.iter().filter_map(|part| part.measured.map(|it| (part.texels, it)));
        let of_known: u64 = known().map(|(texels, _)| texels).sum();
        let share = texels as f64 / of_known.max(1) as f64;
        let bytes = known().map(|(_, measured)| measured.bytes as f64).sum::<f64>() * share;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a length")]
        let measured = Measured {
            bytes: bytes as u64,
            seconds: known().map(|(_, measured)| measured.seconds).sum::<f64>() * share,
            decoded_blocks: known().map(|(_, measured)| measured.decoded_blocks).sum(),
        };
        Self {
            texels,
            pages: parts.iter().map(|part| part.pages).sum(),
            measured: (of_known > 0).then_some(measured),
        }
    }

    /// With what a few leaves say, if there are many. `left` is the share of the work that is still
    /// to be done; `go_on` is asked before each leaf. Runs on the current rayon pool and holds up to
    /// `memory_bytes`; what cannot be read is left for the build to find.
    #[must_use]
    pub fn measure(
        self,
        description: &Description,
        origin: &dyn Origin,
        scratch: &Arc<Scratch>,
        memory_bytes: u64,
        left: f64,
        go_on: GoOn<'_>,
    ) -> Self {
        if self.texels < WORTH_MEASURING_PX {
            return self;
        }
        let largest = (self.texels / SHARE).min(memory_bytes / 4);
        let sample = Sample::choose(description, origin, largest);
        // A few leaves keep a few threads busy badly, and one well.
        let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build().ok();
        let measured = sample
            .zip(alone)
            .and_then(|(sample, alone)| alone.install(|| sample.measure(origin, scratch, go_on)));
        Self { measured: measured.map(|figures| figures.scaled(self, origin, left)), ..self }
    }
}

/// Who is asked whether to go on.
type GoOn<'a> = &'a mut (dyn FnMut() -> Proceed + Send);

/// Leaves to measure on.
struct Sample {
    leaves: Vec<PageAddress>,
    /// An archive of them alone, side by side.
    description: Description,
}

/// What was seen, on one thread.
struct Figures {
    decoded_blocks: u64,
    reading_s: f64,
    building_s: f64,
    bytes: u64,
}

impl Sample {
    /// Leaves for which at most so many pixels are decoded.
    fn choose(description: &Description, origin: &dyn Origin, largest_px: u64) -> Option<Self> {
        let pyramid = description.grid.pyramid();
        let (rows, cols) = pyramid.pages(pyramid.finest())?;
        if rows < 2 || cols < 3 {
            return None;
        }
        // The last row and column may be cut.
        let at = |sixth: u32, count: u32| sixth * count / 6;
        let pair = |row: u32, col: u32| {
            let leaf = |col| PageAddress::new(pyramid.finest(), row.min(rows - 2), col);
            let left = col.min(cols - 3);
            [leaf(left), leaf(left + 1)]
        };
        let spread = [pair(at(1, rows), at(5, cols)), pair(at(3, rows), at(1, cols))];
        let spread = [spread[0], spread[1], pair(at(5, rows), at(3, cols))].concat();
        let in_a_row = [1, 3, 5].map(|sixth| pair(at(3, rows), at(sixth, cols))).concat();
        let affordable = |leaves: &Vec<PageAddress>| origin.decoded_for(leaves) <= largest_px;
        let leaves = [spread, in_a_row].into_iter().find(affordable)?;

        let (grid, interior) = (&description.grid, pyramid.interior());
        let [left, top] = grid.origin();
        let [pixel_x, pixel_y] = grid.pixel_size();
        let middle = f64::from(pyramid.extent().height / 2 - interior / 2);
        let outline = Outline {
            origin: [left, top - middle * pixel_y],
            pixel_size: [pixel_x, pixel_y],
            width: LEAVES * interior,
            height: interior,
        };
        let placed = Grid::from_outline(*grid.crs(), outline, pyramid.page_side()).ok()?;
        let pages = placed.grid.pyramid().pages(placed.grid.pyramid().finest());
        let description = Description { grid: placed.grid, ..description.clone() };
        (pages == Some((1, LEAVES))).then_some(Self { leaves, description })
    }

    fn measure(
        &self,
        origin: &dyn Origin,
        scratch: &Arc<Scratch>,
        go_on: GoOn<'_>,
    ) -> Option<Figures> {
        let apart = origin.apart();
        let start = Instant::now();
        let read = |&leaf: &PageAddress| match go_on() {
            Proceed::Yes => apart.read(leaf).ok(),
            Proceed::No => None,
        };
        let raws = self.leaves.iter().map(read).collect::<Option<Vec<_>>>()?;
        let reading_s = start.elapsed().as_secs_f64();
        let decoded_blocks = apart.decoded_blocks();
        let leaves =
            SideBySide { raws, may_have_holes: apart.may_have_holes(), is_whole: apart.is_whole() };
        drop(apart);

        let (building_s, bytes) = self.build(&leaves, scratch)?;
        Some(Figures { decoded_blocks, reading_s, building_s, bytes })
    }

    /// Seconds and bytes of the archive.
    fn build(&self, leaves: &SideBySide, scratch: &Arc<Scratch>) -> Option<(f64, u64)> {
        let start = Instant::now();
        let means = Means {
            scratch: Arc::clone(scratch),
            frontier_bytes: u64::MAX,
            pages_together: LEAVES as usize,
            note_every: Duration::MAX,
        };
        let (description, watch) = (&self.description, |_| Proceed::Yes);
        let built = build::build(description, leaves, Vec::new(), &means, None, watch);
        let (archive, _) = built.ok()?;
        Some((start.elapsed().as_secs_f64(), archive.len() as u64))
    }
}

impl Figures {
    fn scaled(&self, all: Estimate, origin: &dyn Origin, left: f64) -> Measured {
        let threads = rayon::current_num_threads() as f64;
        let blocks = origin.blocks() as f64 / self.decoded_blocks.max(1) as f64;
        let texels = f64::from(LEAVES) * f64::from(origin.grid().pyramid().interior()).powi(2);
        // Levels above the leaves have a quarter of them here, a third in all.
        let above = (4.0 / 3.0) / (5.0 / 4.0);
        let building_s = self.building_s * above * all.texels as f64 / texels;
        let seconds = self.reading_s * blocks + building_s;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a length")]
        let bytes = (self.bytes as f64 * above * all.texels as f64 / texels) as u64;
        Measured { bytes, seconds: left * seconds / threads, decoded_blocks: self.decoded_blocks }
    }
}

/// Leaves that were read before, in a row.
struct SideBySide {
    raws: Vec<Option<Raw>>,
    may_have_holes: bool,
    is_whole: bool,
}

impl Leaves for SideBySide {
    fn read(&self, page: PageAddress) -> Result<Option<Raw>, RasterError> {
        Ok(self.raws[page.col as usize].clone())
    }

    fn may_have_holes(&self) -> bool {
        self.may_have_holes
    }

    fn is_whole(&self) -> bool {
        self.is_whole
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_not_measured_is_taken_to_be_like_what_was() {
        let known = Measured { bytes: 600, seconds: 3.0, decoded_blocks: 4 };
        let of = |texels, measured| Estimate { texels, pages: 2, measured };
        let together = Estimate::together(&[of(300, Some(known)), of(50, None), of(100, None)]);
        let measured = Measured { bytes: 900, seconds: 4.5, decoded_blocks: 4 };
        assert_eq!(together, Estimate { texels: 450, pages: 6, measured: Some(measured) });
        assert_eq!(Estimate::together(&[of(7, None), of(8, None)]).measured, None);
        assert_eq!(Estimate::together(&[of(300, Some(known))]), of(300, Some(known)));
    }
}
