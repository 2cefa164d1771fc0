#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the grids drawn are small"
)]

use std::collections::BTreeSet;

use areoid_formats::body::Ellipsoid;
use areoid_formats::geodesy::LatitudeKind;
use areoid_formats::grid::Grid;
use areoid_formats::projection::{
    Equirectangular, PolarScale, PolarStereographic, Pole, Projection,
};
use areoid_formats::pyramid::PoleContact;
use areoid_formats::units::{Meters, Radians};
use proptest::prelude::*;

use super::*;
use crate::resample::tile::Coords;
use crate::resample::transform::Precision;
use crate::resample::transform::tests::{Round, Straight, round, straight, surfaces};

/// Six taps an axis.
const REACH: Reach = [2, 3, 2, 3];

/// The row that stands for row `row`, one by one, and whether it does half a turn away.
fn row_of(source: &Placement, mut row: i64) -> (i64, bool) {
    let height = i64::from(source.height);
    let mut turned = false;
    while !(0..height).contains(&row) {
        let (contact, edge) =
            if row < 0 { (source.north, 0) } else { (source.south, 2 * height - 2) };
        let outward = if row < 0 { -1 } else { 1 };
        let own = if contact == PoleContact::Outline { outward } else { 0 };
        row = if height == 1 && own == 0 { 0 } else { edge + own - row };
        turned ^= contact != PoleContact::None;
    }
    (row, turned)
}

/// The column that stands for column `col`: the western one where half a turn falls between two.
fn col_of(source: &Placement, mut col: i64, turned: bool) -> i64 {
    let width = i64::from(source.width);
    if source.wraps {
        return (col + if turned { width / 2 } else { 0 }).rem_euclid(width);
    }
    while !(0..width).contains(&col) {
        col = if width == 1 {
            0
        } else if col < 0 {
            -col
        } else {
            2 * width - 2 - col
        };
    }
    col
}

/// The prepared tiles that the taps of every texel of a leaf lie in.
fn touched(
    transform: &Transform,
    pyramid: &Pyramid,
    (leaf, around): (PageAddress, u32),
) -> BTreeSet<PreparedAt> {
    let source = transform.source();
    let (height, width) = pyramid.interior_size(leaf);
    let around = i64::from(around);
    let start = |index: u32| i64::from(index * pyramid.interior()) - around;
    let (row, col) = (start(leaf.row), start(leaf.col));
    let end = |start: i64, length: u32| start + i64::from(length) + 2 * around;
    let tiles = transform.tiles(row..end(row, height), col..end(col, width));
    let mut found = BTreeSet::new();
    let mut coords = Coords::default();
    let inside = |place: f64, length: u32| (0..i64::from(length)).contains(&floor(place + 0.5));
    let mut last = [i64::MIN; 2];
    for tile in tiles {
        transform.coords(tile, &mut coords);
        for (&u, &v) in coords.u.iter().zip(&coords.v) {
            if !(source.wraps || inside(u, source.width)) || !inside(v, source.height) {
                continue;
            }
            let place = [floor(u), floor(v)];
            if place == last {
                continue;
            }
            last = place;
            for tap in place[1] - REACH[2]..=place[1] + REACH[3] {
                let (row, turned) = row_of(source, tap);
                for tap in place[0] - REACH[0]..=place[0] + REACH[1] {
                    let col = col_of(source, tap, turned);
                    let [row, col] = [row, col].map(|at| at as u32 / PREPARED);
                    found.insert(PreparedAt { row, col });
                }
            }
        }
    }
    found
}

fn leaf_at(grid: &Grid, place: [f64; 2]) -> PageAddress {
    let finest = grid.pyramid().finest();
    let (rows, cols) = grid.pyramid().pages(finest).unwrap();
    let [row, col] = [(place[0], rows), (place[1], cols)]
        .map(|(place, count)| ((place * f64::from(count)) as u32).min(count - 1));
    PageAddress::new(finest, row, col)
}

fn check(target: &Grid, source: &Placement, place: [f64; 2]) -> Result<(), TestCaseError> {
    let transform = Transform::new(&target.placement(), source, Precision::default()).unwrap();
    let leaf = leaf_at(target, place);
    for around in [0, 1] {
        let named = prepared_tiles(&transform, target.pyramid(), (leaf, around), |_| REACH);
        for tile in touched(&transform, target.pyramid(), (leaf, around)) {
            prop_assert!(named.binary_search(&tile).is_ok(), "{tile:?} is not among {named:?}");
        }
        for tile in named {
            let in_source =
                tile.row * PREPARED < source.height && tile.col * PREPARED < source.width;
            prop_assert!(in_source, "{tile:?}");
        }
    }
    Ok(())
}

/// The same grid in pages of so few texels that all of one can be tried.
fn small_pages(grid: Grid) -> Option<Grid> {
    let (origin, pixel_size, extent) = (grid.origin(), grid.pixel_size(), grid.pyramid().extent());
    [66, 130, 514]
        .into_iter()
        .find_map(|side| Grid::new(*grid.crs(), origin, pixel_size, extent, side).ok())
}

fn places() -> impl Strategy<Value = [f64; 2]> {
    let place = || prop_oneof![Just(0.0), 0.0..1.0, Just(1.0)];
    [place(), place()]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn every_tap_of_a_polar_leaf_is_named(
        surface in surfaces(), target in round(), source in straight(), place in places(),
    ) {
        check(&target.grid(surface), &source.placement(surface), place)?;
    }

    #[test]
    fn every_tap_of_a_straight_leaf_is_named(
        surface in surfaces(), target in straight(), source in round(), place in places(),
    ) {
        let Some(target) = target.grid(surface).and_then(small_pages) else { return Ok(()) };
        check(&target, &source.placement(surface), place)?;
    }

    #[test]
    fn every_tap_from_straight_to_straight_is_named(
        surface in surfaces(), target in straight(), source in straight(), place in places(),
    ) {
        let Some(target) = target.grid(surface).and_then(small_pages) else { return Ok(()) };
        check(&target, &source.placement(surface), place)?;
    }

    #[test]
    fn every_tap_from_polar_to_polar_is_named(
        surface in surfaces(), target in round(), source in round(), place in places(),
    ) {
        check(&target.grid(surface), &source.placement(surface), place)?;
    }
}

/// Leaves of maps as large as those of planets: a rectangle turned by any angle in the source, and
/// all of them about a pole.
#[test]
fn few_more_tiles_are_named_than_touched() {
    let surface = (Ellipsoid::sphere(Meters(3_396_190.0)).unwrap(), LatitudeKind::Planetographic);
    let map = PolarStereographic {
        pole: Pole::North,
        central_meridian: Radians(0.3),
        scale: PolarScale::AtPole(1.0),
        false_easting: Meters(0.0),
        false_northing: Meters(0.0),
    };
    let polar = Round { map, scale: 3396.19, aspect: 1.0, pole: [4095.5; 2], size: [8192; 2] };
    let globe = Straight {
        projection: Projection::Equirectangular(Equirectangular::default()),
        on_sphere: false,
        half_width: 9216,
        posts: false,
        part: None,
    };
    let mut worst = 0.0_f64;
    for (target, source) in [
        (polar.grid(surface), globe.placement(surface)),
        (globe.grid(surface).unwrap(), polar.placement(surface)),
    ] {
        let target = Grid::new(
            *target.crs(),
            target.origin(),
            target.pixel_size(),
            target.pyramid().extent(),
            512,
        )
        .unwrap();
        let transform = Transform::new(&target.placement(), &source, Precision::default()).unwrap();
        let finest = target.pyramid().finest();
        let (rows, cols) = target.pyramid().pages(finest).unwrap();
        let (mut named, mut needed) = (0, 0);
        let leaves = (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col)));
        for (row, col) in leaves.step_by(29) {
            let leaf = PageAddress::new(finest, row, col);
            named += prepared_tiles(&transform, target.pyramid(), (leaf, 0), |_| REACH).len();
            needed += touched(&transform, target.pyramid(), (leaf, 0)).len();
        }
        let ratio = named as f64 / needed as f64;
        worst = worst.max(ratio);
    }
    assert!(worst <= 1.3, "{worst}");
}
