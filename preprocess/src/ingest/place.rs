//! Building an archive in its place, and how much memory there is for it.

use std::io::{self, BufWriter, Write};
use std::sync::Arc;
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::thread;
use std::time::Duration;

use areoid_formats::archive::{Description, Written};
use areoid_formats::catalog::Build;
use rayon::ThreadPool;

use super::memory::Memory;
use super::plan::Part;
use super::request::{Event, IngestError, Request, Watch, tell};
use crate::build::{self, Begun, Means, Proceed, Progress, Site};
use crate::build_error::BuildError;
use crate::estimate::Estimate;
use crate::feather::HALO;
use crate::lowpass;
use crate::note::Note;
use crate::once::Overflow;
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

impl Buffered<'_, '_> {
    /// Asks for a sync, or puts it off while one is waited for. An error if one failed: which, the
    /// thread that waited says.
    fn ask_to_sync(&mut self) -> io::Result<()> {
        match self.sync.try_send(()) {
            Ok(()) => self.unsynced = 0,
            Err(TrySendError::Full(())) => {}
            Err(TrySendError::Disconnected(())) => return Err(io::Error::other("a sync failed")),
        }
        Ok(())
    }
}

impl Write for Buffered<'_, '_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.sink.write(bytes)?;
        self.unsynced += written;
        if self.unsynced >= SYNCED_TOGETHER {
            self.ask_to_sync()?;
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
        // A note says that all is on the medium.
        self.ask_to_sync()?;
        self.sink.get_mut().note(note).map_err(io::Error::other)
    }
}

/// What a build works with, beside its place.
pub(super) struct Ready {
    scratch: Arc<Scratch>,
    memory: Memory,
    /// What it is expected to make and take.
    pub(super) estimate: Estimate,
}

/// The threads of an ingest.
pub(super) fn threads(request: &Request) -> Result<ThreadPool, IngestError> {
    rayon::ThreadPoolBuilder::new()
        .num_threads(request.threads.unwrap_or(0))
        .build()
        .map_err(|error| IngestError::Threads(error.to_string()))
}

/// Makes ready for a build and measures what it will take.
pub(super) fn make_ready(
    request: &Request,
    part: &Part,
    (build, begun): (&Build<'_>, Option<&Begun>),
    threads: &ThreadPool,
    watch: Watch<'_>,
) -> Result<Ready, IngestError> {
    let Part { description, origin } = part;
    let named = begun.and_then(|begun| begun.note.as_ref()).map(Note::slots);
    let scratch = Scratch::new(build.scratch()?, &named.unwrap_or_default());
    let scratch = scratch.map_err(|error| failed(description, BuildError::Scratch(error)))?;
    let scratch = Arc::new(scratch);
    let memory = Memory::share(request, threads, part);
    tell(watch, Event::Measuring)?;
    let pyramid = description.grid.pyramid();
    let done = begun.map_or(0, |begun| begun.archive.units) as f64;
    let units =
        Schedule::new(pyramid, description.unit_pages, HALO, lowpass::reach(description.mip))
            .remaining()
            .max(1) as f64;
    let estimate = threads.install(|| {
        let left = 1.0 - done / units;
        let mut go_on = || watch(Event::Measuring);
        let estimate = Estimate::of(pyramid);
        estimate.measure(description, &**origin, &scratch, memory.spare_bytes, left, &mut go_on)
    });
    Ok(Ready { scratch, memory, estimate })
}

/// Builds the archive in `build`.
pub(super) fn write(
    request: &Request,
    part: &mut Part,
    (build, begun): (&mut Build<'_>, Option<Begun>),
    Ready { scratch, memory, .. }: Ready,
    threads: &ThreadPool,
    watch: &mut (dyn FnMut(Progress) -> Proceed + Send),
) -> Result<Written, IngestError> {
    let means = means(part, scratch, memory, request.note_every);
    let Part { description, origin } = &*part;
    let sync_now = build.syncing()?;
    let built = thread::scope(|scope| {
        let (sync, asked) = sync_channel(0);
        let synced = scope.spawn(move || asked.into_iter().try_for_each(|()| sync_now()));
        let sink = BufWriter::with_capacity(WRITTEN_TOGETHER, build);
        let site = Buffered { sink, unsynced: 0, sync };
        let built =
            threads.install(|| build::build(description, &**origin, site, &means, begun, watch));
        let built = built.and_then(|(Buffered { sink, .. }, written)| match sink.into_inner() {
            Ok(_) => Ok(written),
            Err(error) => Err(BuildError::Write(error.into_error())),
        });
        match synced.join() {
            Ok(Ok(())) => built,
            Ok(Err(error)) => Err(BuildError::Sync(error)),
            Err(panic) => std::panic::resume_unwind(panic),
        }
    });
    ended(part, built)
}

/// What a part is built with, its memory shared out: a quarter of what is spare for the rasters' blocks,
/// which wait only where strips are wide.
pub(super) fn means(
    part: &mut Part,
    scratch: Arc<Scratch>,
    memory: Memory,
    note_every: Duration,
) -> Means {
    let Memory { spare_bytes, pages_together, .. } = memory;
    let aside = Arc::new(Aside::new(Arc::clone(&scratch)));
    part.origin.spill(&Arc::new(Overflow::new(aside, spare_bytes / 4)));
    Means { scratch, frontier_bytes: spare_bytes - spare_bytes / 4, pages_together, note_every }
}

/// How a build ended: if it failed because its rasters changed, that is said.
pub(super) fn ended<T>(
    Part { description, origin }: &Part,
    built: Result<T, BuildError>,
) -> Result<T, IngestError> {
    if !matches!(built, Err(BuildError::Interrupted)) {
        origin.check_unchanged()?;
    }
    built.map_err(|error| failed(description, error))
}

fn failed(description: &Description, source: BuildError) -> IngestError {
    IngestError::Build { dataset: description.dataset.clone(), source: Box::new(source) }
}
