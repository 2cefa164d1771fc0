//! Loads, budget, pins, failures: what sessions see while pages come and go.

use std::collections::HashSet;
use std::sync::Barrier;
use std::time::Duration;

use tokio::time::advance;

use super::*;
use crate::open::newcomer;
use crate::scene::Scene;
use crate::store::{Limits, Outcome, PageName, Request, Store, Work};

const PLENTY: usize = 64 << 20;
/// Decoded bytes of a page.
const PAGE: usize = 66 * 66 * 4;

/// Wanted pages of a settled selection and all of their ancestors.
fn with_ancestors(selection: &Selection) -> HashSet<PageAddress> {
    let mut all = HashSet::new();
    for page in &selection.pages {
        let mut next = Some(page.entry.page);
        while let Some(page) = next {
            all.insert(page);
            next = page.parent();
        }
    }
    all
}

fn addresses(selection: &Selection) -> Vec<PageAddress> {
    selection.pages.iter().map(|page| page.entry.page).collect()
}

#[test]
fn an_update_never_waits_for_a_read() {
    let globe = Gated::new("globe", globe(), Kind::Height);
    let cache = globe.cache(PLENTY, 2);
    let mut session = cache.session();
    globe.gate.allow(Some(0));
    let near = view(10.0, 20.0, 3e5, 30.0);
    // Loads are stuck in their reads from here on, and updates go on.
    for step in 0..50 {
        let selection = session.update(&view(10.0 + f64::from(step), 20.0, 3e5, 30.0));
        assert!(selection.pages.is_empty() && selection.missing > 0);
    }
    globe.gate.allow(None);
    let settled = session.settle(&near);
    assert!(settled.missing == 0 && settled.failed.is_empty());
    assert_eq!(settled.pages.len(), settled.wanted);
}

#[test]
fn an_update_never_waits_for_a_lock() {
    let globe = Gated::new("globe", globe(), Kind::Height);
    let cache = globe.cache(PLENTY, 2);
    let mut session = cache.session();
    let near = view(10.0, 20.0, 3e5, 30.0);
    let settled = session.settle(&near);
    let repeated = {
        let _held = cache.engine().shared().store();
        session.update(&view(100.0, 20.0, 3e5, 30.0))
    };
    assert!(Arc::ptr_eq(&settled, &repeated));
    assert_eq!(cache.stats().repeated, 1);
}

#[test]
fn the_best_ancestor_stands_in() {
    let globe = Gated::new("globe", globe(), Kind::Height);
    let cache = globe.cache(PLENTY, 1);
    let mut session = cache.session();
    let near = view(10.0, 20.0, 3e5, 30.0);
    let target = session.settle(&near);
    drop(session);
    drop(cache);

    let cache = globe.cache(PLENTY, 1);
    let mut session = cache.session();
    globe.gate.allow(Some(0));
    let empty = session.update(&near);
    assert!(empty.pages.is_empty() && empty.error_px.is_infinite());
    let (mut last, mut worst_px) = (empty, 0.0_f64);
    while last.missing > 0 {
        globe.gate.allow(Some(1));
        while !session.has_news() {
            std::thread::yield_now();
        }
        // A page may come at any moment: what is there before the update must be in its answer.
        let lineage = |page: PageAddress| std::iter::successors(Some(page), |page| page.parent());
        let held: Vec<_> = target
            .pages
            .iter()
            .map(|wanted| {
                let store = cache.engine().shared().store();
                let holds = |page: &PageAddress| store.holds(PageName { dataset: 0, page: *page });
                (wanted.entry.page, lineage(wanted.entry.page).find(holds))
            })
            .collect();
        let now = loop {
            let repeated = cache.stats().repeated;
            let now = session.update(&near);
            if cache.stats().repeated == repeated {
                break now;
            }
            // The tables were in use, and the last selection came again.
            std::thread::yield_now();
        };
        let pages: HashSet<_> = addresses(&now).into_iter().collect();
        assert_eq!(pages.len(), now.pages.len());
        for (wanted, finest) in held {
            let Some(finest) = finest else { continue };
            let shown = lineage(wanted).find(|page| pages.contains(page));
            assert!(shown.is_some_and(|shown| shown.level >= finest.level), "{wanted}");
        }
        // Coarse before fine.
        assert!(now.pages.is_sorted_by_key(|page| page.entry.page.level));
        assert!(now.generation >= last.generation);
        if addresses(&now) != addresses(&last) {
            assert!(now.generation > last.generation);
        }
        assert!(now.error_px <= last.error_px, "{} after {}", now.error_px, last.error_px);
        if now.error_px.is_finite() {
            worst_px = worst_px.max(now.error_px);
        }
        last = now;
    }
    assert_eq!(addresses(&last), addresses(&target));
    assert_eq!(last.error_px, target.error_px);
    let tolerance = near.tolerance_px;
    assert!(last.error_px <= tolerance && worst_px > tolerance, "{} {worst_px}", last.error_px);
    let again = session.update(&near);
    assert_eq!(again.generation, last.generation);
}

#[test]
fn many_sessions_read_a_page_once() {
    let globe = Gated::new("globe", globe(), Kind::Height);
    let cache = globe.cache(PLENTY, 4);
    let barrier = Barrier::new(8);
    std::thread::scope(|scope| {
        for number in 0..8 {
            let (cache, barrier) = (&cache, &barrier);
            scope.spawn(move || {
                let mut session = cache.session();
                barrier.wait();
                for step in 0..6 {
                    let step = f64::from((step + number) % 6);
                    let settled = session.settle(&view(20.0 * step, 20.0, 3e5, 40.0));
                    assert_eq!(settled.missing, 0);
                }
            });
        }
    });
    // A page that all have turned away from may be given up between its read and its decoding, and
    // be read anew for the next who wants it; but none is loaded twice.
    let reads: usize = globe.page_reads().values().sum();
    let stats = cache.stats();
    assert_eq!((stats.errors, stats.evictions), (0, 0));
    assert_eq!(stats.loads, stats.pages as u64);
    assert!(reads as u64 <= stats.loads + stats.cancelled, "{reads} reads: {stats:?}");
    assert_eq!(stats.reserved_bytes, 0);
}

#[test]
fn only_what_the_view_needs_is_read() {
    let globe = Gated::new("globe", globe(), Kind::Height);
    let cache = globe.cache(PLENTY, 1);
    let mut session = cache.session();
    globe.gate.allow(Some(0));
    // The first load is that of the root, which both need, and it is stuck.
    session.update(&view(-100.0, -20.0, 3e5, 40.0));
    session.update(&view(-120.0, -60.0, 3e5, 40.0));
    let near = view(10.0, 20.0, 3e5, 30.0);
    session.update(&near);
    globe.gate.allow(None);
    let settled = session.settle(&near);
    let read: HashSet<_> = globe.page_reads().into_keys().collect();
    let wanted: HashSet<_> = addresses(&settled).into_iter().collect();
    let all = with_ancestors(&settled);
    assert!(wanted.is_subset(&read) && read.is_subset(&all), "{read:?} of {all:?}");
    let lengths = globe.entries.iter().filter(|entry| read.contains(&entry.page)).map(|entry| {
        let Payload::Record { length, .. } = entry.payload else { return 0 };
        u64::from(length)
    });
    assert_eq!(cache.stats().loaded_bytes, lengths.sum::<u64>());
    // Of the ancestors, every other one.
    assert!(read.len() < all.len(), "{} of {}", read.len(), all.len());
}

#[test]
fn a_load_nobody_wants_is_given_up() {
    let globe = Gated::new("globe", globe(), Kind::Height);
    let cache = globe.cache(PLENTY, 1);
    let mut session = cache.session();
    let near = view(10.0, 20.0, 1e6, 0.0);
    // The root and the index, so that the next load is one of another page.
    session.settle(&view(10.0, 20.0, 1e9, 0.0));
    globe.gate.allow(Some(0));
    while cache.stats().reserved_bytes == 0 {
        session.update(&near);
    }
    drop(session);
    globe.gate.allow(None);
    while cache.stats().reserved_bytes > 0 {
        std::thread::yield_now();
    }
    let stats = cache.stats();
    assert_eq!((stats.cancelled, stats.errors), (1, 0), "{stats:?}");
}

#[test]
fn no_walk_passes_the_budget() {
    let globe = Gated::new("globe", globe(), Kind::Height);
    for (budget_pages, sessions) in [(3, 1), (12, 1), (40, 1), (40, 3), (90, 2)] {
        let budget = budget_pages * 2 * PAGE;
        let cache = globe.cache(budget, 3);
        let mut sessions: Vec<_> = (0..sessions).map(|_| cache.session()).collect();
        for step in 0..60_u32 {
            for (number, session) in sessions.iter_mut().enumerate() {
                let page = PageAddress::new(Level(0), step, u32::try_from(number).unwrap());
                let view = view(
                    360.0 * chance(page, 5),
                    180.0 * chance(page, 6) - 90.0,
                    10.0_f64.powf(4.5 + 2.5 * chance(page, 7)),
                    90.0 * chance(page, 8),
                );
                let selection = if chance(page, 9) < 0.5 {
                    session.settle(&view)
                } else {
                    session.update(&view)
                };
                let bytes: usize = selection.pages.iter().map(|page| page.page.bytes()).sum();
                assert!(bytes <= budget / 2);
                let stats = cache.stats();
                assert!(stats.bytes + stats.reserved_bytes <= stats.budget_bytes);
            }
        }
        let stats = cache.stats();
        assert!(stats.peak_bytes <= budget && stats.loads > 0, "{stats:?}");
        assert!(stats.evictions > 0 || budget_pages != 12, "{stats:?}");
    }
}

/// One session alone always gets all of what fits into half the budget.
#[test]
fn a_lone_session_settles_on_any_budget() {
    let globe = Gated::new("globe", globe(), Kind::Height);
    for pages in 2..30 {
        let cache = globe.cache(pages * 2 * PAGE, 2);
        let mut session = cache.session();
        for step in 0..8 {
            let settled = session.settle(&view(40.0 * f64::from(step), 10.0, 2e5, 60.0));
            assert_eq!(settled.missing, 0, "{pages} pages, {:?}", cache.stats());
            let forced = settled.tolerance_px > 1.0;
            assert!(forced == (settled.error_px > 1.0), "{}", settled.error_px);
            assert!(settled.error_px <= settled.tolerance_px);
        }
    }
}

#[test]
fn pages_in_use_are_not_evicted() {
    let globe = Gated::new("globe", globe(), Kind::Height);
    let cache = globe.cache(30 * PAGE, 2);
    let (mut session, mut other) = (cache.session(), cache.session());
    let near = view(10.0, 20.0, 3e5, 30.0);
    let held = session.settle(&near);
    assert!(!held.pages.is_empty());
    for step in 0..48 {
        let narrow = Degrees(2.0).into();
        // Over the middle of pages, so that few of them are in sight.
        let (column, row) = (f64::from(step % 16), f64::from(step / 16));
        let elsewhere = view(22.5 * column + 11.0, 22.5 * row - 56.0, 3e5, 0.0);
        other.settle(&View { vertical_fov: narrow, ..elsewhere });
        let store = cache.engine().shared().store();
        for page in &held.pages {
            assert!(store.holds(PageName { dataset: page.dataset, page: page.entry.page }));
        }
    }
    assert!(cache.stats().evictions > 0);
    let again = session.update(&near);
    assert_eq!(again.generation, held.generation);
}

#[test]
fn the_root_stays() {
    let globe = Gated::new("globe", globe(), Kind::Height);
    let cache = globe.cache(24 * PAGE, 2);
    let mut session = cache.session();
    for step in 0..20 {
        session.settle(&view(18.0 * f64::from(step), -40.0, 2e5, 30.0));
        let root = PageName { dataset: 0, page: PageAddress::new(Level(0), 0, 0) };
        assert!(cache.engine().shared().store().holds(root));
    }
    assert!(cache.stats().evictions > 0);
    assert_eq!(globe.page_reads()[&PageAddress::new(Level(0), 0, 0)], 1);
}

#[test]
fn a_damaged_page_is_told_and_stood_in_for() {
    let (description, mut bytes) = planet("globe", globe(), Kind::Height);
    let whole = Gated::from_bytes(description.clone(), bytes.clone());
    let near = view(10.0, 20.0, 3e5, 30.0);
    let settled = whole.cache(PLENTY, 2).session().settle(&near);
    let victim = settled.pages.last().unwrap().entry;
    let Payload::Record { offset, .. } = victim.payload else { panic!("heights are stored") };
    bytes[usize::try_from(offset).unwrap() + RECORD_HEAD_LEN + 9] ^= 0x10;

    let damaged = Gated::from_bytes(description, bytes);
    let cache = damaged.cache(PLENTY, 2);
    let mut session = cache.session();
    for _ in 0..3 {
        let selection = session.settle(&near);
        assert_eq!((selection.missing, selection.failed.len()), (0, 1));
        assert_eq!(selection.failed[0].page, victim.page);
        assert!(selection.failed[0].error.contains("damaged"), "{}", selection.failed[0].error);
        let pages = addresses(&selection);
        assert!(pages.contains(&victim.page.parent().unwrap()) && !pages.contains(&victim.page));
    }
    assert_eq!(cache.stats().errors, 1);
    assert_eq!(damaged.page_reads()[&victim.page], 1);
}

#[test]
fn a_dataset_appears_in_one_step() {
    let (globe, cap) =
        (Gated::new("globe", globe(), Kind::Height), Gated::new("cap", cap(), Kind::Height));
    let cache = globe.cache(PLENTY, 2);
    let mut session = cache.session();
    let pole = view(0.0, 88.0, 3e5, 0.0);
    let before = session.settle(&pole);
    cache.insert(cap.info.clone(), Arc::clone(&cap.archive) as _).unwrap();
    assert!(session.has_news());
    let after = session.settle(&pole);
    assert_eq!((before.datasets.len(), after.datasets.len()), (1, 2));
    assert!(after.generation > before.generation);
    assert!(after.pages.iter().any(|page| page.dataset == 1));
    assert_eq!(after.datasets[1].name, "cap");
    for page in &before.pages {
        assert!(after.pages.iter().any(|now| Arc::ptr_eq(now, page)));
    }
}

/// A medium that fails for a while is tried again, and what it has is shown then.
#[test]
fn what_failed_is_tried_again() {
    let globe = Gated::new("globe", globe(), Kind::Height);
    let cache = globe.cache(PLENTY, 2);
    let mut session = cache.session();
    let near = view(10.0, 20.0, 3e5, 30.0);
    globe.gate.fail(true);
    let failing = session.settle(&near);
    assert!(failing.pages.is_empty() && !failing.failed.is_empty());
    assert!(failing.failed[0].error.contains("out of order"), "{}", failing.failed[0].error);
    globe.gate.fail(false);
    let healed = loop {
        while !session.has_news() {
            std::thread::yield_now();
        }
        let now = session.settle(&near);
        if now.failed.is_empty() {
            break now;
        }
    };
    assert!(healed.missing == 0 && healed.pages.len() == healed.wanted);
}

/// What fails again and again is asked for less and less often; what has come is as if it had never
/// failed, and so is everything once the reason is gone.
#[tokio::test(start_paused = true)]
async fn what_fails_again_waits_twice_as_long() {
    let globe = Gated::new("globe", globe(), Kind::Height);
    let newcomer = newcomer(globe.info.clone(), Arc::clone(&globe.archive) as _).unwrap();
    let scene = Scene::empty(mars()).changed(|_| false, [newcomer]);
    let (dataset, entry) = (&scene.datasets[0], globe.entries[0]);
    let work = Work::Texels(PageName { dataset: dataset.number, page: entry.page });
    let mut store = Store::new(PLENTY, Limits { loads: 1, bytes: PLENTY });
    let attempt = |store: &mut Store, outcome| {
        let request = Request { work, dataset: Arc::clone(dataset), entry, bytes: PAGE };
        store.replace_requests(1, vec![request]);
        assert_eq!(store.next().map(|request| request.work), Some(work));
        store.finish(work, outcome);
    };
    let failed = || Outcome::Failed("out of order".into());
    for seconds in [1, 2, 4, 8, 16, 32, 60, 60] {
        attempt(&mut store, failed());
        advance(Duration::from_millis(1000 * seconds - 1)).await;
        assert!(store.error(work).is_some(), "{seconds}");
        advance(Duration::from_millis(1)).await;
        assert!(store.error(work).is_none(), "{seconds}");
    }
    attempt(&mut store, Outcome::Loaded(None));
    attempt(&mut store, failed());
    advance(Duration::from_secs(1)).await;
    assert!(store.error(work).is_none());
    attempt(&mut store, failed());
    store.forgive();
    assert!(store.error(work).is_none());
}

/// While many pages are missing, one in eight more is asked for to stand in for them; for a few, none.
#[test]
fn one_page_stands_in_for_eight() {
    let globe = Gated::new("globe", fine_globe(), Kind::Height);
    // With the index in memory, what is wanted is known at once.
    globe.archive.entries().unwrap();
    let extra = |tolerance_px, altitude| {
        globe.gate.reads.lock().unwrap().clear();
        let cache = globe.cache(PLENTY, 1);
        let near = View { tolerance_px, ..view(10.0, 20.0, altitude, 60.0) };
        let settled = cache.session().settle(&near);
        let drawn: HashSet<_> = addresses(&settled).into_iter().collect();
        let read = globe.page_reads();
        let is_other = |page: &&PageAddress| !drawn.contains(*page) && page.level != Level(0);
        (drawn.len(), read.keys().filter(is_other).count())
    };
    let (many, others) = extra(0.05, 1e6);
    assert!(many > 40 && others >= 2 && others <= many / 8, "{others} for {many}");
    let (few, others) = extra(5.0, 2e5);
    assert!((2..8).contains(&few) && others == 0, "{others} for {few}");
}

/// Pages by name, one after another and beside a session that flies on.
#[test]
fn single_pages_are_loaded_for_whoever_asks() {
    let globe = Gated::new("globe", globe(), Kind::Height);
    let cache = globe.cache(PLENTY, 2);
    let mut session = cache.session();
    for (step, entry) in globe.entries.iter().enumerate().take(60) {
        session.update(&view(6.0 * step as f64, 20.0, 3e5, 30.0));
        let page = cache.wait_for(cache.page(0, entry.page)).unwrap().unwrap();
        assert_eq!((page.dataset, page.entry.page), (0, entry.page));
        let truth = globe.archive.page(entry).unwrap();
        assert_eq!(page.page.texels(), truth.texels());
        assert!(Arc::ptr_eq(&page, &cache.resident(0, entry.page).unwrap()));
    }
    let nowhere = PageAddress::new(Level(0), 9, 9);
    assert!(cache.wait_for(cache.page(0, nowhere)).unwrap().is_none());
    let error = cache.wait_for(cache.page(7, nowhere)).unwrap_err();
    assert!(matches!(error, crate::PageError::NoSuchDataset(7)), "{error}");
    drop(session);
    let held = globe.cache(PAGE / 2, 1);
    let error = held.wait_for(held.page(0, globe.entries[0].page)).unwrap_err();
    assert!(matches!(error, crate::PageError::NoRoom { .. }), "{error}");
}

/// The height of what is drawn is within both bounds of that of the finest data, which is what a query
/// of the archives answers.
#[test]
fn a_selection_knows_heights_as_well_as_it_says() {
    use areoid_formats::query::HeightQuery;
    let (globe, cap) =
        (Gated::new("globe", globe(), Kind::Height), Gated::new("cap", cap(), Kind::Height));
    let cache = globe.cache(PLENTY, 2);
    cache.insert(cap.info.clone(), Arc::clone(&cap.archive) as _).unwrap();
    let mut session = cache.session();
    let archives = [&*globe.archive, &*cap.archive];
    let mut query = HeightQuery::new(archives, None);
    let (mut found, mut coarse) = (0, 0);
    for step in 0..60 {
        let (longitude, latitude) = (6.1 * f64::from(step), 60.0 + 0.49 * f64::from(step));
        let position = Geographic::from_degrees(Degrees(longitude), Degrees(latitude));
        let selection = session.settle(&view(longitude, latitude, 8e5, 0.0));
        let drawn = selection.height(position);
        let exact = cache.wait_for(cache.exact_height(position)).unwrap();
        let truth = query.height(position).unwrap();
        match (&exact, truth) {
            (Some(exact), Some(truth)) => {
                assert!((exact.height_m - truth.height_m).abs() < 1e-9);
                assert_eq!((exact.bound_m, &exact.datasets), (truth.bound_m, &truth.datasets));
            }
            (None, None) => {}
            other => panic!("{other:?}"),
        }
        if let (Some(drawn), Some(exact)) = (drawn, exact) {
            // These planets' texels are not those that their bounds are of: the figures are all there is
            // to compare.
            assert!(drawn.bound_m >= exact.bound_m);
            coarse += u32::from(drawn.bound_m > 0.0);
            found += 1;
        }
    }
    assert!(found > 20 && coarse > 0, "{found} {coarse}");
}

/// Of pages over one another the finest answers.
#[test]
fn a_height_is_that_of_the_finest_page() {
    let globe = Gated::new("globe", globe(), Kind::Height);
    let cache = globe.cache(PLENTY, 2);
    let settled = cache.session().settle(&view(0.0, 0.0, 1e7, 0.0));
    let grid = &globe.info.grid;
    let finest = grid.pyramid().finest();
    let mut found = 0;
    for entry in globe.entries.iter().filter(|entry| entry.page.level == finest).take(40) {
        let mut lineage: Vec<_> =
            std::iter::successors(Some(entry.page), |page| page.parent()).collect();
        lineage.reverse();
        let load = |page: PageAddress| cache.wait_for(cache.page(0, page)).unwrap().unwrap();
        let select = |pages: &[PageAddress]| Selection {
            generation: 0,
            scene: 0,
            datasets: settled.datasets.clone(),
            pages: pages.iter().map(|page| load(*page)).collect(),
            missing: 0,
            roots: Vec::new(),
            beneath: Vec::new(),
            failed: Vec::new(),
            tolerance_px: 1.0,
            error_px: 1.0,
            visited: 0,
            wanted: 0,
            culled: 0,
        };
        let interior = f64::from(grid.pyramid().interior());
        let [x, y] = [entry.page.col, entry.page.row].map(|at| (f64::from(at) + 0.5) * interior);
        let place = areoid_formats::grid::TexelPoint { x, y };
        let position = grid.geographic_from_texel(finest, place).unwrap();
        let all = select(&lineage).height(position).unwrap();
        let alone = select(&[entry.page]).height(position).unwrap();
        let above = select(&lineage[..lineage.len() - 1]).height(position).unwrap();
        assert_eq!((all.height_m, all.bound_m), (alone.height_m, alone.bound_m));
        assert!(above.bound_m > alone.bound_m);
        found += 1;
    }
    assert_eq!(found, 40);
}
