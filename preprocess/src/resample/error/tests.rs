#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the rasters drawn are small, and their values are chosen"
)]

mod rig;

use areoid_formats::grid::{Grid, Placement};
use areoid_formats::page::Page;
use areoid_formats::projection::{MapPoint, Pole};
use proptest::prelude::*;

use super::*;
use crate::build::Leaves as _;
use crate::mosaic::Layout;
use crate::resample::kernel::{Kernel, RangeLimit};
use crate::resample::target::TargetMap;
use crate::resample::truth::SourcePixels;
use crate::verify::verify;

use self::rig::*;

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
