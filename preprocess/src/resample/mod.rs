//! Leaves of any grid from rasters on any other.
//!
//! ```text
//!   target tile ─▶ transform ─▶ coords ─┐
//!   blocks ─▶ prepared tiles ─▶ window ─┴─▶ kernel ─▶ texels
//!   (decoded)  (filled, filtered)
//! ```

pub mod tile;

pub mod extension;
pub mod source;

pub mod transform;

pub mod target;

pub mod prepare;

pub mod needs;
pub mod window;

pub mod kernel;

pub mod rasters;

mod beneath;
mod error;
mod fit;

mod leaf;

pub mod truth;

use std::sync::Arc;

use areoid_formats::address::PageAddress;
use areoid_formats::grid::{Grid, Placement};
use areoid_formats::page::Kind;
use rayon::prelude::*;

use self::extension::Extension;
use self::kernel::{Kernel, RangeLimit};
use self::needs::{PreparedAt, prepared_tiles};
use self::prepare::{Beside, PreparedSource};
use self::rasters::Rasters;
use self::source::{Rect, Source};
use self::tile::Footprint;
use self::transform::{Precision, Transform};
use crate::mosaic::Layout;
use crate::once::Overflow;
use crate::origin::Origin;

/// How texels are made of pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Resampling {
    /// The kernel.
    pub kernel: Kernel,
    /// Whether texels keep within the pixels around them.
    pub limit: RangeLimit,
    /// How exact their places are.
    pub precision: Precision,
    /// What texels are of what lies between the pixels.
    pub texels: Texels,
}

/// What texels are of the field that a kernel sees between pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Texels {
    /// Its values at their centers.
    #[default]
    Sampled,
    /// Those whose bilinear surface, which is what is shown, is nearest to it. Of heights alone.
    Fitted,
}

impl Texels {
    /// How many texels around a leaf are sampled for it.
    fn around(self) -> u32 {
        match self {
            Self::Sampled => 0,
            Self::Fitted => 1,
        }
    }
}

/// Rasters that cannot be resampled to a grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the grid shows another body than the rasters")]
pub struct OtherBody;

/// Leaves of a grid, resampled from rasters on another.
#[derive(Debug)]
pub struct Resampler {
    plan: Arc<Plan>,
    layout: Layout,
    rasters: Arc<Rasters>,
    prepared: PreparedSource,
    heights: Heights,
    held: Held,
}

/// What becomes of heights between whole meters, where the source has none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Heights {
    Rounded,
    AsTheyAre,
}

/// What finished leaves are held against.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Held {
    AgainstPixels,
    AgainstNothing,
}

/// What of the pixels each leaf is made of, and held against: a function of grids alone, found once.
///
/// In memory until the build is done: half a kilobyte a leaf where texels are as large as pixels, and
/// 16 bytes more for each 65,536 pixels beneath one.
#[derive(Debug)]
struct Plan {
    grid: Grid,
    resampling: Resampling,
    transform: Transform,
    /// From pixels to texels.
    back: Transform,
    /// Row by row.
    leaves: Vec<Needs>,
}

/// What a leaf needs.
#[derive(Debug)]
struct Needs {
    /// The prepared tiles that it announces.
    tiles: Box<[PreparedAt]>,
    /// The pixels that it is held against when it is finished.
    beneath: Box<[Rect]>,
}

impl Resampler {
    /// Leaves of `grid` from `layout`, whose pixels are `kind` and lie at `placement`.
    ///
    /// # Errors
    ///
    /// [`OtherBody`].
    pub fn new(
        grid: Grid,
        layout: Layout,
        placement: Placement,
        kind: Kind,
        resampling: Resampling,
    ) -> Result<Self, OtherBody> {
        let (target, precision) = (grid.placement(), resampling.precision);
        let transform = Transform::new(&target, &placement, precision).ok_or(OtherBody)?;
        let back = Transform::new(&placement, &target, precision).ok_or(OtherBody)?;
        let plan = Arc::new(Plan::new(grid, resampling, transform, back));
        let held = Held::AgainstPixels;
        let (rasters, prepared) = plan.sources(&layout, kind, held, None);
        Ok(Self { plan, layout, rasters, prepared, heights: Heights::Rounded, held })
    }

    /// The same with heights that are not rounded to whole meters where those of the rasters are: for
    /// what is derived from them.
    #[must_use]
    pub fn unrounded(self) -> Self {
        Self { heights: Heights::AsTheyAre, ..self }
    }

    /// The same with leaves that are not held against the pixels when they are finished, so that no
    /// block waits for that. They have no source error.
    ///
    /// # Panics
    ///
    /// If a leaf was read already.
    #[must_use]
    pub fn unmeasured(self) -> Self {
        assert_eq!(self.rasters.decoded_blocks(), 0, "uses are announced before the first");
        let held = Held::AgainstNothing;
        let (rasters, prepared) = self.plan.sources(&self.layout, self.rasters.kind(), held, None);
        Self { rasters, prepared, held, ..self }
    }

    /// How often a prepared tile was made, and how many there are.
    #[must_use]
    pub fn prepared_tiles(&self) -> (u64, u64) {
        let (cols, rows) = self.prepared.tiles();
        (self.prepared.made(), u64::from(cols) * u64::from(rows))
    }
}

impl Plan {
    fn new(grid: Grid, resampling: Resampling, transform: Transform, back: Transform) -> Self {
        let (pyramid, around) = (grid.pyramid(), resampling.texels.around());
        let reach = |footprint: Footprint| {
            let [across, down] = resampling.kernel.reach(footprint);
            [across - 1, across, down - 1, down]
        };
        let needs = |leaf: PageAddress| Needs {
            tiles: prepared_tiles(&transform, pyramid, (leaf, around), reach).into(),
            beneath: beneath::beneath(&back, pyramid, leaf).into(),
        };
        let all: Vec<PageAddress> = leaves(&grid).collect();
        let leaves = all.into_par_iter().map(needs).collect();
        Self { grid, resampling, transform, back, leaves }
    }

    /// What leaves are sampled from, with their uses announced and what waits in memory limited.
    fn sources(
        &self,
        layout: &Layout,
        kind: Kind,
        held: Held,
        overflow: Option<&Arc<Overflow>>,
    ) -> (Arc<Rasters>, PreparedSource) {
        let (placement, filter) = (*self.transform.source(), self.resampling.kernel.filter());
        let named = self.leaves.iter().flat_map(|needs| &needs.tiles).copied();
        let uses = needs::uses(&placement, named);
        let columns = placement.width.div_ceil(prepare::PREPARED) as usize;
        let narrow = |index: usize| u32::try_from(index).expect("tiles of a raster");
        let wanted = (0..uses.len()).filter(|&at| uses[at] > 0);
        let extension = Extension::new(placement.extent());
        let rects = wanted.flat_map(|at| {
            prepare::reads(extension, filter, (narrow(at % columns), narrow(at / columns)))
        });
        let again = self.leaves.iter().filter(|_| held == Held::AgainstPixels);
        let again = again.flat_map(|needs| &needs.beneath).cloned();
        let rects: Vec<Rect> = rects.chain(again).collect();
        let mut rasters = Rasters::new(layout, placement, kind, &rects);
        overflow.into_iter().for_each(|overflow| rasters.spill(overflow));
        let rasters = Arc::new(rasters);
        let source = Arc::clone(&rasters) as Arc<dyn Source>;
        let uses_of = |col: u32, row: u32| uses[row as usize * columns + col as usize];
        let beside = match self.resampling.limit {
            RangeLimit::None => Beside::Nothing,
            RangeLimit::Taps => Beside::Pixels,
        };
        let mut prepared = PreparedSource::new(source, filter, beside, uses_of);
        overflow.into_iter().for_each(|overflow| prepared.spill(overflow));
        (rasters, prepared)
    }

    /// What a leaf needs.
    fn needs(&self, leaf: PageAddress) -> &Needs {
        let pyramid = self.grid.pyramid();
        let (_, cols) = pyramid.pages(leaf.level).expect("a leaf is of the finest level");
        &self.leaves[leaf.row as usize * cols as usize + leaf.col as usize]
    }
}

/// All leaves of a grid.
fn leaves(grid: &Grid) -> impl Iterator<Item = PageAddress> + use<> {
    let finest = grid.pyramid().finest();
    let (rows, cols) = grid.pyramid().pages(finest).expect("a pyramid has a finest level");
    (0..rows).flat_map(move |row| (0..cols).map(move |col| PageAddress::new(finest, row, col)))
}

impl Origin for Resampler {
    fn grid(&self) -> &Grid {
        &self.plan.grid
    }

    fn apart(&self) -> Box<dyn Origin> {
        let (plan, layout) = (Arc::clone(&self.plan), self.layout.clone());
        let (heights, held) = (self.heights, self.held);
        let (rasters, prepared) = plan.sources(&layout, self.rasters.kind(), held, None);
        Box::new(Self { plan, layout, rasters, prepared, heights, held })
    }

    fn spill(&mut self, overflow: &Arc<Overflow>) {
        let kind = self.rasters.kind();
        (self.rasters, self.prepared) =
            self.plan.sources(&self.layout, kind, self.held, Some(overflow));
    }

    fn decoded_blocks(&self) -> u64 {
        self.rasters.decoded_blocks()
    }

    fn blocks(&self) -> u64 {
        self.rasters.blocks()
    }

    fn decoded_for(&self, leaves: &[PageAddress]) -> u64 {
        let mut tiles: Vec<PreparedAt> =
            leaves.iter().flat_map(|&leaf| &self.plan.needs(leaf).tiles).copied().collect();
        tiles.sort_unstable();
        tiles.dedup();
        let rects = tiles.iter().flat_map(|tile| self.prepared.reads(tile.col, tile.row));
        self.rasters.pixels_of(&rects.collect::<Vec<_>>())
    }
}

#[cfg(test)]
mod tests;
