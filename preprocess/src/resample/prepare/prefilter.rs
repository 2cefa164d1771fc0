//! From pixels to the coefficients of the spline through them.
//!
//! A B-spline through pixels x has coefficients c with b * c = x, b being the spline at whole
//! numbers. For each pole z of 1/b that is a recursion down and one up:
//!
//! ```text
//!   1/b = Π 1 / (1 + κ δ²),  κ = -z/(1-z)²,  δ² the second difference
//!   1 / (1 + κ δ²) = 1 + z / ((1 - z D)(1 - z U)) δ²,  D, U the pixels before and after
//!
//!   p_n = (δ²x)_n + z p_(n-1)      e_n = z p_n + z e_(n+1)      c_n = x_n + e_n
//! ```
//!
//! The textbook recursion runs over the pixels themselves. Running over second differences, f32
//! rounds the curvature of the terrain instead of its height: where it is flat or a ramp, pixels are
//! their own coefficients to the bit.
//!
//! # References
//!
//! M. Unser, A. Aldroubi, M. Eden 1993, *B-spline signal processing*; the poles are those of its
//! table.

use areoid_formats::lanes::{self, Wide};

/// Pole of the cubic spline: √3 - 2.
pub(super) const CUBIC_POLES: &[f32] = &[-0.267_949_2];

/// Poles of the quintic spline.
pub(super) const QUINTIC_POLES: &[f32] = &[-0.430_575_35, -0.043_096_29];

/// Columns that are filtered together: a strip of them stays in the nearest cache.
const STRIP: usize = 32;

/// Rows that are transposed and filtered together.
const LANES: usize = 16;

/// Turns the pixels of rows of `width` into coefficients, along columns and rows.
///
/// # Precision
///
/// Beyond the first and last pixels the terrain is taken to go on straight. What that changes falls
/// by a factor of the largest pole a pixel inward.
pub(super) fn prefilter(pixels: &mut [f32], width: usize, poles: &[f32], room: &mut Vec<f32>) {
    let height = pixels.len() / width;
    room.clear();
    room.resize(height.max(width) * STRIP.max(LANES) + width * LANES, 0.0);
    lanes::vectorized(Prefilter { pixels, width, height, poles, room });
}

struct Prefilter<'a> {
    pixels: &'a mut [f32],
    width: usize,
    height: usize,
    poles: &'a [f32],
    room: &'a mut [f32],
}

impl Wide for Prefilter<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { pixels, width, height, poles, room } = self;
        let (room, turned) = room.split_at_mut(height.max(width) * STRIP.max(LANES));
        for col in (0..width).step_by(STRIP) {
            let cols = STRIP.min(width - col);
            for &pole in poles {
                columns(&mut pixels[col..], width, cols, height, pole, room);
            }
        }
        for row in (0..height).step_by(LANES) {
            let rows = LANES.min(height - row);
            let lines = &mut pixels[row * width..][..rows * width];
            for (lane, line) in lines.chunks_exact(width).enumerate() {
                for (to, &from) in turned.chunks_exact_mut(LANES).zip(line) {
                    to[lane] = from;
                }
            }
            for &pole in poles {
                columns(turned, LANES, LANES, width, pole, room);
            }
            for (lane, line) in lines.chunks_exact_mut(width).enumerate() {
                for (to, from) in line.iter_mut().zip(turned.chunks_exact(LANES)) {
                    *to = from[lane];
                }
            }
        }
    }
}

/// Filters `cols` columns of `rows` pixels by one pole; rows are `stride` apart.
#[inline(always)]
fn columns(
    pixels: &mut [f32],
    stride: usize,
    cols: usize,
    rows: usize,
    pole: f32,
    room: &mut [f32],
) {
    let down = &mut room[..rows * cols];
    down[..cols].fill(0.0);
    for row in 1..rows {
        let (before, here) = down[(row - 1) * cols..].split_at_mut(cols);
        let here = &mut here[..cols];
        if row + 1 == rows {
            for col in 0..cols {
                here[col] = pole * before[col];
            }
            break;
        }
        let above = &pixels[(row - 1) * stride..][..cols];
        let center = &pixels[row * stride..][..cols];
        let below = &pixels[(row + 1) * stride..][..cols];
        for col in 0..cols {
            let curvature = (below[col] - center[col]) - (center[col] - above[col]);
            here[col] = curvature + pole * before[col];
        }
    }
    // Past the end what comes down falls by the pole a row.
    let end = pole / (1.0 - pole * pole);
    let mut up = [0.0_f32; STRIP];
    let up = &mut up[..cols];
    for row in (0..rows).rev() {
        let down = &down[row * cols..][..cols];
        let line = &mut pixels[row * stride..][..cols];
        for col in 0..cols {
            up[col] = if row + 1 == rows { end * down[col] } else { pole * (down[col] + up[col]) };
            line[col] += up[col];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a spline's coefficients are worth at whole numbers.
    fn spline_at_pixels(degree: u32) -> Vec<f64> {
        match degree {
            3 => [4.0, 1.0].map(|tap| tap / 6.0).into(),
            _ => [66.0, 26.0, 1.0].map(|tap| tap / 120.0).into(),
        }
    }

    /// Solves b * c = x on a line of mirrored ends by elimination.
    fn solved(taps: &[f64], x: &[f64]) -> Vec<f64> {
        let n = x.len();
        let mut matrix = vec![vec![0.0; n + 1]; n];
        for row in 0..n {
            for offset in -(taps.len() as i64 - 1)..taps.len() as i64 {
                let last = n as i64 - 1;
                let col = (row as i64 + offset).abs();
                let col = if col > last { 2 * last - col } else { col };
                matrix[row][usize::try_from(col).unwrap()] +=
                    taps[usize::try_from(offset.abs()).unwrap()];
            }
            matrix[row][n] = x[row];
        }
        for pivot in 0..n {
            for row in pivot + 1..n {
                let factor = matrix[row][pivot] / matrix[pivot][pivot];
                let line = matrix[pivot].clone();
                for (at, above) in matrix[row].iter_mut().zip(line).skip(pivot) {
                    *at -= factor * above;
                }
            }
        }
        let mut c = vec![0.0; n];
        for row in (0..n).rev() {
            let rest: f64 = (row + 1..n).map(|col| matrix[row][col] * c[col]).sum();
            c[row] = (matrix[row][n] - rest) / matrix[row][row];
        }
        c
    }

    fn noise(index: usize) -> f64 {
        let mixed = (index as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        f64::from(u32::try_from((mixed ^ mixed >> 29) >> 32).unwrap()) / f64::from(u32::MAX) - 0.5
    }

    /// A square of mirrored ends with a halo, filtered, against the solution in f64.
    fn off(degree: u32, poles: &[f32], halo: usize) -> f64 {
        const SIDE: usize = 64;
        let pixels: Vec<f64> = (0..SIDE * SIDE).map(|at| 1000.0 * noise(at)).collect();
        let mirrored = |at: usize| {
            let at = (at as i64 - halo as i64).abs();
            let last = SIDE as i64 - 1;
            usize::try_from(if at > last { 2 * last - at } else { at }).unwrap()
        };
        let width = SIDE + 2 * halo;
        #[expect(clippy::cast_possible_truncation, reason = "pixels are f32")]
        let mut found: Vec<f32> = (0..width * width)
            .map(|at| pixels[mirrored(at / width) * SIDE + mirrored(at % width)] as f32)
            .collect();
        prefilter(&mut found, width, poles, &mut Vec::new());

        let taps = spline_at_pixels(degree);
        let rows: Vec<Vec<f64>> = pixels.chunks(SIDE).map(|row| solved(&taps, row)).collect();
        let mut worst = 0.0_f64;
        for col in 0..SIDE {
            let column: Vec<f64> = rows.iter().map(|row| row[col]).collect();
            for (row, wanted) in solved(&taps, &column).into_iter().enumerate() {
                let found = f64::from(found[(row + halo) * width + col + halo]);
                worst = worst.max((found - wanted).abs());
            }
        }
        worst
    }

    #[test]
    fn coefficients_solve_the_interpolation() {
        // Noise of 1000 peak to peak has coefficients of several thousand, whose half ulp is 2e-4.
        let (cubic, quintic) = (off(3, CUBIC_POLES, 16), off(5, QUINTIC_POLES, 26));
        assert!(cubic < 6e-4 && quintic < 3e-3, "{cubic:e} {quintic:e}");
    }

    #[test]
    fn flat_ground_and_ramps_are_their_own_coefficients() {
        let field = |at: usize| if at % 40 < 20 { 1234.567 } else { (at % 40) as f32 };
        // Columns of constants beside columns of ramps: along columns nothing changes.
        let mut pixels: Vec<f32> = (0..40 * 48).map(field).collect();
        let before = pixels.clone();
        let mut room = vec![0.0; 4096];
        columns(&mut pixels, 40, 20, 48, QUINTIC_POLES[0], &mut room);
        assert_eq!(pixels, before);
        let mut ramp: Vec<f32> = (0..70 * 33).map(|at| (at % 70 + 3 * (at / 70)) as f32).collect();
        let before = ramp.clone();
        prefilter(&mut ramp, 70, QUINTIC_POLES, &mut Vec::new());
        assert_eq!(ramp, before);
    }
}
