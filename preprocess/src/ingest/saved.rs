//! What is saved by splitting a globe: how long one pyramid would have been.
//!
//! ```text
//!   small   one pyramid is built, and written nowhere
//!   large   the band's bytes, and those of the rows about the poles by a few of their leaves
//! ```

use std::io::{self, Write};
use std::sync::Arc;
use std::time::Duration;

use rayon::ThreadPool;

use super::plan::Part;
use super::request::{PartMade, Request, Saved};
use crate::build::{self, Means, Proceed, Site};
use crate::estimate::{Estimate, bytes_per_texel};
use crate::scratch::Scratch;

/// A pyramid of so many texels is built: of one without whole pages a few leaves say nothing.
const MOST_BUILT: u64 = 16 << 20;

/// What was saved by splitting a globe into `parts`, of which the band is the first.
pub(super) fn saved(
    request: &Request,
    instead_of: &Part,
    threads: &ThreadPool,
    parts: &[PartMade],
) -> Saved {
    let minus = |whole: u64, parts: u64| whole.cast_signed().saturating_sub(parts.cast_signed());
    let texels = |part: &PartMade| Estimate::of(part.grid.pyramid()).texels;
    let whole = Estimate::of(instead_of.description.grid.pyramid()).texels;
    let bytes = parts.first().and_then(|band| {
        if whole <= MOST_BUILT {
            threads.install(|| built(request, instead_of))
        } else {
            guessed(request, instead_of, band)
        }
    });
    Saved {
        texels: minus(whole, parts.iter().map(texels).sum()),
        bytes: bytes.map(|bytes| minus(bytes, parts.iter().map(|part| part.bytes).sum())),
    }
}

/// How long the archive of a part is.
fn built(request: &Request, Part { description, origin }: &Part) -> Option<u64> {
    let means = Means {
        scratch: scratch(request)?,
        frontier_bytes: u64::MAX,
        pages_together: 8,
        note_every: Duration::MAX,
    };
    let go_on = |_| Proceed::Yes;
    let built = build::build(description, &*origin.apart(), Nowhere, &means, None, go_on);
    built.ok().map(|(_, written)| written.bytes)
}

/// About how long the archive of a globe is whose band has one.
fn guessed(request: &Request, Part { description, origin }: &Part, band: &PartMade) -> Option<u64> {
    let [whole, of_band] =
        [&description.grid, &band.grid].map(|grid| Estimate::of(grid.pyramid()).texels);
    let pyramid = description.grid.pyramid();
    let (rows, _) = pyramid.pages(pyramid.finest())?;
    // Those at either end that the band has not.
    let beyond = (1.0 - of_band as f64 / whole as f64) / 2.0 * f64::from(rows);
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a row of pages")]
    let row = |share: f64| (share * beyond) as u32;
    let rows = [row(0.2), row(0.8), rows.saturating_sub(1 + row(0.5))];
    let scratch = scratch(request)?;
    let each = bytes_per_texel(description, &**origin, rows, &scratch, request.memory_bytes)?;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a length")]
    let beyond = (each * whole.saturating_sub(of_band) as f64) as u64;
    Some(band.bytes + beyond)
}

/// Room that nothing is kept in.
fn scratch(request: &Request) -> Option<Arc<Scratch>> {
    let file = tempfile::tempfile_in(&request.catalog).ok()?;
    Scratch::new(file, &[]).ok().map(Arc::new)
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
