//! What is left of an earlier build, and whether it is gone on with.

use std::fmt;
use std::io;
use std::sync::{Mutex, PoisonError};

use areoid_formats::archive::{Archive, Description, recover};
use areoid_formats::catalog::{
    Build, CatalogError, Disk, Existing, NewDataset, publish_stray, stray,
};
use areoid_formats::storage::{ByteSource, FileSource};

use super::kept;
use super::request::{Event, IngestError, Leftover, Request, Unfinished, Watch, tell};
use crate::build::{Begun, Proceed};
use crate::note::Note;

/// Publishes the archive that a process killed between its last two steps left whole, if there is
/// one: its generation and itself.
pub(super) fn publish_left(
    disk: &dyn Disk,
    request: &Request,
    description: &Description,
    watch: Watch<'_>,
) -> Result<Option<(u64, Archive)>, IngestError> {
    let (folder, name) = (&request.catalog, &description.dataset);
    let Some(archive) = stray(folder, description)? else { return Ok(None) };
    let Some(content) = archive.content() else { return Ok(None) };
    tell(watch, Event::Leftover(Leftover::Whole))?;
    // What was begun since makes the same.
    Build::start(disk, folder, name)?.discard()?;
    watch(Event::Publishing);
    let dataset = new_dataset(description, archive.len(), content, request.existing);
    match publish_stray(disk, folder, dataset) {
        Ok(generation) => Ok(Some((generation, archive))),
        Err(CatalogError::Missing { .. }) => Ok(None),
        Err(error) => Err(kept(error.into())),
    }
}

/// What the manifest is to say of an archive.
pub(super) fn new_dataset(
    description: &Description,
    bytes: u64,
    content: u64,
    existing: Existing,
) -> NewDataset {
    NewDataset {
        name: description.dataset.clone(),
        group: None,
        kind: description.kind,
        priority: description.priority,
        body: description.body.clone(),
        bytes,
        content,
        source: description.source.clone(),
        existing,
    }
}

/// The place of a build, what is gone on with there, and what is told of what was left and is not.
pub(super) type Place<'a> = (Build<'a>, Option<Begun>, Option<Leftover>);

/// Opens the place of the build, and what is left there of an earlier one that can be gone on with.
pub(super) fn begin<'a>(
    disk: &'a dyn Disk,
    request: &Request,
    description: &Description,
    watch: Watch<'_>,
) -> Result<Place<'a>, IngestError> {
    let (folder, name) = (&request.catalog, &description.dataset);
    let mut build = Build::resume(disk, folder, name)?;
    let source = build.source()?;
    let left = !source.is_empty();
    if request.unfinished == Unfinished::Discard {
        // What cannot be read could not have been gone on with.
        let ours = recover::is_begun(&source, description).unwrap_or(false);
        build.cut(0)?;
        let leftover = if ours { Leftover::Discarded } else { Leftover::Unrelated };
        return Ok((build, None, left.then_some(leftover)));
    }
    let source = Heeding::new(source, watch);
    let archive = recover::unfinished(&source, description).map_err(|error| {
        if source.is_stopped() {
            return IngestError::Kept(Box::new(IngestError::Interrupted));
        }
        IngestError::Leftover { dataset: name.clone(), source: error }
    })?;
    let unrelated = left && archive.is_none();
    let Some(archive) = archive.filter(|archive| archive.units > 0) else {
        build.cut(0)?;
        return Ok((build, None, unrelated.then_some(Leftover::Unrelated)));
    };
    build.cut(archive.end)?;
    let note = build.last_note()?.and_then(|note| Note::from_bytes(&note));
    Ok((build, Some(Begun { archive, note }), None))
}

/// An unfinished archive, which is read from front to back until somebody wants to stop.
struct Heeding<'a> {
    source: FileSource,
    state: Mutex<State<'a>>,
}

struct State<'a> {
    watch: Watch<'a>,
    /// Where the next event is due.
    due: u64,
    stopped: bool,
}

/// Bytes between two events.
const TOLD_EVERY: u64 = 1 << 20;

impl<'a> Heeding<'a> {
    fn new(source: FileSource, watch: Watch<'a>) -> Self {
        Self { source, state: Mutex::new(State { watch, due: 0, stopped: false }) }
    }

    fn is_stopped(&self) -> bool {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).stopped
    }
}

impl ByteSource for Heeding<'_> {
    fn len(&self) -> u64 {
        self.source.len()
    }

    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if offset >= state.due {
            state.due = offset + TOLD_EVERY;
            let event = Event::Checking { done: offset, bytes: self.source.len() };
            state.stopped = (state.watch)(event) == Proceed::No;
            if state.stopped {
                return Err(io::ErrorKind::Interrupted.into());
            }
        }
        drop(state);
        self.source.read_exact_at(buffer, offset)
    }
}

impl fmt::Debug for Heeding<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Heeding").field("source", &self.source).finish_non_exhaustive()
    }
}
