//! A split raster is one dataset: killed at any unit of any part, stopped at any event, replaced and
//! removed.

use std::fs;
use std::path::Path;

use areoid_formats::catalog::{Catalog, RealDisk};
use areoid_preprocess::build::Proceed;
use areoid_preprocess::ingest::{
    Event, Existing, IngestError, Leftover, Outcome, Request, TargetGrid, Unfinished, ingest,
};
use serde_json::Value;
use tempfile::TempDir;

use super::rig::{self, NAME, SMALL, Subject, Subjects, soak};

const PARTS: [&str; 3] = ["subject.band", "subject.north", "subject.south"];

/// Work units of the parts.
const UNITS: [usize; 3] = [8, 4, 4];

/// The subject split into `catalog`.
fn request(subject: &Subject, catalog: &Path) -> Request {
    Request { grid: TargetGrid::Split, ..subject.request(catalog) }
}

fn split(request: &Request) -> Outcome {
    ingest(&RealDisk, request, |_| Proceed::Yes).unwrap()
}

/// The bytes of the parts, which are all that there is of the subject.
fn archives(catalog: &Path) -> Vec<Vec<u8>> {
    let opened = Catalog::open(catalog).unwrap();
    let parts = opened.named(NAME).unwrap();
    assert_eq!(parts.iter().map(|part| &part.name).collect::<Vec<_>>(), PARTS);
    parts.iter().map(|part| fs::read(opened.archive_path(part)).unwrap()).collect()
}

/// The archives of an undisturbed ingest, which keep all laws.
fn undisturbed(subject: &Subject) -> Vec<Vec<u8>> {
    let home = TempDir::new().unwrap();
    let outcome = split(&request(subject, home.path()));
    assert_eq!(outcome.resumed_units, 0);
    assert_eq!(rig::run("verify", home.path())["ok"], true);
    archives(home.path())
}

/// Nothing is to be seen of the subject.
fn assert_invisible(catalog: &Path, what: &str) {
    let seen = Catalog::open(catalog).is_ok_and(|catalog| !catalog.datasets().is_empty());
    assert!(!seen, "{what}");
}

fn assert_whole(catalog: &Path, expected: &[Vec<u8>], what: &str) {
    assert!(archives(catalog) == expected, "{what}: an archive differs");
    assert_eq!(rig::names_in(&catalog.join("build")), [] as [&str; 0], "{what}");
    assert_eq!(rig::names_in(&catalog.join("archives")).len(), PARTS.len(), "{what}");
}

#[test]
fn killed_in_any_part_it_goes_on_to_the_same_bytes() {
    let expected: Vec<_> = SMALL.all.iter().map(undisturbed).collect();
    let all: usize = UNITS.iter().sum();
    for kill_at in (1..=all).step_by(if soak() { 1 } else { 2 }) {
        let which = kill_at % SMALL.all.len();
        let (subject, expected) = (&SMALL.all[which], &expected[which]);
        let catalog = TempDir::new().unwrap();
        let asked = request(subject, catalog.path());
        let die = std::panic::AssertUnwindSafe(|| {
            ingest(&RealDisk, &asked, |event| match event {
                Event::Building(progress) if progress.units_done >= kill_at => {
                    assert_eq!(progress.units, all);
                    std::panic::resume_unwind(Box::new("killed"))
                }
                _ => Proceed::Yes,
            })
        });
        assert!(std::panic::catch_unwind(die).is_err());
        let what = format!("{}, killed after {kill_at}", subject.raster.display());
        assert_invisible(catalog.path(), &what);

        let mut seen = Vec::new();
        let outcome = ingest(&RealDisk, &asked, |event| {
            if let Event::Building(progress) = event {
                seen.push(progress);
            }
            Proceed::Yes
        });
        let outcome = outcome.unwrap();
        // What is whole is not built again, and of the rest nothing is lost but what the process
        // had not handed over.
        let whole: usize = (0..3)
            .map(|parts| UNITS[..parts + 1].iter().sum())
            .filter(|&units: &usize| units < kill_at)
            .max()
            .unwrap_or(0);
        let resumed = outcome.resumed_units as usize;
        assert!(resumed >= whole.max(kill_at - 1) && resumed <= kill_at, "{what}: {resumed}");
        assert!(seen.is_sorted_by_key(|progress| (progress.units_done, progress.texels)), "{what}");
        let last = seen.last().unwrap();
        assert_eq!((last.units_done, last.units), (all, all), "{what}");
        let read: u64 = outcome
            .parts
            .iter()
            .map(|part| {
                let extent = part.grid.pyramid().extent();
                u64::from(extent.width) * u64::from(extent.height)
            })
            .sum();
        assert_eq!(last.texels, read, "{what}");
        assert_whole(catalog.path(), expected, &what);
    }
}

#[test]
fn a_wish_to_stop_is_heeded_in_every_part() {
    // A unit or two a part.
    let subject = &Subjects::new(1).all[1];
    let expected = undisturbed(subject);
    for stop_at in 0.. {
        let catalog = TempDir::new().unwrap();
        let asked = request(subject, catalog.path());
        let mut events = Vec::new();
        let stopped = ingest(&RealDisk, &asked, |event| {
            events.push(event);
            if events.len() > stop_at { Proceed::No } else { Proceed::Yes }
        });
        let what = format!("stopped at {stop_at}: {:?}", events.last());
        let Err(error) = stopped else {
            assert!(matches!(events[stop_at], Event::Publishing), "{what}");
            break;
        };
        assert!(error.is_interruption() && events.len() == stop_at + 1, "{what}: {error}");
        assert_invisible(catalog.path(), &what);
        let begun = matches!(events[stop_at], Event::Building(progress) if progress.units_done > 0);
        assert_eq!(error.can_be_resumed(), begun, "{what}");
        let build = catalog.path().join("build");
        assert_eq!(begun, build.exists() && !rig::names_in(&build).is_empty(), "{what}");
        let outcome = split(&asked);
        assert_eq!(outcome.resumed_units > 0, begun, "{what}");
        assert_whole(catalog.path(), &expected, &what);
    }
}

/// Killed between the first archive's rename and the manifest's link: some archives are in their
/// places, the others whole where they were built.
#[test]
fn parts_in_their_places_are_published_with_the_others() {
    let subject = &SMALL.all[0];
    let expected = undisturbed(subject);
    for in_place in 1_usize..=3 {
        for unfinished in [Unfinished::Resume, Unfinished::Discard] {
            let catalog = TempDir::new().unwrap();
            let asked = Request { unfinished, ..request(subject, catalog.path()) };
            split(&asked);
            fs::remove_file(catalog.path().join("manifest.1")).unwrap();
            let folder = catalog.path().join("archives");
            for (name, part) in rig::names_in(&folder).iter().zip(PARTS).skip(in_place) {
                assert!(name.starts_with(part));
                let build = catalog.path().join(format!("build/{part}.part"));
                fs::rename(folder.join(name), build).unwrap();
            }
            assert_invisible(catalog.path(), "without its manifest");
            let mut leftovers = Vec::new();
            let outcome = ingest(&RealDisk, &asked, |event| {
                if let Event::Leftover(leftover) = event {
                    leftovers.push(leftover);
                }
                Proceed::Yes
            });
            let outcome = outcome.unwrap();
            let what = format!("{in_place} in place, {unfinished:?}");
            let kept = if unfinished == Unfinished::Resume { 3 } else { in_place };
            assert_eq!(
                outcome.resumed_units as usize,
                UNITS[..kept].iter().sum::<usize>(),
                "{what}"
            );
            assert_eq!(leftovers == [Leftover::Whole], in_place == 3, "{what}: {leftovers:?}");
            let discarded = leftovers.contains(&Leftover::Discarded);
            assert_eq!(discarded, kept < 3, "{what}: {leftovers:?}");
            assert_whole(catalog.path(), &expected, &what);
        }
    }
}

#[test]
fn a_raster_and_its_split_replace_each_other_as_one() {
    let (subject, catalog) = (&SMALL.all[0], TempDir::new().unwrap());
    let ingest = |options: &[&str]| subject.command(catalog.path(), options).output().unwrap();
    let done = |options: &[&str]| -> Value {
        serde_json::from_slice(rig::stdout(&ingest(options))).unwrap()
    };
    let split = ["--grid", "split"];
    let names = |told: &Value| -> Vec<String> {
        let parts = told["parts"].as_array().unwrap().iter();
        parts.map(|part| part["name"].as_str().unwrap().to_owned()).collect()
    };
    let first = done(&split);
    assert_eq!((&first["dataset"], &first["generation"]), (&NAME.into(), &1.into()));
    assert_eq!(names(&first), PARTS);
    assert_eq!(rig::listed(catalog.path()), PARTS);
    let expected = archives(catalog.path());
    let again = done(&split);
    assert_eq!((&again["already_there"], &again["generation"]), (&true.into(), &1.into()));
    for same in ["parts", "pages", "bytes", "bound", "saved_texels"] {
        assert_eq!(first[same], again[same], "{same}");
        assert!(!first[same].is_null(), "{same}");
    }
    // That takes building one pyramid.
    assert!(first["saved_bytes"].is_i64() && again["saved_bytes"].is_null());

    // On other options, and on the raster's own grid, only by force.
    for options in [&["--grid", "split", "--priority", "3"][..], &[]] {
        let refused = rig::assert_told(&ingest(options));
        assert!(refused.contains("called subject is there already"), "{refused}");
        assert_whole(catalog.path(), &expected, "refused");
    }
    let native = done(&["--force"]);
    assert_eq!((names(&native), &native["saved_texels"]), (vec![NAME.to_owned()], &Value::Null));
    assert_eq!(rig::listed(catalog.path()), [NAME]);
    assert_eq!(rig::names_in(&catalog.path().join("archives")).len(), 1);
    let refused = rig::assert_told(&ingest(&split));
    assert!(refused.contains("called subject is there already"), "{refused}");
    assert_eq!(done(&["--grid", "split", "--force"])["generation"], 3);
    assert_whole(catalog.path(), &expected, "replaced");

    areoid_formats::catalog::remove_dataset(&RealDisk, catalog.path(), NAME).unwrap();
    assert_eq!(rig::listed(catalog.path()), [] as [&str; 0]);
    assert_eq!(rig::names_in(&catalog.path().join("archives")), [] as [&str; 0]);
}

/// One part that cannot be read is no reason to keep the others.
#[test]
fn a_group_with_a_damaged_part_is_replaced() {
    let (subject, catalog) = (&SMALL.all[1], TempDir::new().unwrap());
    let asked = request(subject, catalog.path());
    split(&asked);
    let expected = archives(catalog.path());
    let opened = Catalog::open(catalog.path()).unwrap();
    fs::write(opened.archive_path(opened.dataset(PARTS[1]).unwrap()), "no archive").unwrap();
    let refused = ingest(&RealDisk, &asked, |_| Proceed::Yes).unwrap_err();
    assert!(matches!(refused, IngestError::Catalog(_)), "{refused}");
    split(&Request { existing: Existing::Replace, ..asked });
    assert_whole(catalog.path(), &expected, "replaced");
}
