//! Reading an archive: opened by its trailer, each structure proven when it is first touched.

use std::fs::File;
use std::io;
use std::ops::Range;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use super::bytes::checksum;
use super::description::{Description, Summary};
use super::entry::{ConstantTexel, PageEntry, Payload, payload_checksum};
use super::error::ArchiveError;
use super::layout::{PREAMBLE_LEN, TRAILER_LEN};
use super::record::{ALIGNMENT, RECORD_HEAD_LEN, record_len};
use super::recover::{self, Recovered};
use super::tail::{Tail, read_description, read_trailer};
use crate::address::{PageAddress, PageKey};
use crate::codec;
use crate::page::{Kind, Page, Texels};
use crate::storage::ByteSource;

/// An open archive.
///
/// Opening reads the trailer and the two descriptions; blocks of the index are read, proven and
/// kept when they are first touched. If the trailer or a block of the index is damaged, the
/// records are walked once and serve as the index from then on.
///
/// # Threads
///
/// All methods may be called from any thread. Those that read may wait for the disk;
/// [`Self::find_resident`] never does.
#[derive(Debug)]
pub struct Archive {
    source: Box<dyn ByteSource>,
    description: Description,
    archive: u64,
    /// Bytes of preamble and description.
    head_len: u64,
    records: Range<u64>,
    /// `None` if the trailer is damaged.
    tail: Option<Tail>,
    /// Whether the records may be walked.
    may_walk: bool,
    rebuilt: OnceLock<Recovered>,
    /// Held by the one thread that walks the records.
    walking: Mutex<()>,
}

impl Archive {
    /// Opens the archive in `source`.
    ///
    /// # Errors
    ///
    /// [`ArchiveError`] if neither end of it can be understood, or the medium fails.
    pub fn open(source: Box<dyn ByteSource>) -> Result<Self, ArchiveError> {
        Self::open_with(source, true)
    }

    /// [`Self::open`] on a medium that is too far away to walk the records on: what a damaged trailer
    /// or block of the index leads to cannot be had.
    ///
    /// # Errors
    ///
    /// Those of [`Self::open`], or [`ArchiveError::Checksum`] if the trailer or the summary is
    /// damaged.
    pub fn open_afar(source: Box<dyn ByteSource>) -> Result<Self, ArchiveError> {
        let archive = Self::open_with(source, false)?;
        if archive.tail.is_none() {
            let offset = archive.source.len().saturating_sub(TRAILER_LEN as u64);
            return Err(ArchiveError::Checksum { what: "the end of the archive", offset });
        }
        Ok(archive)
    }

    fn open_with(source: Box<dyn ByteSource>, may_walk: bool) -> Result<Self, ArchiveError> {
        let trailer = match read_trailer(source.as_ref()) {
            Err(error @ ArchiveError::Read { .. }) => return Err(error),
            trailer => trailer,
        };
        let front = read_description(source.as_ref(), 0);
        let (preamble, description) = match (front, &trailer) {
            (Ok(front), _) => front,
            // A version of another era is no damage, and neither is a medium that fails.
            (Err(error @ (ArchiveError::Version { .. } | ArchiveError::Read { .. })), _) => {
                return Err(error);
            }
            (Err(error), Err(_)) => return Err(error),
            (Err(error), Ok(trailer)) => {
                read_description(source.as_ref(), trailer.copy).map_err(|_| error)?
            }
        };
        let archive = preamble.archive;
        let head_len = PREAMBLE_LEN as u64 + u64::from(preamble.description_len);
        let records = head_len.next_multiple_of(ALIGNMENT);

        let tail = match trailer {
            Ok(trailer) => {
                let levels = usize::from(description.grid.pyramid().finest().0) + 1;
                Tail::read(source.as_ref(), trailer, archive, head_len, levels)?
            }
            Err(_) => None,
        };
        let end = tail.as_ref().map_or(source.len(), |tail| tail.trailer.index);
        Ok(Self {
            source,
            description,
            archive,
            head_len,
            records: records..end.max(records),
            tail,
            may_walk,
            rebuilt: OnceLock::new(),
            walking: Mutex::new(()),
        })
    }

    /// What the archive says of itself.
    #[must_use]
    pub fn description(&self) -> &Description {
        &self.description
    }

    /// Length in bytes.
    #[must_use]
    pub fn len(&self) -> u64 {
        self.source.len()
    }

    /// Whether the archive has no bytes: never, once open.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.source.is_empty()
    }

    /// What is known of its levels, or `None` if the trailer or the summary is damaged.
    #[must_use]
    pub fn summary(&self) -> Option<&Summary> {
        self.tail.as_ref().map(|tail| &tail.summary)
    }

    /// What names the archive's content, as [`Written`](super::Written) has it; `None` if the
    /// trailer or the summary is damaged.
    #[must_use]
    pub fn content(&self) -> Option<u64> {
        self.tail.as_ref().map(|tail| checksum(&tail.trailer.to_bytes()))
    }

    /// Pages in the index.
    ///
    /// # Errors
    ///
    /// [`ArchiveError::Read`] if the index had to be rebuilt and the medium failed.
    pub fn page_count(&self) -> Result<u64, ArchiveError> {
        match &self.tail {
            Some(tail) => Ok(tail.trailer.entries),
            None => Ok(self.rebuilt()?.entries.len() as u64),
        }
    }

    /// What the index says of `page`; `None` if it has no valid texel, or is not the grid's.
    ///
    /// # Errors
    ///
    /// [`ArchiveError::Read`] if the medium fails. Damage to the index is not an error: the
    /// records answer instead, but for an archive [opened from afar](Self::open_afar).
    pub fn find(&self, page: PageAddress) -> Result<Option<PageEntry>, ArchiveError> {
        if !self.description.grid.pyramid().contains(page) {
            return Ok(None);
        }
        let key = PageKey::from(page);
        if let Some(tail) = self.tail.as_ref().filter(|_| self.rebuilt.get().is_none()) {
            match tail.find(self.source.as_ref(), key) {
                Ok(None) => return Ok(None),
                Ok(Some(entry)) if self.check(&entry).is_ok() => return Ok(Some(entry)),
                Err(error) if !self.may_walk || matches!(error, ArchiveError::Read { .. }) => {
                    return Err(error);
                }
                Ok(Some(_)) | Err(_) => {}
            }
        }
        let entries = &self.rebuilt()?.entries;
        let place = entries.binary_search_by_key(&key, |entry| entry.page.into());
        Ok(place.ok().map(|place| entries[place]))
    }

    /// [`Self::find`] without waiting: `None` if the index has to be read first, or another thread
    /// is adding to what has been read.
    #[must_use]
    pub fn find_resident(&self, page: PageAddress) -> Option<Option<PageEntry>> {
        if !self.description.grid.pyramid().contains(page) {
            return Some(None);
        }
        let key = PageKey::from(page);
        if let Some(rebuilt) = self.rebuilt.get() {
            let place = rebuilt.entries.binary_search_by_key(&key, |entry| entry.page.into());
            return Some(place.ok().map(|place| rebuilt.entries[place]));
        }
        let found = self.tail.as_ref()?.find_resident(key)?;
        // An entry that makes no sense sends the caller to `find`, and that to the records.
        found.is_none_or(|entry| self.check(&entry).is_ok()).then_some(found)
    }

    /// All pages in the order of their keys.
    ///
    /// # Errors
    ///
    /// [`ArchiveError::Read`] if the medium fails.
    pub fn entries(&self) -> Result<Vec<PageEntry>, ArchiveError> {
        if let Some(tail) = self.tail.as_ref().filter(|_| self.rebuilt.get().is_none()) {
            match self.entries_of(tail) {
                Ok(entries) => return Ok(entries),
                Err(error) if !self.may_walk || matches!(error, ArchiveError::Read { .. }) => {
                    return Err(error);
                }
                Err(_) => {}
            }
        }
        Ok(self.rebuilt()?.entries.clone())
    }

    /// The stored bytes of a page, proven; empty for a constant one.
    ///
    /// # Errors
    ///
    /// [`ArchiveError::PageChecksum`] if the page is damaged, [`ArchiveError::Truncated`] if it
    /// should lie past the end, [`ArchiveError::Read`] if the medium fails.
    pub fn payload(&self, entry: &PageEntry) -> Result<Vec<u8>, ArchiveError> {
        self.payload_by(entry, |buffer, offset| self.source.read_exact_at(buffer, offset))
    }

    /// [`Self::payload`] through `read`, which fills a buffer with the archive's bytes from an offset on.
    ///
    /// # Errors
    ///
    /// Those of [`Self::payload`].
    pub fn payload_by(
        &self,
        entry: &PageEntry,
        read: impl FnOnce(&mut [u8], u64) -> io::Result<()>,
    ) -> Result<Vec<u8>, ArchiveError> {
        let Payload::Record { offset, length, checksum } = entry.payload else {
            return Ok(Vec::new());
        };
        let what = "a page";
        let start = payload_start(offset);
        let end = start.saturating_add(u64::from(length));
        if end > self.source.len() {
            return Err(ArchiveError::Truncated { what, start, end, len: self.source.len() });
        }
        let mut payload = vec![0; length as usize];
        read(&mut payload, start).map_err(|source| ArchiveError::Read { what, source })?;
        let found = payload_checksum(entry.page, &payload);
        if found != checksum {
            let page = entry.page;
            return Err(ArchiveError::PageChecksum { page, found, expected: checksum });
        }
        Ok(payload)
    }

    /// Says that the stored bytes of a page will probably be read soon: [`ByteSource::advise`].
    pub fn advise(&self, entry: &PageEntry) {
        if let Payload::Record { offset, length, .. } = entry.payload {
            let start = payload_start(offset);
            self.source.advise(start..start.saturating_add(u64::from(length)));
        }
    }

    /// The file that the stored bytes of a page are in, and where they begin, if it is open just now
    /// ([`ByteSource::open_file`]); `None` for a constant one. They are proven by [`Self::payload`] alone.
    #[must_use]
    pub fn file_of(&self, entry: &PageEntry) -> Option<(Arc<File>, u64)> {
        let Payload::Record { offset, .. } = entry.payload else { return None };
        Some((self.source.open_file()?, payload_start(offset)))
    }

    /// The texels of a page.
    ///
    /// # Errors
    ///
    /// Those of [`Self::payload`], and [`ArchiveError::Page`].
    pub fn page(&self, entry: &PageEntry) -> Result<Page, ArchiveError> {
        self.decode(entry, &self.payload(entry)?)
    }

    /// The texels of a page whose payload has been read: no I/O.
    ///
    /// # Errors
    ///
    /// [`ArchiveError::Page`].
    pub fn decode(&self, entry: &PageEntry, payload: &[u8]) -> Result<Page, ArchiveError> {
        decode_page(&self.description, entry, payload)
    }

    /// The records as a walk finds them, without what no writer writes: pages that the grid does
    /// not have, and all but the first record of a page. The walk is done once.
    ///
    /// # Errors
    ///
    /// [`ArchiveError::Read`] if the medium fails, [`ArchiveError::Checksum`] if the archive was
    /// [opened from afar](Self::open_afar).
    pub fn rebuilt(&self) -> Result<&Recovered, ArchiveError> {
        if !self.may_walk {
            return Err(ArchiveError::Checksum { what: "the index", offset: self.records.end });
        }
        // A thread that panicked here left nothing half done.
        let _walking = match self.rebuilt.get() {
            Some(rebuilt) => return Ok(rebuilt),
            None => self.walking.lock().unwrap_or_else(PoisonError::into_inner),
        };
        if let Some(rebuilt) = self.rebuilt.get() {
            return Ok(rebuilt);
        }
        let mut found = self.scan()?;
        found.entries.retain(|entry| self.check(entry).is_ok());
        found.entries.dedup_by_key(|entry| entry.page);
        found.empty_runs.retain(|&(first, pages)| self.has_run(first, pages));
        Ok(self.rebuilt.get_or_init(|| found))
    }

    /// The records as a walk finds them, whatever they say.
    pub(super) fn scan(&self) -> Result<Recovered, ArchiveError> {
        recover::scan(self.source.as_ref(), self.archive, self.records.clone())
    }

    /// Refuses an entry that no writer writes.
    pub(super) fn check(&self, entry: &PageEntry) -> Result<(), ArchiveError> {
        let refuse = |reason| Err(ArchiveError::Entry { page: entry.page, reason });
        if !self.description.grid.pyramid().contains(entry.page) {
            return refuse("the grid has no such page");
        }
        if !entry.has_sound_figures() {
            return refuse("its figures are out of range");
        }
        match entry.payload {
            Payload::Record { offset, length, .. } => {
                let length = record_len(u64::from(length));
                let end = length.and_then(|length| offset.checked_add(length));
                let lies_among_records = offset >= self.records.start
                    && offset.is_multiple_of(ALIGNMENT)
                    && end.is_some_and(|end| end <= self.records.end);
                if !lies_among_records {
                    return refuse("its record does not lie among the records");
                }
            }
            Payload::Constant(ConstantTexel(texel)) => {
                if self.description.kind == Kind::Height && !f32::from_le_bytes(texel).is_finite() {
                    return refuse("its one height is not finite");
                }
            }
        }
        Ok(())
    }

    /// Whether the grid has the pages of a run: at least its ends, and as many on their level.
    pub(super) fn has_run(&self, first: PageKey, pages: u64) -> bool {
        let pyramid = self.description.grid.pyramid();
        let first_page = PageAddress::from(first);
        let Some((rows, cols)) = pyramid.pages(first_page.level) else { return false };
        let last = pages.checked_sub(1).and_then(|more| first.get().checked_add(more));
        last.map(|last| PageAddress::from(PageKey::from_raw(last))).is_some_and(|last| {
            last.level == first_page.level
                && pyramid.contains(first_page)
                && pyramid.contains(last)
                && pages <= u64::from(rows) * u64::from(cols)
        })
    }

    /// All entries straight from the index of `tail`: sound, in order, no page twice.
    pub(super) fn entries_of(&self, tail: &Tail) -> Result<Vec<PageEntry>, ArchiveError> {
        let entries = tail.entries(self.source.as_ref())?;
        for entry in &entries {
            self.check(entry)?;
        }
        if let Some(pair) = entries
            .windows(2)
            .find(|pair| PageKey::from(pair[0].page) >= PageKey::from(pair[1].page))
        {
            let reason = "the index is not in the order of keys";
            return Err(ArchiveError::Entry { page: pair[1].page, reason });
        }
        Ok(entries)
    }

    /// The tail as it is on the medium now, without blocks read before.
    pub(super) fn fresh_tail(&self) -> Result<Option<Tail>, ArchiveError> {
        let trailer = match read_trailer(self.source.as_ref()) {
            Err(error @ ArchiveError::Read { .. }) => return Err(error),
            Err(_) => return Ok(None),
            Ok(trailer) => trailer,
        };
        let levels = usize::from(self.description.grid.pyramid().finest().0) + 1;
        Tail::read(self.source.as_ref(), trailer, self.archive, self.head_len, levels)
    }

    /// Everything in the archive that is not as it was written, in words; empty if all is well.
    /// Reads the whole archive.
    ///
    /// # Errors
    ///
    /// [`ArchiveError::Read`] if the medium fails.
    pub fn damage(&self) -> Result<Vec<String>, ArchiveError> {
        super::audit::damage(self)
    }

    /// The bytes of the archive, as they are: nothing read of them is proven.
    #[must_use]
    pub fn source(&self) -> &dyn ByteSource {
        self.source.as_ref()
    }

    pub(super) fn id(&self) -> u64 {
        self.archive
    }

    pub(super) fn head_len(&self) -> u64 {
        self.head_len
    }

    pub(super) fn records(&self) -> Range<u64> {
        self.records.clone()
    }
}

/// Where the payload of a record lies.
fn payload_start(record: u64) -> u64 {
    record.saturating_add(RECORD_HEAD_LEN as u64)
}

/// The texels of a page from its stored bytes.
///
/// # Errors
///
/// [`ArchiveError::Page`] if the payload is not one of this kind and side.
pub fn decode_page(
    description: &Description,
    entry: &PageEntry,
    payload: &[u8],
) -> Result<Page, ArchiveError> {
    let side = description.grid.pyramid().page_side() as usize;
    let count = side * side;
    let fail = |source| ArchiveError::Page { page: entry.page, source };
    let (texels, coverage) = match (description.kind, entry.payload) {
        (Kind::Height, Payload::Constant(ConstantTexel(texel))) => {
            (Texels::Height(vec![f32::from_le_bytes(texel); count]), None)
        }
        (_, Payload::Constant(ConstantTexel([red, green, blue, _]))) => {
            (Texels::Color(vec![[red, green, blue]; count]), None)
        }
        (Kind::Height, Payload::Record { .. }) => {
            let (texels, coverage) =
                codec::decode_heights(payload, side, description.quantum).map_err(fail)?;
            (Texels::Height(texels), coverage)
        }
        (_, Payload::Record { .. }) => {
            let (texels, coverage) = codec::decode_colors(payload, side).map_err(fail)?;
            (Texels::Color(texels), coverage)
        }
    };
    Ok(Page::new(side, texels, coverage))
}
