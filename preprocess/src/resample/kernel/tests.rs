//! Kernels against analytic fields, constants and ramps.

use super::super::prepare::{Beside, PreparedSource};
use super::super::source::test_support::InMemory;
use super::*;
use areoid_formats::pyramid::{Extent, PoleContact};
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

const ALL: [Kernel; 8] = [
    Kernel::Nearest,
    Kernel::Bilinear,
    Kernel::Cubic,
    Kernel::PlainLanczos,
    Kernel::Lanczos,
    Kernel::CubicSpline,
    Kernel::QuinticSpline,
    Kernel::Average,
];

/// A texel a pixel.
const DENSE: Footprint = Footprint { texel_u: 1.0, texel_v: 1.0, detail_u: 1.0, detail_v: 1.0 };

/// A texel every `pixels`.
fn sparse(pixels: f64) -> Footprint {
    Footprint { texel_u: pixels, texel_v: pixels, ..DENSE }
}

fn open(width: u32, height: u32) -> Extent {
    let (north, south) = (PoleContact::None, PoleContact::None);
    Extent { width, height, wraps: false, north, south }
}

/// Numbers in 0..1 that follow from a seed.
fn random(seed: &mut u64) -> f64 {
    *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    f64::from(u32::try_from(*seed >> 32).unwrap()) / (f64::from(u32::MAX) + 1.0)
}

/// Places in a rectangle of columns and rows.
fn places(count: usize, [left, right, top, bottom]: [f64; 4], seed: u64) -> Coords {
    let mut seed = seed;
    let mut along = |low: f64, high: f64| -> Vec<f64> {
        (0..count).map(|_| low + (high - low) * random(&mut seed)).collect()
    };
    Coords { u: along(left, right), v: along(top, bottom), range: [left, right, top, bottom] }
}

fn prepared(kernel: Kernel, source: InMemory) -> PreparedSource {
    PreparedSource::new(Arc::new(source), kernel.filter(), Beside::Pixels, |_, _| u32::MAX)
}

fn sample(
    kernel: Kernel,
    limit: RangeLimit,
    source: &PreparedSource,
    coords: &Coords,
    footprint: Footprint,
) -> Sampled {
    let (mut window, mut out) = (Window::default(), Sampled::default());
    window.assemble(source, coords.range, kernel.reach(footprint), |_| true).unwrap();
    kernel.sample(limit, coords, footprint, &window, &mut Scratch::default(), &mut out);
    out
}

/// RMS and greatest error in % of a wave's RMS and amplitude.
fn off(kernel: Kernel, footprint: Footprint, wavelength_px: f64) -> (f64, f64) {
    const SIDE: u32 = 400;
    const AMPLITUDE: f64 = 3000.0;
    let (mut squares, mut signal, mut worst) = (0.0, 0.0, 0.0_f64);
    for (seed, direction) in [0.2_f64, 0.57, 0.94, 1.31].into_iter().enumerate() {
        let (along_rows, along_cols) = direction.sin_cos();
        let frequency = TAU / wavelength_px;
        let field = |col: f64, row: f64| {
            AMPLITUDE * (frequency * (along_cols * col + along_rows * row) + 0.3).sin()
        };
        #[expect(clippy::cast_possible_truncation, reason = "pixels are f32")]
        let pixel = |col: u32, row: u32| field(f64::from(col), f64::from(row)) as f32;
        let source = prepared(kernel, InMemory::heights(open(SIDE, SIDE), pixel));
        let coords = places(4000, [80.0, 320.0, 80.0, 320.0], seed as u64);
        let out = sample(kernel, RangeLimit::None, &source, &coords, footprint);
        assert!(out.alpha.is_none());
        for ((&u, &v), &texel) in coords.u.iter().zip(&coords.v).zip(&out.planes[0]) {
            let error = f64::from(texel) - field(u, v);
            squares += error * error;
            signal += field(u, v).powi(2);
            worst = worst.max(error.abs());
        }
    }
    (100.0 * (squares / signal).sqrt(), 100.0 * worst / AMPLITUDE)
}

#[test]
fn waves_come_out_as_well_as_the_table_says() {
    const WAVES: [f64; 5] = [273.0, 16.0, 8.0, 4.0, 2.5];
    // The module's table, RMS in %; the greatest error is at most 2.2 times as large, for waves
    // along both axes.
    let table = [
        (Kernel::Bilinear, [0.0049, 1.42, 5.6, 21.2, 48.4]),
        (Kernel::Cubic, [0.000_03, 0.063, 0.62, 6.95, 32.0]),
        (Kernel::PlainLanczos, [0.034, 0.48, 0.605, 2.06, 16.0]),
        (Kernel::Lanczos, [0.0003, 0.062, 0.41, 2.02, 16.1]),
        (Kernel::CubicSpline, [0.000_03, 0.0032, 0.058, 1.38, 16.5]),
        (Kernel::QuinticSpline, [0.000_04, 0.000_06, 0.00105, 0.13, 6.9]),
    ];
    for (kernel, limits) in table {
        let mut line = String::new();
        for (wave, most) in WAVES.into_iter().zip(limits) {
            let (rms, worst) = off(kernel, DENSE, wave);
            line += &format!("  {wave}: {rms:.6} ({worst:.5})");
            assert!(rms <= most && worst <= 2.2 * most + 2e-5, "{kernel:?}{line}");
        }
    }
}

#[test]
fn waves_come_out_beside_holes_too() {
    // Round holes; texels within 4 pixels of one.
    let holes: Vec<[f64; 3]> = {
        let mut seed = 29;
        let mut along = |low: f64, high: f64| low + (high - low) * random(&mut seed);
        (0..40).map(|_| [along(0.0, 300.0), along(0.0, 300.0), along(3.0, 14.0)]).collect()
    };
    let nearest_hole = |u: f64, v: f64| {
        let off = holes.iter().map(|&[col, row, radius]| (u - col).hypot(v - row) - radius);
        off.fold(f64::INFINITY, f64::min)
    };
    for (kernel, limits) in [
        (Kernel::Cubic, [0.03, 1.7, 5.0]),
        (Kernel::Lanczos, [0.03, 1.7, 5.0]),
        (Kernel::CubicSpline, [0.03, 1.7, 5.0]),
        (Kernel::QuinticSpline, [0.03, 1.7, 5.0]),
    ] {
        for (wave, most) in [273.0, 16.0, 8.0].into_iter().zip(limits) {
            let field = |u: f64, v: f64| (TAU / wave * (0.8 * u + 0.6 * v) + 0.3).sin();
            let pixel = |col: u32, row: u32| {
                let (col, row) = (f64::from(col), f64::from(row));
                #[expect(clippy::cast_possible_truncation, reason = "pixels are f32")]
                let height = field(col, row) as f32;
                if nearest_hole(col, row) < 0.0 { f32::NAN } else { height }
            };
            let source = prepared(kernel, InMemory::heights(open(300, 300), pixel));
            let coords = places(20_000, [20.0, 280.0, 20.0, 280.0], 31);
            let out = sample(kernel, RangeLimit::None, &source, &coords, DENSE);
            let texels = coords.u.iter().zip(&coords.v).zip(&out.planes[0]);
            let squares: Vec<f64> = texels
                .zip(out.alpha.unwrap())
                .filter(|&(((&u, &v), _), alpha)| alpha != 0 && nearest_hole(u, v) < 4.0)
                .map(|(((&u, &v), &texel), _)| (f64::from(texel) - field(u, v)).powi(2))
                .collect();
            assert!(squares.len() > 1000);
            let rms = 100.0 * (2.0 * squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
            assert!(rms < most, "{kernel:?}: {wave} px: {rms} %");
        }
    }
}

#[test]
fn texels_far_apart_do_not_alias() {
    // Shorter than two texels by enough that nothing should come out; the least of what passes.
    for kernel in ALL.into_iter().filter(|&kernel| kernel != Kernel::Nearest) {
        let most = match kernel {
            Kernel::Average => 40.0,
            Kernel::Bilinear => 9.0,
            _ => 5.0,
        };
        for (apart, wave) in [(2.5, 2.9), (3.5, 4.0), (4.0, 2.5), (6.0, 4.0), (8.0, 3.3)] {
            let came_out = |kernel: Kernel| {
                const SIDE: u32 = 400;
                let (mut squares, mut count) = (0.0, 0.0);
                for direction in 0..4 {
                    let (down, right) = (0.2 + f64::from(direction) * 0.37).sin_cos();
                    #[expect(clippy::cast_possible_truncation, reason = "pixels are f32")]
                    let pixel = |col: u32, row: u32| {
                        let phase = right * f64::from(col) + down * f64::from(row);
                        (TAU / wave * phase).sin() as f32
                    };
                    let source = prepared(kernel, InMemory::heights(open(SIDE, SIDE), pixel));
                    let coords = places(500, [80.0, 320.0, 80.0, 320.0], 3);
                    let out = sample(kernel, RangeLimit::None, &source, &coords, sparse(apart));
                    squares +=
                        out.planes[0].iter().map(|&texel| f64::from(texel).powi(2)).sum::<f64>();
                    count += 500.0;
                }
                100.0 * (2.0 * squares / count).sqrt()
            };
            let rms = came_out(kernel);
            assert!(rms < most, "{kernel:?}: {wave} px at {apart}: {rms} %");
        }
        // What is long against texels stays.
        let (rms, _) = off(kernel, sparse(4.0), 64.0);
        let most = match kernel {
            Kernel::Bilinear => 1.4,
            Kernel::Average => 0.8,
            _ => 0.05,
        };
        assert!(rms < most, "{kernel:?}: {rms}");
    }
}

#[test]
fn kernels_widen_only_where_texels_are_far_apart() {
    for (texel, detail, expected) in [
        (1.0, 1.0, 1.0),
        (0.3, 1.0, 1.0),
        (1.57, 1.0, 1.0),
        (1.8, 1.0, 1.4),
        (2.0, 1.0, 2.0),
        (5.0, 1.0, 5.0),
        (9.0, 9.0, 1.0),
        (18.0, 9.0, 18.0),
    ] {
        let footprint = Footprint { texel_u: texel, detail_u: detail, texel_v: 1.0, detail_v: 1.0 };
        let [u, v] = stretched::stretch(footprint);
        assert!((u - expected).abs() <= 1.0 / 128.0 && v == 1.0, "{texel} {detail}: {u}");
    }
}

#[test]
fn constants_stay_to_the_bit() {
    const HEIGHT: f32 = 1234.567;
    // Holes of all sizes, and edges.
    let pixel = |col: u32, row: u32| {
        let hole = (col / 9 + row / 7).is_multiple_of(5)
            || (col * 7 + row * 13).is_multiple_of(31)
            || col + row < 60;
        if hole { f32::NAN } else { HEIGHT }
    };
    for kernel in ALL {
        let source = prepared(kernel, InMemory::heights(open(300, 280), pixel));
        let coords = places(3000, [-0.5, 299.4, -0.5, 279.4], 5);
        for footprint in [DENSE, sparse(1.7), sparse(3.3)] {
            for limit in [RangeLimit::None, RangeLimit::Taps] {
                let out = sample(kernel, limit, &source, &coords, footprint);
                let alpha = out.alpha.unwrap();
                let valid = alpha.iter().filter(|&&alpha| alpha != 0).count();
                assert!((1000..2600).contains(&valid), "{kernel:?}: {valid}");
                for (texel, _) in out.planes[0].iter().zip(alpha).filter(|&(_, alpha)| alpha != 0) {
                    assert_eq!(texel.to_bits(), HEIGHT.to_bits(), "{kernel:?} {footprint:?}");
                }
            }
        }
    }
}

#[test]
fn ground_flat_around_a_texel_stays_flat_to_the_bit() {
    // Far from the step even a spline's coefficients do not know of it.
    let pixel = |col: u32, _: u32| if col < 150 { 1234.567 } else { -8000.25 };
    for kernel in ALL {
        let source = prepared(kernel, InMemory::heights(open(300, 64), pixel));
        for (range, height) in [([20.0, 110.0], 1234.567_f32), ([190.0, 280.0], -8000.25)] {
            let coords = places(500, [range[0], range[1], 5.0, 58.0], 9);
            let out = sample(kernel, RangeLimit::None, &source, &coords, sparse(2.4));
            assert!(out.planes[0].iter().all(|texel| texel.to_bits() == height.to_bits()));
            let out = sample(kernel, RangeLimit::None, &source, &coords, DENSE);
            assert!(out.planes[0].iter().all(|texel| texel.to_bits() == height.to_bits()));
        }
    }
}

#[test]
fn ramps_stay_to_a_millionth_of_a_pixel() {
    // Near zero, where f32 is fine enough to tell. A pixel is the larger of the source's and the
    // target's.
    let pixel = |col: u32, row: u32| (col as f32 - 130.0) + 0.25 * (row as f32 - 128.0);
    let ramps = ALL.into_iter().filter(|kernel| {
        !matches!(kernel, Kernel::Nearest | Kernel::Average | Kernel::PlainLanczos)
    });
    for kernel in ramps {
        let source = prepared(kernel, InMemory::heights(open(300, 280), pixel));
        let coords = places(3000, [124.0, 136.0, 124.0, 136.0], 11);
        for (footprint, pixel) in [(DENSE, 1.0), (sparse(3.3), 3.3)] {
            let out = sample(kernel, RangeLimit::None, &source, &coords, footprint);
            for ((&u, &v), &texel) in coords.u.iter().zip(&coords.v).zip(&out.planes[0]) {
                let error = f64::from(texel) - ((u - 130.0) + 0.25 * (v - 128.0));
                assert!(error.abs() <= 1e-6 * pixel, "{kernel:?} {footprint:?}: {error:e}");
            }
        }
    }
}

/// Where texels were a little farther apart than pixels, a wave of 273 pixels was off by 50 roundings:
/// stretched kernels had a second moment.
#[test]
fn parabolas_stay_however_far_texels_are_apart() {
    let field = |u: f64, v: f64| 0.125 * ((u - 130.0).powi(2) - (v - 128.0).powi(2));
    #[expect(clippy::cast_possible_truncation, reason = "pixels are f32, and eighths")]
    let pixel = |col: u32, row: u32| field(f64::from(col), f64::from(row)) as f32;
    for kernel in [Kernel::Cubic, Kernel::CubicSpline, Kernel::QuinticSpline] {
        let source = prepared(kernel, InMemory::heights(open(300, 280), pixel));
        let coords = places(3000, [124.0, 136.0, 122.0, 134.0], 37);
        for apart in [1.0, 1.59, 1.601, 1.67, 1.8, 2.0, 3.3] {
            let out = sample(kernel, RangeLimit::None, &source, &coords, sparse(apart));
            for ((&u, &v), &texel) in coords.u.iter().zip(&coords.v).zip(&out.planes[0]) {
                let error = f64::from(texel) - field(u, v);
                assert!(error.abs() <= 5e-6 * apart, "{kernel:?} {apart}: {error:e}");
            }
        }
    }
}

#[test]
fn a_limit_keeps_texels_between_the_pixels_around_them() {
    let pixel =
        |col: u32, row: u32| if (col / 10 + row / 10).is_multiple_of(2) { 0.0 } else { 1000.0 };
    let coords = places(3000, [40.0, 200.0, 40.0, 200.0], 13);
    for kernel in [Kernel::Cubic, Kernel::Lanczos, Kernel::CubicSpline, Kernel::QuinticSpline] {
        let source = prepared(kernel, InMemory::heights(open(256, 256), pixel));
        for (footprint, most) in [(DENSE, 300), (sparse(1.9), 20)] {
            let outside = |limit| {
                let out = sample(kernel, limit, &source, &coords, footprint);
                out.planes[0].iter().filter(|texel| !(0.0..=1000.0).contains(*texel)).count()
            };
            assert!(outside(RangeLimit::None) > most, "{kernel:?}");
            assert_eq!(outside(RangeLimit::Taps), 0, "{kernel:?}");
        }
        // Of wide kernels all taps count, and not those alone that are near.
        let means = sample(kernel, RangeLimit::Taps, &source, &coords, sparse(8.0));
        let free = sample(kernel, RangeLimit::None, &source, &coords, sparse(8.0));
        let moved = means.planes[0].iter().zip(&free.planes[0]).filter(|(a, b)| a != b).count();
        assert!(moved < 300, "{kernel:?}: {moved}");
    }
}

/// What holes are filled with goes on as the slope beside them does, and counted as a pixel.
#[test]
fn a_limit_heeds_no_pixel_without_data() {
    // Ground that falls to 0 at the edges of ditches without data.
    let pixel = |col: u32, _| match col % 16 {
        0..4 => f32::NAN,
        col => (30 * (col - 4).min(15 - col)) as f32,
    };
    let coords = places(3000, [8.0, 80.0, 8.0, 80.0], 19);
    for kernel in [Kernel::Bilinear, Kernel::Cubic, Kernel::Lanczos, Kernel::QuinticSpline] {
        let source = prepared(kernel, InMemory::heights(open(90, 90), pixel));
        let below = |limit| {
            let out = sample(kernel, limit, &source, &coords, DENSE);
            let alpha = out.alpha.unwrap();
            let valid = out.planes[0].iter().zip(&alpha).filter(|&(_, &alpha)| alpha != 0);
            valid.filter(|&(&texel, _)| texel < 0.0).count()
        };
        assert!(below(RangeLimit::None) > 100, "{kernel:?}");
        assert_eq!(below(RangeLimit::Taps), 0, "{kernel:?}");
    }
}

#[test]
fn a_texel_is_valid_where_its_pixel_is() {
    let is_hole = |col: u32, row: u32| (col * 3 + row * 5) % 17 < 4;
    let pixel = |col: u32, row: u32| if is_hole(col, row) { f32::NAN } else { (col + row) as f32 };
    for kernel in ALL.into_iter().filter(|&kernel| kernel != Kernel::Average) {
        let source = prepared(kernel, InMemory::heights(open(90, 90), pixel));
        let coords = places(3000, [-3.0, 93.0, -3.0, 93.0], 17);
        let out = sample(kernel, RangeLimit::None, &source, &coords, DENSE);
        let alpha = out.alpha.unwrap();
        for ((&u, &v), &alpha) in coords.u.iter().zip(&coords.v).zip(&alpha) {
            let inside = |at: f64| (-0.5..89.5).contains(&at);
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "inside")]
            let nearest = |at: f64| (at + 0.5).floor() as u32;
            let valid = inside(u) && inside(v) && !is_hole(nearest(u), nearest(v));
            assert_eq!(alpha != 0, valid, "{kernel:?} at {u}, {v}");
        }
    }
}

#[test]
fn averages_are_of_what_is_valid_under_a_texel() {
    let pixel = |col: u32, row: u32| match (col, row) {
        (20, 20) => f32::NAN,
        (40.., _) => f32::NAN,
        _ => col as f32,
    };
    let source = prepared(Kernel::Average, InMemory::heights(open(64, 64), pixel));
    let coords = Coords {
        u: vec![10.0, 10.25, 20.0, 39.0, 39.75],
        v: vec![10.0, 10.0, 20.0, 30.0, 30.0],
        range: [10.0, 39.75, 10.0, 30.0],
    };
    let out = sample(Kernel::Average, RangeLimit::None, &source, &coords, sparse(3.0));
    // Three columns; two halves and two; the hole is missing from the middle; half is missing.
    let expected = [10.0, 10.25, 20.0, 38.5];
    for (found, expected) in out.planes[0].iter().zip(expected) {
        assert!((found - expected).abs() < 1e-4, "{:?}", out.planes[0]);
    }
    assert_eq!(out.alpha.unwrap(), [255, 255, 255, 255, 0]);
}

/// A field on the sphere that is as rough everywhere, poles included.
fn on_sphere(longitude: f64, latitude: f64, frequency: f64) -> f64 {
    let (sin, cos) = latitude.sin_cos();
    let [x, y, z] = [cos * longitude.cos(), cos * longitude.sin(), sin];
    1000.0 * (frequency * (0.48 * x + 0.6 * y + 0.64 * z) + 0.7).sin()
}

#[test]
fn poles_and_the_antimeridian_are_as_good_as_elsewhere() {
    for (posts, height) in [(false, 360), (true, 361)] {
        let contact = if posts { PoleContact::Posts } else { PoleContact::Outline };
        let extent = Extent { width: 720, height, wraps: true, north: contact, south: contact };
        // Rows from the pole.
        let top = if posts { 0.0 } else { 0.5 };
        let place =
            |u: f64, v: f64| ((u + 0.5) * TAU / 720.0 - PI, PI / 2.0 - (v + top) * PI / 360.0);
        // Waves of at least 8 pixels.
        let frequency = 720.0 / 8.0;
        #[expect(clippy::cast_possible_truncation, reason = "pixels are f32")]
        let pixel = |col: u32, row: u32| {
            let (longitude, latitude) = place(col.into(), row.into());
            on_sphere(longitude, latitude, frequency) as f32
        };
        for (kernel, most) in
            [(Kernel::Cubic, 0.61), (Kernel::CubicSpline, 0.06), (Kernel::QuinticSpline, 0.0012)]
        {
            let source = prepared(kernel, InMemory::heights(extent, pixel));
            let last = f64::from(height) - 1.0;
            let zones = [
                ("seam", [-3.0, 3.0, 100.0, 260.0]),
                ("a turn on", [716.0, 727.0, 100.0, 260.0]),
                ("north", [-400.0, 400.0, -top, 4.0]),
                ("south", [-400.0, 400.0, last - 4.0, last + top]),
                ("elsewhere", [200.0, 500.0, 60.0, 300.0]),
            ];
            for (zone, range) in zones {
                let coords = places(4000, range, 19);
                let out = sample(kernel, RangeLimit::None, &source, &coords, DENSE);
                assert!(out.alpha.is_none());
                let squares =
                    coords.u.iter().zip(&coords.v).zip(&out.planes[0]).map(|((&u, &v), &texel)| {
                        let (longitude, latitude) = place(u, v);
                        (f64::from(texel) - on_sphere(longitude, latitude, frequency)).powi(2)
                    });
                let rms = 100.0 * (squares.sum::<f64>() / 4000.0 / (1e6 / 2.0)).sqrt();
                assert!(rms < most, "{kernel:?}, posts {posts}, {zone}: {rms} %");
            }
        }
    }
}

#[test]
fn colors_are_summed_as_light_and_constants_keep_their_code() {
    let checkers = |col: u32, row: u32| {
        let code = if (col + row).is_multiple_of(2) { 255 } else { 0 };
        [code, 7, 200, if col < 80 { 255 } else { 0 }]
    };
    for kernel in ALL {
        let source = prepared(kernel, InMemory::colors(open(120, 120), checkers));
        let coords = places(2000, [30.0, 100.0, 30.0, 90.0], 23);
        let out = sample(kernel, RangeLimit::None, &source, &coords, sparse(4.0));
        let alpha = out.alpha.clone().unwrap();
        let codes = [0, 1, 2].map(|channel| {
            let mut codes = Vec::new();
            out.codes_into(channel, &mut codes);
            codes
        });
        for (texel, &alpha) in alpha.iter().enumerate() {
            let [red, green, blue] = codes.each_ref().map(|plane| plane[texel]);
            if alpha != 0 {
                assert_eq!((green, blue), (7, 200), "{kernel:?}");
                let near_edge = coords.u[texel] > 60.0;
                // Half the light of white.
                let gray = (160..=215).contains(&red) || kernel == Kernel::Nearest || near_edge;
                assert!(gray, "{kernel:?}: {red}");
            }
            let valid = coords.u[texel] < 79.5;
            assert!((alpha != 0) == valid || kernel == Kernel::Average);
        }
    }
}
