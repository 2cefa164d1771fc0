//! Insertion, removal, other processes, and a reader that never sees a mixture.

use std::fs;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::thread;

use areoid_cache::remote::{self, Client, RemoteError};
use areoid_formats::catalog::{RealDisk, remove_dataset};
use serde_json::json;

use super::rig::{NAME, Place, Serving, TOKEN, eventually, globe, ingest, rest, soak, write_bare};

#[test]
fn an_insertion_is_visible_when_it_is_answered() {
    let serving = Serving::new();
    let answer = serving.insert(&serving.place.insertion("new", json!({})));
    let last = answer.text().lines().filter(|line| line.contains("inserted")).count();
    assert_eq!(last, 1, "{}", answer.text());
    assert_eq!(serving.names(), ["new", "pole"]);
    assert_eq!(serving.metric("areoid_inserted_total"), 1.0);
    let (pages, _) = serving.subject();
    assert_eq!(serving.get(&format!("{pages}/0/0/0")).status, 200);
    assert_eq!(serving.remove("new").status, 200);
    assert_eq!(serving.remove("new").status, 404);
    assert_eq!(serving.names(), ["pole"]);
}

#[test]
fn a_temporary_dataset_leaves_no_file_and_ends_with_the_service() {
    let serving = Serving::new();
    let before = listing(&serving.place);
    let more = json!({ "temporary": true });
    assert!(
        serving.insert(&serving.place.insertion("guest", more.clone())).text().contains("inserted")
    );
    assert_eq!(serving.names(), ["guest", "pole"]);
    assert_eq!(listing(&serving.place), before);
    let (pages, _) = serving.subject();
    assert!(pages.contains("guest"));
    assert_eq!(serving.get(&format!("{pages}/0/0/0")).status, 200);
    // It stays when the catalog changes, and does not take a name that the catalog has.
    ingest(&serving.place.catalog(), "other", &[]);
    eventually("the other is seen", || serving.names() == ["guest", "other", "pole"]);
    let taken = serving.insert(&serving.place.insertion(NAME, more));
    assert!(taken.text().contains("error"), "{}", taken.text());
    let Serving { place, service } = serving;
    service.stop();
    let service = areoid_cache::service::Service::start(&place.options()).unwrap();
    let serving = Serving { place, service };
    assert_eq!(serving.names(), ["other", "pole"]);
}

/// Heights of all of Mars, as a group or as one dataset.
fn insert_globe(serving: &Serving, split: bool, temporary: bool) {
    let raster = serving.place.path("rasters/globe.tif");
    write_bare(&raster, 512, 256);
    let grid = if split { "split" } else { "native" };
    let options = json!({ "rasters": [raster], "grid": grid, "temporary": temporary });
    let mut more = globe();
    more.as_object_mut().unwrap().extend(options.as_object().unwrap().clone());
    let answer = serving.insert(&serving.place.insertion("globe", more)).text();
    assert!(answer.contains("inserted"), "{answer}");
}

#[test]
fn parts_of_a_temporary_group_go_together() {
    let serving = Serving::new();
    insert_globe(&serving, true, true);
    let all = ["globe.band", "globe.north", "globe.south", "pole"];
    assert_eq!(serving.names(), all);
    assert_eq!(serving.remove("globe.north").status, 409);
    assert_eq!(serving.names(), all);
    assert_eq!(serving.remove("globe").status, 200);
    assert_eq!(serving.names(), ["pole"]);
}

/// Whatever it was, a group or one dataset: old and new are never served together.
#[test]
fn what_is_called_as_something_temporary_comes_in_its_place() {
    const PARTS: [&str; 4] = ["globe.band", "globe.north", "globe.south", "pole"];
    const ONE: [&str; 2] = ["globe", "pole"];
    for [split_first, kept_then] in [[true, false], [false, false], [true, true], [false, true]] {
        let serving = Serving::new();
        let all = |split: bool| if split { PARTS.to_vec() } else { ONE.to_vec() };
        insert_globe(&serving, split_first, true);
        assert_eq!(serving.names(), all(split_first));
        insert_globe(&serving, !split_first, !kept_then);
        assert_eq!(serving.names(), all(!split_first), "{split_first} {kept_then}");
    }
    // One that is called as a part: no half of a group is left.
    let serving = Serving::new();
    insert_globe(&serving, true, true);
    assert_eq!(serving.names(), PARTS);
    let one = serving.place.insertion("globe.band", json!({}));
    assert!(serving.insert(&one).text().contains("inserted"));
    assert_eq!(serving.names(), ["globe.band", "pole"]);
}

#[test]
fn a_temporary_dataset_of_a_name_that_is_taken_is_refused_before_it_is_built() {
    let serving = Serving::new();
    let broken = serving.place.path("rasters/broken.tif");
    fs::write(&broken, b"II*\0 no raster").unwrap();
    let more = json!({ "rasters": [broken], "temporary": true });
    let refused = serving.insert(&serving.place.insertion(NAME, more)).text();
    assert!(refused.contains("cannot stand in its place"), "{refused}");
}

#[test]
fn insertions_that_wait_are_counted_and_one_too_many_is_told_so() {
    let serving = Serving::with(|options| options.limits.insertions = 2);
    let begin = |name| serving.begin_to_insert(&serving.place.insertion(name, json!({})));
    let first = begin("one");
    eventually("it is under way", || serving.metric("areoid_inserting") == 1.0);
    let second = begin("two");
    eventually("it waits", || serving.metric("areoid_inserting") == 2.0);
    let refused = serving.insert(&serving.place.insertion("three", json!({})));
    assert_eq!((refused.status, refused.header("retry-after")), (503, "1"));
    for stream in [first, second] {
        assert!(rest(stream).unwrap().text().contains("inserted"));
    }
    eventually("there is room", || serving.metric("areoid_inserting") == 0.0);
    let inserted = serving.insert(&serving.place.insertion("three", json!({})));
    assert!(inserted.text().contains("inserted"));
    assert_eq!(serving.names(), ["one", "pole", "three", "two"]);
}

fn listing(place: &Place) -> Vec<String> {
    let entries = fs::read_dir(place.catalog()).unwrap().map(Result::unwrap);
    let mut names: Vec<_> = entries.map(|entry| entry.file_name().into_string().unwrap()).collect();
    names.extend(
        fs::read_dir(place.catalog().join("archives"))
            .unwrap()
            .map(|entry| entry.unwrap().path().display().to_string()),
    );
    names.sort();
    names
}

#[test]
fn a_failed_insertion_leaves_no_trace() {
    let serving = Serving::new();
    let before = listing(&serving.place);
    fs::write(serving.place.path("rasters/broken.tif"), b"II*\0 no raster").unwrap();
    for temporary in [false, true] {
        let more = json!({ "rasters": [serving.place.path("rasters/broken.tif")], "temporary": temporary });
        assert!(serving.insert(&serving.place.insertion("new", more)).text().contains("error"));
        let more = json!({ "priority": 9, "temporary": temporary });
        assert!(serving.insert(&serving.place.insertion(NAME, more)).text().contains("error"));
    }
    assert_eq!(serving.names(), ["pole"]);
    assert_eq!(listing(&serving.place), before);
    let builds = fs::read_dir(serving.place.catalog().join("build"));
    assert_eq!(builds.map_or(0, Iterator::count), 0);
    assert_eq!(serving.metric("areoid_insertions_failed_total"), 4.0);
}

#[test]
fn what_other_processes_change_is_seen() {
    let serving = Serving::new();
    ingest(&serving.place.catalog(), "other", &[]);
    eventually("it is seen", || serving.names() == ["other", "pole"]);
    remove_dataset(&RealDisk, &serving.place.catalog(), "other").unwrap();
    eventually("it is gone", || serving.names() == ["pole"]);
}

#[test]
fn the_client_inserts_and_removes() {
    let serving = Serving::new();
    let client = Client::new(&format!("http://{}", serving.admin())).unwrap();
    let request = serde_json::from_str(&serving.place.insertion("new", json!({}))).unwrap();
    let inserted = remote::insert(&client, TOKEN, &request, |_| {}).unwrap();
    assert_eq!(inserted["dataset"], "new");
    assert_eq!(serving.names(), ["new", "pole"]);
    assert_eq!(remote::remove(&client, TOKEN, "new").unwrap()["removed"], "new");
    let refused = remote::remove(&client, "a wrong token, too", "pole").unwrap_err();
    assert!(matches!(refused, RemoteError::Refused { status: 401, .. }), "{refused}");
    assert_eq!(serving.names(), ["pole"]);
}

/// The catalog is in one of the states that the changes go through, and each page URL in it is answered
/// or gone: never with another content's bytes.
#[test]
fn a_reader_never_sees_a_mixture() {
    let serving = Serving::new();
    let rounds = if soak() { 1000 } else { 8 };
    let (ended, looks) = (AtomicBool::new(false), AtomicU64::new(0));
    thread::scope(|scope| {
        scope.spawn(|| {
            let mut newest = 0;
            while !ended.load(Relaxed) {
                let catalog = serving.get("/v1/catalog").json();
                let generation = catalog["generation"].as_u64().unwrap();
                assert!(generation >= newest, "back from {newest} to {generation}");
                newest = generation;
                // Generations 1, 4, 7, ...: alone; then inserted, then replaced.
                let datasets = catalog["datasets"].as_array().unwrap();
                let found: Vec<_> = datasets
                    .iter()
                    .map(|one| (one["name"].as_str().unwrap(), one["priority"].as_i64().unwrap()))
                    .collect();
                let expected: &[(&str, i64)] = match (generation - 1) % 3 {
                    0 => &[("pole", 0)],
                    1 => &[("guest", 1), ("pole", 0)],
                    _ => &[("guest", 2), ("pole", 0)],
                };
                assert_eq!(found, expected, "generation {generation}");
                for one in datasets {
                    assert!(one.get("error").is_none(), "{one}");
                    let path = format!(
                        "/v1/pages/{}/{}/0/0/0",
                        one["name"].as_str().unwrap(),
                        one["content"].as_str().unwrap()
                    );
                    let page = serving.get(&path);
                    assert!(
                        page.status == 200 || page.status == 404 && one["name"] == "guest",
                        "{path}"
                    );
                }
                looks.fetch_add(1, Relaxed);
            }
        });
        for _ in 0..rounds {
            for priority in [1, 2] {
                let more = json!({ "priority": priority, "force": true });
                let answer = serving.insert(&serving.place.insertion("guest", more));
                assert!(answer.text().contains("inserted"), "{}", answer.text());
            }
            assert_eq!(serving.remove("guest").status, 200);
        }
        ended.store(true, Relaxed);
    });
    assert!(looks.load(Relaxed) > rounds, "{looks:?} looks");
}
