//! Pages of an archive read back, a few of them kept.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use areoid_formats::address::PageAddress;
use areoid_formats::archive::{Archive, ArchiveError, PageEntry};
use areoid_formats::page::Page;
use areoid_formats::pyramid::Pyramid;

/// Pages kept decoded while verifying.
const KEPT_PAGES: usize = 256;

/// Decoded pages, a few of them at a time. Damaged ones read as absent: they are reported once, by
/// the look at every byte.
pub(super) struct Reader<'a> {
    pub(super) archive: &'a Archive,
    pub(super) entries: &'a HashMap<PageAddress, PageEntry>,
    pages: Mutex<HashMap<PageAddress, Option<Arc<Page>>>>,
}

impl<'a> Reader<'a> {
    pub(super) fn new(archive: &'a Archive, entries: &'a HashMap<PageAddress, PageEntry>) -> Self {
        Self { archive, entries, pages: Mutex::default() }
    }

    pub(super) fn page(&self, address: PageAddress) -> Result<Option<Arc<Page>>, ArchiveError> {
        let lock = || self.pages.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(held) = lock().get(&address) {
            return Ok(held.clone());
        }
        let page = match self.entries.get(&address).map(|entry| self.archive.page(entry)) {
            Some(Err(error @ ArchiveError::Read { .. })) => return Err(error),
            Some(Ok(page)) => Some(Arc::new(page)),
            Some(Err(_)) | None => None,
        };
        let mut pages = lock();
        if pages.len() >= KEPT_PAGES {
            pages.clear();
        }
        pages.insert(address, page.clone());
        Ok(page)
    }

    pub(super) fn pyramid(&self) -> &Pyramid {
        self.archive.description().grid.pyramid()
    }

    pub(super) fn name(&self, page: PageAddress) -> String {
        format!("{}/{page}", self.archive.description().dataset)
    }
}
