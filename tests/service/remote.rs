//! A server's catalog read from afar.

use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::time::{Duration, Instant};

use areoid_cache::remote::{Blocks, Client, RemoteCatalog, RemoteError};
use areoid_cache::service::Service;
use areoid_cache::{Cache, PageSource as _};
use areoid_formats::archive::{Archive, PageEntry, Payload};
use areoid_formats::catalog::Catalog;
use tempfile::TempDir;

use super::rig::{Serving, eventually};
use super::road::Road;

fn client(serving: &Serving) -> Client {
    Client::new(&format!("http://{}", serving.address())).unwrap()
}

fn assert_same(near: &Archive, far: &Archive) {
    assert_eq!(near.description(), far.description());
    let entries = near.entries().unwrap();
    assert_eq!(entries, far.entries().unwrap());
    for entry in &entries {
        assert_eq!(near.payload(entry).unwrap(), far.payload(entry).unwrap());
    }
}

fn near(serving: &Serving) -> Archive {
    Catalog::open_with_archives(&serving.place.catalog()).unwrap().1.remove(0)
}

fn bytes_in(folder: &Path) -> u64 {
    fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().metadata().unwrap().len()).sum()
}

#[test]
fn a_remote_archive_has_the_same_pages() {
    let serving = Serving::new();
    let remote = RemoteCatalog::open(&client(&serving), None).unwrap();
    assert!(remote.problems.is_empty(), "{:?}", remote.problems);
    assert_eq!(&remote.body, Catalog::open(&serving.place.catalog()).unwrap().body());
    assert_same(&near(&serving), remote.datasets[0].pages.archive());
    let options = areoid_cache::Options::with_budget(16 << 20);
    let sources = remote.datasets.into_iter().map(|dataset| (dataset.info, dataset.pages as _));
    let cache = Cache::with_sources(remote.body, sources, options).unwrap();
    assert_eq!((cache.datasets().iter().count(), cache.problems().len()), (1, 0));
}

#[test]
fn what_is_on_the_disk_is_read_without_the_server_and_proven() {
    let serving = Serving::new();
    let folder = TempDir::new().unwrap();
    let blocks = Arc::new(Blocks::open(folder.path(), 64 << 20).unwrap());
    let remote = RemoteCatalog::open(&client(&serving), Some(&blocks)).unwrap();
    let near = near(&serving);
    let far = remote.datasets[0].pages.archive();
    assert_same(&near, far);
    // Damaged blocks are asked for again, once each; some are read when an archive is opened alone.
    let mut damaged = 0.0;
    for victim in fs::read_dir(folder.path()).unwrap() {
        let victim = victim.unwrap().path();
        let mut bytes = fs::read(&victim).unwrap();
        bytes[100] ^= 1;
        fs::write(&victim, bytes).unwrap();
        damaged += 1.0;
    }
    let asked = serving.metric("areoid_requests_total");
    assert_same(&near, far);
    let again = serving.metric("areoid_requests_total") - asked;
    assert!(0.5 * damaged < again && again <= damaged, "{again} requests for {damaged} blocks");
    assert_same(&near, far);
    assert_eq!(serving.metric("areoid_requests_total"), asked + again);
    let Serving { place: _place, service } = serving;
    service.stop();
    assert_same(&near, far);
}

/// Whoever asks for a block goes on for those who wait for it, though it wants nothing itself any more.
#[test]
fn a_block_that_somebody_waits_for_is_not_given_up() {
    const BLOCK: u64 = 128 << 10;
    let serving = Serving::new();
    let (near, road) = (near(&serving), Road::to(serving.address()));
    let block_of = |entry: &PageEntry| match entry.payload {
        Payload::Record { offset, length, .. } => {
            let last = offset + 4096 + u64::from(length);
            (offset / BLOCK == last / BLOCK).then_some(offset / BLOCK)
        }
        Payload::Constant(_) => None,
    };
    let entries = near.entries().unwrap();
    let mut both = entries.iter().filter(|entry| block_of(entry) == Some(2));
    let [one, other] = [(); 2].map(|()| *both.next().unwrap());

    let folder = TempDir::new().unwrap();
    let blocks = Arc::new(Blocks::open(folder.path(), 64 << 20).unwrap());
    let client = Client::new(&format!("http://{}", road.address)).unwrap();
    let remote = RemoteCatalog::open(&client, Some(&blocks)).unwrap();
    let far = &remote.datasets[0].pages;
    let (is_wanted, is_waiting) = (AtomicBool::new(true), AtomicBool::new(false));
    road.slow_down(true);
    std::thread::scope(|scope| {
        let asking = scope.spawn(|| far.payload_while(&one, &|| is_wanted.load(Relaxed)));
        eventually("the answer has begun", || road.slow_bytes() > 500);
        let waiting = scope.spawn(|| {
            far.payload_while(&other, &|| {
                is_waiting.store(true, Relaxed);
                true
            })
        });
        eventually("another waits", || is_waiting.load(Relaxed));
        is_wanted.store(false, Relaxed);
        let then = road.slow_bytes();
        eventually("more of it comes", || road.slow_bytes() > then + 200);
        road.slow_down(false);
        let asked = asking.join().unwrap().unwrap();
        assert_eq!(asked, Some(near.payload(&one).unwrap()));
        let waited = waiting.join().unwrap().unwrap();
        assert_eq!(waited, Some(near.payload(&other).unwrap()));
    });
    // With nobody who wants or waits, nothing is asked.
    let asked = serving.metric("areoid_requests_total");
    let third = entries.iter().find(|entry| block_of(entry) == Some(3)).unwrap();
    assert_eq!(far.payload_while(third, &|| false).unwrap(), None);
    assert_eq!(serving.metric("areoid_requests_total"), asked);
}

#[test]
fn the_disk_cache_keeps_its_bound() {
    let serving = Serving::new();
    let folder = TempDir::new().unwrap();
    let blocks = Arc::new(Blocks::open(folder.path(), 400 << 10).unwrap());
    let remote = RemoteCatalog::open(&client(&serving), Some(&blocks)).unwrap();
    assert_same(&near(&serving), remote.datasets[0].pages.archive());
    assert!(bytes_in(folder.path()) <= 400 << 10, "{}", bytes_in(folder.path()));
}

#[test]
fn a_vanished_network_fails_in_bounded_time_and_heals() {
    let serving = Serving::new();
    let remote = RemoteCatalog::open(&client(&serving), None).unwrap();
    let near = near(&serving);
    let entries = near.entries().unwrap();
    let far = remote.datasets[0].pages.archive();
    let address = serving.address();
    let Serving { place, service } = serving;
    service.stop();
    let start = Instant::now();
    let error = far.payload(&entries[0]).unwrap_err();
    assert!(start.elapsed() < Duration::from_secs(10));
    // What was not there a moment ago is not asked for by every page.
    let start = Instant::now();
    for entry in &entries {
        far.payload(entry).unwrap_err();
    }
    assert!(start.elapsed() < Duration::from_secs(5), "{error}");
    assert!(matches!(
        RemoteCatalog::open(&Client::new(&format!("http://{address}")).unwrap(), None),
        Err(RemoteError::Network { .. })
    ));

    let mut options = place.options();
    options.listen = address;
    let _service = Service::start(&options).unwrap();
    eventually("it heals", || far.payload(&entries[0]).is_ok());
    assert_same(&near, far);
}

#[test]
fn what_is_no_server_is_refused() {
    for url in [
        "",
        "http://",
        "https://host",
        "ftp://host",
        "/a/folder",
        "http://[::1",
        "http://a b",
        "http://:80",
    ] {
        assert!(matches!(Client::new(url), Err(RemoteError::Url { .. })), "{url}");
    }
}
