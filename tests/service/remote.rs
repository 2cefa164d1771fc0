//! A server's catalog read from afar.

use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use areoid_cache::Cache;
use areoid_cache::remote::{Blocks, Client, RemoteCatalog, RemoteError};
use areoid_cache::service::Service;
use areoid_formats::archive::Archive;
use areoid_formats::catalog::Catalog;
use tempfile::TempDir;

use super::rig::{Serving, eventually};

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
