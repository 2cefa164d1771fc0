//! Building an archive: leaves in, pages out, one pass from the finest level up.
//!
//! ```text
//!   unit n+1:  read ─────────────────┐ at the same time, on all cores
//!   unit n:    settle ▶ parents ▶ finish whole pages ▶ write
//! ```
//!
//! The schedule says what happens when; within a step the pages of a level are made in parallel
//! and written in the schedule's order, so the bytes do not depend on threads or time.

use std::collections::HashMap;
use std::io::{self, Write};
use std::sync::Arc;
use std::time::Duration;

use areoid_formats::address::PageAddress;
use areoid_formats::archive::{ArchiveWriter, Description, Written};
use areoid_formats::codec::EncodeError;
use areoid_formats::page::Kind;
use rayon::prelude::*;

use crate::feather::{self, HALO, Raws};
use crate::mip;
use crate::raster::RasterError;
use crate::schedule::{Schedule, Step};
use crate::tile::{self, Raw, Tile, Tiles, on_step};
use crate::whole::{self, Whole};

/// Where leaves come from.
///
/// # Contract
///
/// Each leaf is asked for once, from any thread, and several at a time. The answer depends on the
/// page alone; `None` means no valid texel.
pub trait Leaves: Sync {
    /// Reads the interior of `page`, cut at the outline.
    ///
    /// # Errors
    ///
    /// [`RasterError`] if the source cannot be read.
    fn read(&self, page: PageAddress) -> Result<Option<Raw>, RasterError>;
}

/// A build that did not come to its end.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BuildError {
    /// The source cannot be read.
    #[error(transparent)]
    Raster(#[from] RasterError),
    /// A texel that cannot be stored on the dataset's step.
    #[error("page {page} holds a height that the step {step} cannot store in 32 bits")]
    Step {
        /// The page.
        page: PageAddress,
        /// The step in meters.
        step: f64,
    },
    /// A page that does not encode.
    #[error("page {page} does not encode")]
    Encode {
        /// The page.
        page: PageAddress,
        /// What the codec says.
        source: EncodeError,
    },
    /// The archive cannot be written.
    #[error("cannot write the archive")]
    Write(#[source] io::Error),
    /// Nothing to build.
    #[error("no valid sample: every one is no-data")]
    NoData,
    /// The caller asked to stop.
    #[error("interrupted")]
    Interrupted,
}

/// How far a build is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Work units done.
    pub units_done: usize,
    /// Work units in all.
    pub units: usize,
    /// Leaves read.
    pub leaves: u64,
    /// Time since the build began.
    pub elapsed: Duration,
}

/// Whether to go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Proceed {
    /// Go on.
    Yes,
    /// Stop after this work unit.
    No,
}

/// Builds the archive that `description` describes from `leaves` into `sink`.
///
/// Runs on the current rayon pool; `watch` is called after each work unit.
///
/// # Errors
///
/// Any [`BuildError`]; what is in the sink is then to be given up.
pub fn build<W: Write + Send>(
    description: &Description,
    leaves: &dyn Leaves,
    sink: W,
    mut watch: impl FnMut(Progress) -> Proceed + Send,
) -> Result<(W, Written), BuildError> {
    let start = std::time::Instant::now();
    let pyramid = description.grid.pyramid();
    let mut schedule = Schedule::new(pyramid, description.unit_pages, HALO);
    let units = schedule.remaining();
    let mut writer = ArchiveWriter::new(sink, description).map_err(BuildError::Write)?;
    let mut shop = Shop {
        description,
        raws: HashMap::new(),
        tiles: HashMap::new(),
        wholes: HashMap::new(),
        written: 0,
    };

    let mut next = schedule.next();
    let mut raws = read(leaves, next.as_ref())?;
    let mut leaf_count = 0;
    let mut units_done = 0;
    while let Some(step) = next {
        next = schedule.next();
        leaf_count += step.read.len() as u64;
        let (done, ahead) =
            rayon::join(|| shop.take(&step, raws, &mut writer), || read(leaves, next.as_ref()));
        done?;
        raws = ahead?;
        units_done += 1;
        let progress = Progress { units_done, units, leaves: leaf_count, elapsed: start.elapsed() };
        if watch(progress) == Proceed::No {
            return Err(BuildError::Interrupted);
        }
    }
    if shop.written == 0 {
        return Err(BuildError::NoData);
    }
    writer.finish().map_err(BuildError::Write)
}

type ReadLeaf = (PageAddress, Option<Arc<Raw>>);

/// Reads the leaves of a step, if there is one.
fn read(leaves: &dyn Leaves, step: Option<&Step>) -> Result<Vec<ReadLeaf>, RasterError> {
    let pages = step.map_or(&[][..], |step| &step.read);
    pages.par_iter().map(|&page| Ok((page, leaves.read(page)?.map(Arc::new)))).collect()
}

/// What is under construction.
struct Shop<'a> {
    description: &'a Description,
    raws: Raws,
    tiles: Tiles,
    wholes: HashMap<PageAddress, Arc<Whole>>,
    /// Pages with a valid texel.
    written: u64,
}

impl Shop<'_> {
    fn take(
        &mut self,
        step: &Step,
        raws: Vec<ReadLeaf>,
        writer: &mut ArchiveWriter<impl Write>,
    ) -> Result<(), BuildError> {
        self.raws.extend(raws);
        for level in step.settled.chunk_by(|one, other| one.level == other.level) {
            let settled: Vec<_> = level
                .par_iter()
                .map(|&page| Ok((page, self.settle(page)?.map(Arc::new))))
                .collect::<Result<_, BuildError>>()?;
            self.tiles.extend(settled);
        }
        for level in step.whole.chunk_by(|one, other| one.level == other.level) {
            let finished: Vec<_> = level
                .par_iter()
                .map(|&page| Ok((page, self.finish(page)?)))
                .collect::<Result<_, BuildError>>()?;
            for (page, whole) in finished {
                self.write(page, whole, writer)?;
            }
        }
        writer.end_unit().map_err(BuildError::Write)?;

        step.forget_read.iter().for_each(|page| drop(self.raws.remove(page)));
        step.forget_settled.iter().for_each(|page| drop(self.tiles.remove(page)));
        step.forget_whole.iter().for_each(|page| drop(self.wholes.remove(page)));
        Ok(())
    }

    /// The tile of a page whose neighborhood (a leaf) or children (others) are there.
    fn settle(&self, page: PageAddress) -> Result<Option<Tile>, BuildError> {
        let Description { grid, kind, quantum, .. } = self.description;
        let pyramid = grid.pyramid();
        if page.level == pyramid.finest() {
            let raw = self.raws[&page].as_ref();
            return raw.map(|raw| settle_leaf(self.description, page, raw, &self.raws)).transpose();
        }
        let children: Vec<_> = pyramid
            .children(page)
            .filter_map(|child| {
                let tile = self.tiles[&child].clone()?;
                Some((place_of(child), tile))
            })
            .collect();
        let (rows, cols) = pyramid.interior_size(page);
        let size = (rows as usize, cols as usize);
        Ok(mip::parent(size, pyramid.interior() as usize, &children, *kind, *quantum))
    }

    fn finish(&self, page: PageAddress) -> Result<Option<Whole>, BuildError> {
        let Description { grid, kind, quantum, .. } = self.description;
        let pyramid = grid.pyramid();
        let window = tile::window(pyramid, page, &self.tiles, *kind, *quantum);
        let Some(window) = window else { return Ok(None) };
        let children: Vec<_> = pyramid
            .children(page)
            .filter_map(|child| Some((place_of(child), self.wholes.get(&child)?.clone())))
            .collect();
        let whole = whole::finish(self.description, page, window, &children);
        whole.map(Some).map_err(|source| BuildError::Encode { page, source })
    }

    fn write(
        &mut self,
        page: PageAddress,
        whole: Option<Whole>,
        writer: &mut ArchiveWriter<impl Write>,
    ) -> Result<(), BuildError> {
        let Some(mut whole) = whole else {
            writer.empty(page);
            return Ok(());
        };
        writer.page(whole.entry, &whole.payload).map_err(BuildError::Write)?;
        self.written += 1;
        whole.payload = Vec::new();
        self.wholes.insert(page, Arc::new(whole));
        Ok(())
    }
}

/// Where a child lies under its parent.
fn place_of(child: PageAddress) -> (usize, usize) {
    ((child.row % 2) as usize, (child.col % 2) as usize)
}

/// A leaf with its coverage, on the dataset's step.
fn settle_leaf(
    description: &Description,
    page: PageAddress,
    raw: &Raw,
    raws: &Raws,
) -> Result<Tile, BuildError> {
    let Description { grid, kind, quantum, .. } = description;
    let coverage = feather::coverage(grid.pyramid(), page, raw, raws);
    let mut planes = raw.planes.clone();
    let mut original = None;
    if *kind == Kind::Height && !quantum.is_none() {
        let mut changed = false;
        for texel in planes.iter_mut().flatten().filter(|texel| !texel.is_nan()) {
            let value = f64::from(*texel);
            if quantum.round(value).is_none() {
                return Err(BuildError::Step { page, step: quantum.step });
            }
            let stored = on_step(value, *quantum, 1);
            changed |= stored.to_bits() != texel.to_bits();
            *texel = stored;
        }
        original = changed.then(|| raw.planes.clone());
    }
    let (rows, cols) = (raw.rows, raw.cols);
    Ok(Tile { rows, cols, planes, original, coverage, spans: None })
}
