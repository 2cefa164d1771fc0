//! What to ingest, and how, as arguments say it: for `areoid ingest` and `areoid insert`.

use std::path::PathBuf;
use std::time::Duration;

use areoid_formats::archive::MipRule;
use areoid_formats::codec::Quantum;
use areoid_formats::geodesy::LatitudeKind;
use areoid_formats::page::Kind;
use areoid_formats::projection::Pole;
use areoid_formats::pyramid::Pyramid;
use areoid_formats::units::Meters;
use areoid_preprocess::ingest::{Existing, Reading, Request, TargetGrid, Unfinished};
use areoid_preprocess::resample::kernel::{Kernel, RangeLimit};
use areoid_preprocess::resample::target::TargetMap;

use crate::args::numbers;
use crate::failure::Failure;
use crate::output;

/// What to ingest, and how: the same for a catalog and for a server.
#[derive(Debug, clap::Args)]
pub(crate) struct IngestOptions {
    /// Rasters: `GeoTIFF` or `BigTIFF`; JPEG or PNG with a world file.
    #[arg(required = true, value_name = "RASTER")]
    rasters: Vec<PathBuf>,

    /// The dataset's name [default: the stem of the first raster, with .normal behind it for normals].
    #[arg(long)]
    name: Option<String>,

    /// What the dataset shows: the samples as heights or as colors, or the normals of the ground whose
    /// heights they are [default: height for one band, color for three or four].
    #[arg(long, value_enum)]
    kind: Option<KindArg>,

    /// The body: mercury, venus, earth, moon, mars, mars-ellipsoid, or its radii in meters
    /// [default: what the raster says].
    #[arg(long, value_name = "NAME|A,B")]
    body: Option<String>,

    /// The grid of the dataset: the rasters' own, or one they are resampled to. A whole globe can be
    /// split into three datasets that are named, replaced and removed as one: NAME.band on its own
    /// grid, and about the poles NAME.north and NAME.south, where all meridians crowd on its own.
    #[arg(long, value_enum, default_value = "native")]
    grid: GridArg,

    /// Store heights on a step of so many meters, within the bound; 0 is lossless [default: the
    /// raster's own quantum].
    #[arg(long, allow_hyphen_values = true, value_name = "METERS", value_parser = step)]
    step_m: Option<f64>,

    /// Texels along a page's side, its border included.
    #[arg(long, value_name = "TEXELS", default_value_t = 512, value_parser = page_side)]
    page_size: u32,

    /// The sample that stands for no data [default: what the raster says].
    #[arg(long, allow_hyphen_values = true, value_name = "VALUE")]
    nodata: Option<f64>,

    /// The coordinate system: EPSG:n, a PROJ string, WKT, or a file that holds one
    /// [default: what the raster says].
    #[arg(long, allow_hyphen_values = true, value_name = "TEXT|FILE")]
    crs: Option<String>,

    /// What the raster's latitudes are [default: planetocentric for a map on a sphere of an
    /// ellipsoidal body, else planetographic].
    #[arg(long, value_enum)]
    latitudes: Option<LatitudesArg>,

    /// Where the raster's outer edges lie, in degrees or meters of its coordinate system
    /// [default: what the raster says].
    #[arg(long, allow_hyphen_values = true, value_name = "W,S,E,N", value_parser = numbers::<4>)]
    extent: Option<[f64; 4]>,

    /// Datasets of higher priority cover those of lower.
    #[arg(long, allow_hyphen_values = true, default_value_t = 0)]
    priority: i32,

    /// How texels between pixels are found on another grid [default: spline]; a raster's own grid
    /// needs none.
    #[arg(long, value_enum, value_name = "KERNEL")]
    kernel: Option<KernelArg>,

    /// The degree of the spline kernel: 3 or 5.
    #[arg(long, value_name = "DEGREE", default_value_t = 5, value_parser = spline_degree)]
    spline_degree: u8,

    /// Keep resampled texels within the range of the pixels around them.
    #[arg(long)]
    limit_range: bool,

    /// Meters to a texel, where the grid's map is truest [default: those of the rasters].
    #[arg(long, value_name = "METERS", value_parser = pixel_size)]
    pixel_size_m: Option<f64>,

    /// How coarser levels are made of finer ones: by the mean of two by two texels, or by a low-pass
    /// over twelve by twelve (Kaiser's window on a sinc), which keeps more of what a level can show and
    /// less of what it cannot. Beside missing texels it is the mean.
    #[arg(long, value_enum, value_name = "RULE", default_value = "mean")]
    mip: MipArg,

    /// Memory to use: what exceeds it waits in a file beside the archive. What a step of the
    /// work takes must fit, which is told where it does not.
    #[arg(long, value_name = "MIB", default_value_t = 2048)]
    memory_mib: u64,

    /// Threads [default: one a core].
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,

    /// Replace a dataset of this name that was made from something else.
    #[arg(long)]
    force: bool,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum KindArg {
    Height,
    Color,
    Normal,
}

#[derive(Clone, Copy, Debug, PartialEq, clap::ValueEnum)]
enum GridArg {
    Native,
    Equirectangular,
    PolarNorth,
    PolarSouth,
    Split,
}

/// A kernel, without the degree of a spline.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum KernelArg {
    Nearest,
    Bilinear,
    Cubic,
    Lanczos,
    Spline,
    Average,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum MipArg {
    Mean,
    Kaiser,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum LatitudesArg {
    Planetographic,
    Planetocentric,
}

impl KernelArg {
    /// The kernel, of degree `spline_degree` if it is a spline: 3, else 5.
    pub(crate) fn kernel(self, spline_degree: u8) -> Kernel {
        match self {
            Self::Nearest => Kernel::Nearest,
            Self::Bilinear => Kernel::Bilinear,
            Self::Cubic => Kernel::Cubic,
            Self::Lanczos => Kernel::Lanczos,
            Self::Spline if spline_degree == 3 => Kernel::CubicSpline,
            Self::Spline => Kernel::QuinticSpline,
            Self::Average => Kernel::Average,
        }
    }
}

impl IngestOptions {
    /// Refuses what makes no sense, and warns of what has no effect.
    pub(crate) fn check(&self) -> Result<(), Failure> {
        if self.grid == GridArg::Split && self.pixel_size_m.is_some() {
            let reason = "--grid split keeps the raster's own pixels: leave out --pixel-size-m";
            return Err(Failure::Misused(reason.to_owned()));
        }
        let own_grid = self.grid == GridArg::Native && self.pixel_size_m.is_none();
        if self.kernel.is_some() && own_grid {
            output::say("warning: --kernel has no effect on the raster's own grid");
        }
        Ok(())
    }

    /// The ingest into `catalog`, which discards what is unfinished.
    pub(crate) fn request(self, catalog: PathBuf) -> Request {
        Request {
            rasters: self.rasters,
            catalog,
            name: self.name,
            kind: self.kind.map(|kind| match kind {
                KindArg::Height => Kind::Height,
                KindArg::Color => Kind::Color,
                KindArg::Normal => Kind::Normal,
            }),
            step_m: self.step_m,
            grid: match self.grid {
                GridArg::Native => TargetGrid::One(TargetMap::Native),
                GridArg::Equirectangular => TargetGrid::One(TargetMap::Equirectangular),
                GridArg::PolarNorth => TargetGrid::One(TargetMap::Polar(Pole::North)),
                GridArg::PolarSouth => TargetGrid::One(TargetMap::Polar(Pole::South)),
                GridArg::Split => TargetGrid::Split,
            },
            pixel_size: self.pixel_size_m.map(Meters),
            kernel: self.kernel.unwrap_or(KernelArg::Spline).kernel(self.spline_degree),
            limit: if self.limit_range { RangeLimit::Taps } else { RangeLimit::None },
            mip: match self.mip {
                MipArg::Mean => MipRule::Mean,
                MipArg::Kaiser => MipRule::Kaiser,
            },
            page_side: self.page_size,
            priority: self.priority,
            threads: self.threads.map(usize::from),
            existing: if self.force { Existing::Replace } else { Existing::Keep },
            unfinished: Unfinished::Discard,
            memory_bytes: self.memory_mib.saturating_mul(1 << 20),
            note_every: Duration::from_secs(15),
            reading: Reading {
                crs: self.crs,
                extent: self.extent,
                nodata: self.nodata,
                body: self.body,
                latitudes: self.latitudes.map(|latitudes| match latitudes {
                    LatitudesArg::Planetographic => LatitudeKind::Planetographic,
                    LatitudesArg::Planetocentric => LatitudeKind::Planetocentric,
                }),
                within: None,
            },
        }
    }
}

/// A step that heights can be stored on, or 0.
fn step(text: &str) -> Result<f64, String> {
    let step: f64 = text.parse().map_err(|error| format!("{error}"))?;
    Quantum::new(step, 0.0).map_err(|_| "expected 0, or 1e-30 to 1e28".to_owned())?;
    Ok(step)
}

/// Texels along a page's side.
fn page_side(text: &str) -> Result<u32, String> {
    let side: u32 = text.parse().map_err(|error| format!("{error}"))?;
    if Pyramid::is_page_side(side) {
        Ok(side)
    } else {
        Err("expected an even number from 8 to 4096".to_owned())
    }
}

/// A degree that there is a spline of.
fn spline_degree(text: &str) -> Result<u8, String> {
    match text {
        "3" => Ok(3),
        "5" => Ok(5),
        _ => Err("expected 3 or 5".to_owned()),
    }
}

/// A positive number of meters.
fn pixel_size(text: &str) -> Result<f64, String> {
    let meters: f64 = text.parse().map_err(|error| format!("{error}"))?;
    let positive = meters > 0.0 && meters.is_finite();
    if positive { Ok(meters) } else { Err("expected a positive number".to_owned()) }
}
