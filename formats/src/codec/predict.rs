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

/// Adds `sign` times the slopes of the row above to `row`, its first texel aside.
fn add_slopes<L: Lane>(predictor: Predictor, above: &[L], row: &mut [L], add: impl Fn(L, L) -> L) {
    let Some(last) = above.len().checked_sub(1) else { return };
    match predictor {
        Predictor::None | Predictor::Left => {}
        Predictor::Plane => {
            for ((v, &u), &ul) in row[1..].iter_mut().zip(&above[1..]).zip(above) {
                *v = add(*v, u.wrapping_sub(ul));
            }
        }
        Predictor::Slope => {
            let inner = row[1..].iter_mut().zip(above).zip(&above[1..]).zip(&above[2..]);
            for (((v, &ul), &u), &ur) in inner {
                *v = add(*v, slope(ul, u, ur));
            }
            row[last] = add(row[last], slope(above[last - 1], above[last], above[last]));
        }
    }
}

/// Writes the residuals of one row.
///
/// # Shapes
///
/// `above` is the row above, empty for the first; the others are one row each.
pub(super) fn residual_row<L: Lane>(p: Predictor, above: &[L], row: &[L], residuals: &mut [L]) {
    if p == Predictor::None {
        residuals.copy_from_slice(row);
        return;
    }
    residuals[0] = row[0].wrapping_sub(above.first().copied().unwrap_or_default());
    for ((residual, &v), &l) in residuals[1..].iter_mut().zip(&row[1..]).zip(row) {
        *residual = v.wrapping_sub(l);
    }
    add_slopes(p, above, residuals, L::wrapping_sub);
    for residual in residuals {
        *residual = residual.zigzag();
    }
}

/// Turns the residuals in `row` into lanes: the inverse of [`residual_row`].
pub(super) fn restore_row<L: Lane>(p: Predictor, above: &[L], row: &mut [L]) {
    if p == Predictor::None {
        return;
    }
    for residual in &mut *row {
        *residual = residual.unzigzag();
    }
    row[0] = row[0].wrapping_add(above.first().copied().unwrap_or_default());
    add_slopes(p, above, row, L::wrapping_add);
    let mut sum = L::default();
    for v in row {
        sum = sum.wrapping_add(*v);
        *v = sum;
    }
}

/// Gives every lane without coverage the value of its prediction, so that its residual is 0.
pub(super) fn fill_holes<L: Lane>(p: Predictor, coverage: &[u8], side: usize, lanes: &mut [L]) {
    for y in 0..side {
        let (above, rows) = lanes.split_at_mut(y * side);
        let above = &above[y.saturating_sub(1) * side..];
        let row = &mut rows[..side];
        for (x, &covered) in coverage[y * side..][..side].iter().enumerate() {
            if covered == 0 {
                row[x] = p.predict(above, &row[..x]);
            }
        }
    }
}

/// The predictor with the least bits in its residuals, and that number, from every eighth row of a
/// large page and every row of a small one. Ties go to the lower number.
pub(super) fn cheapest<L: Lane>(lanes: &[L], side: usize) -> (Predictor, u64) {
    let apart = if side < 64 { 1 } else { 8 };
    let mut residuals = vec![L::default(); side];
    let mut costs = [0_u64; 4];
    for y in (apart - 1..side).step_by(apart) {
        let above = if y == 0 { &[][..] } else { &lanes[(y - 1) * side..y * side] };
        let row = &lanes[y * side..][..side];
        for (predictor, cost) in Predictor::ALL.into_iter().zip(&mut costs) {
            residual_row(predictor, above, row, &mut residuals);
            let bits = |&residual: &L| u32::BITS - residual.into().leading_zeros();
            *cost += residuals.iter().map(bits).map(u64::from).sum::<u64>();
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
        assert_eq!(cheapest(&lanes, SIDE).0, Predictor::Plane);
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
