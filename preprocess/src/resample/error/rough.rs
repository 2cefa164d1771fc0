//! Which pixels of a row may be farther from a leaf than some height: all that are, and few more.
//!
//! ```text
//!   places ─▶ taps and fractions ─▶ four texels ─▶ roughly |R_L - pixel| ─▶ suspects
//!   f64       vectors               one by one     f32, vectors
//! ```
//!
//! Nearly no pixel is off as much as the worst one found before it, and to tell so takes no more than
//! this. Holes are not looked at: a texel without data is NaN or 0 here, as pages have it, and what
//! that does to a place that counts is within [`Slack`].

use areoid_formats::lanes::{Wide, greatest, least, vectorized};

use super::super::tile::TILE;

/// What is rough is off by so much of the largest texel: fractions of 24 bits, and sums of four
/// products of such numbers.
const ROUNDING: f64 = 1.0 / (1_u64 << 20) as f64;

/// And by so much where a tap without data is taken for 0: it weighs half of that at most.
const HOLES: f64 = 1.0 / (1_u64 << 15) as f64;

/// How much what is rough may be too small.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slack(f64);

impl Slack {
    /// Of a leaf whose valid texels lie in `least..=most`, with holes or not.
    pub(super) fn new([least, most]: [f64; 2], has_holes: bool) -> Self {
        // Sums of equal numbers are exact; holes are not equal to what lies beside them.
        let is_exact = !has_holes && least >= most;
        let share = if has_holes { ROUNDING + HOLES } else { ROUNDING };
        Self(if is_exact { 0.0 } else { share * least.abs().max(most.abs()) })
    }

    /// What is rough and no larger than this belongs to nothing larger than `largest`.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "a difference is rounded less than allowed"
    )]
    fn below(self, largest: f64) -> f32 {
        // The difference itself has a rounding error, too.
        (largest - largest.abs() * ROUNDING - self.0) as f32
    }
}

/// A row of at most [`TILE`] pixels, roughly.
#[derive(Debug)]
pub(super) struct Rough {
    count: usize,
    at: [u32; TILE],
    right: [f32; TILE],
    below: [f32; TILE],
    off: [f32; TILE],
}

impl Default for Rough {
    fn default() -> Self {
        Self { count: 0, at: [0; TILE], right: [0.0; TILE], below: [0.0; TILE], off: [0.0; TILE] }
    }
}

impl Rough {
    /// Compares pixels with a page of `side` texels a side whose first texel has its center at
    /// `corner`, column first. Places outside it are taken for its edge.
    ///
    /// # Panics
    ///
    /// If slices are not as long as they have to be.
    pub(super) fn compare<T, P, const CHANNELS: usize>(
        &mut self,
        [us, vs]: [&[f64]; 2],
        corner: [f64; 2],
        (planes, side): ([&[T]; CHANNELS], usize),
        pixels: [&[P]; CHANNELS],
    ) where
        T: Copy + Default + Into<f32>,
        P: Copy + Into<f32>,
    {
        self.count = us.len();
        vectorized(Places { us, vs, corner, side, to: self });
        vectorized(Differences { planes, pixels, side, rough: self });
    }

    /// The pixels that may be farther off than `largest`.
    pub(super) fn suspects(&self, slack: Slack, largest: f64) -> impl Iterator<Item = usize> + '_ {
        let below = slack.below(largest);
        let off = &self.off[..self.count];
        let any = !areoid_formats::lanes::none(off, |off| is_suspect(off, below));
        let all = if any { 0..self.count } else { 0..0 };
        all.filter(move |&pixel| is_suspect(off[pixel], below))
    }
}

/// A difference that is no number is that of a tap without data.
#[inline(always)]
fn is_suspect(off: f32, below: f32) -> bool {
    off.is_nan() || off > below
}

struct Places<'a> {
    us: &'a [f64],
    vs: &'a [f64],
    corner: [f64; 2],
    side: usize,
    to: &'a mut Rough,
}

impl Wide for Places<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { us, vs, corner: [left, top], side, to } = self;
        #[expect(clippy::cast_possible_truncation, reason = "a page is small")]
        let stride = side as u32;
        // The last texel has no other to its right.
        let last = side as f64 - 1.25;
        let (at, right, below) = (&mut to.at[..], &mut to.right[..], &mut to.below[..]);
        let out = at.iter_mut().zip(right).zip(below);
        for ((&u, &v), ((at, right), below)) in us.iter().zip(vs).zip(out) {
            let (across, fraction) = split(least(greatest(u - left, 0.0), last));
            let (down, fraction_down) = split(least(greatest(v - top, 0.0), last));
            *at = down * stride + across;
            (*right, *below) = (fraction, fraction_down);
        }
    }
}

/// A place from 0 on: the whole number below it, or its own or the one before if it is whole, and
/// what is left, up to 1.
///
/// Numbers at 1.5·2⁵² are whole and have them in their low bits: a cast would not become a vector.
#[inline(always)]
fn split(place: f64) -> (u32, f32) {
    const WHOLE: f64 = 1.5 * (1_u64 << 52) as f64;
    let shifted = (place - 0.5) + WHOLE;
    #[expect(clippy::cast_possible_truncation, reason = "the bits wanted; the rounding promised")]
    let parts = (shifted.to_bits() as u32, (place - (shifted - WHOLE)) as f32);
    parts
}

struct Differences<'a, T, P, const CHANNELS: usize> {
    planes: [&'a [T]; CHANNELS],
    pixels: [&'a [P]; CHANNELS],
    side: usize,
    rough: &'a mut Rough,
}

impl<T, P, const CHANNELS: usize> Wide for Differences<'_, T, P, CHANNELS>
where
    T: Copy + Default + Into<f32>,
    P: Copy + Into<f32>,
{
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { planes, pixels, side, rough } = self;
        let Rough { count, at, right, below, off } = rough;
        let (at, off) = (&at[..*count], &mut off[..*count]);
        let mut taps = [[T::default(); TILE]; 4];
        for (channel, (plane, pixels)) in planes.into_iter().zip(pixels).enumerate() {
            let [one, two, three, four] = &mut taps;
            let columns = one.iter_mut().zip(two).zip(three.iter_mut().zip(four));
            for (&at, ((one, two), (three, four))) in at.iter().zip(columns) {
                let near = &plane[at as usize..at as usize + side + 2];
                (*one, *two) = (near[0], near[1]);
                (*three, *four) = (near[side], near[side + 1]);
            }
            let pixels = &pixels[..off.len()];
            for at in 0..off.len() {
                let [a, b, c, d] =
                    [taps[0][at], taps[1][at], taps[2][at], taps[3][at]].map(Into::into);
                let (upper, lower) = (a + (b - a) * right[at], c + (d - c) * right[at]);
                let pixel: f32 = pixels[at].into();
                let this = (upper + (lower - upper) * below[at] - pixel).abs();
                // A pixel without data is NaN, and nothing is far from it; any other NaN stays.
                let this = if pixel.is_nan() { f32::NEG_INFINITY } else { this };
                off[at] = if channel > 0 && this <= off[at] { off[at] } else { this };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SIDE: usize = 6;

    /// The reconstruction at a place, of valid taps alone; `None` where others weigh too much.
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "places in a page")]
    fn exact(texels: &[f32], holes: &[bool], [x, y]: [f64; 2]) -> Option<f64> {
        let [col, row] = [x, y].map(|place| place.floor().min((SIDE - 2) as f64));
        let (right, below) = (x - col, y - row);
        let (mut sum, mut valid) = (0.0, 0.0);
        for (down, across) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            let at = (row as usize + down) * SIDE + col as usize + across;
            let weight = [1.0 - right, right][across] * [1.0 - below, below][down];
            if !holes[at] {
                sum += weight * f64::from(texels[at]);
                valid += weight;
            }
        }
        (valid >= 1.0 - super::super::NO_WEIGHT).then(|| sum / valid)
    }

    /// Along an axis, in the interior: anywhere, on a texel, and so near one that the next weighs next
    /// to nothing.
    fn any_place() -> impl Strategy<Value = f64> {
        let near = prop::sample::select(vec![0.0, 1e-9, -1e-9, 1.4e-5, -1.4e-5]);
        prop_oneof![
            0.5..SIDE as f64 - 1.5,
            (1..SIDE - 2, near).prop_map(|(texel, off)| texel as f64 + off),
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

        #[test]
        fn what_is_farther_off_is_suspect(
            noise in prop::collection::vec(-1.0_f32..1.0, SIDE * SIDE),
            (offset, relief) in prop::sample::select(
                vec![(0.0, 1.0), (4000.0, 1e-3), (4000.0, 0.0), (-1e30, 1e28), (0.0, 1e38)]),
            holes in prop::collection::vec(prop::bool::weighted(0.2), SIDE * SIDE),
            has_holes: bool,
            places in prop::collection::vec([any_place(), any_place()], 16),
            off in prop::collection::vec(-2.0_f32..2.0, 16),
        ) {
            let holes: Vec<bool> = holes.into_iter().map(|hole| hole && has_holes).collect();
            let stored = |(noise, &hole): (f32, &bool)| if hole { 0.0 } else { offset + relief * noise };
            let texels: Vec<f32> = noise.into_iter().zip(&holes).map(stored).collect();
            let valid = || texels.iter().zip(&holes).filter(|&(_, &hole)| !hole).map(|(&texel, _)| texel);
            let range = [valid().fold(f32::INFINITY, f32::min), valid().fold(f32::NEG_INFINITY, f32::max)];
            let slack = Slack::new(range.map(f64::from), has_holes);
            // In f64, equal errors may differ by so much.
            let rounding = 1e-14 * f64::from(offset.abs() + relief);
            let pixels: Vec<f32> = off.into_iter().map(|off| offset + relief * off).collect();
            let errors: Vec<Option<f64>> = places
                .iter()
                .zip(&pixels)
                .map(|(&place, &pixel)| Some((exact(&texels, &holes, place)? - f64::from(pixel)).abs()))
                .collect();

            let [us, vs] = [0, 1].map(|axis| places.iter().map(|place| place[axis]).collect::<Vec<_>>());
            let mut rough = Rough::default();
            rough.compare([&us[..], &vs[..]], [0.0; 2], ([&texels[..]], SIDE), [&pixels[..]]);
            for &largest in errors.iter().flatten() {
                let suspects: Vec<usize> = rough.suspects(slack, largest).collect();
                for (pixel, error) in errors.iter().enumerate() {
                    let is_larger = error.is_some_and(|error| error > largest + rounding);
                    prop_assert!(!is_larger || suspects.contains(&pixel), "{pixel}: {error:?} {largest}");
                }
            }
        }
    }
}
