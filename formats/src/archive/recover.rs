//! Walking the records of an archive: without its index, behind damage, or before it is whole.

use std::ops::Range;

use super::description::Description;
use super::entry::{PageEntry, Payload, payload_checksum};
use super::error::ArchiveError;
use super::record::{ALIGNMENT, Marker, RECORD_HEAD_LEN, RecordHead, parse_head, record_len};
use crate::address::PageKey;
use crate::storage::ByteSource;

/// What a walk over the records found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recovered {
    /// The pages, sorted by key.
    pub entries: Vec<PageEntry>,
    /// Runs of pages without data, as the markers list them.
    pub empty_runs: Vec<(PageKey, u64)>,
    /// Work units whose marker was found, in their order.
    pub units: Vec<u64>,
    /// Ranges in bytes that hold no record and are not what the format puts there.
    pub damaged: Vec<Range<u64>>,
    /// Where the walk ended: behind the last whole record.
    pub end: u64,
}

/// Walks the records of archive `archive` in `range`, which starts where a record may.
///
/// Heads are trusted only when their checksum holds, and a marker's lists likewise; payloads are
/// not read. Behind something that is no record, the walk goes on at the next multiple of 4096.
///
/// # Errors
///
/// [`ArchiveError::Read`] if the medium fails.
pub fn scan(
    source: &dyn ByteSource,
    archive: u64,
    range: Range<u64>,
) -> Result<Recovered, ArchiveError> {
    let mut found = Recovered { end: range.start, ..Recovered::default() };
    let mut position = range.start;
    while position < range.end {
        let (record, length) = record_at(source, archive, position, range.end)?;
        let end = position.saturating_add(length).min(range.end);
        if record.is_some() {
            found.end = end;
        }
        match record.map(|(record, _)| record) {
            Some(Found::Page(entry)) => found.entries.push(entry),
            Some(Found::Marker(marker)) => {
                found.units.push(marker.unit);
                found.entries.extend(marker.constants);
                found.empty_runs.extend(marker.empty_runs);
            }
            None => match found.damaged.last_mut() {
                Some(last) if last.end == position => last.end = end,
                _ => found.damaged.push(position..end),
            },
        }
        position = end;
    }
    found.entries.sort_by_key(|entry| PageKey::from(entry.page));
    Ok(found)
}

/// An archive that stopped while it was written, up to its last whole work unit.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Unfinished {
    /// Where the records start.
    pub records: u64,
    /// The pages, in their order.
    pub entries: Vec<PageEntry>,
    /// Work units, from the first on.
    pub units: u64,
    /// Where the next record goes: behind the last marker. What follows is to be cut off.
    pub end: u64,
}

/// What `source` has of the archive of `description`; `None` if it is another's or starts otherwise.
///
/// Every byte up to [`Unfinished::end`] is proven: by a checksum, payloads included, or as a zero
/// that pads.
///
/// # Errors
///
/// [`ArchiveError::Read`] if the medium fails.
pub fn unfinished(
    source: &dyn ByteSource,
    description: &Description,
) -> Result<Option<Unfinished>, ArchiveError> {
    let Ok((archive, expected)) = description.head() else { return Ok(None) };
    let mut front = vec![0; expected.len()];
    let records = (front.len() as u64).next_multiple_of(ALIGNMENT);
    if source.len() < records {
        return Ok(None);
    }
    read(source, &mut front, 0)?;
    if front != expected || !is_padding(source, front.len() as u64..records)? {
        return Ok(None);
    }
    let mut found = Unfinished { records, end: records, ..Unfinished::default() };
    let (mut position, mut pending) = (records, Vec::new());
    let levels = description.grid.pyramid().finest();
    while position < source.len() {
        let (record, length) = record_at(source, archive, position, source.len())?;
        let Some((record, body_end)) = record else { break };
        position += length;
        if !is_padding(source, body_end..position)? {
            break;
        }
        match record {
            Found::Page(entry) if entry.page.level <= levels && is_whole(source, &entry)? => {
                pending.push(entry);
            }
            Found::Marker(marker) if marker.unit == found.units => {
                found.entries.append(&mut pending);
                found.entries.extend(marker.constants);
                found.units += 1;
                found.end = position;
            }
            _ => break,
        }
    }
    Ok(Some(found))
}

/// Whether nothing but zeros stands in `range`, which lies in the file and is shorter than
/// [`ALIGNMENT`].
fn is_padding(source: &dyn ByteSource, range: Range<u64>) -> Result<bool, ArchiveError> {
    let mut bytes = vec![0; usize::try_from(range.end - range.start).unwrap_or(0)];
    read(source, &mut bytes, range.start)?;
    Ok(bytes.iter().all(|&byte| byte == 0))
}

/// Whether the payload is the one that the entry speaks of.
fn is_whole(source: &dyn ByteSource, entry: &PageEntry) -> Result<bool, ArchiveError> {
    let Payload::Record { offset, length, checksum } = entry.payload else { return Ok(false) };
    // No larger than the file, because the record fits it.
    let mut payload = vec![0; length as usize];
    read(source, &mut payload, offset + RECORD_HEAD_LEN as u64)?;
    Ok(payload_checksum(entry.page, &payload) == checksum)
}

enum Found {
    Page(PageEntry),
    Marker(Marker),
}

/// The record at `position` and where its body ends, if a whole one is there, and how far it is to
/// where the next may be.
fn record_at(
    source: &dyn ByteSource,
    archive: u64,
    position: u64,
    end: u64,
) -> Result<(Option<(Found, u64)>, u64), ArchiveError> {
    const NOTHING: (Option<(Found, u64)>, u64) = (None, ALIGNMENT);
    if end - position < RECORD_HEAD_LEN as u64 {
        return Ok(NOTHING);
    }
    let mut head = [0; RECORD_HEAD_LEN];
    read(source, &mut head, position)?;
    let Some((record, body_len)) = parse_head(&head, archive) else { return Ok(NOTHING) };
    let Some(length) = record_len(body_len).filter(|length| *length <= end - position) else {
        return Ok(NOTHING);
    };
    let body_end = position + RECORD_HEAD_LEN as u64 + body_len;
    match record {
        RecordHead::Page(entry) => {
            let in_place = matches!(entry.payload, Payload::Record { offset, length, .. }
                if offset == position && u64::from(length) == body_len);
            Ok(if in_place { (Some((Found::Page(entry), body_end)), length) } else { NOTHING })
        }
        RecordHead::Marker(head) => {
            // No larger than the file, because the record fits it.
            let mut body = vec![0; usize::try_from(body_len).unwrap_or(0)];
            read(source, &mut body, position + RECORD_HEAD_LEN as u64)?;
            // A head that is whole is believed on the length of a body that is not. It is also
            // what keeps the walk linear: no body is read twice.
            let marker = Marker::parse(head, &body, position).ok();
            Ok((marker.map(|marker| (Found::Marker(marker), body_end)), length))
        }
    }
}

fn read(source: &dyn ByteSource, buffer: &mut [u8], offset: u64) -> Result<(), ArchiveError> {
    source
        .read_exact_at(buffer, offset)
        .map_err(|source| ArchiveError::Read { what: "a record", source })
}
