//! A leaf of the target, tile by tile.

use std::cell::RefCell;

use areoid_formats::address::PageAddress;
use areoid_formats::lanes::{self, Wide, vectorized};
use areoid_formats::page::Kind;
use areoid_formats::pyramid::PoleContact;

use super::error;
use super::fit::fit;
use super::kernel::{Sampled, Scratch};
use super::needs::{PreparedAt, texels_around};
use super::source::Source as _;
use super::tile::{Coords, TargetTile};
use super::window::Window;
use super::{Heights, Held, Resampler, Texels};
use crate::build::Leaves;
use crate::raster::RasterError;
use crate::texel::Planes;
use crate::tile::{self, Closed, Raw};

/// Memory that leaves use again.
#[derive(Debug, Default)]
struct Room {
    coords: Coords,
    window: Window,
    scratch: Scratch,
    sampled: Sampled,
    /// Those of a canvas.
    planes: Vec<Vec<f32>>,
}

/// Texels of a leaf, in a page's layout.
struct Canvas {
    side: usize,
    /// Meters, or amounts of light: anything where nothing is valid.
    planes: Vec<Vec<f32>>,
    alpha: Vec<u8>,
}

impl Leaves for Resampler {
    fn read(&self, page: PageAddress) -> Result<Option<Raw>, RasterError> {
        thread_local! {
            static ROOM: RefCell<Room> = RefCell::default();
        }
        let named = &self.plan.needs(page).tiles;
        // Ranges that are estimates may say of parts what they do not of the whole.
        if named.is_empty() {
            return Ok(None);
        }
        ROOM.with_borrow_mut(|room| {
            let canvas = self.canvas(page, room);
            self.release(named);
            let Some(mut canvas) = canvas? else { return Ok(None) };
            if !canvas.is_finite() {
                let found = "heights so large that what lies between them is not finite";
                let supported = "heights up to a tenth of the largest 32-bit number";
                return Err(RasterError::not_supported(self.rasters.path(), found, supported));
            }
            let raw = self.raw(page, &mut canvas);
            room.planes = canvas.planes;
            Ok(raw)
        })
    }

    fn skip(&self, page: PageAddress) {
        self.release(&self.plan.needs(page).tiles);
    }

    fn source_error(
        &self,
        page: PageAddress,
        leaf: Option<&Closed<'_>>,
    ) -> Result<Option<f32>, RasterError> {
        if self.held == Held::AgainstNothing {
            return Ok(None);
        }
        let rects = &self.plan.needs(page).beneath;
        let Some(leaf) = leaf else {
            rects.iter().for_each(|rect| self.rasters.pass(rect));
            return Ok(None);
        };
        let (back, pyramid) = (&self.plan.back, self.plan.grid.pyramid());
        let found = error::source_error(back, &*self.rasters, pyramid, page, leaf, rects);
        found.map(Some)
    }

    fn check_unchanged(&self) -> Result<(), RasterError> {
        self.rasters.check_unchanged()
    }

    fn may_have_holes(&self) -> bool {
        let source = self.plan.transform.source();
        let global = ![source.north, source.south].contains(&PoleContact::None);
        !(self.rasters.is_solid() && global)
    }

    fn is_whole(&self) -> bool {
        self.heights == Heights::Rounded && self.rasters.is_whole()
    }
}

impl Resampler {
    fn release(&self, named: &[PreparedAt]) {
        for tile in named {
            if self.prepared.release(tile.col, tile.row) {
                let rects = self.prepared.reads(tile.col, tile.row);
                rects.into_iter().for_each(|rect| self.rasters.pass(&rect));
            }
        }
    }

    /// The texels of a leaf; `None` if none can be valid.
    fn canvas(&self, page: PageAddress, room: &mut Room) -> Result<Option<Canvas>, RasterError> {
        let pyramid = self.plan.grid.pyramid();
        let side = pyramid.page_side() as usize;
        let texels = self.plan.resampling.texels;
        let (rows, cols) = texels_around(pyramid, page, texels.around());
        let [top, left] = [page.row, page.col].map(|at| i64::from(at * pyramid.interior()) - 1);
        let channels = self.prepared.channels();
        let mut canvas: Option<Canvas> = None;
        let named = &self.plan.needs(page).tiles;
        for tile in self.plan.transform.tiles(rows, cols) {
            if !self.sample(tile, named, room)? {
                continue;
            }
            let canvas = canvas.get_or_insert_with(|| {
                let mut planes = std::mem::take(&mut room.planes);
                planes.resize_with(channels, Vec::new);
                planes.iter_mut().for_each(|plane| plane.resize(side * side, 0.0));
                Canvas { side, planes, alpha: vec![0; side * side] }
            });
            let [row, col] = [tile.row - top, tile.col - left]
                .map(|at| usize::try_from(at).expect("tiles lie in the leaf or around it"));
            canvas.lay(row * side + col, tile, &room.sampled);
        }
        if let (Texels::Fitted, Some(canvas)) = (texels, &mut canvas) {
            let (rows, cols) = pyramid.interior_size(page);
            canvas.fit(rows as usize, cols as usize);
        }
        Ok(canvas)
    }

    /// Samples a tile into the room; false if none of its texels can be valid.
    fn sample(
        &self,
        tile: TargetTile,
        named: &[PreparedAt],
        room: &mut Room,
    ) -> Result<bool, RasterError> {
        let Room { coords, window, scratch, sampled, .. } = room;
        if self.plan.transform.range(tile).is_none() {
            return Ok(false);
        }
        let footprint = self.plan.transform.coords(tile, coords);
        let kernel = self.plan.resampling.kernel;
        // Of estimates, those of parts may miss what that of the whole has.
        let estimated = !self.plan.transform.ranges_are_bounds();
        let wanted = |tile: PreparedAt| estimated || named.binary_search(&tile).is_ok();
        let reach = kernel.reach(footprint);
        if !window.assemble(&self.prepared, coords.range, reach, wanted)? {
            return Ok(false);
        }
        kernel.sample(self.plan.resampling.limit, coords, footprint, window, scratch, sampled);
        Ok(true)
    }

    /// A leaf as a build takes it; `None` if nothing in it is valid.
    fn raw(&self, page: PageAddress, canvas: &mut Canvas) -> Option<Raw> {
        let Canvas { side, planes, alpha } = canvas;
        let (rows, cols) = self.plan.grid.pyramid().interior_size(page);
        let inside = alpha.chunks_exact(*side).skip(1).take(rows as usize);
        let (least, greatest) =
            inside.fold((u8::MAX, 0), |found, row| lanes::extremes(&row[1..=cols as usize], found));
        if greatest == 0 {
            return None;
        }
        let planes = match self.rasters.kind() {
            Kind::Height if self.is_whole() => Planes::WholeHeight(whole(&planes[0], alpha)),
            Kind::Height => {
                for (height, &code) in planes[0].iter_mut().zip(&*alpha) {
                    *height = if code == 0 { f32::NAN } else { *height };
                }
                Planes::Height(planes.swap_remove(0))
            }
            Kind::Color | Kind::Normal => Planes::Color(std::array::from_fn(|channel| {
                let light = planes[channel].iter().zip(&*alpha);
                light
                    .map(|(&light, &code)| if code == 0 { 0 } else { crate::texel::code(light) })
                    .collect()
            })),
        };
        Some(Raw { planes, alpha: (least < u8::MAX).then(|| std::mem::take(alpha)) })
    }
}

impl Canvas {
    /// Whether all that is valid is finite.
    fn is_finite(&self) -> bool {
        // Many at a time become vectors.
        const TOGETHER: usize = 256;
        let off = |values: &[f32], alpha: &[u8]| {
            let texels = values.iter().zip(alpha);
            texels.fold(false, |off, (value, &code)| off | ((code != 0) & !value.is_finite()))
        };
        let chunks = |plane: &Vec<f32>| {
            let mut chunks = plane.chunks(TOGETHER).zip(self.alpha.chunks(TOGETHER));
            chunks.any(|(values, alpha)| off(values, alpha))
        };
        !self.planes.iter().any(chunks)
    }

    /// Fits what is inside the border, and takes the border's coverage away.
    fn fit(&mut self, rows: usize, cols: usize) {
        let Self { side, planes, alpha } = self;
        for plane in planes {
            fit(plane, alpha, *side, (rows, cols));
        }
        for (row, part) in tile::outside((*side, rows, cols)) {
            alpha[row * *side..][part].fill(0);
        }
    }

    fn lay(&mut self, at: usize, tile: TargetTile, sampled: &Sampled) {
        let lines = |row: usize| {
            (
                at + row * self.side..at + row * self.side + tile.cols,
                row * tile.cols..(row + 1) * tile.cols,
            )
        };
        for row in 0..tile.rows {
            let (to, from) = lines(row);
            for (plane, texels) in self.planes.iter_mut().zip(&sampled.planes) {
                plane[to.clone()].copy_from_slice(&texels[from.clone()]);
            }
            match &sampled.alpha {
                Some(alpha) => self.alpha[to].copy_from_slice(&alpha[from]),
                None => self.alpha[to].fill(u8::MAX),
            }
        }
    }
}

/// Heights rounded to whole meters, ties to even; 0 where invalid.
fn whole(heights: &[f32], alpha: &[u8]) -> Vec<i16> {
    let mut rounded = vec![0; heights.len()];
    vectorized(Whole { heights, alpha, rounded: &mut rounded });
    rounded
}

struct Whole<'a> {
    heights: &'a [f32],
    alpha: &'a [u8],
    rounded: &'a mut [i16],
}

impl Wide for Whole<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        /// Sums with it are whole, ties to even: `round_ties_even` is a call where vectors are not
        /// known to have it.
        const WHOLE: f32 = 1.5 * (1_u32 << 23) as f32;
        let (least, most) = (f32::from(i16::MIN), f32::from(i16::MAX));
        let places = self.rounded.iter_mut().zip(self.heights).zip(self.alpha);
        for ((rounded, &height), &code) in places {
            let shifted = lanes::least(lanes::greatest(height, least), most) + WHOLE;
            #[expect(clippy::cast_possible_truncation, reason = "the low bits are the number")]
            let low = shifted.to_bits() as u16;
            *rounded = if code == 0 { 0 } else { low.cast_signed() };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heights_are_rounded_to_the_nearest_meter_within_16_bits() {
        let eighths = -8 * 40_000..=8 * 40_000;
        let heights: Vec<f32> = eighths.map(|eighth| eighth as f32 / 8.0).collect();
        let alpha: Vec<u8> = (0..heights.len()).map(|at| u8::from(at % 5 != 0)).collect();
        for ((&height, &code), &found) in heights.iter().zip(&alpha).zip(&whole(&heights, &alpha)) {
            let expected = height.round_ties_even().clamp(-32_768.0, 32_767.0);
            assert_eq!(f32::from(found), if code == 0 { 0.0 } else { expected }, "{height}");
        }
    }
}
