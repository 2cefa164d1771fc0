//! Leaves cut from the rasters of a mosaic.

use std::ops::Range;

use areoid_formats::address::PageAddress;
use areoid_formats::page::Kind;
use areoid_formats::pyramid::Pyramid;

use super::{Mosaic, Part, Place};
use crate::build::Leaves;
use crate::raster::{Filled, RasterError, Window, colors_into, heights_into, whole_heights_into};
use crate::texel::Planes;
use crate::tile::Raw;

impl Leaves for Mosaic {
    fn read(&self, page: PageAddress) -> Result<Option<Raw>, RasterError> {
        let pyramid = self.grid.pyramid();
        let place = Place::of(pyramid, page);
        let overlaps = self.parts.iter().map(|part| (part, part.overlap(place)));
        let overlaps: Vec<_> = overlaps.filter_map(|(part, at)| Some((part, at?))).collect();
        if overlaps.is_empty() {
            return Ok(None);
        }
        let side = pyramid.page_side() as usize;
        let solid =
            |(part, overlap): &(&Part, Overlap)| part.is_solid() && overlap.len() == place.len();
        // Other alpha than opaque and none comes from rasters that have it.
        let hazy = |(part, _): &(&Part, Overlap)| part.raster.info().has_alpha;
        let covered = overlaps.iter().any(solid) && !overlaps.iter().any(hazy);
        let mut raw = self.blank(side, covered);
        let mut is_opaque = false;
        for (part, overlap) in overlaps {
            let filled = part.read_into(&mut raw, side, place, &overlap)?;
            let covers = overlap.len() == place.len();
            // A translucent texel over an opaque one is translucent.
            is_opaque = match filled {
                Filled::All => is_opaque || covers,
                Filled::Part => false,
                Filled::Nothing => is_opaque,
            };
        }
        if is_opaque {
            raw.alpha = None;
            return Ok(Some(raw));
        }
        Ok(settled(raw, side, place))
    }

    fn skip(&self, page: PageAddress) {
        let place = Place::of(self.grid.pyramid(), page);
        for part in &self.parts {
            for (col, row) in part.overlap(place).iter().flat_map(|overlap| part.blocks_of(overlap))
            {
                part.blocks.release(col, row);
            }
        }
    }

    fn check_unchanged(&self) -> Result<(), RasterError> {
        self.parts.iter().try_for_each(|part| part.raster.check_unchanged())
    }

    fn is_whole(&self) -> bool {
        self.kind == Kind::Height && self.parts.iter().all(|part| part.raster.info().is_whole())
    }

    fn may_have_holes(&self) -> bool {
        let extent = self.grid.pyramid().extent();
        let whole = |part: &Part| {
            let last = part.row + i64::from(part.height);
            let all_rows = part.row <= 0 && last >= i64::from(extent.height);
            all_rows && (part.col, part.width) == (0, extent.width) && part.is_solid()
        };
        !self.parts.iter().any(whole)
    }
}

impl Mosaic {
    /// A leaf without data; `covered` if there will be data everywhere.
    fn blank(&self, side: usize, covered: bool) -> Raw {
        let plane = || vec![0; side * side];
        match self.kind {
            Kind::Height if self.is_whole() => Raw {
                planes: Planes::WholeHeight(vec![0; side * side]),
                alpha: (!covered).then(plane),
            },
            Kind::Height => {
                // Zeros come without being written; what stands for no data must be.
                let blank = if covered { 0.0 } else { f32::NAN };
                Raw { planes: Planes::Height(vec![blank; side * side]), alpha: None }
            }
            Kind::Color | Kind::Normal => {
                let planes = Planes::Color([plane(), plane(), plane()]);
                Raw { planes, alpha: (!covered).then(plane) }
            }
        }
    }
}

/// A leaf with what alpha it needs; `None` if nothing is valid.
fn settled(mut raw: Raw, side: usize, place: Place) -> Option<Raw> {
    let alpha = raw.alpha.take().unwrap_or_else(|| match &raw.planes {
        Planes::Height(heights) => {
            heights.iter().map(|height| if height.is_nan() { 0 } else { u8::MAX }).collect()
        }
        Planes::WholeHeight(_) | Planes::Color(_) => vec![u8::MAX; side * side],
    });
    let rows = alpha.chunks_exact(side).skip(1).take(place.height as usize);
    let inside = rows.flat_map(|row| &row[1..=place.width as usize]);
    let (least, greatest) = inside
        .fold((u8::MAX, 0), |(least, greatest), &alpha| (alpha.min(least), alpha.max(greatest)));
    raw.alpha = (least < u8::MAX).then_some(alpha);
    (greatest > 0).then_some(raw)
}

impl Place {
    /// Where a leaf's interior lies on the grid.
    pub(super) fn of(pyramid: &Pyramid, page: PageAddress) -> Self {
        let (height, width) = pyramid.interior_size(page);
        let interior = pyramid.interior();
        let row = i64::from(page.row * interior);
        Self { col: page.col * interior, row, width, height }
    }

    fn len(self) -> usize {
        self.width as usize * self.height as usize
    }
}

/// What a raster and a leaf share.
pub(super) struct Overlap {
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
    /// Whether every pixel is sure to have data.
    fn is_solid(&self) -> bool {
        let info = self.raster.info();
        info.nodata.is_none() && !info.has_alpha && !info.sample.is_float()
    }

    pub(super) fn overlap(&self, leaf: Place) -> Option<Overlap> {
        let shared = |leaf: i64, length: u32, part: i64, used: u32| {
            let start = (leaf - part).max(0);
            let end = (leaf + i64::from(length) - part).min(used.into());
            let range = u32::try_from(start).ok()?..u32::try_from(end).ok()?;
            (!range.is_empty()).then_some(range)
        };
        let rows = shared(leaf.row, leaf.height, self.row, self.height)?;
        let cols = shared(leaf.col.into(), leaf.width, self.col.into(), self.width)?;
        Some(Overlap { cols, rows })
    }

    /// Columns and rows of the blocks that hold what is shared.
    pub(super) fn blocks_of(&self, Overlap { cols, rows }: &Overlap) -> Vec<(u32, u32)> {
        let info = self.raster.info();
        let down = rows.start / info.block_height..=(rows.end - 1) / info.block_height;
        let across = cols.start / info.block_width..=(cols.end - 1) / info.block_width;
        down.flat_map(|row| across.clone().map(move |col| (col, row))).collect()
    }

    /// Lays this raster's pixels over the leaf at `place`, in pages of `side` texels, where it has
    /// data.
    fn read_into(
        &self,
        raw: &mut Raw,
        side: usize,
        place: Place,
        overlap: &Overlap,
    ) -> Result<Filled, RasterError> {
        let info = self.raster.info();
        let Overlap { cols, rows } = overlap;
        let mut all: Option<Filled> = None;
        for (block_col, block_row) in self.blocks_of(overlap) {
            let block = self.blocks.get(block_col, block_row)?;
            let whole = Window::of(&block);
            let window = Window {
                cols: whole.cols.start.max(cols.start)..whole.cols.end.min(cols.end),
                rows: whole.rows.start.max(rows.start)..whole.rows.end.min(rows.end),
            };
            let border = i64::from(Pyramid::BORDER);
            let to_row = self.row + i64::from(window.rows.start) - place.row + border;
            let to_col = (self.col + window.cols.start - place.col + Pyramid::BORDER) as usize;
            let to_row = usize::try_from(to_row).expect("a row of the leaf");
            let at = to_row * side + to_col;
            let filled = match &mut raw.planes {
                Planes::Height(out) => heights_into(&block, info, &window, &mut out[at..], side),
                Planes::WholeHeight(out) => {
                    let alpha = raw.alpha.as_mut().map(|alpha| &mut alpha[at..]);
                    whole_heights_into(&block, info, &window, &mut out[at..], alpha, side)?
                }
                Planes::Color(planes) => {
                    let planes = planes.each_mut().map(|plane| &mut plane[at..]);
                    let alpha = raw.alpha.as_mut().map(|alpha| &mut alpha[at..]);
                    colors_into(&block, info, &window, planes, alpha, side)?
                }
            };
            all = Some(match all {
                Some(before) if before != filled => Filled::Part,
                _ => filled,
            });
            drop(block);
            self.blocks.release(block_col, block_row);
        }
        Ok(all.unwrap_or(Filled::Nothing))
    }
}
