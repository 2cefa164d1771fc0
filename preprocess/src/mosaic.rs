//! Rasters on one grid: where each lies in it, and leaves cut from them.
//!
//! Several rasters make a mosaic if they share a projection and a pixel size and lie a whole
//! number of pixels apart. Where they overlap the one given last shows, where it has data.

use std::ops::Range;
use std::sync::Arc;

use areoid_formats::address::PageAddress;
use areoid_formats::grid::{Grid, GridError, Outline};
use areoid_formats::page::Kind;
use areoid_formats::projection::Crs;
use areoid_formats::pyramid::Pyramid;

use crate::build::Leaves;
use crate::raster::{
    BlockCache, Filled, Overflow, Raster, RasterError, RasterInfo, Window, colors_into,
    heights_into,
};
use crate::tile::Raw;

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

    /// The mosaic with a budget for the blocks of all its rasters together: what is beyond it is
    /// set aside.
    ///
    /// # Panics
    ///
    /// If a leaf has been read already.
    #[must_use]
    pub fn spilling(mut self, overflow: &Arc<Overflow>) -> Self {
        let spilling = |part: Part| {
            let blocks = part.blocks.spilling(Arc::clone(overflow));
            Part { blocks, ..part }
        };
        self.parts = self.parts.into_iter().map(spilling).collect();
        self
    }

    /// The grid on which the leaves are the rasters' pixels.
    #[must_use]
    pub fn grid(&self) -> &Grid {
        &self.grid
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

/// A leaf's interior as its rasters have it, cut at the outline.
#[derive(Debug)]
struct Leaf {
    rows: usize,
    cols: usize,
    planes: Planes,
    /// Alpha beside each texel, or `None` where all are opaque and valid. 0 is invalid.
    alpha: Option<Vec<u8>>,
}

/// Texels in the type that the rasters have.
#[derive(Debug)]
enum Planes {
    /// NaN where invalid.
    Height(Vec<f32>),
    /// 0 where invalid.
    Color([Vec<u8>; 3]),
}

impl Mosaic {
    /// The leaf of `page`; `None` if no raster has data in it.
    fn read_planes(&self, page: PageAddress) -> Result<Option<Leaf>, RasterError> {
        let pyramid = self.grid.pyramid();
        let (rows, cols) = pyramid.interior_size(page);
        let place = Place {
            col: page.col * pyramid.interior(),
            row: page.row * pyramid.interior(),
            width: cols,
            height: rows,
        };
        let overlaps = self.parts.iter().map(|part| (part, part.overlap(place)));
        let overlaps: Vec<_> = overlaps.filter_map(|(part, at)| Some((part, at?))).collect();
        if overlaps.is_empty() {
            return Ok(None);
        }
        let count = rows as usize * cols as usize;
        let (planes, alpha) = match self.kind {
            Kind::Height => (Planes::Height(vec![f32::NAN; count]), None),
            Kind::Color | Kind::Normal => {
                (Planes::Color(std::array::from_fn(|_| vec![0; count])), Some(vec![0; count]))
            }
        };
        let mut leaf = Leaf { rows: rows as usize, cols: cols as usize, planes, alpha };
        let mut is_opaque = false;
        for (part, overlap) in overlaps {
            let filled = part.read_into(&mut leaf, place, &overlap)?;
            let covers = overlap.len() == count;
            // A translucent texel over an opaque one is translucent.
            is_opaque = match filled {
                Filled::All => is_opaque || covers,
                Filled::Part => false,
                Filled::Nothing => is_opaque,
            };
        }
        if is_opaque {
            leaf.alpha = None;
            return Ok(Some(leaf));
        }
        Ok(leaf.settled())
    }
}

impl Leaf {
    /// The leaf with what alpha it needs; `None` if nothing is valid.
    fn settled(mut self) -> Option<Self> {
        let alpha = self.alpha.take().unwrap_or_else(|| match &self.planes {
            Planes::Height(heights) => {
                heights.iter().map(|height| if height.is_nan() { 0 } else { u8::MAX }).collect()
            }
            Planes::Color([red, ..]) => vec![u8::MAX; red.len()],
        });
        let (least, greatest) = alpha.iter().fold((u8::MAX, 0), |(least, greatest), &alpha| {
            (alpha.min(least), alpha.max(greatest))
        });
        self.alpha = (least < u8::MAX).then_some(alpha);
        (greatest > 0).then_some(self)
    }
}

impl Leaves for Mosaic {
    fn read(&self, page: PageAddress) -> Result<Option<Raw>, RasterError> {
        let Some(Leaf { rows, cols, planes, alpha }) = self.read_planes(page)? else {
            return Ok(None);
        };
        let planes = match planes {
            Planes::Height(heights) => vec![heights],
            Planes::Color(planes) => {
                let texel = |(at, &code): (usize, &u8)| match &alpha {
                    Some(alpha) if alpha[at] == 0 => f32::NAN,
                    _ => f32::from(code),
                };
                planes.map(|codes| codes.iter().enumerate().map(texel).collect()).into()
            }
        };
        Ok(Some(Raw { rows, cols, planes, alpha }))
    }
}

/// What a raster and a leaf share.
struct Overlap {
    /// In the raster's own pixels.
    cols: Range<u32>,
    rows: Range<u32>,
}

impl Overlap {
    fn len(&self) -> usize {
        self.cols.len() * self.rows.len()
    }
}

impl Part {
    fn overlap(&self, leaf: Place) -> Option<Overlap> {
        let shared = |leaf: u32, length: u32, part: u32, used: u32| {
            let start = leaf.saturating_sub(part);
            let end = (leaf + length).saturating_sub(part).min(used);
            (start < end).then_some(start..end)
        };
        let rows = shared(leaf.row, leaf.height, self.row, self.height)?;
        let cols = shared(leaf.col, leaf.width, self.col, self.width)?;
        Some(Overlap { cols, rows })
    }

    /// Lays this raster's pixels over the leaf at `place`, where it has data.
    fn read_into(
        &self,
        leaf: &mut Leaf,
        place: Place,
        Overlap { cols, rows }: &Overlap,
    ) -> Result<Filled, RasterError> {
        let info = self.raster.info();
        let mut all: Option<Filled> = None;
        for block_row in rows.start / info.block_height..=(rows.end - 1) / info.block_height {
            for block_col in cols.start / info.block_width..=(cols.end - 1) / info.block_width {
                let block = self.blocks.get(block_col, block_row)?;
                let whole = Window::of(&block);
                let window = Window {
                    cols: whole.cols.start.max(cols.start)..whole.cols.end.min(cols.end),
                    rows: whole.rows.start.max(rows.start)..whole.rows.end.min(rows.end),
                };
                let to_row = (self.row + window.rows.start - place.row) as usize;
                let to_col = (self.col + window.cols.start - place.col) as usize;
                let (at, stride) = (to_row * leaf.cols + to_col, leaf.cols);
                let filled = match &mut leaf.planes {
                    Planes::Height(out) => {
                        heights_into(&block, info, &window, &mut out[at..], stride)
                    }
                    Planes::Color(planes) => {
                        let planes = planes.each_mut().map(|plane| &mut plane[at..]);
                        let alpha = leaf.alpha.as_mut().expect("colors are read with their alpha");
                        colors_into(&block, info, &window, planes, &mut alpha[at..], stride)?
                    }
                };
                all = Some(match all {
                    Some(before) if before != filled => Filled::Part,
                    _ => filled,
                });
                drop(block);
                self.blocks.release(block_col, block_row);
            }
        }
        Ok(all.unwrap_or(Filled::Nothing))
    }
}

#[cfg(test)]
mod tests;
