//! Leaves of any grid from rasters on any other.
//!
//! ```text
//!   target tile ─▶ transform ─▶ coords ─┐
//!   blocks ─▶ prepared tiles ─▶ window ─┴─▶ kernel ─▶ texels
//!   (decoded)  (filled, filtered)
//! ```

pub mod tile;

pub mod transform;

pub mod needs;

pub mod target;

pub mod extension;
pub mod source;

pub mod prepare;

pub mod window;

pub mod kernel;

pub mod rasters;

mod leaf;

use std::sync::Arc;

use areoid_formats::address::PageAddress;
use areoid_formats::grid::{Grid, Placement};
use areoid_formats::page::Kind;

use self::extension::Extension;
use self::kernel::{Kernel, RangeLimit};
use self::needs::{PreparedAt, prepared_tiles};
use self::prepare::{Beside, PreparedSource};
use self::rasters::Rasters;
use self::source::Source;
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
}

/// Rasters that cannot be resampled to a grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the grid shows another body than the rasters")]
pub struct OtherBody;

/// Leaves of a grid, resampled from rasters on another.
#[derive(Debug)]
pub struct Resampler {
    grid: Grid,
    resampling: Resampling,
    layout: Layout,
    rasters: Arc<Rasters>,
    transform: Transform,
    prepared: PreparedSource,
    heights: Heights,
}

/// What becomes of heights between whole meters, where the source has none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Heights {
    Rounded,
    AsTheyAre,
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
        let transform = Transform::new(&grid, &placement, resampling.precision).ok_or(OtherBody)?;
        let (rasters, prepared) = sources(&layout, kind, &transform, resampling, None);
        let heights = Heights::Rounded;
        Ok(Self { grid, resampling, layout, rasters, transform, prepared, heights })
    }

    /// The same with heights that are not rounded to whole meters where those of the rasters are: for
    /// what is derived from them.
    #[must_use]
    pub fn unrounded(self) -> Self {
        Self { heights: Heights::AsTheyAre, ..self }
    }

    /// How often a prepared tile was made, and how many there are.
    #[must_use]
    pub fn prepared_tiles(&self) -> (u64, u64) {
        let (cols, rows) = self.prepared.tiles();
        (self.prepared.made(), u64::from(cols) * u64::from(rows))
    }
}

/// What leaves are sampled from, with their uses announced and what waits in memory limited.
fn sources(
    layout: &Layout,
    kind: Kind,
    transform: &Transform,
    resampling: Resampling,
    overflow: Option<&Arc<Overflow>>,
) -> (Arc<Rasters>, PreparedSource) {
    let (placement, filter) = (*transform.source(), resampling.kernel.filter());
    let named =
        leaves(transform.target()).flat_map(|leaf| named(transform, leaf, resampling.kernel));
    let uses = needs::uses(&placement, named);
    let columns = placement.width.div_ceil(prepare::PREPARED) as usize;
    let narrow = |index: usize| u32::try_from(index).expect("tiles of a raster");
    let wanted = (0..uses.len()).filter(|&at| uses[at] > 0);
    let extension = Extension::new(placement.extent());
    let rects = wanted.flat_map(|at| {
        prepare::reads(extension, filter, (narrow(at % columns), narrow(at / columns)))
    });
    let mut rasters = Rasters::new(layout, placement, kind, &rects.collect::<Vec<_>>());
    overflow.into_iter().for_each(|overflow| rasters.spill(overflow));
    let rasters = Arc::new(rasters);
    let source = Arc::clone(&rasters) as Arc<dyn Source>;
    let uses_of = |col: u32, row: u32| uses[row as usize * columns + col as usize];
    let beside = match resampling.limit {
        RangeLimit::None => Beside::Nothing,
        RangeLimit::Taps => Beside::Pixels,
    };
    let mut prepared = PreparedSource::new(source, filter, beside, uses_of);
    overflow.into_iter().for_each(|overflow| prepared.spill(overflow));
    (rasters, prepared)
}

/// All leaves of a grid.
fn leaves(grid: &Grid) -> impl Iterator<Item = PageAddress> + use<> {
    let finest = grid.pyramid().finest();
    let (rows, cols) = grid.pyramid().pages(finest).expect("a pyramid has a finest level");
    (0..rows).flat_map(move |row| (0..cols).map(move |col| PageAddress::new(finest, row, col)))
}

/// The prepared tiles that a leaf announces.
fn named(transform: &Transform, leaf: PageAddress, kernel: Kernel) -> Vec<PreparedAt> {
    prepared_tiles(transform, leaf, |footprint: Footprint| {
        let [across, down] = kernel.reach(footprint);
        [across - 1, across, down - 1, down]
    })
}

impl Origin for Resampler {
    fn grid(&self) -> &Grid {
        &self.grid
    }

    fn apart(&self) -> Box<dyn Origin> {
        let made = Self::new(
            self.grid.clone(),
            self.layout.clone(),
            *self.transform.source(),
            self.rasters.kind(),
            self.resampling,
        );
        Box::new(Self { heights: self.heights, ..made.expect("the same bodies as before") })
    }

    fn spill(&mut self, overflow: &Arc<Overflow>) {
        let kind = self.rasters.kind();
        (self.rasters, self.prepared) =
            sources(&self.layout, kind, &self.transform, self.resampling, Some(overflow));
    }

    fn decoded_blocks(&self) -> u64 {
        self.rasters.decoded_blocks()
    }

    fn blocks(&self) -> u64 {
        self.rasters.blocks()
    }

    fn decoded_for(&self, leaves: &[PageAddress]) -> u64 {
        let kernel = self.resampling.kernel;
        let mut tiles: Vec<PreparedAt> =
            leaves.iter().flat_map(|&leaf| named(&self.transform, leaf, kernel)).collect();
        tiles.sort_unstable();
        tiles.dedup();
        let rects = tiles.iter().flat_map(|tile| self.prepared.reads(tile.col, tile.row));
        self.rasters.pixels_of(&rects.collect::<Vec<_>>())
    }
}

#[cfg(test)]
mod tests;
