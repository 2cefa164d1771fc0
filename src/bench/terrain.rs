//! Made-up terrain that is as rough as a planet's: fractal noise on a global map, row by row.
//!
//! ```text
//!   height(x, y) = Σ over octaves  amplitude · fade(y) · Σ taps  B(u − i) B(v − j) noise(i, j)
//! ```
//!
//! Each octave is a lattice of noise, `2^k` pixels wide, under a cubic B-spline; the finest is noise
//! of single pixels. An octave is [`GROWTH`] times as high as the one before: structure at every
//! scale down to the pixel, and the same statistics by the pixel whatever the size of the map, so
//! that times at different sizes compare. It wraps in longitude, and fades into one height at the
//! poles, as a field on a sphere does.
//!
//! Any row can be made alone: a map needs the memory of the rows asked for, and its samples depend
//! on its size alone.

use std::ops::Range;

/// The first sample that stands for no data.
pub(super) const MISSING: i16 = i16::MIN;

/// Standard deviation of the finest octave, in meters.
const ROUGHNESS_M: f32 = 1.5;

/// Standard deviation of [`noise`], that of an even distribution over [-1, 1).
const NOISE_DEVIATION: f32 = 0.577_350_3;

/// What is left of it under a spline: the mean over a cell of the root of the sum of the squared
/// weights, 151/315 along each axis.
const SPLINE_DEVIATION: f32 = NOISE_DEVIATION * 151.0 / 315.0;

/// An octave's height over that of the next finer one: 2^H, with the exponent H = 0.9 of Hurst.
const GROWTH: f32 = 1.866;

/// The coarsest octave has at least so many cells around the planet.
const LEAST_CELLS: u32 = 8;

/// Octaves of the field that holes are cut from, as powers of two of pixels.
const HOLE_OCTAVES: Range<u32> = 4..9;

/// A hole is where that field is so many times as high as its finest octave usually is.
const HOLE_LEVEL: f32 = 8.0;

/// One lattice of noise.
#[derive(Clone, Copy, Debug)]
struct Octave {
    /// Pixels of a cell, nearly.
    spacing_px: u32,
    /// Cells around the planet and from pole to pole.
    cells: (u32, u32),
    amplitude_m: f32,
    seed: u64,
}

/// Terrain on a global map.
#[derive(Clone, Debug)]
pub(super) struct Terrain {
    width: u32,
    height: u32,
    octaves: Vec<Octave>,
}

impl Terrain {
    /// The heights of a map of that size.
    pub(super) fn heights(width: u32, height: u32) -> Self {
        let octaves = (0..=(width / LEAST_CELLS).max(1).ilog2()).collect::<Vec<_>>();
        Self::new((width, height), &octaves, ROUGHNESS_M, 1)
    }

    /// What a map of that size has holes by: see [`Self::is_hole`].
    pub(super) fn holes(width: u32, height: u32) -> Self {
        Self::new((width, height), &HOLE_OCTAVES.collect::<Vec<_>>(), 1.0, 2)
    }

    /// Whether a sample of [`Self::holes`] is a hole.
    pub(super) fn is_hole(sample: f32) -> bool {
        sample > HOLE_LEVEL
    }

    fn new((width, height): (u32, u32), octaves: &[u32], finest_m: f32, seed: u64) -> Self {
        let octaves = octaves.iter().zip(0_u16..).map(|(&exponent, place)| {
            let spacing_px = 1 << exponent;
            let deviation = if exponent == 0 { NOISE_DEVIATION } else { SPLINE_DEVIATION };
            let across = (f64::from(width) / f64::from(spacing_px)).round();
            let down = (f64::from(height) / f64::from(spacing_px)).round();
            Octave {
                spacing_px,
                cells: (whole(across).max(1), whole(down).max(1)),
                amplitude_m: finest_m * GROWTH.powi(i32::from(place)) / deviation,
                seed: mixed(seed << 32 | u64::from(exponent)),
            }
        });
        Self { width, height, octaves: octaves.collect() }
    }

    /// The samples of whole rows, in meters.
    pub(super) fn rows(&self, rows: Range<u32>) -> Vec<f32> {
        let width = self.width as usize;
        let mut samples = vec![0.0; width * rows.len()];
        for octave in &self.octaves {
            let mut lattice = LatticeRows::new(octave.seed, octave.cells.0);
            for (row, out) in rows.clone().zip(samples.chunks_exact_mut(width)) {
                let scale = octave.amplitude_m * self.fade(row, octave.spacing_px);
                if octave.spacing_px == 1 {
                    for (col, sample) in (0..).zip(out) {
                        *sample += scale * noise(octave.seed, row, col);
                    }
                } else {
                    let (cell, place) = self.cell(row, octave.cells.1);
                    let knots = lattice.knots(cell, weights(place), scale);
                    add_spline(&knots, octave.cells.0, out);
                }
            }
        }
        samples
    }

    /// The cell of a row's center and how far into it that lies.
    fn cell(&self, row: u32, cells: u32) -> (u32, f32) {
        let at = (f64::from(row) + 0.5) * f64::from(cells) / f64::from(self.height);
        (whole(at.floor()), fraction(at - at.floor()))
    }

    /// How much of an octave there is on a row: none at the poles, all two cells off them.
    fn fade(&self, row: u32, spacing_px: u32) -> f32 {
        let from_pole = f64::from(row.min(self.height - 1 - row)) + 0.5;
        let place = (from_pole / (2.0 * f64::from(spacing_px))).min(1.0);
        fraction(place * place * (3.0 - 2.0 * place))
    }
}

/// Rows of a lattice, made when they are first needed and kept while they may be needed again.
struct LatticeRows {
    seed: u64,
    cells: u32,
    first: u32,
    rows: std::collections::VecDeque<Vec<f32>>,
}

impl LatticeRows {
    fn new(seed: u64, cells: u32) -> Self {
        Self { seed, cells, first: 0, rows: std::collections::VecDeque::new() }
    }

    /// The four rows about a cell, summed with `weights` and scaled, with one knot more to the left
    /// and two to the right than there are cells. Cells must not be asked for in falling order.
    fn knots(&mut self, cell: u32, weights: [f32; 4], scale: f32) -> Vec<f32> {
        while !self.rows.is_empty() && self.first < cell {
            self.rows.pop_front();
            self.first += 1;
        }
        if self.rows.is_empty() {
            self.first = cell;
        }
        for place in 0..4_u32 {
            if self.rows.len() <= place as usize {
                let row = self.first + place;
                let wrapped = (0..self.cells + 3).map(|col| (col + self.cells - 1) % self.cells);
                self.rows.push_back(wrapped.map(|col| noise(self.seed, row, col)).collect());
            }
        }
        let [a, b, c, d] = weights.map(|weight| weight * scale);
        let of = |place: usize| self.rows[place].iter();
        let pairs = of(0).zip(of(1)).zip(of(2).zip(of(3)));
        pairs.map(|((p, q), (r, s))| a * p + b * q + c * r + d * s).collect()
    }
}

/// Adds the cubic B-spline over `knots` to the pixels of a row.
fn add_spline(knots: &[f32], cells: u32, out: &mut [f32]) {
    let width = out.len() as u64;
    let cells_wide = u64::from(cells);
    // The first pixel whose center lies in a cell.
    let start =
        |cell: u64| ((2 * cell * width).saturating_sub(cells_wide)).div_ceil(2 * cells_wide);
    let step = fraction(f64::from(cells) / width as f64);
    let mut first = 0;
    for (cell, knots) in (0..cells_wide).zip(knots.windows(4)) {
        let &[a, b, c, d] = knots else { continue };
        let c0 = (a + 4.0 * b + c) / 6.0;
        let c1 = (c - a) / 2.0;
        let c2 = (a - 2.0 * b + c) / 2.0;
        let c3 = (d - a + 3.0 * (b - c)) / 6.0;
        let end = usize::try_from(start(cell + 1).min(width)).expect("within the row");
        let place = (first as f64 + 0.5) * f64::from(cells) / width as f64 - cell as f64;
        let place = fraction(place);
        for (pixel, sample) in (0_u16..).zip(&mut out[first..end]) {
            let t = place + f32::from(pixel) * step;
            *sample += c0 + t * (c1 + t * (c2 + t * c3));
        }
        first = end;
    }
}

/// The weights of the four knots about a place in a cell.
fn weights(t: f32) -> [f32; 4] {
    let s = 1.0 - t;
    let inner = |t: f32| (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0;
    [s * s * s / 6.0, inner(t), inner(s), t * t * t / 6.0]
}

/// Evenly distributed in [-1, 1).
fn noise(seed: u64, row: u32, col: u32) -> f32 {
    let bits = mixed(seed ^ (u64::from(row) << 32 | u64::from(col)));
    let [a, b, ..] = bits.to_le_bytes();
    let [c, ..] = (bits >> 32).to_le_bytes();
    let code = i32::from_le_bytes([0, a, b, c]) >> 8;
    // 24 bits: exact in an f32.
    code as f32 / (1 << 23) as f32
}

/// A bijection that mixes all bits: the finalizer of `SplitMix64`.
///
/// # References
///
/// * Steele, Lea & Flood 2014, *Fast Splittable Pseudorandom Number Generators*.
const fn mixed(bits: u64) -> u64 {
    let bits = bits.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    bits ^ (bits >> 31)
}

#[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
fn fraction(value: f64) -> f32 {
    value as f32
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a count of cells")]
fn whole(value: f64) -> u32 {
    value as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_the_same_alone_and_together() {
        let terrain = Terrain::heights(300, 150);
        let all = terrain.rows(0..150);
        for row in [0, 1, 74, 149] {
            let at = row as usize * 300;
            assert_eq!(terrain.rows(row..row + 1), all[at..at + 300], "row {row}");
        }
    }

    #[test]
    fn it_is_as_smooth_across_the_seam_as_elsewhere_and_level_at_the_poles() {
        let terrain = Terrain::heights(1000, 500);
        let rows = terrain.rows(0..500);
        let steps = |col: usize| {
            let squares =
                rows.chunks_exact(1000).map(|row| (row[(col + 1) % 1000] - row[col]).powi(2));
            (squares.sum::<f32>() / 500.0).sqrt()
        };
        let (seam, elsewhere) = (steps(999), steps(499));
        assert!(seam < 1.2 * elsewhere, "{seam} against {elsewhere}");
        let polar = rows[..1000].iter().fold(0.0_f32, |largest, height| largest.max(height.abs()));
        assert!(polar < 2.0 * ROUGHNESS_M, "{polar}");
    }

    #[test]
    fn holes_are_a_part_of_the_map() {
        let field = Terrain::holes(2000, 1000).rows(0..1000);
        let holes = field.iter().filter(|&&sample| Terrain::is_hole(sample)).count();
        let share = holes as f64 / field.len() as f64;
        assert!((0.05..0.25).contains(&share), "{share}");
    }
}
