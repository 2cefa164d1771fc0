//! The pages of a dataset on a server, proven, whatever was kept on the disk.

use std::io;
use std::sync::Arc;

use areoid_formats::address::PageAddress;
use areoid_formats::archive::index::BLOCK_LEN;
use areoid_formats::archive::record::RECORD_HEAD_LEN;
use areoid_formats::archive::{Archive, ArchiveError, PageEntry, Payload};
use areoid_formats::page::Page;
use areoid_formats::storage::ByteSource;

use super::range::is_given_up;
use super::source::HttpSource;
use crate::pages::PageSource;

/// An archive on a server. What was kept on the disk and is not what it should be is asked for once
/// more.
#[derive(Debug)]
pub struct RemotePages {
    archive: Archive,
    source: Arc<HttpSource>,
}

/// The archive's way to the source that its owner has, too.
#[derive(Debug)]
struct Shared(Arc<HttpSource>);

impl ByteSource for Shared {
    fn len(&self) -> u64 {
        self.0.len()
    }

    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        self.0.read_exact_at(buffer, offset)
    }
}

impl RemotePages {
    /// Reads both ends of the archive.
    ///
    /// # Errors
    ///
    /// [`ArchiveError`]; a damaged end is one, too: the records of a distant archive are not walked.
    pub fn open(source: HttpSource) -> Result<Self, ArchiveError> {
        let source = Arc::new(source);
        let open = || Archive::open_afar(Box::new(Shared(Arc::clone(&source))));
        let archive = match open() {
            Err(error) => match source.kept() {
                Some(kept) if !matches!(error, ArchiveError::Read { .. }) => {
                    kept.forget_all();
                    open()?
                }
                _ => return Err(error),
            },
            Ok(archive) => archive,
        };
        Ok(Self { archive, source })
    }

    /// The archive.
    #[must_use]
    pub fn archive(&self) -> &Archive {
        &self.archive
    }

    /// What `read` reads; once more if it is damaged and may come from the disk.
    fn proven<T>(
        &self,
        read: impl Fn() -> Result<T, ArchiveError>,
        damaged: impl Fn(&ArchiveError) -> Option<(u64, u64)>,
    ) -> Result<T, ArchiveError> {
        let result = read();
        let damage = result.as_ref().err().and_then(damaged);
        let (Some((offset, length)), Some(kept)) = (damage, self.source.kept()) else {
            return result;
        };
        kept.forget(offset, length);
        read()
    }

    /// The stored bytes of a page, read as long as `is_wanted`.
    fn payload_by(
        &self,
        entry: &PageEntry,
        is_wanted: &dyn Fn() -> bool,
    ) -> Result<Vec<u8>, ArchiveError> {
        let read = |buffer: &mut [u8], offset| self.source.read_while(buffer, offset, is_wanted);
        let payload = || self.archive.payload_by(entry, read);
        self.proven(payload, |error| match (error, entry.payload) {
            (ArchiveError::PageChecksum { .. }, Payload::Record { offset, length, .. }) => {
                Some((offset.saturating_add(RECORD_HEAD_LEN as u64), u64::from(length)))
            }
            _ => None,
        })
    }

    /// Refuses an entry that would take memory like no page of its size.
    fn check(&self, entry: PageEntry) -> Result<PageEntry, ArchiveError> {
        /// The most that a texel and its coverage may take, and all that stands before them.
        const TEXEL_BYTES: u64 = 8;
        const HEAD_BYTES: u64 = 4096;
        let side = u64::from(self.archive.description().grid.pyramid().page_side());
        let most = side * side * TEXEL_BYTES + HEAD_BYTES;
        match entry.payload {
            Payload::Record { length, .. } if u64::from(length) > most => {
                let reason = "it is longer than any page of its size";
                Err(ArchiveError::Entry { page: entry.page, reason })
            }
            _ => Ok(entry),
        }
    }
}

impl PageSource for RemotePages {
    fn find_resident(&self, page: PageAddress) -> Option<Option<PageEntry>> {
        let found = self.archive.find_resident(page)?;
        found.map(|entry| self.check(entry)).transpose().ok()
    }

    fn find(&self, page: PageAddress) -> Result<Option<PageEntry>, ArchiveError> {
        let find = || self.archive.find(page);
        let found = self.proven(find, |error| match error {
            ArchiveError::Checksum { offset, .. } => Some((*offset, BLOCK_LEN as u64)),
            _ => None,
        })?;
        found.map(|entry| self.check(entry)).transpose()
    }

    fn payload(&self, entry: &PageEntry) -> Result<Vec<u8>, ArchiveError> {
        self.payload_by(entry, &|| true)
    }

    fn payload_while(
        &self,
        entry: &PageEntry,
        is_wanted: &dyn Fn() -> bool,
    ) -> Result<Option<Vec<u8>>, ArchiveError> {
        match self.payload_by(entry, is_wanted) {
            Err(ArchiveError::Read { source, .. }) if is_given_up(&source) => Ok(None),
            payload => payload.map(Some),
        }
    }

    fn decode(&self, entry: &PageEntry, payload: &[u8]) -> Result<Page, ArchiveError> {
        self.archive.decode(entry, payload)
    }
}
