//! Kernels as wide as texels are apart, where those are farther apart than the source's detail.
//!
//! With q the length of a texel's footprint along an axis, in units of the source's own detail
//! there, and s the same in pixels:
//!
//! ```text
//!   stretch
//!      s |                 .·
//!        |               .·
//!        |              /            texels as dense as pixels, and up to 1.6 times as far apart,
//!      1 |_____________/             are interpolated: there is hardly anything to alias, and a
//!        +------------1.6-2----- q   wider kernel would blur what there is
//! ```
//!
//! An equirectangular raster has many pixels a detail toward its poles: crossing many of its columns
//! there is no minification, which is why q and not s decides.
//!
//! A spline's kernel is endless, so it is not stretched: it gives way, as stretch goes from 1 to 2,
//! to stretched Lanczos. What that weighs is pixels, which are the coefficients convolved with the
//! spline at whole numbers; so are its weights then, and coefficients are summed as ever.

use areoid_formats::lanes;

use super::super::tile::{Coords, Footprint};
use super::super::window::View;
use super::taps::ROUNDER;
use super::wide::{Axis, LOAD};
use super::{Kernel, Scratch, weights, wide};

/// How far kernels are stretched along the source's columns and rows.
pub(super) fn stretch(footprint: Footprint) -> [f64; 2] {
    let Footprint { texel_u, texel_v, detail_u, detail_v } = footprint;
    [(texel_u, detail_u), (texel_v, detail_v)].map(|(texel, detail)| {
        let share = ((texel / detail - 1.6) / 0.4).clamp(0.0, 1.0);
        let stretch = 1.0 + share * (texel.max(1.0) - 1.0);
        (stretch * STEPS_TO_A_PIXEL).round() / STEPS_TO_A_PIXEL
    })
}

/// Kernels are stretched in steps, so that one table of weights serves many tiles of texels.
const STEPS_TO_A_PIXEL: f64 = 64.0;

/// Half the taps of a kernel stretched along an axis.
pub(super) fn reach(kernel: Kernel, stretch: f64) -> i64 {
    let pairs = kernel.pairs() as f64;
    #[expect(clippy::cast_possible_truncation, reason = "no more than the source has pixels")]
    let stretched = |pairs: f64| (pairs * stretch).ceil() as i64;
    match kernel {
        Kernel::CubicSpline | Kernel::QuinticSpline if stretch > 1.0 => {
            stretched(LOBES) + at_pixels(kernel).len() as i64 - 1
        }
        _ => stretched(pairs),
    }
}

/// Of Lanczos, which stands in for splines.
const LOBES: f64 = 3.0;

/// A spline at whole numbers, from 0 on.
fn at_pixels(kernel: Kernel) -> &'static [f32] {
    match kernel {
        Kernel::QuinticSpline => &[66.0 / 120.0, 26.0 / 120.0, 1.0 / 120.0],
        _ => &[4.0 / 6.0, 1.0 / 6.0],
    }
}

/// The kernel, `distance` pixels from its center.
fn value(kernel: Kernel, distance: f32) -> f32 {
    match kernel {
        Kernel::Nearest | Kernel::Bilinear | Kernel::Average => (1.0 - distance.abs()).max(0.0),
        Kernel::Cubic => weights::CUBIC.kernel(distance),
        Kernel::PlainLanczos => weights::PLAIN_LANCZOS.kernel(distance),
        Kernel::Lanczos => weights::LANCZOS.kernel(distance),
        Kernel::CubicSpline => weights::CUBIC_SPLINE.kernel(distance),
        Kernel::QuinticSpline => weights::QUINTIC_SPLINE.kernel(distance),
    }
}

/// Texels by a kernel stretched along one axis or both.
///
/// # Precision
///
/// Weights are interpolated in tables of [`STEPS`] fractions: within 1e-5. They sum to 1, and
/// balance, as those of the tables do.
///
/// # Panics
///
/// If a tap lies outside the view.
pub(super) fn sample(
    kernel: Kernel,
    stretch: [f64; 2],
    coords: &Coords,
    view: View<'_>,
    scratch: &mut Scratch,
    out: &mut [f32],
) {
    let Scratch { tables, room } = scratch;
    tables.make_room();
    let [across, down] = stretch.map(|stretch| tables.place(kernel, stretch));
    wide::sample([&tables.0[across], &tables.0[down]], coords, view, room, out);
}

/// The tables of stretches seen of late, those of one kernel as long as it is the same.
#[derive(Debug, Default)]
pub(super) struct Tables(Vec<Table>);

/// So many times [`LOAD`] weights are kept, or one texel's two tables if they are more: 2 MiB.
const KEPT: usize = 1 << 16;

impl Tables {
    /// Forgets all if they are many.
    fn make_room(&mut self) {
        if self.0.iter().map(|table| table.weights.len()).sum::<usize>() > KEPT {
            self.0.clear();
        }
    }

    /// Where the table of a stretch is, which is made if it is not there.
    fn place(&mut self, kernel: Kernel, stretch: f64) -> usize {
        if let Some(at) = self.0.iter().position(|table| table.of == (kernel, stretch)) {
            return at;
        }
        self.0.push(Table::new(kernel, stretch));
        self.0.len() - 1
    }
}

/// Weights of fractions 0, 1/[`STEPS`], …, 1.
#[derive(Debug)]
struct Table {
    of: (Kernel, f64),
    reach: i64,
    /// A row a fraction, with zeros behind its taps up to a multiple of [`LOAD`].
    weights: Vec<[f32; LOAD]>,
}

/// Fractions in a table.
const STEPS: usize = 256;

impl Table {
    fn new(kernel: Kernel, stretch: f64) -> Self {
        let reach = reach(kernel, stretch);
        let mut made = Self { of: (kernel, stretch), reach, weights: Vec::new() };
        let (mut taps, mut room) = (Vec::new(), Vec::new());
        for step in 0..=STEPS {
            let fraction = step as f64 / STEPS as f64;
            axis(kernel, stretch, fraction, reach, &mut taps, &mut room);
            taps.resize(made.chunks() * LOAD, 0.0);
            made.weights.extend_from_slice(taps.as_chunks().0);
        }
        made
    }
}

impl Axis for Table {
    fn reach(&self) -> i64 {
        self.reach
    }

    #[inline(always)]
    fn weights(&self, fraction: f64, out: &mut [[f32; LOAD]]) {
        let place = fraction * STEPS as f64;
        let step = lanes::least(place.floor(), (STEPS - 1) as f64);
        #[expect(clippy::cast_possible_truncation, reason = "a fraction; the lowest bits")]
        let (between, step) = ((place - step) as f32, (step + ROUNDER).to_bits() as u32 as usize);
        let rows = &self.weights[step * self.chunks()..][..2 * self.chunks()];
        let (before, after) = rows.split_at(self.chunks());
        for ((out, before), after) in out.iter_mut().zip(before).zip(after) {
            for lane in 0..LOAD {
                out[lane] = before[lane] + (after[lane] - before[lane]) * between;
            }
        }
    }
}

/// The `2 * reach` weights along an axis, `fraction` behind the last tap of the first half.
fn axis(
    kernel: Kernel,
    stretch: f64,
    fraction: f64,
    reach: i64,
    out: &mut Vec<f32>,
    room: &mut Vec<f32>,
) {
    let distances = move |reach: i64| (1 - reach..=reach).map(move |tap| tap as f64 - fraction);
    let is_spline = matches!(kernel, Kernel::CubicSpline | Kernel::QuinticSpline);
    if stretch == 1.0 || !is_spline {
        fit(kernel, stretch, distances(reach), out);
        return;
    }
    let at_pixels = at_pixels(kernel);
    let beside = at_pixels.len() - 1;
    fit(Kernel::Lanczos, stretch, distances(reach - beside as i64), room);
    #[expect(clippy::cast_possible_truncation, reason = "weights are f32")]
    let (share, distance) = ((stretch - 1.0).min(1.0) as f32, |d: f64| d as f32);
    out.clear();
    out.extend(distances(reach).map(|d| (1.0 - share) * value(kernel, distance(d))));
    for (tap, &weight) in room.iter().enumerate() {
        let to = &mut out[tap..][..2 * beside + 1];
        for (offset, to) in to.iter_mut().enumerate() {
            *to += share * weight * at_pixels[offset.abs_diff(beside)];
        }
    }
}

/// Weights of a stretched kernel that keep what it keeps unstretched: constants and ramps, and parabolas
/// if it has lobes. Without them a long wave is off by the square of its frequency, and not by the cube.
fn fit(
    kernel: Kernel,
    stretch: f64,
    distances: impl Iterator<Item = f64> + Clone,
    out: &mut Vec<f32>,
) {
    #[expect(clippy::cast_possible_truncation, reason = "weights are f32")]
    let narrow = |number: f64| number as f32;
    out.clear();
    out.extend(distances.clone().map(|d| value(kernel, narrow(d / stretch))));
    if stretch == 1.0 {
        return;
    }
    // A hump under the kernel, g = 1 - (d / edge)², times a parabola: what is missing to the moments.
    let edge = (out.len() / 2) as f64;
    let hump = |d: f64| (1.0 - (d / edge).powi(2)).max(0.0);
    let (mut found, mut moments) = ([0.0; 3], [0.0; 5]);
    for (&weight, d) in out.iter().zip(distances.clone()) {
        let powers = [1.0, d, d * d, d * d * d, d * d * d * d];
        for (found, power) in found.iter_mut().zip(powers) {
            *found += f64::from(weight) * power;
        }
        for (moment, power) in moments.iter_mut().zip(powers) {
            *moment += hump(d) * power;
        }
    }
    let [sum, first, second] = found;
    let [a, b, c] = match kernel {
        Kernel::Bilinear => line(moments, -first / sum),
        _ => parabola(moments, [-first / sum, -second / sum]),
    };
    for (weight, d) in out.iter_mut().zip(distances) {
        *weight = narrow(f64::from(*weight) / sum + hump(d) * (a + d * (b + d * c)));
    }
}

/// The line a + b d that, weighted by something with these moments, has sum 0 and this first moment.
fn line([zero, one, two, ..]: [f64; 5], first: f64) -> [f64; 3] {
    let per_determinant = first / (zero * two - one * one);
    [-one * per_determinant, zero * per_determinant, 0.0]
}

/// The parabola a + b d + c d² that has sum 0 and these first two moments, by Cramer's rule.
fn parabola([zero, one, two, three, four]: [f64; 5], [first, second]: [f64; 2]) -> [f64; 3] {
    let [ab, ac] = [two * three - one * four, one * three - two * two];
    let [bb, bc, cc] = [zero * four - two * two, one * two - zero * three, zero * two - one * one];
    let determinant = zero * (two * four - three * three) + one * ab + two * ac;
    [ab * first + ac * second, bb * first + bc * second, bc * first + cc * second]
        .map(|part| part / determinant)
}
