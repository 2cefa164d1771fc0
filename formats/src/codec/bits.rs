//! Lanes into bit planes, and back.
//!
//! A lane is an unsigned integer of 8, 16 or 32 bits. Bit `k` of lane `i` is bit `i mod 8` of byte
//! `i / 8` of plane `k`:
//!
//! ```text
//!   lanes    l0 l1 l2 ..            planes   bit 0 of  l0 l1 l2 l3 l4 l5 l6 l7 | l8 ..
//!            each w bits      ->             bit 1 of  l0 l1 ..
//! ```
//!
//! Small residuals leave the upper planes empty or sparse, and noise is confined to the lower ones.
//! In memory the lanes come in whole blocks; what is beyond the last texel is not stored.
//!
//! # References
//!
//! K. Masui et al., *A compression scheme for radio data in high performance computing*, Astronomy
//! and Computing 12, 2015 (bitshuffle); H. S. Warren, *Hacker's Delight*, section 7-3 (the 8x8
//! transposition).

/// Words of a plane that are handled at once: enough for the compiler to make vectors of them, few
/// enough for the fastest cache.
const WIDTH: usize = 16;

/// Lanes in a block.
pub(super) const BLOCK: usize = 64 * WIDTH;

/// Bytes of a block in one plane.
const BLOCK_BYTES: usize = 8 * WIDTH;

/// An unsigned integer that wraps: the unit of prediction and of bit planes.
pub(super) trait Lane: Copy + Default + PartialEq + Into<u32> {
    /// Bits of a lane, which is also the number of its planes.
    const BITS: usize;

    fn wrapping_add(self, other: Self) -> Self;
    fn wrapping_sub(self, other: Self) -> Self;
    fn or(self, other: Self) -> Self;

    /// The lane as a signed number, divided by 4 towards minus infinity.
    fn quarter(self) -> Self;

    /// Signed numbers to unsigned, small to small: 0, -1, 1, -2, .. to 0, 1, 2, 3, ..
    fn zigzag(self) -> Self;

    /// The inverse of [`Self::zigzag`].
    fn unzigzag(self) -> Self;

    /// Byte `byte` of the lane, 0 the least significant.
    fn byte(self, byte: usize) -> u8;

    /// A lane whose byte `byte` is `value`, the others 0.
    fn from_byte(value: u8, byte: usize) -> Self;
}

macro_rules! lane {
    ($lane:ty) => {
        impl Lane for $lane {
            const BITS: usize = <$lane>::BITS as usize;

            #[inline(always)]
            fn wrapping_add(self, other: Self) -> Self {
                <$lane>::wrapping_add(self, other)
            }

            #[inline(always)]
            fn wrapping_sub(self, other: Self) -> Self {
                <$lane>::wrapping_sub(self, other)
            }

            #[inline(always)]
            fn or(self, other: Self) -> Self {
                self | other
            }

            #[inline(always)]
            fn quarter(self) -> Self {
                (self.cast_signed() >> 2).cast_unsigned()
            }

            #[inline(always)]
            fn zigzag(self) -> Self {
                (self << 1) ^ (self.cast_signed() >> (<$lane>::BITS - 1)).cast_unsigned()
            }

            #[inline(always)]
            fn unzigzag(self) -> Self {
                (self >> 1) ^ (self & 1).wrapping_neg()
            }

            #[inline(always)]
            #[allow(clippy::cast_possible_truncation, reason = "a byte is what is asked for")]
            fn byte(self, byte: usize) -> u8 {
                (self >> (8 * byte)) as u8
            }

            #[inline(always)]
            fn from_byte(value: u8, byte: usize) -> Self {
                <$lane>::from(value) << (8 * byte)
            }
        }
    };
}

lane!(u8);
lane!(u16);
lane!(u32);

/// Bytes of a plane in memory: whole blocks.
pub(super) const fn stride(lanes: usize) -> usize {
    lanes.div_ceil(BLOCK) * BLOCK_BYTES
}

/// Writes the planes of `lanes`, plane `k` at `k * stride`.
///
/// Where `union`, the bitwise or of all lanes, shows the eight planes of a byte empty, they are left
/// as they are.
///
/// # Shapes
///
/// `lanes` is whole blocks; `planes` is `L::BITS` strides.
pub(super) fn shuffle<L: Lane>(lanes: &[L], union: L, planes: &mut [u8]) {
    let stride = stride(lanes.len());
    for (byte, planes) in planes.chunks_exact_mut(8 * stride).enumerate() {
        if union.byte(byte) == 0 {
            continue;
        }
        for (block, lanes) in lanes.as_chunks::<BLOCK>().0.iter().enumerate() {
            let bytes = lanes.map(|lane| lane.byte(byte));
            let mut words = [[0; WIDTH]; 8];
            for (i, bytes) in bytes.as_chunks().0.iter().enumerate() {
                words[i % 8][i / 8] = u64::from_le_bytes(*bytes);
            }
            each_column(&mut words, |column| transpose_bits(transpose_bytes(column)));
            for (plane, words) in words.iter().enumerate() {
                let bytes = &mut planes[plane * stride + block * BLOCK_BYTES..][..BLOCK_BYTES];
                for (bytes, word) in bytes.as_chunks_mut().0.iter_mut().zip(words) {
                    *bytes = word.to_le_bytes();
                }
            }
        }
    }
}

/// The inverse of [`shuffle`]; the eight planes of a byte that is not live are taken for empty.
///
/// # Shapes
///
/// As for [`shuffle`]; bit `k` of `live` says that plane `k` may hold a one.
pub(super) fn unshuffle<L: Lane>(planes: &[u8], live: u32, lanes: &mut [L]) {
    let stride = stride(lanes.len());
    for (block, lanes) in lanes.as_chunks_mut::<BLOCK>().0.iter_mut().enumerate() {
        let mut values = [L::default(); BLOCK];
        for (byte, planes) in planes.chunks_exact(8 * stride).enumerate() {
            if (live >> (8 * byte)) & 0xff == 0 {
                continue;
            }
            let mut words = [[0; WIDTH]; 8];
            for (plane, words) in words.iter_mut().enumerate() {
                let bytes = &planes[plane * stride + block * BLOCK_BYTES..][..BLOCK_BYTES];
                for (bytes, word) in bytes.as_chunks().0.iter().zip(words) {
                    *word = u64::from_le_bytes(*bytes);
                }
            }
            each_column(&mut words, |column| transpose_bytes(transpose_bits(column)));
            let mut bytes = [0; BLOCK];
            for (i, bytes) in bytes.as_chunks_mut().0.iter_mut().enumerate() {
                *bytes = words[i % 8][i / 8].to_le_bytes();
            }
            for (value, bits) in values.iter_mut().zip(bytes) {
                *value = value.or(L::from_byte(bits, byte));
            }
        }
        *lanes = values;
    }
}

/// Replaces every column of eight words. The columns are independent, and so become vectors.
#[inline(always)]
fn each_column(words: &mut [[u64; WIDTH]; 8], transposed: impl Fn([u64; 8]) -> [u64; 8]) {
    let [a, b, c, d, e, f, g, h] = words;
    for i in 0..WIDTH {
        let column = [a[i], b[i], c[i], d[i], e[i], f[i], g[i], h[i]];
        [a[i], b[i], c[i], d[i], e[i], f[i], g[i], h[i]] = transposed(column);
    }
}

/// In each byte, by itself: bit `c` of word `r` becomes bit `r` of word `c`. Its own inverse.
#[inline(always)]
fn transpose_bits(column: [u64; 8]) -> [u64; 8] {
    let column = exchange::<4, 4>(column, 0x0f0f_0f0f_0f0f_0f0f);
    let column = exchange::<2, 2>(column, 0x3333_3333_3333_3333);
    exchange::<1, 1>(column, 0x5555_5555_5555_5555)
}

/// Byte `c` of word `r` becomes byte `r` of word `c`. Its own inverse.
#[inline(always)]
fn transpose_bytes(column: [u64; 8]) -> [u64; 8] {
    let column = exchange::<4, 32>(column, 0x0000_0000_ffff_ffff);
    let column = exchange::<2, 16>(column, 0x0000_ffff_0000_ffff);
    exchange::<1, 8>(column, 0x00ff_00ff_00ff_00ff)
}

/// One step of a transposition: of two words `DISTANCE` apart, the first gives its upper fields for
/// the lower fields of the second. `mask` has the lower fields.
#[inline(always)]
fn exchange<const DISTANCE: usize, const SHIFT: u32>(mut words: [u64; 8], mask: u64) -> [u64; 8] {
    for low in 0..8 {
        if low & DISTANCE == 0 {
            let swap = ((words[low] >> SHIFT) ^ words[low + DISTANCE]) & mask;
            words[low] ^= swap << SHIFT;
            words[low + DISTANCE] ^= swap;
        }
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn planes_of<L: Lane>(lanes: &[L]) -> Vec<u8> {
        let mut planes = vec![0; L::BITS * stride(lanes.len())];
        let union = lanes.iter().fold(L::default(), |union, &lane| union.or(lane));
        shuffle(lanes, union, &mut planes);
        planes
    }

    fn check<L: Lane + std::fmt::Debug>(lanes: &[L]) {
        let lanes: Vec<L> = lanes.iter().copied().cycle().take(2 * BLOCK).collect();
        let planes = planes_of(&lanes);
        let stride = stride(lanes.len());
        for (i, &lane) in lanes.iter().enumerate() {
            for k in 0..L::BITS {
                let bit = planes[k * stride + i / 8] >> (i % 8) & 1;
                assert_eq!(u32::from(bit), lane.into() >> k & 1, "bit {k} of lane {i}");
            }
        }
        let mut back = vec![L::from_byte(0xff, 0); lanes.len()];
        unshuffle(&planes, u32::MAX, &mut back);
        assert_eq!(back, lanes);
    }

    #[test]
    fn each_single_bit_lands_where_the_format_says() {
        for lane in (0..BLOCK).step_by(5).chain([63, 64, BLOCK - 1]) {
            for bit in 0..32 {
                let mut lanes = [0_u32; BLOCK];
                lanes[lane] = 1 << bit;
                let planes = planes_of(&lanes);
                let ones: Vec<_> = (0..planes.len()).filter(|&at| planes[at] != 0).collect();
                assert_eq!(ones, [bit * BLOCK_BYTES + lane / 8]);
                assert_eq!(planes[ones[0]], 1 << (lane % 8));
            }
        }
    }

    #[test]
    fn zigzag_is_one_to_one_and_keeps_small_small() {
        assert_eq!([0_u8, 255, 1, 254, 2, 128].map(Lane::zigzag), [0, 1, 2, 3, 4, 255]);
        for lane in 0..=u16::MAX {
            assert_eq!(lane.zigzag().unzigzag(), lane);
        }
    }

    proptest! {
        #[test]
        fn planes_hold_the_bits_of_u8_lanes(lanes: [[u8; 31]; 7]) {
            check(lanes.as_flattened());
        }

        #[test]
        fn planes_hold_the_bits_of_u16_lanes(lanes: [[u16; 31]; 7], keep: u16) {
            check(&lanes.as_flattened().iter().map(|lane| lane & keep).collect::<Vec<_>>());
        }

        #[test]
        fn planes_hold_the_bits_of_u32_lanes(lanes: [[u32; 31]; 5], shift in 0..32) {
            check(&lanes.as_flattened().iter().map(|lane| lane >> shift).collect::<Vec<_>>());
        }
    }
}
