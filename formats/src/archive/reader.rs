//! Reading an archive: opened by its trailer, each structure proven when it is first touched.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::{Arc, OnceLock, PoisonError, RwLock};

use super::description::{Description, Summary};
use super::entry::{ConstantTexel, PageEntry, Payload, payload_checksum};
use super::error::ArchiveError;
use super::index::{BLOCK_LEN, Block, CHILDREN_PER_BLOCK, IndexShape};
use super::layout::{
    MAX_JSON_LEN, PREAMBLE_LEN, Preamble, TRAILER_LEN, Trailer, archive_id, summary_checksum,
};
use super::record::RECORD_HEAD_LEN;
use super::recover::{self, Recovered};
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
    records: Range<u64>,
    /// `None` if the trailer is damaged.
    tail: Option<Tail>,
    rebuilt: OnceLock<Recovered>,
}

#[derive(Debug)]
struct Tail {
    trailer: Trailer,
    shape: IndexShape,
    summary: Summary,
    /// By number in the file's order.
    blocks: RwLock<HashMap<u64, Arc<Block>>>,
}

impl Archive {
    /// Opens the archive in `source`.
    ///
    /// # Errors
    ///
    /// [`ArchiveError`] if neither end of it can be understood, or the medium fails.
    pub fn open(source: Box<dyn ByteSource>) -> Result<Self, ArchiveError> {
        let trailer = read_trailer(source.as_ref());
        let front = read_description(source.as_ref(), 0);
        let (preamble, description) = match (front, &trailer) {
            (Ok(front), _) => front,
            // A version of another era is no damage.
            (Err(error @ ArchiveError::Version { .. }), _) => return Err(error),
            (Err(error), Err(_)) => return Err(error),
            (Err(error), Ok(trailer)) => {
                read_description(source.as_ref(), trailer.copy).map_err(|_| error)?
            }
        };
        let archive = preamble.archive;
        let head_len = PREAMBLE_LEN as u64 + u64::from(preamble.description_len);
        let records = head_len.next_multiple_of(super::record::ALIGNMENT);

        let tail = trailer.ok().and_then(|trailer| Tail::read(source.as_ref(), trailer, archive));
        let end = tail.as_ref().map_or(source.len(), |tail| tail.trailer.index);
        Ok(Self {
            source,
            description,
            archive,
            records: records..end.max(records),
            tail,
            rebuilt: OnceLock::new(),
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
    /// records answer instead.
    pub fn find(&self, page: PageAddress) -> Result<Option<PageEntry>, ArchiveError> {
        if !self.description.grid.pyramid().contains(page) {
            return Ok(None);
        }
        let key = PageKey::from(page);
        if let Some(tail) = self.tail.as_ref().filter(|_| self.rebuilt.get().is_none()) {
            match tail.find(self.source.as_ref(), key) {
                Ok(entry) => return Ok(entry),
                Err(error @ ArchiveError::Read { .. }) => return Err(error),
                Err(_) => {}
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
        self.tail.as_ref()?.find_resident(key)
    }

    /// All pages in the order of their keys.
    ///
    /// # Errors
    ///
    /// [`ArchiveError::Read`] if the medium fails.
    pub fn entries(&self) -> Result<Vec<PageEntry>, ArchiveError> {
        if let Some(tail) = self.tail.as_ref().filter(|_| self.rebuilt.get().is_none()) {
            match tail.entries(self.source.as_ref()) {
                Ok(entries) => return Ok(entries),
                Err(error @ ArchiveError::Read { .. }) => return Err(error),
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
        let Payload::Record { offset, length, checksum } = entry.payload else {
            return Ok(Vec::new());
        };
        let what = "a page";
        let start = offset.saturating_add(RECORD_HEAD_LEN as u64);
        let end = start.saturating_add(u64::from(length));
        if end > self.source.len() {
            return Err(ArchiveError::Truncated { what, start, end, len: self.source.len() });
        }
        let mut payload = vec![0; length as usize];
        self.source
            .read_exact_at(&mut payload, start)
            .map_err(|source| ArchiveError::Read { what, source })?;
        let found = payload_checksum(entry.page, &payload);
        if found != checksum {
            let page = entry.page;
            return Err(ArchiveError::PageChecksum { page, found, expected: checksum });
        }
        Ok(payload)
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

    /// The records as a walk finds them. The walk is done once.
    ///
    /// # Errors
    ///
    /// [`ArchiveError::Read`] if the medium fails.
    pub fn rebuilt(&self) -> Result<&Recovered, ArchiveError> {
        if let Some(rebuilt) = self.rebuilt.get() {
            return Ok(rebuilt);
        }
        let found = recover::scan(self.source.as_ref(), self.archive, self.records.clone())?;
        Ok(self.rebuilt.get_or_init(|| found))
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

    pub(super) fn source(&self) -> &dyn ByteSource {
        self.source.as_ref()
    }

    pub(super) fn id(&self) -> u64 {
        self.archive
    }

    pub(super) fn trailer(&self) -> Option<&Trailer> {
        self.tail.as_ref().map(|tail| &tail.trailer)
    }

    pub(super) fn records(&self) -> Range<u64> {
        self.records.clone()
    }

    /// All entries straight from the index.
    pub(super) fn index_entries(&self) -> Option<Result<Vec<PageEntry>, ArchiveError>> {
        self.tail.as_ref().map(|tail| tail.entries(self.source.as_ref()))
    }
}

impl Tail {
    /// What the trailer leads to, or `None` if it does not hold together.
    fn read(source: &dyn ByteSource, trailer: Trailer, archive: u64) -> Option<Self> {
        let shape = IndexShape::new(trailer.entries);
        let index_len = shape.block_count().checked_mul(BLOCK_LEN as u64)?;
        let ordered = trailer.archive == archive
            && trailer.records <= trailer.index
            && trailer.index.checked_add(index_len)? <= trailer.summary
            && trailer.summary.checked_add(trailer.summary_len)? <= trailer.copy
            && trailer.copy <= trailer.file_len
            && trailer.summary_len <= MAX_JSON_LEN;
        if !ordered {
            return None;
        }
        let mut json = vec![0; usize::try_from(trailer.summary_len).ok()?];
        source.read_exact_at(&mut json, trailer.summary).ok()?;
        if summary_checksum(&json) != trailer.summary_checksum {
            return None;
        }
        let summary = serde_json::from_slice(&json).ok()?;
        Some(Self { trailer, shape, summary, blocks: RwLock::default() })
    }

    fn find(
        &self,
        source: &dyn ByteSource,
        key: PageKey,
    ) -> Result<Option<PageEntry>, ArchiveError> {
        let walk = self.descend(key, |height, number, sum| {
            self.block(source, height, number, sum).map(Some)
        })?;
        Ok(walk.flatten())
    }

    fn find_resident(&self, key: PageKey) -> Option<Option<PageEntry>> {
        let blocks = self.blocks.try_read().ok()?;
        let walk = self.descend(key, |height, number, _| {
            Ok(blocks.get(&self.shape.position(height, number)).cloned())
        });
        walk.ok().flatten()
    }

    /// Follows `key` from the root to a leaf through blocks that `fetch` supplies. The outer
    /// `None` says that it did not have one.
    fn descend(
        &self,
        key: PageKey,
        fetch: impl Fn(usize, u64, u64) -> Result<Option<Arc<Block>>, ArchiveError>,
    ) -> Result<Option<Option<PageEntry>>, ArchiveError> {
        let Some(root) = self.shape.root_height() else { return Ok(Some(None)) };
        let (mut number, mut sum) = (0, self.trailer.root_checksum);
        for height in (0..=root).rev() {
            let Some(block) = fetch(height, number, sum)? else { return Ok(None) };
            if height == 0 {
                return Ok(Some(block.entry(key)));
            }
            let Some(child) = block.child(key) else { return Ok(Some(None)) };
            number = number * CHILDREN_PER_BLOCK as u64 + child.place as u64;
            sum = child.checksum;
        }
        Ok(Some(None))
    }

    /// A block, read and proven unless it is in memory.
    fn block(
        &self,
        source: &dyn ByteSource,
        height: usize,
        number: u64,
        sum: u64,
    ) -> Result<Arc<Block>, ArchiveError> {
        let position = self.shape.position(height, number);
        let what = "a block of the index";
        let offset = self.trailer.index + position * BLOCK_LEN as u64;
        let damaged = ArchiveError::Checksum { what, offset };
        if number >= self.shape.blocks_at(height) {
            return Err(damaged);
        }
        // A thread that panicked here left a whole map behind: insertion is its only change.
        let held =
            self.blocks.read().unwrap_or_else(PoisonError::into_inner).get(&position).cloned();
        if let Some(block) = held {
            return Ok(block);
        }
        let mut bytes = vec![0; BLOCK_LEN].into_boxed_slice();
        source
            .read_exact_at(&mut bytes, offset)
            .map_err(|source| ArchiveError::Read { what, source })?;
        let block = Arc::new(Block::parse(bytes, height, sum).ok_or(damaged)?);
        let mut blocks = self.blocks.write().unwrap_or_else(PoisonError::into_inner);
        Ok(Arc::clone(blocks.entry(position).or_insert(block)))
    }

    fn entries(&self, source: &dyn ByteSource) -> Result<Vec<PageEntry>, ArchiveError> {
        let mut entries = Vec::new();
        if let Some(root) = self.shape.root_height() {
            self.collect(source, root, 0, self.trailer.root_checksum, &mut entries)?;
        }
        Ok(entries)
    }

    fn collect(
        &self,
        source: &dyn ByteSource,
        height: usize,
        number: u64,
        sum: u64,
        entries: &mut Vec<PageEntry>,
    ) -> Result<(), ArchiveError> {
        let block = self.block(source, height, number, sum)?;
        if height == 0 {
            entries.extend(block.entries());
            return Ok(());
        }
        let mut place = 0;
        while let Some(child) = block.nth_child(place) {
            let number = number * CHILDREN_PER_BLOCK as u64 + place as u64;
            self.collect(source, height - 1, number, child.checksum, entries)?;
            place += 1;
        }
        Ok(())
    }
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

fn read_trailer(source: &dyn ByteSource) -> Result<Trailer, ArchiveError> {
    let what = "the trailer";
    let len = source.len();
    let Some(start) = len.checked_sub(TRAILER_LEN as u64) else {
        return Err(ArchiveError::Truncated { what, start: 0, end: TRAILER_LEN as u64, len });
    };
    let mut bytes = [0; TRAILER_LEN];
    source
        .read_exact_at(&mut bytes, start)
        .map_err(|source| ArchiveError::Read { what, source })?;
    Trailer::parse(&bytes, len)
}

/// Preamble and description at `offset`.
pub(super) fn read_description(
    source: &dyn ByteSource,
    offset: u64,
) -> Result<(Preamble, Description), ArchiveError> {
    let what = "the description";
    let len = source.len();
    let read = |buffer: &mut [u8], start: u64| {
        let end = start.saturating_add(buffer.len() as u64);
        if end > len {
            return Err(ArchiveError::Truncated { what, start, end, len });
        }
        source.read_exact_at(buffer, start).map_err(|source| ArchiveError::Read { what, source })
    };
    let mut bytes = [0; PREAMBLE_LEN];
    read(&mut bytes, offset)?;
    let preamble = Preamble::parse(&bytes, offset)?;
    let json_len = u64::from(preamble.description_len);
    if json_len > MAX_JSON_LEN.min(len) {
        let (field, expected) = ("description length", "at most 16 MiB and the archive");
        return Err(ArchiveError::Field { field, offset, found: json_len, expected });
    }
    let mut json = vec![0; preamble.description_len as usize];
    read(&mut json, offset + PREAMBLE_LEN as u64)?;
    if archive_id(&json) != preamble.archive {
        return Err(ArchiveError::Checksum { what, offset: offset + PREAMBLE_LEN as u64 });
    }
    Ok((preamble, Description::from_json(&json)?))
}
