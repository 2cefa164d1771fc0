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
//! Here the lanes come in blocks of 64, so that a block is eight u64 in each plane; what is beyond
//! the last texel is zero and not stored.
//!
//! # References
//!
//! K. Masui et al., *A compression scheme for radio data in high performance computing*, Astronomy
//! and Computing 12, 2015 (bitshuffle); H. S. Warren, *Hacker's Delight*, section 7-3 (the 8x8
//! transposition).

/// Lanes in a block.
pub(super) const BLOCK: usize = 64;

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
    lanes.div_ceil(BLOCK) * 8
}

/// Writes the planes of `lanes`, plane `k` at `k * stride`.
///
/// Planes in a byte (eight planes) that `union`, the bitwise or of all lanes, shows empty are left
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
            let mut words = [0; 8];
            for (word, bytes) in words.iter_mut().zip(bytes.as_chunks().0) {
                *word = transpose_bits(u64::from_le_bytes(*bytes));
            }
            for (plane, word) in transpose_bytes(words).into_iter().enumerate() {
                planes[plane * stride + block * 8..][..8].copy_from_slice(&word.to_le_bytes());
            }
        }
    }
}

/// The inverse of [`shuffle`]: bytes of lanes whose planes are all `empty` become zero unread.
///
/// # Shapes
///
/// As for [`shuffle`]; bit `k` of `live` says that plane `k` may hold a one.
pub(super) fn unshuffle<L: Lane>(planes: &[u8], live: u32, lanes: &mut [L]) {
    let stride = stride(lanes.len());
    let mut first = true;
    for (byte, planes) in planes.chunks_exact(8 * stride).take(L::BITS / 8).enumerate() {
        if (live >> (8 * byte)) & 0xff == 0 {
            continue;
        }
        for (block, lanes) in lanes.as_chunks_mut::<BLOCK>().0.iter_mut().enumerate() {
            let mut words = [0; 8];
            for (plane, word) in words.iter_mut().enumerate() {
                let bytes = planes[plane * stride + block * 8..].first_chunk();
                *word = u64::from_le_bytes(*bytes.expect("a plane holds every block"));
            }
            let mut bytes = [0; BLOCK];
            for (bytes, word) in bytes.as_chunks_mut().0.iter_mut().zip(transpose_bytes(words)) {
                *bytes = transpose_bits(word).to_le_bytes();
            }
            if first {
                for (lane, value) in lanes.iter_mut().zip(bytes) {
                    *lane = L::from_byte(value, byte);
                }
            } else {
                for (lane, value) in lanes.iter_mut().zip(bytes) {
                    *lane = lane.or(L::from_byte(value, byte));
                }
            }
        }
        first = false;
    }
    if first {
        lanes.fill(L::default());
    }
}

/// Transposes eight bytes of eight bits: bit `c` of byte `r` becomes bit `r` of byte `c`.
#[inline(always)]
const fn transpose_bits(mut x: u64) -> u64 {
    let swap = (x ^ (x >> 7)) & 0x00aa_00aa_00aa_00aa;
    x ^= swap ^ (swap << 7);
    let swap = (x ^ (x >> 14)) & 0x0000_cccc_0000_cccc;
    x ^= swap ^ (swap << 14);
    let swap = (x ^ (x >> 28)) & 0x0000_0000_f0f0_f0f0;
    x ^ swap ^ (swap << 28)
}

/// Transposes eight words of eight bytes: byte `c` of word `r` becomes byte `r` of word `c`.
#[inline(always)]
fn transpose_bytes(mut words: [u64; 8]) -> [u64; 8] {
    for (distance, mask) in
        [(4, 0x0000_0000_ffff_ffff), (2, 0x0000_ffff_0000_ffff), (1, 0x00ff_00ff_00ff_00ff)]
    {
        let shift = 8 * distance;
        for low in 0..8 {
            if low & distance == 0 {
                let swap = ((words[low] >> shift) ^ words[low | distance]) & mask;
                words[low] ^= swap << shift;
                words[low | distance] ^= swap;
            }
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
        let planes = planes_of(lanes);
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
        for lane in 0..128 {
            for bit in 0..32 {
                let mut lanes = [0_u32; 128];
                lanes[lane] = 1 << bit;
                let planes = planes_of(&lanes);
                let ones: Vec<_> = (0..planes.len()).filter(|&at| planes[at] != 0).collect();
                assert_eq!(ones, [bit * 16 + lane / 8]);
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
        fn planes_hold_the_bits_of_u8_lanes(lanes: [[u8; 32]; 6]) {
            check(lanes.as_flattened());
        }

        #[test]
        fn planes_hold_the_bits_of_u16_lanes(lanes: [[u16; 32]; 6], keep: u16) {
            check(&lanes.as_flattened().iter().map(|lane| lane & keep).collect::<Vec<_>>());
        }

        #[test]
        fn planes_hold_the_bits_of_u32_lanes(lanes: [[u32; 32]; 4], shift in 0..32) {
            check(&lanes.as_flattened().iter().map(|lane| lane >> shift).collect::<Vec<_>>());
        }
    }
}
