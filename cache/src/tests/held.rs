//! Pages that a selection holds, against sets.

use std::collections::BTreeSet;

use super::*;
use crate::held::Held;
use crate::scene::{Newcomer, Scene};
use crate::selection::ResidentPage;
use crate::store::{Limits, Outcome, PageName, Request, Store, Work};
use areoid_formats::page::{Page, Texels};

const BYTES: usize = 66 * 66 * 5;

/// Loads a page, and says which had to go for it.
fn load(store: &mut Store, scene: &Scene, entry: &PageEntry, names: &[PageName]) -> Vec<usize> {
    let there = |store: &Store| -> BTreeSet<usize> {
        (0..names.len()).filter(|&page| store.holds(names[page])).collect()
    };
    let before = there(store);
    let dataset = Arc::clone(&scene.datasets[0]);
    let name = PageName { dataset: dataset.number, page: entry.page };
    let work = Work::Texels(name);
    store.replace_requests(0, vec![Request { work, dataset, entry: *entry, bytes: BYTES }]);
    if let Some(request) = store.next() {
        let texels = Texels::Height(vec![0.0; 66 * 66]);
        let page = Page::new(66, texels, Some(vec![255; 66 * 66]));
        let page = ResidentPage { dataset: name.dataset, entry: *entry, page };
        store.finish(request.work, Outcome::Loaded(Some(Arc::new(page))));
    }
    before.difference(&there(store)).copied().collect()
}

/// What is shown is found and stays, what is not goes in the order in which it was let go of, and what is wanted
/// for the first time is counted.
#[test]
fn what_is_held_stays_and_what_is_not_goes_in_turn() {
    let planet = Gated::globe();
    let newcomer = Newcomer::new(planet.info.clone(), Arc::clone(&planet.archive) as _).unwrap();
    let scene = Scene::empty(mars()).changed(|_| false, [newcomer]);
    let number = scene.datasets[0].number;
    let entries = &planet.entries[..12];
    let names: Vec<PageName> =
        entries.iter().map(|entry| PageName { dataset: number, page: entry.page }).collect();

    let limits = Limits { loads: 1, bytes: usize::MAX };
    let mut store = Store::new(8 * BYTES, limits);
    store.add_session(0);
    let mut held = Held::default();
    let mut used = [0; 12];
    let (mut shown, mut wanted) = (BTreeSet::new(), BTreeSet::new());
    let (mut first, mut first_there, mut gone) = (0, 0, 0);
    let mut state = 1_u64;
    let mut chance = |below: usize| {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        usize::try_from(state >> 33).unwrap() % below
    };
    let mut selection = Vec::new();
    for step in 1..=4000 {
        let page = chance(12);
        let is_there = store.holds(names[page]);
        for victim in load(&mut store, &scene, &entries[page], &names) {
            assert!(!shown.contains(&victim), "step {step}: {victim} is shown");
            let others = (0..12).filter(|&page| store.holds(names[page]) && !shown.contains(&page));
            let oldest = others.filter(|&other| other != page).map(|page| used[page]).min();
            assert!(oldest.is_none_or(|oldest| used[victim] <= oldest), "step {step}: {victim}");
            gone += 1;
        }
        if !is_there && store.holds(names[page]) {
            used[page] = step;
        }

        // Mostly the same as before.
        let mut next: BTreeSet<usize> = wanted.clone();
        for _ in 0..chance(3) {
            let page = chance(12);
            if !next.remove(&page) && next.len() < 5 {
                next.insert(page);
            }
        }
        let there: BTreeSet<usize> =
            next.iter().copied().filter(|&page| store.holds(names[page])).collect();
        held.fetch();
        let found: Vec<_> =
            next.iter().filter_map(|&page| held.get(names[page], &mut store)).collect();
        let found_pages: BTreeSet<_> = found.iter().map(|page| page.entry.page).collect();
        assert_eq!(found_pages, there.iter().map(|&page| entries[page].page).collect());
        first += next.difference(&wanted).count() as u64;
        first_there += next.difference(&wanted).filter(|page| there.contains(*page)).count() as u64;
        held.renew(found.iter(), next.iter().map(|&page| names[page]), &mut store);
        shown.difference(&there).for_each(|&page| used[page] = step);
        there.iter().for_each(|&page| used[page] = step);
        (shown, wanted, selection) = (there, next, found);
    }
    assert!(gone > 500 && first > 1000, "{gone} {first}");
    assert_eq!((store.stats.first_wanted, store.stats.first_resident), (first, first_there));

    // Nothing is kept but what is shown.
    held.renew([].iter(), [].into_iter(), &mut store);
    assert!(selection.iter().all(|page| Arc::strong_count(page) == 2), "the table's and this one");
}
