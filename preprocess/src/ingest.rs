//! Ingest: rasters become a dataset of a catalog.

use std::fs::File;
use std::io::{self, BufWriter, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use areoid_formats::archive::{
    Archive, ArchiveError, Description, Source, SourceFile, Summary, Written, recover,
};
use areoid_formats::body::Body;
pub use areoid_formats::catalog::Existing;
use areoid_formats::catalog::{Build, Catalog, CatalogError, Disk, NewDataset, publish_build};
use areoid_formats::codec::{Quantum, QuantumError};
use areoid_formats::geodesy::LatitudeKind;
use areoid_formats::page::Kind;
use areoid_formats::projection::Crs;
use areoid_formats::storage::ByteSource as _;
use xxhash_rust::xxh3::Xxh3;

use crate::build::{self, Begun, Means, Proceed, Progress, Site};
use crate::build_error::BuildError;
use crate::estimate::Estimate;
use crate::feather::{FEATHER_TEXELS, HALO};
use crate::mosaic::{Mosaic, MosaicError};
use crate::note::Note;
use crate::raster::{self, Overflow, Raster, RasterError, RasterInfo, ReadOptions, SampleType};
use crate::schedule::Schedule;
use crate::scratch::{Aside, Scratch};

/// Leaf pages along a side of a work unit.
pub const UNIT_PAGES: u32 = 8;

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
    /// Memory to use, in bytes: what exceeds it goes to a file beside the archive. Two work units
    /// and their parents must fit, whatever it is.
    pub memory_bytes: u64,
    /// How much work an unfinished build may lose.
    pub note_every: Duration,
    /// How the rasters are read.
    pub reading: Reading,
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
}

/// What an ingest tells of itself, in this order.
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
    /// A build was left that did not come to its end.
    Leftover(Leftover),
    /// It begins to measure a few leaves, if there are many.
    Measuring,
    /// It begins to build.
    Estimated(Estimate),
    /// It has done a work unit.
    Building(Progress),
    /// It begins to make durable and public what it built.
    Publishing,
}

/// What becomes of a build that was left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Leftover {
    /// It is one of the same input with the same options, and gone on with.
    Resumed {
        /// Its work units.
        units: u64,
        /// Those that are done again, without being written.
        again: u64,
    },
    /// It could have been gone on with, but was to be discarded.
    Discarded,
    /// It is one of another input, or with other options: discarded.
    Unrelated,
}

/// What an ingest did.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// The dataset's name.
    pub dataset: String,
    /// Whether it was there already, made from the same input with the same options.
    pub already_there: bool,
    /// The generation of the catalog that has it.
    pub generation: u64,
    /// What its archive says of its levels.
    pub summary: Summary,
    /// Length of its archive in bytes.
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
    /// A step that heights cannot be stored on.
    #[error(transparent)]
    Step(#[from] QuantumError),
    /// A request that makes no sense.
    #[error("{0}")]
    Request(String),
    /// The caller asked to stop before the build began.
    #[error("interrupted before the build began")]
    Interrupted,
    /// The threads cannot be started.
    #[error("cannot start the threads: {0}")]
    Threads(String),
}

impl IngestError {
    /// Whether the ingest left a build that can be gone on with, if it came past its first unit.
    #[must_use]
    pub fn can_be_resumed(&self) -> bool {
        matches!(self, Self::Build { source, .. } if source.can_be_resumed())
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

/// Who is told of events and asked whether to go on. Only while hashing and after a work unit is
/// the answer heeded.
type Watch<'a> = &'a mut (dyn FnMut(Event) -> Proceed + Send);

/// Ingests; `watch` is told how it goes, and may stop it while it hashes and after each work unit.
///
/// # Errors
///
/// Any [`IngestError`]; the catalog is then as it was.
pub fn ingest(
    disk: &dyn Disk,
    request: &Request,
    mut watch: impl FnMut(Event) -> Proceed + Send,
) -> Result<Outcome, IngestError> {
    let start = Instant::now();
    watch(Event::Opening);
    let mut catalog = newest(&request.catalog)?;
    let (description, mut mosaic) = plan(request, catalog.as_ref(), &mut watch)?;
    let mut outcome = Outcome {
        dataset: description.dataset.clone(),
        already_there: false,
        generation: 0,
        summary: Summary::default(),
        bytes: 0,
        pixels: 0,
        decoded_blocks: 0,
        estimate: None,
        resumed_units: 0,
        seconds: 0.0,
    };
    let there = loop {
        let Some(opened) = &catalog else { break None };
        match existing(opened, &description, request.existing) {
            // Another process may have replaced or removed it since the catalog was opened.
            Err(IngestError::Catalog(error)) if matches!(*error, CatalogError::Missing { .. }) => {
                let generation = opened.generation();
                catalog = newest(&request.catalog)?;
                if catalog.as_ref().is_none_or(|newer| newer.generation() == generation) {
                    return Err(IngestError::Catalog(error));
                }
            }
            there => break there?,
        }
    };
    if let (Some(catalog), Some((summary, bytes))) = (&catalog, there) {
        (outcome.already_there, outcome.generation) = (true, catalog.generation());
        (outcome.summary, outcome.bytes) = (summary, bytes);
        outcome.seconds = start.elapsed().as_secs_f64();
        return Ok(outcome);
    }

    let (mut build, begun, leftover) = begin(disk, request, &description)?;
    if let Some(leftover) = leftover {
        watch(Event::Leftover(leftover));
    }
    outcome.resumed_units = begun.as_ref().map_or(0, |begun| begun.archive.units);
    let mut has_units = outcome.resumed_units > 0;
    let mut note = |event: Event| {
        match event {
            Event::Estimated(estimate) => outcome.estimate = Some(estimate),
            Event::Building(progress) => {
                has_units = true;
                outcome.pixels = progress.texels - progress.texels_skipped;
            }
            _ => {}
        }
        watch(event)
    };
    let written = write(request, &description, &mut mosaic, (&mut build, begun), &mut note);
    let written = match written {
        Ok(written) => written,
        Err(error) => {
            if !(has_units && error.can_be_resumed()) {
                // What cannot be removed either is swept by the next build of this name; the first
                // error says more.
                let _ = build.discard();
            }
            return Err(error);
        }
    };
    watch(Event::Publishing);
    outcome.generation = publish_build(
        build,
        NewDataset {
            name: description.dataset,
            kind: description.kind,
            priority: description.priority,
            body: description.body,
            bytes: written.bytes,
            content: written.content,
            source: description.source,
            existing: request.existing,
        },
    )?;
    (outcome.summary, outcome.bytes) = (written.summary, written.bytes);
    outcome.decoded_blocks = mosaic.decoded_blocks();
    outcome.seconds = start.elapsed().as_secs_f64();
    Ok(outcome)
}

/// The newest generation of the catalog, if there is one.
fn newest(folder: &Path) -> Result<Option<Catalog>, IngestError> {
    match Catalog::open(folder) {
        Ok(catalog) => Ok(Some(catalog)),
        Err(CatalogError::NotACatalog { .. }) => Ok(None),
        Err(error) => Err(error.into()),
    }
}
/// The place of a build, what is gone on with there, and what is told of what was left.
type Place<'a> = (Build<'a>, Option<Begun>, Option<Leftover>);

/// Opens the place of the build, and what is left there of an earlier one that can be gone on with.
fn begin<'a>(
    disk: &'a dyn Disk,
    request: &Request,
    description: &Description,
) -> Result<Place<'a>, IngestError> {
    let (folder, name) = (&request.catalog, &description.dataset);
    let mut build = Build::resume(disk, folder, name)?;
    let source = build.source()?;
    let left = !source.is_empty();
    if request.unfinished == Unfinished::Discard {
        // What cannot be read could not have been gone on with.
        let ours = recover::is_begun(&source, description).unwrap_or(false);
        build.cut(0)?;
        let leftover = if ours { Leftover::Discarded } else { Leftover::Unrelated };
        return Ok((build, None, left.then_some(leftover)));
    }
    let archive = recover::unfinished(&source, description)
        .map_err(|source| IngestError::Leftover { dataset: name.clone(), source })?;
    let unrelated = left && archive.is_none();
    let Some(archive) = archive.filter(|archive| archive.units > 0) else {
        build.cut(0)?;
        return Ok((build, None, unrelated.then_some(Leftover::Unrelated)));
    };
    build.cut(archive.end)?;
    let note = build.last_note()?.and_then(|note| Note::from_bytes(&note));
    let noted = note.as_ref().map_or(0, |note| note.units).min(archive.units);
    let leftover = Leftover::Resumed { units: archive.units, again: archive.units - noted };
    Ok((build, Some(Begun { archive, note }), Some(leftover)))
}

/// Bytes of heads, padding and small payloads that are written together; payloads of this size go
/// to the file without a copy.
const WRITTEN_TOGETHER: usize = 32 << 10;

/// A build's archive, written in large pieces.
struct Buffered<'a, 'b>(BufWriter<&'a mut Build<'b>>);

impl Write for Buffered<'_, '_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

impl Site for Buffered<'_, '_> {
    fn note(&mut self, note: &[u8]) -> io::Result<()> {
        self.0.flush()?;
        self.0.get_mut().note(note).map_err(io::Error::other)
    }
}

/// Builds the archive in `build`, on threads of its own.
fn write(
    request: &Request,
    description: &Description,
    mosaic: &mut Mosaic,
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
    let spare_bytes = request.memory_bytes.saturating_sub(step_bytes(description));
    watch(Event::Measuring);
    let pyramid = description.grid.pyramid();
    let done = begun.as_ref().map_or(0, |begun| begun.archive.units) as f64;
    let units = Schedule::new(pyramid, description.unit_pages, HALO).remaining().max(1) as f64;
    let estimate = threads.install(|| {
        let left = 1.0 - done / units;
        Estimate::of(pyramid).measure(description, mosaic, &scratch, spare_bytes, left)
    });
    watch(Event::Estimated(estimate));
    // A quarter for the rasters' blocks, which wait only where strips are wide.
    let aside = Arc::new(Aside::new(Arc::clone(&scratch)));
    mosaic.spill(&Arc::new(Overflow::new(aside, spare_bytes / 4)));
    let frontier_bytes = spare_bytes - spare_bytes / 4;
    let means = Means { scratch, frontier_bytes, note_every: request.note_every };
    let mosaic = &*mosaic;
    let site = Buffered(BufWriter::with_capacity(WRITTEN_TOGETHER, build));
    let built = threads.install(|| {
        let watch = |progress| watch(Event::Building(progress));
        build::build(description, mosaic, site, &means, begun, watch)
    });
    if !matches!(built, Err(BuildError::Interrupted)) {
        // What was made of rasters that changed is of no use, and says why they could not be read.
        mosaic.check_unchanged()?;
    }
    let (site, written) = built.map_err(failed)?;
    site.0.into_inner().map_err(|error| failed(BuildError::Write(error.into_error())))?;
    Ok(written)
}

/// What a step of the build needs beside the pages that wait, in bytes: its leaves and those of the
/// next unit, the pages fetched and made, and the blocks that leaves are cut from.
fn step_bytes(description: &Description) -> u64 {
    const EVERYTHING_ELSE: u64 = 48 << 20;
    let side = u64::from(description.grid.pyramid().page_side());
    let texel = match description.kind {
        Kind::Height => 4,
        Kind::Color | Kind::Normal => 3,
    };
    let unit = u64::from(description.unit_pages).pow(2) * side * side * texel;
    5 * unit + EVERYTHING_ELSE
}

/// What the catalog has under the name of `description`, if that is the same dataset.
fn existing(
    catalog: &Catalog,
    description: &Description,
    policy: Existing,
) -> Result<Option<(Summary, u64)>, IngestError> {
    let Ok(record) = catalog.dataset(&description.dataset) else { return Ok(None) };
    let archive = match (catalog.archive(record), policy) {
        (Ok(archive), _) => archive,
        // What cannot be read can be replaced.
        (Err(_), Existing::Replace) => return Ok(None),
        (Err(error), Existing::Keep) => return Err(error.into()),
    };
    if archive.description() == description
        && let Some(summary) = archive.summary()
    {
        return Ok(Some((summary.clone(), archive.len())));
    }
    match policy {
        Existing::Replace => Ok(None),
        Existing::Keep => Err(CatalogError::Exists { name: description.dataset.clone() }.into()),
    }
}

/// Opens the rasters and decides what becomes of them.
fn plan(
    request: &Request,
    catalog: Option<&Catalog>,
    watch: Watch<'_>,
) -> Result<(Description, Mosaic), IngestError> {
    let catalog_body = catalog.filter(|c| !c.datasets().is_empty()).map(Catalog::body);
    let (rasters, crs, body) = open(&request.rasters, &request.reading, catalog_body)?;
    if let Some(catalog) = catalog_body.filter(|catalog| !catalog.same_as(&body)) {
        let (catalog, raster) = (catalog.name.clone(), body.name);
        return Err(CatalogError::OtherBody { catalog, raster }.into());
    }
    let first = rasters.first().ok_or(MosaicError::Empty)?.info().clone();
    let kind = match (request.kind, first.bands) {
        (Some(Kind::Normal), _) => {
            return Err(IngestError::Request("--kind normal is not supported yet".to_owned()));
        }
        (Some(kind), _) => kind,
        (None, 1 | 2) => Kind::Height,
        (None, _) => Kind::Color,
    };
    let name = match &request.name {
        Some(name) => name.clone(),
        None => {
            let stem = first.path.file_stem().and_then(|stem| stem.to_str());
            stem.unwrap_or_default().to_owned()
        }
    };
    let mosaic = Mosaic::new(rasters, crs, kind, request.page_side)?;
    let files = fingerprints(&request.rasters, watch)?;
    let reading = &request.reading;
    let source = Source {
        files,
        crs: reading.crs.clone(),
        extent: reading.extent,
        nodata: reading.nodata.map(|nodata| nodata.to_string()),
        body: reading.body.clone(),
        latitudes: reading.latitudes.map(|kind| latitudes_name(kind).to_owned()),
    };
    let description = Description {
        dataset: name,
        kind,
        body,
        grid: mosaic.grid().clone(),
        quantum: quantum(kind, &first, request.step_m)?,
        priority: request.priority,
        feather_texels: FEATHER_TEXELS,
        unit_pages: UNIT_PAGES,
        source,
    };
    Ok((description, mosaic))
}

/// The rasters of a dataset, what they are projected by, and the body they show.
pub type Opened = (Vec<Arc<dyn Raster>>, Crs, Body);

/// Opens rasters as `reading` says; `catalog` is the body of the catalog they go to or are in, if
/// it has one.
///
/// # Errors
///
/// [`IngestError::Raster`] or [`IngestError::Request`].
pub fn open(
    paths: &[PathBuf],
    reading: &Reading,
    catalog: Option<&Body>,
) -> Result<Opened, IngestError> {
    let asked = match &reading.body {
        Some(text) => Some(Body::parse(text).map_err(|e| IngestError::Request(e.to_string()))?),
        None => None,
    };
    let mut options = ReadOptions {
        crs: reading.crs.clone(),
        extent: reading.extent,
        nodata: reading.nodata,
        body: asked.clone(),
        latitudes: reading.latitudes,
    };
    let open_all = |options: &ReadOptions| -> Result<Vec<Arc<dyn Raster>>, RasterError> {
        paths.iter().map(|path| raster::open(path, options).map(Arc::from)).collect()
    };
    let mut rasters = open_all(&options)?;
    let crs = rasters.first().and_then(|raster| raster.info().crs);
    if let (None, Some(catalog)) = (&asked, catalog) {
        // What a raster says of its body gives way to the catalog's if the equators agree: a map
        // on a sphere may well show the catalog's ellipsoid.
        let adopt = crs.is_none_or(|crs| {
            let (a, b) = (crs.ellipsoid.a().0, catalog.ellipsoid.a().0);
            (a / b - 1.0).abs() <= Body::SAME_WITHIN
        });
        if adopt {
            options.body = Some(catalog.clone());
            rasters = open_all(&options)?;
        }
    }
    let first = rasters.first().ok_or(MosaicError::Empty)?.info();
    let crs = first.crs.ok_or_else(|| {
        let path = first.path.display();
        IngestError::Request(format!(
            "{path} does not say which body it shows: give --body or --crs"
        ))
    })?;
    let body = options.body.unwrap_or_else(|| Body::from_ellipsoid(crs.body));
    Ok((rasters, crs, body))
}

/// The step heights are stored on.
fn quantum(kind: Kind, info: &RasterInfo, step_m: Option<f64>) -> Result<Quantum, QuantumError> {
    match (kind, step_m.filter(|&step| step != 0.0), info.sample) {
        (Kind::Color | Kind::Normal, ..) | (_, None, SampleType::F32 | SampleType::F64) => {
            Ok(Quantum::NONE)
        }
        (_, Some(step), _) => Quantum::new(step, 0.0),
        (_, None, _) => Quantum::new(info.scale.abs(), info.offset),
    }
}

/// The name of a kind of latitudes on the command line.
#[must_use]
pub fn latitudes_name(kind: LatitudeKind) -> &'static str {
    match kind {
        LatitudeKind::Planetographic => "planetographic",
        LatitudeKind::Planetocentric => "planetocentric",
    }
}

/// Names, lengths and contents of files.
fn fingerprints(paths: &[PathBuf], watch: Watch<'_>) -> Result<Vec<SourceFile>, IngestError> {
    let length = |path: &PathBuf| path.metadata().map_or(0, |data| data.len());
    let (mut done, bytes) = (0, paths.iter().map(length).sum());
    let mut count = |read| {
        done += read;
        match watch(Event::Hashing { done, bytes }) {
            Proceed::Yes => Ok(()),
            Proceed::No => Err(IngestError::Interrupted),
        }
    };
    paths.iter().map(|path| fingerprint(path, &mut count)).collect()
}

/// A file's name, length and content; `count` is told of bytes read.
fn fingerprint(
    path: &Path,
    count: &mut dyn FnMut(u64) -> Result<(), IngestError>,
) -> Result<SourceFile, IngestError> {
    let failed = |source: io::Error| CatalogError::io("read", path, source);
    let mut file = File::open(path).map_err(failed)?;
    let (mut hash, mut bytes) = (Xxh3::new(), 0);
    let mut buffer = vec![0; 1 << 20];
    loop {
        let read = file.read(&mut buffer).map_err(failed)?;
        if read == 0 {
            break;
        }
        hash.update(&buffer[..read]);
        bytes += read as u64;
        count(read as u64)?;
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    Ok(SourceFile { name, bytes, xxh3: format!("{:032x}", hash.digest128()) })
}

/// Opens the rasters that `archive` was made from, as it was made from them.
///
/// # Errors
///
/// [`IngestError`] if they cannot be read, or do not lie on the archive's grid.
pub fn reopen(paths: &[PathBuf], archive: &Archive) -> Result<Mosaic, IngestError> {
    let description = archive.description();
    let source = &description.source;
    let reading = Reading {
        crs: source.crs.clone(),
        extent: source.extent,
        nodata: source.nodata.as_deref().and_then(|nodata| nodata.parse().ok()),
        body: source.body.clone(),
        latitudes: [LatitudeKind::Planetographic, LatitudeKind::Planetocentric]
            .into_iter()
            .find(|&kind| source.latitudes.as_deref() == Some(latitudes_name(kind))),
    };
    let (rasters, crs, _) = open(paths, &reading, Some(&description.body))?;
    let page_side = description.grid.pyramid().page_side();
    let mosaic = Mosaic::new(rasters, crs, description.kind, page_side)?;
    if *mosaic.grid() != description.grid {
        let dataset = &description.dataset;
        let reason =
            format!("the rasters do not lie on the grid of {dataset}: was it made from them?");
        return Err(IngestError::Request(reason));
    }
    Ok(mosaic)
}
