//! Records: the head of a page, and the marker that closes a work unit.
//!
//! Every record starts at a multiple of 4096 with a head of 128 bytes that says what it is and how
//! long, so that an archive without an index can be walked from its start, and so that the walk
//! finds its way again behind a damaged record.

use super::bytes::{checksum, put, round_up, u64_at};
use super::entry::{ENTRY_LEN, PageEntry};
use super::error::ArchiveError;
use crate::address::PageKey;

/// Records and everything after them start at multiples of this many bytes.
pub const ALIGNMENT: u64 = 4096;

/// Size of a record's head in bytes: the body follows.
pub const RECORD_HEAD_LEN: usize = 128;

/// The first bytes of a page's record.
pub const PAGE_MAGIC: [u8; 8] = *b"\x89ArPage\n";
/// The first bytes of a work unit's marker.
pub const MARKER_MAGIC: [u8; 8] = *b"\x89ArUnit\n";

const ARCHIVE_AT: usize = 8;
const BODY_LEN_AT: usize = 16;
const ENTRY_AT: usize = 32;
const UNIT_AT: usize = 32;
const CONSTANTS_AT: usize = 40;
const EMPTY_RUNS_AT: usize = 48;
const BODY_CHECKSUM_AT: usize = 56;
const HEAD_CHECKSUM_AT: usize = 96;
const _: () = assert!(ENTRY_AT + ENTRY_LEN == HEAD_CHECKSUM_AT);
const _: () = assert!(BODY_CHECKSUM_AT + size_of::<u64>() <= HEAD_CHECKSUM_AT);
const _: () = assert!(HEAD_CHECKSUM_AT + size_of::<u64>() <= RECORD_HEAD_LEN);

/// Bytes of one run of empty pages in a marker: first key u64, pages u64.
const RUN_LEN: usize = 16;

/// The head of a record, whole and checked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RecordHead {
    /// A page; its payload follows.
    Page(PageEntry),
    /// A marker; its lists follow.
    Marker(MarkerHead),
}

/// What the head of a marker says of its body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MarkerHead {
    /// The unit that ends here, counted from 0 along the builder's curve.
    pub unit: u64,
    /// Entries of constant pages in the body.
    pub constants: u64,
    /// Runs of empty pages in the body, after the constant ones.
    pub empty_runs: u64,
    /// Checksum of the body.
    pub body_checksum: u64,
}

/// The pages that became whole in a work unit and have no record.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Marker {
    /// The unit, counted from 0 along the builder's curve.
    pub unit: u64,
    /// Pages whose texels are all the same.
    pub constants: Vec<PageEntry>,
    /// Runs of pages without a valid texel: the first key, and how many keys.
    pub empty_runs: Vec<(PageKey, u64)>,
}

/// The head of a page's record.
#[must_use]
pub fn page_head(archive: u64, entry: &PageEntry, payload_len: u32) -> [u8; RECORD_HEAD_LEN] {
    let mut head = [0; RECORD_HEAD_LEN];
    put(&mut head, 0, &PAGE_MAGIC);
    put(&mut head, ARCHIVE_AT, &archive.to_le_bytes());
    put(&mut head, BODY_LEN_AT, &u64::from(payload_len).to_le_bytes());
    put(&mut head, ENTRY_AT, &entry.to_bytes());
    seal(head)
}

impl Marker {
    /// Head and body as the archive stores them.
    #[must_use]
    pub fn to_bytes(&self, archive: u64) -> Vec<u8> {
        let mut body =
            Vec::with_capacity(self.constants.len() * ENTRY_LEN + self.empty_runs.len() * RUN_LEN);
        for entry in &self.constants {
            body.extend_from_slice(&entry.to_bytes());
        }
        for &(first, pages) in &self.empty_runs {
            body.extend_from_slice(&first.get().to_le_bytes());
            body.extend_from_slice(&pages.to_le_bytes());
        }
        let mut head = [0; RECORD_HEAD_LEN];
        put(&mut head, 0, &MARKER_MAGIC);
        put(&mut head, ARCHIVE_AT, &archive.to_le_bytes());
        put(&mut head, BODY_LEN_AT, &(body.len() as u64).to_le_bytes());
        put(&mut head, UNIT_AT, &self.unit.to_le_bytes());
        put(&mut head, CONSTANTS_AT, &(self.constants.len() as u64).to_le_bytes());
        put(&mut head, EMPTY_RUNS_AT, &(self.empty_runs.len() as u64).to_le_bytes());
        put(&mut head, BODY_CHECKSUM_AT, &checksum(&body).to_le_bytes());
        let mut bytes = seal(head).to_vec();
        bytes.append(&mut body);
        bytes
    }

    /// The marker whose head is `head`, from its body.
    ///
    /// # Errors
    ///
    /// [`ArchiveError::Checksum`] if the body is not the one the head promises. `offset` is where
    /// the record starts.
    ///
    /// # Panics
    ///
    /// Never: lists that the body's length holds fit `usize`.
    pub fn parse(head: MarkerHead, body: &[u8], offset: u64) -> Result<Self, ArchiveError> {
        if checksum(body) != head.body_checksum || body_len(head) != Some(body.len() as u64) {
            return Err(ArchiveError::Checksum { what: "the marker of a work unit", offset });
        }
        let constants = usize::try_from(head.constants).expect("the body's length holds it");
        let (entries, runs) = body.split_at(constants * ENTRY_LEN);
        let constants = entries.as_chunks().0.iter().map(PageEntry::from_bytes).collect();
        let empty_runs = runs
            .as_chunks::<RUN_LEN>()
            .0
            .iter()
            .map(|run| (PageKey::from_raw(u64_at(run, 0)), u64_at(run, 8)))
            .collect();
        Ok(Self { unit: head.unit, constants, empty_runs })
    }
}

/// The length of the body that `head` describes.
fn body_len(head: MarkerHead) -> Option<u64> {
    let constants = head.constants.checked_mul(ENTRY_LEN as u64)?;
    constants.checked_add(head.empty_runs.checked_mul(RUN_LEN as u64)?)
}

/// Reads a record's head; `None` if these bytes are not the head of a record of `archive`. The
/// second number is the length of the body.
#[must_use]
pub fn parse_head(head: &[u8; RECORD_HEAD_LEN], archive: u64) -> Option<(RecordHead, u64)> {
    if u64_at(head, HEAD_CHECKSUM_AT) != checksum(&head[..HEAD_CHECKSUM_AT])
        || u64_at(head, ARCHIVE_AT) != archive
        || head[HEAD_CHECKSUM_AT + 8..].iter().any(|&byte| byte != 0)
    {
        return None;
    }
    let length = u64_at(head, BODY_LEN_AT);
    let record = if head.starts_with(&PAGE_MAGIC) {
        RecordHead::Page(PageEntry::from_bytes(&super::bytes::array_at(head, ENTRY_AT)))
    } else if head.starts_with(&MARKER_MAGIC) {
        let marker = MarkerHead {
            unit: u64_at(head, UNIT_AT),
            constants: u64_at(head, CONSTANTS_AT),
            empty_runs: u64_at(head, EMPTY_RUNS_AT),
            body_checksum: u64_at(head, BODY_CHECKSUM_AT),
        };
        if body_len(marker) != Some(length) {
            return None;
        }
        RecordHead::Marker(marker)
    } else {
        return None;
    };
    Some((record, length))
}

/// The bytes a record takes up with a body of `body_len` bytes, padding included, or `None` past
/// the end of `u64`.
#[must_use]
pub fn record_len(body_len: u64) -> Option<u64> {
    round_up(body_len.checked_add(RECORD_HEAD_LEN as u64)?, ALIGNMENT)
}

fn seal(mut head: [u8; RECORD_HEAD_LEN]) -> [u8; RECORD_HEAD_LEN] {
    let sum = checksum(&head[..HEAD_CHECKSUM_AT]);
    put(&mut head, HEAD_CHECKSUM_AT, &sum.to_le_bytes());
    head
}

/// Runs of consecutive keys in `keys`, which are sorted.
#[must_use]
pub fn runs(keys: &[PageKey]) -> Vec<(PageKey, u64)> {
    let mut runs: Vec<(PageKey, u64)> = Vec::new();
    for &key in keys {
        match runs.last_mut() {
            Some((first, pages)) if first.get() + *pages == key.get() => *pages += 1,
            _ => runs.push((key, 1)),
        }
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::archive::entry::tests::any_entry;
    use proptest::prelude::*;

    fn any_marker() -> impl Strategy<Value = Marker> {
        let runs = prop::collection::vec((any::<u64>(), 1..99_u64), 0..5)
            .prop_map(|runs| runs.into_iter().map(|(k, n)| (PageKey::from_raw(k), n)).collect());
        (any::<u64>(), prop::collection::vec(any_entry(), 0..5), runs)
            .prop_map(|(unit, constants, empty_runs)| Marker { unit, constants, empty_runs })
    }

    proptest! {
        #[test]
        fn a_marker_survives_its_bytes(marker in any_marker(), archive in any::<u64>()) {
            let bytes = marker.to_bytes(archive);
            let (head, body) = bytes.split_first_chunk().unwrap();
            let Some((RecordHead::Marker(head), length)) = parse_head(head, archive) else {
                panic!("a marker's head is one");
            };
            prop_assert_eq!(length, body.len() as u64);
            prop_assert_eq!(Marker::parse(head, body, 0).unwrap(), marker);
        }

        #[test]
        fn a_damaged_marker_is_refused(
            marker in any_marker(), at in any::<prop::sample::Index>(), bit in 0..8_u8,
        ) {
            let mut bytes = marker.to_bytes(9);
            let at = at.index(bytes.len());
            bytes[at] ^= 1 << bit;
            let (head, body) = bytes.split_first_chunk().unwrap();
            if let Some((head, _)) = parse_head(head, 9) {
                let RecordHead::Marker(head) = head else { panic!("no damage makes it a page") };
                prop_assert!(Marker::parse(head, body, 0).is_err());
            }
        }
    }

    #[test]
    fn empty_pages_are_listed_as_runs() {
        let keys = [3, 4, 5, 9, 11, 12].map(PageKey::from_raw);
        let expected = [(3, 3), (9, 1), (11, 2)].map(|(key, n)| (PageKey::from_raw(key), n));
        assert_eq!(runs(&keys), expected);
    }
}
