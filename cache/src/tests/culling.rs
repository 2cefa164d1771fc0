//! The search against brute force: every point that can be seen is under a wanted page, and the
//! page shows it as well as asked for; and where a coarser one still has to do with it, it is there.

use std::sync::LazyLock;

use areoid_formats::address::PageAddress;
use areoid_formats::grid::TexelPoint;
use areoid_formats::pyramid::{Extent, PoleContact};
use areoid_formats::units::Degrees;
use areoid_preprocess::resample::target::{Split, split};
use proptest::prelude::*;

use super::*;
use crate::found::{Found, Seen};
use crate::memo::Memo;
use crate::scene::Newcomer;
use crate::scene::Scene;
use crate::search::{Hidden, Wish};

pub(super) fn scene(datasets: &[&Gated]) -> Scene {
    let newcomers = datasets.iter().map(|dataset| {
        // Brings the whole index into memory.
        dataset.archive.entries().unwrap();
        Newcomer::new(dataset.info.clone(), Arc::clone(&dataset.archive) as _).unwrap()
    });
    Scene::empty(mars()).changed(|_| false, newcomers)
}

pub(super) fn search(scene: &Scene, memo: &mut Memo, view: &View, allowance: usize) -> Found {
    search_exaggerated(scene, memo, (view, 1.0), allowance)
}

fn search_exaggerated(
    scene: &Scene,
    memo: &mut Memo,
    (view, exaggeration): (&View, f64),
    allowance: usize,
) -> Found {
    search_all(scene, memo, (std::slice::from_ref(view), exaggeration), allowance)
}

fn search_all(
    scene: &Scene,
    memo: &mut Memo,
    (views, exaggeration): (&[View], f64),
    allowance: usize,
) -> Found {
    let (mut found, hidden) = (Found::default(), &Hidden::default());
    let wish = Wish { views, exaggeration, hidden, allowance, blends: true, only: None };
    crate::search::search(scene, memo, wish, &mut found);
    found
}

/// Points of a page's shell, heights taken so many times.
fn points(dataset: &Gated, entry: &PageEntry, steps: u32, exaggeration: f64) -> Vec<DVec3> {
    let (grid, page) = (&dataset.info.grid, entry.page);
    let interior = f64::from(grid.pyramid().interior());
    let (rows, cols) = grid.pyramid().interior_size(page);
    let mut points = Vec::new();
    for step in 0..(steps + 1).pow(2) {
        let (row, col) = (step / (steps + 1), step % (steps + 1));
        let [row, col] = [row, col].map(|step| f64::from(step) / f64::from(steps));
        let texel = TexelPoint {
            x: f64::from(page.col) * interior + col * f64::from(cols),
            y: f64::from(page.row) * interior + row * f64::from(rows),
        };
        let position = grid.geographic_from_texel(page.level, texel).unwrap();
        for height in [entry.lowest, entry.highest] {
            let height = Meters(exaggeration * f64::from(height));
            points.push(mars().ellipsoid.cartesian_from_geographic(position, height));
        }
    }
    points
}

/// Whether the body below all terrain stands between eye and point.
fn hidden(eye: DVec3, point: DVec3, radius: f64) -> bool {
    let sight = point - eye;
    let nearest = (-eye.dot(sight) / sight.length_squared()).clamp(0.0, 1.0);
    (eye + nearest * sight).length() < radius
}

/// The radius of the body below all terrain that is so many times as high.
fn inner(datasets: &[&Gated], exaggeration: f64) -> f64 {
    let entries = datasets.iter().flat_map(|dataset| &dataset.entries);
    let lowest = entries.map(|entry| f64::from(entry.lowest)).fold(0.0, f64::min);
    mars().ellipsoid.b().0 + exaggeration * lowest
}

/// Whether a point is in the picture and not behind the body, which is `inner` large.
fn is_seen(view: &View, inner: f64, point: DVec3) -> bool {
    let up = (view.vertical_fov.0 / 2.0).tan();
    let right = up * f64::from(view.viewport[0]) / f64::from(view.viewport[1]);
    let seen = view.orientation.transpose() * (point - view.eye);
    let ahead = -seen.z;
    let in_frustum = ahead > 0.0 && seen.x.abs() <= right * ahead && seen.y.abs() <= up * ahead;
    in_frustum && !hidden(view.eye, point, inner)
}

fn wanted_over(found: &Found, dataset: usize, page: PageAddress) -> Option<usize> {
    found.wanted.iter().copied().find(|&place| {
        let seen = &found.seen[place];
        let mut ancestor = Some(page);
        while let Some(page) = ancestor {
            if seen.dataset == dataset && seen.page == page {
                return true;
            }
            ancestor = page.parent();
        }
        false
    })
}

/// Checks a view of terrain that is so many times as high; returns the points seen.
fn check(datasets: &[&Gated], scene: &Scene, view: &View, exaggeration: f64) -> usize {
    let (mut memo, inner) = (Memo::default(), inner(datasets, exaggeration));
    // What is remembered of other terrain is of no account.
    search_exaggerated(scene, &mut memo, (view, exaggeration + 1.0), usize::MAX);
    let found = search_exaggerated(scene, &mut memo, (view, exaggeration), usize::MAX);
    assert!(found.unindexed.is_empty());
    let up = (view.vertical_fov.0 / 2.0).tan();
    let scale = f64::from(view.viewport[1]) / (2.0 * up);
    let mut seen_points = 0;
    for (place, dataset) in datasets.iter().enumerate() {
        let finest = dataset.info.grid.pyramid().finest();
        for entry in dataset.entries.iter().filter(|entry| entry.page.level == finest) {
            for point in points(dataset, entry, 4, exaggeration) {
                if !is_seen(view, inner, point) {
                    continue;
                }
                seen_points += 1;
                let Some(wanted) = wanted_over(&found, place, entry.page) else {
                    panic!("{point} of {} is seen and culled", entry.page);
                };
                let wanted = &found.seen[wanted];
                let sight = point - view.eye;
                let cosine = sight.normalize().dot(view.axis());
                let pixels = |seen: &Seen| {
                    let bound = datasets[seen.dataset].entry(seen.page).bound;
                    let bound = exaggeration.max(1.0) * f64::from(bound);
                    bound * scale / (sight.length() * cosine * cosine)
                };
                let error = pixels(wanted);
                assert!(error <= view.tolerance_px * (1.0 + 1e-9), "{error} px at {point}");
                let mut above = wanted.parent;
                while let Some(place) = above {
                    let seen = &found.seen[place];
                    let shows = pixels(seen) < View::BLENDED * view.tolerance_px * (1.0 - 1e-9);
                    assert!(!shows || found.beneath.contains(&place), "{}", seen.page);
                    above = seen.parent;
                }
            }
        }
    }
    for place in &found.wanted {
        assert!(
            found.seen[*place].pixels <= view.tolerance_px || {
                let seen = &found.seen[*place];
                seen.page.level == scene.datasets[seen.dataset].info.grid.pyramid().finest()
            }
        );
    }
    seen_points
}

#[test]
fn named_views_cull_nothing_that_is_seen() {
    let (globe, cap) = (Gated::globe(), Gated::new("cap", cap(), Kind::Height));
    let scene = scene(&[&globe, &cap]);
    for (longitude, latitude, altitude, pitch) in [
        (0.0, 0.0, 1e7, 0.0),
        (180.0, 10.0, 3e5, 70.0),
        (-180.0, 0.0, 3e4, 85.0),
        (0.0, 90.0, 5e5, 0.0),
        (77.0, -90.0, 5e5, 30.0),
        (30.0, 85.0, 2e4, 80.0),
        (30.0, 40.0, 1e4, 100.0),
    ] {
        let seen = check(&[&globe, &cap], &scene, &view(longitude, latitude, altitude, pitch), 1.0);
        assert!(seen > 0 || pitch > 90.0, "{longitude} {latitude}");
    }
}

/// From low over a plain, peaks behind the horizon of the reference surface are still seen.
#[test]
fn peaks_behind_the_horizon_are_wanted() {
    let globe = Gated::globe();
    let scene = scene(&[&globe]);
    let sphere = mars().ellipsoid.b().0;
    let mut beyond = 0;
    for heading in 0..12 {
        let view = view(30.0 * f64::from(heading), 5.0, 2e3, 90.0);
        check(&[&globe], &scene, &view, 1.0);
        let found = search(&scene, &mut Memo::default(), &view, usize::MAX);
        let horizon = (view.eye.length_squared() - sphere * sphere).sqrt();
        beyond +=
            found.wanted.iter().filter(|&&place| found.seen[place].distance > horizon).count();
    }
    assert!(beyond > 0);
}

/// The globe and the cap, made once.
fn both() -> (&'static Gated, &'static Gated) {
    static BOTH: LazyLock<(Gated, Gated)> =
        LazyLock::new(|| (Gated::globe(), Gated::new("cap", cap(), Kind::Height)));
    (&BOTH.0, &BOTH.1)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn no_view_culls_what_is_seen(
        longitude in -180.0..180.0,
        latitude in -90.0..90.0,
        altitude in 3.5..7.3_f64,
        pitch in 0.0..100.0,
        fov in 5.0..110.0,
        tolerance_px in 0.2..50.0,
        exaggeration in prop_oneof![Just(1.0), 0.0..1.0, 1.0..20.0],
    ) {
        let (globe, cap) = both();
        let scene = scene(&[globe, cap]);
        let view = View {
            vertical_fov: Degrees(fov).into(),
            tolerance_px,
            ..view(longitude, latitude, 10.0_f64.powf(altitude), pitch)
        };
        check(&[globe, cap], &scene, &view, exaggeration);
    }

    /// Whichever of them the body is in the way of.
    #[test]
    fn two_views_cull_nothing_that_either_sees(
        places in prop::array::uniform2((-180.0..180.0, -90.0..90.0, 3.5..7.3_f64, 0.0..100.0)),
        tolerance_px in 0.2..50.0,
    ) {
        let (globe, cap) = both();
        let (scene, inner) = (scene(&[globe, cap]), inner(&[globe, cap], 1.0));
        let views = places.map(|(longitude, latitude, altitude, pitch)| View {
            tolerance_px,
            ..view(longitude, latitude, 10.0_f64.powf(altitude), pitch)
        });
        let found = search_all(&scene, &mut Memo::default(), (&views, 1.0), usize::MAX);
        for (place, dataset) in [globe, cap].into_iter().enumerate() {
            let finest = dataset.info.grid.pyramid().finest();
            for entry in dataset.entries.iter().filter(|entry| entry.page.level == finest) {
                let mut points = points(dataset, entry, 4, 1.0).into_iter();
                let is_seen =
                    points.any(|point| views.iter().any(|view| is_seen(view, inner, point)));
                let is_wanted = wanted_over(&found, place, entry.page).is_some();
                prop_assert!(!is_seen || is_wanted, "{}", entry.page);
            }
        }
    }
}

/// A map of 5 degrees on a side.
pub(super) fn region(west: f64, south: f64) -> Grid {
    let (origin, pixel_size) = ([west, south + 5.0], [5.0 / 128.0; 2]);
    let outline = Outline { origin, pixel_size, width: 128, height: 128 };
    let crs = Crs::new(Projection::Geographic, mars().ellipsoid);
    Grid::from_outline(crs, outline, 66).unwrap().grid
}

/// Where terrain is not as high as the boxes of the tree over its datasets say, none of them is missed.
#[test]
fn exaggerated_datasets_are_found() {
    let regions: Vec<Gated> = (0..72)
        .map(|place| {
            region(10.0 * f64::from(place % 36) - 180.0, 40.0 * f64::from(place / 36) - 20.0)
        })
        .enumerate()
        .map(|(place, grid)| Gated::new(&place.to_string(), grid, Kind::Height))
        .collect();
    let regions: Vec<&Gated> = regions.iter().filter(|region| !region.entries.is_empty()).collect();
    let scene = scene(&regions);
    let mut seen = Vec::new();
    for exaggeration in [0.0, 1.0, 5.0, 1000.0] {
        let around = (0..24).map(|step| {
            let longitude = 15.0 * f64::from(step) + 3.0;
            let [high, low] = [3e6, 5e5].map(|altitude| view(longitude, -10.0, altitude, 30.0));
            let up = view(longitude, 9.0, 3e4, 125.0);
            [high, low, up]
                .iter()
                .map(|view| check(&regions, &scene, view, exaggeration))
                .sum::<usize>()
        });
        seen.push(around.sum::<usize>());
    }
    assert!(seen[0] > 0 && seen.is_sorted_by(|one, next| one < next), "{seen:?}");
}

/// What is seen of a page is at least as far as its sight says, along the eye's axis too; and of some
/// pages not much farther.
#[test]
fn what_is_seen_is_no_nearer_than_its_sight() {
    let (globe, cap) = both();
    let scene = scene(&[globe, cap]);
    let inner = inner(&[globe, cap], 1.0);
    let (mut seen, mut tightest) = (0, f64::INFINITY);
    for step in 0..60_u32 {
        let chance = |salt| chance(PageAddress::new(Level(0), step, 1), salt);
        let view = View {
            vertical_fov: Degrees(10.0 + 90.0 * chance(11)).into(),
            ..view(
                360.0 * chance(12),
                180.0 * chance(13) - 90.0,
                10.0_f64.powf(3.5 + 3.5 * chance(14)),
                95.0 * chance(15),
            )
        };
        let lens = crate::view::Lens::new(&view, scene.radii(1.0));
        for (place, dataset) in [globe, cap].into_iter().enumerate() {
            for entry in &dataset.entries {
                let sight = lens.sight(&scene.datasets[place].node(entry, 1.0).volume);
                for point in points(dataset, entry, 4, 1.0) {
                    if !is_seen(&view, inner, point) {
                        continue;
                    }
                    seen += 1;
                    let line = point - view.eye;
                    let (distance, cosine) = (line.length(), line.normalize().dot(view.axis()));
                    let reach = distance * cosine * cosine;
                    assert!(sight.distance <= distance * (1.0 + 1e-9), "{} {point}", entry.page);
                    assert!(sight.reach <= reach * (1.0 + 1e-9), "{} {point}", entry.page);
                    tightest = tightest.min(reach / sight.reach);
                }
            }
        }
    }
    assert!(seen > 10_000 && tightest < 1.01, "{seen} points, {tightest}");
}

#[test]
fn an_allowance_raises_the_tolerance_to_what_fits() {
    let globe = Gated::globe();
    let scene = scene(&[&globe]);
    let view = view(10.0, 20.0, 4e5, 60.0);
    let free = search(&scene, &mut Memo::default(), &view, usize::MAX);
    assert_eq!(free.tolerance_px, 1.0);
    let page = 66 * 66 * 4;
    let mut last = (f64::INFINITY, 0);
    for pages in [1, 3, 5, 9, 14, free.seen.len()] {
        let found = search(&scene, &mut Memo::default(), &view, pages * page);
        assert!(found.seen.len() <= pages);
        assert!(found.tolerance_px <= last.0 && found.seen.len() >= last.1, "{pages}");
        let worst = found.wanted.iter().map(|&place| found.seen[place]);
        let finest = globe.info.grid.pyramid().finest();
        for seen in worst.filter(|seen| seen.page.level < finest) {
            assert!(seen.pixels <= found.tolerance_px);
        }
        last = (found.tolerance_px, found.seen.len());
    }
    assert_eq!(last, (1.0, free.seen.len()));
    let none = search(&scene, &mut Memo::default(), &view, page - 1);
    // What is not drawn at all is off by its own size.
    assert!(none.seen.is_empty() && none.tolerance_px > 1000.0, "{}", none.tolerance_px);
}

/// Colors follow their texels' size on the screen, down to the level whose bound says that the
/// finer ones look the same.
#[test]
fn colors_stop_where_the_bound_says_so() {
    let colors = Gated::new("color", globe(), Kind::Color);
    let scene = scene(&[&colors]);
    let levels = |altitude| {
        let view = view(10.0, 20.0, altitude, 0.0);
        let found = search(&scene, &mut Memo::default(), &view, usize::MAX);
        let levels = found.wanted.iter().map(|&place| found.seen[place].page.level.0);
        levels.max().unwrap()
    };
    assert_eq!((levels(1e9), levels(1e8), levels(1e5)), (0, 1, 3));
}

#[test]
fn what_is_remembered_changes_nothing() {
    let globe = Gated::globe();
    let scene = scene(&[&globe]);
    let mut memo = Memo::default();
    for step in 0..40 {
        let view = view(9.0 * f64::from(step), 30.0, 2e5, 75.0);
        let remembered = search(&scene, &mut memo, &view, usize::MAX);
        let fresh = search(&scene, &mut Memo::default(), &view, usize::MAX);
        assert_eq!(remembered.wanted, fresh.wanted);
        assert_eq!((remembered.visited, remembered.culled), (fresh.visited, fresh.culled));
    }
}

/// 2,700 pages: of the wanted ones, few have no point in sight at all.
#[test]
#[expect(clippy::print_stdout, reason = "figures for whoever asks with --nocapture")]
fn searches_want_little_more_than_is_seen() {
    let (globe, cap) =
        (Gated::new("globe", fine_globe(), Kind::Height), Gated::new("cap", cap(), Kind::Height));
    let (datasets, scene) = ([&globe, &cap], scene(&[&globe, &cap]));
    let inner = inner(&datasets, 1.0);
    let (mut all, mut needed) = (0, 0);
    for (name, view) in [
        ("globe", view(0.0, 0.0, 1e7, 0.0)),
        ("near", view(30.0, 50.0, 4e5, 20.0)),
        ("horizon", view(0.0, 0.0, 2e4, 80.0)),
        ("pole", view(0.0, 89.9, 2e4, 80.0)),
    ] {
        let mut memo = Memo::default();
        let start = std::time::Instant::now();
        let found = search(&scene, &mut memo, &view, usize::MAX);
        let cold = start.elapsed();
        let start = std::time::Instant::now();
        for _ in 0..20 {
            search(&scene, &mut memo, &view, usize::MAX);
        }
        let warm = start.elapsed() / 20;
        let in_sight = |place: &usize| {
            let seen = &found.seen[*place];
            let dataset = datasets[seen.dataset];
            let mut points = points(dataset, dataset.entry(seen.page), 32, 1.0).into_iter();
            points.any(|point| is_seen(&view, inner, point))
        };
        let seen = found.wanted.iter().filter(|place| in_sight(place)).count();
        let (visited, wanted) = (found.visited, found.wanted.len());
        println!(
            "{name}: {visited} visited, {wanted} wanted, {seen} in sight, {cold:?} cold, {warm:?} warm"
        );
        (all, needed) = (all + wanted, needed + seen);
    }
    assert!(all as f64 <= 1.5 * f64::from(u32::try_from(needed).unwrap()), "{all} for {needed}");
}

/// A globe on its own grid, and the band and the caps that it is split into.
fn split_globe() -> (Grid, [Grid; 3]) {
    let globe = fine_globe();
    let (crs, placement) = (*globe.crs(), globe.placement());
    let Split { rows, north, south } = split(&placement, 66).unwrap();
    let extent = Extent {
        height: rows.end - rows.start,
        north: PoleContact::None,
        south: PoleContact::None,
        ..placement.extent()
    };
    let [left, top] = placement.origin;
    let origin = [left, top - f64::from(rows.start) * placement.pixel_size[1]];
    let band = Grid::new(crs, origin, placement.pixel_size, extent, 66).unwrap();
    (globe, [band, north, south])
}

/// Law 6: views of a pole of a split globe need little more pages than those of the equator, from
/// wherever: those of the globe on one grid need many times as many.
#[test]
#[expect(clippy::print_stdout, reason = "figures for whoever asks with --nocapture")]
fn poles_of_a_split_globe_need_little_more_pages_than_the_equator() {
    let (globe, parts) = split_globe();
    let globe = Gated::new("globe", globe, Kind::Height);
    let names = ["band", "north", "south"];
    let parts: Vec<Gated> = names
        .into_iter()
        .zip(parts)
        .map(|(name, grid)| Gated::new(name, grid, Kind::Height))
        .collect();
    let split = scene(&parts.iter().collect::<Vec<_>>());
    let native = scene(&[&globe]);
    // From many places, because it is chance where pages end.
    let wanted = |scene: &Scene, latitude: f64, altitude: f64| {
        let one = |turn: i32| {
            let offset = f64::from(turn % 7 - 3);
            let latitude = if latitude.abs() > 80.0 {
                latitude - (offset.abs() + 0.5).copysign(latitude)
            } else {
                latitude + offset
            };
            let view = view(10.3 + 17.0 * f64::from(turn), latitude, altitude, 0.0);
            search(scene, &mut Memo::default(), &view, usize::MAX).wanted.len()
        };
        (0..21).map(one).sum::<usize>() as f64
    };
    let (mut all, mut before) = ([0.0; 4], 0.0);
    for altitude in [3e4, 6e4, 1.2e5, 2e5, 3e5, 5e5, 8e5, 1.5e6] {
        let at = [0.0, 90.0, -90.0, 60.0].map(|latitude| wanted(&split, latitude, altitude));
        let native = wanted(&native, 90.0, altitude);
        println!("{altitude}: {at:?} at the equator, the poles and 60; {native} on one grid");
        all = std::array::from_fn(|place| all[place] + at[place]);
        before += native;
    }
    println!("{all:?}, {before} on one grid");
    let [equator, north, south, _] = all;
    assert!(north <= 1.5 * equator && south <= 1.5 * equator, "{all:?}");
    assert!(before > 3.0 * equator, "{before} for {equator}");
}
