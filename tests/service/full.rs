//! A disk that fills up during an insertion: one clear error, and everything else goes on.

use std::fs;
use std::path::Path;

use serde_json::json;

use crate::mounted::Mounted;

use super::rig::{NAME, Place, TOKEN, ask, copy, get};
use super::server::Process;

/// All files below a folder, with their bytes.
fn files(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut all = Vec::new();
    for entry in fs::read_dir(folder).unwrap().map(Result::unwrap) {
        if entry.file_type().unwrap().is_dir() {
            all.extend(files(&entry.path()));
        } else {
            all.push((entry.path().display().to_string(), fs::read(entry.path()).unwrap()));
        }
    }
    all.sort();
    all
}

#[test]
#[expect(
    clippy::print_stdout,
    reason = "whoever asks with --nocapture learns that nothing was tested"
)]
fn a_full_disk_ends_an_insertion_and_nothing_else() {
    const PLENTY: u64 = 64 << 20;
    let place = Place::new();
    let Some(disk) = Mounted::new(PLENTY) else {
        println!("not allowed to mount a file system: not tested here");
        return;
    };
    let catalog = disk.path().join("catalog");
    copy(&place.catalog(), &catalog);
    let server = Process::start_on(&place, &catalog, "", &[]);
    let served = || get(server.public, "/v1/catalog").text();
    let authorization = format!("Bearer {TOKEN}");
    let insert = |temporary: bool| {
        let body = place.insertion("new", json!({ "temporary": temporary }));
        let headers = [("authorization", authorization.as_str())];
        ask(server.admin(), "POST", "/v1/datasets", &headers, &body).text()
    };
    let archive = fs::metadata(place.archive()).unwrap().len();

    for temporary in [false, true] {
        let before = (served(), files(&catalog));
        let held: u64 = before.1.iter().map(|(_, bytes)| bytes.len() as u64).sum();
        // No room at all, for half of it, and for all but its end.
        for room in [4096, archive / 2, archive - 4096] {
            disk.resize((held + room).next_multiple_of(4096) + 4096);
            let answer = insert(temporary);
            assert!(answer.contains("No space left on device"), "{room}: {answer}");
            assert_eq!(answer.matches("\"error\"").count(), 1, "{answer}");
            assert!((served(), files(&catalog)) == before, "{room} left something");
            let dataset = get(server.public, &format!("/v1/datasets/{NAME}")).json();
            let content = dataset["content"].as_str().unwrap();
            let page = get(server.public, &format!("/v1/pages/{NAME}/{content}/0/0/0"));
            assert_eq!(page.status, 200);
        }
        disk.resize(PLENTY);
        assert!(insert(temporary).contains("inserted"));
        let headers = [("authorization", authorization.as_str())];
        assert_eq!(ask(server.admin(), "DELETE", "/v1/datasets/new", &headers, "").status, 200);
    }
}
