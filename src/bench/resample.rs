//! Resampling alone: from a raster to a headerless file of the samples of another map.

use std::fs;
use std::path::PathBuf;
use std::process::ExitCode;

use areoid_formats::address::PageAddress;
use areoid_formats::body::Ellipsoid;
use areoid_formats::grid::Grid;
use areoid_formats::page::Kind;
use areoid_formats::projection::{Crs, PolarScale, PolarStereographic, Pole, Projection};
use areoid_formats::pyramid::{Extent, PoleContact};
use areoid_formats::units::{Meters, Radians};
use areoid_preprocess::build::Leaves as _;
use areoid_preprocess::feather::HALO;
use areoid_preprocess::ingest::{self, Reading, UNIT_PAGES};
use areoid_preprocess::mosaic::Layout;
use areoid_preprocess::raster::RasterError;
use areoid_preprocess::resample::kernel::{Kernel, RangeLimit};
use areoid_preprocess::resample::transform::Precision;
use areoid_preprocess::resample::{Resampler, Resampling, Texels};
use areoid_preprocess::schedule::Schedule;
use areoid_preprocess::texel::Planes;
use areoid_preprocess::tile::Raw;
use rayon::prelude::*;

use super::geotiff::{MARS_RADIUS_M, Place};
use super::terrain::MISSING;
use crate::failure::Failure;
use crate::ingest_options::KernelArg;
use crate::output;

/// Resample a raster of heights, on all cores.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    raster: PathBuf,

    /// The file, of 16-bit numbers from whole meters and of floating-point numbers from others.
    #[arg(short, long)]
    output: PathBuf,

    /// Columns.
    #[arg(long)]
    width: u32,

    /// Rows.
    #[arg(long)]
    height: u32,

    /// Pixels from the north pole to the equator [default: a map of straight meridians].
    #[arg(long)]
    radius_px: Option<u32>,

    #[arg(long, value_enum)]
    kernel: KernelArg,

    /// The degree of the spline kernel.
    #[arg(long, default_value_t = 5)]
    spline_degree: u8,

    /// Weights of Lanczos as others have them, not exact for ramps.
    #[arg(long)]
    plain: bool,

    /// Every place through the body, one by one.
    #[arg(long)]
    exact: bool,
}

impl Args {
    pub(super) fn run(self) -> Result<ExitCode, Failure> {
        let grid = self.grid()?;
        let reading = Reading::default();
        let (rasters, crs, _) = ingest::open(&[self.raster], &reading, None)?;
        let layout = Layout::new(rasters, crs)?;
        let placement = layout.placement()?;
        let kernel = match self.kernel.kernel(self.spline_degree) {
            Kernel::Lanczos if self.plain => Kernel::PlainLanczos,
            kernel => kernel,
        };
        let resampling = Resampling {
            kernel,
            limit: RangeLimit::None,
            precision: if self.exact { Precision::Exact } else { Precision::default() },
            texels: Texels::Sampled,
        };
        let resampler = Resampler::new(grid.clone(), layout, placement, Kind::Height, resampling)?;
        let pyramid = grid.pyramid();
        let width = pyramid.extent().width as usize;
        let bytes = if resampler.is_whole() { 2 } else { 4 };
        let pixels = width * pyramid.extent().height as usize;
        let mut samples = match bytes {
            2 => MISSING.to_le_bytes().repeat(pixels),
            _ => f32::NAN.to_le_bytes().repeat(pixels),
        };
        for step in Schedule::new(pyramid, UNIT_PAGES, HALO, 0) {
            let read = |&page: &PageAddress| Ok((page, resampler.read(page)?));
            let leaves: Result<Vec<(PageAddress, Option<Raw>)>, RasterError> =
                step.read.par_iter().map(read).collect();
            for (page, raw) in leaves? {
                // Nothing is held against the pixels here.
                resampler.source_error(page, None)?;
                let Some(raw) = raw else { continue };
                let (rows, cols) = pyramid.interior_size(page);
                let [top, left] = [page.row, page.col].map(|at| (at * pyramid.interior()) as usize);
                let side = pyramid.page_side() as usize;
                for row in 0..rows as usize {
                    let from = (row + 1) * side + 1;
                    let to = ((top + row) * width + left) * bytes;
                    let out = &mut samples[to..to + cols as usize * bytes];
                    lay(&raw, from, out);
                }
            }
        }
        fs::write(&self.output, samples)?;
        let (made, tiles) = resampler.prepared_tiles();
        output::line(format_args!("{made} of {tiles} tiles prepared"))?;
        Ok(ExitCode::SUCCESS)
    }

    fn place(&self) -> Place {
        match self.radius_px {
            Some(radius_px) => Place::North { radius_px },
            None => Place::Half,
        }
    }

    fn grid(&self) -> Result<Grid, Failure> {
        let sphere = Ellipsoid::sphere(Meters(MARS_RADIUS_M)).map_err(|e| e.to_string());
        let sphere = sphere.map_err(Failure::Misused)?;
        let [left, top, pixel_x, pixel_y] =
            self.place().corner_and_pixel((self.width, self.height));
        let (projection, wraps, north) = match self.place() {
            Place::North { .. } => {
                let map = PolarStereographic {
                    pole: Pole::North,
                    central_meridian: Radians(0.0),
                    scale: PolarScale::AtPole(1.0),
                    false_easting: Meters(0.0),
                    false_northing: Meters(0.0),
                };
                (Projection::PolarStereographic(map), false, PoleContact::None)
            }
            Place::Globe | Place::Half => (Projection::Geographic, true, PoleContact::Outline),
        };
        let south = PoleContact::None;
        let extent = Extent { width: self.width, height: self.height, wraps, north, south };
        let crs = Crs::new(projection, sphere);
        let grid = Grid::new(crs, [left, top], [pixel_x, pixel_y], extent, 512);
        grid.map_err(|error| Failure::Misused(error.to_string()))
    }
}

/// Lays a part of a row of a leaf, which begins at texel `from`.
fn lay(raw: &Raw, from: usize, out: &mut [u8]) {
    let valid = |at: usize| raw.alpha.as_ref().is_none_or(|alpha| alpha[at] != 0);
    match &raw.planes {
        Planes::WholeHeight(heights) => {
            for (at, sample) in (from..).zip(out.chunks_exact_mut(2)) {
                let height = if valid(at) { heights[at] } else { MISSING };
                sample.copy_from_slice(&height.to_le_bytes());
            }
        }
        Planes::Height(heights) => {
            for (&height, sample) in heights[from..].iter().zip(out.chunks_exact_mut(4)) {
                sample.copy_from_slice(&height.to_le_bytes());
            }
        }
        Planes::Color(_) => {}
    }
}
