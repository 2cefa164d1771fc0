//! What pages are made of: `f32` heights, NaN where invalid, or `i16` heights in whole meters or `u8`
//! codes of colors and normals, 0 there.
//!
//! Everything from reading to writing is generic over the three, so that each runs at its own width.

mod color;
mod height;
mod whole_height;

pub(crate) use self::color::{code, light};

use areoid_formats::archive::{ConstantTexel, Description};
use areoid_formats::bound;
use areoid_formats::codec::{EncodeError, Quantum, Scratch};
use areoid_formats::lanes::{greatest, least};
use areoid_formats::page::Kind;

/// A leaf's texels, one plane a channel.
#[derive(Clone, Debug, PartialEq)]
pub enum Planes {
    /// Meters, NaN where invalid.
    Height(Vec<f32>),
    /// Whole meters, 0 where invalid.
    WholeHeight(Vec<i16>),
    /// Red, green and blue codes, or those of a normal's x, y and z; 0 where invalid.
    Color([Vec<u8>; 3]),
}

/// The planes of a page under construction, lent.
#[derive(Clone, Copy, Debug)]
pub enum PlanesView<'a> {
    /// Meters, NaN where invalid.
    Height(&'a [f32]),
    /// Whole meters.
    WholeHeight(&'a [i16]),
    /// Red, green and blue codes.
    Color([&'a [u8]; 3]),
}

/// How texels are averaged, and what their mean is stored on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mean {
    /// Heights, on a step or on none.
    OfHeights(Quantum),
    /// Colors as light, on whole codes.
    OfColors,
    /// Normals as their codes are, on whole ones.
    OfNormals,
}

impl Mean {
    /// That of a dataset.
    #[must_use]
    pub fn of(description: &Description) -> Self {
        match description.kind {
            Kind::Height => Self::OfHeights(description.quantum),
            Kind::Color => Self::OfColors,
            Kind::Normal => Self::OfNormals,
        }
    }

    /// The step of heights, or none.
    pub(crate) fn quantum(self) -> Quantum {
        match self {
            Self::OfHeights(quantum) => quantum,
            Self::OfColors | Self::OfNormals => Quantum::NONE,
        }
    }
}

/// A texel of one channel.
pub trait Texel: bound::Texel<Cell: bytemuck::Pod> + bytemuck::Pod + std::fmt::Debug {
    /// Channels of a page.
    const CHANNELS: usize;
    /// What stands where there is no data; coverage says so.
    const INVALID: Self;
    /// The least and greatest finest texel where there is none.
    const NOTHING: (Self, Self);

    /// The planes of a leaf of this kind, whose `alpha` is 0 where a texel is invalid.
    ///
    /// # Panics
    ///
    /// If they are of another kind.
    fn channels(planes: Planes, alpha: Option<&[u8]>) -> Vec<Vec<Self>>;

    /// The channels of a page, lent.
    ///
    /// # Panics
    ///
    /// If there are not as many as [`Self::CHANNELS`].
    fn view(channels: &[Vec<Self>]) -> PlanesView<'_>;

    /// Puts the channels of a leaf on the step, and returns what they were if that changed any;
    /// `None` if a texel cannot be stored.
    fn to_step(planes: &mut [Vec<Self>], quantum: Quantum) -> Option<Option<Vec<Vec<Self>>>>;

    /// `value` as it is stored: on the step for heights, else a whole code. The value is a
    /// mean of stored ones.
    fn stored(value: f64, quantum: Quantum) -> Self;

    /// The mean of one to four valid texels, as it is stored; summed in f64 from the first on, of
    /// colors the light.
    fn mean(texels: &[Self], mean: Mean) -> Self;

    /// [`Self::mean`] of two by two texels, for each pair of columns of two rows.
    fn halve(rows: [&[Self]; 2], mean: Mean, out: &mut [Self]);

    /// What a low-pass sums of each texel, as [`Self::mean`] does: of colors the light, else what it
    /// stands for. Of an invalid one anything.
    #[inline(always)]
    fn linear(texels: &[Self], _: Mean, out: &mut [f64]) {
        for (out, &texel) in out.iter_mut().zip(texels) {
            *out = texel.into();
        }
    }

    /// The texels nearest such sums, as they are stored, none less than the first or greater than the
    /// second of `range`, which are valid ones.
    fn nearest(sums: &[f64], range: [&[Self]; 2], mean: Mean, out: &mut [Self]);

    /// The texel of a page that has no other, as its entry stores it.
    fn constant(texels: &[Self]) -> ConstantTexel;

    /// The payload of a page, in `payload`.
    ///
    /// # Errors
    ///
    /// [`EncodeError`] if a texel cannot be stored, which rounding to the step rules out.
    fn encode(
        planes: &[Vec<Self>],
        coverage: Option<&[u8]>,
        description: &Description,
        scratch: &mut Scratch,
        payload: &mut Vec<u8>,
    ) -> Result<(), EncodeError>;
}

/// [`Texel::nearest`] where what is summed is what texels stand for. They are on the step: so is what
/// a sum outside their range becomes, and it can be stored.
#[inline(always)]
fn nearest_within<S: Texel>(sums: &[f64], [low, high]: [&[S]; 2], quantum: Quantum, out: &mut [S]) {
    for (((out, &sum), &low), &high) in out.iter_mut().zip(sums).zip(low).zip(high) {
        // A zero is positive, as it is in rasters that were read.
        *out = S::stored(greatest(least(sum, high.into()), low.into()) + 0.0, quantum);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// The same as of floats.
        #[test]
        fn halved_rows_of_whole_heights_are_means(upper: [i16; 6], lower: [i16; 6]) {
            let meters = Mean::OfHeights(Quantum::new(1.0, 0.0).unwrap());
            let mut halved = [0; 3];
            i16::halve([&upper, &lower], meters, &mut halved);
            for (col, texel) in halved.into_iter().enumerate() {
                let [a, b] = [2 * col, 2 * col + 1];
                let texels = [upper[a], upper[b], lower[a], lower[b]];
                let mean = f32::mean(&texels.map(f32::from), meters);
                prop_assert_eq!(f32::from(texel), mean);
                prop_assert_eq!(i16::mean(&texels, meters), texel);
            }
        }

        #[test]
        fn halved_rows_are_means(
            upper: [i16; 6], lower: [i16; 6],
            step in prop::sample::select(vec![0.0, 1.0, 0.25, 0.1]),
        ) {
            let quantum = Quantum::new(step, 0.0).unwrap();
            let on_step = |row: [i16; 6]| row.map(|texel| f32::stored(f64::from(texel) / 8.0, quantum));
            let (upper, lower) = (on_step(upper), on_step(lower));
            let mut halved = [0.0; 3];
            let mean = Mean::OfHeights(quantum);
            f32::halve([&upper, &lower], mean, &mut halved);
            for (col, texel) in halved.into_iter().enumerate() {
                let [a, b] = [2 * col, 2 * col + 1];
                let one = f32::mean(&[upper[a], upper[b], lower[a], lower[b]], mean);
                prop_assert_eq!(texel.to_bits(), one.to_bits());
            }
        }
    }
}
