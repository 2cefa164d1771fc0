//! Killed between the archive's rename and the manifest's link: what is done need only be linked.

use std::fs;
use std::path::PathBuf;

use areoid_formats::catalog::RealDisk;
use areoid_preprocess::build::Proceed;
use areoid_preprocess::ingest::{Event, Leftover, Outcome, Request, Unfinished, ingest};
use tempfile::TempDir;

use super::rig::{self, NAME, SMALL, Subject, Tiny};

/// A catalog with a dataset beside which the subject's archive stands in its place, unnamed.
fn killed(subject: &Subject) -> (TempDir, PathBuf) {
    let home = TempDir::new().unwrap();
    let catalog = home.path().join("catalog");
    Tiny::new("other").subject.ingest(&catalog, &["--name", "other"]);
    let before = fs::read(catalog.join("manifest.1")).unwrap();
    subject.ingest(&catalog, &[]);
    fs::write(catalog.join("manifest.1"), before).unwrap();
    fs::remove_file(catalog.join("manifest.2")).unwrap();
    let archives = rig::names_in(&catalog.join("archives"));
    let stray = archives.iter().find(|name| name.starts_with(NAME)).unwrap();
    let stray = catalog.join("archives").join(stray);
    (home, stray)
}

/// What an ingest makes, and the events it tells but for hashing.
fn told(request: &Request) -> (Outcome, Vec<Event>) {
    let mut events = Vec::new();
    let outcome = ingest(&RealDisk, request, |event| {
        if !matches!(event, Event::Hashing { .. }) {
            events.push(event);
        }
        Proceed::Yes
    });
    (outcome.unwrap(), events)
}

/// It used to be built once more.
#[test]
fn an_archive_in_its_place_is_only_published() {
    for subject in &SMALL.all {
        let expected = subject.undisturbed();
        let begun = TempDir::new().unwrap();
        subject.half_build(begun.path(), 2, 4);
        for unfinished in [Unfinished::Resume, Unfinished::Discard] {
            let (home, _) = killed(subject);
            let catalog = home.path().join("catalog");
            // One was begun since.
            rig::copy(&begun.path().join("build"), &catalog.join("build"));
            let request = Request { unfinished, ..subject.request(&catalog) };
            let (outcome, events) = told(&request);
            let steps = [Event::Opening, Event::Leftover(Leftover::Whole), Event::Publishing];
            assert_eq!(events, steps);
            assert_eq!((outcome.generation, outcome.resumed_units), (2, 8));
            assert!(!outcome.already_there && outcome.bytes == expected.len() as u64);
            rig::assert_whole(&catalog, &expected, "linked");
            assert_eq!(rig::listed(&catalog), ["other", NAME]);
            assert!(told(&request).0.already_there);
        }
    }
}

#[test]
fn an_archive_of_something_else_or_without_its_end_is_not_published() {
    let subject = &SMALL.all[1];
    let expected = subject.undisturbed();
    let harms: [fn(&PathBuf); 3] = [
        |stray| {
            let bytes = fs::read(stray).unwrap();
            fs::write(stray, &bytes[..bytes.len() - 1]).unwrap();
        },
        |stray| fs::write(stray, "").unwrap(),
        // Under the name of another content.
        |stray| fs::rename(stray, stray.with_file_name("subject-0123456789abcdef.areoid")).unwrap(),
    ];
    for harm in harms {
        let (home, stray) = killed(subject);
        harm(&stray);
        let catalog = home.path().join("catalog");
        let (outcome, _) = told(&subject.request(&catalog));
        assert_eq!(outcome.resumed_units, 0);
        rig::assert_whole(&catalog, &expected, "built");
    }
    let (home, _) = killed(&Subject { step_m: Some(9.0), ..subject.clone() });
    let catalog = home.path().join("catalog");
    assert_eq!(told(&subject.request(&catalog)).0.resumed_units, 0);
    rig::assert_whole(&catalog, &expected, "of another step");
}
