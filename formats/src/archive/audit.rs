//! Looking at every byte of an archive.

use std::ops::Range;

use super::entry::{PageEntry, Payload};
use super::error::ArchiveError;
use super::layout::TRAILER_LEN;
use super::reader::Archive;
use super::record::{ALIGNMENT, RECORD_HEAD_LEN, parse_head, record_len};
use super::tail::read_description;
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

    note(read_description(source, 0).map(drop))?;
    let padding = archive.head_len()..archive.records().start;
    note(zeros(source, padding, "the padding of the description"))?;

    // The walk proves heads and markers; payloads and padding are looked at one by one.
    let found = archive.scan()?;
    for range in &found.damaged {
        let what = "a record";
        note(Err(ArchiveError::Checksum { what, offset: range.start }))?;
    }
    for entry in &found.entries {
        note(archive.check(entry))?;
        note(archive.page(entry).map(drop))?;
    }
    for &(first, _) in found.empty_runs.iter().filter(|run| !archive.has_run(run.0, run.1)) {
        let reason = "it is listed as empty, but the grid does not have it";
        note(Err(ArchiveError::Entry { page: first.into(), reason }))?;
    }
    note(record_padding(archive))?;

    let Some(tail) = archive.fresh_tail()? else {
        let offset = source.len().saturating_sub(TRAILER_LEN as u64);
        note(Err(ArchiveError::Checksum { what: "the trailer or the summary", offset }))?;
        return Ok(problems);
    };
    note(read_description(source, tail.copy()).map(drop))?;
    match archive.entries_of(&tail) {
        Ok(indexed) if same(&indexed, &found.entries) => {}
        Ok(_) => {
            let what = "the index, which is whole but does not list the records,";
            note(Err(ArchiveError::Checksum { what, offset: tail.index() }))?;
        }
        Err(error) => note(Err(error))?,
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
    let Range { start: mut position, end } = archive.records();
    while position.saturating_add(RECORD_HEAD_LEN as u64) <= end {
        let mut head = [0; RECORD_HEAD_LEN];
        source
            .read_exact_at(&mut head, position)
            .map_err(|source| ArchiveError::Read { what: "a record", source })?;
        let parsed = parse_head(&head, archive.id());
        let length = parsed.and_then(|(_, body)| Some((body, record_len(body)?)));
        match length {
            Some((body, length)) if length <= end - position => {
                let body_end = position + RECORD_HEAD_LEN as u64 + body;
                zeros(source, body_end..position + length, "the padding of a record")?;
                position += length;
            }
            _ => position += ALIGNMENT,
        }
    }
    Ok(())
}

/// Checks that `range`, which is shorter than [`ALIGNMENT`], is zero.
fn zeros(
    source: &dyn ByteSource,
    range: Range<u64>,
    what: &'static str,
) -> Result<(), ArchiveError> {
    let (Range { start, end }, len) = (range, source.len());
    if end > len {
        return Err(ArchiveError::Truncated { what, start, end, len });
    }
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
pub fn record_range(entry: &PageEntry) -> Option<Range<u64>> {
    match entry.payload {
        Payload::Record { offset, length, .. } => {
            Some(offset..offset + record_len(u64::from(length))?)
        }
        Payload::Constant(_) => None,
    }
}
