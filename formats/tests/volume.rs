//! Volumes against brute force: points of many footprints at many heights.

#![expect(clippy::unwrap_used, reason = "a failed test may panic")]

use areoid_formats::address::PageAddress;
use areoid_formats::body::{Body, Ellipsoid};
use areoid_formats::bounds::{HalfSpace, Position};
use areoid_formats::geodesy::LatitudeKind;
use areoid_formats::grid::{Grid, Outline, TexelPoint};
use areoid_formats::projection::{Crs, Projection};
use areoid_formats::units::Meters;
use areoid_formats::volume::{Horizon, Volume};
use glam::DVec3;
use proptest::prelude::*;

/// Grids by name, from the ordinary to the odd.
fn grids() -> Vec<(&'static str, Grid)> {
    let mars = Body::parse("mars").unwrap().ellipsoid;
    let saturn = Body::parse("60268000,54364000").unwrap().ellipsoid;
    let degrees = |body| Crs::new(Projection::Geographic, body);
    let proj = |text: &str| Crs::from_proj_string(text).unwrap();
    let make = |crs, origin, pixel: f64, width, height| {
        let outline = Outline { origin, pixel_size: [pixel; 2], width, height };
        Grid::from_outline(crs, outline, 66).unwrap().grid
    };
    let centric = Crs::from_proj_string("+proj=longlat +R=3396190")
        .unwrap()
        .on_body(Body::parse("mars-ellipsoid").unwrap().ellipsoid, LatitudeKind::Planetocentric);
    let polar = "+proj=stere +lat_0=-90 +lat_ts=-71 +lon_0=0 +datum=WGS84";
    vec![
        ("globe", make(degrees(mars), [-180.0, 90.0], 0.25, 1440, 720)),
        ("globe from 0", make(degrees(mars), [0.0, 90.0], 0.25, 1440, 720)),
        ("posts on the Earth", make(degrees(Ellipsoid::WGS84), [-180.25, 90.25], 0.5, 721, 361)),
        ("antimeridian", make(degrees(Ellipsoid::WGS84), [170.0, 60.0], 0.01, 3000, 500)),
        ("pole without a turn", make(degrees(Ellipsoid::WGS84), [10.0, 90.0], 0.1, 700, 500)),
        ("three quarters", make(degrees(saturn), [10.0, 90.0], 0.2, 1350, 900)),
        ("planetocentric", make(centric, [0.0, 90.0], 0.25, 1440, 720)),
        (
            "equirectangular",
            make(proj("+proj=eqc +lat_ts=40 +lon_0=150 +R=3396190"), [-8e5, 3e6], 1e3, 1700, 900),
        ),
        ("a patch", make(degrees(mars), [77.0, 18.6], 1e-5, 900, 700)),
        (
            "polar cap",
            make(proj("+proj=stere +lat_0=90 +R=3396190"), [-1.2e6, 1.2e6], 2e3, 1200, 1200),
        ),
        ("beside the pole", make(proj(polar), [3e5, 2.1e6], 1e3, 900, 700)),
        ("half a planet and more", make(proj(polar), [-1.5e7, 1.5e7], 2e4, 1500, 1500)),
        ("across the pole, cut", make(proj(polar), [-1.3e5, 4e5], 500.0, 701, 901)),
        (
            "a cap of Saturn",
            make(
                proj("+proj=stere +lat_0=90 +a=60268000 +b=54364000"),
                [-4e7, 5e7],
                6e4,
                1200,
                1500,
            ),
        ),
        (
            "a cap on a sphere of an ellipsoid",
            make(
                proj("+proj=stere +lat_0=90 +R=3396190").on_body(
                    Body::parse("mars-ellipsoid").unwrap().ellipsoid,
                    LatitudeKind::Planetocentric,
                ),
                [-2e6, 3e6],
                4e3,
                1000,
                1400,
            ),
        ),
    ]
}

/// Points of the shell on a lattice of the page's interior, ends included.
fn points(grid: &Grid, page: PageAddress, heights: [f64; 2], steps: u32) -> Vec<DVec3> {
    let scale = f64::from(grid.pyramid().halvings(page.level)).exp2();
    let extent = grid.pyramid().extent();
    let interior = f64::from(grid.pyramid().interior());
    let along = |index: u32, count: u32, step: u32| {
        let outline = f64::from(count) / scale;
        let start = f64::from(index) * interior;
        let end = (start + interior).min(outline);
        start + (end - start) * f64::from(step) / f64::from(steps)
    };
    let mut points = Vec::new();
    for (row, col) in (0..=steps).flat_map(|row| (0..=steps).map(move |col| (row, col))) {
        let texel = TexelPoint {
            x: along(page.col, extent.width, col),
            y: along(page.row, extent.height, row),
        };
        let Some(position) = grid.geographic_from_texel(page.level, texel) else { continue };
        for height in [heights[0], heights[0].midpoint(heights[1]), heights[1]] {
            points.push(grid.crs().body.cartesian_from_geographic(position, Meters(height)));
        }
    }
    points
}

fn pages(grid: &Grid) -> Vec<PageAddress> {
    let pyramid = grid.pyramid();
    let of_level = |level| {
        let (rows, cols) = pyramid.pages(level).unwrap();
        (0..rows).flat_map(move |row| (0..cols).map(move |col| PageAddress::new(level, row, col)))
    };
    pyramid.levels().flat_map(of_level).collect()
}

const TERRAIN: [f64; 2] = [-8_000.0, 21_000.0];

#[test]
fn volumes_hold_their_points() {
    for (name, grid) in grids() {
        for page in pages(&grid) {
            let [lowest, highest] = TERRAIN.map(Meters);
            let volume = Volume::new(&grid, page, lowest, highest);
            for point in points(&grid, page, TERRAIN, 9) {
                let outside = volume.bounds().distance_from(point);
                assert_eq!(outside, 0.0, "{name} {page}: {point} is {outside} m outside");
                assert!(point.length() <= volume.greatest_radius().0, "{name} {page}");
                assert!(volume.aabb().distance_from(point) == 0.0, "{name} {page}");
            }
        }
    }
}

/// Each point is in a quarter, or between two, and quarters of quarters are as small as they should be.
#[test]
fn quarters_hold_what_the_whole_holds() {
    for (name, grid) in grids() {
        for page in pages(&grid).into_iter().step_by(7) {
            let [lowest, highest] = TERRAIN.map(Meters);
            let volume = Volume::new(&grid, page, lowest, highest);
            let quarters = volume.quarters();
            let rounding = 1e-9 * grid.crs().body.a().0;
            for point in points(&grid, page, TERRAIN, 9) {
                let nearest = quarters
                    .iter()
                    .map(|quarter| quarter.bounds().distance_from(point))
                    .fold(f64::INFINITY, f64::min);
                assert!(nearest <= rounding, "{name} {page}: {point} is {nearest} m outside");
            }
            let [mut edges, mut halved] =
                [volume, quarters[0]].map(|volume| volume.bounds().half.to_array());
            edges.sort_by(f64::total_cmp);
            halved.sort_by(f64::total_cmp);
            let mut expected = [edges[0], 0.5 * edges[1], 0.5 * edges[2]];
            expected.sort_by(f64::total_cmp);
            assert_eq!(halved, expected, "{name} {page}");
            for quarter in quarters {
                assert_eq!(quarter.bounds().half, quarters[0].bounds().half);
                assert_eq!(quarter.greatest_radius(), volume.greatest_radius());
            }
        }
    }
}

/// The box's radius against that of the sphere around the same center that the points need, and
/// how much of the box's thickness is empty.
#[test]
#[expect(clippy::print_stdout, reason = "figures for whoever asks with --nocapture")]
fn volumes_are_tight() {
    let (start, mut made) = (std::time::Instant::now(), 0);
    for (_, grid) in grids() {
        for page in pages(&grid) {
            std::hint::black_box(Volume::new(&grid, page, Meters(0.0), Meters(1.0)));
            made += 1;
        }
    }
    println!("{:?} a volume", start.elapsed() / made);
    for (name, grid) in grids() {
        let (mut worst, mut sum, mut count) = (1.0_f64, 0.0, 0.0);
        for page in pages(&grid) {
            let [lowest, highest] = TERRAIN.map(Meters);
            let volume = Volume::new(&grid, page, lowest, highest);
            let points = points(&grid, page, TERRAIN, 24);
            // Near the least sphere: from the middle of the points' box on the volume's axes.
            let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
            for &point in &points {
                let along = volume.bounds().axes.transpose_mul_vec3(point);
                (min, max) = (min.min(along), max.max(along));
            }
            let needed = (0.5 * (max - min)).length();
            let ratio = volume.bounds().radius() / needed;
            (worst, sum, count) = (worst.max(ratio), sum + ratio, count + 1.0);
            let limit = if page.level.0 == 0 { 1.35 } else { 1.12 };
            assert!(ratio < limit, "{name} {page}: {ratio}");
        }
        println!("{name:35} {count:5} pages: mean {:.4}, worst {worst:.4}", sum / count);
    }
}

/// Whether the sphere of `radius` around the body's center cuts the line of sight.
fn sphere_hides(eye: DVec3, point: DVec3, radius: f64) -> bool {
    let sight = point - eye;
    let nearest = (-eye.dot(sight) / sight.length_squared()).clamp(0.0, 1.0);
    (eye + nearest * sight).length() < radius
}

fn direction() -> impl Strategy<Value = DVec3> {
    prop::array::uniform3(-1.0..1.0)
        .prop_map(|v| DVec3::from_array(v).try_normalize().unwrap_or(DVec3::Z))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn answers_err_on_the_safe_side(
        which in 0..15_usize,
        page in any::<prop::sample::Index>(),
        eye_direction in direction(),
        near in any::<prop::sample::Index>(),
        altitude in 1.0..7.5_f64,
        axis in direction(),
        heights in (-8e3..21e3_f64, 0.0..5e3_f64),
    ) {
        let (name, grid) = grids().swap_remove(which);
        let pages = pages(&grid);
        let page = *page.get(&pages);
        let heights = [heights.0, heights.0 + heights.1];
        let volume = Volume::new(&grid, page, Meters(heights[0]), Meters(heights[1]));
        let points = points(&grid, page, heights, 12);
        prop_assume!(!points.is_empty());

        // Half of the eyes are near the page, where answers are hardest.
        let ground = near.get(&points);
        let up = if altitude.fract() < 0.5 { ground.normalize() } else { eye_direction };
        let eye = up * (ground.length() + 10.0_f64.powf(altitude));
        let sphere = grid.crs().body.b().0 - 9e3;
        let horizon = Horizon::new(eye, Meters(sphere));
        let hidden = horizon.is_some_and(|horizon| volume.hidden_by(&horizon));
        let distance = volume.distance_from(eye).0;
        let cosine = volume.least_cosine(eye, axis);
        let in_front = horizon.map(|horizon| horizon.in_front());
        let side = HalfSpace::through(eye, axis);
        let position = volume.position_in(&[side]);
        for &point in &points {
            prop_assert!(distance <= point.distance(eye), "{name} {page}");
            prop_assert!(!hidden || sphere_hides(eye, point, sphere), "{name} {page}");
            let is_in_front = in_front.is_some_and(|half| half.normal.dot(point) >= half.offset);
            prop_assert!(!is_in_front || !sphere_hides(eye, point, sphere * (1.0 - 1e-12)));
            let inside = (point - eye).dot(axis) >= 0.0;
            prop_assert!(
                position == Position::Across || (position == Position::Within) == inside,
                "{name} {page}"
            );
            let angle = (point - eye).normalize().dot(axis);
            prop_assert!(cosine == 0.0 || cosine <= angle, "{name} {page}");
        }
    }
}

#[test]
fn heights_that_make_no_shell_are_the_whole_body() {
    let (_, grid) = grids().swap_remove(0);
    let page = pages(&grid)[5];
    for heights in [[f64::NAN, 0.0], [-4e6, 0.0], [0.0, f64::INFINITY], [f64::NAN; 2]] {
        let volume = Volume::new(&grid, page, Meters(heights[0]), Meters(heights[1]));
        assert!(volume.bounds().half.min_element() >= 3_396_190.0, "{heights:?}");
        assert_eq!(volume.distance_from(DVec3::X).0, 0.0);
    }
}
