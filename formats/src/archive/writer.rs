//! Writing an archive: front to back, never seeking.

use std::io::{self, Write};

use super::description::{Description, LevelSummary, Summary};
use super::entry::{PageEntry, Payload, payload_checksum};
use super::index;
use super::layout::{PREAMBLE_LEN, TRAILER_LEN, Trailer, summary_checksum};
use super::record::{ALIGNMENT, Marker, RECORD_HEAD_LEN, page_head, runs};
use super::recover::Unfinished;
use crate::address::{PageAddress, PageKey};

/// Writes an archive to `sink`, front to back.
///
/// Pages come in the builder's order; [`Self::end_unit`] closes each work unit with its marker,
/// and [`Self::finish`] adds what makes the archive whole. An archive that stops before that is
/// read by [`recover`](super::recover::scan) up to its last whole record.
#[derive(Debug)]
pub struct ArchiveWriter<W> {
    sink: W,
    /// Bytes written.
    position: u64,
    archive: u64,
    preamble_and_description: Vec<u8>,
    records: u64,
    entries: Vec<PageEntry>,
    levels: Vec<LevelSummary>,
    unit: u64,
    constants: Vec<PageEntry>,
    empty: Vec<PageKey>,
}

/// What a finished archive amounts to.
#[derive(Clone, Debug, PartialEq)]
pub struct Written {
    /// Length of the archive in bytes.
    pub bytes: u64,
    /// What it says of its levels.
    pub summary: Summary,
    /// XXH3 of the trailer: the trailer proves everything else, so this names the content.
    pub content: u64,
}

impl<W: Write> ArchiveWriter<W> {
    /// Starts an archive.
    ///
    /// # Errors
    ///
    /// Those of the sink, here and in every method: after one, the archive ends with its last whole
    /// record. A description of more than 2^24 bytes.
    pub fn new(sink: W, description: &Description) -> io::Result<Self> {
        let mut writer = Self::empty_at(sink, description)?;
        let head = std::mem::take(&mut writer.preamble_and_description);
        writer.write(&head)?;
        writer.preamble_and_description = head;
        writer.align()?;
        writer.records = writer.position;
        Ok(writer)
    }

    /// Goes on with an archive that stopped: `sink` stands at its [`Unfinished::end`].
    ///
    /// # Errors
    ///
    /// A description of more than 2^24 bytes.
    pub fn resume(sink: W, description: &Description, begun: Unfinished) -> io::Result<Self> {
        let mut writer = Self::empty_at(sink, description)?;
        writer.position = begun.end;
        writer.records = begun.records;
        writer.unit = begun.units;
        for entry in &begun.entries {
            writer.count(entry);
        }
        writer.entries = begun.entries;
        Ok(writer)
    }

    fn empty_at(sink: W, description: &Description) -> io::Result<Self> {
        let (archive, head) = description.head()?;
        let levels =
            vec![LevelSummary::default(); usize::from(description.grid.pyramid().finest().0) + 1];
        Ok(Self {
            sink,
            position: 0,
            archive,
            preamble_and_description: head,
            records: 0,
            entries: Vec::new(),
            levels,
            unit: 0,
            constants: Vec::new(),
            empty: Vec::new(),
        })
    }

    /// Work units closed.
    pub fn units(&self) -> u64 {
        self.unit
    }

    /// The name by which records know their archive.
    pub fn archive(&self) -> u64 {
        self.archive
    }

    /// Bytes written.
    pub fn bytes(&self) -> u64 {
        self.position
    }

    /// Whether there is no page yet that has a valid texel.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// The sink. What is written to it is not the archive's.
    pub fn sink(&mut self) -> &mut W {
        &mut self.sink
    }

    /// Counts a page in the summary of its level.
    fn count(&mut self, entry: &PageEntry) {
        let level = &mut self.levels[usize::from(entry.page.level.0)];
        level.pages += 1;
        level.bound_max = level.bound_max.max(entry.bound);
        level.source_error_max = level.source_error_max.max(entry.source_error);
        match entry.payload {
            Payload::Constant(_) => level.constant += 1,
            Payload::Record { length, .. } => level.bytes += u64::from(length),
        }
    }

    /// Adds a page. A constant one goes into the unit's marker; the place of a payload, given in
    /// `entry`, is filled in here.
    ///
    /// # Errors
    ///
    /// Those of the sink.
    ///
    /// # Panics
    ///
    /// If the page's level is not the grid's, or `payload` is longer than 4 GiB.
    pub fn page(&mut self, entry: PageEntry, payload: &[u8]) -> io::Result<()> {
        if let Payload::Constant(_) = entry.payload {
            self.count(&entry);
            self.constants.push(entry);
            self.entries.push(entry);
            return Ok(());
        }
        let length = u32::try_from(payload.len()).expect("a page's payload is a few megabytes");
        let checksum = payload_checksum(entry.page, payload);
        let offset = self.position;
        let entry = PageEntry { payload: Payload::Record { offset, length, checksum }, ..entry };
        self.write(&page_head(self.archive, &entry, length))?;
        self.write(payload)?;
        self.align()?;
        self.count(&entry);
        self.entries.push(entry);
        Ok(())
    }

    /// Notes a page without a valid texel.
    pub fn empty(&mut self, page: PageAddress) {
        self.empty.push(page.into());
    }

    /// Closes a work unit.
    ///
    /// # Errors
    ///
    /// Those of the sink.
    pub fn end_unit(&mut self) -> io::Result<()> {
        self.empty.sort_unstable();
        let marker = Marker {
            unit: self.unit,
            constants: std::mem::take(&mut self.constants),
            empty_runs: runs(&self.empty),
        };
        self.empty.clear();
        self.unit += 1;
        let bytes = marker.to_bytes(self.archive);
        self.write(&bytes)?;
        self.align()
    }

    /// Adds index, summary and trailer, and gives the sink back, flushed but not synced. Closes the
    /// work unit if pages of it would be in no record otherwise.
    ///
    /// # Errors
    ///
    /// Those of the sink.
    pub fn finish(mut self) -> io::Result<(W, Written)> {
        if !(self.constants.is_empty() && self.empty.is_empty()) {
            self.end_unit()?;
        }
        self.entries.sort_unstable_by_key(|entry| PageKey::from(entry.page));
        let (blocks, root_checksum) = index::build(&self.entries, self.archive);
        let index = self.position;
        self.write(&blocks)?;

        let summary = Summary { levels: std::mem::take(&mut self.levels), units: self.unit };
        let json = serde_json::to_vec(&summary)?;
        let summary_at = self.position;
        self.write(&json)?;
        let copy = self.position;
        let head = std::mem::take(&mut self.preamble_and_description);
        self.write(&head)?;
        let trailer = Trailer {
            archive: self.archive,
            records: self.records,
            index,
            entries: self.entries.len() as u64,
            root_checksum,
            summary: summary_at,
            summary_len: json.len() as u64,
            summary_checksum: summary_checksum(&json),
            copy,
            file_len: self.position + TRAILER_LEN as u64,
        }
        .to_bytes();
        self.write(&trailer)?;
        self.sink.flush()?;
        let content = super::bytes::checksum(&trailer);
        Ok((self.sink, Written { bytes: self.position, summary, content }))
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.sink.write_all(bytes)?;
        self.position += bytes.len() as u64;
        Ok(())
    }

    /// Pads with zeros to where the next record may start.
    fn align(&mut self) -> io::Result<()> {
        #[expect(clippy::cast_possible_truncation, reason = "4096 fits any usize")]
        const ZEROS: [u8; ALIGNMENT as usize] = [0; ALIGNMENT as usize];
        let missing = self.position.next_multiple_of(ALIGNMENT) - self.position;
        #[expect(clippy::cast_possible_truncation, reason = "less than the alignment")]
        self.write(&ZEROS[..missing as usize])
    }
}

const _: () = assert!(PREAMBLE_LEN.is_multiple_of(8) && RECORD_HEAD_LEN.is_multiple_of(8));
