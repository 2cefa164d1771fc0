//! Walking the records of an archive: without its index, behind damage, or before it is whole.

use std::ops::Range;

use super::entry::{PageEntry, Payload};
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
    while position.saturating_add(RECORD_HEAD_LEN as u64) <= range.end {
        match record_at(source, archive, position, range.end)? {
            Some((record, length)) => {
                match record {
                    Found::Page(entry) => found.entries.push(entry),
                    Found::Marker(marker) => {
                        found.units.push(marker.unit);
                        found.entries.extend(marker.constants);
                        found.empty_runs.extend(marker.empty_runs);
                    }
                }
                position += length;
                found.end = position;
            }
            None => {
                match found.damaged.last_mut() {
                    Some(last) if last.end == position => last.end += ALIGNMENT,
                    _ => found.damaged.push(position..position + ALIGNMENT),
                }
                position += ALIGNMENT;
            }
        }
    }
    found.entries.sort_by_key(|entry| PageKey::from(entry.page));
    Ok(found)
}

enum Found {
    Page(PageEntry),
    Marker(Marker),
}

/// The record at `position` and its length with padding, if a whole one is there.
fn record_at(
    source: &dyn ByteSource,
    archive: u64,
    position: u64,
    end: u64,
) -> Result<Option<(Found, u64)>, ArchiveError> {
    let mut head = [0; RECORD_HEAD_LEN];
    read(source, &mut head, position)?;
    let Some((record, body_len)) = parse_head(&head, archive) else { return Ok(None) };
    let Some(length) = record_len(body_len).filter(|length| *length <= end - position) else {
        return Ok(None);
    };
    let found = match record {
        RecordHead::Page(entry) => {
            let in_place = matches!(entry.payload, Payload::Record { offset, length, .. }
                if offset == position && u64::from(length) == body_len);
            in_place.then_some(Found::Page(entry))
        }
        RecordHead::Marker(head) => {
            // No larger than the file, because the record fits it.
            let mut body = vec![0; usize::try_from(body_len).unwrap_or(0)];
            read(source, &mut body, position + RECORD_HEAD_LEN as u64)?;
            Marker::parse(head, &body, position).ok().map(Found::Marker)
        }
    };
    Ok(found.map(|found| (found, length)))
}

fn read(source: &dyn ByteSource, buffer: &mut [u8], offset: u64) -> Result<(), ArchiveError> {
    source
        .read_exact_at(buffer, offset)
        .map_err(|source| ArchiveError::Read { what: "a record", source })
}
