//! What an unfinished build notes of itself, so that it can be gone on with.
//!
//! A note says where the work stood after a unit: which pages are in which slots of the scratch
//! file, and what is known of pages without their texels. It is read once, by the process that goes
//! on with the build, and only by the version that wrote it; anything odd about it means that the
//! work units since the start are done again.

use areoid_formats::address::{PageAddress, PageKey};
use areoid_formats::archive::{ENTRY_LEN, PageEntry};
use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::xxh3_64;

use crate::feather::Validity;
use crate::scratch::Slot;

/// Where a build stood after a work unit.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Note {
    /// The archive under construction, by the checksum of its description.
    pub archive: u64,
    /// Work units done.
    pub units: u64,
    /// The pages under construction.
    pub pages: Vec<(PageAddress, Slot)>,
    /// What is known of pages that are whole.
    pub entries: Vec<PageEntry>,
    /// Which texels of leaves are valid.
    pub validity: Vec<(PageAddress, NotedValidity)>,
    /// Pages that one of their two uses is over for.
    pub half_done: Vec<PageAddress>,
}

/// [`Validity`], its bits in a slot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[expect(missing_docs, reason = "the variants are those of Validity")]
pub enum NotedValidity {
    Empty,
    Full,
    Mixed { cols: usize, bits: Slot },
}

impl NotedValidity {
    /// What `validity` is noted as; `bits` stores its bits.
    pub(crate) fn of<E>(
        validity: &Validity,
        bits: impl FnOnce(&[u8]) -> Result<Slot, E>,
    ) -> Result<Self, E> {
        Ok(match validity {
            Validity::Empty => Self::Empty,
            Validity::Full => Self::Full,
            Validity::Mixed { cols, bits: bytes } => {
                Self::Mixed { cols: *cols, bits: bits(bytes)? }
            }
        })
    }
}

/// The note in JSON: pages as keys, entries as hexadecimal digits.
#[derive(Serialize, Deserialize)]
struct Written {
    version: String,
    byte_order: u16,
    archive: u64,
    units: u64,
    pages: Vec<(u64, Slot)>,
    entries: Vec<String>,
    validity: Vec<(u64, NotedValidity)>,
    half_done: Vec<u64>,
}

/// The scratch file has arrays as this machine holds them.
const BYTE_ORDER: u16 = if cfg!(target_endian = "little") { 0x1234 } else { 0x3412 };

impl Note {
    /// The slots it names.
    #[must_use]
    pub fn slots(&self) -> Vec<Slot> {
        let bits = self.validity.iter().filter_map(|(_, validity)| match validity {
            NotedValidity::Mixed { bits, .. } => Some(*bits),
            NotedValidity::Empty | NotedValidity::Full => None,
        });
        self.pages.iter().map(|(_, slot)| *slot).chain(bits).collect()
    }

    /// The note as a file: a checksum, a line's end, JSON.
    ///
    /// # Panics
    ///
    /// Never: it has no map whose keys are not text.
    #[must_use]
    pub fn to_bytes(&self) -> Vec<u8> {
        let hexadecimal = |entry: &PageEntry| {
            entry.to_bytes().iter().map(|byte| format!("{byte:02x}")).collect::<String>()
        };
        let key = |page: PageAddress| PageKey::from(page).get();
        let written = Written {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            byte_order: BYTE_ORDER,
            archive: self.archive,
            units: self.units,
            pages: self.pages.iter().map(|&(page, slot)| (key(page), slot)).collect(),
            entries: self.entries.iter().map(hexadecimal).collect(),
            validity: self.validity.iter().map(|&(page, valid)| (key(page), valid)).collect(),
            half_done: self.half_done.iter().copied().map(key).collect(),
        };
        let json = serde_json::to_vec(&written).expect("a note has no maps");
        let mut bytes = format!("{:016x}\n", xxh3_64(&json)).into_bytes();
        bytes.extend_from_slice(&json);
        bytes
    }

    /// Reads a note; `None` if the bytes are not a whole one of this version and machine.
    #[must_use]
    pub fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (sum, json) = bytes.split_at_checked(17)?;
        if sum != format!("{:016x}\n", xxh3_64(json)).as_bytes() {
            return None;
        }
        let written: Written = serde_json::from_slice(json).ok()?;
        if written.version != env!("CARGO_PKG_VERSION") || written.byte_order != BYTE_ORDER {
            return None;
        }
        let page = |key: u64| PageAddress::from(PageKey::from_raw(key));
        let entry = |digits: &String| {
            let mut bytes = [0; ENTRY_LEN];
            for (at, byte) in bytes.iter_mut().enumerate() {
                *byte = u8::from_str_radix(digits.get(2 * at..2 * at + 2)?, 16).ok()?;
            }
            Some(PageEntry::from_bytes(&bytes))
        };
        Some(Self {
            archive: written.archive,
            units: written.units,
            pages: written.pages.into_iter().map(|(key, slot)| (page(key), slot)).collect(),
            entries: written.entries.iter().map(entry).collect::<Option<_>>()?,
            validity: written.validity.into_iter().map(|(key, valid)| (page(key), valid)).collect(),
            half_done: written.half_done.into_iter().map(page).collect(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use areoid_formats::address::Level;
    use areoid_formats::archive::Payload;

    #[test]
    fn a_note_comes_back_and_a_damaged_one_does_not() {
        let page = PageAddress::new(Level(2), 1, 3);
        let slot = Slot { offset: 4096, length: 77, checksum: u64::MAX };
        let entry = PageEntry {
            page,
            payload: Payload::Record { offset: 8192, length: 9, checksum: 5 },
            valid_fraction: 0.5,
            min: -1.0,
            max: 2.5,
            lowest: -1.5,
            highest: 3.0,
            bound: 0.25,
            source_error: 0.0,
            full: false,
        };
        let note = Note {
            archive: 12,
            units: 7,
            pages: vec![(page, slot)],
            entries: vec![entry],
            validity: vec![(page, NotedValidity::Mixed { cols: 8, bits: slot })],
            half_done: vec![page],
        };
        let bytes = note.to_bytes();
        assert_eq!(Note::from_bytes(&bytes).as_ref(), Some(&note));
        for at in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[at] ^= 1;
            assert_eq!(Note::from_bytes(&damaged), None);
            assert_eq!(Note::from_bytes(&bytes[..at]), None);
        }
    }
}
