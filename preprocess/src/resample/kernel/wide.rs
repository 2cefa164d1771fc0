//! Any number of taps along each axis, with weights of each texel's own.

use areoid_formats::lanes::{self, Wide};

use super::super::tile::Coords;
use super::super::window::View;

/// Taps that are summed at once.
pub(super) const LOAD: usize = 8;

/// Weights of the taps along an axis.
pub(super) trait Axis {
    /// Half the taps.
    fn reach(&self) -> i64;

    /// The weights of a texel `fraction` behind the last tap of the first half, with zeros behind
    /// them in what is left of `out`. They sum to 1.
    fn weights(&self, fraction: f64, out: &mut [[f32; LOAD]]);

    /// How many times [`LOAD`] weights that takes.
    fn chunks(&self) -> usize {
        usize::try_from(2 * self.reach()).expect("not negative").div_ceil(LOAD)
    }
}

/// Weights of one texel along two axes.
#[derive(Debug, Default)]
pub(super) struct Room([Vec<[f32; LOAD]>; 2]);

impl Room {
    /// As much as `axes` need.
    pub(super) fn of<A: Axis>(&mut self, axes: [&A; 2]) -> [&mut [[f32; LOAD]]; 2] {
        let [across, down] = &mut self.0;
        across.resize(axes[0].chunks(), [0.0; LOAD]);
        down.resize(axes[1].chunks(), [0.0; LOAD]);
        [across, down]
    }
}

/// Texels by the weights of two axes, along columns and along rows.
///
/// # Shapes
///
/// The view has [`View::SLACK`] numbers behind each row, which is [`LOAD`] or more.
///
/// # Panics
///
/// If a tap lies outside the view.
pub(super) fn sample<A: Axis>(
    axes: [&A; 2],
    coords: &Coords,
    view: View<'_>,
    room: &mut Room,
    out: &mut [f32],
) {
    const { assert!(LOAD <= View::SLACK) };
    lanes::vectorized(Texels { axes, coords, view, room, out });
}

struct Texels<'a, A> {
    axes: [&'a A; 2],
    coords: &'a Coords,
    view: View<'a>,
    room: &'a mut Room,
    out: &'a mut [f32],
}

impl<A: Axis> Wide for Texels<'_, A> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { axes, coords, view, room, out } = self;
        let [left, above] = axes.map(|axis| (1 - axis.reach()) as f64);
        let rows = usize::try_from(2 * axes[1].reach()).expect("not negative");
        let [across, down] = room.of(axes);
        for ((&u, &v), out) in coords.u.iter().zip(&coords.v).zip(out) {
            let (col, row) = (u.floor(), v.floor());
            axes[0].weights(u - col, across);
            axes[1].weights(v - row, down);
            let beside = view.data[view.index(col, row)];
            let first = view.index(col + left, row + above);
            let mut sums = [0.0_f32; LOAD];
            for (chunk, weights) in across.iter().enumerate() {
                let mut columns = [0.0_f32; LOAD];
                for (row, &weight) in down.as_flattened()[..rows].iter().enumerate() {
                    let at = first + row * view.stride + chunk * LOAD;
                    let taps = &view.data[at..at + LOAD];
                    for lane in 0..LOAD {
                        columns[lane] += (taps[lane] - beside) * weight;
                    }
                }
                for lane in 0..LOAD {
                    sums[lane] += columns[lane] * weights[lane];
                }
            }
            *out = beside + sums.iter().sum::<f32>();
        }
    }
}
