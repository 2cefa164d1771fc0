//! Reductions over many numbers, several lanes at a time.
//!
//! Sums, least and greatest of floats depend on the order of their terms as far as a compiler
//! knows, so a plain fold handles one at a time. These keep a lane each for every sixteenth number,
//! which becomes vectors.

const LANES: usize = 16;

/// Work that is compiled once for every width of vectors, as plain loops.
///
/// # Contract
///
/// [`Self::run`] and all that is to profit is `#[inline(always)]`: that is how it gets into the
/// function that may use the wider vectors. A closure would not. The result does not depend on how
/// operations are grouped, so it is the same on every processor.
pub trait Wide {
    /// What comes out.
    type Output;

    /// Does the work.
    fn run(self) -> Self::Output;
}

/// Does work with the widest vectors that this processor has.
#[inline]
pub fn vectorized<W: Wide>(work: W) -> W::Output {
    struct Inlined<W>(W);
    impl<W: Wide> pulp::NullaryFnOnce for Inlined<W> {
        type Output = W::Output;

        #[inline(always)]
        fn call(self) -> W::Output {
            self.0.run()
        }
    }
    pulp::Arch::new().dispatch(Inlined(work))
}

/// The least and greatest of `values` and of the two given, which stand for none; NaN counts for
/// nothing.
#[must_use]
pub fn extremes<T: Copy + PartialOrd>(values: &[T], none: (T, T)) -> (T, T) {
    struct Extremes<'a, T>(&'a [T], (T, T));
    impl<T: Copy + PartialOrd> Wide for Extremes<'_, T> {
        type Output = (T, T);

        #[inline(always)]
        fn run(self) -> (T, T) {
            let Self(values, (low, high)) = self;
            // One after the other: together they become no vectors.
            (reduce(values, low, least), reduce(values, high, greatest))
        }
    }
    vectorized(Extremes(values, none))
}

/// [`extremes`] of the values whose coverage is not 0.
#[must_use]
pub fn covered_extremes<T: Copy + PartialOrd>(
    values: &[T],
    coverage: &[u8],
    none: (T, T),
) -> (T, T) {
    struct Covered<'a, T>(&'a [T], &'a [u8], (T, T));
    impl<T: Copy + PartialOrd> Wide for Covered<'_, T> {
        type Output = (T, T);

        #[inline(always)]
        fn run(self) -> (T, T) {
            let Self(values, coverage, none) = self;
            let (mut low, mut high) = none;
            for (values, coverage) in values.chunks(HELD).zip(coverage.chunks(HELD)) {
                low = reduce(&held(values, coverage, none.0)[..values.len()], low, least);
                high = reduce(&held(values, coverage, none.1)[..values.len()], high, greatest);
            }
            (low, high)
        }
    }
    vectorized(Covered(values, coverage, none))
}

const HELD: usize = 256;

/// Values with coverage, and `none` for the others: a loop of its own, which becomes vectors.
#[inline(always)]
fn held<T: Copy>(values: &[T], coverage: &[u8], none: T) -> [T; HELD] {
    let mut held = [none; HELD];
    for ((held, &value), &covered) in held.iter_mut().zip(values).zip(coverage) {
        *held = if covered == 0 { none } else { value };
    }
    held
}

#[inline(always)]
fn reduce<T: Copy>(values: &[T], none: T, pick: impl Fn(T, T) -> T) -> T {
    let mut picked = [none; LANES];
    let (chunks, rest) = values.as_chunks::<LANES>();
    for chunk in chunks {
        for lane in 0..LANES {
            picked[lane] = pick(chunk[lane], picked[lane]);
        }
    }
    picked.iter().chain(rest).fold(none, |picked, &value| pick(value, picked))
}

/// Whether `test` is false for all values. It is called for each, so that it becomes vectors, too.
#[must_use]
#[inline]
pub fn none<T: Copy>(values: &[T], test: impl Fn(T) -> bool) -> bool {
    let mut found = [0_u32; LANES];
    let (chunks, rest) = values.as_chunks::<LANES>();
    for chunk in chunks {
        for lane in 0..LANES {
            found[lane] |= u32::from(test(chunk[lane]));
        }
    }
    found == [0; LANES] && !rest.iter().any(|&value| test(value))
}

/// Which of eight bytes are not 0, a bit each, the first in the lowest.
#[must_use]
#[inline(always)]
pub const fn present(bytes: [u8; 8]) -> u8 {
    // The multiplication moves bit 7 of byte j to bit 56 + j; no two meet on the way.
    (tops(u64::from_le_bytes(bytes)) >> 7).wrapping_mul(0x0102_0408_1020_4080).to_le_bytes()[7]
}

/// Eight bytes, 255 for each bit and 0 elsewhere: the other way round.
#[must_use]
#[inline(always)]
pub const fn spread(bits: u8) -> [u8; 8] {
    let copies = u64::from_le_bytes([bits; 8]);
    ((tops(copies & 0x8040_2010_0804_0201) >> 7) * 255).to_le_bytes()
}

/// The highest bit of each byte that is not 0.
#[inline(always)]
const fn tops(word: u64) -> u64 {
    const LOW: u64 = 0x7f7f_7f7f_7f7f_7f7f;
    (((word & LOW) + LOW) | word) & !LOW
}

/// The first if it is less than the second: one instruction, where `f32::min` with its care for
/// NaN is several.
#[inline(always)]
pub fn least<T: PartialOrd>(a: T, b: T) -> T {
    if a < b { a } else { b }
}

/// The first if it is greater than the second. See [`least`].
#[inline(always)]
pub fn greatest<T: PartialOrd>(a: T, b: T) -> T {
    if a > b { a } else { b }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn bits_are_spread_and_found_again() {
        for bits in 0..=u8::MAX {
            let bytes = spread(bits);
            for (place, &byte) in bytes.iter().enumerate() {
                assert_eq!(byte, if bits >> place & 1 == 1 { 255 } else { 0 });
            }
            assert_eq!(present(bytes), bits);
            assert_eq!(present(bytes.map(|byte| byte & 16)), bits);
        }
    }

    proptest! {
        #[test]
        fn lanes_find_what_a_fold_does(
            mut values in prop::collection::vec(-9_i16..9, 0..70), nan in 0..70_usize, wanted: i16,
        ) {
            let sorted = { let mut sorted = values.clone(); sorted.sort_unstable(); sorted };
            let expected = match (sorted.first(), sorted.last()) {
                (Some(&low), Some(&high)) => (low, high),
                _ => (i16::MAX, i16::MIN),
            };
            prop_assert_eq!(extremes(&values, (i16::MAX, i16::MIN)), expected);
            prop_assert_eq!(none(&values, |v| v == wanted % 10), !values.contains(&(wanted % 10)));

            let coverage: Vec<u8> = values.iter().map(|&v| u8::from(v != wanted % 10)).collect();
            let covered: Vec<i16> = values.iter().copied().filter(|&v| v != wanted % 10).collect();
            let none = (i16::MAX, i16::MIN);
            prop_assert_eq!(covered_extremes(&values, &coverage, none), extremes(&covered, none));

            let mut floats: Vec<f32> = values.iter().map(|&v| f32::from(v)).collect();
            if nan < floats.len() {
                floats[nan] = f32::NAN;
                values.remove(nan);
            }
            let kept = values.iter().copied();
            let low = kept.clone().min().map_or(f32::INFINITY, f32::from);
            let high = kept.max().map_or(f32::NEG_INFINITY, f32::from);
            prop_assert_eq!(extremes(&floats, (f32::INFINITY, f32::NEG_INFINITY)), (low, high));
        }
    }
}
