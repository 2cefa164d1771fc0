//! Loads, budget, pins: what sessions see while pages come and go.

use std::collections::HashSet;
use std::sync::Barrier;

use super::*;
use crate::store::PageName;

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

#[test]
fn an_update_never_waits_for_a_read() {
    let globe = Gated::globe();
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
    let globe = Gated::globe();
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
    let globe = Gated::globe();
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
    let globe = Gated::globe();
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
    let globe = Gated::globe();
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
    let globe = Gated::globe();
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
    let globe = Gated::globe();
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
    let globe = Gated::globe();
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
    let globe = Gated::globe();
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
    let globe = Gated::globe();
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
fn a_dataset_appears_in_one_step() {
    let (globe, cap) = (Gated::globe(), Gated::new("cap", cap(), Kind::Height));
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
