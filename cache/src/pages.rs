//! Where the pages of a dataset come from.

use std::fmt;

use areoid_formats::address::PageAddress;
use areoid_formats::archive::{Archive, ArchiveError, PageEntry};
use areoid_formats::page::Page;

/// The pages of one dataset: an archive, or whatever answers like one.
///
/// # Contract
///
/// * What is found of a page never changes. Entries nest: a page's range and bound contain those
///   of its children.
/// * [`Self::find_resident`] never waits. All others may, for a disk or a network, but not forever.
/// * All methods may be called from any thread, in any number.
/// * Whoever asks [`Self::payload_while`]'s `is_wanted` holds no lock that [`Self::find_resident`] takes: the
///   answer may be waited for.
pub trait PageSource: fmt::Debug + Send + Sync {
    /// What is known of a page without waiting: `None` if [`Self::find`] has to be asked first, and
    /// `Some(None)` if the page has no data or is not the grid's.
    fn find_resident(&self, page: PageAddress) -> Option<Option<PageEntry>>;

    /// What is known of a page; `None` if it has no data or is not the grid's.
    ///
    /// # Errors
    ///
    /// [`ArchiveError`] if the index cannot be read.
    fn find(&self, page: PageAddress) -> Result<Option<PageEntry>, ArchiveError>;

    /// The stored bytes of a page, proven; none for a constant one.
    ///
    /// # Errors
    ///
    /// [`ArchiveError`] if they cannot be read, or are not what was stored.
    fn payload(&self, entry: &PageEntry) -> Result<Vec<u8>, ArchiveError>;

    /// [`Self::payload`], or `None` if it was given up because `is_wanted` was false, and for no other reason.
    /// Who waits long for a medium asks that again and again; others need not ask.
    ///
    /// # Errors
    ///
    /// Those of [`Self::payload`].
    fn payload_while(
        &self,
        entry: &PageEntry,
        is_wanted: &dyn Fn() -> bool,
    ) -> Result<Option<Vec<u8>>, ArchiveError> {
        let _ = is_wanted;
        self.payload(entry).map(Some)
    }

    /// The texels of a page from its stored bytes.
    ///
    /// # Errors
    ///
    /// [`ArchiveError`] if they are no such page's.
    fn decode(&self, entry: &PageEntry, payload: &[u8]) -> Result<Page, ArchiveError>;

    /// Says that the stored bytes of a page will probably be asked for in a second or two, and are not yet:
    /// where they lie far off they may be brought nearer.
    fn advise(&self, entry: &PageEntry) {
        let _ = entry;
    }
}

impl PageSource for Archive {
    fn find_resident(&self, page: PageAddress) -> Option<Option<PageEntry>> {
        Self::find_resident(self, page)
    }

    fn find(&self, page: PageAddress) -> Result<Option<PageEntry>, ArchiveError> {
        Self::find(self, page)
    }

    fn payload(&self, entry: &PageEntry) -> Result<Vec<u8>, ArchiveError> {
        Self::payload(self, entry)
    }

    fn decode(&self, entry: &PageEntry, payload: &[u8]) -> Result<Page, ArchiveError> {
        Self::decode(self, entry, payload)
    }

    fn advise(&self, entry: &PageEntry) {
        Self::advise(self, entry);
    }
}
