//! What pixels with a value make of one beside them that has none: see [`super::fill`].
//!
//! ```text
//!     c   .   .   c   .   .   c
//!     .   b   .   b   .   b   .      each of the eight neighbors goes on as it came
//!     .   .   a   a   a   .   .
//!     c   b   a   ?   a   b   c
//!     .   .   a   a   a   .   .      NaN marks what has no value
//!     .   b   .   b   .   b   .
//!     c   .   .   c   .   .   c
//! ```
//!
//! Neighbors are summed row by row, so that sums are the same near an edge and inside.

use areoid_formats::lanes::{self, Wide};

/// Row and column of a pixel.
pub(super) type Spot = [usize; 2];

/// Spots that are looked at together.
const LANES: usize = 16;

/// So far along a line values are looked at.
const ALONG: usize = 3;

/// What the neighbors that have a value make of pixels of rows of `width`, each beside one that does.
pub(super) fn guesses(pixels: &[f32], width: usize, spots: &[Spot], out: &mut Vec<f32>) {
    let height = pixels.len() / width;
    let is_inside = |at: usize, len: usize| (ALONG..len.saturating_sub(ALONG)).contains(&at);
    let is_inside = |&[row, col]: &Spot| is_inside(row, height) && is_inside(col, width);
    out.clear();
    out.resize(spots.len(), 0.0);
    for (spots, out) in spots.chunks(LANES).zip(out.chunks_mut(LANES)) {
        // What is near an edge asks before each step whether there is one; the rest need not.
        let mut inside = [None; LANES];
        for (inside, spot) in inside.iter_mut().zip(spots) {
            *inside = is_inside(spot).then(|| spot[0] * width + spot[1]);
        }
        if let Some(some) = inside.into_iter().flatten().next() {
            let mut found = [0.0; LANES];
            let at = inside.map(|at| at.unwrap_or(some));
            lanes::vectorized(Inside { pixels, width, at, out: &mut found });
            out.copy_from_slice(&found[..out.len()]);
        }
        for ((out, inside), &spot) in out.iter_mut().zip(inside).zip(spots) {
            if inside.is_none() {
                *out = beside_an_edge(pixels, width, spot);
            }
        }
    }
}

/// Pixels that three others lie beside in every direction.
struct Inside<'a> {
    pixels: &'a [f32],
    width: usize,
    at: [usize; LANES],
    out: &'a mut [f32; LANES],
}

impl Wide for Inside<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { pixels, width, at, out } = self;
        let ways = [(width + 1, 0.5), (width, 1.0), (width - 1, 0.5), (1, 1.0)];
        let mut sums = Sums { values: [0.0; LANES], weights: [0.0; LANES] };
        for (step, weight) in ways {
            sums.add(weight, along(pixels, at, |at, steps| at - steps * step));
        }
        for (step, weight) in ways.into_iter().rev() {
            sums.add(weight, along(pixels, at, |at, steps| at + steps * step));
        }
        for (out, (value, weight)) in out.iter_mut().zip(sums.values.iter().zip(&sums.weights)) {
            #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the point")]
            let guess = (value / weight) as f32;
            *out = guess;
        }
    }
}

/// The first, second and third pixel beside others, where `index` says.
#[inline(always)]
fn along(
    pixels: &[f32],
    at: [usize; LANES],
    index: impl Fn(usize, usize) -> usize,
) -> [[f32; LANES]; ALONG] {
    let mut lines = [[0.0; LANES]; ALONG];
    for lane in 0..LANES {
        for steps in 1..=ALONG {
            lines[steps - 1][lane] = pixels[index(at[lane], steps)];
        }
    }
    lines
}

/// What neighbors make of pixels, times what they weigh, and the weights.
struct Sums {
    values: [f64; LANES],
    weights: [f64; LANES],
}

impl Sums {
    #[inline(always)]
    fn add(&mut self, weight: f64, [a, b, c]: [[f32; LANES]; ALONG]) {
        for lane in 0..LANES {
            let value = weight * along_line(a[lane].into(), b[lane].into(), c[lane].into());
            let is_known = !a[lane].is_nan();
            self.values[lane] += if is_known { value } else { 0.0 };
            self.weights[lane] += if is_known { weight } else { 0.0 };
        }
    }
}

/// The same of any pixel.
fn beside_an_edge(pixels: &[f32], width: usize, [row, col]: Spot) -> f32 {
    let height = pixels.len() / width;
    // The value `steps` away on the line through both.
    let along = |[down, right]: Spot, steps: usize| {
        let index = |from: usize, one: usize, len: usize| {
            let index = (from + steps * one).checked_sub(steps * from);
            index.filter(|&index| index < len)
        };
        let place = index(row, down, height).zip(index(col, right, width));
        place.map_or(f64::NAN, |(row, col)| pixels[row * width + col].into())
    };
    let rows = row.saturating_sub(1)..(row + 2).min(height);
    let cols = col.saturating_sub(1)..(col + 2).min(width);
    let (mut sum, mut weights) = (0.0, 0.0);
    for [down, right] in rows.flat_map(|down| cols.clone().map(move |right| [down, right])) {
        let [a, b, c] = [1, 2, 3].map(|steps| along([down, right], steps));
        if !a.is_nan() && [down, right] != [row, col] {
            let weight = if down == row || right == col { 1.0 } else { 0.5 };
            sum += weight * along_line(a, b, c);
            weights += weight;
        }
    }
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the point")]
    let guess = (sum / weights) as f32;
    guess
}

/// What goes on from `a`, with `b` behind it and `c` behind that.
#[inline(always)]
fn along_line(a: f64, b: f64, c: f64) -> f64 {
    let (near, far) = (a - b, b - c);
    let smaller = if near.abs() < far.abs() { near } else { far };
    let slope = if near * far <= 0.0 { 0.0 } else { smaller };
    let slope = if c.is_nan() { 0.5 * near } else { slope };
    a + if b.is_nan() { 0.0 } else { slope }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pixel_is_guessed_inside_as_beside_an_edge() {
        let all: Vec<f32> = (0..77).map(|at| (at * at * 37 % 1009) as f32 + 0.1).collect();
        let (width, center) = (7, [5, 3]);
        for pattern in 1..2000 {
            let is_known = |at: usize| {
                [at / 7, at % 7] != center && !((at * pattern + at / 5) % 4099).is_multiple_of(3)
            };
            let pixels: Vec<f32> =
                (0..77).map(|at| if is_known(at) { all[at] } else { f32::NAN }).collect();
            let (mut inside, mut both) = (Vec::new(), Vec::new());
            guesses(&pixels, width, &[center], &mut inside);
            guesses(&pixels, width, &[[5, 2], center, [0, 0]], &mut both);
            let edge = beside_an_edge(&pixels, width, [5, 2]).to_bits();
            let beside = beside_an_edge(&pixels, width, center).to_bits();
            assert_eq!([inside[0].to_bits(), both[1].to_bits()], [beside; 2]);
            assert_eq!(both[0].to_bits(), edge);
        }
    }
}
