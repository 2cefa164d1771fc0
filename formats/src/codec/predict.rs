//! Predicting a texel from those above and to the left of it.
//!
//! Every predictor but [`Predictor::None`] is the left neighbour plus a slope that the row above
//! alone gives:
//!
//! ```text
//!      ul  u  ur        left     l
//!      l   v            plane    l + (u - ul)
//!                       slope    l + (u + ur - 2 ul) / 4, rounded down
//! ```
//!
//! so a row is undone by an addition that runs over all texels at once and one running sum. The
//! first row has slopes of 0; a row's first texel is predicted by the one above it, the page's first
//! by 0; past the last column `ur` is `u`. All arithmetic wraps at the lane's width, so any lanes
//! survive, and residuals are zigzagged.
//!
//! `plane` is right for smooth ground. On rough ground it adds the noise of three neighbours to
//! that of the texel; `slope` halves the weight of the gradient above and takes it over two texels.
//! (On fractal terrain it equals the mean of `l` and `u`, whose inverse is a serial chain.)

use super::bits::Lane;
use super::coverage;
use crate::lanes::{Wide, vectorized};

/// How a lane image was predicted. The numbers are those of the format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Predictor {
    /// Nothing is predicted: residuals are the lanes, not zigzagged.
    None = 0,
    /// The left neighbour.
    Left = 1,
    /// The left neighbour and the slope above.
    Plane = 2,
    /// The left neighbour and half of the slope above, over two texels.
    Slope = 3,
}

impl Predictor {
    /// All predictors, by number.
    pub(super) const ALL: [Self; 4] = [Self::None, Self::Left, Self::Plane, Self::Slope];

    /// What is predicted for texel `x` of a row.
    ///
    /// # Shapes
    ///
    /// `above` is the row above, empty for the first; `left` the texels of this row before `x`.
    fn predict<L: Lane>(self, above: &[L], left: &[L]) -> L {
        let x = left.len();
        let Some(&l) = left.last() else {
            return match self {
                Self::None => L::default(),
                _ => above.first().copied().unwrap_or_default(),
            };
        };
        let slope = match (self, above) {
            (Self::None, _) => return L::default(),
            (Self::Left, _) | (_, []) => L::default(),
            (Self::Plane, _) => above[x].wrapping_sub(above[x - 1]),
            (Self::Slope, _) => {
                let right = above.get(x + 1).copied().unwrap_or(above[x]);
                slope(above[x - 1], above[x], right)
            }
        };
        l.wrapping_add(slope)
    }
}

/// `(u + ur - 2 ul) / 4`, rounded down, as signed lanes that wrap.
#[inline(always)]
fn slope<L: Lane>(ul: L, u: L, ur: L) -> L {
    u.wrapping_sub(ul).wrapping_add(ur.wrapping_sub(ul)).quarter()
}

/// Writes the residuals of one row.
///
/// # Shapes
///
/// `above` is the row above, empty for the first; the others are one row each.
#[inline(always)]
pub(super) fn residual_row<L: Lane>(p: Predictor, above: &[L], row: &[L], residuals: &mut [L]) {
    if p == Predictor::None {
        residuals.copy_from_slice(row);
        return;
    }
    residuals[0] = row[0].wrapping_sub(above.first().copied().unwrap_or_default()).zigzag();
    let steps = residuals[1..].iter_mut().zip(row[1..].iter().zip(row));
    match (p, above) {
        (Predictor::None | Predictor::Left, _) | (_, []) => {
            for (residual, (&v, &l)) in steps {
                *residual = v.wrapping_sub(l).zigzag();
            }
        }
        (Predictor::Plane, _) => {
            for ((residual, (&v, &l)), (&u, &ul)) in steps.zip(above[1..].iter().zip(above)) {
                *residual = v.wrapping_sub(l).wrapping_sub(u.wrapping_sub(ul)).zigzag();
            }
        }
        (Predictor::Slope, _) => {
            let aboves = above.iter().zip(&above[1..]).zip(&above[2..]);
            for ((residual, (&v, &l)), ((&ul, &u), &ur)) in steps.zip(aboves) {
                *residual = v.wrapping_sub(l).wrapping_sub(slope(ul, u, ur)).zigzag();
            }
            let last = row.len() - 1;
            let slope = slope(above[last - 1], above[last], above[last]);
            residuals[last] = row[last].wrapping_sub(row[last - 1]).wrapping_sub(slope).zigzag();
        }
    }
}

/// Turns the residuals in `row` into lanes: the inverse of [`residual_row`].
#[inline(always)]
pub(super) fn restore_row<L: Lane>(p: Predictor, above: &[L], row: &mut [L]) {
    if p == Predictor::None {
        return;
    }
    row[0] = row[0].unzigzag().wrapping_add(above.first().copied().unwrap_or_default());
    match (p, above) {
        (Predictor::None | Predictor::Left, _) | (_, []) => {
            for v in &mut row[1..] {
                *v = v.unzigzag();
            }
        }
        (Predictor::Plane, _) => {
            for ((v, &u), &ul) in row[1..].iter_mut().zip(&above[1..]).zip(above) {
                *v = v.unzigzag().wrapping_add(u.wrapping_sub(ul));
            }
        }
        (Predictor::Slope, _) => {
            let last = row.len() - 1;
            let inner = row[1..last].iter_mut().zip(above).zip(&above[1..]).zip(&above[2..]);
            for (((v, &ul), &u), &ur) in inner {
                *v = v.unzigzag().wrapping_add(slope(ul, u, ur));
            }
            let slope = slope(above[last - 1], above[last], above[last]);
            row[last] = row[last].unzigzag().wrapping_add(slope);
        }
    }
    sum_up(row);
}

/// Replaces each lane by the sum of all up to it. Eight at a time in three steps: an addition that
/// waits for the one before it would be slower.
#[inline(always)]
fn sum_up<L: Lane>(row: &mut [L]) {
    let mut sum = L::default();
    let (chunks, rest) = row.as_chunks_mut::<8>();
    for chunk in chunks {
        let sums = with_before::<4, L>(with_before::<2, L>(with_before::<1, L>(*chunk)));
        *chunk = sums.map(|lane| lane.wrapping_add(sum));
        sum = chunk[7];
    }
    for lane in rest {
        sum = sum.wrapping_add(*lane);
        *lane = sum;
    }
}

/// Each lane and the one `DISTANCE` before it.
#[inline(always)]
fn with_before<const DISTANCE: usize, L: Lane>(lanes: [L; 8]) -> [L; 8] {
    let mut sums = lanes;
    for i in DISTANCE..8 {
        sums[i] = lanes[i].wrapping_add(lanes[i - DISTANCE]);
    }
    sums
}

/// Gives every lane without coverage the value of its prediction, so that its residual is 0.
pub(super) fn fill_holes<L: Lane>(p: Predictor, coverage: &[u8], side: usize, lanes: &mut [L]) {
    for y in 0..side {
        let coverage = &coverage[y * side..][..side];
        if coverage::all(coverage) {
            continue;
        }
        let (above, rows) = lanes.split_at_mut(y * side);
        let above = &above[y.saturating_sub(1) * side..];
        let row = &mut rows[..side];
        let last = side - 1;
        // The ends are cases of their own.
        if coverage[0] == 0 {
            row[0] = p.predict(above, &[]);
        }
        let steps = above.iter().zip(above.iter().skip(1));
        match p {
            Predictor::None => {
                for (lane, &covered) in row.iter_mut().zip(coverage) {
                    *lane = if covered == 0 { L::default() } else { *lane };
                }
            }
            Predictor::Plane if y > 0 => {
                fill_row(coverage, row, steps.map(|(&ul, &u)| u.wrapping_sub(ul)));
            }
            Predictor::Slope if y > 0 => {
                let steps = steps.zip(above.iter().skip(2));
                fill_row(coverage, row, steps.map(|((&ul, &u), &ur)| slope(ul, u, ur)));
            }
            _ => fill_row(coverage, row, std::iter::repeat(L::default())),
        }
        if coverage[last] == 0 {
            row[last] = p.predict(above, &row[..last]);
        }
    }
}

/// [`fill_holes`] in a row from its second lane on, as far as there are slopes.
#[inline(always)]
fn fill_row<L: Lane>(coverage: &[u8], row: &mut [L], slopes: impl Iterator<Item = L>) {
    let mut left = row[0];
    for ((lane, &covered), slope) in row[1..].iter_mut().zip(&coverage[1..]).zip(slopes) {
        if covered == 0 {
            *lane = left.wrapping_add(slope);
        }
        left = *lane;
    }
}

/// The predictor with the least bits in its residuals, and that number, from every sixteenth row of
/// a large page and every row of a small one. Ties go to the lower number.
///
/// Only texels with coverage count; to their neighbours those without hold the last covered lane
/// before them in the row, or 0, so that the rims of holes are no cliffs.
///
/// # Shapes
///
/// `fill(y, row)` writes row `y`, `side` lanes; `rows` has room for three.
pub(super) fn cheapest<L: Lane>(
    side: usize,
    coverage: Option<&[u8]>,
    rows: &mut [L],
    fill: impl Fn(usize, &mut [L]),
) -> (Predictor, u64) {
    vectorized(Cheapest { side, coverage, rows, fill })
}

struct Cheapest<'a, L, F> {
    side: usize,
    coverage: Option<&'a [u8]>,
    rows: &'a mut [L],
    fill: F,
}

impl<L: Lane, F: Fn(usize, &mut [L])> Wide for Cheapest<'_, L, F> {
    type Output = (Predictor, u64);

    #[inline(always)]
    fn run(self) -> (Predictor, u64) {
        let Self { side, coverage, rows, fill } = self;
        let apart = if side < 64 { 1 } else { 16 };
        let (above, rows) = rows.split_at_mut(side);
        let (row, rows) = rows.split_at_mut(side);
        let residuals = &mut rows[..side];
        let mut costs = [0_u64; 4];
        for y in (apart - 1..side).step_by(apart) {
            let filled = |y: usize, row: &mut [L]| {
                fill(y, row);
                if let Some(coverage) = coverage {
                    coverage::hold(&coverage[y * side..][..side], row);
                }
            };
            filled(y, row);
            let above = if y == 0 {
                &[][..]
            } else {
                filled(y - 1, above);
                &*above
            };
            let coverage = coverage.map(|coverage| &coverage[y * side..][..side]);
            for (predictor, cost) in Predictor::ALL.into_iter().zip(&mut costs) {
                residual_row(predictor, above, row, residuals);
                *cost += u64::from(match coverage {
                    None => residuals.iter().map(|&residual| bit_length(residual)).sum::<u32>(),
                    Some(coverage) => {
                        let bits = |(&residual, &covered): (&L, &u8)| {
                            if covered == 0 { 0 } else { bit_length(residual) }
                        };
                        residuals.iter().zip(coverage).map(bits).sum::<u32>()
                    }
                });
            }
        }
        let mut best = (Predictor::None, costs[0]);
        for (predictor, cost) in Predictor::ALL.into_iter().zip(costs) {
            if cost < best.1 {
                best = (predictor, cost);
            }
        }
        best
    }
}

/// The bit length of a residual, rounded to f32 first: its exponent, which is a vector instruction
/// away where counting leading zeros is not.
#[inline(always)]
fn bit_length<L: Lane>(residual: L) -> u32 {
    (residual.into() as f32).to_bits().saturating_sub(126 << 23) >> 23
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SIDE: usize = 7;

    fn rows(lanes: &[u16]) -> impl Iterator<Item = (&[u16], &[u16])> {
        (0..SIDE).map(|y| {
            (&lanes[y.saturating_sub(1) * SIDE..y * SIDE], &lanes[y * SIDE..(y + 1) * SIDE])
        })
    }

    #[test]
    fn a_plane_has_no_residual_inside() {
        let lanes: Vec<u16> = (0..49).map(|i| 100 + i % 7 * 3 + i / 7 * 5).collect();
        let mut residuals = [0; SIDE];
        for (above, row) in rows(&lanes).skip(1) {
            residual_row(Predictor::Plane, above, row, &mut residuals);
            assert_eq!(residuals, [10, 0, 0, 0, 0, 0, 0]);
        }
        let fill = |y: usize, row: &mut [u16]| row.copy_from_slice(&lanes[y * SIDE..][..SIDE]);
        assert_eq!(cheapest(SIDE, None, &mut [0; 3 * SIDE], fill).0, Predictor::Plane);
    }

    proptest! {
        #[test]
        fn rows_come_back_and_residuals_are_those_of_the_formula(
            lanes in prop::collection::vec(any::<u16>(), SIDE * SIDE)
        ) {
            for predictor in Predictor::ALL {
                for (above, row) in rows(&lanes) {
                    let mut residuals = [0; SIDE];
                    residual_row(predictor, above, row, &mut residuals);
                    for x in 0..SIDE {
                        let residual = row[x].wrapping_sub(predictor.predict(above, &row[..x]));
                        let residual = if predictor == Predictor::None { residual } else { residual.zigzag() };
                        prop_assert_eq!(residuals[x], residual, "{:?} {}", predictor, x);
                    }
                    restore_row(predictor, above, &mut residuals);
                    prop_assert_eq!(&residuals[..], row);
                }
            }
        }

        #[test]
        fn holes_cost_nothing(
            mut lanes in prop::collection::vec(any::<u16>(), SIDE * SIDE),
            coverage in prop::collection::vec(0_u8..2, SIDE * SIDE),
        ) {
            for predictor in Predictor::ALL {
                fill_holes(predictor, &coverage, SIDE, &mut lanes);
                for ((above, row), coverage) in rows(&lanes).zip(coverage.chunks(SIDE)) {
                    let mut residuals = [0; SIDE];
                    residual_row(predictor, above, row, &mut residuals);
                    for (residual, covered) in residuals.into_iter().zip(coverage) {
                        prop_assert!(residual == 0 || *covered != 0);
                    }
                }
            }
        }
    }
}
