//! Datasets that come, go and are replaced while sessions look at them.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::{Duration, Instant};

use super::*;
use crate::open::newcomer;
use crate::scene::Scene;

fn numbers(selection: &Selection) -> BTreeSet<usize> {
    selection.pages.iter().map(|page| page.dataset).collect()
}

/// The old pages stay on the screen, wherever the view moves to, until the new ones are there.
#[test]
fn a_replaced_dataset_is_drawn_until_the_new_one_is_there() {
    let old = Gated::globe();
    let new = Gated::globe();
    let cache = old.cache(PLENTY, 2);
    let mut session = cache.session();
    let near = view(10.0, 20.0, 3e5, 30.0);
    let before = session.settle(&near);
    cache.insert(new.info.clone(), Arc::clone(&new.archive) as _).unwrap();
    new.gate.allow(Some(0));
    let start = Instant::now();
    for step in 0..20 {
        let aside = view(10.0 + 0.01 * f64::from(step), 20.0, 3e5, 30.0);
        let now = session.update(&aside);
        if start.elapsed() < Session::ADOPT_WITHIN {
            assert_eq!((numbers(&now), now.scene), (BTreeSet::from([0]), before.scene));
            assert!(!now.pages.is_empty());
        }
    }
    new.gate.allow(None);
    let after = loop {
        let now = session.update(&near);
        assert!(!now.pages.is_empty(), "a hole");
        assert_eq!(numbers(&now).len(), 1, "a mixture");
        if now.scene != before.scene {
            break now;
        }
        std::thread::yield_now();
    };
    assert_eq!((numbers(&after), after.missing), (BTreeSet::from([1]), 0));
    assert_eq!(after.pages.len(), before.pages.len());
}

/// What is replaced, and out of sight where the view leapt to, is not shown where it leaps back to, because
/// more was missing elsewhere.
#[test]
fn a_leap_to_and_fro_leaves_no_hole() {
    let globe = Gated::new("globe", fine_globe(), Kind::Height);
    let [old, new] = [(); 2].map(|()| Gated::new("cap", cap(), Kind::Height));
    for dataset in [&globe, &new] {
        // What is wanted is known at once.
        dataset.archive.entries().unwrap();
    }
    let cache = globe.cache(PLENTY, 2);
    cache.insert(old.info.clone(), Arc::clone(&old.archive) as _).unwrap();
    let mut session = cache.session();
    session.look_ahead = false;
    let pole = view(0.0, 88.0, 3e5, 0.0);
    let elsewhere = View { tolerance_px: 0.05, ..view(90.0, -30.0, 1e6, 0.0) };
    let before = session.settle(&pole);
    assert_eq!(numbers(&before), BTreeSet::from([0, 1]));
    let of_cap = before.pages.iter().filter(|page| page.dataset == 1).count();

    globe.gate.allow(Some(0));
    cache.insert(new.info.clone(), Arc::clone(&new.archive) as _).unwrap();
    new.gate.allow(Some(0));
    let start = Instant::now();
    for _ in 0..4 {
        let now = session.update(&pole);
        let there = session.update(&elsewhere);
        let back = session.update(&pole);
        if start.elapsed() < Session::ADOPT_WITHIN {
            assert!(there.missing > of_cap, "{} {of_cap}", there.missing);
            for selection in [now, back] {
                assert_eq!((numbers(&selection), selection.missing), (BTreeSet::from([0, 1]), 0));
            }
        }
    }
    globe.gate.allow(None);
    new.gate.allow(None);
    let after = session.settle(&pole);
    assert_eq!((numbers(&after), after.missing), (BTreeSet::from([0, 2]), 0));
}

/// Nothing is read of what a user has switched off, and it is there again when it is switched on.
#[test]
fn what_is_hidden_is_not_loaded() {
    let globe = Gated::globe();
    let colors = Gated::new("colors", cap(), Kind::Color);
    let cache = globe.cache(PLENTY, 2);
    cache.insert(colors.info.clone(), Arc::clone(&colors.archive) as _).unwrap();
    let mut session = cache.session();
    session.hide(|info| info.name == "colors");
    let near = view(0.0, 85.0, 3e5, 30.0);
    let hidden = session.settle(&near);
    assert_eq!((numbers(&hidden), hidden.missing), (BTreeSet::from([0]), 0));
    assert!(colors.page_reads().is_empty(), "{:?}", colors.page_reads());

    session.hide(|_| false);
    let shown = session.settle(&near);
    assert_eq!((numbers(&shown), shown.missing), (BTreeSet::from([0, 1]), 0));
    session.hide(|info| info.kind == Kind::Height);
    assert_eq!(numbers(&session.settle(&near)), BTreeSet::from([1]));
}

/// What cannot be loaded in time is not waited for: the catalog of now is shown with what there is.
#[test]
fn a_change_is_shown_within_its_time() {
    let (old, new) = (Gated::globe(), Gated::new("globe", globe(), Kind::Height));
    let cache = old.cache(PLENTY, 2);
    let mut session = cache.session();
    let near = view(10.0, 20.0, 3e5, 30.0);
    let before = session.settle(&near);
    cache.insert(new.info.clone(), Arc::clone(&new.archive) as _).unwrap();
    new.gate.allow(Some(0));
    let start = Instant::now();
    while session.update(&near).scene == before.scene {
        std::thread::yield_now();
    }
    assert!(start.elapsed() + Duration::from_millis(100) > Session::ADOPT_WITHIN);
    assert!(session.update(&near).pages.is_empty());
    new.gate.allow(None);
    assert_eq!(session.settle(&near).pages.len(), before.pages.len());
}

/// In one step, and in the place of one dataset that is called alike; and so the other way about.
#[test]
fn the_parts_of_a_group_come_and_go_together() {
    let globe = Gated::globe();
    let cache = globe.cache(PLENTY, 2);
    let part = |part: &str| {
        let name = format!("cap.{part}");
        let one = Gated::new("cap", cap(), Kind::Height);
        let info = DatasetInfo { name, group: Some("cap".to_owned()), ..one.info.clone() };
        (info, Arc::clone(&one.archive) as Arc<dyn PageSource>)
    };
    let one = Gated::new("cap", cap(), Kind::Height);
    let names = || {
        let datasets = cache.datasets();
        datasets.iter().map(|(_, info)| info.name.clone()).collect::<Vec<_>>()
    };
    let session = cache.session();
    cache.insert_all([part("north"), part("south")]).unwrap();
    assert_eq!(names(), ["globe", "cap.north", "cap.south"]);
    cache.insert(one.info.clone(), Arc::clone(&one.archive) as _).unwrap();
    assert_eq!(names(), ["globe", "cap"]);
    cache.insert_all([part("north"), part("south")]).unwrap();
    assert_eq!(names(), ["globe", "cap.north", "cap.south"]);
    cache.insert_all([part("band")]).unwrap();
    assert_eq!(names(), ["globe", "cap.band"]);
    assert!(session.has_news() && cache.remove("cap") && !cache.remove("cap"));
    assert_eq!(names(), ["globe"]);
}

#[test]
fn a_removed_dataset_is_gone_and_its_memory_free() {
    let (globe, cap) = (Gated::globe(), Gated::new("cap", cap(), Kind::Height));
    let cache = globe.cache(PLENTY, 2);
    cache.insert(cap.info.clone(), Arc::clone(&cap.archive) as _).unwrap();
    let mut session = cache.session();
    let pole = view(0.0, 88.0, 3e5, 0.0);
    let both = session.settle(&pole);
    assert_eq!(numbers(&both), BTreeSet::from([0, 1]));
    let of_globe: Vec<_> = both.pages.iter().filter(|page| page.dataset == 0).cloned().collect();
    drop(both);
    assert!(cache.remove("cap") && !cache.remove("cap"));
    let after = session.settle(&pole);
    assert_eq!((numbers(&after), after.datasets.len()), (BTreeSet::from([0]), 1));
    for page in &of_globe {
        assert!(after.pages.iter().any(|now| Arc::ptr_eq(now, page)), "dropped for nothing");
    }
    let kept = of_globe.len();
    drop((of_globe, after));
    assert!(cache.remove("globe"));
    let none = session.settle(&pole);
    assert!(none.pages.is_empty() && none.datasets.is_empty());
    assert_eq!(none.wanted, 0);
    // What was on the screen a moment ago goes, too.
    assert!(kept > 0);
    while cache.stats().pages > 0 {
        std::thread::yield_now();
    }
    assert_eq!(cache.stats().bytes, 0);
}

/// Two datasets are replaced in one step, again and again: whoever looks sees both of before or both
/// of after.
#[test]
fn nobody_sees_a_mixture() {
    let rounds = if std::env::var_os("AREOID_SOAK").is_some() { 1000 } else { 60 };
    let versions = [0, 1].map(|version| {
        [("globe", globe()), ("cap", cap())].map(|(name, grid)| {
            let mut made = Gated::new(name, grid, Kind::Height);
            made.info.priority = version;
            made
        })
    });
    let cache = versions[0][0].cache(PLENTY, 2);
    let one_step = |round: usize| {
        let made = &versions[round % 2];
        let newcomers = made
            .iter()
            .map(|made| newcomer(made.info.clone(), Arc::clone(&made.archive) as _).unwrap());
        cache.engine().change(|_| true, newcomers.collect());
    };
    one_step(0);
    let done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        for number in 0..2 {
            let (cache, done) = (&cache, &done);
            scope.spawn(move || {
                let mut session = cache.session();
                let mut scenes = BTreeSet::new();
                let mut last = 0;
                while !done.load(Relaxed) {
                    let place = 20.0 * f64::from(number);
                    let now = session.update(&view(place, 80.0, 6e5, 10.0));
                    let priorities: BTreeSet<_> =
                        now.datasets.iter().map(|(_, info)| info.priority).collect();
                    assert!(priorities.len() <= 1, "{priorities:?}");
                    for page in &now.pages {
                        assert!(now.datasets.get(page.dataset).is_some());
                    }
                    assert!(now.scene >= last, "back in time");
                    last = now.scene;
                    scenes.insert(now.scene);
                    let all: BTreeSet<_> =
                        cache.datasets().iter().map(|(_, info)| info.priority).collect();
                    assert_eq!(all.len(), 1);
                }
                assert!(scenes.len() > 1, "{scenes:?}");
            });
        }
        let start = Instant::now();
        for round in 1..=rounds {
            one_step(round);
            // At times long enough for sessions to take it over.
            while round % 10 == 0
                && start.elapsed() < Duration::from_millis(10) * u32::try_from(round).unwrap()
            {
                std::thread::yield_now();
            }
        }
        std::thread::sleep(Duration::ZERO);
        let start = Instant::now();
        while start.elapsed() < 2 * Session::ADOPT_WITHIN {
            std::thread::yield_now();
        }
        done.store(true, Relaxed);
    });
    let mut session = cache.session();
    let settled = session.settle(&view(0.0, 88.0, 3e5, 0.0));
    assert_eq!((settled.missing, settled.datasets.len()), (0, 2));
}

/// What a search reads of each dataset is what that says of itself: through many changes, with new terrain under
/// what lies on it, for one root and for several; and in the scenes before, too.
#[test]
fn leaves_say_what_datasets_do() {
    // All around, and 95 columns cannot be halved.
    let pixel_size = [360.0 / 380.0; 2];
    let wide = Outline { origin: [-180.0, 45.0], pixel_size, width: 380, height: 90 };
    let crs = Crs::new(Projection::Geographic, mars().ellipsoid);
    let wide = Gated::new("wide", Grid::from_outline(crs, wide, 66).unwrap().grid, Kind::Color);
    let made = [wide, Gated::globe(), Gated::new("cap", cap(), Kind::Color)];
    let check = |scene: &Scene| {
        for dataset in &scene.datasets {
            let leaf = scene.leaf(dataset.slot as usize);
            assert_eq!((leaf.number, leaf.kind), (dataset.number, dataset.kind));
            let only = match dataset.roots.as_slice() {
                [root] => Some(*root),
                _ => None,
            };
            assert_eq!(leaf.root, only);
            for root in &dataset.roots {
                assert_eq!(leaf.page_bytes(root), dataset.page_bytes(root));
            }
        }
        let several = scene.datasets.iter().filter(|dataset| dataset.roots.len() > 1).count();
        (scene.slots.len(), several)
    };
    let mut scenes = vec![Scene::empty(mars())];
    let mut heights = BTreeSet::new();
    for round in 0..400_usize {
        // Colors first, which lie on the terrain that comes then.
        let made = &made[if round < 80 { round % 2 * 2 } else { round * 7 % 3 }];
        let mut info = made.info.clone();
        // Many at first, and then some less.
        info.name = (round % if round < 200 { 150 } else { 90 }).to_string();
        let newcomer = newcomer(info.clone(), Arc::clone(&made.archive) as _).unwrap();
        let next = scenes[scenes.len() - 1].changed(|other| other.name == info.name, [newcomer]);
        heights.insert(next.radii(1.0).map(|radius| radius.0.to_bits()));
        scenes.push(next);
    }
    let (slots, several): (Vec<usize>, Vec<usize>) = scenes.iter().map(check).unzip();
    let most = [slots, several].map(|all| all.into_iter().max().unwrap());
    assert!(most[0] > 130 && most[1] > 30 && heights.len() == 2, "{most:?} {}", heights.len());
}

/// The tree stays good, and finds what there is, through many changes.
#[test]
fn the_tree_over_datasets_follows_all_changes() {
    let (globe, cap) = (Gated::globe(), Gated::new("cap", cap(), Kind::Height));
    let mut scene = Scene::empty(mars());
    for round in 0..300_usize {
        let made = if round % 3 == 0 { &globe } else { &cap };
        let mut info = made.info.clone();
        info.name = format!("{}-{}", info.name, round % 7);
        let newcomer = newcomer(info.clone(), Arc::clone(&made.archive) as _).unwrap();
        let next = scene.changed(|other| other.name == info.name, [newcomer]);
        // The one before stays what it was.
        for scene in [&next, &scene] {
            assert_eq!(scene.tree.len(), scene.datasets.len());
            assert!(scene.datasets.is_sorted_by_key(|dataset| dataset.number));
            for (place, dataset) in scene.datasets.iter().enumerate() {
                assert_eq!(scene.place(dataset.number), Some(place));
                let bounds = scene.tree.get(dataset.slot).unwrap();
                assert!(dataset.roots.iter().all(|root| bounds.contains(&root.volume.aabb())));
                assert_eq!(scene.slots[dataset.slot as usize], place);
            }
        }
        scene = next;
    }
    assert_eq!(scene.generation, 300);
    assert!(scene.datasets.len() <= 14 && scene.slots.len() <= 14);
}
