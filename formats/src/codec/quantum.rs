//! The step that heights are stored on.
//!
//! A page of heights is stored as integers: `value(q) = offset + q step`, computed in f64 and
//! rounded once to f32. What is on the step survives storage bit for bit; what is not must be
//! rounded first, by [`Quantum::round`], and half a step goes into the page's bound.

use serde::{Deserialize, Serialize};

/// The integer step heights are stored on: `value(q) = offset + q step`.
///
/// # Units
///
/// `step` and `offset` are meters, as the heights are.
///
/// # Domain
///
/// A step of 0 is [`Quantum::NONE`]: float32 kept bit for bit. Otherwise the step is from 1e-30 to
/// 1e28 and the offset within ±1e37, so that every i32 has a finite value. The fields are public
/// for reading them from files; the codecs check them again.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Quantum {
    /// Distance between two stored values, in meters; 0 for none.
    pub step: f64,
    /// The value of index 0, in meters.
    pub offset: f64,
}

/// A step or offset outside the domain of [`Quantum`].
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("no quantum has step {step} and offset {offset}")]
pub struct QuantumError {
    step: f64,
    offset: f64,
}

/// Adding and subtracting 1.5 2^52 rounds an f64 below 2^51 to an integer, ties to even, in two
/// instructions that exist as vectors everywhere.
const ROUNDER: f64 = 6_755_399_441_055_744.0;

impl Quantum {
    /// No step: any finite float32, bit for bit.
    pub const NONE: Self = Self { step: 0.0, offset: 0.0 };

    /// A step, or [`Quantum::NONE`] from a step and an offset of 0.
    ///
    /// # Errors
    ///
    /// [`QuantumError`] outside the domain of the type.
    pub fn new(step: f64, offset: f64) -> Result<Self, QuantumError> {
        // Adding 0 turns an offset of -0.0 into 0.0: one quantum, one writing.
        Self { step: step + 0.0, offset: offset + 0.0 }.checked()
    }

    /// Itself, if it lies in the domain of the type.
    pub(super) fn checked(self) -> Result<Self, QuantumError> {
        let Self { step, offset } = self;
        let none = step == 0.0 && offset == 0.0;
        if none || ((1e-30..=1e28).contains(&step) && offset.abs() <= 1e37) {
            Ok(self)
        } else {
            Err(QuantumError { step, offset })
        }
    }

    /// Whether heights are kept as floats, bit for bit.
    #[must_use]
    pub fn is_none(&self) -> bool {
        self.step == 0.0
    }

    /// The stored value nearest `value`, or `None` if there is none in reach of an i32.
    ///
    /// Without a step that is the nearest f32.
    ///
    /// # Precision
    ///
    /// The index is the f64 quotient `(value - offset) / step` rounded to an integer, ties to even.
    /// Where offset and step are dyadic the quotient, and so the tie, is exact; elsewhere a value
    /// within 2^-52 of a midpoint, relatively, may go either way. The result is within half a step,
    /// plus half an ulp of an f32, of `value`.
    #[must_use]
    pub fn round(&self, value: f64) -> Option<f32> {
        if self.is_none() {
            #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the point")]
            let nearest = value as f32;
            return nearest.is_finite().then_some(nearest);
        }
        let index = ((value - self.offset) / self.step).round_ties_even();
        if !(f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(&index) {
            return None; // NaN too
        }
        #[expect(clippy::cast_possible_truncation, reason = "an integer in range")]
        Some(self.value(index as i32))
    }

    /// The index whose value is `texel` bit for bit, or `None` if there is none.
    ///
    /// Where several are (a step finer than float32 resolves), the one nearest in f64. Without a
    /// step nothing has an index.
    #[must_use]
    pub fn index(&self, texel: f32) -> Option<i32> {
        if self.is_none() || !texel.is_finite() {
            return None;
        }
        let nearest = self.nearest(texel);
        // Floats below a power of two are twice as dense as those above it: the index nearest that
        // power may belong to the float below, and its neighbor, farther above, to the power.
        [nearest, nearest.saturating_sub(1), nearest.saturating_add(1)]
            .into_iter()
            .find(|&index| self.value(index).to_bits() == texel.to_bits())
    }

    /// The value of an index: one multiplication and one addition in f64, one rounding to f32.
    #[must_use]
    #[inline]
    pub fn value(&self, q: i32) -> f32 {
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the point")]
        let value = (self.offset + f64::from(q) * self.step) as f32;
        value
    }

    /// The index nearest `texel`, ties to even; anything if that is out of reach.
    #[inline]
    fn nearest(&self, texel: f32) -> i32 {
        let index = (f64::from(texel) - self.offset) / self.step;
        #[expect(clippy::cast_possible_truncation, reason = "saturates, and the caller checks")]
        let nearest = ((index + ROUNDER) - ROUNDER) as i32;
        nearest
    }

    /// The index of `texel` if it has one and rounding errors do not hide it, else anything.
    ///
    /// `steps_per_meter` is the inverse of the step: a multiplication costs a fraction of a division.
    #[inline(always)]
    pub(super) fn guess(&self, texel: f32, steps_per_meter: f64) -> i32 {
        let sum = (f64::from(texel) - self.offset) * steps_per_meter + ROUNDER;
        #[expect(clippy::cast_possible_truncation, reason = "the low 32 bits are the integer's")]
        let low = sum.to_bits() as u32;
        low.cast_signed()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn ties_go_to_the_even_index() {
        let meters = Quantum::new(1.0, 0.0).unwrap();
        for (value, stored) in [(0.5, 0.0), (1.5, 2.0), (2.5, 2.0), (-0.5, 0.0), (-1.5, -2.0)] {
            assert_eq!(meters.round(value).map(f32::to_bits), Some(f32::to_bits(stored)));
        }
        let halves = Quantum::new(0.5, 0.25).unwrap();
        for (value, stored) in [(0.5, 0.25), (1.0, 1.25), (1.5, 1.25), (0.0, 0.25), (-0.5, -0.75)] {
            assert_eq!(halves.round(value), Some(stored));
        }
    }

    #[test]
    fn an_ulp_beside_a_tie_decides_it() {
        let meters = Quantum::new(1.0, 0.0).unwrap();
        assert_eq!(meters.round(0.5_f64.next_up()), Some(1.0));
        assert_eq!(meters.round(1.5_f64.next_down()), Some(1.0));
    }

    #[test]
    fn indices_end_where_an_i32_does() {
        let meters = Quantum::new(1.0, 0.0).unwrap();
        assert_eq!(meters.round(2_147_483_647.0), Some(2_147_483_648.0));
        assert_eq!(meters.round(2_147_483_648.0), None);
        assert_eq!(meters.round(-2_147_483_648.0), Some(-2_147_483_648.0));
        assert_eq!(meters.round(-2_147_483_649.0), None);
        assert_eq!(meters.round(f64::NAN), None);
        assert_eq!(meters.round(f64::INFINITY), None);
    }

    #[test]
    fn without_a_step_every_finite_float_stays() {
        assert_eq!(Quantum::NONE.round(0.1), Some(0.1));
        assert_eq!(Quantum::NONE.round(1e39), None);
        assert_eq!(Quantum::NONE.round(f64::NAN), None);
        assert_eq!(Quantum::NONE.index(1.0), None);
    }

    #[test]
    fn negative_zero_is_on_no_step() {
        assert_eq!(Quantum::new(1.0, -0.0).unwrap().index(-0.0), None);
        assert_eq!(Quantum::new(1.0, -0.0).unwrap().index(0.0), Some(0));
    }

    /// 2^24 is the float32 of 2^24 + 0.9, but 2^24 - 0.6, which is nearer, has a float of its own.
    #[test]
    fn a_power_of_two_has_its_index_from_the_sparser_side() {
        let quantum = Quantum::new(1.5, 16_777_216.9).unwrap();
        assert_eq!(quantum.value(0), 16_777_216.0);
        assert_eq!(quantum.index(16_777_216.0), Some(0));
        assert_eq!(quantum.index(16_777_215.0), Some(-1));
    }

    #[test]
    fn only_finite_positive_steps_are_quanta() {
        for (step, offset) in
            [(-1.0, 0.0), (f64::NAN, 0.0), (1.0, f64::INFINITY), (0.0, 1.0), (1e-31, 0.0)]
        {
            assert!(Quantum::new(step, offset).is_err(), "{step} {offset}");
        }
        assert_eq!(Quantum::new(-0.0, -0.0), Ok(Quantum::NONE));
        let widest = Quantum::new(1e28, 1e37).unwrap();
        assert!(widest.value(i32::MIN).is_finite() && widest.value(i32::MAX).is_finite());
    }

    proptest! {
        #[test]
        fn every_value_has_an_index_with_that_value(
            q: i32,
            step in prop::sample::select(vec![1.0, 0.5, 0.1, 1e-3, 1e-6, 0.25, 7.0, 1.0 / 3.0]),
            offset in -1e5..1e5,
        ) {
            let quantum = Quantum::new(step, offset).unwrap();
            let texel = quantum.value(q);
            let index = quantum.index(texel);
            prop_assert_eq!(index.map(|index| quantum.value(index).to_bits()), Some(texel.to_bits()));
        }

        #[test]
        fn rounding_moves_by_half_a_step_at_most(value in -1e6..1e6, step in 1e-3..1e3) {
            let quantum = Quantum::new(step, 0.125).unwrap();
            let stored = f64::from(quantum.round(value).unwrap());
            prop_assert!((stored - value).abs() <= 0.5 * step * (1.0 + 1e-9) + value.abs() * 1e-7);
            prop_assert_eq!(quantum.round(stored).map(f64::from), Some(stored));
        }
    }
}
