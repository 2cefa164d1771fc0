//! Prepared tiles: the same whoever makes them and from wherever; windows of them.

use super::super::source::test_support::InMemory;
use super::super::window::Window;
use super::*;
use crate::once::test_support::MemorySpill;
use areoid_formats::pyramid::{Extent, PoleContact};
use std::collections::BTreeSet;

fn noise(col: i64, row: i64) -> f32 {
    let mixed = (col * 7919 + row * 104_729 + 1).wrapping_mul(0x1e37_79b9_7f4a_7c15);
    f32::from(i16::try_from((mixed ^ mixed >> 29) >> 40 & 0x3fff).unwrap()) - 8000.0
}

fn extent(width: u32, height: u32, pole: PoleContact) -> Extent {
    Extent { width, height, wraps: pole != PoleContact::None, north: pole, south: pole }
}

fn prepared(source: InMemory, filter: Filter) -> PreparedSource {
    PreparedSource::new(Arc::new(source), filter, Beside::Nothing, |_, _| u32::MAX)
}

/// What is prepared at a pixel.
fn at(source: &PreparedSource, col: u32, row: u32) -> f32 {
    let tile = source.get(col / PREPARED, row / PREPARED).unwrap();
    let (col, row) = (col % PREPARED, row % PREPARED);
    tile.plane(0).unwrap()[row as usize * tile.cols() + col as usize]
}

#[test]
fn tiles_do_not_depend_on_where_they_are_cut() {
    // The same terrain around the body, begun elsewhere, so that edges of tiles fall elsewhere.
    const SHIFT: u32 = 120;
    for (filter, most) in [
        (Filter::Pixels { reach: 3 }, 0.0),
        (Filter::CubicSpline, 16_384.0 * 2.0_f32.powi(-22)),
        (Filter::QuinticSpline, 16_384.0 * 2.0_f32.powi(-21)),
    ] {
        let source = |shift: u32| {
            let pixel =
                move |col: u32, row: u32| noise(i64::from((col + shift) % 600), i64::from(row));
            prepared(InMemory::heights(extent(600, 70, PoleContact::Outline), pixel), filter)
        };
        let (one, other) = (source(0), source(SHIFT));
        for col in 0..600 {
            for row in 0..70 {
                let (a, b) = (at(&one, (col + SHIFT) % 600, row), at(&other, col, row));
                assert!((a - b).abs() <= most, "{filter:?} at {col}, {row}: {a} and {b}");
            }
        }
    }
}

#[test]
fn windows_are_the_extended_source() {
    let pixel = |col: u32, row: u32| noise(col.into(), row.into());
    for pole in [PoleContact::None, PoleContact::Outline, PoleContact::Posts] {
        for filter in [Filter::Pixels { reach: 2 }, Filter::QuinticSpline] {
            let source = prepared(InMemory::heights(extent(560, 280, pole), pixel), filter);
            let mut window = Window::default();
            for [left, right, top, bottom] in [
                [10.5, 70.0, 20.0, 30.0],
                [-40.0, 30.2, -9.0, 20.0],
                [500.0, 640.0, 250.0, 300.0],
                [1100.0, 1160.0, 100.0, 101.0],
                [-600.0, 1200.0, -5.0, 2.0],
            ] {
                assert!(
                    window.assemble(&source, [left, right, top, bottom], [2, 2], |_| true).unwrap()
                        || pole == PoleContact::None
                );
                let extension = source.extension();
                let view = window.view(0);
                #[expect(clippy::cast_possible_truncation, reason = "places of pixels")]
                let (first, last) = ((left - 1.0) as i64, right as i64 + 2);
                for (down, row) in (view.row..view.row + 5).enumerate() {
                    for col in first..last {
                        let origin = extension.row(row);
                        let from = extension.col(col, origin.turned);
                        let place = down * view.stride + usize::try_from(col - view.col).unwrap();
                        let found = view.data[place];
                        assert_eq!(found, at(&source, from.index, origin.index));
                        if let Some(alpha) = window.alpha() {
                            assert_eq!(alpha[place] != 0, origin.real && from.real);
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn halos_are_the_extended_source() {
    // What a spline has at an edge is what it has inside of a source that goes on.
    let terrain = |col: i64, row: i64| noise(col.rem_euclid(300), row);
    let small = InMemory::heights(extent(300, 40, PoleContact::Outline), |col, row| {
        terrain(col.into(), row.into())
    });
    let large = InMemory::heights(extent(400, 140, PoleContact::None), |col, row| {
        let (col, row) = (i64::from(col) - 50, i64::from(row) - 50);
        match row {
            ..0 => terrain(col + 150, -1 - row),
            40.. => terrain(col + 150, 79 - row),
            _ => terrain(col, row),
        }
    });
    let (small, large) =
        (prepared(small, Filter::QuinticSpline), prepared(large, Filter::QuinticSpline));
    for row in 0..40 {
        for col in 0..300 {
            let (a, b) = (at(&small, col, row), at(&large, col + 50, row + 50));
            assert!((a - b).abs() < 0.01, "{col}, {row}: {a} and {b}");
        }
    }
}

#[test]
fn each_tile_is_made_once_of_what_it_says_it_reads() {
    let pixel = |col: u32, row: u32| {
        if (col / 70 + row / 90).is_multiple_of(3) {
            f32::NAN
        } else {
            noise(col.into(), row.into())
        }
    };
    let source = Arc::new(InMemory::heights(extent(600, 300, PoleContact::Outline), pixel));
    let spill = Arc::new(MemorySpill::default());
    let mut tight = PreparedSource::new(
        Arc::clone(&source) as _,
        Filter::CubicSpline,
        Beside::Pixels,
        |_, _| 4,
    );
    tight.spill(&Arc::new(Overflow::new(Arc::clone(&spill) as _, 0)));
    let loose = PreparedSource::new(
        Arc::clone(&source) as _,
        Filter::CubicSpline,
        Beside::Pixels,
        |_, _| 4,
    );
    let places: Vec<(u32, u32)> =
        (0..2).flat_map(|row| (0..3).map(move |col| (col, row))).collect();
    let announced: Vec<Rect> =
        places.iter().flat_map(|&(col, row)| tight.reads(col, row)).collect();
    for _visit in 0..3 {
        for &(col, row) in &places {
            assert_eq!(*tight.get(col, row).unwrap(), *loose.get(col, row).unwrap());
            tight.release(col, row);
            loose.release(col, row);
        }
    }
    assert_eq!((tight.made(), loose.made(), tight.tiles()), (6, 6, (3, 2)));
    assert!(spill.given() > 0);
    let mut expected: Vec<Rect> = [announced.clone(), announced].concat();
    let mut read = source.read.lock().unwrap().clone();
    let key = |rect: &Rect| (rect.rows.start, rect.cols.start, rect.rows.end, rect.cols.end);
    expected.sort_by_key(key);
    read.sort_by_key(key);
    assert_eq!(read, expected);
    let ends: BTreeSet<bool> =
        read.iter().map(|rect| rect.cols.end <= 600 && rect.rows.end <= 300).collect();
    assert_eq!(ends, BTreeSet::from([true]));
}

#[test]
fn memory_used_again_leaks_nothing() {
    const SENTINEL: f32 = 1e30;
    let is_hole = |col: u32, row: u32| (col / 5 + row / 3).is_multiple_of(4);
    let pixel = move |col: u32, row: u32| match (row < 256, is_hole(col, row)) {
        (true, _) => SENTINEL,
        (false, true) => f32::NAN,
        (false, false) => noise(col.into(), row.into()),
    };
    for filter in [Filter::Pixels { reach: 3 }, Filter::CubicSpline, Filter::QuinticSpline] {
        let source = |dirty: bool| {
            let pixels = InMemory::heights(extent(256, 512, PoleContact::None), pixel);
            let source = prepared(pixels, filter);
            if dirty {
                source.get(0, 0).unwrap();
            }
            source
        };
        // The second tile's halo lies in the first: cut it off.
        let clean = source(false).get(0, 1).unwrap();
        assert_eq!(clean, source(true).get(0, 1).unwrap());
    }
    let color = move |col: u32, row: u32| match (row < 256, is_hole(col, row)) {
        (true, _) => [255; 4],
        (false, hole) => [40, 50, 60, if hole { 0 } else { 255 }],
    };
    let pixels = InMemory::colors(extent(256, 512, PoleContact::None), color);
    let source = prepared(pixels, Filter::Pixels { reach: 1 });
    source.get(0, 0).unwrap();
    let tile = source.get(0, 1).unwrap();
    let below: &[f32] = &tile.plane(0).unwrap()[30 * 256..];
    assert!(below.iter().all(|&light| light == texel::light(40)));
}

#[test]
fn a_tile_without_data_near_it_is_empty() {
    let pixel = |col: u32, _: u32| if col < 250 { f32::NAN } else { 5.0 };
    let source =
        prepared(InMemory::heights(extent(800, 64, PoleContact::None), pixel), Filter::CubicSpline);
    assert!(!source.get(0, 0).unwrap().is_empty());
    let pixel = |col: u32, _: u32| if col < 560 { f32::NAN } else { 5.0 };
    let source =
        prepared(InMemory::heights(extent(800, 64, PoleContact::None), pixel), Filter::CubicSpline);
    assert!(source.get(0, 0).unwrap().is_empty());
    let mut window = Window::default();
    assert!(!window.assemble(&source, [10.0, 200.0, 1.0, 9.0], [2, 2], |_| true).unwrap());
    assert!(window.assemble(&source, [10.0, 600.0, 1.0, 9.0], [2, 2], |_| true).unwrap());
}

#[test]
fn a_window_is_masked_by_the_holes_in_it_and_by_no_others() {
    let pixel = |col: u32, _: u32| if (100..140).contains(&col) { f32::NAN } else { 5.0 };
    let filter = Filter::Pixels { reach: 2 };
    let source = prepared(InMemory::heights(extent(256, 256, PoleContact::None), pixel), filter);
    let mut window = Window::default();
    let mut window_of = |left: f64, right: f64| {
        let any = window.assemble(&source, [left, right, 20.0, 60.0], [2, 2], |_| true).unwrap();
        (any, window.alpha().is_some())
    };
    // Taps reach two pixels to the right of the one beside a place, and one to its left.
    assert_eq!(window_of(20.0, 97.5), (true, false));
    assert_eq!(window_of(20.0, 98.5), (true, true));
    assert_eq!(window_of(101.0, 137.5), (false, true));
    assert_eq!(window_of(101.0, 138.5), (true, true));
    assert_eq!(window_of(141.0, 200.0), (true, false));
}
