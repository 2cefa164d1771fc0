//! An ingest as it is asked for over HTTP: the options of `areoid ingest` in JSON, paths of the server.

use std::path::PathBuf;
use std::time::Duration;

use areoid_formats::archive::MipRule;
use areoid_formats::catalog::check_name;
use areoid_formats::codec::Quantum;
use areoid_formats::geodesy::LatitudeKind;
use areoid_formats::page::Kind;
use areoid_formats::projection::Pole;
use areoid_formats::pyramid::Pyramid;
use areoid_formats::units::Meters;
use areoid_preprocess::ingest::{Existing, Reading, Request, TargetGrid, Unfinished};
use areoid_preprocess::resample::kernel::{Kernel, RangeLimit};
use areoid_preprocess::resample::target::TargetMap;
use serde::{Deserialize, Serialize};

use crate::insertion::Lifetime;

/// What to insert, and how. What is left out is as `areoid ingest` has it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InsertRequest {
    /// Rasters, by absolute paths.
    pub rasters: Vec<PathBuf>,
    /// Whether it is gone when the service ends.
    #[serde(default)]
    pub temporary: bool,
    /// The dataset's name.
    #[serde(default)]
    pub name: Option<String>,
    /// What the samples are.
    #[serde(default)]
    pub kind: Option<Kind>,
    /// The step in meters that heights are stored on.
    #[serde(default)]
    pub step_m: Option<f64>,
    /// `native`, `equirectangular`, `polar-north`, `polar-south` or `split`.
    #[serde(default = "native")]
    pub grid: String,
    /// Meters to a texel.
    #[serde(default)]
    pub pixel_size_m: Option<f64>,
    /// The kernel's name, as the archive has it.
    #[serde(default = "spline")]
    pub kernel: String,
    /// Whether resampled texels keep within the pixels around them.
    #[serde(default)]
    pub limit_range: bool,
    /// How coarser levels are made.
    #[serde(default)]
    pub mip: MipRule,
    /// Texels along a page's side.
    #[serde(default = "page_size")]
    pub page_size: u32,
    /// Higher covers lower.
    #[serde(default)]
    pub priority: i32,
    /// Threads; one a core if left out.
    #[serde(default)]
    pub threads: Option<usize>,
    /// Whether a dataset of the same name made from something else is replaced.
    #[serde(default)]
    pub force: bool,
    /// Memory to use.
    #[serde(default = "memory_mib")]
    pub memory_mib: u64,
    /// `EPSG:n`, a PROJ string or WKT.
    #[serde(default)]
    pub crs: Option<String>,
    /// West, south, east, north in map units.
    #[serde(default)]
    pub extent: Option<[f64; 4]>,
    /// The sample that stands for no data.
    #[serde(default)]
    pub nodata: Option<f64>,
    /// The body.
    #[serde(default)]
    pub body: Option<String>,
    /// What latitudes mean.
    #[serde(default)]
    pub latitudes: Option<LatitudeKind>,
}

fn native() -> String {
    GRIDS[0].0.to_owned()
}

fn spline() -> String {
    Kernel::QuinticSpline.name().to_owned()
}

fn page_size() -> u32 {
    512
}

fn memory_mib() -> u64 {
    512
}

/// Threads of an ingest, at most.
const MOST_THREADS: usize = 1024;

const GRIDS: [(&str, TargetGrid); 5] = [
    ("native", TargetGrid::One(TargetMap::Native)),
    ("equirectangular", TargetGrid::One(TargetMap::Equirectangular)),
    ("polar-north", TargetGrid::One(TargetMap::Polar(Pole::North))),
    ("polar-south", TargetGrid::One(TargetMap::Polar(Pole::South))),
    ("split", TargetGrid::Split),
];

const KERNELS: [Kernel; 8] = [
    Kernel::Nearest,
    Kernel::Bilinear,
    Kernel::Cubic,
    Kernel::PlainLanczos,
    Kernel::Lanczos,
    Kernel::CubicSpline,
    Kernel::QuinticSpline,
    Kernel::Average,
];

impl InsertRequest {
    /// What asks another process for the ingest `request`.
    #[must_use]
    pub fn new(request: &Request, lifetime: Lifetime) -> Self {
        let grid = GRIDS.iter().find(|(_, grid)| *grid == request.grid);
        let reading = &request.reading;
        Self {
            rasters: request.rasters.clone(),
            temporary: lifetime == Lifetime::Temporary,
            name: request.name.clone(),
            kind: request.kind,
            step_m: request.step_m,
            grid: grid.map_or_else(native, |(name, _)| (*name).to_owned()),
            pixel_size_m: request.pixel_size.map(|size| size.0),
            kernel: request.kernel.name().to_owned(),
            limit_range: request.limit == RangeLimit::Taps,
            mip: request.mip,
            page_size: request.page_side,
            priority: request.priority,
            threads: request.threads,
            force: request.existing == Existing::Replace,
            memory_mib: request.memory_bytes >> 20,
            crs: reading.crs.clone(),
            extent: reading.extent,
            nodata: reading.nodata,
            body: reading.body.clone(),
            latitudes: reading.latitudes,
        }
    }

    /// How long the dataset is to live.
    #[must_use]
    pub fn lifetime(&self) -> Lifetime {
        if self.temporary { Lifetime::Temporary } else { Lifetime::Kept }
    }

    /// The ingest into `catalog`.
    ///
    /// # Errors
    ///
    /// What makes no sense, in words.
    pub fn request(self, catalog: PathBuf) -> Result<Request, String> {
        if self.rasters.is_empty() {
            return Err("there is no raster to insert".to_owned());
        }
        self.name.as_deref().map_or(Ok(()), check_name).map_err(|error| error.to_string())?;
        let grid = GRIDS.iter().find(|(name, _)| *name == self.grid);
        let (_, grid) = *grid.ok_or_else(|| format!("no grid is called {:?}", self.grid))?;
        let kernel = KERNELS.into_iter().find(|kernel| kernel.name() == self.kernel);
        let kernel = kernel.ok_or_else(|| format!("no kernel is called {:?}", self.kernel))?;
        if !Pyramid::is_page_side(self.page_size) {
            return Err("page_size is an even number from 8 to 4096".to_owned());
        }
        if self.step_m.is_some_and(|step| Quantum::new(step, 0.0).is_err()) {
            return Err("step_m is 0, or 1e-30 to 1e28".to_owned());
        }
        if self.pixel_size_m.is_some_and(|size| !(size > 0.0 && size.is_finite())) {
            return Err("pixel_size_m is a positive number".to_owned());
        }
        if self.threads.is_some_and(|threads| !(1..=MOST_THREADS).contains(&threads)) {
            return Err(format!("threads is a number from 1 to {MOST_THREADS}"));
        }
        Ok(Request {
            rasters: self.rasters,
            catalog,
            name: self.name,
            kind: self.kind,
            step_m: self.step_m,
            grid,
            pixel_size: self.pixel_size_m.map(Meters),
            kernel,
            limit: if self.limit_range { RangeLimit::Taps } else { RangeLimit::None },
            mip: self.mip,
            page_side: self.page_size,
            priority: self.priority,
            threads: self.threads,
            existing: if self.force { Existing::Replace } else { Existing::Keep },
            unfinished: Unfinished::Discard,
            memory_bytes: self.memory_mib.saturating_mul(1 << 20),
            note_every: Duration::from_secs(3600),
            reading: Reading {
                crs: self.crs,
                extent: self.extent,
                nodata: self.nodata,
                body: self.body,
                latitudes: self.latitudes,
                within: None,
            },
        })
    }
}
