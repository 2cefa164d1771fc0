//! How long one pyramid would be, of which a group is made instead: it is built, and written nowhere.

use std::io::{self, Write};
use std::sync::Arc;
use std::time::Duration;

use areoid_formats::catalog::CatalogError;
use rayon::ThreadPool;

use super::memory::Memory;
use super::plan::Part;
use super::request::{Event, IngestError, PartMade, Request, Saved, Watch};
use crate::build::{self, Means, Site};
use crate::build_error::BuildError;
use crate::estimate::Estimate;
use crate::once::Overflow;
use crate::scratch::{Aside, Scratch};

/// Larger ones are not built for it.
const MOST_TEXELS: u64 = 16 << 20;

/// What was saved by making `parts`, where one pyramid has so many bytes, if that is known.
pub(super) fn saved(instead_of: &Part, bytes: Option<u64>, parts: &[PartMade]) -> Saved {
    let minus = |whole: u64, parts: u64| whole.cast_signed().saturating_sub(parts.cast_signed());
    let texels = |part: &PartMade| Estimate::of(part.grid.pyramid()).texels;
    let whole = Estimate::of(instead_of.description.grid.pyramid()).texels;
    Saved {
        texels: minus(whole, parts.iter().map(texels).sum()),
        bytes: bytes.map(|bytes| minus(bytes, parts.iter().map(|part| part.bytes).sum())),
    }
}

/// How long the archive of a part is; `None` of a large one.
///
/// # Errors
///
/// [`IngestError::Build`], also if it is interrupted.
pub(super) fn length(
    request: &Request,
    Part { description, origin }: &mut Part,
    threads: &ThreadPool,
    watch: Watch<'_>,
) -> Result<Option<u64>, IngestError> {
    if Estimate::of(description.grid.pyramid()).texels > MOST_TEXELS {
        return Ok(None);
    }
    let folder = &request.catalog;
    let file = tempfile::tempfile_in(folder)
        .map_err(|source| CatalogError::io("make a scratch file in", folder, source))?;
    let failed = |source| {
        let dataset = description.dataset.clone();
        IngestError::Build { dataset, source: Box::new(source) }
    };
    let scratch = Scratch::new(file, &[]).map_err(|error| failed(BuildError::Scratch(error)))?;
    let scratch = Arc::new(scratch);
    let count = threads.current_num_threads();
    let memory = Memory::share(request.memory_bytes, count, description, &**origin);
    let blocks_bytes = memory.spare_bytes / 4;
    let aside = Arc::new(Aside::new(Arc::clone(&scratch)));
    origin.spill(&Arc::new(Overflow::new(aside, blocks_bytes)));
    let means = Means {
        scratch,
        frontier_bytes: memory.spare_bytes - blocks_bytes,
        pages_together: memory.pages_together,
        note_every: Duration::MAX,
    };
    let go_on = |_| watch(Event::Measuring);
    let built =
        threads.install(|| build::build(description, &**origin, Nowhere, &means, None, go_on));
    built.map(|(_, written)| Some(written.bytes)).map_err(failed)
}

/// Where an archive goes whose length alone is asked for.
struct Nowhere;

impl Write for Nowhere {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Site for Nowhere {
    fn note(&mut self, _note: &[u8]) -> io::Result<()> {
        Ok(())
    }
}
