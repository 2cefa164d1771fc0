//! Leaves of another grid, against fields that are known everywhere.

use areoid_formats::body::Body;
use areoid_formats::geodesy::{Geographic, surface_normal};
use areoid_formats::projection::{Crs, MapPoint, PolarScale, PolarStereographic, Pole, Projection};
use areoid_formats::pyramid::Extent;
use areoid_formats::units::{Meters, Radians};

use super::target::{TargetMap, TargetRequest, target_grid};
use super::*;
use crate::build::Leaves as _;
use crate::raster::{
    Block, Outline as RasterOutline, Raster, RasterError, RasterInfo, SampleType, Samples,
};
use crate::texel::Planes;

/// Floats in memory, in blocks of 100 × 70 pixels; NaN where there is none.
#[derive(Debug)]
struct Floats {
    info: RasterInfo,
    values: Vec<f32>,
}

impl Raster for Floats {
    fn info(&self) -> &RasterInfo {
        &self.info
    }

    fn read_block(&self, block_col: u32, block_row: u32) -> Result<Block, RasterError> {
        let info = &self.info;
        let (col, row) = (block_col * info.block_width, block_row * info.block_height);
        let width = info.block_width.min(info.width - col);
        let height = info.block_height.min(info.height - row);
        let pixels =
            (row..row + height).flat_map(|row| (col..col + width).map(move |col| (col, row)));
        let value =
            |(col, row): (u32, u32)| self.values[row as usize * info.width as usize + col as usize];
        let samples = Samples::F32(pixels.map(value).collect());
        Ok(Block { col, row, width, height, samples })
    }

    fn check_unchanged(&self) -> Result<(), RasterError> {
        Ok(())
    }
}

fn moon() -> Body {
    Body::parse("moon").unwrap()
}

/// A raster of what `field` is at its pixels' centers.
fn painted(
    crs: Crs,
    origin: [f64; 2],
    pixel: f64,
    (width, height): (u32, u32),
    field: impl Fn(Geographic) -> f32,
) -> Layout {
    let center = |col: u32, row: u32| MapPoint {
        x: origin[0] + (f64::from(col) + 0.5) * pixel,
        y: origin[1] - (f64::from(row) + 0.5) * pixel,
    };
    let places = (0..height).flat_map(|row| (0..width).map(move |col| (col, row)));
    let values = places.map(|(col, row)| crs.unproject(center(col, row)).map_or(f32::NAN, &field));
    raster(crs, origin, pixel, (width, height), values.collect())
}

/// A raster of `values`, row by row.
fn raster(
    crs: Crs,
    origin: [f64; 2],
    pixel: f64,
    (width, height): (u32, u32),
    values: Vec<f32>,
) -> Layout {
    assert_eq!(values.len(), width as usize * height as usize);
    let outline = RasterOutline { origin, pixel_size: [pixel; 2] };
    let raster = Floats {
        values,
        info: RasterInfo {
            path: "floats.tif".into(),
            width,
            height,
            bands: 1,
            has_alpha: false,
            sample: SampleType::F32,
            crs: Some(crs),
            outline,
            point_registered: false,
            nodata: None,
            scale: 1.0,
            offset: 0.0,
            block_width: 100,
            block_height: 70,
        },
    };
    Layout::new(vec![Arc::new(raster)], crs).unwrap()
}

/// The whole moon, 512 by 256 pixels.
fn globe(field: impl Fn(Geographic) -> f32) -> Layout {
    let crs = Crs::new(Projection::Geographic, moon().ellipsoid);
    painted(crs, [-180.0, 90.0], 360.0 / 512.0, (512, 256), field)
}

/// A plane wave of this many pixels of the globe, in a direction that no grid has.
fn wave(pixels: f64) -> impl Fn(Geographic) -> f32 {
    let k = 512.0 / pixels;
    move |place| {
        let [x, y, z] = surface_normal(place).to_array();
        #[expect(clippy::cast_possible_truncation, reason = "a height")]
        let height = (100.0 * (k * (0.48 * x - 0.6 * y + 0.64 * z) + 1.0).sin()) as f32;
        height
    }
}

fn resampled(layout: Layout, map: TargetMap, kernel: Kernel) -> Resampler {
    resampled_as(layout, map, kernel, Texels::Sampled)
}

fn resampled_as(layout: Layout, map: TargetMap, kernel: Kernel, texels: Texels) -> Resampler {
    let placement = layout.placement().unwrap();
    let request = TargetRequest { map, pixel_size: None, page_side: 66 };
    let grid = target_grid(&[placement], request).unwrap();
    let (limit, precision) = (RangeLimit::None, Precision::default());
    let resampling = Resampling { kernel, limit, precision, texels };
    Resampler::new(grid, layout, placement, Kind::Height, resampling).unwrap()
}

/// Also across the edges of leaves, and not beside holes.
#[test]
fn fitted_texels_are_sampled_ones_beyond_the_field_by_a_twelfth_of_its_bend() {
    let field = |place: Geographic| {
        let is_hole = (place.latitude.0 - 1.1).abs() < 0.1 && place.longitude.0.abs() < 0.2;
        if is_hole { f32::NAN } else { wave(9.0)(place) }
    };
    let map = TargetMap::Polar(Pole::North);
    let [sampled, fitted] = [Texels::Sampled, Texels::Fitted].map(|texels| {
        let resampler = resampled_as(globe(field), map, Kernel::CubicSpline, texels);
        (resampler.grid().pyramid().extent().width as usize, whole(&resampler))
    });
    let (width, sampled) = sampled;
    let (mut full, mut beside) = (0, 0);
    for (at, (&fitted, &center)) in fitted.1.iter().zip(&sampled).enumerate() {
        let (row, col) = (at / width, at % width);
        if row == 0 || col == 0 || row + 1 == width || col + 1 == width {
            continue;
        }
        assert_eq!(fitted.is_nan(), center.is_nan(), "{row} {col}");
        let around = [at - width, at - 1, at + 1, at + width].map(|at| f64::from(sampled[at]));
        let bend: f64 = around.into_iter().map(|height| height - f64::from(center)).sum();
        if center.is_nan() {
            continue;
        }
        let expected = if bend.is_nan() { 0.0 } else { bend / 12.0 };
        *(if bend.is_nan() { &mut beside } else { &mut full }) += 1;
        let found = f64::from(center) - f64::from(fitted);
        assert!((found - expected).abs() < 1e-3, "{row} {col}: {found}, expected {expected}");
    }
    assert!(full > 20_000 && beside > 20, "{full} {beside}");
}

/// Every valid texel and the place of its center.
fn texels(resampler: &Resampler) -> Vec<(Geographic, f32)> {
    let grid = resampler.grid();
    let ([left, top], [width, height]) = (grid.origin(), grid.pixel_size());
    let center = |(row, col): (usize, usize)| MapPoint {
        x: left + (col as f64 + 0.5) * width,
        y: top - (row as f64 + 0.5) * height,
    };
    let across = grid.pyramid().extent().width as usize;
    let all = whole(resampler).into_iter().enumerate().filter(|(_, height)| !height.is_nan());
    all.map(|(at, height)| {
        (grid.crs().unproject(center((at / across, at % across))).unwrap(), height)
    })
    .collect()
}

/// All leaves as one, row by row; NaN where there is nothing.
fn whole(resampler: &Resampler) -> Vec<f32> {
    let pyramid = resampler.grid().pyramid();
    let (extent, side) = (pyramid.extent(), pyramid.page_side() as usize);
    let mut whole = vec![f32::NAN; extent.width as usize * extent.height as usize];
    for leaf in leaves(resampler.grid()) {
        let (rows, cols) = pyramid.interior_size(leaf);
        let Some(raw) = resampler.read(leaf).unwrap() else { continue };
        let Planes::Height(heights) = raw.planes else { panic!("floats come as floats") };
        for row in 0..rows as usize {
            let to = (leaf.row * pyramid.interior()) as usize + row;
            let to = to * extent.width as usize + (leaf.col * pyramid.interior()) as usize;
            let from = (row + 1) * side + 1;
            whole[to..to + cols as usize].copy_from_slice(&heights[from..from + cols as usize]);
        }
    }
    whole
}

/// RMS and largest error, in percent of the wave's RMS, of texels where `zone` says so.
fn errors(
    texels: &[(Geographic, f32)],
    field: impl Fn(Geographic) -> f32,
    zone: impl Fn(Geographic) -> bool,
) -> (f64, f64) {
    let off = |&(place, height): &(Geographic, f32)| f64::from(height) - f64::from(field(place));
    let errors: Vec<f64> = texels.iter().filter(|(place, _)| zone(*place)).map(off).collect();
    assert!(errors.len() > 30, "a zone of {} texels", errors.len());
    let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
    let largest = errors.iter().fold(0.0, |most: f64, e| most.max(e.abs()));
    let percent = 100.0 / (100.0 / 2.0_f64.sqrt());
    (rms * percent, largest * percent)
}

fn degrees(place: Geographic) -> (f64, f64) {
    (place.longitude.0.to_degrees(), place.latitude.0.to_degrees())
}

/// Four steps of an f32 at the wave's greatest height.
const ROUNDING_PERCENT: f64 = 100.0 * 4.0 * f32::EPSILON as f64;

/// A quarter of a turn carries both maps and their pixels over into themselves: of a field turned with
/// them, errors are at a quarter what those of the field itself are at the antimeridian.
#[test]
fn the_antimeridian_is_as_good_as_a_meridian_that_lies_like_it() {
    let map = PolarStereographic {
        pole: Pole::North,
        central_meridian: Radians(0.0),
        scale: PolarScale::AtPole(1.0),
        false_easting: Meters(0.0),
        false_northing: Meters(0.0),
    };
    let polar = Crs::new(Projection::PolarStereographic(map), moon().ellipsoid);
    let pixel = std::f64::consts::TAU * moon().ellipsoid.a().0 / 512.0;
    for (kernel, pixels, _) in LIMITS {
        let rms = |quarters: f64, meridian_deg: f64, is_from_globe: bool| {
            let field = move |place: Geographic| {
                let longitude = Radians(place.longitude.0 - quarters * std::f64::consts::FRAC_PI_2);
                wave(pixels)(Geographic { longitude, ..place })
            };
            let resampler = if is_from_globe {
                resampled(globe(field), TargetMap::Polar(Pole::North), kernel)
            } else {
                let half = 150.0 * pixel;
                let layout = painted(polar, [-half, half], pixel, (300, 300), field);
                resampled(layout, TargetMap::Equirectangular, kernel)
            };
            let strip = |place| {
                let (longitude, latitude) = degrees(place);
                let off = (longitude - meridian_deg + 180.0).rem_euclid(360.0) - 180.0;
                off.abs() < 3.0 && (60.0..85.0).contains(&latitude)
            };
            errors(&texels(&resampler), field, strip).0.max(ROUNDING_PERCENT)
        };
        for is_from_globe in [true, false] {
            let antimeridian = rms(0.0, 180.0, is_from_globe);
            let like_it = rms(1.0, -90.0, is_from_globe);
            let ratio = antimeridian / like_it;
            assert!(
                (0.99..1.01).contains(&ratio),
                "{kernel:?} of {pixels} pixels: {antimeridian} %, {like_it} %"
            );
        }
    }
}

/// What kernels are off by once: the length of the wave in pixels, and the root mean square in
/// percent of it.
const LIMITS: [(Kernel, f64, f64); 6] = [
    (Kernel::Bilinear, 16.0, 1.6),
    (Kernel::Cubic, 16.0, 0.08),
    (Kernel::Lanczos, 16.0, 0.08),
    (Kernel::CubicSpline, 16.0, 0.005),
    (Kernel::QuinticSpline, 16.0, 0.005),
    (Kernel::QuinticSpline, 8.0, 0.05),
];

const ZONES: [&str; 3] = ["pole", "antimeridian", "elsewhere"];

/// The zones that a place of a hemisphere is in.
fn zone(pole: Pole, place: Geographic) -> &'static [&'static str] {
    let (longitude, latitude) = degrees(place);
    match pole.sign() * latitude {
        high if high > 87.0 => &ZONES[..1],
        high if !(20.0..85.0).contains(&high) => &[],
        _ if longitude.abs() > 178.5 => &ZONES[1..],
        _ => &ZONES[2..],
    }
}

/// The pole and the antimeridian are as good as the rest, in every kernel.
#[test]
fn a_wave_is_the_same_on_another_grid() {
    for (kernel, pixels, limit) in LIMITS {
        for pole in [Pole::North, Pole::South] {
            let resampler = resampled(globe(wave(pixels)), TargetMap::Polar(pole), kernel);
            let texels = texels(&resampler);
            for name in ZONES {
                let in_zone = |place| zone(pole, place).contains(&name);
                let (rms, _) = errors(&texels, wave(pixels), in_zone);
                assert!(
                    rms < limit,
                    "{kernel:?} of {pixels} pixels at the {pole:?} {name}: {rms} %"
                );
            }
            let (made, tiles) = resampler.prepared_tiles();
            assert!(made <= tiles, "{made} prepared of {tiles}");
            assert!(resampler.decoded_blocks() <= resampler.blocks());
        }
    }
}

/// The rectangle about a tile of texels that lies across the pixels has corners that none of them needs:
/// squares there were asked for, and made anew each time, though no leaf had announced them.
#[test]
fn squares_and_blocks_are_made_once_where_leaves_lie_across_them() {
    let map = PolarStereographic {
        pole: Pole::North,
        central_meridian: Radians(0.3),
        scale: PolarScale::AtPole(1.0),
        false_easting: Meters(0.0),
        false_northing: Meters(0.0),
    };
    let crs = Crs::new(Projection::PolarStereographic(map), moon().ellipsoid);
    let pixel = 3.5 * moon().ellipsoid.a().0 / 1100.0;
    let half = 550.0 * pixel;
    for kernel in [Kernel::Bilinear, Kernel::QuinticSpline] {
        let polar = painted(crs, [-half, half], pixel, (1100, 1100), wave(16.0));
        let placement = polar.placement().unwrap();
        let map = TargetMap::Equirectangular;
        let grid =
            target_grid(&[placement], TargetRequest { map, pixel_size: None, page_side: 130 });
        let (limit, precision, texels) = (RangeLimit::None, Precision::default(), Texels::Sampled);
        let resampling = Resampling { kernel, limit, precision, texels };
        let resampler =
            Resampler::new(grid.unwrap(), polar, placement, Kind::Height, resampling).unwrap();
        for leaf in leaves(resampler.grid()) {
            resampler.read(leaf).unwrap();
            resampler.source_error(leaf, None).unwrap();
        }
        let (made, tiles) = resampler.prepared_tiles();
        assert!(made <= tiles, "{kernel:?}: {made} prepared of {tiles}");
        let (decoded, blocks) = (resampler.decoded_blocks(), resampler.blocks());
        assert!(decoded <= blocks, "{kernel:?}: {decoded} decoded of {blocks}");
    }
}

#[test]
fn a_constant_stays_one_to_the_bit() {
    for kernel in [
        Kernel::Nearest,
        Kernel::Bilinear,
        Kernel::Cubic,
        Kernel::Lanczos,
        Kernel::CubicSpline,
        Kernel::QuinticSpline,
        Kernel::Average,
    ] {
        let holes = |place: Geographic| {
            let (longitude, latitude) = degrees(place);
            if longitude.abs() < 20.0 && latitude > 50.0 { f32::NAN } else { 1234.567 }
        };
        let resampler = resampled(globe(holes), TargetMap::Polar(Pole::North), kernel);
        let texels = texels(&resampler);
        assert!(texels.len() > 10_000);
        assert!(texels.iter().all(|(_, height)| height.to_bits() == 1234.567_f32.to_bits()));
        // A pixel's width inside the hole nothing is valid; an average wants half of its footprint,
        // which spans many columns beside the pole.
        let inside = |place: Geographic| {
            let (longitude, latitude) = degrees(place);
            longitude.abs() < 19.0 && (51.0..80.0).contains(&latitude)
        };
        assert!(!texels.iter().any(|&(place, _)| inside(place)), "{kernel:?}");
    }
}

/// There and back again: what is lost is at most twice what a kernel loses once, at the pole and on the
/// antimeridian, too.
#[test]
fn a_wave_comes_back_from_a_polar_grid() {
    for (kernel, pixels, limit) in LIMITS {
        for pole in [Pole::North, Pole::South] {
            let there = resampled(globe(wave(pixels)), TargetMap::Polar(pole), kernel);
            let grid = there.grid();
            let Extent { width, height, .. } = grid.pyramid().extent();
            let (origin, pixel) = (grid.origin(), grid.pixel_size()[0]);
            let polar = raster(*grid.crs(), origin, pixel, (width, height), whole(&there));
            let back = resampled(polar, TargetMap::Equirectangular, kernel);
            let texels = texels(&back);
            for name in ZONES {
                let in_zone = |place| zone(pole, place).contains(&name);
                let (rms, _) = errors(&texels, wave(pixels), in_zone);
                assert!(
                    rms < 2.0 * limit,
                    "{kernel:?} of {pixels} pixels at the {pole:?} {name}: {rms} %"
                );
            }
        }
    }
}
