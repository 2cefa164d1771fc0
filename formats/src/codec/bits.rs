//! Lanes into bit planes, and back.
//!
//! A lane is an unsigned integer of 8, 16 or 32 bits. A byte of plane `k` has bit `k` of eight lanes
//! one below the other: bit `r` of byte `b side + x` is that of row `8 b + r`, column `x`.
//!
//! ```text
//!   lanes    row 0   a0 a1 a2 ..      plane k    bytes of band 0   x = 0: bit k of a0 b0 c0 .. h0
//!   band 0   row 1   b0 b1 b2 ..  ->                               x = 1: bit k of a1 b1 c1 .. h1
//!            ..                                  bytes of band 1   ..
//!            row 7   h0 h1 h2 ..
//! ```
//!
//! Small residuals leave the upper planes empty or sparse, and noise is confined to the lower ones.
//! Eight lanes below one another are as near as eight in a row, and turning them into a byte needs no
//! shuffling of bytes: registers are rows, and bits move between registers in place.
//!
//! # References
//!
//! K. Masui et al., *A compression scheme for radio data in high performance computing*, Astronomy
//! and Computing 12, 2015 (bitshuffle); H. S. Warren, *Hacker's Delight*, section 7-3 (the 8x8
//! transposition).

/// Rows of a band: the bits of a byte.
pub(super) const BAND: usize = 8;

/// Columns that are turned at once: as many bytes as the widest registers have.
const COLUMNS: usize = 64;

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

/// Lanes of a row in memory: whole turns of columns.
pub(super) const fn stride(side: usize) -> usize {
    side.next_multiple_of(COLUMNS)
}

/// Eight rows of a band's bytes, or the same columns of eight planes.
type Square = [[u64; COLUMNS / 8]; BAND];

/// Writes byte `byte` of the lanes of a band to the eight planes that it has.
///
/// # Shapes
///
/// `rows` is eight rows, each padded to [`stride`]; `planes` gives the `side` bytes that the band has
/// in each plane.
#[inline(always)]
pub(super) fn turn<L: Lane>(rows: &[L], byte: usize, mut planes: [&mut [u8]; BAND]) {
    let side = planes[0].len();
    let stride = stride(side);
    for start in (0..side).step_by(COLUMNS) {
        let mut square = Square::default();
        for (words, row) in square.iter_mut().zip(rows.chunks_exact(stride)) {
            let row: &[L; COLUMNS] = row[start..].first_chunk().expect("rows are padded");
            let bytes = row.map(|lane| lane.byte(byte));
            for (word, bytes) in words.iter_mut().zip(bytes.as_chunks().0) {
                *word = u64::from_le_bytes(*bytes);
            }
        }
        transpose(&mut square);
        let end = side.min(start + COLUMNS);
        for (words, plane) in square.iter().zip(&mut planes) {
            let bytes: [u8; COLUMNS] = bytes_from(words);
            match plane[start..].first_chunk_mut() {
                Some(whole) => *whole = bytes,
                None => plane[start..end].copy_from_slice(&bytes[..end - start]),
            }
        }
    }
}

/// The inverse of [`turn`]: sets byte `byte` of lanes in which it is 0. A plane that is `None` is
/// empty.
///
/// # Shapes
///
/// As for [`turn`]; what lies past the last column comes out as anything.
#[inline(always)]
pub(super) fn turn_back<L: Lane>(planes: [Option<&[u8]>; BAND], byte: usize, rows: &mut [L]) {
    let Some(side) = planes.iter().flatten().next().map(|plane| plane.len()) else { return };
    let stride = stride(side);
    for start in (0..side).step_by(COLUMNS) {
        let mut square = Square::default();
        for (words, plane) in square.iter_mut().zip(planes) {
            let Some(plane) = plane else { continue };
            let mut bytes = [0; COLUMNS];
            match plane[start..].first_chunk() {
                Some(whole) => bytes = *whole,
                None => bytes[..side - start].copy_from_slice(&plane[start..]),
            }
            for (word, bytes) in words.iter_mut().zip(bytes.as_chunks().0) {
                *word = u64::from_le_bytes(*bytes);
            }
        }
        transpose(&mut square);
        for (words, row) in square.iter().zip(rows.chunks_exact_mut(stride)) {
            let row: &mut [L; COLUMNS] = row[start..].first_chunk_mut().expect("rows are padded");
            for (lane, bits) in row.iter_mut().zip(bytes_from(words)) {
                *lane = lane.or(L::from_byte(bits, byte));
            }
        }
    }
}

#[inline(always)]
fn bytes_from(words: &[u64; COLUMNS / 8]) -> [u8; COLUMNS] {
    let mut bytes = [0; COLUMNS];
    for (bytes, word) in bytes.as_chunks_mut().0.iter_mut().zip(words) {
        *bytes = word.to_le_bytes();
    }
    bytes
}

/// Turns every column of bytes. The words of a row are independent, and so become vectors.
#[inline(always)]
fn transpose(square: &mut Square) {
    let [a, b, c, d, e, f, g, h] = square;
    for i in 0..COLUMNS / 8 {
        let column = [a[i], b[i], c[i], d[i], e[i], f[i], g[i], h[i]];
        [a[i], b[i], c[i], d[i], e[i], f[i], g[i], h[i]] = transpose_bits(column);
    }
}

/// In each byte, by itself: bit `c` of word `r` becomes bit `r` of word `c`. Its own inverse.
#[inline(always)]
fn transpose_bits(column: [u64; 8]) -> [u64; 8] {
    let column = exchange::<4, 4>(column, 0x0f0f_0f0f_0f0f_0f0f);
    let column = exchange::<2, 2>(column, 0x3333_3333_3333_3333);
    exchange::<1, 1>(column, 0x5555_5555_5555_5555)
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

    const SIDE: usize = 70;

    fn planes_of<L: Lane>(rows: &[L]) -> Vec<[u8; SIDE]> {
        let mut planes = vec![[0; SIDE]; L::BITS];
        for (byte, planes) in planes.as_chunks_mut::<BAND>().0.iter_mut().enumerate() {
            turn(rows, byte, planes.each_mut().map(|plane| &mut plane[..]));
        }
        planes
    }

    fn check<L: Lane + std::fmt::Debug>(lanes: &[L]) {
        let stride = stride(SIDE);
        let rows: Vec<L> = lanes.iter().copied().cycle().take(BAND * stride).collect();
        let planes = planes_of(&rows);
        for (k, plane) in planes.iter().enumerate() {
            for (x, byte) in plane.iter().enumerate() {
                for r in 0..BAND {
                    let bit = rows[r * stride + x].into() >> k & 1;
                    assert_eq!(u32::from(byte >> r & 1), bit, "bit {k} of row {r}, column {x}");
                }
            }
        }
        let mut back = vec![L::default(); rows.len()];
        for (byte, planes) in planes.as_chunks::<BAND>().0.iter().enumerate() {
            let empty = |plane: &[u8; SIDE]| plane.iter().all(|&byte| byte == 0);
            let planes = planes.each_ref().map(|plane| (!empty(plane)).then_some(&plane[..]));
            turn_back(planes, byte, &mut back);
        }
        for (row, back) in rows.chunks(stride).zip(back.chunks(stride)) {
            assert_eq!(back[..SIDE], row[..SIDE]);
        }
    }

    #[test]
    fn each_single_bit_lands_where_the_format_says() {
        let stride = stride(SIDE);
        for x in [0, 1, 7, 8, 63, 64, 69] {
            for (r, bit) in (0..8).flat_map(|r| (0..32).map(move |bit| (r, bit))) {
                let mut rows = vec![0_u32; BAND * stride];
                rows[r * stride + x] = 1 << bit;
                let mut expected = vec![[0; SIDE]; 32];
                expected[bit][x] = 1 << r;
                assert_eq!(planes_of(&rows), expected);
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
