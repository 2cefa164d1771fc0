//! Rasters on one grid, and leaves cut from them.
//!
//! Several rasters make a mosaic if they share a projection and a pixel size and lie a whole
//! number of pixels apart ([`Layout`]). Where they overlap the one given last shows, where it has
//! data.

mod layout;
mod leaf;

pub use self::layout::{Layout, MosaicError, Placed};

use std::collections::HashSet;
use std::ops::Range;
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
    /// Column and row of its first pixel in the finest level: the row is negative where the grid
    /// begins farther down.
    col: u32,
    row: i64,
    /// Columns and rows of it up to the end of the grid: all but a column that repeats the first,
    /// and rows below.
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
        let rows = 0..layout.outline().height;
        Self::of_rows(&layout, rows, kind, page_side)
    }

    /// Some rows of a layout, on the grid of its pixels.
    ///
    /// # Errors
    ///
    /// [`MosaicError::Grid`] if they make no grid.
    pub fn of_rows(
        layout: &Layout,
        rows: Range<u32>,
        kind: Kind,
        page_side: u32,
    ) -> Result<Self, MosaicError> {
        let grid = layout.grid_of_rows(rows.clone(), page_side)?;
        let extent = grid.pyramid().extent();
        let part = |Placed { raster, col, row }: &Placed| {
            let (raster, info) = (Arc::clone(raster), raster.info());
            let (col, row) = (*col, i64::from(*row) - i64::from(rows.start));
            let width = info.width.min(extent.width.saturating_sub(col));
            let before_end = (i64::from(extent.height) - row).max(0);
            let height = u32::try_from(before_end).map_or(info.height, |end| info.height.min(end));
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
        let blocks = |part: &Part| {
            let info = part.raster.info();
            let first = u32::try_from(-part.row).unwrap_or(0);
            if first >= part.height {
                return 0;
            }
            let down = (part.height - 1) / info.block_height - first / info.block_height + 1;
            u64::from(info.blocks().0) * u64::from(down)
        };
        self.parts.iter().map(blocks).sum()
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

/// A rectangle of a raster's pixels on the grid; its first rows may be above it.
#[derive(Clone, Copy)]
struct Place {
    col: u32,
    row: i64,
    width: u32,
    height: u32,
}

/// How many leaves look at each block of a raster at `place`.
fn uses(info: &RasterInfo, place: Place, pyramid: &Pyramid) -> impl Fn(u32, u32) -> u32 + use<> {
    let interior = i64::from(pyramid.interior());
    let (block_width, block_height) = (info.block_width, info.block_height);
    let leaves = move |block: u32, length: u32, used: u32, offset: i64| {
        let start = i64::from(block) * i64::from(length);
        let end = (start + i64::from(length)).min(i64::from(used)) + offset;
        let start = (start + offset).max(0);
        if start >= end { 0 } else { (end - 1) / interior - start / interior + 1 }
    };
    move |block_col, block_row| {
        let across = leaves(block_col, block_width, place.width, place.col.into());
        let down = leaves(block_row, block_height, place.height, place.row);
        u32::try_from(across * down).unwrap_or(u32::MAX)
    }
}

#[cfg(test)]
mod tests;
