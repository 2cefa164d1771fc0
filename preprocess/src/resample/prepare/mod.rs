//! Squares of a source made ready for kernels, each once.
//!
//! ```text
//!   blocks ─▶ read, with a halo from past the edges, too ─▶ fill holes ─▶ prefilter ─▶ the core
//!                                                            (masked)      (splines)     is kept
//! ```
//!
//! Heights become f32 meters, colors f32 amounts of light. What stood in a hole is nowhere
//! afterward; what stands there now, a mask hides from all but the taps of kernels.

mod guess;

mod fill;
mod prefilter;
mod tile;

use std::sync::{Arc, Mutex, PoisonError};

use areoid_formats::lanes;
use areoid_formats::page::Kind;

use super::extension::{Extension, Run};
use super::source::{Pixels, Rect, Source};
use crate::once::{OnceCache, OnceError, Overflow};
use crate::raster::RasterError;
use crate::texel;

pub use self::tile::Prepared;

/// Source pixels along a side of a prepared tile; the last of a row or column may be smaller.
pub const PREPARED: u32 = 256;

/// What a kernel wants of its taps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filter {
    /// The pixels themselves.
    Pixels {
        /// How many pixels before and after a texel its taps reach.
        reach: u32,
    },
    /// Coefficients of the cubic spline through them.
    CubicSpline,
    /// Coefficients of the quintic spline through them.
    QuinticSpline,
}

impl Filter {
    /// Pixels around a tile that what is made of it depends on.
    ///
    /// # Precision
    ///
    /// Of what lies beyond, less than 2^-30 arrives in a tile.
    #[must_use]
    pub fn halo(self) -> u32 {
        match self {
            Self::Pixels { reach: 0 } => 0,
            Self::Pixels { reach } => reach + 1,
            Self::CubicSpline => 16,
            Self::QuinticSpline => 26,
        }
    }

    /// Rings of a hole that are filled with care: of a step behind them, less than 3e-5 (cubic) or
    /// 1e-5 (quintic) arrives at a valid pixel.
    fn rings(self) -> usize {
        match self {
            Self::Pixels { .. } => self.halo() as usize,
            Self::CubicSpline => 8,
            Self::QuinticSpline => 14,
        }
    }

    fn poles(self) -> &'static [f32] {
        match self {
            Self::Pixels { .. } => &[],
            Self::CubicSpline => prefilter::CUBIC_POLES,
            Self::QuinticSpline => prefilter::QUINTIC_POLES,
        }
    }
}

/// Whether tiles hold the pixels beside a spline's coefficients.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Beside {
    /// Only what kernels sum.
    Nothing,
    /// The pixels, too, for limits of range.
    Pixels,
}

/// A source in prepared tiles.
///
/// Any thread may call anything; threads that want a tile that another makes wait for that one.
#[derive(Debug)]
pub struct PreparedSource {
    source: Arc<dyn Source>,
    extension: Extension,
    filter: Filter,
    beside: Beside,
    tiles: OnceCache<Prepared>,
    rooms: Mutex<Vec<Room>>,
}

/// Memory in which tiles are made.
#[derive(Debug, Default)]
struct Room {
    /// A plane a channel, halo and all.
    planes: Vec<Vec<f32>>,
    codes: [Vec<u8>; 3],
    /// 0 where there is no data; of heights only if there is such a pixel.
    alpha: Vec<u8>,
    flipped: Flipped,
    fill: fill::Room,
    prefilter: Vec<f32>,
}

/// Pixels read in another order than they are wanted in.
#[derive(Debug, Default)]
struct Flipped {
    heights: Vec<f32>,
    codes: [Vec<u8>; 3],
    alpha: Vec<u8>,
}

/// Part of a tile and its halo, and where it comes from.
struct Piece {
    rows: Run,
    cols: Run,
}

impl Piece {
    fn rect(&self) -> Rect {
        Rect { cols: self.cols.range(), rows: self.rows.range() }
    }
}

/// The rectangles of a source that are read to make the tile in a column and row of tiles.
#[must_use]
pub fn reads(extension: Extension, filter: Filter, tile: (u32, u32)) -> Vec<Rect> {
    pieces(extension, filter, tile).iter().map(Piece::rect).collect()
}

fn core(extension: Extension, (col, row): (u32, u32)) -> Rect {
    let extent = extension.extent();
    let span = |at: u32, len: u32| at * PREPARED..(at * PREPARED + PREPARED).min(len);
    Rect { cols: span(col, extent.width), rows: span(row, extent.height) }
}

fn pieces(extension: Extension, filter: Filter, tile: (u32, u32)) -> Vec<Piece> {
    let (core, halo) = (core(extension, tile), i64::from(filter.halo()));
    let wide =
        |range: std::ops::Range<u32>| i64::from(range.start) - halo..i64::from(range.end) + halo;
    let runs = extension.rows(wide(core.rows));
    let piece = |rows: Run| {
        let cols = extension.cols(wide(core.cols.clone()), rows.first.turned);
        cols.into_iter().map(move |cols| Piece { rows, cols })
    };
    runs.into_iter().flat_map(piece).collect()
}

impl PreparedSource {
    /// Prepares `source` for kernels that want `filter`; the tile at `(col, row)` of tiles will be
    /// released `uses(col, row)` times.
    #[must_use]
    pub fn new(
        source: Arc<dyn Source>,
        filter: Filter,
        beside: Beside,
        uses: impl Fn(u32, u32) -> u32,
    ) -> Self {
        let extension = Extension::new(source.extent());
        let tiles = OnceCache::new(tiles(extension), uses);
        Self { source, extension, filter, beside, tiles, rooms: Mutex::default() }
    }

    /// Gives the tiles a budget: what is beyond it is set aside.
    ///
    /// # Panics
    ///
    /// If a tile has been made already.
    pub fn spill(&mut self, overflow: &Arc<Overflow>) {
        self.tiles.spill(Arc::clone(overflow));
    }

    /// The source.
    #[must_use]
    pub fn source(&self) -> &Arc<dyn Source> {
        &self.source
    }

    /// Its extension.
    #[must_use]
    pub fn extension(&self) -> Extension {
        self.extension
    }

    /// What the tiles are prepared for.
    #[must_use]
    pub fn filter(&self) -> Filter {
        self.filter
    }

    /// Channels: one of heights, three of colors.
    #[must_use]
    pub fn channels(&self) -> usize {
        match self.source.kind() {
            Kind::Height => 1,
            Kind::Color | Kind::Normal => 3,
        }
    }

    /// Whether there are pixels beside coefficients.
    #[must_use]
    pub fn keeps_pixels(&self) -> bool {
        self.beside == Beside::Pixels && !self.filter.poles().is_empty()
    }

    /// Tiles in a row of tiles, and rows of them.
    #[must_use]
    pub fn tiles(&self) -> (u32, u32) {
        tiles(self.extension)
    }

    /// How often a tile was made: at most once each, if all uses were announced.
    #[must_use]
    pub fn made(&self) -> u64 {
        self.tiles.made()
    }

    /// The rectangles of the source that are read to make a tile.
    #[must_use]
    pub fn reads(&self, col: u32, row: u32) -> Vec<Rect> {
        reads(self.extension, self.filter, (col, row))
    }

    /// A tile, made now if it was not yet.
    ///
    /// # Errors
    ///
    /// [`RasterError`] if the source cannot be read, or a tile not be set aside or read back.
    ///
    /// # Panics
    ///
    /// If there is no such tile.
    pub fn get(&self, col: u32, row: u32) -> Result<Arc<Prepared>, RasterError> {
        let failed = |action, source| RasterError::io(action, self.source.path())(source);
        self.tiles.get(col, row, || self.make(col, row)).map_err(|error| match error {
            OnceError::Make(error) => error,
            OnceError::SetAside(source) => failed("set aside pixels of", source),
            OnceError::ReadBack(source) => failed("read back pixels of", source),
        })
    }

    /// Ends one announced use of a tile, whether it was asked for or not: true if that was the last
    /// and the tile was never made, so that nothing of [`Self::reads`] was read for it.
    ///
    /// # Panics
    ///
    /// If there is no such tile.
    pub fn release(&self, col: u32, row: u32) -> bool {
        self.tiles.release(col, row)
    }

    fn make(&self, col: u32, row: u32) -> Result<Prepared, RasterError> {
        let rooms = || self.rooms.lock().unwrap_or_else(PoisonError::into_inner);
        let mut room = rooms().pop().unwrap_or_default();
        let prepared = self.make_in(col, row, &mut room);
        rooms().push(room);
        prepared
    }

    fn make_in(&self, col: u32, row: u32, room: &mut Room) -> Result<Prepared, RasterError> {
        let (core, halo) = (core(self.extension, (col, row)), self.filter.halo() as usize);
        let (width, height) = (core.cols.len() + 2 * halo, core.rows.len() + 2 * halo);
        room.blank(self.source.kind(), width * height);
        for piece in pieces(self.extension, self.filter, (col, row)) {
            self.read(&piece, room, width)?;
        }
        let masked = room.settle(self.source.kind());
        let inside = tile::Inside { core, halo, width };
        if masked && lanes::none(&room.alpha, |alpha| alpha != 0) {
            return Ok(Prepared::empty(&inside, room.planes.len()));
        }
        let alpha = masked.then_some(&room.alpha[..]);
        let mut prepared = Prepared::new(&inside, room.planes.len(), alpha);
        if let Some(alpha) = alpha {
            for plane in &mut room.planes {
                fill::fill(plane, alpha, width, self.filter.rings(), &mut room.fill);
            }
        }
        if self.filter.poles().is_empty() {
            room.planes.iter().for_each(|plane| prepared.push(&inside, plane));
        } else {
            if self.beside == Beside::Pixels {
                room.planes.iter().for_each(|plane| prepared.push(&inside, plane));
            }
            for plane in &mut room.planes {
                prefilter::prefilter(plane, width, self.filter.poles(), &mut room.prefilter);
                prepared.push(&inside, plane);
            }
        }
        prepared.finish(&inside, alpha);
        Ok(prepared)
    }

    /// Lays a piece where it belongs.
    fn read(&self, piece: &Piece, room: &mut Room, width: usize) -> Result<(), RasterError> {
        let at = piece.rows.at * width + piece.cols.at;
        let Room { planes, codes, alpha, flipped, .. } = room;
        let kind = self.source.kind();
        if !piece.rows.backward && !piece.cols.backward {
            let pixels = match kind {
                Kind::Height => Pixels::Heights(&mut planes[0][at..]),
                Kind::Color | Kind::Normal => Pixels::Colors {
                    planes: codes.each_mut().map(|plane| &mut plane[at..]),
                    alpha: &mut alpha[at..],
                },
            };
            return self.source.read(&piece.rect(), pixels, width);
        }
        let (rows, cols) = (piece.rows.len, piece.cols.len);
        let places = || {
            (0..rows * cols).map(|from| {
                let (row, col) = (from / cols, from % cols);
                let row = if piece.rows.backward { rows - 1 - row } else { row };
                let col = if piece.cols.backward { cols - 1 - col } else { col };
                (at + row * width + col, from)
            })
        };
        match kind {
            Kind::Height => {
                flipped.heights.clear();
                flipped.heights.resize(rows * cols, f32::NAN);
                self.source.read(&piece.rect(), Pixels::Heights(&mut flipped.heights), cols)?;
                places().for_each(|(to, from)| planes[0][to] = flipped.heights[from]);
            }
            Kind::Color | Kind::Normal => {
                flipped.alpha.clear();
                flipped.alpha.resize(rows * cols, 0);
                flipped.codes.iter_mut().for_each(|plane| plane.resize(rows * cols, 0));
                let pixels = Pixels::Colors {
                    planes: flipped.codes.each_mut().map(|plane| &mut plane[..]),
                    alpha: &mut flipped.alpha,
                };
                self.source.read(&piece.rect(), pixels, cols)?;
                for (to, from) in places() {
                    alpha[to] = flipped.alpha[from];
                    for (codes, flipped) in codes.iter_mut().zip(&flipped.codes) {
                        codes[to] = flipped[from];
                    }
                }
            }
        }
        Ok(())
    }
}

impl Room {
    /// Makes room for `len` pixels without data.
    fn blank(&mut self, kind: Kind, len: usize) {
        let blank = |plane: &mut Vec<f32>, value| {
            plane.clear();
            plane.resize(len, value);
        };
        match kind {
            Kind::Height => {
                self.planes.resize_with(1, Vec::new);
                blank(&mut self.planes[0], f32::NAN);
            }
            Kind::Color | Kind::Normal => {
                self.planes.resize_with(3, Vec::new);
                self.codes.iter_mut().for_each(|plane| plane.resize(len, 0));
                self.alpha.clear();
                self.alpha.resize(len, 0);
            }
        }
    }

    /// Turns what was read into numbers and a mask; whether there is need of the mask.
    fn settle(&mut self, kind: Kind) -> bool {
        match kind {
            Kind::Height => {
                let heights = &self.planes[0];
                if lanes::none(heights, |height| height.is_nan()) {
                    return false;
                }
                self.alpha.clear();
                self.alpha
                    .extend(heights.iter().map(|height| if height.is_nan() { 0 } else { 255 }));
                true
            }
            Kind::Color | Kind::Normal => {
                for (plane, codes) in self.planes.iter_mut().zip(&self.codes) {
                    plane.clear();
                    plane.extend(codes.iter().map(|&code| texel::light(code)));
                }
                !lanes::none(&self.alpha, |alpha| alpha != 255)
            }
        }
    }
}

fn tiles(extension: Extension) -> (u32, u32) {
    let extent = extension.extent();
    (extent.width.div_ceil(PREPARED), extent.height.div_ceil(PREPARED))
}

#[cfg(test)]
mod tests;
