//! Weights of taps: even and odd polynomials about the middle between two pixels.
//!
//! ```text
//!      low 0     low 1     low 2  |  high 2    high 1    high 0
//!        +---------+---------+--x-|----+---------+---------+
//!       -2        -1         0    |    1         2         3      pixels, from the one beside x
//!                               <-t                               t in -1/2 ..= 1/2
//! ```
//!
//! A kernel k is even, so the weights of two taps that lie opposite one another are k at mirrored
//! places: `low(t) = E(t²) + t O(t²)` and `high(t) = E(t²) - t O(t²)`. Four or six weights cost two
//! or three pairs of short polynomials, for many texels at once and without a table.
//!
//! # References
//!
//! * R. Keys 1981, *Cubic convolution interpolation for digital image processing* (a = -1/2).
//! * M. Unser 1999, *Splines: a perfect fit for signal and image processing*.

/// The weights of `2 * PAIRS` taps.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pieces<const PAIRS: usize, const TERMS: usize> {
    /// Coefficients of E in powers of t², of each pair, the outermost first.
    even: [[f32; TERMS]; PAIRS],
    /// Coefficients of O.
    odd: [[f32; TERMS]; PAIRS],
}

impl<const PAIRS: usize, const TERMS: usize> Pieces<PAIRS, TERMS> {
    /// The weights of each tap of many texels at fractions less a half, `t`.
    ///
    /// What `out` has beyond the taps is left as it is.
    #[inline(always)]
    pub(super) fn at<const TEXELS: usize, const TAPS: usize>(
        &self,
        t: &[f32; TEXELS],
        out: &mut [[f32; TEXELS]; TAPS],
    ) {
        for pair in 0..PAIRS {
            for texel in 0..TEXELS {
                let (even, odd) = self.parts(pair, t[texel]);
                out[pair][texel] = even + odd;
                out[2 * PAIRS - 1 - pair][texel] = even - odd;
            }
        }
    }

    /// E(t²) and t O(t²).
    #[inline(always)]
    fn parts(&self, pair: usize, t: f32) -> (f32, f32) {
        let square = t * t;
        let (mut even, mut odd) = (self.even[pair][TERMS - 1], self.odd[pair][TERMS - 1]);
        for term in (0..TERMS - 1).rev() {
            even = even * square + self.even[pair][term];
            odd = odd * square + self.odd[pair][term];
        }
        (even, odd * t)
    }

    /// The kernel itself, `distance` pixels from its center.
    pub(super) fn kernel(&self, distance: f32) -> f32 {
        let distance = distance.abs();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "small, not negative"
        )]
        let whole = distance as usize;
        if whole >= PAIRS {
            return 0.0;
        }
        // The high tap of this pair is as far as that from the point.
        let (even, odd) = self.parts(PAIRS - 1 - whole, 0.5 - (distance - whole as f32));
        even - odd
    }
}

/// The cubic of Keys with a = -1/2, also Catmull-Rom's. Exact for polynomials of degree 2.
pub(super) const CUBIC: Pieces<2, 2> = Pieces {
    even: [[-1.0 / 16.0, 1.0 / 4.0], [9.0 / 16.0, -1.0 / 4.0]],
    odd: [[1.0 / 8.0, -1.0 / 2.0], [-11.0 / 8.0, 3.0 / 2.0]],
};

/// The cubic B-spline.
pub(super) const CUBIC_SPLINE: Pieces<2, 2> = Pieces {
    even: [[1.0 / 48.0, 1.0 / 4.0], [23.0 / 48.0, -1.0 / 4.0]],
    odd: [[-1.0 / 8.0, -1.0 / 6.0], [-5.0 / 8.0, 1.0 / 2.0]],
};

/// The quintic B-spline.
pub(super) const QUINTIC_SPLINE: Pieces<3, 3> = Pieces {
    even: [
        [1.0 / 3840.0, 1.0 / 96.0, 1.0 / 48.0],
        [79.0 / 1280.0, 7.0 / 32.0, -1.0 / 16.0],
        [841.0 / 1920.0, -11.0 / 48.0, 1.0 / 24.0],
    ],
    odd: [
        [-1.0 / 384.0, -1.0 / 48.0, -1.0 / 120.0],
        [-25.0 / 128.0, -1.0 / 16.0, 1.0 / 24.0],
        [-77.0 / 192.0, 7.0 / 24.0, -1.0 / 12.0],
    ],
};

/// Lanczos's windowed sinc with three lobes, its weights divided by their sum.
///
/// # Precision
///
/// Polynomials through Chebyshev's nodes: within 1.5e-7 of the kernel. Their sum is 1 within 1e-11
/// before they are rounded to f32.
#[expect(clippy::excessive_precision, reason = "digits enough to see that they sum to 1")]
pub(super) const PLAIN_LANCZOS: Pieces<3, 5> = Pieces {
    even: [
        [0.024_456_545_7, -0.088_125_733_6, -0.056_857_512_7, 0.078_069_118_4, -0.023_390_608_1],
        [-0.135_869_523_1, 0.570_761_727_3, -0.114_024_761_1, 0.028_415_190_0, -0.035_427_400_9],
        [0.611_412_977_4, -0.482_635_993_7, 0.170_882_273_8, -0.106_484_308_4, 0.058_818_009_0],
    ],
    odd: [
        [-0.063_924_076_6, 0.309_972_724_4, -0.241_507_860_6, 0.110_070_438_0, -0.049_854_566_0],
        [0.181_158_560_7, -0.841_472_327_6, 0.524_813_207_5, -0.260_760_415_7, 0.123_686_252_0],
        [-1.336_669_981_2, 1.545_208_095_3, -0.908_498_938_1, 0.517_886_493_6, -0.241_400_303_3],
    ],
};

/// The same, with six numbers times the first moment m of its weights taken off them, so that linear
/// ramps stay what they are, to which plain Lanczos is off by 1 % of a pixel.
///
/// The numbers v sum to 0 and have the first moment 1; of all such, they answer waves of 3 to 20
/// pixels least: `∫ |Σ v_k exp(2πi ν k)|² dν` over 1/20 ≤ ν ≤ 7/20 is minimal. Errors of short waves
/// are then those of plain Lanczos.
pub(super) const LANCZOS: Pieces<3, 5> = exact_for_ramps(PLAIN_LANCZOS);

/// v of the low taps, the outermost first; those of the high ones are opposite.
const BALANCE: [f64; 3] = [-0.258_034_81, 0.211_071_25, -0.343_039_72];

/// With taps q from the middle, m = -2 t Σ (E + q O) over the pairs: a polynomial like t O.
#[expect(clippy::cast_possible_truncation, reason = "coefficients are f32")]
const fn exact_for_ramps(plain: Pieces<3, 5>) -> Pieces<3, 5> {
    let Pieces { even, mut odd } = plain;
    let mut term = 0;
    while term < 5 {
        let (mut moment, mut pair) = (0.0, 0);
        while pair < 3 {
            let from_middle = 2.5 - pair as f64;
            moment -= 2.0 * (even[pair][term] as f64 + from_middle * odd[pair][term] as f64);
            pair += 1;
        }
        pair = 0;
        while pair < 3 {
            odd[pair][term] = (odd[pair][term] as f64 - BALANCE[pair] * moment) as f32;
            pair += 1;
        }
        term += 1;
    }
    Pieces { even, odd }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    /// The weights at a fraction, in the order of the taps.
    fn weights<const PAIRS: usize, const TERMS: usize>(
        pieces: &Pieces<PAIRS, TERMS>,
        fraction: f64,
    ) -> Vec<f64> {
        #[expect(clippy::cast_possible_truncation, reason = "as the kernels do")]
        let t = [(fraction - 0.5) as f32; 3];
        let mut taps = [[0.0; 3]; 6];
        pieces.at(&t, &mut taps);
        taps[..2 * PAIRS].iter().map(|tap| f64::from(tap[1])).collect()
    }

    /// The kernel a definition gives, weights divided by their sum, and the worst difference.
    fn worst<const PAIRS: usize, const TERMS: usize>(
        pieces: &Pieces<PAIRS, TERMS>,
        wanted: impl Fn(&[f64]) -> Vec<f64>,
    ) -> f64 {
        let fractions = (0..=512).map(|step| f64::from(step) / 512.0);
        let errors = fractions.flat_map(|fraction| {
            let distances: Vec<f64> =
                (0..2 * PAIRS).map(|tap| tap as f64 - (PAIRS - 1) as f64 - fraction).collect();
            let (found, wanted) = (weights(pieces, fraction), wanted(&distances));
            #[expect(clippy::cast_possible_truncation, reason = "as the kernels do")]
            let direct: Vec<f64> =
                distances.iter().map(|&d| f64::from(pieces.kernel(d as f32))).collect();
            let off = |found: Vec<f64>| -> Vec<f64> {
                found.iter().zip(&wanted).map(|(found, wanted)| (found - wanted).abs()).collect()
            };
            [off(found), off(direct)].concat()
        });
        errors.fold(0.0, f64::max)
    }

    fn lanczos(x: f64) -> f64 {
        match x.abs() {
            0.0 => 1.0,
            3.0.. => 0.0,
            _ => 3.0 * (PI * x).sin() * (PI * x / 3.0).sin() / (PI * x).powi(2),
        }
    }

    fn normalized(distances: &[f64]) -> Vec<f64> {
        let sum: f64 = distances.iter().map(|&d| lanczos(d)).sum();
        distances.iter().map(|&d| lanczos(d) / sum).collect()
    }

    /// The numbers of least answer, by their definition: of the forms that are odd about the middle,
    /// x = A⁻¹ w / (wᵀ A⁻¹ w) with A their answers' products and w their first moments.
    fn balance() -> [f64; 6] {
        let product = |j: usize, k: usize| {
            let turns = 2.0 * PI * j.abs_diff(k) as f64;
            let [to, from] = [0.35, 0.05]
                .map(|limit| if turns == 0.0 { limit } else { (turns * limit).sin() / turns });
            to - from
        };
        let a: [[f64; 3]; 3] = std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                let (far_i, far_j) = (5 - i, 5 - j);
                product(i, j) - product(i, far_j) - product(far_i, j) + product(far_i, far_j)
            })
        });
        let moments = [-5.0, -3.0, -1.0];
        let determinant = |m: [[f64; 3]; 3]| {
            let [x, y, z] = m.map(glam::DVec3::from_array);
            x.dot(y.cross(z))
        };
        // Cramer's rule; the factor that they share falls out.
        let solved: [f64; 3] = std::array::from_fn(|col| {
            let mut replaced = a;
            for (row, moment) in replaced.iter_mut().zip(moments) {
                row[col] = moment;
            }
            determinant(replaced)
        });
        let scale: f64 = solved.iter().zip(moments).map(|(x, moment)| x * moment).sum();
        let [x, y, z] = solved.map(|x| x / scale);
        [x, y, z, -z, -y, -x]
    }

    fn linear(distances: &[f64]) -> Vec<f64> {
        let weights = normalized(distances);
        let first: f64 = weights.iter().zip(distances).map(|(w, d)| w * d).sum();
        weights.iter().zip(balance()).map(|(w, v)| w - first * v).collect()
    }

    /// A B-spline by differences of truncated powers.
    fn spline(degree: i32, x: f64) -> f64 {
        let mut choose = 1.0;
        let mut sum = 0.0;
        for k in 0..=degree + 1 {
            let from_knot = x + f64::from(degree + 1) / 2.0 - f64::from(k);
            sum += choose * from_knot.max(0.0).powi(degree);
            choose *= -f64::from(degree + 1 - k) / f64::from(k + 1);
        }
        sum / (1..=degree).map(f64::from).product::<f64>()
    }

    fn keys(x: f64) -> f64 {
        match x.abs() {
            x @ ..1.0 => (1.5 * x - 2.5) * x * x + 1.0,
            x @ ..2.0 => ((-0.5 * x + 2.5) * x - 4.0) * x + 2.0,
            _ => 0.0,
        }
    }

    #[test]
    fn weights_are_those_of_the_definitions() {
        let each =
            |kernel: fn(f64) -> f64| move |at: &[f64]| at.iter().map(|&d| kernel(d)).collect();
        assert!(worst(&CUBIC, each(keys)) < 2e-7);
        assert!(worst(&CUBIC_SPLINE, each(|x| spline(3, x))) < 1e-7);
        assert!(worst(&QUINTIC_SPLINE, each(|x| spline(5, x))) < 1e-7);
        assert!(worst(&PLAIN_LANCZOS, normalized) < 3e-7);
        assert!(worst(&LANCZOS, linear) < 3e-7);
    }

    #[test]
    fn weights_sum_to_one_and_balance() {
        fn check<const PAIRS: usize, const TERMS: usize>(pieces: &Pieces<PAIRS, TERMS>) {
            for step in 0..=64 {
                let fraction = f64::from(step) / 64.0;
                let weights = weights(pieces, fraction);
                let sum: f64 = weights.iter().sum();
                let center: f64 =
                    weights.iter().enumerate().map(|(tap, weight)| weight * tap as f64).sum();
                assert!((sum - 1.0).abs() < 3e-7, "{sum}");
                assert!((center - (PAIRS - 1) as f64 - fraction).abs() < 6e-7, "{center}");
            }
        }
        check(&CUBIC);
        check(&CUBIC_SPLINE);
        check(&QUINTIC_SPLINE);
        check(&LANCZOS);
    }

    #[test]
    fn a_pixel_center_has_the_pixel() {
        assert_eq!(weights(&CUBIC, 0.0), [0.0, 1.0, 0.0, 0.0]);
    }
}
