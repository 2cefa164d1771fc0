//! The bytes of one bit plane: nothing, raw, sparse, or LZ4, whichever is least.
//!
//! Planes of noise stay raw and decode at the speed of a copy. Sparse planes, a one here and there,
//! are what LZ4 is bad at: a match needs four bytes alike, which is 32 texels. They are stored as a
//! bitmap of the bytes that are not 0, then those bytes.

use crate::lanes::{Wide, present, vectorized};
use lz4_flex::block::{CompressTable, compress_into_with_table, decompress_into};

/// How a plane is stored. The numbers are those of the format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Method {
    /// Not at all: every bit is 0.
    Zero = 0,
    /// As it is.
    Raw = 1,
    /// A bitmap of the bytes that are not 0, and those bytes.
    Sparse = 2,
    /// One LZ4 block.
    Lz4 = 3,
}

impl Method {
    /// The method of the low two bits of `number`.
    pub(super) const fn from_low_bits(number: u8) -> Self {
        match number & 3 {
            0 => Self::Zero,
            1 => Self::Raw,
            2 => Self::Sparse,
            _ => Self::Lz4,
        }
    }
}

/// Compresses planes one after another; holds LZ4's table and a plane of scratch.
#[derive(Default)]
pub(super) struct PlaneWriter {
    table: CompressTable,
    packed: Vec<u8>,
}

impl std::fmt::Debug for PlaneWriter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("PlaneWriter").finish_non_exhaustive()
    }
}

impl PlaneWriter {
    /// Appends `plane` to `out` by the method that takes the fewest bytes, and says which.
    ///
    /// Decoding a raw plane is so much faster that the others must save a 32nd of it. LZ4 is tried
    /// where it has a chance: on a one here and there it spends four bytes, on a change of byte
    /// therefore two, so that more changes than an eighth of the bytes are better sparse or raw.
    pub(super) fn write(&mut self, plane: &[u8], out: &mut Vec<u8>) -> Method {
        let Counts { ones, changes } = vectorized(Counting(plane));
        if ones == 0 {
            return Method::Zero;
        }
        let raw_len = plane.len() - plane.len() / 32;
        let sparse_len = plane.len().div_ceil(8) + ones;

        let lz4_len = if changes <= plane.len() / 8 {
            self.packed.resize(lz4_flex::block::get_maximum_output_size(plane.len()), 0);
            compress_into_with_table(plane, &mut self.packed, &mut self.table)
                .expect("the output has LZ4's maximum size")
        } else {
            usize::MAX
        };

        if raw_len <= sparse_len.min(lz4_len) {
            out.extend_from_slice(plane);
            Method::Raw
        } else if sparse_len <= lz4_len {
            write_sparse(plane, ones, out);
            Method::Sparse
        } else {
            out.extend_from_slice(&self.packed[..lz4_len]);
            Method::Lz4
        }
    }
}

/// What a plane is like.
struct Counts {
    /// Bytes that are not 0.
    ones: usize,
    /// Bytes that differ from the next.
    changes: usize,
}

struct Counting<'a>(&'a [u8]);

impl Wide for Counting<'_> {
    type Output = Counts;

    #[inline(always)]
    fn run(self) -> Counts {
        let Self(plane) = self;
        Counts {
            ones: count(plane, plane, |byte, _| byte != 0),
            changes: count(plane, &plane[1..], |byte, next| byte != next),
        }
    }
}

/// How many pairs of bytes `counts`: by chunks that fit a u8, which become vectors.
#[inline(always)]
fn count(bytes: &[u8], others: &[u8], counts: impl Fn(u8, u8) -> bool) -> usize {
    let chunks = bytes.chunks(128).zip(others.chunks(128));
    let of_chunk = |(bytes, others): (&[u8], &[u8])| {
        bytes.iter().zip(others).map(|(&byte, &other)| u8::from(counts(byte, other))).sum::<u8>()
    };
    chunks.map(of_chunk).map(usize::from).sum()
}

/// Restores a plane from `bytes` into exactly all of `plane`; `None` if they do not fit.
pub(super) fn read(method: Method, bytes: &[u8], plane: &mut [u8]) -> Option<()> {
    match method {
        Method::Zero => {
            plane.fill(0);
            bytes.is_empty().then_some(())
        }
        Method::Raw => {
            (bytes.len() == plane.len()).then_some(())?;
            plane.copy_from_slice(bytes);
            Some(())
        }
        Method::Sparse => vectorized(ReadSparse { bytes, plane }),
        Method::Lz4 => match decompress_into(bytes, plane) {
            Ok(len) if len == plane.len() => Some(()),
            _ => None,
        },
    }
}

/// Writes bitmap and bytes; `ones` of the bytes are not 0.
fn write_sparse(plane: &[u8], ones: usize, out: &mut Vec<u8>) {
    let (words, rest) = plane.as_chunks();
    out.extend(words.iter().map(|word| present(*word)));
    if !rest.is_empty() {
        let mut word = [0; 8];
        word[..rest.len()].copy_from_slice(rest);
        out.push(present(word));
    }
    let start = out.len();
    // Every byte is written, and the next one overwrites a 0: branches would be guesses. A word has
    // room for 16 bytes, so that no index is out of bounds.
    out.resize(start + ones + 16, 0);
    let bytes = &mut out[start..];
    let mut at = 0;
    for word in words {
        if *word == [0; 8] {
            continue;
        }
        let room: &mut [u8; 16] = bytes[at..].first_chunk_mut().expect("16 bytes more than ones");
        let mut next = 0;
        for &byte in word {
            room[next % 16] = byte;
            next += usize::from(byte != 0);
        }
        at += next;
    }
    for &byte in rest {
        bytes[at] = byte;
        at += usize::from(byte != 0);
    }
    out.truncate(start + ones);
}

/// How eight bytes are spread over the ones of eight bits.
#[derive(Clone, Copy)]
struct Spread {
    /// The bytes that come from four, two and one places before them, in this order.
    moved: [u64; 3],
    /// The bytes where there is a one.
    ones: u64,
}

/// For each eight bits of a bitmap.
///
/// # References
///
/// H. S. Warren, *Hacker's Delight*, section 7-5 (expand), with bytes in place of bits.
static SPREADS: [Spread; 256] = {
    let mut spreads = [Spread { moved: [0; 3], ones: 0 }; 256];
    let mut bits = 0;
    while bits < 256 {
        let (mut place, mut rank) = (0, 0);
        while place < 8 {
            if bits >> place & 1 == 1 {
                let (mut at, mut step) = (rank, 0);
                while step < 3 {
                    if (place - rank) & (4 >> step) != 0 {
                        at += 4 >> step;
                        spreads[bits].moved[step] |= 0xff << (8 * at);
                    }
                    step += 1;
                }
                spreads[bits].ones |= 0xff << (8 * place);
                rank += 1;
            }
            place += 1;
        }
        bits += 1;
    }
    spreads
};

/// The first of `bytes` where `bits` has ones, the first in the lowest, and 0 elsewhere.
#[inline(always)]
fn spread(bytes: [u8; 8], bits: u8) -> [u8; 8] {
    let Spread { moved: [by_four, by_two, by_one], ones } = SPREADS[usize::from(bits)];
    let mut word = u64::from_le_bytes(bytes);
    for (moved, shift) in [(by_four, 32), (by_two, 16), (by_one, 8)] {
        word ^= (word ^ word << shift) & moved;
    }
    (word & ones).to_le_bytes()
}

/// A plane that is read from bitmap and bytes; `None` comes out if they do not fit.
struct ReadSparse<'a> {
    bytes: &'a [u8],
    plane: &'a mut [u8],
}

impl Wide for ReadSparse<'_> {
    type Output = Option<()>;

    #[inline(always)]
    fn run(self) -> Option<()> {
        let Self { bytes, plane } = self;
        let (bitmap, mut bytes) = bytes.split_at_checked(plane.len().div_ceil(8))?;
        for (plane, &ones) in plane.chunks_mut(8).zip(bitmap) {
            if let (Some(plane), Some(next)) = (plane.as_mut_array::<8>(), bytes.first_chunk::<8>())
            {
                *plane = spread(*next, ones);
                bytes = &bytes[ones.count_ones() as usize..];
                continue;
            }
            plane.fill(0);
            let mut left = ones;
            while left != 0 {
                let (&byte, rest) = bytes.split_first()?;
                *plane.get_mut(left.trailing_zeros() as usize)? = byte;
                bytes = rest;
                left &= left - 1;
            }
        }
        bytes.is_empty().then_some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn check(plane: &[u8]) -> Method {
        let mut bytes = Vec::new();
        let method = PlaneWriter::default().write(plane, &mut bytes);
        assert!(bytes.len() <= plane.len());
        let mut back = vec![0xa5; plane.len()];
        assert_eq!(read(method, &bytes, &mut back), Some(()));
        assert_eq!(back, plane);
        if method != Method::Zero {
            assert_eq!(read(method, &bytes[..bytes.len() - 1], &mut back), None);
        }
        method
    }

    #[test]
    fn each_plane_gets_the_method_made_for_it() {
        let mut state = 1_u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            state.to_le_bytes()[3]
        };
        let noise: Vec<u8> = (0..1000).map(|_| random() | 1).collect();
        let sparse: Vec<u8> = noise.iter().map(|&n| if n % 16 < 3 { n } else { 0 }).collect();
        assert_eq!(check(&[0; 1000]), Method::Zero);
        assert_eq!(check(&noise), Method::Raw);
        assert_eq!(check(&sparse), Method::Sparse);
        assert_eq!(check(&[7; 1000]), Method::Lz4);
    }

    #[test]
    fn bytes_that_are_too_few_or_too_many_for_a_plane_are_refused() {
        let plane = [9; 100];
        let shorter = lz4_flex::block::compress(&plane[..99]);
        let longer = lz4_flex::block::compress(&[9; 101]);
        assert_eq!(read(Method::Lz4, &shorter, &mut [0; 100]), None);
        assert_eq!(read(Method::Lz4, &longer, &mut [0; 100]), None);
        for bytes in [&[0b0101, 1][..], &[0b0101, 1, 2, 3], &[0b1_0001, 1, 2], &[]] {
            assert_eq!(read(Method::Sparse, bytes, &mut [0; 4]), None, "{bytes:?}");
        }
        assert_eq!(read(Method::Sparse, &[0b0101, 1, 2], &mut [0; 4]), Some(()));
        assert_eq!(read(Method::Raw, &[1; 5], &mut [0; 4]), None);
        assert_eq!(read(Method::Zero, &[0], &mut [0; 4]), None);
    }

    #[test]
    fn a_reused_table_changes_no_byte() {
        let plane: Vec<u8> = (0..40_000_u32).map(|i| (i / 7 * i % 11).to_le_bytes()[0]).collect();
        let (mut fresh, mut reused) = (Vec::new(), Vec::new());
        PlaneWriter::default().write(&plane, &mut fresh);
        let mut writer = PlaneWriter::default();
        for len in [40_000, 1000, 3, 39_999, 100_000] {
            let other: Vec<u8> = (0..len).map(|i: u32| (i % 13).to_le_bytes()[0]).collect();
            writer.write(&other, &mut Vec::new());
        }
        writer.write(&plane, &mut reused);
        assert_eq!(fresh, reused);
    }

    #[test]
    fn bytes_go_where_the_ones_are() {
        for bits in 0..=u8::MAX {
            let mut expected = [0; 8];
            let places = (0..8).filter(|place| bits >> place & 1 == 1);
            places.zip(1..).for_each(|(place, byte)| expected[place] = byte);
            assert_eq!(spread([1, 2, 3, 4, 5, 6, 7, 8], bits), expected, "{bits:#b}");
        }
    }

    proptest! {
        #[test]
        fn planes_come_back(plane in prop::collection::vec(any::<u8>(), 2..300), keep in 0_u8..=16) {
            check(&plane);
            check(&plane.iter().map(|&byte| if byte % 16 < keep { byte } else { 0 }).collect::<Vec<_>>());
        }
    }
}
