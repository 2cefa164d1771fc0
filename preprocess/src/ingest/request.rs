//! What an ingest is asked, what it tells, and what can go wrong.

use std::path::PathBuf;
use std::time::Duration;

use areoid_formats::archive::{ArchiveError, MipRule, Summary};
use areoid_formats::catalog::{CatalogError, Existing};
use areoid_formats::geodesy::LatitudeKind;
use areoid_formats::grid::Grid;
use areoid_formats::page::Kind;
use areoid_formats::units::Meters;

use crate::build::{Proceed, Progress};
use crate::build_error::BuildError;
use crate::estimate::Estimate;
use crate::mosaic::MosaicError;
use crate::raster::{Fence, RasterError};
use crate::resample::OtherBody;
use crate::resample::kernel::{Kernel, RangeLimit};
use crate::resample::target::{TargetError, TargetMap};

/// What to ingest, and how.
#[derive(Clone, Debug, PartialEq)]
pub struct Request {
    /// The rasters, a later one over an earlier one.
    pub rasters: Vec<PathBuf>,
    /// The catalog; it is made if it is not there.
    pub catalog: PathBuf,
    /// The dataset's name; the first raster's stem if `None`.
    pub name: Option<String>,
    /// What the samples are; heights of one band and colors of three or four if `None`.
    pub kind: Option<Kind>,
    /// The step in meters that heights are stored on; 0 or `None` is lossless.
    pub step_m: Option<f64>,
    /// The grid of the dataset, or of its parts.
    pub grid: TargetGrid,
    /// Ground meters to a texel where the grid's map is truest; those of the rasters if `None`.
    pub pixel_size: Option<Meters>,
    /// How texels are made of pixels where the grid is not the rasters' own.
    pub kernel: Kernel,
    /// Whether those texels keep within the pixels around them.
    pub limit: RangeLimit,
    /// How coarser texels are made of finer ones.
    pub mip: MipRule,
    /// Texels along a page's side, border included.
    pub page_side: u32,
    /// Higher covers lower.
    pub priority: i32,
    /// Threads; as many as there are cores if `None`.
    pub threads: Option<usize>,
    /// Whether a dataset of the same name made from something else is replaced.
    pub existing: Existing,
    /// What becomes of an unfinished build of this dataset.
    pub unfinished: Unfinished,
    /// Memory to use, in bytes: what exceeds it goes to a file beside the archive. What a
    /// step of the work takes must fit, whatever it is.
    pub memory_bytes: u64,
    /// How much work an unfinished build may lose.
    pub note_every: Duration,
    /// How the rasters are read.
    pub reading: Reading,
}

impl Request {
    /// What the dataset, or the group, will be called.
    #[must_use]
    pub fn called(&self) -> String {
        if let Some(name) = &self.name {
            return name.clone();
        }
        let stem = self.rasters.first().and_then(|path| path.file_stem());
        let stem = stem.and_then(|stem| stem.to_str()).unwrap_or_default();
        // The heights that normals are made of come from the same file.
        let what = if self.kind == Some(Kind::Normal) { ".normal" } else { "" };
        format!("{stem}{what}")
    }

    /// What its datasets will be called: that name, or those of the group's parts.
    #[must_use]
    pub fn datasets(&self) -> Vec<String> {
        let called = self.called();
        match self.grid {
            TargetGrid::One(_) => vec![called],
            TargetGrid::Split => PARTS.iter().map(|part| format!("{called}.{part}")).collect(),
        }
    }
}

/// What the parts of a split globe are called.
pub(super) const PARTS: [&str; 3] = ["band", "north", "south"];

/// What the texels of a dataset lie on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TargetGrid {
    /// One grid.
    One(TargetMap),
    /// A band on the raster's own grid and a cap about each pole, which overlap: a group of three
    /// datasets, its name with `.band`, `.north` and `.south` behind it.
    Split,
}

/// What becomes of a build that did not come to its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unfinished {
    /// It is discarded.
    Discard,
    /// It is gone on with, if it is one of the same input with the same options.
    Resume,
}

/// The options that say how a raster is read, as they were given.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Reading {
    /// `EPSG:n`, a PROJ string, WKT, or a file with one of them.
    pub crs: Option<String>,
    /// West, south, east, north in map units.
    pub extent: Option<[f64; 4]>,
    /// The sample that stands for no data.
    pub nodata: Option<f64>,
    /// The body's name or radii.
    pub body: Option<String>,
    /// What latitudes mean.
    pub latitudes: Option<LatitudeKind>,
    /// Where the rasters and the files beside them must lie; [`Self::crs`] is no file then.
    pub within: Option<Fence>,
}

/// What an ingest tells of itself, in this order. The answer is heeded, but of the last. Of parts
/// built one after another it tells as of one build; which of them are gone on with, as each begins.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Event {
    /// It begins to read what the rasters are.
    Opening,
    /// It hashes the input.
    Hashing {
        /// Bytes hashed.
        done: u64,
        /// Bytes of all files.
        bytes: u64,
    },
    /// It checks what is left of a build, to go on with it.
    Checking {
        /// Bytes checked.
        done: u64,
        /// Bytes that are left.
        bytes: u64,
    },
    /// A build was left that did not come to its end.
    Leftover(Leftover),
    /// It will use more memory than it may.
    ShortOfMemory {
        /// What it needs, whatever it may use, in bytes.
        least_bytes: u64,
    },
    /// It begins to measure a few leaves, if there are many.
    Measuring,
    /// It begins to build.
    Estimated(Estimate),
    /// It begins with work units, or has done one.
    Building(Progress),
    /// It begins to make durable and public what it built.
    Publishing,
}

/// What becomes of a build that was left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Leftover {
    /// It is one of the same input with the same options, and gone on with: told when the build
    /// begins and its note was tried.
    Resumed {
        /// Its work units.
        units: u64,
        /// Those that are done again, without being written.
        again: u64,
    },
    /// It is done, of the same input with the same options, and only not published: now it is.
    Whole,
    /// It could have been gone on with, but was to be discarded.
    Discarded,
    /// It is one of another input, or with other options: discarded.
    Unrelated,
}

/// What an ingest did.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// The name of the dataset, or of the group.
    pub dataset: String,
    /// The dataset, or the parts of the group.
    pub parts: Vec<PartMade>,
    /// What was saved by splitting.
    pub saved: Option<Saved>,
    /// Whether it was there already, made from the same input with the same options.
    pub already_there: bool,
    /// The generation of the catalog that has it.
    pub generation: u64,
    /// Length of all archives in bytes.
    pub bytes: u64,
    /// Pixels read.
    pub pixels: u64,
    /// Blocks of the rasters that were decoded, without those of the estimate.
    pub decoded_blocks: u64,
    /// What was expected; `None` if there was nothing to do.
    pub estimate: Option<Estimate>,
    /// Work units that an earlier process had done.
    pub resumed_units: u64,
    /// Wall-clock seconds.
    pub seconds: f64,
}

/// A dataset that an ingest made.
#[derive(Clone, Debug, PartialEq)]
pub struct PartMade {
    /// Its name.
    pub name: String,
    /// Where its texels lie.
    pub grid: Grid,
    /// What its archive says of its levels.
    pub summary: Summary,
    /// Length of its archive in bytes.
    pub bytes: u64,
}

/// How much smaller the parts of a split raster are than its pyramid on its own grid; negative
/// where they are larger.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Saved {
    /// Texels of the finest levels.
    pub texels: i64,
    /// Bytes of archives. `None` where all was there already, and of globes beyond 16 Mi texels: to know
    /// it the one pyramid is built.
    pub bytes: Option<i64>,
}

/// An ingest that did not come to its end. The catalog is as it was.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum IngestError {
    /// A raster cannot be read.
    #[error(transparent)]
    Raster(Box<RasterError>),
    /// The rasters make no dataset.
    #[error(transparent)]
    Mosaic(Box<MosaicError>),
    /// There is no such grid for the rasters.
    #[error(transparent)]
    Target(#[from] TargetError),
    /// The rasters cannot be resampled to it.
    #[error(transparent)]
    Resample(#[from] OtherBody),
    /// The catalog refuses.
    #[error(transparent)]
    Catalog(Box<CatalogError>),
    /// The archive cannot be built.
    #[error("cannot build {dataset}")]
    Build {
        /// The dataset.
        dataset: String,
        /// Why.
        source: Box<BuildError>,
    },
    /// What is left of an earlier build cannot be read.
    #[error("cannot read what is left of an unfinished build of {dataset}")]
    Leftover {
        /// The dataset.
        dataset: String,
        /// Why.
        source: ArchiveError,
    },
    /// A step that heights cannot be stored on, asked for or the raster's own.
    #[error("heights cannot be stored on a step of {step:?} m from {offset:?} m: give --step-m")]
    Step {
        /// The step in meters.
        step: f64,
        /// A height on it, in meters.
        offset: f64,
    },
    /// A request that makes no sense.
    #[error("{0}")]
    Request(String),
    /// The caller asked to stop before the build began.
    #[error("interrupted before the build began")]
    Interrupted,
    /// The threads cannot be started.
    #[error("cannot start the threads: {0}")]
    Threads(String),
    /// Any of these, of a cause that may go away, and what is built so far is kept.
    #[error(transparent)]
    Kept(Box<IngestError>),
}

impl IngestError {
    /// Whether the ingest left a build that [`Unfinished::Resume`] goes on with.
    #[must_use]
    pub fn can_be_resumed(&self) -> bool {
        matches!(self, Self::Kept(_))
    }

    /// Whether the caller asked to stop.
    #[must_use]
    pub fn is_interruption(&self) -> bool {
        match self {
            Self::Kept(error) => error.is_interruption(),
            Self::Build { source, .. } => matches!(**source, BuildError::Interrupted),
            error => matches!(error, Self::Interrupted),
        }
    }

    /// Whether the same ingest of the same rasters may come to its end another time.
    pub(super) fn may_go_away(&self) -> bool {
        match self {
            Self::Build { source, .. } => source.may_go_away(),
            Self::Catalog(error) => matches!(**error, CatalogError::Io { .. }),
            Self::Raster(error) => matches!(**error, RasterError::Io { .. }),
            error => matches!(error, Self::Interrupted | Self::Threads(_) | Self::Kept(_)),
        }
    }
}

/// Boxed, because these errors are many times larger than what they are returned beside.
macro_rules! boxed {
    ($($error:ident: $variant:ident),*) => {$(
        impl From<$error> for IngestError {
            fn from(error: $error) -> Self {
                Self::$variant(Box::new(error))
            }
        }
    )*};
}
boxed!(RasterError: Raster, MosaicError: Mosaic, CatalogError: Catalog);

/// Who is told of events and asked whether to go on.
pub(super) type Watch<'a> = &'a mut (dyn FnMut(Event) -> Proceed + Send);

/// Tells of an event before the build begins.
pub(super) fn tell(watch: Watch<'_>, event: Event) -> Result<(), IngestError> {
    match watch(event) {
        Proceed::Yes => Ok(()),
        Proceed::No => Err(IngestError::Interrupted),
    }
}
