//! Rasters on one grid, and leaves cut from them.
//!
//! Several rasters make a mosaic if they share a projection and a pixel size and lie a whole
//! number of pixels apart ([`Layout`]). Where they overlap the one given last shows, where it has
//! data.

mod layout;
mod leaf;
mod truth;

pub use self::layout::{Layout, MosaicError, Placed};

use std::collections::HashSet;
use std::sync::Arc;

use areoid_formats::address::PageAddress;
use areoid_formats::grid::Grid;
use areoid_formats::page::Kind;
use areoid_formats::projection::Crs;
use areoid_formats::pyramid::Pyramid;

use crate::once::Overflow;
use crate::origin::Origin;
use crate::raster::{BlockCache, Raster, RasterInfo};

/// Rasters placed on the grid that their pixels share.
#[derive(Debug)]
pub struct Mosaic {
    grid: Grid,
    kind: Kind,
    parts: Vec<Part>,
}

#[derive(Debug)]
struct Part {
    raster: Arc<dyn Raster>,
    blocks: BlockCache,
    /// Column and row of its first pixel in the finest level.
    col: u32,
    row: u32,
    /// Pixels of it that are used: all but a column that repeats the first.
    width: u32,
    height: u32,
}

impl Mosaic {
    /// Places `rasters`, all on `crs`, on the grid of their pixels.
    ///
    /// # Errors
    ///
    /// Any [`MosaicError`].
    pub fn new(
        rasters: Vec<Arc<dyn Raster>>,
        crs: Crs,
        kind: Kind,
        page_side: u32,
    ) -> Result<Self, MosaicError> {
        let layout = Layout::new(rasters, crs)?;
        let native = Grid::from_outline(crs, layout.outline(), page_side).map_err(|source| {
            let path = layout.parts()[0].raster.info().path.clone();
            MosaicError::Grid { path, source }
        })?;
        let grid = native.grid;
        let extent = grid.pyramid().extent();
        let part = |Placed { raster, col, row }: &Placed| {
            let (raster, info) = (Arc::clone(raster), raster.info());
            let (col, row) = (*col, *row);
            let width = info.width.min(extent.width.saturating_sub(col));
            let height = info.height.min(extent.height.saturating_sub(row));
            let uses = uses(info, Place { col, row, width, height }, grid.pyramid());
            Part {
                blocks: BlockCache::new(Arc::clone(&raster), uses),
                raster,
                col,
                row,
                width,
                height,
            }
        };
        let parts = layout.parts().iter().map(part).collect();
        Ok(Self { grid, kind, parts })
    }
}

impl Origin for Mosaic {
    fn grid(&self) -> &Grid {
        &self.grid
    }

    fn apart(&self) -> Box<dyn Origin> {
        let apart = |part: &Part| {
            let blocks = BlockCache::new(Arc::clone(&part.raster), |_, _| u32::MAX);
            Part { raster: Arc::clone(&part.raster), blocks, ..*part }
        };
        let parts = self.parts.iter().map(apart).collect();
        Box::new(Self { grid: self.grid.clone(), kind: self.kind, parts })
    }

    fn spill(&mut self, overflow: &Arc<Overflow>) {
        self.parts.iter_mut().for_each(|part| part.blocks.spill(Arc::clone(overflow)));
    }

    /// Each is decoded once.
    fn decoded_blocks(&self) -> u64 {
        self.parts.iter().map(|part| part.blocks.decoded()).sum()
    }

    fn blocks(&self) -> u64 {
        let blocks = self.parts.iter().map(|part| part.raster.info().blocks());
        blocks.map(|(across, down)| u64::from(across) * u64::from(down)).sum()
    }

    fn decoded_for(&self, leaves: &[PageAddress]) -> u64 {
        let places = leaves.iter().map(|&leaf| Place::of(self.grid.pyramid(), leaf));
        let places: Vec<_> = places.collect();
        let pixels = |part: &Part| {
            let overlaps = places.iter().filter_map(|&place| part.overlap(place));
            let blocks: HashSet<_> = overlaps.flat_map(|at| part.blocks_of(&at)).collect();
            let info = part.raster.info();
            blocks.len() as u64 * u64::from(info.block_width) * u64::from(info.block_height)
        };
        self.parts.iter().map(pixels).sum()
    }
}

/// A rectangle of a raster's pixels on the grid.
#[derive(Clone, Copy)]
struct Place {
    col: u32,
    row: u32,
    width: u32,
    height: u32,
}

/// How many leaves look at each block of a raster at `place`.
fn uses(info: &RasterInfo, place: Place, pyramid: &Pyramid) -> impl Fn(u32, u32) -> u32 + use<> {
    let interior = pyramid.interior();
    let (block_width, block_height) = (info.block_width, info.block_height);
    let leaves = move |start: u32, length: u32, used: u32, offset: u32| {
        let end = (start + length).min(used);
        if start >= end {
            0
        } else {
            (offset + end - 1) / interior - (offset + start) / interior + 1
        }
    };
    move |block_col, block_row| {
        leaves(block_col * block_width, block_width, place.width, place.col)
            * leaves(block_row * block_height, block_height, place.height, place.row)
    }
}

#[cfg(test)]
mod tests;
