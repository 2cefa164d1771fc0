//! How long the one pyramid would be that a group is made instead of: it is built, and written nowhere.

use std::io::{self, Write};
use std::sync::Arc;
use std::time::Duration;

use areoid_formats::catalog::CatalogError;
use rayon::ThreadPool;

use super::memory::Memory;
use super::place::{ended, means};
use super::plan::Part;
use super::request::{Event, IngestError, PartMade, Request, Saved, Watch};
use crate::build::{self, Site};
use crate::estimate::Estimate;
use crate::scratch::Scratch;

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
/// Those of a build, also if it is interrupted; [`IngestError::Catalog`] if there is no room for it.
pub(super) fn length(
    request: &Request,
    part: &mut Part,
    threads: &ThreadPool,
    watch: Watch<'_>,
) -> Result<Option<u64>, IngestError> {
    if Estimate::of(part.description.grid.pyramid()).texels > MOST_TEXELS {
        return Ok(None);
    }
    let folder = &request.catalog;
    let scratch = tempfile::tempfile_in(folder).and_then(|file| Scratch::new(file, &[]));
    let scratch =
        scratch.map_err(|source| CatalogError::io("make a scratch file in", folder, source))?;
    let memory = Memory::share(request, threads, part);
    let means = means(part, Arc::new(scratch), memory, Duration::MAX);
    let Part { description, origin } = &*part;
    let go_on = |_| watch(Event::Measuring);
    let built =
        threads.install(|| build::build(description, &**origin, Nowhere, &means, None, go_on));
    ended(part, built).map(|(_, written)| Some(written.bytes))
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
