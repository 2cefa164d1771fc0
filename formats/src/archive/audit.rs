//! Looking at every byte of an archive.

use super::entry::{PageEntry, Payload};
use super::error::ArchiveError;
use super::index::{BLOCK_LEN, IndexShape};
use super::layout::{PREAMBLE_LEN, TRAILER_LEN};
use super::reader::{Archive, read_description};
use super::record::{ALIGNMENT, RECORD_HEAD_LEN, record_len};
use super::recover;
use crate::storage::ByteSource;

/// Everything in `archive` that is not as it was written, in words.
pub(super) fn damage(archive: &Archive) -> Result<Vec<String>, ArchiveError> {
    let mut problems = Vec::new();
    let source = archive.source();
    let mut note = |result: Result<(), ArchiveError>| match result {
        Err(error @ ArchiveError::Read { .. }) => Err(error),
        Err(error) => {
            problems.push(error.to_string());
            Ok(())
        }
        Ok(()) => Ok(()),
    };

    let json_len = archive.description().to_json().len() as u64;
    let head_len = PREAMBLE_LEN as u64 + json_len;
    note(read_description(source, 0).map(drop))?;
    note(zeros(source, head_len, archive.records().start, "the padding of the description"))?;

    // The walk proves heads and markers; payloads and padding are looked at one by one.
    let found = recover::scan(source, archive.id(), archive.records())?;
    for range in &found.damaged {
        let what = "a record";
        note(Err(ArchiveError::Checksum { what, offset: range.start }))?;
    }
    for entry in &found.entries {
        note(archive.page(entry).map(drop))?;
    }
    note(record_padding(archive))?;

    match (archive.trailer(), archive.index_entries()) {
        (Some(trailer), Some(indexed)) => {
            note(read_description(source, trailer.copy).map(drop))?;
            let blocks = IndexShape::new(trailer.entries).block_count() * BLOCK_LEN as u64;
            let ends_meet = trailer.records == archive.records().start
                && trailer.index + blocks == trailer.summary
                && trailer.summary + trailer.summary_len == trailer.copy
                && trailer.copy + head_len + TRAILER_LEN as u64 == trailer.file_len;
            if !ends_meet {
                let what = "the layout of the trailer";
                note(Err(ArchiveError::Checksum { what, offset: trailer.copy }))?;
            }
            match indexed {
                Ok(indexed) if same(&indexed, &found.entries) => {}
                Ok(_) => {
                    let what = "the index, which is whole but does not list the records,";
                    note(Err(ArchiveError::Checksum { what, offset: trailer.index }))?;
                }
                Err(error) => note(Err(error))?,
            }
        }
        _ => {
            let offset = source.len().saturating_sub(TRAILER_LEN as u64);
            note(Err(ArchiveError::Checksum { what: "the trailer or the summary", offset }))?;
        }
    }
    Ok(problems)
}

/// Whether two lists of entries are the same to the bit, NaN included.
fn same(one: &[PageEntry], other: &[PageEntry]) -> bool {
    one.iter().map(PageEntry::to_bytes).eq(other.iter().map(PageEntry::to_bytes))
}

/// Checks that what lies between the body of each record and the next record is zero.
fn record_padding(archive: &Archive) -> Result<(), ArchiveError> {
    let source = archive.source();
    let mut position = archive.records().start;
    let end = archive.records().end;
    while position < end {
        let mut head = [0; RECORD_HEAD_LEN];
        source
            .read_exact_at(&mut head, position)
            .map_err(|source| ArchiveError::Read { what: "a record", source })?;
        let parsed = super::record::parse_head(&head, archive.id());
        let length = parsed.and_then(|(_, body)| Some((body, record_len(body)?)));
        match length {
            Some((body, length)) if length <= end - position => {
                let body_end = position + RECORD_HEAD_LEN as u64 + body;
                zeros(source, body_end, position + length, "the padding of a record")?;
                position += length;
            }
            _ => position += ALIGNMENT,
        }
    }
    Ok(())
}

fn zeros(
    source: &dyn ByteSource,
    start: u64,
    end: u64,
    what: &'static str,
) -> Result<(), ArchiveError> {
    let length = end.saturating_sub(start).min(ALIGNMENT);
    let mut padding = vec![0; usize::try_from(length).unwrap_or(0)];
    source
        .read_exact_at(&mut padding, start)
        .map_err(|source| ArchiveError::Read { what, source })?;
    if padding.iter().any(|&byte| byte != 0) {
        return Err(ArchiveError::Checksum { what, offset: start });
    }
    Ok(())
}

/// Where the records and payloads of `entry` lie: used by tests that damage one page.
#[must_use]
pub fn record_range(entry: &PageEntry) -> Option<std::ops::Range<u64>> {
    match entry.payload {
        Payload::Record { offset, length, .. } => {
            Some(offset..offset + record_len(u64::from(length))?)
        }
        Payload::Constant(_) => None,
    }
}
