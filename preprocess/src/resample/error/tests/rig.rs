//! Rasters in memory, drawn by chance, and archives made of them.

use std::sync::Arc;
use std::time::Duration;

use areoid_formats::archive::{self, Archive, Description};
use areoid_formats::body::Body;
use areoid_formats::codec::Quantum;
use areoid_formats::grid::Grid;
use areoid_formats::projection::{Crs, PolarScale, PolarStereographic, Pole, Projection};
use areoid_formats::units::{Meters, Radians};
use proptest::prelude::*;

use super::super::*;
use crate::build::{Means, Proceed, build};
use crate::build_error::BuildError;
use crate::mosaic::Layout;
use crate::raster::{Block, Outline, Raster, RasterInfo, SampleType, Samples};
use crate::resample::kernel::{Kernel, RangeLimit};
use crate::resample::target::{TargetMap, TargetRequest, target_grid};
use crate::resample::transform::Precision;
use crate::resample::{Resampler, Resampling, Texels};
use crate::scratch::Scratch;

/// Samples in memory, the bands of a pixel side by side, in blocks of 20 × 14 pixels.
#[derive(Debug)]
pub(super) struct InMemory {
    info: RasterInfo,
    samples: Vec<f32>,
}

impl Raster for InMemory {
    fn info(&self) -> &RasterInfo {
        &self.info
    }

    fn read_block(&self, block_col: u32, block_row: u32) -> Result<Block, RasterError> {
        let info = &self.info;
        let [col, row, width, height] = info.block_window(block_col, block_row).unwrap();
        let bands = info.samples_per_pixel();
        let line = |row: u32| {
            let first = (row * info.width + col) as usize * bands;
            self.samples[first..first + width as usize * bands].iter().copied()
        };
        let samples = (row..row + height).flat_map(line);
        let samples = match info.sample {
            SampleType::U8 => Samples::U8(samples.map(|sample| sample as u8).collect()),
            SampleType::I16 => Samples::I16(samples.map(|sample| sample as i16).collect()),
            _ => Samples::F32(samples.collect()),
        };
        Ok(Block { col, row, width, height, samples })
    }

    fn check_unchanged(&self) -> Result<(), RasterError> {
        Ok(())
    }
}

/// What is drawn of a raster.
#[derive(Clone, Copy, Debug)]
pub(super) enum Map {
    /// All of the body, rows on the poles or half a row from them.
    Globe { posts: bool },
    /// Columns and rows of a globe four times as large, from here on.
    Region { from: [u32; 2] },
    /// The pole at this place.
    Polar { pole: Pole, at: [f64; 2] },
}

#[derive(Clone, Copy, Debug)]
pub(super) enum Values {
    Whole,
    Floats { step: f64 },
    Colors,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Case {
    pub(super) map: Map,
    pub(super) size: u32,
    pub(super) values: Values,
    /// Of 64 squares, so many have no data.
    pub(super) holes: u64,
    pub(super) seed: u64,
    pub(super) target: TargetMap,
    /// Of the raster's pixels' sizes.
    pub(super) scale: f64,
    pub(super) kernel: Kernel,
    pub(super) limit: RangeLimit,
}

pub(super) fn cases() -> impl Strategy<Value = Case> {
    let pole = prop::sample::select(vec![Pole::North, Pole::South]);
    let map = prop_oneof![
        any::<bool>().prop_map(|posts| Map::Globe { posts }),
        [0..200_u32, 0..60_u32].prop_map(|from| Map::Region { from }),
        (pole.clone(), [-0.5..1.5, -0.5..1.5_f64]).prop_map(|(pole, at)| Map::Polar { pole, at }),
    ];
    let values = prop_oneof![
        Just(Values::Whole),
        Just(Values::Floats { step: 0.0 }),
        Just(Values::Floats { step: 0.5 }),
        Just(Values::Colors)
    ];
    let target = prop_oneof![
        Just(TargetMap::Native),
        Just(TargetMap::Equirectangular),
        pole.prop_map(TargetMap::Polar)
    ];
    let kernel = prop::sample::select(vec![
        Kernel::Nearest,
        Kernel::Bilinear,
        Kernel::Cubic,
        Kernel::Lanczos,
        Kernel::QuinticSpline,
        Kernel::Average,
    ]);
    let limit = prop::sample::select(vec![RangeLimit::None, RangeLimit::Taps]);
    let holes = prop_oneof![Just(0_u64), 1..40_u64];
    (map, 9..60_u32, values, holes, any::<u64>(), target, 0.4..4.0, (kernel, limit)).prop_map(
        |(map, size, values, holes, seed, target, scale, (kernel, limit))| Case {
            map,
            size,
            values,
            holes,
            seed,
            target,
            scale,
            kernel,
            limit,
        },
    )
}

/// `SplitMix64`'s mixing of a number.
pub(super) fn mixed(number: u64) -> u64 {
    let z = (number ^ (number >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl Case {
    fn texels(&self) -> Texels {
        if self.seed.is_multiple_of(2) { Texels::Sampled } else { Texels::Fitted }
    }

    pub(super) fn layout(&self) -> Layout {
        self.layout_with(|_, _| false)
    }

    /// With holes in more pixels, by row and column.
    pub(super) fn layout_with(&self, is_also_hole: impl Fn(u32, u32) -> bool) -> Layout {
        let body = Body::parse("moon").unwrap().ellipsoid;
        let height = self.size;
        let degrees = 180.0 / f64::from(height);
        let geographic = Crs::new(Projection::Geographic, body);
        let (crs, origin, pixel_size, width, height) = match self.map {
            Map::Globe { posts: false } => {
                (geographic, [-180.0, 90.0], [degrees; 2], 2 * height, height)
            }
            Map::Globe { posts: true } => {
                (geographic, [0.0, 90.0 + degrees / 2.0], [degrees; 2], 2 * height, height + 1)
            }
            Map::Region { from: [col, row] } => {
                let degrees = degrees / 4.0;
                let row = row.min(3 * height);
                let origin = [f64::from(col) * degrees - 90.0, 90.0 - f64::from(row) * degrees];
                (geographic, origin, [degrees; 2], height + 3, height)
            }
            Map::Polar { pole, at } => {
                let map = PolarStereographic {
                    pole,
                    central_meridian: Radians(0.4),
                    scale: PolarScale::AtPole(1.0),
                    false_easting: Meters(0.0),
                    false_northing: Meters(0.0),
                };
                let crs = Crs::new(Projection::PolarStereographic(map), body);
                let pixel = 3e6 / f64::from(height);
                let [x, y] = at.map(|at| at * f64::from(height) * pixel);
                (crs, [-x, y], [pixel; 2], height + 1, height)
            }
        };
        let (sample, bands) = match self.values {
            Values::Whole => (SampleType::I16, 1),
            Values::Floats { .. } => (SampleType::F32, 1),
            Values::Colors => (SampleType::U8, 3),
        };
        let has_alpha = bands == 3;
        let sample_at = |row: u32, col: u32, band: u64| {
            let pixel = u64::from(row) << 32 | u64::from(col) << 2 | band;
            let noise = mixed(self.seed ^ pixel.wrapping_mul(0x9e37_79b9_7f4a_7c15)) >> 40;
            let wave = (f64::from(row) * 0.3).sin() + (f64::from(col) * 0.2).cos();
            (noise as f64 / f64::from(1 << 24), wave)
        };
        let is_hole = |row: u32, col: u32| {
            let square = u64::from(row / 7) << 20 | u64::from(col / 5);
            mixed(self.seed.wrapping_add(square)) % 64 < self.holes
        };
        let mut samples = Vec::new();
        for (row, col) in (0..height).flat_map(|row| (0..width).map(move |col| (row, col))) {
            let hole = is_hole(row, col) || is_also_hole(row, col);
            match self.values {
                Values::Colors => {
                    let code = |band| (sample_at(row, col, band).0 * 255.0).round() as f32;
                    samples.extend([0, 1, 2].map(code));
                    samples.push(if hole { 0.0 } else { 255.0 });
                }
                _ if hole => samples.push(-9999.0),
                _ => {
                    let (noise, wave) = sample_at(row, col, 0);
                    samples.push((noise * 300.0 + wave * 900.0).round() as f32);
                }
            }
        }
        let info = RasterInfo {
            path: "memory.tif".into(),
            width,
            height,
            bands,
            has_alpha,
            sample,
            crs: Some(crs),
            outline: Outline { origin, pixel_size },
            point_registered: false,
            nodata: (!has_alpha).then_some(-9999.0),
            scale: 1.0,
            offset: 0.0,
            block_width: 20,
            block_height: 14,
        };
        Layout::new(vec![Arc::new(InMemory { info, samples })], crs).unwrap()
    }

    pub(super) fn kind(&self) -> Kind {
        if matches!(self.values, Values::Colors) { Kind::Color } else { Kind::Height }
    }

    pub(super) fn resampler(&self, layout: Layout) -> Option<Resampler> {
        let placement = layout.placement().unwrap();
        let pixel_size = Some(Meters(placement.nominal_pixel().0 * self.scale));
        let request = TargetRequest { map: self.target, pixel_size, page_side: 34 };
        let grid = target_grid(&[placement], request).ok()?;
        let precision = Precision::default();
        let resampling =
            Resampling { kernel: self.kernel, limit: self.limit, precision, texels: self.texels() };
        Some(Resampler::new(grid, layout, placement, self.kind(), resampling).unwrap())
    }

    pub(super) fn description(&self, grid: &Grid) -> Description {
        let quantum = match self.values {
            Values::Whole => Quantum::new(1.0, 0.0).unwrap(),
            Values::Floats { step } if step > 0.0 => Quantum::new(step, 0.0).unwrap(),
            _ => Quantum::NONE,
        };
        Description {
            dataset: "made-up".to_owned(),
            kind: self.kind(),
            body: Body::parse("moon").unwrap(),
            grid: grid.clone(),
            quantum,
            priority: 0,
            feather_texels: 32,
            unit_pages: 2,
            source: archive::Source::default(),
            resampling: Some(archive::Resampling {
                kernel: self.kernel.name().to_owned(),
                range_limited: self.limit == RangeLimit::Taps,
                fitted: self.texels() == Texels::Fitted,
            }),
            mip: archive::MipRule::Mean,
        }
    }
}

/// The archive of leaves; `None` if nothing is valid.
pub(super) fn built(description: &Description, leaves: &Resampler) -> Option<Archive> {
    let scratch = Scratch::new(tempfile::tempfile().unwrap(), &[]).unwrap();
    let means = Means {
        scratch: Arc::new(scratch),
        frontier_bytes: 1 << 30,
        pages_together: 8,
        note_every: Duration::from_secs(3600),
    };
    match build(description, leaves, Vec::new(), &means, None, |_| Proceed::Yes) {
        Ok((bytes, _)) => Some(Archive::open(Box::new(bytes)).unwrap()),
        Err(BuildError::NoData) => None,
        Err(error) => panic!("{error}"),
    }
}

/// Pixels with data, column and row first.
pub(super) fn pixels(layout: &Layout) -> Vec<([u32; 2], [f64; 3])> {
    let raster = &layout.parts()[0].raster;
    let (info, (across, down)) = (raster.info(), raster.info().blocks());
    let mut found = Vec::new();
    for (col, row) in (0..down).flat_map(|row| (0..across).map(move |col| (col, row))) {
        let block = raster.read_block(col, row).unwrap();
        let samples: Vec<f64> = match &block.samples {
            Samples::U8(samples) => samples.iter().map(|&sample| sample.into()).collect(),
            Samples::I16(samples) => samples.iter().map(|&sample| sample.into()).collect(),
            Samples::F32(samples) => samples.iter().map(|&sample| sample.into()).collect(),
            _ => panic!("no such samples"),
        };
        for (at, pixel) in samples.chunks_exact(info.samples_per_pixel()).enumerate() {
            let place = [block.col + at as u32 % block.width, block.row + at as u32 / block.width];
            match *pixel {
                [height] if height != -9999.0 => found.push((place, [height, 0.0, 0.0])),
                [red, green, blue, 255.0] => found.push((place, [red, green, blue])),
                _ => {}
            }
        }
    }
    found
}
