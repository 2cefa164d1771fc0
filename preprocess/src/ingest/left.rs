//! What is left of earlier builds, and whether it is gone on with; what is left of these.

use std::fmt;
use std::io;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use areoid_formats::archive::{Archive, Description, Written, recover};
use areoid_formats::catalog::{
    Build, CatalogError, Disk, Finished, NewDataset, publish_archives, stray,
};
use areoid_formats::storage::{ByteSource, FileSource};

use super::plan::{Part, Plan};
use super::request::{Event, IngestError, Leftover, Request, Unfinished, Watch, tell};
use crate::build::{Begun, Proceed};
use crate::note::Note;

/// What there is of a part of an ingest.
pub(super) enum Standing<'a> {
    /// A whole archive in its place, with its content: a process killed between its last two steps
    /// left it.
    InPlace(Box<Archive>, u64),
    /// A build.
    Build(Box<Underway<'a>>),
}

/// A build, from its beginning to its publication.
pub(super) struct Underway<'a> {
    pub(super) build: Build<'a>,
    /// What is gone on with.
    pub(super) begun: Option<Begun>,
    /// What is told of what was left and is not gone on with.
    pub(super) leftover: Option<Leftover>,
    /// Where its first work unit ends.
    pub(super) unit_end: Option<u64>,
    /// What is known of it when it is done.
    pub(super) written: Option<Written>,
}

impl<'a> Underway<'a> {
    fn new(build: Build<'a>, begun: Option<Begun>, leftover: Option<Leftover>) -> Self {
        let unit_end = begun.as_ref().map(|begun| begun.archive.end);
        Self { build, begun, leftover, unit_end, written: None }
    }

    /// Keeps the build if there is something to go on with, else discards it; whether it is kept.
    fn keep_if_of_use(self) -> bool {
        // A disk may have had no room for a unit that was done. Where it does not tell, that shows
        // later.
        let length = self.build.source().map_or(u64::MAX, |source| source.len());
        let is_of_use = self.unit_end.is_some_and(|end| end <= length);
        if !is_of_use {
            self.discard();
        }
        is_of_use
    }

    /// Discards the build. What cannot be removed either is swept by the next build of this name; why
    /// it is discarded says more.
    fn discard(self) {
        let _ = self.build.discard();
    }
}

/// The whole archive of a part that stands in its place, if there is one, with its content.
pub(super) fn in_place(
    folder: &Path,
    description: &Description,
) -> Result<Option<(Archive, u64)>, IngestError> {
    let archive = stray(folder, description)?;
    Ok(archive.and_then(|archive| archive.content().map(|content| (archive, content))))
}

/// Publishes archives that a process killed between its last two steps left whole in their places,
/// unless they are gone meanwhile.
pub(super) fn publish_left(
    disk: &dyn Disk,
    request: &Request,
    plan: &Plan,
    archives: &[(Archive, u64)],
    watch: Watch<'_>,
) -> Result<Option<u64>, IngestError> {
    tell(watch, Event::Leftover(Leftover::Whole))?;
    for part in &plan.parts {
        // What was begun since makes the same.
        Build::start(disk, &request.catalog, &part.description.dataset)?.discard()?;
    }
    watch(Event::Publishing);
    let datasets = plan.parts.iter().zip(archives).map(|(part, (archive, content))| {
        (Finished::InPlace, dataset(request, plan, part, (archive.len(), *content)))
    });
    match publish_archives(disk, &request.catalog, datasets.collect()) {
        Ok(generation) => Ok(Some(generation)),
        Err(CatalogError::Missing { .. }) => Ok(None),
        Err(error) => Err(kept(error.into())),
    }
}

/// What the manifest is to say of the archive of a part: its length and its content.
pub(super) fn dataset(
    request: &Request,
    plan: &Plan,
    Part { description, .. }: &Part,
    (bytes, content): (u64, u64),
) -> NewDataset {
    NewDataset {
        name: description.dataset.clone(),
        group: plan.is_group.then(|| plan.called.clone()),
        kind: description.kind,
        priority: description.priority,
        body: description.body.clone(),
        bytes,
        content,
        source: description.source.clone(),
        existing: request.existing,
    }
}

/// What there is of each part, its build locked.
pub(super) fn stand<'a>(
    disk: &'a dyn Disk,
    request: &Request,
    plan: &Plan,
    left: Vec<Option<(Archive, u64)>>,
    watch: Watch<'_>,
) -> Result<Vec<Standing<'a>>, IngestError> {
    let mut standing = Vec::new();
    for (part, left) in plan.parts.iter().zip(left) {
        let found = match left {
            Some((archive, content)) => Ok(Standing::InPlace(Box::new(archive), content)),
            None => begin(disk, request, &part.description, watch)
                .map(|underway| Standing::Build(Box::new(underway))),
        };
        match found {
            Ok(found) => standing.push(found),
            Err(error) => {
                // What was left of the other parts is left to go on with.
                builds(standing).for_each(|underway| _ = underway.keep_if_of_use());
                return Err(error);
            }
        }
    }
    Ok(standing)
}

/// Opens the place of the build, and what is left there of an earlier one that can be gone on with.
fn begin<'a>(
    disk: &'a dyn Disk,
    request: &Request,
    description: &Description,
    watch: Watch<'_>,
) -> Result<Underway<'a>, IngestError> {
    let (folder, name) = (&request.catalog, &description.dataset);
    let mut build = Build::resume(disk, folder, name)?;
    let source = build.source()?;
    let left = !source.is_empty();
    if request.unfinished == Unfinished::Discard {
        // What cannot be read could not have been gone on with.
        let ours = recover::is_begun(&source, description).unwrap_or(false);
        build.cut(0)?;
        let leftover = if ours { Leftover::Discarded } else { Leftover::Unrelated };
        return Ok(Underway::new(build, None, left.then_some(leftover)));
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
        return Ok(Underway::new(build, None, unrelated.then_some(Leftover::Unrelated)));
    };
    build.cut(archive.end)?;
    let note = build.last_note()?.and_then(|note| Note::from_bytes(&note));
    Ok(Underway::new(build, Some(Begun { archive, note }), None))
}

/// Keeps builds that stopped if that is of use: if they have a work unit, and the cause may go
/// away.
pub(super) fn stopped(standing: Vec<Standing<'_>>, error: IngestError) -> IngestError {
    if !error.may_go_away() {
        builds(standing).for_each(|underway| underway.discard());
        return error;
    }
    let kept_builds = builds(standing).map(|underway| underway.keep_if_of_use());
    if kept_builds.filter(|&is_kept| is_kept).count() > 0 { kept(error) } else { error }
}

fn builds(standing: Vec<Standing<'_>>) -> impl Iterator<Item = Box<Underway<'_>>> {
    standing.into_iter().filter_map(|standing| match standing {
        Standing::InPlace(..) => None,
        Standing::Build(underway) => Some(underway),
    })
}

/// The error of an ingest whose build is still there.
pub(super) fn kept(error: IngestError) -> IngestError {
    if error.may_go_away() { IngestError::Kept(Box::new(error)) } else { error }
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
