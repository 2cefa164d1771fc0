//! The fixed structures at both ends of an archive: preamble and trailer.

use super::bytes::{checksum, put, u32_at, u64_at};
use super::error::ArchiveError;

/// The first bytes of an archive. Like PNG's they have a byte that is not ASCII and both line
/// endings, so that a transfer in text mode is caught at once.
pub const MAGIC: [u8; 8] = *b"\x89Areo\r\n\x1a";
/// The last structure of an archive starts with these.
pub const TRAILER_MAGIC: [u8; 8] = *b"\x89ArTail\n";
/// The one version this build reads and writes.
pub const VERSION: u32 = 2;
/// Size of the preamble in bytes; the description follows.
pub const PREAMBLE_LEN: usize = 64;
/// Size of the trailer in bytes.
pub const TRAILER_LEN: usize = 128;
/// The longest description or summary in bytes.
pub const MAX_JSON_LEN: u64 = 1 << 24;

const VERSION_AT: usize = 8;
const DESCRIPTION_LEN_AT: usize = 12;
const ARCHIVE_AT: usize = 16;
const PREAMBLE_CHECKSUM_AT: usize = 56;
const _: () = assert!(PREAMBLE_CHECKSUM_AT + size_of::<u64>() == PREAMBLE_LEN);

/// How an archive starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Preamble {
    /// Bytes of the description that follows.
    pub description_len: u32,
    /// Checksum of the description: the name by which records know their archive.
    pub archive: u64,
}

impl Preamble {
    /// The preamble as the archive stores it.
    #[must_use]
    pub fn to_bytes(self) -> [u8; PREAMBLE_LEN] {
        let mut bytes = [0; PREAMBLE_LEN];
        put(&mut bytes, 0, &MAGIC);
        put(&mut bytes, VERSION_AT, &VERSION.to_le_bytes());
        put(&mut bytes, DESCRIPTION_LEN_AT, &self.description_len.to_le_bytes());
        put(&mut bytes, ARCHIVE_AT, &self.archive.to_le_bytes());
        let sum = checksum(&bytes[..PREAMBLE_CHECKSUM_AT]);
        put(&mut bytes, PREAMBLE_CHECKSUM_AT, &sum.to_le_bytes());
        bytes
    }

    /// Reads a preamble that starts at `offset` of the archive.
    ///
    /// # Errors
    ///
    /// [`ArchiveError::NotAnArchive`], [`ArchiveError::Version`] or [`ArchiveError::Checksum`].
    pub fn parse(bytes: &[u8; PREAMBLE_LEN], offset: u64) -> Result<Self, ArchiveError> {
        if !bytes.starts_with(&MAGIC) {
            return Err(ArchiveError::NotAnArchive { found: super::bytes::array_at(bytes, 0) });
        }
        if u64_at(bytes, PREAMBLE_CHECKSUM_AT) != checksum(&bytes[..PREAMBLE_CHECKSUM_AT]) {
            return Err(ArchiveError::Checksum { what: "the preamble", offset });
        }
        check_version(u32_at(bytes, VERSION_AT))?;
        Ok(Self {
            description_len: u32_at(bytes, DESCRIPTION_LEN_AT),
            archive: u64_at(bytes, ARCHIVE_AT),
        })
    }
}

fn check_version(found: u32) -> Result<(), ArchiveError> {
    if found == VERSION { Ok(()) } else { Err(ArchiveError::Version { found, supported: VERSION }) }
}

const RECORDS_AT: usize = 24;
const INDEX_AT: usize = 32;
const ENTRIES_AT: usize = 40;
const ROOT_CHECKSUM_AT: usize = 48;
const SUMMARY_AT: usize = 56;
const SUMMARY_LEN_AT: usize = 64;
const SUMMARY_CHECKSUM_AT: usize = 72;
const COPY_AT: usize = 80;
const FILE_LEN_AT: usize = 88;
const TRAILER_CHECKSUM_AT: usize = 120;
const _: () = assert!(TRAILER_CHECKSUM_AT + size_of::<u64>() == TRAILER_LEN);

/// How an archive ends: where its parts are, and the checksums that prove them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Trailer {
    /// Checksum of the description.
    pub archive: u64,
    /// Where the records start.
    pub records: u64,
    /// Where the records end and the index starts.
    pub index: u64,
    /// Pages in the index.
    pub entries: u64,
    /// Checksum of the index's root block; 0 without pages.
    pub root_checksum: u64,
    /// Where the summary starts.
    pub summary: u64,
    /// Bytes of the summary.
    pub summary_len: u64,
    /// Checksum of the summary.
    pub summary_checksum: u64,
    /// Where the copy of preamble and description starts.
    pub copy: u64,
    /// Bytes of the whole archive, this trailer included.
    pub file_len: u64,
}

impl Trailer {
    /// The trailer as the archive stores it.
    #[must_use]
    pub fn to_bytes(&self) -> [u8; TRAILER_LEN] {
        let mut bytes = [0; TRAILER_LEN];
        put(&mut bytes, 0, &TRAILER_MAGIC);
        put(&mut bytes, VERSION_AT, &VERSION.to_le_bytes());
        for (at, value) in [
            (ARCHIVE_AT, self.archive),
            (RECORDS_AT, self.records),
            (INDEX_AT, self.index),
            (ENTRIES_AT, self.entries),
            (ROOT_CHECKSUM_AT, self.root_checksum),
            (SUMMARY_AT, self.summary),
            (SUMMARY_LEN_AT, self.summary_len),
            (SUMMARY_CHECKSUM_AT, self.summary_checksum),
            (COPY_AT, self.copy),
            (FILE_LEN_AT, self.file_len),
        ] {
            put(&mut bytes, at, &value.to_le_bytes());
        }
        let sum = checksum(&bytes[..TRAILER_CHECKSUM_AT]);
        put(&mut bytes, TRAILER_CHECKSUM_AT, &sum.to_le_bytes());
        bytes
    }

    /// Reads the trailer of an archive that is `file_len` bytes long.
    ///
    /// # Errors
    ///
    /// [`ArchiveError::Checksum`], [`ArchiveError::Version`], or [`ArchiveError::Field`] if it
    /// belongs to an archive of another length. Its offsets still have to be checked against it.
    pub fn parse(bytes: &[u8; TRAILER_LEN], file_len: u64) -> Result<Self, ArchiveError> {
        let offset = file_len - TRAILER_LEN as u64;
        if !bytes.starts_with(&TRAILER_MAGIC)
            || u64_at(bytes, TRAILER_CHECKSUM_AT) != checksum(&bytes[..TRAILER_CHECKSUM_AT])
        {
            return Err(ArchiveError::Checksum { what: "the trailer", offset });
        }
        check_version(u32_at(bytes, VERSION_AT))?;
        let trailer = Self {
            archive: u64_at(bytes, ARCHIVE_AT),
            records: u64_at(bytes, RECORDS_AT),
            index: u64_at(bytes, INDEX_AT),
            entries: u64_at(bytes, ENTRIES_AT),
            root_checksum: u64_at(bytes, ROOT_CHECKSUM_AT),
            summary: u64_at(bytes, SUMMARY_AT),
            summary_len: u64_at(bytes, SUMMARY_LEN_AT),
            summary_checksum: u64_at(bytes, SUMMARY_CHECKSUM_AT),
            copy: u64_at(bytes, COPY_AT),
            file_len: u64_at(bytes, FILE_LEN_AT),
        };
        if trailer.file_len != file_len {
            return Err(ArchiveError::Field {
                field: "file length",
                offset: offset + FILE_LEN_AT as u64,
                found: trailer.file_len,
                expected: "the length of this file",
            });
        }
        Ok(trailer)
    }
}

/// The checksum by which an archive's records know it.
#[must_use]
pub fn archive_id(description_json: &[u8]) -> u64 {
    checksum(description_json)
}

/// The checksum of a summary.
#[must_use]
pub fn summary_checksum(json: &[u8]) -> u64 {
    checksum(json)
}
