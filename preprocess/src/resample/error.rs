//! How far the reconstruction of a finished leaf is from the pixels it was made of.
//!
//! ```text
//!   pixels beneath it ─▶ their places among the texels ─▶ roughly |R_L - pixel| ─▶ four taps each,
//!                                                         larger than any before?   |R_L - pixel|
//! ```
//!
//! # Precision
//!
//! A place is known to [`Transform::bound_px`], so that the error found may be too small by what
//! `R_L` changes over that: it is added. What is rough decides only who is looked at again.
//! All of the pixels beneath a leaf are looked at as far as [`super::beneath`] finds them.

mod rough;

use std::cell::RefCell;

use areoid_formats::address::PageAddress;
use areoid_formats::bound;
use areoid_formats::lanes;
use areoid_formats::page::Kind;
use areoid_formats::pyramid::Pyramid;

use self::rough::{Rough, Slack};
use super::beneath::Interior;
use super::source::{Patch, Rect, Source};
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
    patch: Patch,
    rough: Rough,
}

/// The largest |`R_L` - pixel| at the pixels' centers in `rects`, where all that `R_L` is made of
/// is valid: meters, or codes of the channel that is off the most. Not less than that is.
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
    let texels = Texels::of(leaf);
    let slack = Slack::new(texels.range, leaf.coverage.is_some());
    // Less than any distance: nothing was found.
    let mut largest = f64::NEG_INFINITY;
    ROOM.with_borrow_mut(|room| {
        for rect in rects {
            room.patch.read(source, rect)?;
            for tile in back.tiles(wide(&rect.rows), wide(&rect.cols)) {
                let pixels =
                    Rect { rows: narrow(tile.row, tile.rows), cols: narrow(tile.col, tile.cols) };
                let has_data = || room.patch.has_data(source.kind(), rect, &pixels);
                if !(interior.may_meet(back, tile) && has_data()) {
                    continue;
                }
                back.places(tile, &mut room.coords);
                let period = back.source().period_px().filter(|_| back.source().wraps);
                for turn in interior.turns(room.coords.range, period) {
                    let place = Place { page: leaf, interior: &interior, turn, rect, tile, slack };
                    largest = room.largest(source.kind(), &place, largest);
                }
            }
        }
        Ok(())
    })?;
    if largest == f64::NEG_INFINITY {
        return Ok(0.0);
    }
    let relief = (4.0 * back.bound_px() + ROUNDING_PX) * texels.spread;
    Ok(bound::rounded_up(largest + relief))
}

fn wide(range: &std::ops::Range<u32>) -> std::ops::Range<i64> {
    i64::from(range.start)..i64::from(range.end)
}

fn narrow(start: i64, length: usize) -> std::ops::Range<u32> {
    let number = |at: i64| u32::try_from(at).expect("pixels of a rectangle");
    number(start)..number(start + length as i64)
}

/// The valid texels of a page.
struct Texels {
    /// The least and the greatest of any channel.
    range: [f64; 2],
    /// How far those of one channel lie apart.
    spread: f64,
}

impl Texels {
    fn of(leaf: &Closed<'_>) -> Self {
        match leaf.planes {
            PlanesView::Height(plane) => Self::of_planes(&[plane], leaf.coverage),
            PlanesView::WholeHeight(plane) => Self::of_planes(&[plane], leaf.coverage),
            PlanesView::Color(planes) => Self::of_planes(&planes, leaf.coverage),
        }
    }

    fn of_planes<S: Texel>(planes: &[&[S]], coverage: Option<&[u8]>) -> Self {
        let nothing = Self { range: [f64::INFINITY, f64::NEG_INFINITY], spread: 0.0 };
        planes.iter().fold(nothing, |Self { range, spread }, plane| {
            let (least, most) = match coverage {
                None => lanes::extremes(plane, S::NOTHING),
                Some(codes) => lanes::covered_extremes(plane, codes, S::NOTHING),
            };
            let [least, most]: [f64; 2] = [least.into(), most.into()];
            Self {
                range: [range[0].min(least), range[1].max(most)],
                spread: spread.max(most - least),
            }
        })
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
    slack: Slack,
}

impl Place<'_> {
    /// The center of the window's first texel, the one before the interior's: column and row.
    fn corner(&self) -> [f64; 2] {
        let Interior { cols, rows } = self.interior;
        [cols[0] + self.turn, rows[0]].map(f64::round)
    }

    /// Whether a place lies in the interior.
    fn holds(&self, u: f64, v: f64) -> bool {
        let Interior { cols: [first, last], rows } = *self.interior;
        first + self.turn <= u && u <= last + self.turn && rows[0] <= v && v <= rows[1]
    }

    /// Where the first pixel of the tile lies in what was read.
    fn first_pixel(&self) -> Option<usize> {
        let from = |start: i64, first: u32| usize::try_from(start - i64::from(first)).ok();
        let row = from(self.tile.row, self.rect.rows.start)?;
        Some(row * self.rect.cols.len() + from(self.tile.col, self.rect.cols.start)?)
    }
}

impl Room {
    /// The largest error of a tile, or what was found before if that is larger.
    fn largest(&mut self, kind: Kind, place: &Place<'_>, before: f64) -> f64 {
        let Self { coords, patch: Patch { heights, codes, alpha }, rough } = self;
        let [red, green, blue] = codes;
        let has_height = |at: usize| !heights[at].is_nan();
        let has_color = |at: usize| alpha[at] != 0;
        match (kind, place.page.planes) {
            (Kind::Height, PlanesView::Height(plane)) => {
                largest(place, coords, rough, ([plane], [heights], &has_height), before)
            }
            (Kind::Height, PlanesView::WholeHeight(plane)) => {
                largest(place, coords, rough, ([plane], [heights], &has_height), before)
            }
            (_, PlanesView::Color(planes)) => {
                largest(place, coords, rough, (planes, [red, green, blue], &has_color), before)
            }
            _ => before,
        }
    }
}

/// Texels, the pixels they are held against, and whether one has data.
type Channels<'a, T, P, const CHANNELS: usize> =
    ([&'a [T]; CHANNELS], [&'a [P]; CHANNELS], &'a dyn Fn(usize) -> bool);

/// The largest error of a tile over its channels, or what was found before if that is larger.
fn largest<T, P, const CHANNELS: usize>(
    place: &Place<'_>,
    coords: &Coords,
    rough: &mut Rough,
    (planes, pixels, has): Channels<'_, T, P, CHANNELS>,
    before: f64,
) -> f64
where
    T: Copy + Default + Into<f32> + Into<f64>,
    P: Copy + Into<f32> + Into<f64>,
{
    let (Some(first), corner) = (place.first_pixel(), place.corner()) else { return before };
    let (side, stride, cols) = (place.page.side, place.rect.cols.len(), place.tile.cols);
    let mut largest = before;
    for (line, (us, vs)) in coords.u.chunks_exact(cols).zip(coords.v.chunks_exact(cols)).enumerate()
    {
        let holds = |at: usize| place.holds(us[at], vs[at]);
        let Some(start) = (0..cols).find(|&at| holds(at)) else { continue };
        let end = (start..cols).rev().find(|&at| holds(at)).map_or(cols, |last| last + 1);
        let (us, vs) = (&us[start..end], &vs[start..end]);
        let first = first + line * stride + start;
        let row = pixels.map(|samples| &samples[first..first + us.len()]);
        rough.compare([us, vs], corner, (planes, side), row);
        for pixel in rough.suspects(place.slack, largest) {
            if !(place.holds(us[pixel], vs[pixel]) && has(first + pixel)) {
                continue;
            }
            let at = [us[pixel] - corner[0], vs[pixel] - corner[1]];
            let value = pixels.map(|samples| samples[first + pixel].into());
            if let Some(error) = error(place.page, planes, at, value) {
                largest = largest.max(error);
            }
        }
    }
    largest
}

/// How far `R_L` is from a pixel at a place among the texels of a page, its column first; `None`
/// where taps without data weigh something.
fn error<T: Copy + Into<f64>, const CHANNELS: usize>(
    page: &Closed<'_>,
    planes: [&[T]; CHANNELS],
    [x, y]: [f64; 2],
    pixel: [f64; CHANNELS],
) -> Option<f64> {
    let side = page.side;
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
        Some(codes) => Some(weights(codes, at, side, right, below)?),
    };
    let off = planes.iter().zip(pixel).map(|(plane, pixel)| {
        let [upper, lower] = [at, at + side].map(|at| {
            let taps = &plane[at..at + 2];
            [taps[0].into(), taps[1].into()]
        });
        let value = match weights {
            None => {
                let [upper, lower] =
                    [upper, lower].map(|[one, other]: [f64; 2]| one + (other - one) * right);
                upper + (lower - upper) * below
            }
            Some([a, b, c, d]) => {
                // What is invalid may be no number.
                let part = |weight: f64, tap: f64| if weight > 0.0 { weight * tap } else { 0.0 };
                part(a, upper[0]) + part(b, upper[1]) + part(c, lower[0]) + part(d, lower[1])
            }
        };
        (value - pixel).abs()
    });
    Some(off.fold(0.0, f64::max))
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
