//! The end of an archive and what it leads to: the trailer, the descriptions, the index.

use std::collections::HashMap;
use std::sync::{Arc, PoisonError, RwLock};

use super::description::{Description, Summary};
use super::entry::PageEntry;
use super::error::ArchiveError;
use super::index::{BLOCK_LEN, Block, CHILDREN_PER_BLOCK, IndexShape};
use super::layout::{
    MAX_JSON_LEN, PREAMBLE_LEN, Preamble, TRAILER_LEN, Trailer, archive_id, summary_checksum,
};
use super::record::ALIGNMENT;
use crate::address::PageKey;
use crate::storage::ByteSource;

/// What a whole trailer leads to.
#[derive(Debug)]
pub(super) struct Tail {
    archive: u64,
    pub(super) trailer: Trailer,
    shape: IndexShape,
    pub(super) summary: Summary,
    /// By number in the file's order.
    blocks: RwLock<HashMap<u64, Arc<Block>>>,
}

impl Tail {
    /// What the trailer leads to, or `None` if it does not hold together with a head of `head_len`
    /// bytes and a pyramid of `levels` levels.
    pub(super) fn read(
        source: &dyn ByteSource,
        trailer: Trailer,
        archive: u64,
        head_len: u64,
        levels: usize,
    ) -> Result<Option<Self>, ArchiveError> {
        let shape = IndexShape::new(trailer.entries);
        let fits = trailer.archive == archive
            && trailer.summary_len <= MAX_JSON_LEN
            && parts_meet(&trailer, &shape, head_len).unwrap_or(false);
        if !fits {
            return Ok(None);
        }
        // No larger than the file, because the parts meet.
        let mut json = vec![0; usize::try_from(trailer.summary_len).unwrap_or(0)];
        source
            .read_exact_at(&mut json, trailer.summary)
            .map_err(|source| ArchiveError::Read { what: "the summary", source })?;
        if summary_checksum(&json) != trailer.summary_checksum {
            return Ok(None);
        }
        let summary: Option<Summary> = serde_json::from_slice(&json).ok();
        let summary = summary.filter(|summary| summary.levels.len() == levels);
        Ok(summary.map(|summary| Self {
            archive,
            trailer,
            shape,
            summary,
            blocks: RwLock::default(),
        }))
    }

    /// Where the index starts.
    pub(super) fn index(&self) -> u64 {
        self.trailer.index
    }

    /// Where the copy of preamble and description starts.
    pub(super) fn copy(&self) -> u64 {
        self.trailer.copy
    }

    pub(super) fn find(
        &self,
        source: &dyn ByteSource,
        key: PageKey,
    ) -> Result<Option<PageEntry>, ArchiveError> {
        let walk = self.descend(key, |height, number, sum| {
            self.block(source, height, number, sum).map(Some)
        })?;
        Ok(walk.flatten())
    }

    pub(super) fn find_resident(&self, key: PageKey) -> Option<Option<PageEntry>> {
        let blocks = self.blocks.try_read().ok()?;
        let walk = self.descend(key, |height, number, _| {
            let position = self.shape.position(height, number);
            Ok(position.and_then(|position| blocks.get(&position)).cloned())
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
        let what = "a block of the index";
        let Some(position) = self.shape.position(height, number) else {
            return Err(ArchiveError::Checksum { what, offset: self.trailer.index });
        };
        let offset = self.trailer.index + position * BLOCK_LEN as u64;
        let damaged = ArchiveError::Checksum { what, offset };
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
        let items = self.shape.items_in(height, number);
        let block = Block::parse(bytes, self.archive, height, items, sum).ok_or(damaged)?;
        let block = Arc::new(block);
        let mut blocks = self.blocks.write().unwrap_or_else(PoisonError::into_inner);
        Ok(Arc::clone(blocks.entry(position).or_insert(block)))
    }

    pub(super) fn entries(&self, source: &dyn ByteSource) -> Result<Vec<PageEntry>, ArchiveError> {
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

/// Whether the parts that a trailer names follow one another without a gap up to the end of the
/// file; `None` if an offset leaves `u64`.
fn parts_meet(trailer: &Trailer, shape: &IndexShape, head_len: u64) -> Option<bool> {
    let index_len = shape.block_count().checked_mul(BLOCK_LEN as u64)?;
    let copy_end = trailer.copy.checked_add(head_len)?;
    Some(
        trailer.records == head_len.next_multiple_of(ALIGNMENT)
            && trailer.records <= trailer.index
            && trailer.index.is_multiple_of(ALIGNMENT)
            && trailer.index.checked_add(index_len)? == trailer.summary
            && trailer.summary.checked_add(trailer.summary_len)? == trailer.copy
            && copy_end.checked_add(TRAILER_LEN as u64)? == trailer.file_len,
    )
}

pub(super) fn read_trailer(source: &dyn ByteSource) -> Result<Trailer, ArchiveError> {
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
