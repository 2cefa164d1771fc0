//! Threads that come between each other at every lock, in hundreds of random orders: what one
//! lock guards is for `orders.rs`, what goes wrong between two of them, or is waited for in vain, is for
//! these.

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering::Relaxed};

use shuttle::future::{self, block_on};
use shuttle::thread;

use super::*;
use crate::engine::Engine;
use crate::loader::Threads;
use crate::locks::model::{check, orders, without_waiting};
use crate::scene::{Newcomer, Scene};
use crate::stats::Stats;
use crate::store::{Limits, PageName};

/// A model's threads.
struct Modeled;

impl Threads for Modeled {
    fn start(&self, work: impl FnOnce() + Send + 'static) {
        thread::spawn(work);
    }
}

/// An engine whose loads the model's threads do.
fn engine(datasets: &[&Gated], budget_bytes: usize) -> Arc<Engine> {
    let newcomers = datasets.iter().map(|dataset| newcomer(dataset));
    let scene = Scene::empty(mars()).changed(|_| false, newcomers);
    let limits = Limits { loads: 2, bytes: budget_bytes };
    let engine = Arc::new(Engine::still(scene, budget_bytes, limits));
    // It goes on for ever: nobody waits for its end.
    drop(future::spawn(Arc::clone(engine.shared()).dispatch(Modeled)));
    engine
}

fn newcomer(dataset: &Gated) -> Newcomer {
    Newcomer::new(dataset.info.clone(), Arc::clone(&dataset.archive) as _).unwrap()
}

/// When no load is under way any more.
fn ended(engine: &Engine) -> Stats {
    loop {
        let stats = engine.shared().stats();
        if stats.reserved_bytes == 0 {
            return stats;
        }
        thread::yield_now();
    }
}

fn numbers(selection: &Selection) -> BTreeSet<usize> {
    selection.pages.iter().map(|page| page.dataset).collect()
}

/// A few pages.
fn far(longitude: f64) -> View {
    View { tolerance_px: 0.3, ..view(longitude, 20.0, 2e6, 0.0) }
}

/// Two threads draw, a dataset comes in the place of another: no frame waits for a lock or is a mixture,
/// all that is wanted comes, whoever is told first, and nothing stays of what is gone.
#[test]
fn frames_loads_and_a_change_in_any_order() {
    let [old, new] = [(); 2].map(|()| Arc::new(Gated::globe()));
    let adopted = Arc::new([const { AtomicUsize::new(0) }; 2]);
    let counts = Arc::clone(&adopted);
    let gone = old.entries.clone();
    check(orders(1000), move || {
        let engine = engine(&[&old], PLENTY);
        let draw = |longitude: f64| {
            let (engine, counts) = (Arc::clone(&engine), Arc::clone(&counts));
            move || {
                let mut session = Session::new(engine, longitude.to_bits());
                let mut last = 0;
                for step in 0..4 {
                    let seen = far(longitude + 40.0 * f64::from(step));
                    let now = without_waiting(|| session.update(&seen));
                    assert!(numbers(&now).len() <= 1 && now.scene >= last, "{:?}", numbers(&now));
                    last = now.scene;
                    thread::yield_now();
                }
                // What comes after it was told of is heard of, and shown when it is whole.
                let now = loop {
                    let now = block_on(session.settled(&far(longitude)));
                    assert_eq!(now.missing, 0);
                    if numbers(&now) == BTreeSet::from([1]) {
                        break now;
                    }
                    assert_eq!(numbers(&now), BTreeSet::from([0]));
                    counts[0].fetch_add(1, Relaxed);
                    while !session.has_news() {
                        thread::yield_now();
                    }
                };
                counts[1].fetch_add(now.pages.len(), Relaxed);
            }
        };
        let drawn = [10.0, 100.0].map(|longitude| thread::spawn(draw(longitude)));
        let (changed, new) = (Arc::clone(&engine), Arc::clone(&new));
        let change = thread::spawn(move || {
            for _ in 0..20 {
                thread::yield_now();
            }
            changed.replace(&["globe".to_owned()].into(), vec![newcomer(&new)]);
        });
        for thread in drawn.into_iter().chain([change]) {
            thread.join().unwrap();
        }
        assert_eq!(ended(&engine).errors, 0);
        engine.shared().let_go();
        let store = engine.shared().store();
        let stays = |entry: &PageEntry| store.holds(PageName { dataset: 0, page: entry.page });
        assert!(!gone.iter().any(stays));
    });
    let [before, after] = [0, 1].map(|state| adopted[state].load(Relaxed));
    assert!(before > 20 && after > 500, "{before} {after}");
}

/// A view that is told of once is enough: its loads go on without another word.
#[test]
fn what_is_asked_for_once_comes_in_any_order() {
    let globe = Arc::new(Gated::globe());
    // What is wanted is known at once.
    globe.archive.entries().unwrap();
    check(orders(200), move || {
        let engine = engine(&[&globe], PLENTY);
        let mut session = Session::new(Arc::clone(&engine), 1);
        let near = View { tolerance_px: 0.1, ..view(10.0, 20.0, 1e6, 30.0) };
        let missing = session.update(&near).missing;
        assert!(missing > 4, "{missing}");
        while engine.shared().stats().pages < missing {
            thread::yield_now();
        }
    });
}

/// More is wanted than there is room for, the medium fails and is forgiven, a session goes: the budget
/// holds, and nobody waits in vain.
#[test]
fn no_room_failures_and_farewells_in_any_order() {
    let globe = Arc::new(Gated::globe());
    let failures = Arc::new(AtomicUsize::new(0));
    let counted = Arc::clone(&failures);
    check(orders(1000), move || {
        let budget_bytes = 9 * PAGE;
        let engine = engine(&[&globe], budget_bytes);
        globe.gate.fail(false);
        let session = |number: u64| Session::new(Arc::clone(&engine), number);
        let mut guest = session(1);
        let goes = thread::spawn(move || {
            for longitude in [0.0, 120.0] {
                without_waiting(|| guest.update(&far(longitude)));
                thread::yield_now();
            }
        });
        let (mut stays, counted) = (session(2), Arc::clone(&counted));
        let whole = Arc::new(AtomicBool::new(false));
        let is_whole = Arc::clone(&whole);
        let stays = thread::spawn(move || {
            loop {
                let now = block_on(stays.settled(&far(60.0)));
                if now.missing == 0 && now.failed.is_empty() {
                    is_whole.store(true, Relaxed);
                    break now.pages.len();
                }
                counted.fetch_add(now.failed.len(), Relaxed);
                while !stays.has_news() {
                    thread::yield_now();
                }
            }
        });
        globe.gate.fail(true);
        for _ in 0..20 {
            thread::yield_now();
        }
        globe.gate.fail(false);
        // What was read before fails after, too: it is forgiven until all is there.
        while !whole.load(Relaxed) {
            engine.forgive();
            thread::yield_now();
        }
        assert!(stays.join().unwrap() > 0);
        goes.join().unwrap();
        let stats = ended(&engine);
        assert!(stats.bytes <= budget_bytes);
    });
    assert!(failures.load(Relaxed) > 20, "{failures:?}");
}
