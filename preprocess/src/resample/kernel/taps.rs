//! Two, four or six taps along each axis: the kernels at their own width.
//!
//! ```text
//!   64 texels:  places ──▶ weights of all ──▶ for each texel: rows × weights ──▶ columns × weights
//!               (f64)      (64 lanes)         (4 or 8 lanes)                     (64 lanes)
//! ```
//!
//! What is summed is differences from the pixel beside the texel: where pixels are equal, the texel
//! is that value to the bit whatever the weights' rounding, and f32 rounds what the terrain does
//! near the texel and not its height above the reference.

use areoid_formats::lanes::{self, Wide};

use super::super::window::View;
use super::weights::Pieces;

/// Texels that are computed at once.
pub(super) const ROW: usize = 64;

/// Adding it leaves a whole number in the lowest bits.
pub(super) const ROUNDER: f64 = 6_755_399_441_055_744.0;

/// Where the taps of a row of texels begin, and what their weights depend on.
struct Spots {
    /// Indices of the first tap of the first row.
    at: [u32; ROW],
    /// Along columns, the way from the middle between two pixels, in -1/2 ..= 1/2.
    u: [f32; ROW],
    /// Along rows.
    v: [f32; ROW],
}

impl Spots {
    /// For taps that begin `before` pixels before the one beside a texel, which is `later` pixels
    /// farther along both axes.
    #[inline(always)]
    fn new(u: &[f64; ROW], v: &[f64; ROW], view: View<'_>, before: i64, later: f64) -> Self {
        let (col, row) = ((view.col + before) as f64, (view.row + before) as f64);
        let stride = view.stride as f64;
        let mut spots = Self { at: [0; ROW], u: [0.0; ROW], v: [0.0; ROW] };
        for lane in 0..ROW {
            let (u, v) = ((u[lane] + later) - col, (v[lane] + later) - row);
            let (col, row) = (u.floor(), v.floor());
            #[expect(clippy::cast_possible_truncation, reason = "fractions; the lowest bits")]
            {
                spots.u[lane] = (u - col - 0.5) as f32;
                spots.v[lane] = (v - row - 0.5) as f32;
                spots.at[lane] = (row * stride + col + ROUNDER).to_bits() as u32;
            }
        }
        spots
    }
}

/// A row of coordinates, the last of fewer repeated.
#[inline(always)]
fn padded(coords: &[f64]) -> [f64; ROW] {
    let mut row = [coords[coords.len() - 1]; ROW];
    row[..coords.len()].copy_from_slice(coords);
    row
}

/// A row of coordinates as it is if it is full, else padded into `room`.
#[inline(always)]
pub(super) fn full<'a>(coords: &'a [f64], room: &'a mut [f64; ROW]) -> &'a [f64; ROW] {
    match coords.try_into() {
        Ok(row) => row,
        Err(_) => {
            *room = padded(coords);
            room
        }
    }
}

/// Work on texels whose coordinates are `u` and `v`, `ROW` by `ROW`.
struct Rows<'a, T> {
    texels: T,
    u: &'a [f64],
    v: &'a [f64],
    out: &'a mut [f32],
}

/// What is done with a row of texels.
trait Texels {
    /// Memory that rows use again.
    type Room;

    fn room() -> Self::Room;

    fn row(&self, u: &[f64; ROW], v: &[f64; ROW], room: &mut Self::Room, out: &mut [f32; ROW]);
}

impl<T: Texels> Wide for Rows<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { texels, u, v, out } = self;
        let rows = u.chunks(ROW).zip(v.chunks(ROW)).zip(out.chunks_mut(ROW));
        let (mut room, mut padding) = (T::room(), [[0.0; ROW]; 2]);
        for ((u, v), out) in rows {
            let [padding_u, padding_v] = &mut padding;
            let (u, v) = (full(u, padding_u), full(v, padding_v));
            let mut row = [0.0; ROW];
            let is_full = out.len() == ROW;
            let to = if is_full { out.try_into().expect("a row") } else { &mut row };
            texels.row(u, v, &mut room, to);
            if !is_full {
                out.copy_from_slice(&row[..out.len()]);
            }
        }
    }
}

/// Indices of the pixels whose cells hold texels; a texel between two belongs to the later.
///
/// `each` is called with as many as there are texels, a row at a time.
pub(super) fn nearest(u: &[f64], v: &[f64], view: View<'_>, each: impl FnMut(&[u32])) {
    struct Nearest<'a, F> {
        u: &'a [f64],
        v: &'a [f64],
        view: View<'a>,
        each: F,
    }
    impl<F: FnMut(&[u32])> Wide for Nearest<'_, F> {
        type Output = ();

        #[inline(always)]
        fn run(self) {
            let Self { u, v, view, mut each } = self;
            let mut padding = [[0.0; ROW]; 2];
            for (us, vs) in u.chunks(ROW).zip(v.chunks(ROW)) {
                let [padding_u, padding_v] = &mut padding;
                let (u, v) = (full(us, padding_u), full(vs, padding_v));
                each(&Spots::new(u, v, view, 0, 0.5).at[..us.len()]);
            }
        }
    }
    lanes::vectorized(Nearest { u, v, view, each });
}

/// Two taps along each axis, linear between them.
///
/// # Panics
///
/// If a tap lies outside the view. See [`separable`].
pub(super) fn bilinear(u: &[f64], v: &[f64], view: View<'_>, out: &mut [f32]) {
    lanes::vectorized(Rows { texels: Bilinear { view }, u, v, out });
}

struct Bilinear<'a> {
    view: View<'a>,
}

impl Texels for Bilinear<'_> {
    type Room = ();

    fn room() {}

    #[inline(always)]
    fn row(&self, u: &[f64; ROW], v: &[f64; ROW], (): &mut (), out: &mut [f32; ROW]) {
        let spots = Spots::new(u, v, self.view, 0, 0.0);
        let stride = self.view.stride;
        let [mut a, mut b, mut c, mut d] = [[0.0_f32; ROW]; 4];
        for lane in 0..ROW {
            let taps = &self.view.data[spots.at[lane] as usize..][..stride + 2];
            (a[lane], b[lane]) = (taps[0], taps[1]);
            (c[lane], d[lane]) = (taps[stride], taps[stride + 1]);
        }
        for lane in 0..ROW {
            let (right, down) = (spots.u[lane] + 0.5, spots.v[lane] + 0.5);
            let upper = (b[lane] - a[lane]) * right;
            let lower = (c[lane] - a[lane]) + (d[lane] - c[lane]) * right;
            out[lane] = a[lane] + (upper + (lower - upper) * down);
        }
    }
}

/// `2 * PAIRS` taps along each axis with the weights of `pieces`; `LOAD` floats of a row are looked
/// at, which is that number or the next power of two.
///
/// # Shapes
///
/// `u`, `v` and `out` have an entry a texel. The view has [`View::SLACK`] floats behind each row.
///
/// # Panics
///
/// If a tap lies outside the view.
pub(super) fn separable<const PAIRS: usize, const TERMS: usize, const LOAD: usize>(
    pieces: &Pieces<PAIRS, TERMS>,
    u: &[f64],
    v: &[f64],
    view: View<'_>,
    out: &mut [f32],
) {
    let texels = Separable::<PAIRS, TERMS, LOAD> { pieces, view };
    lanes::vectorized(Rows { texels, u, v, out });
}

/// What is known of a row of texels before its sums.
struct Taps<const LOAD: usize> {
    /// Weights of the columns of taps, and of the rows.
    across: [[f32; ROW]; LOAD],
    down: [[f32; ROW]; LOAD],
    /// The pixels beside texels.
    beside: [f32; ROW],
    /// Sums along columns, stored and not summed at once: the compiler would take the sum's order
    /// for the taps'.
    columns: [[f32; LOAD]; ROW],
}

struct Separable<'a, const PAIRS: usize, const TERMS: usize, const LOAD: usize> {
    pieces: &'a Pieces<PAIRS, TERMS>,
    view: View<'a>,
}

impl<const PAIRS: usize, const TERMS: usize, const LOAD: usize> Texels
    for Separable<'_, PAIRS, TERMS, LOAD>
{
    type Room = Taps<LOAD>;

    fn room() -> Taps<LOAD> {
        Taps {
            across: [[0.0; ROW]; LOAD],
            down: [[0.0; ROW]; LOAD],
            beside: [0.0; ROW],
            columns: [[0.0; LOAD]; ROW],
        }
    }

    #[inline(always)]
    fn row(&self, u: &[f64; ROW], v: &[f64; ROW], room: &mut Taps<LOAD>, out: &mut [f32; ROW]) {
        let Taps { across, down, beside, columns } = room;
        let spots = Spots::new(u, v, self.view, PAIRS as i64 - 1, 0.0);
        let stride = self.view.stride;
        self.pieces.at(&spots.u, across);
        self.pieces.at(&spots.v, down);

        let last = 2 * PAIRS - 1;
        for texel in 0..ROW {
            let taps = &self.view.data[spots.at[texel] as usize..][..last * stride + LOAD];
            let center = taps[(PAIRS - 1) * stride + PAIRS - 1];
            let mut sums = [0.0_f32; LOAD];
            for (tap, weights) in down[..=last].iter().enumerate() {
                let line = row::<LOAD>(taps, tap * stride);
                let weight = weights[texel];
                for col in 0..LOAD {
                    sums[col] += (line[col] - center) * weight;
                }
            }
            columns[texel] = sums;
            beside[texel] = center;
        }
        for texel in 0..ROW {
            let mut sum = 0.0;
            for tap in 0..=last {
                sum += columns[texel][tap] * across[tap][texel];
            }
            out[texel] = beside[texel] + sum;
        }
    }
}

#[inline(always)]
fn row<const LOAD: usize>(taps: &[f32], at: usize) -> &[f32; LOAD] {
    taps[at..at + LOAD].try_into().expect("that many")
}

/// Brings texels between the least and the greatest of the `2 * reach` pixels around them along
/// columns and along rows that have data: `alpha` stands beside the pixels, `None` where all have.
///
/// # Panics
///
/// If one lies outside the view.
pub(super) fn limit(
    reach: [i64; 2],
    u: &[f64],
    v: &[f64],
    (view, alpha): (View<'_>, Option<&[u8]>),
    out: &mut [f32],
) {
    let [cols, rows] = reach.map(|reach| usize::try_from(2 * reach).expect("not negative"));
    let [left, above] = reach.map(|reach| (1 - reach) as f64);
    for ((&u, &v), texel) in u.iter().zip(v).zip(out) {
        let first = view.index(u.floor() + left, v.floor() + above);
        let (mut least, mut greatest) = (f32::INFINITY, f32::NEG_INFINITY);
        for row in 0..rows {
            let line = first + row * view.stride..first + row * view.stride + cols;
            let valid = alpha.map(|alpha| &alpha[line.clone()]);
            for (at, &pixel) in view.data[line].iter().enumerate() {
                if valid.is_none_or(|valid| valid[at] != 0) {
                    least = lanes::least(pixel, least);
                    greatest = lanes::greatest(pixel, greatest);
                }
            }
        }
        // Without a pixel the texel is none either.
        if least <= greatest {
            *texel = texel.clamp(least, greatest);
        }
    }
}
