//! The mean of a texel's footprint: a box, pixels counting by the part of them inside.

use areoid_formats::lanes;

use super::super::tile::{Coords, Footprint};
use super::super::window::Window;
use super::wide::{Axis, LOAD};
use super::{Sampled, Scratch, wide};

/// A box along an axis.
#[derive(Clone, Copy, Debug)]
struct Side {
    /// Half its length in pixels: at least a half.
    half: f64,
    /// Pixels before and after a texel that it may touch.
    reach: i64,
}

impl Side {
    /// Along an axis along which a footprint is `texel` pixels long.
    fn new(texel: f64) -> Self {
        let half = 0.5 * texel.max(1.0);
        #[expect(clippy::cast_possible_truncation, reason = "no more than the source has pixels")]
        let reach = (half + 0.5).ceil() as i64;
        Self { half, reach }
    }
}

impl Axis for Side {
    fn reach(&self) -> i64 {
        self.reach
    }

    #[inline(always)]
    fn weights(&self, fraction: f64, out: &mut [[f32; LOAD]]) {
        #[expect(clippy::cast_possible_truncation, reason = "weights are f32")]
        let (fraction, half) = (fraction as f32, self.half as f32);
        let share = 0.5 / half;
        let mut first = (1 - self.reach) as f32 - fraction;
        for chunk in out {
            for (lane, weight) in chunk.iter_mut().enumerate() {
                let tap = first + lane as f32;
                let inside = lanes::least(tap + 0.5, half) - lanes::greatest(tap - 0.5, -half);
                *weight = lanes::greatest(inside, 0.0) * share;
            }
            first += LOAD as f32;
        }
    }
}

/// Pixels before and after a texel that its box may touch.
pub(super) fn reach(texel: f64) -> i64 {
    Side::new(texel).reach
}

/// Means of the valid pixels in a box, valid where they are half of it.
///
/// # Panics
///
/// If a tap lies outside the window.
pub(super) fn average(
    coords: &Coords,
    footprint: Footprint,
    window: &Window,
    scratch: &mut Scratch,
    out: &mut Sampled,
) {
    let sides = [footprint.texel_u, footprint.texel_v].map(Side::new);
    match window.alpha() {
        None => {
            for (channel, plane) in out.planes.iter_mut().enumerate() {
                plane.resize(coords.u.len(), 0.0);
                let sides = sides.each_ref();
                wide::sample(sides, coords, window.view(channel), &mut scratch.room, plane);
            }
            out.alpha = None;
        }
        Some(alpha) => masked(coords, sides, window, alpha, scratch, out),
    }
}

/// [`average`] beside holes, which take part with no weight: the one kernel that looks at the mask.
fn masked(
    coords: &Coords,
    sides: [Side; 2],
    window: &Window,
    alpha: &[u8],
    scratch: &mut Scratch,
    out: &mut Sampled,
) {
    let view = window.view(0);
    let hazy = window.channels() > 1;
    let [across, down] = scratch.room.of(sides.each_ref());
    let mut mask = Vec::with_capacity(coords.u.len());
    out.planes.iter_mut().for_each(Vec::clear);
    let [left, above] = sides.map(|side| (1 - side.reach) as f64);
    for (&u, &v) in coords.u.iter().zip(&coords.v) {
        let (col, row) = (u.floor(), v.floor());
        sides[0].weights(u - col, across);
        sides[1].weights(v - row, down);
        let beside = view.index(col, row);
        let first = view.index(col + left, row + above);
        let valid = || {
            let rows = down.as_flattened().iter().enumerate().filter(|&(_, &weight)| weight > 0.0);
            let taps = rows.flat_map(|(row, &down)| {
                let line = first + row * view.stride;
                let cols =
                    across.as_flattened().iter().enumerate().filter(|&(_, &weight)| weight > 0.0);
                cols.map(move |(col, &across)| (line + col, across * down))
            });
            taps.filter(|&(at, _)| alpha[at] != 0)
        };
        let share: f32 = valid().map(|(_, weight)| weight).sum();
        for (channel, plane) in out.planes.iter_mut().enumerate() {
            let data = window.view(channel).data;
            let sum: f32 = valid().map(|(at, weight)| (data[at] - data[beside]) * weight).sum();
            plane.push(data[beside] + if share > 0.0 { sum / share } else { 0.0 });
        }
        let haze = || valid().map(|(at, weight)| f32::from(alpha[at]) * weight).sum::<f32>();
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "1 to 255")]
        mask.push(match (share >= 0.5, hazy) {
            (false, _) => 0,
            (true, false) => u8::MAX,
            (true, true) => (haze() / share).round_ties_even().clamp(1.0, 255.0) as u8,
        });
    }
    out.alpha = mask.iter().any(|&alpha| alpha != u8::MAX).then_some(mask);
}
