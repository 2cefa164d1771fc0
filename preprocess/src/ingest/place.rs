//! Building an archive in its place, and how much memory there is for it.

use std::io::{self, BufWriter, Write};
use std::sync::Arc;
use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::thread;

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
    Part { description, origin }: &Part,
    (build, begun): (&Build<'_>, Option<&Begun>),
    threads: &ThreadPool,
    watch: Watch<'_>,
) -> Result<Ready, IngestError> {
    let named = begun.and_then(|begun| begun.note.as_ref()).map(Note::slots);
    let scratch = Scratch::new(build.scratch()?, &named.unwrap_or_default());
    let scratch = scratch.map_err(|error| failed(description, BuildError::Scratch(error)))?;
    let scratch = Arc::new(scratch);
    let memory =
        Memory::share(request.memory_bytes, threads.current_num_threads(), description, &**origin);
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
    Part { description, origin }: &mut Part,
    (build, begun): (&mut Build<'_>, Option<Begun>),
    Ready { scratch, memory, .. }: Ready,
    threads: &ThreadPool,
    watch: &mut (dyn FnMut(Progress) -> Proceed + Send),
) -> Result<Written, IngestError> {
    // A quarter for the rasters' blocks, which wait only where strips are wide.
    let Memory { spare_bytes, pages_together, .. } = memory;
    let aside = Arc::new(Aside::new(Arc::clone(&scratch)));
    origin.spill(&Arc::new(Overflow::new(aside, spare_bytes / 4)));
    let frontier_bytes = spare_bytes - spare_bytes / 4;
    let note_every = request.note_every;
    let means = Means { scratch, frontier_bytes, pages_together, note_every };
    let origin = &**origin;
    let sync_now = build.syncing()?;
    let built = thread::scope(|scope| {
        let (sync, asked) = sync_channel(0);
        let synced = scope.spawn(move || asked.into_iter().try_for_each(|()| sync_now()));
        let sink = BufWriter::with_capacity(WRITTEN_TOGETHER, build);
        let site = Buffered { sink, unsynced: 0, sync };
        let built =
            threads.install(|| build::build(description, origin, site, &means, begun, watch));
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
    if !matches!(built, Err(BuildError::Interrupted)) {
        // Rasters that changed say why they could not be read.
        origin.check_unchanged()?;
    }
    built.map_err(|error| failed(description, error))
}

fn failed(description: &Description, source: BuildError) -> IngestError {
    IngestError::Build { dataset: description.dataset.clone(), source: Box::new(source) }
}
