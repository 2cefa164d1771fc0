//! Building an archive: leaves in, pages out, one pass from the finest level up.
//!
//! ```text
//!   unit n+1:  read ─────────────────┐ at the same time, on all cores
//!   unit n:    settle ▶ parents ▶ finish whole pages ▶ write
//!              now and then: a note of where the work stands
//! ```
//!
//! A build that goes on with another one starts at its last note, does the units from there to the
//! last whole one in the archive again without writing anything, and writes from there on: so the
//! bytes are those of a build that was never interrupted.

use std::io::{self, Write};
use std::sync::Arc;
use std::time::{Duration, Instant};

use areoid_formats::address::PageAddress;
use areoid_formats::archive::{ArchiveWriter, Description, MipRule, Unfinished, Written};
use areoid_formats::codec::Quantum;
use areoid_formats::page::Kind;
use rayon::prelude::*;

use crate::build_error::BuildError;
use crate::feather::HALO;
use crate::lowpass;
use crate::mip::Spans;
use crate::note::Note;
use crate::raster::RasterError;
use crate::schedule::{Schedule, Step};
use crate::scratch::Scratch;
use crate::shop::Shop;
use crate::texel::Texel;
use crate::tile::{Closed, Raw};
use crate::whole::Payloads;

/// Where leaves come from.
///
/// # Contract
///
/// Each leaf is either read or skipped, once, and later given to [`Self::source_error`], once; from
/// any thread, and several at a time. The answer depends on the page alone; `None` means no valid
/// texel.
pub trait Leaves: Sync {
    /// Reads the interior of `page`, cut at the outline.
    ///
    /// # Errors
    ///
    /// [`RasterError`] if the source cannot be read.
    fn read(&self, page: PageAddress) -> Result<Option<Raw>, RasterError>;

    /// Tells that `page` will not be read.
    fn skip(&self, _page: PageAddress) {}

    /// The largest distance of `R_L` from the source's pixels at their centers in the interior of
    /// `page`, in meters or codes, not less than it is; `None` where leaves are those pixels until
    /// they are rounded to the step. Without a leaf nobody asks: it is empty, or not built again.
    ///
    /// # Errors
    ///
    /// [`RasterError`] if the source cannot be read.
    fn source_error(
        &self,
        _page: PageAddress,
        _leaf: Option<&Closed<'_>>,
    ) -> Result<Option<f32>, RasterError> {
        Ok(None)
    }

    /// Checks that what was read so far is of the source as it was when it was opened: else it would
    /// stay in an archive that a later process goes on with.
    ///
    /// # Errors
    ///
    /// [`RasterError::Modified`], or [`RasterError::Io`] if it cannot be told.
    fn check_unchanged(&self) -> Result<(), RasterError> {
        Ok(())
    }

    /// Whether a texel inside the outline may be invalid.
    fn may_have_holes(&self) -> bool {
        true
    }

    /// Whether heights come as whole meters, [`crate::texel::Planes::WholeHeight`].
    fn is_whole(&self) -> bool {
        false
    }
}

/// Where an archive is written.
///
/// # Contract
///
/// Bytes written come behind one another. After [`Self::note`] everything written before is on the
/// medium, and so is the note, in the place of the one before.
pub trait Site: Write {
    /// Keeps a note for a process that goes on with the build.
    ///
    /// # Errors
    ///
    /// Those of the file system.
    fn note(&mut self, note: &[u8]) -> io::Result<()>;
}

/// Memory outlives nothing: its notes are dropped.
impl Site for Vec<u8> {
    fn note(&mut self, _note: &[u8]) -> io::Result<()> {
        Ok(())
    }
}

/// What a build works with.
#[derive(Debug)]
pub struct Means {
    /// Room for pages that do not fit in memory.
    pub scratch: Arc<Scratch>,
    /// Memory for the pages under construction, in bytes, beside those of the step that is done.
    pub frontier_bytes: u64,
    /// How many pages are looked at together: as many threads as there are have work in them.
    pub pages_together: usize,
    /// How much work may pass between two notes.
    pub note_every: Duration,
}

/// A build to go on with.
#[derive(Debug)]
pub struct Begun {
    /// What its archive has.
    pub archive: Unfinished,
    /// Its last note, if there is one.
    pub note: Option<Note>,
}

/// How far a build is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Work units done.
    pub units_done: usize,
    /// Those among them that stood in the archive already.
    pub units_resumed: usize,
    /// Work units in all.
    pub units: usize,
    /// Leaves read.
    pub leaves: u64,
    /// Texels of the finest level done.
    pub texels: u64,
    /// Those among them that did not have to be done again.
    pub texels_skipped: u64,
    /// Bytes of the archive so far.
    pub bytes: u64,
    /// Time since the build began.
    pub elapsed: Duration,
}

/// Whether to go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Proceed {
    /// Go on.
    Yes,
    /// Stop after this work unit, with a note.
    No,
}

/// Builds the archive that `description` describes from `leaves` at `site`, from the start or from
/// where `begun` stopped; the site then stands at the end of what it has.
///
/// Runs on the current rayon pool; `watch` is called before the first work unit that is done and
/// after each.
///
/// # Errors
///
/// Any [`BuildError`]. What is at the site can be gone on with.
pub fn build<W: Site + Send>(
    description: &Description,
    leaves: &dyn Leaves,
    site: W,
    means: &Means,
    begun: Option<Begun>,
    watch: impl FnMut(Progress) -> Proceed + Send,
) -> Result<(W, Written), BuildError> {
    if description.mip == MipRule::Unknown {
        return Err(BuildError::MipRule);
    }
    match description.kind {
        Kind::Height if is_of_whole_heights(description, leaves) => {
            build_of::<i16, W>(description, leaves, site, means, begun, watch)
        }
        Kind::Height => build_of::<f32, W>(description, leaves, site, means, begun, watch),
        Kind::Color | Kind::Normal => {
            build_of::<u8, W>(description, leaves, site, means, begun, watch)
        }
    }
}

/// Whether pages are of whole heights from reading to writing.
pub(crate) fn is_of_whole_heights(description: &Description, leaves: &dyn Leaves) -> bool {
    description.quantum == (Quantum { step: 1.0, offset: 0.0 }) && leaves.is_whole()
}

fn build_of<S: Texel, W: Site + Send>(
    description: &Description,
    leaves: &dyn Leaves,
    site: W,
    means: &Means,
    begun: Option<Begun>,
    mut watch: impl FnMut(Progress) -> Proceed + Send,
) -> Result<(W, Written), BuildError> {
    let start = Instant::now();
    let Description { grid, unit_pages, mip, .. } = description;
    let mut schedule = Schedule::new(grid.pyramid(), *unit_pages, HALO, lowpass::reach(*mip));
    let spans = if leaves.may_have_holes() { Spans::Kept } else { Spans::Unneeded };
    let scratch = Arc::clone(&means.scratch);
    let (waiting, together) = (means.frontier_bytes, means.pages_together);
    let mut shop = Shop::<S>::new(description, spans, scratch, waiting, together);
    let mut progress = Progress {
        units_done: 0,
        units_resumed: 0,
        units: schedule.remaining(),
        leaves: 0,
        texels: 0,
        texels_skipped: 0,
        bytes: 0,
        elapsed: Duration::ZERO,
    };

    let (writer, note) = match begun {
        Some(Begun { archive, note }) => (ArchiveWriter::resume(site, description, archive), note),
        None => (ArchiveWriter::new(site, description), None),
    };
    let mut writer = writer.map_err(BuildError::Write)?;
    progress.units_resumed = usize::try_from(writer.units()).unwrap_or(usize::MAX);
    let is_noted = note.is_some();
    let usable =
        note.filter(|note| note.archive == writer.archive() && note.units <= writer.units());
    let skipped = if progress.units_resumed == progress.units {
        // Only what stands behind the records may be missing.
        writer.units()
    } else {
        let restored = usable.filter(|note| shop.restore(note));
        if is_noted && restored.is_none() {
            means.scratch.clear();
        }
        restored.map_or(0, |note| note.units)
    };
    while (progress.units_done as u64) < skipped
        && let Some(step) = schedule.next()
    {
        step.read.iter().for_each(|&leaf| leaves.skip(leaf));
        let finest = description.grid.pyramid().finest();
        for &leaf in step.whole.iter().filter(|page| page.level == finest) {
            leaves.source_error(leaf, None)?;
        }
        progress.texels_skipped += texels(description, &step);
        progress.units_done += 1;
    }
    progress.texels = progress.texels_skipped;
    progress.bytes = writer.bytes();
    if watch(progress) == Proceed::No {
        return Err(BuildError::Interrupted);
    }

    let mut next = schedule.next();
    let mut raws = read(leaves, next.as_ref())?;
    let mut noted = Instant::now();
    while let Some(step) = next {
        next = schedule.next();
        progress.leaves += step.read.len() as u64;
        progress.texels += texels(description, &step);
        let (done, ahead) = rayon::join(
            || take(&mut shop, &step, (leaves, raws), &mut writer, progress.units_done),
            || read(leaves, next.as_ref()),
        );
        done?;
        raws = ahead?;
        progress.units_done += 1;
        progress.bytes = writer.bytes();
        progress.elapsed = start.elapsed();
        let proceed = watch(progress);
        let behind = (progress.units_done as u64) < writer.units();
        if !behind && (proceed == Proceed::No || noted.elapsed() >= means.note_every) {
            let note = shop.note(writer.archive(), writer.units()).map_err(BuildError::Scratch)?;
            means.scratch.sync().map_err(BuildError::Scratch)?;
            writer.sink().note(&note.to_bytes()).map_err(BuildError::Write)?;
            shop.noted(&note);
            noted = Instant::now();
        }
        if proceed == Proceed::No {
            return Err(BuildError::Interrupted);
        }
    }
    debug_assert!(shop.is_done(), "every page is forgotten after its last use");
    if writer.is_empty() {
        return Err(BuildError::NoData);
    }
    writer.finish().map_err(BuildError::Write)
}

/// Does a step and writes what became whole, unless the archive has it already. The marker behind it,
/// or a note, says that the unit is one to go on from: so its leaves are known to be good by then.
fn take<S: Texel>(
    shop: &mut Shop<'_, S>,
    step: &Step,
    (leaves, raws): (&dyn Leaves, Vec<(PageAddress, Option<Raw>)>),
    writer: &mut ArchiveWriter<impl Write>,
    unit: usize,
) -> Result<(), BuildError> {
    let measure = |page, leaf: Option<&Closed<'_>>| leaves.source_error(page, leaf);
    if (unit as u64) < writer.units() {
        shop.take(step, raws, &measure, Payloads::Unneeded, |_| Ok(()))?;
        return Ok(leaves.check_unchanged()?);
    }
    shop.take(step, raws, &measure, Payloads::Made, |(page, whole)| match whole {
        Some((entry, payload)) => writer.page(entry, &payload).map_err(BuildError::Write),
        None => {
            writer.empty(page);
            Ok(())
        }
    })?;
    leaves.check_unchanged()?;
    writer.end_unit().map_err(BuildError::Write)
}

/// Texels of the leaves of a step.
fn texels(description: &Description, step: &Step) -> u64 {
    let sizes = step.read.iter().map(|&leaf| description.grid.pyramid().interior_size(leaf));
    sizes.map(|(rows, cols)| u64::from(rows) * u64::from(cols)).sum()
}

/// Reads the leaves of a step, if there is one.
fn read(
    leaves: &dyn Leaves,
    step: Option<&Step>,
) -> Result<Vec<(PageAddress, Option<Raw>)>, RasterError> {
    let pages = step.map_or(&[][..], |step| &step.read);
    pages.par_iter().map(|&page| Ok((page, leaves.read(page)?))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use areoid_formats::archive::Source;
    use areoid_formats::body::Body;
    use areoid_formats::grid::{Grid, Outline};
    use areoid_formats::projection::{Crs, Projection};

    struct Nothing;

    impl Leaves for Nothing {
        fn read(&self, _: PageAddress) -> Result<Option<Raw>, RasterError> {
            Ok(None)
        }
    }

    #[test]
    fn what_coarser_texels_are_to_be_is_known_or_refused() {
        let body = Body::parse("moon").unwrap();
        let crs = Crs::new(Projection::Geographic, body.ellipsoid);
        let outline = Outline { origin: [0.0; 2], pixel_size: [1.0; 2], width: 30, height: 20 };
        let build = |mip| {
            let description = Description {
                dataset: "nothing".to_owned(),
                kind: Kind::Height,
                body: body.clone(),
                grid: Grid::from_outline(crs, outline, 10).unwrap().grid,
                quantum: Quantum::NONE,
                priority: 0,
                feather_texels: 32,
                unit_pages: 8,
                source: Source::default(),
                resampling: None,
                mip,
            };
            let scratch = Arc::new(Scratch::new(tempfile::tempfile().unwrap(), &[]).unwrap());
            let note_every = Duration::MAX;
            let means = Means { scratch, frontier_bytes: 0, pages_together: 8, note_every };
            build(&description, &Nothing, Vec::new(), &means, None, |_| Proceed::Yes).unwrap_err()
        };
        assert!(matches!(build(MipRule::Unknown), BuildError::MipRule));
        assert!(matches!(build(MipRule::Mean), BuildError::NoData));
        assert!(matches!(build(MipRule::Kaiser), BuildError::NoData));
    }
}
