//! What a frame costs, and what is there before it is needed.

use std::collections::HashSet;
use std::f64::consts::TAU;
use std::time::{Duration, Instant};

use super::*;

#[test]
fn an_unchanged_view_allocates_nothing() {
    let globe = Gated::globe();
    let cache = globe.cache(PLENTY, 2);
    let mut session = cache.session();
    let near = view(10.0, 20.0, 3e5, 30.0);
    session.settle(&near);
    // The views of the settled frame are known; news of its last loads may still be on the way.
    while session.has_news() {
        session.update(&near);
    }
    let first = session.update(&near);
    let counted = allocation_counter::measure(|| {
        for _ in 0..100 {
            assert!(Arc::ptr_eq(&session.update(&near), &first));
        }
    });
    assert_eq!(counted.count_total, 0, "{counted:?}");
}

/// Both eyes get what each would alone, from one search that looks at shared pages once.
#[test]
fn several_views_are_one_search() {
    let globe = Gated::globe();
    let views = [view(10.0, 20.0, 3e5, 30.0), view(10.4, 20.0, 3e5, 30.0)];
    let alone: Vec<_> = views
        .iter()
        .map(|view| {
            let settled = globe.cache(PLENTY, 2).session().settle(view);
            let pages: HashSet<_> = settled.pages.iter().map(|page| page.entry.page).collect();
            (pages, settled.visited)
        })
        .collect();

    let again = Gated::new("globe", super::globe(), Kind::Height);
    let cache = again.cache(PLENTY, 2);
    let mut session = cache.session();
    let both = loop {
        let both = session.update_all(&views);
        if both.missing == 0 && !both.pages.is_empty() {
            break both;
        }
        std::thread::yield_now();
    };
    let pages: HashSet<_> = both.pages.iter().map(|page| page.entry.page).collect();
    // Wherever one of them is refined, so is what the other shares of it.
    let covered = |page: &PageAddress| {
        let mut up = std::iter::successors(Some(*page), |page| page.parent());
        up.any(|page| pages.contains(&page))
            || pages.iter().any(|finer| {
                std::iter::successors(Some(*finer), |page| page.parent()).any(|up| up == *page)
            })
    };
    for (one, visited) in &alone {
        assert!(one.iter().all(covered));
        assert!(both.visited < alone[0].1 + alone[1].1 && both.visited >= *visited);
    }
    let union: HashSet<_> = alone.iter().flat_map(|(pages, _)| pages).collect();
    assert!(pages.len() <= union.len() && !pages.is_empty());
    assert!(again.page_reads().values().all(|&reads| reads == 1));
}

/// A selection for these views, and not the one before once more because the tables were in use.
fn anew(cache: &Cache, session: &mut Session, views: &[View]) -> Arc<Selection> {
    loop {
        let repeated = cache.stats().repeated;
        let now = session.update_all(views);
        if cache.stats().repeated == repeated {
            return now;
        }
    }
}

/// Of two views, each keeps its own tolerance.
#[test]
fn a_coarser_view_beside_a_finer_one_stays_coarse() {
    let globe = Gated::new("globe", fine_globe(), Kind::Height);
    // East and west.
    let (here, there) = (view(40.0, 20.0, 3e5, 0.0), view(-120.0, -20.0, 3e5, 0.0));
    let rough = View { tolerance_px: 50.0, ..there };
    let cache = globe.cache(PLENTY, 2);
    let mut session = cache.session();
    let mut finest = |views: &[View]| loop {
        let now = anew(&cache, &mut session, views);
        if now.missing == 0 && !now.pages.is_empty() {
            let pages = now.pages.iter().map(|page| page.entry.page);
            let half = |page: PageAddress| {
                let (_, cols) = globe.info.grid.pyramid().pages(page.level).unwrap();
                usize::from(2 * page.col >= cols)
            };
            let mut levels = [Level(0); 2];
            pages.for_each(|page| levels[half(page)] = levels[half(page)].max(page.level));
            break levels;
        }
        std::thread::yield_now();
    };
    let [west, east] = finest(&[here, there]);
    let [rough_west, still_east] = finest(&[here, rough]);
    assert_eq!(east, still_east);
    assert!(rough_west < west, "{rough_west:?} {west:?}");
    assert_eq!(finest(&[rough, here]), [rough_west, east]);
}

/// A steady flight at sixty frames a second: most pages are there when they are first needed.
#[test]
fn a_steady_flight_is_looked_ahead_of() {
    // With one eye, or two.
    for eyes in [&[0.0][..], &[0.0, 1.0]] {
        let residents = [false, true].map(|ahead| residents(eyes, ahead));
        assert!(residents[1] >= 0.8 && residents[0] < 0.5, "{residents:?}");
    }
}

/// How many of the pages first needed were there.
fn residents(eyes: &[f64], ahead: bool) -> f64 {
    let globe = Gated::new("globe", fine_globe(), Kind::Height);
    let cache = globe.cache(PLENTY, 2);
    let mut session = cache.session();
    session.look_ahead = ahead;
    let at = |turn: f64| View { tolerance_px: 0.1, ..view(turn, 20.0, 2e5, 45.0) };
    let all = |turn: f64| eyes.iter().map(|eye| at(turn + eye)).collect::<Vec<_>>();
    let begun = Instant::now();
    while anew(&cache, &mut session, &all(0.0)).missing > 0 {
        assert!(begun.elapsed() < Duration::from_secs(60), "pages are missing");
        std::thread::yield_now();
    }
    let before = cache.stats();
    let (start, frame) = (Instant::now(), Duration::from_micros(16_667));
    for step in 0..120_u32 {
        session.update_all(&all(0.2 * f64::from(step)));
        // Loads have until the next frame, however slow the machine.
        while start.elapsed() < frame * (step + 1) || cache.stats().reserved_bytes > 0 {
            std::thread::yield_now();
        }
    }
    let stats = cache.stats();
    assert!(ahead == (stats.ahead > 0), "{stats:?}");
    let first = stats.first_wanted - before.first_wanted;
    assert!(first > 10, "{stats:?}");
    (stats.first_resident - before.first_resident) as f64 / first as f64
}

/// What lies further ahead is told to the medium, each page once, before it is read.
#[test]
fn media_are_told_of_what_comes_later() {
    let globe = Gated::new("globe", fine_globe(), Kind::Height);
    let cache = globe.cache(PLENTY, 2);
    let mut session = cache.session();
    let at = |turn: f64| View { tolerance_px: 0.1, ..view(turn, 20.0, 2e5, 45.0) };
    session.settle(&at(0.0));
    let (start, frame) = (Instant::now(), Duration::from_micros(16_667));
    for step in 0..180_u32 {
        session.update(&at(0.2 * f64::from(step)));
        while start.elapsed() < frame * (step + 1) || cache.stats().reserved_bytes > 0 {
            std::thread::yield_now();
        }
    }
    let stats = cache.stats();
    let told = globe.gate.told.lock().unwrap();
    let places: HashSet<u64> = told.iter().map(|(start, _)| *start).collect();
    assert_eq!(places.len(), told.len());
    assert!(places.len() > 10 && places.len() as u64 <= stats.advised, "{stats:?}");
    let late = told.iter().filter(|(_, was_read)| *was_read).count();
    assert!(late < told.len() / 4, "{late} of {}", told.len());
    assert!(stats.advised_used > 5 && stats.advised_used <= stats.advised, "{stats:?}");
}

/// What was looked away from is still there.
#[test]
fn looking_back_reads_nothing() {
    let globe = Gated::globe();
    let cache = globe.cache(PLENTY, 2);
    let mut session = cache.session();
    let turn = |step: i32| view(TAU.to_degrees() / 8.0 * f64::from(step), 10.0, 4e5, 20.0);
    for step in 0..8 {
        session.settle(&turn(step));
    }
    let loads = cache.stats().loads;
    for step in (0..8).rev() {
        assert_eq!(session.update(&turn(step)).missing, 0);
    }
    assert_eq!(cache.stats().loads, loads);
}

/// Views that are none are answered with something, and are over with the next one.
#[test]
fn views_that_make_no_sense_do_no_harm() {
    let globe = Gated::globe();
    let cache = globe.cache(PLENTY, 2);
    let mut session = cache.session();
    let near = view(10.0, 20.0, 3e5, 30.0);
    let truth = session.settle(&near);
    for number in [f64::NAN, f64::INFINITY, -f64::INFINITY, 0.0, -1.0, 1e300, f64::MIN_POSITIVE] {
        for odd in [
            View { eye: DVec3::splat(number), ..near },
            View { eye: DVec3::new(number, 0.0, 0.0), ..near },
            View { orientation: DMat3::from_cols_array(&[number; 9]), ..near },
            View { vertical_fov: areoid_formats::units::Radians(number), ..near },
            View { tolerance_px: number, ..near },
            View { viewport: [0, 0], ..near },
            View { viewport: [u32::MAX, 1], tolerance_px: number, ..near },
        ] {
            session.update(&odd);
            session.update_all(&[odd, near]);
        }
    }
    assert!(anew(&cache, &mut session, &[]).pages.is_empty());
    // Nor does a view that is none come after what makes all views new.
    session.settle(&near);
    session.exaggerate(2.0);
    assert!(anew(&cache, &mut session, &[]).pages.is_empty());
    session.exaggerate(1.0);
    let again = session.settle(&near);
    assert_eq!((again.pages.len(), again.missing), (truth.pages.len(), 0));
}

/// The same view of terrain that is higher is another.
#[test]
fn what_is_exaggerated_is_selected_anew() {
    let globe = Gated::globe();
    let cache = globe.cache(PLENTY, 2);
    let (mut session, mut other) = (cache.session(), cache.session());
    let view = view(10.0, 20.0, 2e6, 30.0);
    let plain = session.settle(&view);
    session.exaggerate(20.0);
    let asked = anew(&cache, &mut session, &[view]);
    assert!(asked.missing > 0 && asked.wanted > plain.wanted, "{asked:?}");
    let high = session.settle(&view);
    other.exaggerate(20.0);
    assert_eq!(addresses(&high), addresses(&other.settle(&view)));
    session.exaggerate(1.0);
    assert_eq!(addresses(&anew(&cache, &mut session, &[view])), addresses(&plain));
}
