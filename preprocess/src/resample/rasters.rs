//! Rasters as what is resampled: pixels by the rectangle, blocks decoded once.

use std::collections::HashSet;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use areoid_formats::grid::Placement;
use areoid_formats::page::Kind;
use areoid_formats::pyramid::Extent;

use super::source::{Pixels, Rect, Source};
use crate::mosaic::{Layout, Placed};
use crate::once::Overflow;
use crate::raster::{BlockCache, Raster, RasterError, Window, colors_into, heights_into};

/// The rasters of a layout, a later one over an earlier one.
#[derive(Debug)]
pub struct Rasters {
    placement: Placement,
    kind: Kind,
    path: PathBuf,
    parts: Vec<Part>,
}

#[derive(Debug)]
struct Part {
    raster: Arc<dyn Raster>,
    blocks: BlockCache,
    cols: Range<u32>,
    rows: Range<u32>,
}

impl Rasters {
    /// The rasters of `layout`, at `placement`; each of `rects` will be read once.
    ///
    /// # Panics
    ///
    /// Never: a layout has a raster.
    #[must_use]
    pub fn new(layout: &Layout, placement: Placement, kind: Kind, rects: &[Rect]) -> Self {
        let part = |placed: &Placed| Part::new(placed, placement, rects);
        let parts = layout.parts().iter().map(part).collect();
        let path = layout.parts()[0].raster.info().path.clone();
        Self { placement, kind, path, parts }
    }

    pub(super) fn spill(&mut self, overflow: &Arc<Overflow>) {
        self.parts.iter_mut().for_each(|part| part.blocks.spill(Arc::clone(overflow)));
    }

    /// Blocks decoded so far.
    #[must_use]
    pub fn decoded_blocks(&self) -> u64 {
        self.parts.iter().map(|part| part.blocks.decoded()).sum()
    }

    /// Bytes of the blocks that are kept now.
    #[cfg(test)]
    pub(super) fn resident_bytes(&self) -> u64 {
        self.parts.iter().map(|part| part.blocks.resident_bytes()).sum()
    }

    /// Blocks of all rasters.
    #[must_use]
    pub fn blocks(&self) -> u64 {
        let blocks = self.parts.iter().map(|part| part.raster.info().blocks());
        blocks.map(|(across, down)| u64::from(across) * u64::from(down)).sum()
    }

    /// Pixels of the blocks that rectangles are read from.
    #[must_use]
    pub fn pixels_of(&self, rects: &[Rect]) -> u64 {
        let pixels = |part: &Part| {
            let shared = rects.iter().filter_map(|rect| part.shared(rect));
            let blocks: HashSet<_> = shared.flat_map(|rect| part.blocks_of(&rect)).collect();
            let info = part.raster.info();
            blocks.len() as u64 * u64::from(info.block_width) * u64::from(info.block_height)
        };
        self.parts.iter().map(pixels).sum()
    }

    /// Whether every pixel is sure to have data.
    pub(super) fn is_solid(&self) -> bool {
        let whole = |part: &Part| {
            let info = part.raster.info();
            let solid = info.nodata.is_none() && !info.has_alpha && !info.sample.is_float();
            solid
                && (part.cols.clone(), part.rows.clone())
                    == (0..self.placement.width, 0..self.placement.height)
        };
        self.parts.iter().any(whole)
    }

    /// Whether heights are whole meters that fit in 16 bits.
    pub(super) fn is_whole(&self) -> bool {
        self.kind == Kind::Height && self.parts.iter().all(|part| part.raster.info().is_whole())
    }

    /// Tells that a rectangle will not be read.
    pub(super) fn pass(&self, rect: &Rect) {
        for part in &self.parts {
            for (col, row) in part.shared(rect).iter().flat_map(|shared| part.blocks_of(shared)) {
                part.blocks.release(col, row);
            }
        }
    }

    pub(super) fn check_unchanged(&self) -> Result<(), RasterError> {
        self.parts.iter().try_for_each(|part| part.raster.check_unchanged())
    }
}

impl Source for Rasters {
    fn extent(&self) -> Extent {
        self.placement.extent()
    }

    fn kind(&self) -> Kind {
        self.kind
    }

    fn path(&self) -> &Path {
        &self.path
    }

    fn read(&self, rect: &Rect, mut pixels: Pixels<'_>, stride: usize) -> Result<(), RasterError> {
        for part in &self.parts {
            let Some(shared) = part.shared(rect) else { continue };
            for (block_col, block_row) in part.blocks_of(&shared) {
                part.lay((block_col, block_row), &shared, rect, &mut pixels, stride)?;
                part.blocks.release(block_col, block_row);
            }
        }
        Ok(())
    }
}

impl Part {
    fn new(placed: &Placed, placement: Placement, rects: &[Rect]) -> Self {
        let (raster, info) = (Arc::clone(&placed.raster), placed.raster.info());
        let cols = placed.col..(placed.col + info.width).min(placement.width);
        let rows = placed.row..(placed.row + info.height).min(placement.height);
        let mut part =
            Self { blocks: BlockCache::new(Arc::clone(&raster), |_, _| 0), raster, cols, rows };
        let (across, down) = part.raster.info().blocks();
        let mut uses = vec![0_u32; across as usize * down as usize];
        for shared in rects.iter().filter_map(|rect| part.shared(rect)) {
            for (col, row) in part.blocks_of(&shared) {
                uses[row as usize * across as usize + col as usize] += 1;
            }
        }
        let uses_of = |col: u32, row: u32| uses[row as usize * across as usize + col as usize];
        part.blocks = BlockCache::new(Arc::clone(&part.raster), uses_of);
        part
    }

    /// What a rectangle has of this raster.
    fn shared(&self, rect: &Rect) -> Option<Rect> {
        let meet = |one: &Range<u32>, other: &Range<u32>| {
            one.start.max(other.start)..one.end.min(other.end)
        };
        let (cols, rows) = (meet(&rect.cols, &self.cols), meet(&rect.rows, &self.rows));
        (!cols.is_empty() && !rows.is_empty()).then_some(Rect { cols, rows })
    }

    /// Columns and rows of the blocks that hold a rectangle inside this raster.
    fn blocks_of(&self, Rect { cols, rows }: &Rect) -> Vec<(u32, u32)> {
        let info = self.raster.info();
        let blocks = |range: &Range<u32>, first: u32, length: u32| {
            (range.start - first) / length..=(range.end - 1 - first) / length
        };
        let across = blocks(cols, self.cols.start, info.block_width);
        let down = blocks(rows, self.rows.start, info.block_height);
        down.flat_map(|row| across.clone().map(move |col| (col, row))).collect()
    }

    /// Lays what a block has of `shared` over planes that begin at the corner of `rect`.
    fn lay(
        &self,
        (block_col, block_row): (u32, u32),
        shared: &Rect,
        rect: &Rect,
        pixels: &mut Pixels<'_>,
        stride: usize,
    ) -> Result<(), RasterError> {
        let info = self.raster.info();
        let block = self.blocks.get(block_col, block_row)?;
        let whole = Window::of(&block);
        let own = |range: &Range<u32>, first: u32, whole: &Range<u32>| {
            (range.start - first).max(whole.start)..(range.end - first).min(whole.end)
        };
        let window = Window {
            cols: own(&shared.cols, self.cols.start, &whole.cols),
            rows: own(&shared.rows, self.rows.start, &whole.rows),
        };
        let row = (window.rows.start + self.rows.start - rect.rows.start) as usize;
        let at = row * stride + (window.cols.start + self.cols.start - rect.cols.start) as usize;
        match pixels {
            Pixels::Heights(heights) => {
                heights_into(&block, info, &window, &mut heights[at..], stride);
            }
            Pixels::Colors { planes, alpha } => {
                let planes = planes.each_mut().map(|plane| &mut plane[at..]);
                colors_into(&block, info, &window, planes, Some(&mut alpha[at..]), stride)?;
            }
        }
        Ok(())
    }
}
