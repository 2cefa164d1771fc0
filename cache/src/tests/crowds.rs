//! Views of many datasets, of which not all can be drawn.

use std::collections::BTreeSet;

use super::culling::{region, scene, search};
use super::*;
use crate::found::Found;
use crate::memo::Memo;
use crate::scene::{Newcomer, Scene};
use crate::search::{Hidden, Only, Wish};
use areoid_formats::bvh::Bvh;

/// The wanted pages, by their datasets' names.
fn wanted(scene: &Scene, found: &Found) -> BTreeSet<(String, PageAddress)> {
    let seen = found.wanted.iter().map(|&place| found.seen[place]);
    seen.map(|seen| (scene.datasets[seen.dataset].info.name.clone(), seen.page)).collect()
}

/// Small regions side by side, east to west and then north.
fn regions() -> impl Iterator<Item = Gated> {
    let places = (0..36 * 9).map(|place| (place % 36, place / 36));
    places
        .map(|(col, row)| region(10.0 * f64::from(col) - 180.0, 10.0 * f64::from(row) - 47.0))
        .enumerate()
        .map(|(place, grid)| Gated::new(&place.to_string(), grid, Kind::Height))
}

/// Whatever order they come and go in, a state knows what it has changed, and a search through the tree costs not much more than through one that is
/// built of what there is.
#[test]
fn the_tree_over_datasets_stays_as_good_as_a_fresh_one() {
    let newcomer = |region: &Gated| {
        Newcomer::new(region.info.clone(), Arc::clone(&region.archive) as _).unwrap()
    };
    let regions: Vec<Gated> = regions().filter(|region| !region.entries.is_empty()).collect();
    let (mut worst, mut told) = (0.0_f64, 0);
    let mut scene = Scene::empty(mars());
    let mut step = |before: &Scene, after: Scene| {
        if let Some(changes) = before.changes(&after) {
            let lacks = |one: &Scene, other: &Scene| {
                let gone =
                    one.datasets.iter().filter(|dataset| other.place(dataset.number).is_none());
                gone.map(|dataset| dataset.bounds()).collect::<Vec<_>>()
            };
            let expected = [lacks(before, &after), lacks(&after, before)].concat();
            assert_eq!(changes.collect::<Vec<_>>(), expected);
            told += expected.len();
        }
        let boxes = after.datasets.iter().map(|dataset| (dataset.slot, dataset.bounds()));
        worst = worst.max(after.tree.cost() / Bvh::build(boxes).cost());
        after
    };
    for region in &regions {
        scene = step(&scene, scene.changed(|_| false, [newcomer(region)]));
    }
    for round in 0..600 {
        let (goes, comes) = (&regions[round * 7 % regions.len()], &regions[round % regions.len()]);
        scene = step(&scene, scene.changed(|info| info.name == goes.info.name, []));
        scene = step(&scene, scene.changed(|info| info.name == comes.info.name, [newcomer(comes)]));
    }
    for keeps in (0..regions.len()).rev().step_by(2) {
        scene = step(&scene, scene.changed(|info| info.name == regions[keeps].info.name, []));
    }
    assert!(worst < 1.5, "{worst}");
    assert!(told > 1000, "{told}");
}

/// What is wanted depends on sizes and errors alone, not on the order in which datasets came, which
/// makes the tree over them; and with more room nothing goes.
#[test]
fn the_largest_datasets_come_first_in_whatever_order_they_came() {
    let regions: Vec<Gated> = regions().collect();
    let mut regions: Vec<&Gated> =
        regions.iter().filter(|region| !region.entries.is_empty()).collect();
    let mut scenes = vec![scene(&regions)];
    regions.reverse();
    scenes.push(scene(&regions));
    let lot = |region: &Gated| {
        chance(PageAddress::new(Level(0), region.info.name.parse().unwrap(), 0), 7)
    };
    regions.sort_by(|one, other| lot(one).total_cmp(&lot(other)));
    scenes.push(scene(&regions));

    let view = View { tolerance_px: 0.005, ..view(12.0, 6.0, 3e6, 20.0) };
    let found = |pages: usize| {
        let search = |scene| search(scene, &mut Memo::default(), &view, pages * PAGE);
        let found: Vec<Found> = scenes.iter().map(search).collect();
        let first = wanted(&scenes[0], &found[0]);
        for (scene, other) in scenes.iter().zip(&found) {
            assert_eq!(wanted(scene, other), first, "{pages}");
            assert_eq!(other.tolerance_px, found[0].tolerance_px, "{pages}");
        }
        (first, found[0].tolerance_px)
    };
    let (mut before, mut tolerance_px) = found(0);
    for pages in 1..=50 {
        let now = found(pages);
        assert!(now.0.len() == pages && now.0.is_superset(&before), "{pages}");
        assert!(now.1 < tolerance_px, "{pages}");
        (before, tolerance_px) = now;
    }
    // None of them is refined yet: what is not drawn is off by more.
    assert!(tolerance_px > 20.0, "{tolerance_px}");
    let finer = [80, 120, 1000].map(|pages| found(pages).0.len());
    assert!(finer.is_sorted() && finer[0] > 50 && finer[2] > finer[0], "{finer:?}");
}

/// However much of a crowd is in sight of one view or of several, the tree over it leaves out nothing that looking at
/// every dataset finds, and adds nothing.
#[test]
fn the_tree_finds_what_looking_at_each_does() {
    let regions: Vec<Gated> = regions().filter(|region| !region.entries.is_empty()).collect();
    let scene = scene(&regions.iter().collect::<Vec<_>>());
    // What lies side by side on the ground does so in memory.
    assert!(scene.tree.clone().renumber().is_sorted());
    let places: Vec<usize> = (0..scene.datasets.len()).collect();
    let lot = |number: u32, salt: u64| chance(PageAddress::new(Level(1), number, 0), salt);
    let (mut memo, hidden) = (Memo::default(), &Hidden::default());
    let (mut most, mut least, mut visited) = (0, usize::MAX, [0, 0]);
    for number in 0..60 {
        let one = |salt: u64| {
            let altitude = 10_f64.powf(4.0 + 3.3 * lot(number, salt));
            let place =
                (360.0 * lot(number, salt + 1) - 180.0, 80.0 * lot(number, salt + 2) - 40.0);
            let pitch = 90.0 * lot(number, salt + 3).powi(2);
            View { tolerance_px: 20.0, ..view(place.0, place.1, altitude, pitch) }
        };
        let views = match number % 3 {
            0 => vec![one(10)],
            // An overview beside another, and a wall.
            1 => vec![one(10), one(20)],
            _ => (-2..=2)
                .map(|tile| {
                    let view = one(10);
                    let turn = DMat3::from_rotation_y(0.6 * f64::from(tile));
                    View { orientation: view.orientation * turn, ..view }
                })
                .collect(),
        };
        for exaggeration in [1.0, 3.0] {
            let only = Only { places: &places, tolerance_px: 0.0 };
            let [tree, each] = [None, Some(only)].map(|only| {
                let mut found = Found::default();
                let (views, allowance) = (views.as_slice(), usize::MAX);
                let wish = Wish { views, exaggeration, hidden, allowance, blends: false, only };
                crate::search::search(&scene, &mut memo, wish, &mut found);
                found
            });
            assert_eq!(wanted(&scene, &tree), wanted(&scene, &each), "{number} {exaggeration}");
            assert_eq!(tree.tolerance_px, each.tolerance_px);
            (most, least) = (most.max(tree.roots.len()), least.min(tree.roots.len()));
            visited = [visited[0] + tree.visited, visited[1] + each.visited];
        }
    }
    assert!(least < 10 && most > 100, "{least} {most}");
    assert!(visited[0] < visited[1], "{visited:?}");
}
