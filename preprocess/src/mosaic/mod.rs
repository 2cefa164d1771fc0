//! Rasters on one grid: where each lies in it, and leaves cut from them.
//!
//! Several rasters make a mosaic if they share a projection and a pixel size and lie a whole
//! number of pixels apart. Where they overlap the one given last shows, where it has data.

mod leaf;

use std::sync::Arc;

use areoid_formats::grid::{Grid, GridError, Outline};
use areoid_formats::page::Kind;
use areoid_formats::projection::Crs;
use areoid_formats::pyramid::Pyramid;

use crate::raster::{BlockCache, Overflow, Raster, RasterError, RasterInfo};

/// How far a raster may lie off the common grid, in pixels.
const ALIGNMENT_PX: f64 = 1e-3;

/// Why rasters make no dataset.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MosaicError {
    /// No raster at all.
    #[error("no raster to read")]
    Empty,
    /// The outline makes no grid.
    #[error("{} makes no grid", path.display())]
    Grid {
        /// The raster, or the first of several.
        path: std::path::PathBuf,
        /// Why.
        source: GridError,
    },
    /// Rasters that do not share a grid.
    #[error(
        "{} does not lie on the grid of {}: {reason}; resampling is not supported yet",
        other.display(), first.display()
    )]
    OffGrid {
        /// The first raster.
        first: std::path::PathBuf,
        /// The one that differs.
        other: std::path::PathBuf,
        /// In what.
        reason: String,
    },
    /// Rasters of different kinds of samples.
    #[error("{} and {} hold different kinds of samples", first.display(), other.display())]
    OtherSamples {
        /// The first raster.
        first: std::path::PathBuf,
        /// The one that differs.
        other: std::path::PathBuf,
    },
}

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
    ///
    /// # Panics
    ///
    /// Never: without a raster it fails.
    pub fn new(
        rasters: Vec<Arc<dyn Raster>>,
        crs: Crs,
        kind: Kind,
        page_side: u32,
    ) -> Result<Self, MosaicError> {
        let first = Arc::clone(rasters.first().ok_or(MosaicError::Empty)?);
        let first = first.info();
        let [pixel_x, pixel_y] = first.outline.pixel_size;
        let [left, top] = first.outline.origin;

        // Offsets in pixels from the first raster's corner.
        let mut places = Vec::new();
        for raster in &rasters {
            let info = raster.info();
            let off_grid = |reason: String| MosaicError::OffGrid {
                first: first.path.clone(),
                other: info.path.clone(),
                reason,
            };
            if info.crs != first.crs {
                return Err(off_grid("another projection".to_owned()));
            }
            if (info.sample, info.bands) != (first.sample, first.bands)
                || (info.scale, info.offset) != (first.scale, first.offset)
            {
                let (first, other) = (first.path.clone(), info.path.clone());
                return Err(MosaicError::OtherSamples { first, other });
            }
            let [width, height] = info.outline.pixel_size;
            let drift = ((width / pixel_x - 1.0).abs() * f64::from(info.width))
                .max((height / pixel_y - 1.0).abs() * f64::from(info.height));
            let [x, y] = info.outline.origin;
            let (col, row) = ((x - left) / pixel_x, (top - y) / pixel_y);
            let off = (col - col.round()).abs().max((row - row.round()).abs());
            if drift.max(off).is_nan() || drift > ALIGNMENT_PX {
                return Err(off_grid(format!("pixels of {width} x {height}")));
            }
            if off > ALIGNMENT_PX {
                return Err(off_grid(format!("{off:.3} pixels beside it")));
            }
            places.push((col.round(), row.round()));
        }

        let extreme = |values: &mut dyn Iterator<Item = f64>, pick: fn(f64, f64) -> f64| {
            values.reduce(pick).expect("there is a first raster")
        };
        let (least_col, least_row) = (
            extreme(&mut places.iter().map(|place| place.0), f64::min),
            extreme(&mut places.iter().map(|place| place.1), f64::min),
        );
        let ends = || rasters.iter().map(|raster| raster.info()).zip(&places);
        let width = extreme(
            &mut ends().map(|(info, place)| place.0 - least_col + f64::from(info.width)),
            f64::max,
        );
        let height = extreme(
            &mut ends().map(|(info, place)| place.1 - least_row + f64::from(info.height)),
            f64::max,
        );
        let too_large = || MosaicError::OffGrid {
            first: first.path.clone(),
            other: first.path.clone(),
            reason: format!("together they span {width} x {height} pixels"),
        };
        let outline = Outline {
            origin: [left + least_col * pixel_x, top - least_row * pixel_y],
            pixel_size: [pixel_x, pixel_y],
            width: whole(width).ok_or_else(too_large)?,
            height: whole(height).ok_or_else(too_large)?,
        };
        let native = Grid::from_outline(crs, outline, page_side)
            .map_err(|source| MosaicError::Grid { path: first.path.clone(), source })?;

        let grid = native.grid;
        let extent = grid.pyramid().extent();
        let parts = rasters
            .into_iter()
            .zip(places)
            .map(|(raster, (col, row))| {
                let col = whole(col - least_col).ok_or_else(too_large)?;
                let row = whole(row - least_row).ok_or_else(too_large)?;
                let info = raster.info();
                let width = info.width.min(extent.width.saturating_sub(col));
                let height = info.height.min(extent.height.saturating_sub(row));
                let place = Place { col, row, width, height };
                let uses = uses(info, place, grid.pyramid());
                let blocks = BlockCache::new(Arc::clone(&raster), uses);
                Ok(Part { raster, blocks, col, row, width, height })
            })
            .collect::<Result<_, MosaicError>>()?;
        Ok(Self { grid, kind, parts })
    }

    /// The same rasters, decoding blocks of its own, which stay as long as it does.
    #[must_use]
    pub fn apart(&self) -> Self {
        let apart = |part: &Part| {
            let blocks = BlockCache::new(Arc::clone(&part.raster), |_, _| u32::MAX);
            Part { raster: Arc::clone(&part.raster), blocks, ..*part }
        };
        let parts = self.parts.iter().map(apart).collect();
        Self { grid: self.grid.clone(), kind: self.kind, parts }
    }

    /// Gives the blocks of all rasters together a budget: what is beyond it is
    /// set aside.
    ///
    /// # Panics
    ///
    /// If a leaf has been read already.
    pub fn spill(&mut self, overflow: &Arc<Overflow>) {
        self.parts.iter_mut().for_each(|part| part.blocks.spill(Arc::clone(overflow)));
    }

    /// The grid on which the leaves are the rasters' pixels.
    #[must_use]
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Whether the rasters are what they were when they were opened.
    ///
    /// # Errors
    ///
    /// [`RasterError::Modified`] if one was changed since, or [`RasterError::Io`].
    pub fn check_unchanged(&self) -> Result<(), RasterError> {
        self.parts.iter().try_for_each(|part| part.raster.check_unchanged())
    }

    /// Blocks decoded so far: each once.
    #[must_use]
    pub fn decoded_blocks(&self) -> u64 {
        self.parts.iter().map(|part| part.blocks.decoded()).sum()
    }

    /// Blocks of all rasters.
    #[must_use]
    pub fn blocks(&self) -> u64 {
        let blocks = self.parts.iter().map(|part| part.raster.info().blocks());
        blocks.map(|(across, down)| u64::from(across) * u64::from(down)).sum()
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

/// A whole number of pixels that a grid can have.
fn whole(pixels: f64) -> Option<u32> {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "in range")]
    (0.0..=f64::from(u32::MAX)).contains(&pixels).then_some(pixels as u32)
}

#[cfg(test)]
mod tests;
