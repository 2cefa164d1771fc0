//! Texels whose bilinear surface is nearest to a field, from its values at their centers.
//!
//! A surface through values at the centers cuts every hill and fills every valley, so that its error has
//! a mean: texels that lie beyond the field by a twelfth of their second difference along each axis
//! take that away,
//!
//! ```text
//!                 -1/12
//!        -1/12    16/12   -1/12
//!                 -1/12
//! ```
//!
//! # Precision
//!
//! Along an axis with pixels h, of a field f with few waves shorter than some pixels, the root mean
//! square distance is h²/√120 of that of f″ through its values and h²/√720 of these texels, which no
//! others are nearer than (M. Unser, *Sampling - 50 Years after Shannon*, 2000, table 1).
//!
//! Where second differences are zero, values come out to the bit.

/// A twelfth.
const SHARE: f32 = 1.0 / 12.0;

/// Fits the `rows` by `cols` texels inside a border of one, which has its values, too. A texel beside one
/// without coverage stays as it is.
pub(super) fn fit(plane: &mut [f32], coverage: &[u8], side: usize, (rows, cols): (usize, usize)) {
    // As they were before this row and the one above it were fitted.
    let (mut above, mut here) = (plane[..side].to_vec(), vec![0.0; side]);
    for row in 1..=rows {
        let start = row * side;
        here.copy_from_slice(&plane[start..][..side]);
        let (fitted, below) = plane[start..].split_at_mut(side);
        let covered = |row: usize| &coverage[row * side..][..side];
        let [up, middle, down] = [covered(row - 1), covered(row), covered(row + 1)];
        for col in 1..=cols {
            let center = here[col];
            let across = (here[col - 1] - center) + (here[col + 1] - center);
            let along = (above[col] - center) + (below[col] - center);
            let around = [up[col], middle[col - 1], middle[col], middle[col + 1], down[col]];
            let is_full = around.into_iter().fold(u8::MAX, |all, code| all & code) == u8::MAX;
            fitted[col] = if is_full { center - SHARE * (across + along) } else { center };
        }
        std::mem::swap(&mut above, &mut here);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SIDE: usize = 34;
    const INSIDE: (usize, usize) = (SIDE - 2, SIDE - 2);

    fn values(field: impl Fn(f64, f64) -> f64) -> Vec<f32> {
        let places = (0..SIDE * SIDE).map(|at| (at / SIDE, at % SIDE));
        #[expect(clippy::cast_possible_truncation, reason = "a height")]
        places.map(|(row, col)| field(row as f64, col as f64) as f32).collect()
    }

    /// The mean square distance of the bilinear surface from a field, where all texels are fitted.
    fn distance(texels: &[f32], field: impl Fn(f64, f64) -> f64) -> f64 {
        const POINTS: usize = 8;
        let mut sum = 0.0;
        for row in 1..SIDE - 2 {
            for col in 1..SIDE - 2 {
                let texel = |down, across| f64::from(texels[(row + down) * SIDE + col + across]);
                for point in 0..POINTS * POINTS {
                    let at = |index| (index as f64 + 0.5) / POINTS as f64;
                    let (down, across) = (at(point / POINTS), at(point % POINTS));
                    let upper = texel(0, 0) * (1.0 - across) + texel(0, 1) * across;
                    let lower = texel(1, 0) * (1.0 - across) + texel(1, 1) * across;
                    let surface = upper * (1.0 - down) + lower * down;
                    sum += (surface - field(row as f64 + down, col as f64 + across)).powi(2);
                }
            }
        }
        sum
    }

    proptest! {
        #[test]
        fn surfaces_are_as_near_as_can_be(
            length in 8.0..40.0_f64, direction in 0.0..std::f64::consts::TAU, phase in 0.0..6.0_f64,
        ) {
            let k = std::f64::consts::TAU / length;
            let field = |row: f64, col: f64| {
                100.0 * (k * (row * direction.sin() + col * direction.cos()) + phase).sin()
            };
            let through = values(field);
            let mut fitted = through.clone();
            fit(&mut fitted, &[u8::MAX; SIDE * SIDE], SIDE, INSIDE);
            let (before, now) = (distance(&through, field), distance(&fitted, field));
            // A sixth of the square; of two axes whose errors have one sign, less.
            prop_assert!(now < 0.2 * before, "{} of {}", now, before);
            // Neither more nor less of the same is nearer.
            for factor in [0.8, 1.25] {
                let other: Vec<f32> =
                    through.iter().zip(&fitted).map(|(t, f)| t + factor * (f - t)).collect();
                prop_assert!(distance(&other, field) > now, "{} times", factor);
            }
        }

        #[test]
        fn what_does_not_bend_stays(
            level in -9000.0..9000.0_f32, holes in prop::collection::vec(any::<bool>(), SIDE * SIDE),
        ) {
            let mut plane = vec![level; SIDE * SIDE];
            fit(&mut plane, &[u8::MAX; SIDE * SIDE], SIDE, INSIDE);
            prop_assert!(plane.iter().all(|height| height.to_bits() == level.to_bits()));

            // Beside a hole, whatever is in it.
            let coverage: Vec<u8> = holes.iter().map(|&hole| if hole { 0 } else { 255 }).collect();
            let rough = values(|row, col| (row * 7.0 + col * 3.0).sin());
            let with = |hole: f32| {
                let values = rough.iter().zip(&holes).map(|(&v, &is_hole)| if is_hole { hole } else { v });
                let mut plane: Vec<f32> = values.collect();
                fit(&mut plane, &coverage, SIDE, INSIDE);
                plane
            };
            let (one, other) = (with(0.0), with(1e9));
            for at in (0..SIDE * SIDE).filter(|&at| !holes[at]) {
                prop_assert_eq!(one[at].to_bits(), other[at].to_bits());
            }
        }
    }
}
