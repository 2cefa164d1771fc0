//! From rasters to the dataset that they make.

use std::fs::File;
use std::io::{self, Read};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use areoid_formats::archive::{Archive, Description, Resampling, Source, SourceFile};
use areoid_formats::body::Body;
use areoid_formats::catalog::{Catalog, CatalogError};
use areoid_formats::codec::Quantum;
use areoid_formats::geodesy::LatitudeKind;
use areoid_formats::grid::Placement;
use areoid_formats::page::Kind;
use areoid_formats::projection::Crs;
use rayon::ThreadPool;
use xxhash_rust::xxh3::Xxh3;

use super::UNIT_PAGES;
use super::request::{Event, IngestError, PARTS, Reading, Request, TargetGrid, Watch, tell};
use crate::feather::FEATHER_TEXELS;
use crate::mosaic::{Layout, Mosaic, MosaicError};
use crate::normals::Normals;
use crate::origin::Origin;
use crate::raster::{self, Fence, Raster, RasterError, RasterInfo, ReadOptions, SampleType};
use crate::resample::kernel::{Kernel, RangeLimit};
use crate::resample::target::{Split, TargetMap, TargetRequest, split, target_grid};
use crate::resample::transform::Precision;
use crate::resample::truth::SourcePixels;
use crate::resample::{self, Resampler, Texels};
use crate::truth::{OnTexels, Truth};

/// What becomes of the rasters.
pub(super) struct Plan {
    /// What the user calls it.
    pub(super) called: String,
    /// The datasets: one of that name, or the parts of a group of that name.
    pub(super) parts: Vec<Part>,
    /// Whether they are a group.
    pub(super) is_group: bool,
    /// What a group is made instead of: one pyramid on the rasters' own grid, which nobody keeps.
    pub(super) instead_of: Option<Part>,
    /// How long its archive would be, once it is known.
    pub(super) instead_bytes: Option<u64>,
}

/// A dataset to be built.
pub(super) struct Part {
    pub(super) description: Description,
    pub(super) origin: Box<dyn Origin>,
}

/// Opens the rasters and decides what becomes of them.
pub(super) fn plan(
    request: &Request,
    threads: &ThreadPool,
    catalog: Option<&Catalog>,
    watch: Watch<'_>,
) -> Result<Plan, IngestError> {
    let catalog_body = catalog.filter(|c| !c.datasets().is_empty()).map(Catalog::body);
    let (rasters, crs, body) = open(&request.rasters, &request.reading, catalog_body)?;
    if let Some(catalog) = catalog_body.filter(|catalog| !catalog.same_as(&body)) {
        let (catalog, raster) = (catalog.name.clone(), body.name);
        return Err(CatalogError::OtherBody { catalog, raster }.into());
    }
    let first = rasters.first().ok_or(MosaicError::Empty)?.info().clone();
    let kind = match (request.kind, first.bands) {
        (Some(kind), _) => kind,
        (None, 1 | 2) => Kind::Height,
        (None, _) => Kind::Color,
    };
    let called = request.called();
    let layout = Layout::new(rasters, crs)?;
    let placement = layout.placement()?;
    let Origins { parts, instead_of } =
        threads.install(|| origins(request, layout, placement, kind))?;
    let reading = &request.reading;
    let files =
        threads.install(|| fingerprints(&request.rasters, reading.within.as_ref(), watch))?;
    let source = Source {
        files,
        crs: reading.crs.clone(),
        extent: reading.extent,
        nodata: reading.nodata.map(|nodata| nodata.to_string()),
        body: reading.body.clone(),
        latitudes: reading.latitudes.map(|kind| latitudes_name(kind).to_owned()),
    };
    let quantum = quantum(kind, &first, request.step_m)?;
    let is_group = parts.len() > 1;
    let part = |(part, is_resampled, origin): PartFrom| Part {
        description: Description {
            dataset: if part.is_empty() { called.clone() } else { format!("{called}.{part}") },
            kind,
            body: body.clone(),
            grid: origin.grid().clone(),
            quantum,
            priority: request.priority,
            feather_texels: FEATHER_TEXELS,
            unit_pages: UNIT_PAGES,
            source: source.clone(),
            resampling: is_resampled.then(|| Resampling {
                kernel: request.kernel.name().to_owned(),
                range_limited: request.limit == RangeLimit::Taps,
                fitted: texels(request, kind) == Texels::Fitted,
            }),
            mip: request.mip,
        },
        origin,
    };
    let instead_of = instead_of.map(|origin| part(("", false, origin)));
    let parts = parts.into_iter().map(part).collect();
    Ok(Plan { called, parts, is_group, instead_of, instead_bytes: None })
}

/// What part of a group some leaves are, or nothing if they are all there is; whether they are resampled,
/// and where they come from.
type PartFrom = (&'static str, bool, Box<dyn Origin>);

/// Where the leaves of each part come from, and those of [`Plan::instead_of`].
struct Origins {
    parts: Vec<PartFrom>,
    instead_of: Option<Box<dyn Origin>>,
}

/// The rasters as they are or resampled, or the normals of either.
fn origins(
    request: &Request,
    layout: Layout,
    placement: Placement,
    kind: Kind,
) -> Result<Origins, IngestError> {
    let one = |part| Origins { parts: vec![part], instead_of: None };
    let (kernel, limit, precision) = (request.kernel, request.limit, Precision::default());
    let texels = texels(request, kind);
    let resampling = resample::Resampling { kernel, limit, precision, texels };
    // Heights on a step of their own keep what whole meters lose.
    let is_rounded = kind != Kind::Normal && request.step_m.is_none_or(|step| step == 0.0);
    let resampled = |grid, layout| -> Result<Box<dyn Origin>, IngestError> {
        let pixels = kind_of_pixels(kind);
        let leaves = Resampler::new(grid, layout, placement, pixels, resampling)?;
        let leaves = if is_rounded { leaves } else { leaves.unrounded() };
        let leaves = if kind == Kind::Normal { leaves.unmeasured() } else { leaves };
        Ok(of_kind(kind, Box::new(leaves)))
    };
    let map = match request.grid {
        TargetGrid::One(TargetMap::Native) if request.pixel_size.is_none() => {
            let rows = 0..placement.height;
            return Ok(one(("", false, native(&layout, rows, kind, request.page_side)?)));
        }
        TargetGrid::One(map) => map,
        TargetGrid::Split if request.pixel_size.is_some() => {
            let reason = "a split raster keeps its own pixels: leave the pixel size out";
            return Err(IngestError::Request(reason.to_owned()));
        }
        TargetGrid::Split => {
            let Split { rows, north, south } = split(&placement, request.page_side)?;
            let cap = |grid| resampled(grid, layout.clone());
            let [band, at_north, at_south] = PARTS;
            let native = |rows| native(&layout, rows, kind, request.page_side);
            return Ok(Origins {
                instead_of: Some(native(0..placement.height)?),
                parts: vec![
                    (band, false, native(rows)?),
                    (at_north, true, cap(north)?),
                    (at_south, true, cap(south)?),
                ],
            });
        }
    };
    let (pixel_size, page_side) = (request.pixel_size, request.page_side);
    let grid = target_grid(&[placement], TargetRequest { map, pixel_size, page_side })?;
    Ok(one(("", true, resampled(grid, layout)?)))
}

/// What texels are of what lies between pixels: heights of caps are fitted, unless pixels, their means or
/// their range was asked for.
fn texels(request: &Request, kind: Kind) -> Texels {
    let is_smooth = !matches!(request.kernel, Kernel::Nearest | Kernel::Average);
    let is_free = is_smooth && request.limit == RangeLimit::None;
    if request.grid == TargetGrid::Split && kind == Kind::Height && is_free {
        Texels::Fitted
    } else {
        Texels::Sampled
    }
}

/// Leaves on the rasters' own grid.
fn native(
    layout: &Layout,
    rows: Range<u32>,
    kind: Kind,
    page_side: u32,
) -> Result<Box<dyn Origin>, IngestError> {
    let mosaic = Mosaic::of_rows(layout, rows, kind_of_pixels(kind), page_side)?;
    Ok(of_kind(kind, Box::new(mosaic)))
}

/// What the pixels are that a dataset is made of.
fn kind_of_pixels(kind: Kind) -> Kind {
    if kind == Kind::Normal { Kind::Height } else { kind }
}

/// Those leaves, or the normals of their heights.
fn of_kind(kind: Kind, leaves: Box<dyn Origin>) -> Box<dyn Origin> {
    if kind == Kind::Normal { Box::new(Normals::new(leaves)) } else { leaves }
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
        within: reading.within.clone(),
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
fn quantum(kind: Kind, info: &RasterInfo, step_m: Option<f64>) -> Result<Quantum, IngestError> {
    let (step, offset) = match (kind, step_m.filter(|&step| step != 0.0), info.sample) {
        (Kind::Color | Kind::Normal, ..) | (_, None, SampleType::F32 | SampleType::F64) => {
            return Ok(Quantum::NONE);
        }
        (_, Some(step), _) => (step, 0.0),
        (_, None, _) => (info.scale.abs(), info.offset),
    };
    Quantum::new(step, offset).map_err(|_| IngestError::Step { step, offset })
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
fn fingerprints(
    paths: &[PathBuf],
    within: Option<&Fence>,
    watch: Watch<'_>,
) -> Result<Vec<SourceFile>, IngestError> {
    let length = |path: &PathBuf| path.metadata().map_or(0, |data| data.len());
    let (mut done, bytes) = (0, paths.iter().map(length).sum());
    let mut count = |read| {
        done += read;
        tell(watch, Event::Hashing { done, bytes })
    };
    paths.iter().map(|path| fingerprint(path, within, &mut count)).collect()
}

/// A file's name, length and content; `count` is told of bytes read.
fn fingerprint(
    path: &Path,
    within: Option<&Fence>,
    count: &mut dyn FnMut(u64) -> Result<(), IngestError>,
) -> Result<SourceFile, IngestError> {
    let failed = |source: io::Error| CatalogError::io("read", path, source);
    let mut file = File::open(path).map_err(failed)?;
    within.map_or(Ok(()), |fence| fence.check(&file, path))?;
    // What comes next is read while this is hashed.
    let (mut hash, mut bytes) = (Xxh3::new(), 0);
    let (mut here, mut next) = (Vec::new(), Vec::new());
    read_chunk(&mut file, &mut here).map_err(failed)?;
    while !here.is_empty() {
        let (read, ()) = rayon::join(|| read_chunk(&mut file, &mut next), || hash.update(&here));
        read.map_err(failed)?;
        bytes += here.len() as u64;
        count(here.len() as u64)?;
        std::mem::swap(&mut here, &mut next);
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    Ok(SourceFile { name, bytes, xxh3: format!("{:032x}", hash.digest128()) })
}

/// Fills `chunk` with what comes next of a file; it ends up empty at the end.
fn read_chunk(file: &mut File, chunk: &mut Vec<u8>) -> io::Result<usize> {
    chunk.clear();
    file.take(2 << 20).read_to_end(chunk)
}

/// Opens the rasters that `archive` was made from, as it was made from them: its leaves once more.
///
/// # Errors
///
/// [`IngestError`] if they cannot be read, or do not lie on the archive's grid: all of it if leaves
/// are their pixels, any of it if they were resampled.
pub fn reopen(paths: &[PathBuf], archive: &Archive) -> Result<Box<dyn Truth>, IngestError> {
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
        within: None,
    };
    let (rasters, crs, _) = open(paths, &reading, Some(&description.body))?;
    let (grid, kind) = (&description.grid, description.kind);
    let layout = Layout::new(rasters, crs)?;
    let (on_grid, truth): (bool, Box<dyn Truth>) = if description.resampling.is_some() {
        if kind == Kind::Normal {
            let reason = "normals of resampled heights have no pixels to be held against";
            return Err(IngestError::Request(reason.to_owned()));
        }
        let placement = layout.placement()?;
        let pixels = SourcePixels::new(grid.clone(), &layout, placement, kind)?;
        (pixels.are_on_grid(), Box::new(pixels))
    } else {
        let rows = layout.rows_of(grid);
        let origin = native(&layout, rows, kind, grid.pyramid().page_side())?;
        (origin.grid() == grid, Box::new(OnTexels::new(origin)))
    };
    if !on_grid {
        let dataset = &description.dataset;
        let reason =
            format!("the rasters do not lie on the grid of {dataset}: was it made from them?");
        return Err(IngestError::Request(reason));
    }
    Ok(truth)
}
