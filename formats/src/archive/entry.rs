//! What the archive knows of a page without reading it: 64 bytes.
//!
//! The same bytes stand in the page's record, in the index, and, for a constant page, in the
//! marker of its work unit. `FORMAT.md` draws them.

use xxhash_rust::xxh3;

use super::bytes::{f32_at, put, u32_at, u64_at};
use crate::address::{PageAddress, PageKey};

/// Size of an entry in bytes.
pub const ENTRY_LEN: usize = 64;

const KEY_AT: usize = 0;
const OFFSET_AT: usize = 8;
const LENGTH_AT: usize = 16;
const VALUE_AT: usize = 20;
const VALID_FRACTION_AT: usize = 24;
const MIN_AT: usize = 28;
const MAX_AT: usize = 32;
const LOWEST_AT: usize = 36;
const HIGHEST_AT: usize = 40;
const BOUND_AT: usize = 44;
const SOURCE_ERROR_AT: usize = 48;
const FLAGS_AT: usize = 52;
const CHECKSUM_AT: usize = 56;
const _: () = assert!(CHECKSUM_AT + size_of::<u64>() == ENTRY_LEN, "FORMAT.md says 64");

const CONSTANT: u32 = 1;
const FULL: u32 = 2;

/// Where a page's texels are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Payload {
    /// All texels of the window are this one, and fully covered: nothing is stored.
    Constant(ConstantTexel),
    /// In a record.
    Record {
        /// Where the record starts, in bytes from the start of the archive.
        offset: u64,
        /// Length of the payload in bytes.
        length: u32,
        /// [`payload_checksum`] of the payload.
        checksum: u64,
    },
}

/// The four bytes of a texel: a height's little-endian `f32`, or red, green, blue and zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConstantTexel(pub [u8; 4]);

/// A page as the index knows it. Heights are in meters, colors in codes 0–255.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PageEntry {
    /// Which page.
    pub page: PageAddress,
    /// Where its texels are.
    pub payload: Payload,
    /// Share of the interior, inside the outline, that is valid: 0 to 1.
    pub valid_fraction: f32,
    /// Least of the finest texels under the page (over channels), or NaN if none is valid.
    pub min: f32,
    /// Greatest of the finest texels under the page (over channels), or NaN if none is valid.
    pub max: f32,
    /// At most what the finest reconstruction takes anywhere over the page: [`Self::min`] and the
    /// texels beside it. Volumes are made of it.
    pub lowest: f32,
    /// At least what the finest reconstruction takes anywhere over the page.
    pub highest: f32,
    /// No point of the page where all taps are valid is farther than this from the finest level
    /// before quantization (law 1). At least that of every page below.
    pub bound: f32,
    /// The largest |`R_L` − source| at the source's pixel centers under the page.
    pub source_error: f32,
    /// Whether every texel of the window is fully covered.
    pub full: bool,
}

impl PageEntry {
    /// The entry as the archive stores it.
    #[must_use]
    pub fn to_bytes(&self) -> [u8; ENTRY_LEN] {
        let (offset, length, value, checksum, constant) = match self.payload {
            Payload::Constant(ConstantTexel(texel)) => (0, 0, texel, 0, CONSTANT),
            Payload::Record { offset, length, checksum } => (offset, length, [0; 4], checksum, 0),
        };
        let flags = constant | if self.full { FULL } else { 0 };
        let mut bytes = [0; ENTRY_LEN];
        put(&mut bytes, KEY_AT, &PageKey::from(self.page).get().to_le_bytes());
        put(&mut bytes, OFFSET_AT, &offset.to_le_bytes());
        put(&mut bytes, LENGTH_AT, &length.to_le_bytes());
        put(&mut bytes, VALUE_AT, &value);
        put(&mut bytes, VALID_FRACTION_AT, &self.valid_fraction.to_le_bytes());
        put(&mut bytes, MIN_AT, &self.min.to_le_bytes());
        put(&mut bytes, MAX_AT, &self.max.to_le_bytes());
        put(&mut bytes, LOWEST_AT, &self.lowest.to_le_bytes());
        put(&mut bytes, HIGHEST_AT, &self.highest.to_le_bytes());
        put(&mut bytes, BOUND_AT, &self.bound.to_le_bytes());
        put(&mut bytes, SOURCE_ERROR_AT, &self.source_error.to_le_bytes());
        put(&mut bytes, FLAGS_AT, &flags.to_le_bytes());
        put(&mut bytes, CHECKSUM_AT, &checksum.to_le_bytes());
        bytes
    }

    /// Whether its numbers are ones that a writer writes: ranges in order or NaN, errors that are
    /// not negative, a share from 0 to 1.
    #[must_use]
    pub fn has_sound_figures(&self) -> bool {
        let range = |low: f32, high: f32| low <= high || low.is_nan() && high.is_nan();
        (0.0..=1.0).contains(&self.valid_fraction)
            && range(self.min, self.max)
            && range(self.lowest, self.highest)
            && self.bound >= 0.0
            && self.source_error >= 0.0
    }

    /// The entry that the archive stores as `bytes`. Every 64 bytes are one: a checksum around
    /// them says whether to believe it.
    #[must_use]
    pub fn from_bytes(bytes: &[u8; ENTRY_LEN]) -> Self {
        let flags = u32_at(bytes, FLAGS_AT);
        let payload = if flags & CONSTANT == 0 {
            Payload::Record {
                offset: u64_at(bytes, OFFSET_AT),
                length: u32_at(bytes, LENGTH_AT),
                checksum: u64_at(bytes, CHECKSUM_AT),
            }
        } else {
            Payload::Constant(ConstantTexel(super::bytes::array_at(bytes, VALUE_AT)))
        };
        Self {
            page: PageKey::from_raw(u64_at(bytes, KEY_AT)).into(),
            payload,
            valid_fraction: f32_at(bytes, VALID_FRACTION_AT),
            min: f32_at(bytes, MIN_AT),
            max: f32_at(bytes, MAX_AT),
            lowest: f32_at(bytes, LOWEST_AT),
            highest: f32_at(bytes, HIGHEST_AT),
            bound: f32_at(bytes, BOUND_AT),
            source_error: f32_at(bytes, SOURCE_ERROR_AT),
            full: flags & FULL != 0,
        }
    }
}

/// The checksum of a page's payload: XXH3, 64 bits, seeded with the page's key, so that the bytes
/// of one page do not pass for another's.
#[must_use]
pub fn payload_checksum(page: PageAddress, payload: &[u8]) -> u64 {
    xxh3::xxh3_64_with_seed(payload, PageKey::from(page).get())
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::address::Level;
    use proptest::prelude::*;

    pub(in crate::archive) fn any_entry() -> impl Strategy<Value = PageEntry> {
        let side = 0..PageAddress::MAX_PAGES_PER_SIDE;
        let payload = prop_oneof![
            any::<[u8; 4]>().prop_map(|texel| Payload::Constant(ConstantTexel(texel))),
            (any::<u64>(), any::<u32>(), any::<u64>()).prop_map(|(offset, length, checksum)| {
                Payload::Record { offset, length, checksum }
            }),
        ];
        let numbers = prop::array::uniform7(-1e6..1e6_f32);
        ((0..33_u8, side.clone(), side), payload, numbers, any::<bool>()).prop_map(
            |((level, row, col), payload, numbers, full)| {
                let [valid_fraction, min, max, lowest, highest, bound, source_error] = numbers;
                PageEntry {
                    page: PageAddress::new(Level(level), row, col),
                    payload,
                    valid_fraction,
                    min,
                    max,
                    lowest,
                    highest,
                    bound,
                    source_error,
                    full,
                }
            },
        )
    }

    proptest! {
        #[test]
        fn an_entry_survives_its_bytes(entry in any_entry()) {
            prop_assert_eq!(PageEntry::from_bytes(&entry.to_bytes()), entry);
        }
    }
}
