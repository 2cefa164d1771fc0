#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the rasters drawn are small, and their values are chosen"
)]

use std::sync::Arc;
use std::time::Duration;

use areoid_formats::archive::{self, Archive, Description};
use areoid_formats::body::Body;
use areoid_formats::codec::Quantum;
use areoid_formats::grid::{Grid, Placement};
use areoid_formats::page::Page;
use areoid_formats::projection::{Crs, MapPoint, PolarScale, PolarStereographic, Pole, Projection};
use areoid_formats::units::{Meters, Radians};
use proptest::prelude::*;

use super::*;
use crate::build::{Leaves as _, Means, Proceed, build};
use crate::build_error::BuildError;
use crate::mosaic::Layout;
use crate::raster::{Block, Outline, Raster, RasterInfo, SampleType, Samples};
use crate::resample::kernel::{Kernel, RangeLimit};
use crate::resample::target::{TargetMap, TargetRequest, target_grid};
use crate::resample::transform::Precision;
use crate::resample::truth::SourcePixels;
use crate::resample::{Resampler, Resampling};
use crate::scratch::Scratch;
use crate::verify::verify;

/// Samples in memory, the bands of a pixel side by side, in blocks of 20 × 14 pixels.
#[derive(Debug)]
struct InMemory {
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
enum Map {
    /// All of the body, rows on the poles or half a row from them.
    Globe { posts: bool },
    /// Columns and rows of a globe four times as large, from here on.
    Region { from: [u32; 2] },
    /// The pole at this place.
    Polar { pole: Pole, at: [f64; 2] },
}

#[derive(Clone, Copy, Debug)]
enum Values {
    Whole,
    Floats { step: f64 },
    Colors,
}

#[derive(Clone, Copy, Debug)]
struct Case {
    map: Map,
    size: u32,
    values: Values,
    /// Of 64 squares, so many have no data.
    holes: u64,
    seed: u64,
    target: TargetMap,
    /// Of the raster's pixels' sizes.
    scale: f64,
    kernel: Kernel,
    limit: RangeLimit,
}

fn cases() -> impl Strategy<Value = Case> {
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
fn mixed(number: u64) -> u64 {
    let z = (number ^ (number >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl Case {
    fn layout(&self) -> Layout {
        self.layout_with(|_, _| false)
    }

    /// With holes in more pixels, by row and column.
    fn layout_with(&self, is_also_hole: impl Fn(u32, u32) -> bool) -> Layout {
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

    fn kind(&self) -> Kind {
        if matches!(self.values, Values::Colors) { Kind::Color } else { Kind::Height }
    }

    fn resampler(&self, layout: Layout) -> Option<Resampler> {
        let placement = layout.placement().unwrap();
        let pixel_size = Some(Meters(placement.nominal_pixel().0 * self.scale));
        let request = TargetRequest { map: self.target, pixel_size, page_side: 34 };
        let grid = target_grid(&[placement], request).ok()?;
        let precision = Precision::default();
        let resampling = Resampling { kernel: self.kernel, limit: self.limit, precision };
        Some(Resampler::new(grid, layout, placement, self.kind(), resampling).unwrap())
    }

    fn description(&self, grid: &Grid) -> Description {
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
            }),
            mip: archive::MipRule::Mean,
        }
    }
}

/// The archive of leaves; `None` if nothing is valid.
fn built(description: &Description, leaves: &Resampler) -> Option<Archive> {
    let scratch = Scratch::new(tempfile::tempfile().unwrap(), &[]).unwrap();
    let (scratch, frontier_bytes) = (Arc::new(scratch), 1 << 30);
    let means = Means { scratch, frontier_bytes, note_every: Duration::from_secs(3600) };
    match build(description, leaves, Vec::new(), &means, None, |_| Proceed::Yes) {
        Ok((bytes, _)) => Some(Archive::open(Box::new(bytes)).unwrap()),
        Err(BuildError::NoData) => None,
        Err(error) => panic!("{error}"),
    }
}

/// Pixels with data, column and row first.
fn pixels(layout: &Layout) -> Vec<([u32; 2], [f64; 3])> {
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

/// By brute force: the largest error of a leaf over pixels no farther outside its interior than
/// `beside`, at places where taps without data weigh no more than `missing`.
fn brute_force(
    grid: &Grid,
    source: &Placement,
    pixels: &[([u32; 2], [f64; 3])],
    (leaf, page): (PageAddress, &Page),
    (beside, missing): (f64, f64),
) -> f64 {
    let pyramid = grid.pyramid();
    let (rows, cols) = pyramid.interior_size(leaf);
    let width = f64::from(pyramid.extent().width);
    let mut largest = 0.0_f64;
    for &([col, row], value) in pixels {
        if col >= source.width {
            continue;
        }
        let shown = source.map_from_pixel(f64::from(col), f64::from(row));
        // A post on a pole may lie past it by rounding.
        let inward = MapPoint { y: shown.y * (1.0 - 1e-12), ..shown };
        let position = source.crs.unproject(shown).or_else(|| source.crs.unproject(inward));
        let Some(position) = position else { continue };
        let Some(shown) = grid.crs().project(position) else { continue };
        let place = grid.texel_from_map(pyramid.finest(), shown);
        let turns = if pyramid.extent().wraps { vec![-width, 0.0, width] } else { vec![0.0] };
        for turn in turns {
            let x = place.x + turn - f64::from(leaf.col * pyramid.interior());
            let y = place.y - f64::from(leaf.row * pyramid.interior());
            let within =
                |at: f64, length: u32| (-beside..=f64::from(length) + beside).contains(&at);
            if !within(x, cols) || !within(y, rows) {
                continue;
            }
            let Some(found) = page.reconstruct(x + 1.0, y + 1.0) else { continue };
            if found.valid_weight >= 1.0 - missing {
                let off = found.value.iter().zip(value).map(|(one, other)| (one - other).abs());
                largest = off.fold(largest, f64::max);
            }
        }
    }
    largest
}

fn check(case: Case) -> Result<(), TestCaseError> {
    let layout = case.layout();
    let placement = layout.placement().unwrap();
    let Some(resampler) = case.resampler(layout.clone()) else { return Ok(()) };
    let grid = resampler.plan.grid.clone();
    let gone_on_with = case.resampler(layout.clone()).expect("as before");
    for (at, leaf) in crate::resample::leaves(&grid).enumerate() {
        if at % 3 == 0 {
            gone_on_with.skip(leaf);
        } else {
            gone_on_with.read(leaf).unwrap();
        }
        prop_assert_eq!(gone_on_with.source_error(leaf, None).unwrap(), None);
    }
    prop_assert!(gone_on_with.rasters.decoded_blocks() <= resampler.rasters.blocks());
    prop_assert_eq!(gone_on_with.rasters.resident_bytes(), 0, "blocks of leaves that are done");

    let archive = built(&case.description(&grid), &resampler);
    prop_assert!(resampler.rasters.decoded_blocks() <= resampler.rasters.blocks());
    prop_assert_eq!(resampler.rasters.resident_bytes(), 0, "blocks that nobody waits for");
    let Some(archive) = archive else { return Ok(()) };

    let truth = SourcePixels::new(grid.clone(), &layout, placement, case.kind()).unwrap();
    let report = verify(&archive, Some(&truth)).unwrap();
    prop_assert!(report.problems.is_empty(), "{:?}", report.problems);

    let pixels = pixels(&layout);
    let mut measured = 0.0_f64;
    for entry in archive.entries().unwrap() {
        if entry.page.level != grid.pyramid().finest() {
            continue;
        }
        let page = archive.page(&entry).unwrap();
        let against = |limits| brute_force(&grid, &placement, &pixels, (entry.page, &page), limits);
        let (stated, bound) = (f64::from(entry.source_error), f64::from(entry.bound));
        let exact = against((0.0, 1e-9));
        measured = measured.max(exact);
        prop_assert!(
            exact <= stated + bound + 1e-9,
            "{} is off by {exact}, says {stated}",
            entry.page
        );
        // What is on the edge may count or not, and places have their own error.
        let most = against((2.0 / 1024.0, 1.0 / 32768.0));
        let relief = 1e-5 * 3000.0;
        prop_assert!(
            stated <= most * 1.0001 + bound + relief,
            "{} is off by {most} at most, says {stated}",
            entry.page
        );
    }
    let finest = report.levels.last().unwrap();
    prop_assert!((finest.measured_max - measured).abs() <= 1e-9 * measured + 1e-9);
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    /// In both directions, about poles and the antimeridian, finer and coarser, with holes.
    #[test]
    fn leaves_say_how_far_they_are_from_their_pixels(case in cases()) {
        check(case)?;
    }
}

/// A raster of so many prepared tiles that leaves far from one another share none, and its leaves.
fn of_many_tiles() -> (Case, Layout) {
    let case = Case {
        map: Map::Polar { pole: Pole::North, at: [0.3, 0.6] },
        size: 3 * crate::resample::prepare::PREPARED + 40,
        values: Values::Whole,
        holes: 3,
        seed: 1,
        target: TargetMap::Equirectangular,
        scale: 6.0,
        kernel: Kernel::Cubic,
        limit: RangeLimit::Taps,
    };
    (case, case.layout())
}

#[test]
fn no_block_of_a_large_raster_waits_when_all_leaves_are_done() {
    let (case, layout) = of_many_tiles();
    // What a build that was interrupted has done already comes in squares.
    for is_skipped in [|_, _| false, |row, col| row < 4 && col < 9, |row, col| row / 3 == col / 3] {
        let resampler = case.resampler(layout.clone()).unwrap();
        let grid = resampler.plan.grid.clone();
        assert!(resampler.prepared.tiles() >= (4, 4));
        let leaves: Vec<PageAddress> = crate::resample::leaves(&grid).collect();
        for &leaf in &leaves {
            if is_skipped(leaf.row, leaf.col) {
                resampler.skip(leaf);
            } else {
                resampler.read(leaf).unwrap();
            }
        }
        assert!(
            resampler.rasters.resident_bytes() > 0,
            "blocks wait for what is held against them"
        );
        for &leaf in &leaves {
            resampler.source_error(leaf, None).unwrap();
        }
        assert_eq!(resampler.rasters.resident_bytes(), 0);
        let (decoded, blocks) = (resampler.rasters.decoded_blocks(), resampler.rasters.blocks());
        assert!(decoded <= blocks, "{decoded} of {blocks}, tiles {:?}", resampler.prepared_tiles());
    }
}

#[test]
fn nothing_waits_for_leaves_that_are_held_against_nothing() {
    let (case, layout) = of_many_tiles();
    let resampler = case.resampler(layout).unwrap().unmeasured();
    let leaves: Vec<PageAddress> = crate::resample::leaves(&resampler.plan.grid).collect();
    for &leaf in &leaves {
        resampler.read(leaf).unwrap();
    }
    assert_eq!(resampler.rasters.resident_bytes(), 0);
    assert!(resampler.rasters.decoded_blocks() > 0);
    for &leaf in &leaves {
        assert_eq!(resampler.source_error(leaf, None).unwrap(), None);
    }
}

/// An archive that lost leaves, or has heights of its own, is like that of another raster: one with a
/// wide hole, or without.
#[test]
fn an_archive_has_data_where_its_pixels_do() {
    for kernel in [Kernel::Bilinear, Kernel::Average, Kernel::QuinticSpline] {
        for (map, target, scale) in [
            (Map::Polar { pole: Pole::North, at: [0.5, 0.5] }, TargetMap::Equirectangular, 1.1),
            (Map::Globe { posts: false }, TargetMap::Polar(Pole::North), 1.1),
            (Map::Polar { pole: Pole::North, at: [0.5, 0.5] }, TargetMap::Equirectangular, 6.0),
        ] {
            let (case, _) = of_many_tiles();
            let case = Case { map, size: 400, holes: 0, target, scale, kernel, ..case };
            let hole = |row: u32, col: u32| (60..160).contains(&row) && (100..300).contains(&col);
            let (solid, with_hole) = (case.layout(), case.layout_with(hole));
            let placement = solid.placement().unwrap();
            let resampled = [&solid, &with_hole].map(|layout| {
                let resampler = case.resampler(layout.clone()).unwrap();
                let grid = resampler.plan.grid.clone();
                built(&case.description(&grid), &resampler).unwrap()
            });
            for (made, against) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                // Blocks are announced for one check each.
                let (archive, layout) = (&resampled[made], [&solid, &with_hole][against]);
                let grid = archive.description().grid.clone();
                let truth = SourcePixels::new(grid, layout, placement, case.kind()).unwrap();
                let report = verify(archive, Some(&truth)).unwrap();
                let breaches = report.problems.iter().filter(|problem| problem.contains("no data"));
                let breaches = breaches.count();
                // Some leaves lie in the hole as a whole, and some beside it.
                let expected = if made == against { 0..1 } else { 1..1000 };
                assert!(expected.contains(&breaches), "{case:?}: {breaches}");
            }
        }
    }
}
