//! Building an archive in its place, and how much memory there is for it.

use std::io::{self, BufWriter, Write};
use std::sync::Arc;
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread;

use areoid_formats::archive::{Description, Written};
use areoid_formats::catalog::Build;
use areoid_formats::page::Kind;

use super::request::{Event, IngestError, Request, Watch, tell};
use crate::build::{self, Begun, Means, Site, is_of_whole_heights};
use crate::build_error::BuildError;
use crate::estimate::Estimate;
use crate::feather::HALO;
use crate::note::Note;
use crate::once::Overflow;
use crate::origin::Origin;
use crate::schedule::Schedule;
use crate::scratch::{Aside, Scratch};

/// Bytes of heads, padding and small payloads that are written together; payloads of this size go
/// to the file without a copy.
const WRITTEN_TOGETHER: usize = 32 << 10;

/// Bytes after which what is written is brought to the medium, so that the last sync has little to
/// wait for.
const SYNCED_TOGETHER: usize = 8 << 20;

/// A build's archive, written in large pieces.
struct Buffered<'a, 'b> {
    sink: BufWriter<&'a mut Build<'b>>,
    /// Bytes since the last sync was asked for.
    unsynced: usize,
    sync: SyncSender<()>,
}

impl Write for Buffered<'_, '_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.sink.write(bytes)?;
        self.unsynced += written;
        // While one sync is waited for, the next is put off.
        if self.unsynced >= SYNCED_TOGETHER && self.sync.try_send(()).is_ok() {
            self.unsynced = 0;
        }
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.sink.flush()
    }
}

impl Site for Buffered<'_, '_> {
    fn note(&mut self, note: &[u8]) -> io::Result<()> {
        self.sink.flush()?;
        self.sink.get_mut().note(note).map_err(io::Error::other)
    }
}

/// Builds the archive in `build`, on threads of its own.
pub(super) fn write(
    request: &Request,
    description: &Description,
    origin: &mut dyn Origin,
    (build, begun): (&mut Build<'_>, Option<Begun>),
    watch: Watch<'_>,
) -> Result<Written, IngestError> {
    let failed = |source| IngestError::Build {
        dataset: description.dataset.clone(),
        source: Box::new(source),
    };
    let threads = rayon::ThreadPoolBuilder::new()
        .num_threads(request.threads.unwrap_or(0))
        .build()
        .map_err(|error| IngestError::Threads(error.to_string()))?;
    let named = begun.as_ref().and_then(|begun| begun.note.as_ref()).map(Note::slots);
    let scratch = Scratch::new(build.scratch()?, &named.unwrap_or_default());
    let scratch = scratch.map_err(|error| failed(BuildError::Scratch(error)))?;
    let scratch = Arc::new(scratch);
    let least_bytes = step_bytes(description, origin);
    if request.memory_bytes < least_bytes {
        tell(watch, Event::ShortOfMemory { least_bytes })?;
    }
    let spare_bytes = request.memory_bytes.saturating_sub(least_bytes);
    tell(watch, Event::Measuring)?;
    let pyramid = description.grid.pyramid();
    let done = begun.as_ref().map_or(0, |begun| begun.archive.units) as f64;
    let units = Schedule::new(pyramid, description.unit_pages, HALO).remaining().max(1) as f64;
    let estimate = threads.install(|| {
        let left = 1.0 - done / units;
        let mut go_on = || watch(Event::Measuring);
        let estimate = Estimate::of(pyramid);
        estimate.measure(description, origin, &scratch, spare_bytes, left, &mut go_on)
    });
    tell(watch, Event::Estimated(estimate))?;
    // A quarter for the rasters' blocks, which wait only where strips are wide.
    let aside = Arc::new(Aside::new(Arc::clone(&scratch)));
    origin.spill(&Arc::new(Overflow::new(aside, spare_bytes / 4)));
    let frontier_bytes = spare_bytes - spare_bytes / 4;
    let means = Means { scratch, frontier_bytes, note_every: request.note_every };
    let origin = &*origin;
    let sync_now = build.syncing()?;
    let built = thread::scope(|scope| {
        let (sync, asked) = sync_channel(0);
        let synced = scope.spawn(move || asked.into_iter().try_for_each(|()| sync_now()));
        let sink = BufWriter::with_capacity(WRITTEN_TOGETHER, build);
        let site = Buffered { sink, unsynced: 0, sync };
        let built = threads.install(|| {
            let watch = |progress| watch(Event::Building(progress));
            build::build(description, origin, site, &means, begun, watch)
        });
        let built = built.and_then(|(Buffered { sink, .. }, written)| match sink.into_inner() {
            Ok(_) => Ok(written),
            Err(error) => Err(BuildError::Write(error.into_error())),
        });
        match synced.join() {
            Ok(synced) => {
                built.and_then(|written| synced.map(|()| written).map_err(BuildError::Write))
            }
            Err(panic) => std::panic::resume_unwind(panic),
        }
    });
    if !matches!(built, Err(BuildError::Interrupted)) {
        // Rasters that changed say why they could not be read.
        origin.check_unchanged()?;
    }
    built.map_err(failed)
}

/// What a step of the build needs beside the pages that wait, in bytes: its leaves and those of the
/// next unit, the pages fetched and made, with their finest texels where there may be holes, and the
/// blocks that leaves are cut from.
fn step_bytes(description: &Description, origin: &dyn Origin) -> u64 {
    const EVERYTHING_ELSE: u64 = 48 << 20;
    let side = u64::from(description.grid.pyramid().page_side());
    let texel = match description.kind {
        Kind::Height if is_of_whole_heights(description, origin) => 2,
        Kind::Height => 4,
        Kind::Color | Kind::Normal => 3,
    };
    let unit = u64::from(description.unit_pages).pow(2) * side * side * texel;
    let units = if origin.may_have_holes() { 7 } else { 5 };
    units * unit + EVERYTHING_ELSE
}
