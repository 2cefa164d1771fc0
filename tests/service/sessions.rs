//! Sessions on a server: the same as on its folder, whatever happens to the server.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use areoid_cache::flight::{Flight, Key};
use areoid_cache::place::{DiskCache, Server};
use areoid_cache::service::Service;
use areoid_cache::{Cache, Options, Place, ResidentPage, Selection, View};
use areoid_formats::page::Texels;
use areoid_formats::units::Degrees;
use serde_json::json;
use tempfile::TempDir;

use super::rig::{NAME, Serving, eventually, ingest};
use super::road::Road;

const OPTIONS: Options =
    Options { budget_bytes: 64 << 20, in_flight_bytes: 16 << 20, concurrent_loads: 8 };

fn url(serving: &Serving) -> String {
    format!("http://{}", serving.address())
}

fn far(serving: &Serving) -> Cache {
    Cache::open(url(serving).as_str(), OPTIONS).wait().unwrap()
}

/// Down to the pole and along, so that each view needs pages that the one before did not.
fn views(cache: &Cache) -> Vec<View> {
    let flight = Flight::new(vec![
        Key { seconds: 0.0, eye: [0.0, 80.0, 4e6], look: [0.0, -90.0] },
        Key { seconds: 3.0, eye: [40.0, 86.0, 2e5], look: [30.0, -60.0] },
        Key { seconds: 5.0, eye: [80.0, 84.0, 5e4], look: [60.0, -40.0] },
    ])
    .unwrap();
    let ellipsoid = cache.body().ellipsoid;
    let pose = |frame: u32| flight.pose(&ellipsoid, f64::from(frame) * 0.5);
    (0..=10).map(|frame| pose(frame).view(Degrees(45.0).into(), [640, 360], 1.0)).collect()
}

fn assert_same(near: &ResidentPage, far: &ResidentPage) {
    assert_eq!(near.entry, far.entry);
    assert_eq!(near.page.coverage(), far.page.coverage());
    match (near.page.texels(), far.page.texels()) {
        (Texels::Height(near), Texels::Height(far)) => {
            let bits = |texels: &[f32]| texels.iter().map(|t| t.to_bits()).collect::<Vec<_>>();
            assert_eq!(bits(near), bits(far));
        }
        (near, far) => assert_eq!(near, far),
    }
}

fn names(cache: &Cache) -> Vec<String> {
    cache.datasets().iter().map(|(_, info)| info.name.clone()).collect()
}

fn is_whole(selection: &Selection) -> bool {
    selection.missing == 0 && selection.failed.is_empty() && !selection.pages.is_empty()
}

#[test]
fn a_flight_gets_the_same_pages_from_a_server_as_from_its_folder() {
    let serving = Serving::new();
    let folder = TempDir::new().unwrap();
    let disk = DiskCache { folder: folder.path().to_owned(), most_bytes: 1 << 20 };
    let kept = Place::Server(Server { url: url(&serving), disk: Some(disk) });
    let near = Cache::open(serving.place.catalog().as_path(), OPTIONS).wait().unwrap();
    let (far, kept) = (far(&serving), Cache::open(kept, OPTIONS).wait().unwrap());
    let [mut one, mut other, mut third] = [&near, &far, &kept].map(Cache::session);
    let mut pages = 0;
    for view in views(&near) {
        let expected = one.settle(&view);
        assert!(is_whole(&expected), "{} missing", expected.missing);
        for found in [other.settle(&view), third.settle(&view)] {
            assert!(is_whole(&found), "{} missing, {:?}", found.missing, found.failed);
            assert_eq!(found.pages.len(), expected.pages.len());
            assert_eq!(found.tolerance_px.to_bits(), expected.tolerance_px.to_bits());
            for (near, far) in expected.pages.iter().zip(&found.pages) {
                assert_same(near, far);
            }
        }
        pages += expected.pages.len();
    }
    assert!(pages > 30, "{pages} pages are a flight of no interest");
    let kept: u64 =
        folder.path().read_dir().unwrap().map(|file| file.unwrap().metadata().unwrap().len()).sum();
    assert!((1..=1 << 20).contains(&kept), "{kept} bytes on the disk");
}

#[test]
fn a_session_sees_what_happens_on_its_server() {
    let serving = Serving::new();
    let cache = far(&serving);
    let mut session = cache.session();
    let view = views(&cache).remove(4);
    let first = session.settle(&view);
    let changed =
        |what: &str, is_so: &dyn Fn(&Selection) -> bool, session: &mut areoid_cache::Session| {
            let begin = Instant::now();
            eventually(what, || {
                let now = session.update(&view);
                now.missing == 0 && is_so(&now)
            });
            assert!(begin.elapsed() < Duration::from_secs(2), "{what} after {:?}", begin.elapsed());
        };
    let has = |selection: &Selection, name: &str, priority: i32| {
        let mut datasets = selection.datasets.iter();
        datasets.any(|(_, info)| info.name == name && info.priority == priority)
    };
    for (priority, temporary) in [(1, false), (2, false)] {
        let more = json!({ "priority": priority, "force": true, "temporary": temporary });
        let answer = serving.insert(&serving.place.insertion("new", more)).text();
        assert!(answer.contains("inserted"), "{answer}");
        changed("it is seen", &|now| has(now, "new", priority), &mut session);
    }
    assert_eq!(serving.remove("new").status, 200);
    changed("it is gone", &|now| !has(now, "new", 2), &mut session);
    let more = json!({ "temporary": true });
    assert!(serving.insert(&serving.place.insertion("guest", more)).text().contains("inserted"));
    changed("a guest is seen", &|now| has(now, "guest", 0), &mut session);
    // What nobody touched was kept.
    let last = session.settle(&view);
    for page in &first.pages {
        assert!(last.pages.iter().any(|now| Arc::ptr_eq(now, page)), "dropped for nothing");
    }
}

/// What is in memory stands in while the server is gone. What has changed meanwhile is there when it
/// is back, and so are the pages that could not be had.
#[test]
fn a_session_outlives_its_server_and_heals() {
    let serving = Serving::new();
    let cache = far(&serving);
    let mut session = cache.session();
    let views = views(&cache);
    let whole = session.settle(&views[0]);
    assert!(is_whole(&whole));
    let address = serving.address();
    let Serving { place, service } = serving;
    service.stop();

    let near = &views[views.len() - 1];
    eventually("it is given up for now", || {
        let now = session.update(near);
        assert!(!now.pages.is_empty(), "nothing stands in");
        now.missing == 0 && !now.failed.is_empty()
    });
    ingest(&place.catalog(), "other", &[]);
    std::thread::sleep(Duration::from_millis(1500));
    assert!(!session.update(near).pages.is_empty());
    assert_eq!(names(&cache), [NAME], "what was there stays");
    // It comes to rest: what cannot be had is not asked for at every frame.
    let errors = cache.stats().errors;
    for _ in 0..200 {
        session.update(near);
    }
    let asked = cache.stats().errors - errors;
    assert!(asked <= 40, "{asked} loads failed within 200 frames");

    let mut options = place.options();
    options.listen = address;
    let _service = Service::start(&options).unwrap();
    let back = Instant::now();
    eventually("it heals", || is_whole(&session.update(near)) && names(&cache) == [NAME, "other"]);
    assert!(back.elapsed() < Duration::from_secs(20), "it took {:?}", back.elapsed());
}

/// A page that is on its way is given up when the view has gone on, with or without a disk cache, and
/// comes when it is wanted again.
#[test]
fn what_nobody_wants_any_more_is_not_waited_for() {
    let serving = Serving::new();
    let folder = TempDir::new().unwrap();
    let disk = DiskCache { folder: folder.path().to_owned(), most_bytes: 1 << 20 };
    for disk in [None, Some(disk)] {
        let road = Road::to(serving.address());
        let server = Server { url: format!("http://{}", road.address), disk };
        let cache = Cache::open(Place::Server(server), OPTIONS).wait().unwrap();
        let mut session = cache.session();
        session.look_ahead = false;
        let views = views(&cache);
        session.settle(&views[0]);
        road.slow_down(true);
        // More than a header.
        eventually("pages are on their way", || {
            session.update(&views[10]);
            road.slow_bytes() > 500
        });
        let (before, begin) = (cache.stats(), Instant::now());
        eventually("they are given up", || {
            session.update(&views[0]);
            cache.stats().reserved_bytes == 0
        });
        let after = cache.stats();
        assert!(begin.elapsed() < Duration::from_secs(3), "after {:?}", begin.elapsed());
        assert_eq!((after.loads, after.errors), (before.loads, before.errors));
        assert!(after.cancelled > before.cancelled);
        road.slow_down(false);
        assert!(is_whole(&session.settle(&views[10])));
    }
}

/// What was kept, and is not what it should be, is asked for once more.
#[test]
fn damage_on_the_disk_is_asked_for_again() {
    let serving = Serving::new();
    let folder = TempDir::new().unwrap();
    let disk = DiskCache { folder: folder.path().to_owned(), most_bytes: 64 << 20 };
    let place = Place::Server(Server { url: url(&serving), disk: Some(disk) });
    let open = || Cache::open(&place, OPTIONS).wait().unwrap();
    let first = open();
    let view = views(&first).remove(6);
    let expected = first.session().settle(&view);
    // All of it; and then all but the ends, which are read when an archive is opened.
    for spared in [0, 1] {
        let mut kept: Vec<(u64, PathBuf)> = folder
            .path()
            .read_dir()
            .unwrap()
            .map(|file| file.unwrap().path())
            .map(|path| (path.to_str().unwrap().rsplit_once('-').unwrap().1.parse().unwrap(), path))
            .collect();
        kept.sort();
        let damaged = spared..kept.len() - spared;
        assert!(damaged.len() > 1, "{kept:?}");
        for (_, path) in &kept[damaged] {
            // As if something else had been kept: whole, and wrong.
            let mut bytes = std::fs::read(path).unwrap();
            let middle = bytes.len() / 2;
            bytes[middle..].fill(0x55);
            let sum = xxhash_of(&bytes[8..]);
            bytes[..8].copy_from_slice(&sum.to_le_bytes());
            std::fs::write(path, bytes).unwrap();
        }
        let second = open();
        assert!(second.problems().is_empty(), "{:?}", second.problems());
        let found = second.session().settle(&view);
        assert!(is_whole(&found), "{:?}", found.failed);
        assert_eq!(found.pages.len(), expected.pages.len());
        for (near, far) in expected.pages.iter().zip(&found.pages) {
            assert_same(near, far);
        }
    }
}

fn xxhash_of(bytes: &[u8]) -> u64 {
    xxhash_rust::xxh3::xxh3_64(bytes)
}
