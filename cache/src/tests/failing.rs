//! What sessions see of pages that cannot be read, and when those are tried again.

use std::time::Duration;

use tokio::time::advance;

use super::*;
use crate::open::newcomer;
use crate::scene::Scene;
use crate::store::{Limits, Outcome, PageName, Request, Store, Work};

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

/// A medium that fails for a while is tried again, and what it has is shown then.
#[test]
fn what_failed_is_tried_again() {
    let globe = Gated::globe();
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
    let globe = Gated::globe();
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
