//! Any number of taps along each axis, with weights of each texel's own.

use areoid_formats::lanes::{self, Wide};

use super::super::tile::Coords;
use super::super::window::View;
use super::taps::{ROUNDER, ROW, full};

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
        // What is left of a vector that is hardly used takes as long as the rest.
        match (self.axes[0].reach(), self.axes[0].chunks()) {
            (..=2, _) => self.run_with::<4, 4>(),
            (_, 2) => self.run_with::<LOAD, { 2 * LOAD }>(),
            _ => self.run_with::<LOAD, LOAD>(),
        }
    }
}

impl<A: Axis> Texels<'_, A> {
    /// Sums `WIDTH` taps of a row at once, of them those that are `LANES` apart one after another.
    #[inline(always)]
    fn run_with<const LANES: usize, const WIDTH: usize>(self) {
        let Self { axes, coords, view, room, out } = self;
        let [cols_before, rows_before] =
            axes.map(|axis| usize::try_from(axis.reach() - 1).expect("a kernel has taps"));
        let (last, stride) = (2 * rows_before + 1, view.stride);
        let center = rows_before * stride + cols_before;
        let [across, down] = room.of(axes);
        let columns_in_all = if WIDTH < LOAD { WIDTH } else { across.len() * LOAD };
        let length = last * stride + columns_in_all;
        let mut padding = [[0.0; ROW]; 2];
        for ((us, vs), out) in
            coords.u.chunks(ROW).zip(coords.v.chunks(ROW)).zip(out.chunks_mut(ROW))
        {
            let [padding_u, padding_v] = &mut padding;
            let (us, vs) = (full(us, padding_u), full(vs, padding_v));
            let spots = Spots::new(us, vs, view, [cols_before, rows_before]);
            let (mut beside, mut sums) = ([0.0_f32; ROW], [[0.0_f32; LANES]; ROW]);
            for texel in 0..out.len() {
                axes[0].weights(spots.right[texel], across);
                axes[1].weights(spots.down[texel], down);
                let taps = &view.data[spots.at[texel] as usize..][..length];
                let here = taps[center];
                let weights = across.as_flattened()[..columns_in_all].as_chunks::<WIDTH>().0;
                for (chunk, weights) in weights.iter().enumerate() {
                    let mut columns = [0.0_f32; WIDTH];
                    let lines = taps[chunk * WIDTH..].chunks(stride);
                    for (line, &weight) in lines.zip(&down.as_flattened()[..=last]) {
                        let line: &[f32; WIDTH] = line[..WIDTH].try_into().expect("that many");
                        for col in 0..WIDTH {
                            columns[col] += (line[col] - here) * weight;
                        }
                    }
                    for col in 0..WIDTH {
                        sums[texel][col % LANES] += columns[col] * weights[col];
                    }
                }
                beside[texel] = here;
            }
            for (out, (beside, sums)) in out.iter_mut().zip(beside.iter().zip(&sums)) {
                let mut sum = 0.0;
                for &lane in sums {
                    sum += lane;
                }
                *out = beside + sum;
            }
        }
    }
}

/// Where the taps of a row of texels begin, and how far the texels lie behind the last tap of the
/// first half.
struct Spots {
    /// Indices of the first tap of the first row.
    at: [u32; ROW],
    /// Along columns, 0 to 1.
    right: [f64; ROW],
    /// Along rows.
    down: [f64; ROW],
}

impl Spots {
    /// For taps that begin so many columns and rows `before` the pixel beside a texel.
    #[inline(always)]
    fn new(u: &[f64; ROW], v: &[f64; ROW], view: View<'_>, before: [usize; 2]) -> Self {
        let [left, above] = before.map(|before| before as f64);
        let (left, above) = (left + view.col as f64, above + view.row as f64);
        let stride = view.stride as f64;
        let mut spots = Self { at: [0; ROW], right: [0.0; ROW], down: [0.0; ROW] };
        for lane in 0..ROW {
            let (col, row) = (u[lane].floor(), v[lane].floor());
            (spots.right[lane], spots.down[lane]) = (u[lane] - col, v[lane] - row);
            let index = (row - above) * stride + (col - left);
            #[expect(clippy::cast_possible_truncation, reason = "the lowest bits")]
            let index = (index + ROUNDER).to_bits() as u32;
            spots.at[lane] = index;
        }
        spots
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Weights without any order.
    struct Uneven(i64);

    impl Uneven {
        fn weight(tap: usize, fraction: f64) -> f32 {
            let base = (tap * 37 + 11) % 29;
            #[expect(clippy::cast_possible_truncation, reason = "weights are f32")]
            let moved = (fraction * (tap % 5) as f64) as f32;
            base as f32 / 100.0 - moved / 50.0
        }
    }

    impl Axis for Uneven {
        fn reach(&self) -> i64 {
            self.0
        }

        fn weights(&self, fraction: f64, out: &mut [[f32; LOAD]]) {
            let taps = usize::try_from(2 * self.0).unwrap();
            for (tap, out) in out.as_flattened_mut().iter_mut().enumerate() {
                *out = if tap < taps { Self::weight(tap, fraction) } else { 0.0 };
            }
        }
    }

    /// Windows of 4, 8, 16 and more taps, with fewer texels than a row and more.
    #[test]
    fn texels_are_the_sums_of_all_their_taps() {
        const PLACES: [(f64, f64); 3] = [(30.25, 31.5), (28.0, 29.75), (33.875, 27.0)];
        let (side, stride) = (64, 64 + View::SLACK);
        // What stands behind a row would show.
        let value = |at: usize| if at % stride < side { (at * at % 1013) as f32 } else { 1e6 };
        let data: Vec<f32> = (0..side * stride + View::SLACK).map(value).collect();
        let view = View { data: &data, stride, col: -2, row: -1 };
        for (reach_u, reach_v) in (1..=20).flat_map(|u| [(u, 1), (u, 2), (u, 7), (u, 20)]) {
            let places = PLACES.into_iter().cycle().take(if reach_u % 2 == 0 { 3 } else { 131 });
            let (u, v): (Vec<f64>, Vec<f64>) = places.unzip();
            let mut out = vec![0.0; u.len()];
            let coords = Coords { u, v, range: [28.0, 34.0, 27.0, 32.0] };
            let axes = [&Uneven(reach_u), &Uneven(reach_v)];
            sample(axes, &coords, view, &mut Room::default(), &mut out);
            for ((&u, &v), &found) in coords.u.iter().zip(&coords.v).zip(&out) {
                let at = |col: f64, row: f64| f64::from(data[view.index(col, row)]);
                let (col, row) = (u.floor(), v.floor());
                let beside = at(col, row);
                let weights = |reach: i64, fraction: f64| {
                    let taps = usize::try_from(2 * reach).unwrap();
                    (0..taps).map(move |tap| f64::from(Uneven::weight(tap, fraction)))
                };
                let (mut wanted, mut size) = (beside, beside.abs());
                for (down, below) in (1 - reach_v..).zip(weights(reach_v, v - row)) {
                    for (across, right) in (1 - reach_u..).zip(weights(reach_u, u - col)) {
                        let tap = at(col + across as f64, row + down as f64);
                        let term = (tap - beside) * below * right;
                        (wanted, size) = (wanted + term, size + term.abs());
                    }
                }
                let off = (f64::from(found) - wanted).abs();
                assert!(off < 1e-5 * size, "{reach_u} {reach_v}: {found} {wanted}");
            }
        }
    }
}
