//! The bytes of one bit plane: nothing, raw, sparse, or LZ4, whichever is least.
//!
//! Planes of noise stay raw and decode at the speed of a copy. Sparse planes, a one here and there,
//! are what LZ4 is bad at: a match needs four bytes alike, which is 32 texels. They are stored as a
//! bitmap of the bytes that are not 0, then those bytes.

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
    /// Decoding a raw plane is so much faster that the others must save a 32nd of it.
    pub(super) fn write(&mut self, plane: &[u8], out: &mut Vec<u8>) -> Method {
        let ones = plane.iter().filter(|&&byte| byte != 0).count();
        if ones == 0 {
            return Method::Zero;
        }
        let raw_len = plane.len() - plane.len() / 32;
        let sparse_len = plane.len().div_ceil(8) + ones;

        self.packed.resize(lz4_flex::block::get_maximum_output_size(plane.len()), 0);
        let lz4_len = compress_into_with_table(plane, &mut self.packed, &mut self.table)
            .expect("the output has LZ4's maximum size");

        if raw_len <= sparse_len.min(lz4_len) {
            out.extend_from_slice(plane);
            Method::Raw
        } else if sparse_len <= lz4_len {
            write_sparse(plane, out);
            Method::Sparse
        } else {
            out.extend_from_slice(&self.packed[..lz4_len]);
            Method::Lz4
        }
    }
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
        Method::Sparse => read_sparse(bytes, plane),
        Method::Lz4 => match decompress_into(bytes, plane) {
            Ok(len) if len == plane.len() => Some(()),
            _ => None,
        },
    }
}

fn write_sparse(plane: &[u8], out: &mut Vec<u8>) {
    out.extend(plane.chunks(8).map(|bytes| {
        bytes.iter().rev().fold(0, |bitmap, &byte| bitmap << 1 | u8::from(byte != 0))
    }));
    out.extend(plane.iter().filter(|&&byte| byte != 0));
}

fn read_sparse(bytes: &[u8], plane: &mut [u8]) -> Option<()> {
    let (bitmap, mut bytes) = bytes.split_at_checked(plane.len().div_ceil(8))?;
    plane.fill(0);
    for (plane, &ones) in plane.chunks_mut(8).zip(bitmap) {
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
        let noise: Vec<u8> = (0..1000_u32)
            .map(|i| (i.wrapping_mul(0x9e37_79b9) >> 20).to_le_bytes()[0] | 1)
            .collect();
        let sparse: Vec<u8> = noise.iter().map(|&n| if n % 16 < 3 { n } else { 0 }).collect();
        assert_eq!(check(&[0; 1000]), Method::Zero);
        assert_eq!(check(&noise), Method::Raw);
        assert_eq!(check(&sparse), Method::Sparse);
        assert_eq!(check(&[7; 1000]), Method::Lz4);
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

    proptest! {
        #[test]
        fn planes_come_back(plane in prop::collection::vec(any::<u8>(), 2..300), keep in 0_u8..=16) {
            check(&plane);
            check(&plane.iter().map(|&byte| if byte % 16 < keep { byte } else { 0 }).collect::<Vec<_>>());
        }
    }
}
