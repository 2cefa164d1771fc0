//! Little-endian numbers at fixed places, and checksums.

use xxhash_rust::xxh3;

/// The `N` bytes of `bytes` from `at`.
///
/// # Panics
///
/// If they are not there: callers check a structure's length once, then take its fields.
pub(super) fn array_at<const N: usize>(bytes: &[u8], at: usize) -> [u8; N] {
    *bytes[at..].first_chunk().expect("the structure's length was checked")
}

pub(super) fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(array_at(bytes, at))
}

pub(super) fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(array_at(bytes, at))
}

pub(super) fn f32_at(bytes: &[u8], at: usize) -> f32 {
    f32::from_le_bytes(array_at(bytes, at))
}

pub(super) fn put(bytes: &mut [u8], at: usize, field: &[u8]) {
    bytes[at..at + field.len()].copy_from_slice(field);
}

/// The checksum of everything but page payloads: XXH3, 64 bits, no seed.
pub(super) fn checksum(bytes: &[u8]) -> u64 {
    xxh3::xxh3_64(bytes)
}

/// `length` rounded up to a multiple of `unit`, or `None` past the end of `u64`.
pub(super) fn round_up(length: u64, unit: u64) -> Option<u64> {
    length.checked_next_multiple_of(unit)
}
