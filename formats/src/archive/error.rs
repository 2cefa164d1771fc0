//! What can be wrong with an archive.

use std::io;

use crate::address::PageAddress;
use crate::codec::DecodeError;

/// An archive that cannot be read, and where it stopped making sense.
///
/// Whatever the bytes, parsing never panics and never allocates more than the archive is long. A
/// page that is not there is not an error but `None`.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ArchiveError {
    /// The first bytes are not an archive's, and no trailer helps.
    #[error("not an Areoid archive: it starts with {found:02x?}")]
    NotAnArchive {
        /// The bytes found instead.
        found: [u8; 8],
    },

    /// An archive of another era.
    #[error("archive version {found} is not supported: this build reads version {supported}")]
    Version {
        /// The version the file declares.
        found: u32,
        /// The version this build reads and writes.
        supported: u32,
    },

    /// The file ends inside a structure.
    #[error("{what} needs bytes {start}..{end}, but the archive has {len}")]
    Truncated {
        /// The structure being read.
        what: &'static str,
        /// Where it starts, in bytes from the start of the file.
        start: u64,
        /// Where it should end.
        end: u64,
        /// Where the file ends.
        len: u64,
    },

    /// A structure's bytes do not match their checksum.
    #[error("{what} at byte {offset} is damaged: its checksum does not match")]
    Checksum {
        /// The damaged structure.
        what: &'static str,
        /// Where it starts, in bytes from the start of the file.
        offset: u64,
    },

    /// A field holds a value that the format forbids.
    #[error("{field} at byte {offset} is {found}, expected {expected}")]
    Field {
        /// The field's name in `FORMAT.md`.
        field: &'static str,
        /// Its offset in bytes from the start of the file.
        offset: u64,
        /// The value found.
        found: u64,
        /// What the format allows there, in words.
        expected: &'static str,
    },

    /// The description is whole but says something impossible.
    #[error("the archive's description is not valid: {reason}")]
    Description {
        /// What is wrong with it.
        reason: String,
    },

    /// A page's payload does not match its checksum.
    #[error(
        "page {page} is damaged: its checksum is {found:#018x}, the index says {expected:#018x}"
    )]
    PageChecksum {
        /// The damaged page.
        page: PageAddress,
        /// Checksum of the bytes read.
        found: u64,
        /// Checksum the index promises.
        expected: u64,
    },

    /// A page's payload is whole but does not decode.
    #[error("page {page} does not decode")]
    Page {
        /// The page.
        page: PageAddress,
        /// What the codec says.
        source: DecodeError,
    },

    /// The medium failed.
    #[error("cannot read {what}")]
    Read {
        /// The structure being read.
        what: &'static str,
        /// What the medium reported.
        source: io::Error,
    },
}
