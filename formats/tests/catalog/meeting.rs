//! Writers and readers at once, in threads and processes.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};

use areoid_formats::catalog::{Catalog, RealDisk, remove_dataset};

use crate::rig::{check_swept, height_of, publish, publish_group, shown};

/// Publishes, replaces and removes datasets of its own, and keeps the last.
fn bustle(folder: &Path, who: &str, rounds: u16) {
    for round in 0..rounds {
        let (kept, passing) = (format!("{who}-kept"), format!("{who}-passing"));
        publish(&RealDisk, folder, &kept, round).unwrap();
        publish(&RealDisk, folder, &passing, round).unwrap();
        assert_eq!(shown(folder)[&kept], f32::from(round));
        remove_dataset(&RealDisk, folder, &passing).unwrap();
    }
}

const ROUNDS: u16 = 25;

/// Run by the test below as a process of its own, which says where in the environment.
#[test]
fn child_process() {
    if let Some(folder) = std::env::var_os("AREOID_TEST_CATALOG") {
        bustle(Path::new(&folder), "child", ROUNDS);
    }
}

#[test]
fn writers_that_meet_lose_nothing_and_readers_never_err() {
    let home = tempfile::tempdir().unwrap();
    let folder = home.path().join("mars");
    publish(&RealDisk, &folder, "first", 1).unwrap();
    let mut child = std::process::Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "meeting::child_process"])
        .env("AREOID_TEST_CATALOG", &folder)
        .stdout(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let reader = scope.spawn(|| {
            let (mut generation, mut looks) = (0, 0);
            while !done.load(Ordering::Relaxed) {
                let (catalog, archives) = Catalog::open_with_archives(&folder).unwrap();
                assert!(catalog.generation() >= generation, "a catalog does not go back");
                generation = catalog.generation();
                let first = catalog.datasets().iter().position(|record| record.name == "first");
                assert_eq!(height_of(&archives[first.unwrap()]), 1.0);
                looks += 1;
            }
            looks
        });
        let writers = ["one", "two"].map(|who| {
            let folder = &folder;
            scope.spawn(move || bustle(folder, who, ROUNDS))
        });
        let ended = writers.map(|writer| writer.join());
        let child = child.wait();
        done.store(true, Ordering::Relaxed);
        ended.into_iter().for_each(Result::unwrap);
        assert!(child.unwrap().success());
        assert!(reader.join().unwrap() > 0);
    });
    let last = f32::from(ROUNDS - 1);
    let expected = [("child-kept", last), ("first", 1.0), ("one-kept", last), ("two-kept", last)];
    assert_eq!(shown(&folder), expected.map(|(name, height)| (name.to_owned(), height)).into());
    assert_eq!(Catalog::open(&folder).unwrap().generation(), 1 + 3 * 3 * u64::from(ROUNDS));
    check_swept(&folder);
}

/// Three parts of one round, a dataset, or nothing: never parts of two rounds, or some of them.
#[test]
fn readers_see_a_group_whole_or_not_at_all() {
    let home = tempfile::tempdir().unwrap();
    let folder = home.path().join("mars");
    publish(&RealDisk, &folder, "first", 1).unwrap();
    std::thread::scope(|scope| {
        let writer = scope.spawn(|| {
            for round in 0..ROUNDS {
                let parts = ["band", "north", "south"].map(|part| (part, round));
                publish_group(&RealDisk, &folder, "split", &parts).unwrap();
                match round % 3 {
                    0 => publish(&RealDisk, &folder, "split", round).map(drop).unwrap(),
                    1 => remove_dataset(&RealDisk, &folder, "split").map(drop).unwrap(),
                    _ => {}
                }
            }
        });
        let mut sizes_seen = [0; 4];
        let mut done = false;
        while !done {
            done = writer.is_finished();
            let (catalog, archives) = Catalog::open_with_archives(&folder).unwrap();
            let records = catalog.datasets().iter().zip(&archives);
            let parts = records.filter(|(record, _)| record.answers_to("split"));
            let parts: Vec<_> =
                parts.map(|(record, archive)| (&record.group, height_of(archive))).collect();
            let is_one = parts.windows(2).all(|pair| pair[0] == pair[1]);
            assert!(is_one && parts.len() != 2, "{parts:?}");
            assert_eq!(parts.len() == 3, parts.iter().any(|(group, _)| group.is_some()));
            sizes_seen[parts.len()] += 1;
        }
        writer.join().unwrap();
        assert!(sizes_seen[3] > 0, "{sizes_seen:?}");
    });
    check_swept(&folder);
}
