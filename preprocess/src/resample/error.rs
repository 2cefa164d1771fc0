//! How far the reconstruction of a finished leaf is from the pixels it was made of.
//!
//! ```text
//!   pixels beneath it ─▶ their places among the texels ─▶ four taps each ─▶ |R_L - pixel|
//! ```
//!
//! # Precision
//!
//! A place is known to [`Transform::bound_px`], so that the error found may be too small by what
//! `R_L` changes over that: it is added.

use std::cell::RefCell;

use areoid_formats::address::PageAddress;
use areoid_formats::bound;
use areoid_formats::lanes;
use areoid_formats::page::Kind;
use areoid_formats::pyramid::Pyramid;

use super::beneath::Interior;
use super::source::{Pixels, Rect, Source};
use super::tile::{Coords, TargetTile};
use super::transform::Transform;
use crate::raster::RasterError;
use crate::texel::{PlanesView, Texel};
use crate::tile::Closed;

/// Taps without data that weigh no more leave a value that counts.
const NO_WEIGHT: f64 = 1.0 / 65_536.0;

/// Two ways of adding four products differ by less, in texels.
const ROUNDING_PX: f64 = 1.0 / (1_u64 << 29) as f64;

/// Memory that leaves use again.
#[derive(Debug, Default)]
struct Room {
    coords: Coords,
    heights: Vec<f32>,
    codes: [Vec<u8>; 3],
    alpha: Vec<u8>,
}

/// The largest |`R_L` - pixel| at the pixels' centers in `rects`, where all that `R_L` is made of
/// is valid: meters, or codes of the channel that is off the most. Not less than it is.
///
/// # Errors
///
/// [`RasterError`] if a pixel cannot be read.
pub(super) fn source_error(
    back: &Transform,
    source: &dyn Source,
    pyramid: &Pyramid,
    page: PageAddress,
    leaf: &Closed<'_>,
    rects: &[Rect],
) -> Result<f32, RasterError> {
    thread_local! {
        static ROOM: RefCell<Room> = RefCell::default();
    }
    let interior = Interior::of(pyramid, page);
    ROOM.with_borrow_mut(|room| {
        let mut largest: Option<f64> = None;
        for rect in rects {
            room.read(source, rect)?;
            for tile in back.tiles(wide(&rect.rows), wide(&rect.cols)) {
                if !interior.may_meet(back, tile) {
                    continue;
                }
                back.coords(tile, &mut room.coords);
                let period = back.source().period_px().filter(|_| back.source().wraps);
                for turn in interior.turns(room.coords.range, period) {
                    let place = Place { page: leaf, interior: &interior, turn, rect, tile };
                    if let Some(error) = room.error(source.kind(), &place) {
                        largest = Some(largest.map_or(error, |largest| largest.max(error)));
                    }
                }
            }
        }
        let Some(largest) = largest else { return Ok(0.0) };
        let relief = (4.0 * back.bound_px() + ROUNDING_PX) * spread(leaf);
        Ok(bound::rounded_up(largest + relief))
    })
}

fn wide(range: &std::ops::Range<u32>) -> std::ops::Range<i64> {
    i64::from(range.start)..i64::from(range.end)
}

/// How far the valid texels of a page lie apart.
fn spread(leaf: &Closed<'_>) -> f64 {
    fn of<S: Texel>(planes: &[&[S]], coverage: Option<&[u8]>) -> f64 {
        let spread = |plane: &&[S]| {
            let (least, most) = match coverage {
                None => lanes::extremes(plane, S::NOTHING),
                Some(codes) => lanes::covered_extremes(plane, codes, S::NOTHING),
            };
            Into::<f64>::into(most) - least.into()
        };
        planes.iter().map(spread).fold(0.0, f64::max)
    }
    match leaf.planes {
        PlanesView::Height(plane) => of(&[plane], leaf.coverage),
        PlanesView::WholeHeight(plane) => of(&[plane], leaf.coverage),
        PlanesView::Color(planes) => of(&planes, leaf.coverage),
    }
}

/// A tile of pixels over a page.
struct Place<'a> {
    page: &'a Closed<'a>,
    interior: &'a Interior,
    /// Columns by which the page lies to the right of its own place.
    turn: f64,
    /// What was read.
    rect: &'a Rect,
    tile: TargetTile,
}

impl Room {
    /// Reads the pixels of a rectangle.
    fn read(&mut self, source: &dyn Source, rect: &Rect) -> Result<(), RasterError> {
        let (cols, rows) = (rect.cols.len(), rect.rows.len());
        match source.kind() {
            Kind::Height => {
                self.heights.clear();
                self.heights.resize(cols * rows, f32::NAN);
                source.read(rect, Pixels::Heights(&mut self.heights), cols)
            }
            Kind::Color | Kind::Normal => {
                self.codes.iter_mut().for_each(|plane| plane.resize(cols * rows, 0));
                self.alpha.clear();
                self.alpha.resize(cols * rows, 0);
                let planes = self.codes.each_mut().map(|plane| &mut plane[..]);
                source.read(rect, Pixels::Colors { planes, alpha: &mut self.alpha }, cols)
            }
        }
    }

    /// The largest error of a tile; `None` if no pixel of it counts.
    fn error(&self, kind: Kind, place: &Place<'_>) -> Option<f64> {
        let has_height = |at: usize| !self.heights[at].is_nan();
        let has_color = |at: usize| self.alpha[at] != 0;
        let [red, green, blue] = &self.codes;
        match (kind, place.page.planes) {
            (Kind::Height, PlanesView::Height(plane)) => {
                self.largest(place, [plane], [&self.heights], has_height)
            }
            (Kind::Height, PlanesView::WholeHeight(plane)) => {
                self.largest(place, [plane], [&self.heights], has_height)
            }
            (_, PlanesView::Color(planes)) => {
                self.largest(place, planes, [red, green, blue], has_color)
            }
            _ => None,
        }
    }

    /// The largest error of a tile over its channels.
    fn largest<T: Copy + Into<f64>, P: Copy + Into<f64>, const CHANNELS: usize>(
        &self,
        place: &Place<'_>,
        planes: [&[T]; CHANNELS],
        pixels: [&[P]; CHANNELS],
        has: impl Fn(usize) -> bool,
    ) -> Option<f64> {
        let Place { page, interior: Interior { cols, rows }, turn, rect, tile } = place;
        let (side, stride) = (page.side, rect.cols.len());
        let from = |start: i64, first: u32| usize::try_from(start - i64::from(first));
        let (row, col) =
            (from(tile.row, rect.rows.start).ok()?, from(tile.col, rect.cols.start).ok()?);
        // The center of the window's first texel, the one before the interior's.
        let [left, top] = [cols[0] + turn, rows[0]].map(f64::round);
        let cols = cols.map(|edge| edge + turn);
        let mut largest = f64::NEG_INFINITY;
        let lines =
            self.coords.u.chunks_exact(tile.cols).zip(self.coords.v.chunks_exact(tile.cols));
        for (line, (us, vs)) in lines.enumerate() {
            let first = (row + line) * stride + col;
            for (pixel, (&u, &v)) in (first..).zip(us.iter().zip(vs)) {
                let beneath = cols[0] <= u && u <= cols[1] && rows[0] <= v && v <= rows[1];
                if !beneath || !has(pixel) {
                    continue;
                }
                let (x, y) = (u - left, v - top);
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "places in a window"
                )]
                let (across, down) = (x as u32, y as u32);
                let (right, below) = (x - f64::from(across), y - f64::from(down));
                let at = down as usize * side + across as usize;
                let weights = match page.coverage {
                    None => None,
                    Some(codes) if taps(at, side).iter().all(|&tap| codes[tap] != 0) => None,
                    Some(codes) => match weights(codes, at, side, right, below) {
                        Some(weights) => Some(weights),
                        None => continue,
                    },
                };
                for (plane, samples) in planes.iter().zip(pixels) {
                    let [upper, lower] = [at, at + side].map(|at| {
                        let taps = &plane[at..at + 2];
                        [taps[0].into(), taps[1].into()]
                    });
                    let value = match weights {
                        None => {
                            let [upper, lower] =
                                [upper, lower].map(|[one, other]| one + (other - one) * right);
                            upper + (lower - upper) * below
                        }
                        Some([a, b, c, d]) => {
                            // What is invalid may be no number.
                            let part = |weight: f64, tap: f64| {
                                if weight > 0.0 { weight * tap } else { 0.0 }
                            };
                            part(a, upper[0])
                                + part(b, upper[1])
                                + part(c, lower[0])
                                + part(d, lower[1])
                        }
                    };
                    largest = largest.max((value - samples[pixel].into()).abs());
                }
            }
        }
        (largest >= 0.0).then_some(largest)
    }
}

/// Where the four taps are whose upper left one is at `at`.
fn taps(at: usize, side: usize) -> [usize; 4] {
    [at, at + 1, at + side, at + side + 1]
}

/// The weights of four taps, those that are valid; `None` if others weigh something.
fn weights(codes: &[u8], at: usize, side: usize, right: f64, below: f64) -> Option<[f64; 4]> {
    let (left, above) = (1.0 - right, 1.0 - below);
    let mut weights = [left * above, right * above, left * below, right * below];
    let mut valid = 0.0;
    for (weight, tap) in weights.iter_mut().zip(taps(at, side)) {
        *weight = if codes[tap] == 0 { 0.0 } else { *weight };
        valid += *weight;
    }
    (valid >= 1.0 - NO_WEIGHT).then(|| weights.map(|weight| weight / valid))
}

#[cfg(test)]
mod tests;
