//! Rasters that change while they are read: noticed, named, and nothing is published.

use std::error::Error;
use std::fs::{self, File};
use std::io::{Seek as _, SeekFrom, Write as _};
use std::path::Path;
use std::time::{Duration, SystemTime};

use areoid_formats::catalog::RealDisk;
use areoid_preprocess::build::Proceed;
use areoid_preprocess::ingest::{Event, ingest};
use tempfile::TempDir;

use super::rig::{self, SMALL, Subject, soak};

/// What is done to a raster, or to the file that takes its place.
type Change = fn(&Path);

const CHANGES: [(&str, Change); 6] = [
    ("appended to", |raster| {
        File::options().append(true).open(raster).unwrap().write_all(b"more").unwrap();
    }),
    ("touched", |raster| {
        let file = File::options().write(true).open(raster).unwrap();
        file.set_modified(SystemTime::now() + Duration::from_secs(2)).unwrap();
    }),
    ("written to", |raster| {
        let mut file = File::options().write(true).open(raster).unwrap();
        file.write_all(b"II").unwrap();
        file.set_modified(SystemTime::UNIX_EPOCH).unwrap();
    }),
    ("replaced", |raster| {
        let other = raster.with_extension("new");
        fs::copy(raster, &other).unwrap();
        fs::rename(other, raster).unwrap();
    }),
    ("removed", |raster| fs::remove_file(raster).unwrap()),
    // Reading fails, and the reader cannot know why: the build used to be kept to go on with, though
    // what it holds may be of another raster.
    ("cut", |raster| File::options().write(true).open(raster).unwrap().set_len(9000).unwrap()),
];

#[test]
fn a_raster_that_changes_while_it_is_read_is_noticed() {
    for (number, original) in SMALL.all.iter().enumerate() {
        let expected = original.undisturbed();
        // Each change in one of the files, or in all.
        let changes = CHANGES.iter().enumerate();
        let some = changes.filter(|(change, _)| soak() || change % SMALL.all.len() == number);
        for (_, &(what, change)) in some {
            let home = TempDir::new().unwrap();
            let raster = home.path().join(original.raster.file_name().unwrap());
            fs::copy(&original.raster, &raster).unwrap();
            let subject = Subject { raster: raster.clone(), ..original.clone() };
            let catalog = home.path().join("catalog");
            let other = ["--name", "other"];
            subject.ingest(&catalog, &other);
            let before = fs::read(catalog.join("manifest.1")).unwrap();

            let mut changed = false;
            let error = ingest(&RealDisk, &subject.request(&catalog), |event| {
                let building =
                    matches!(event, Event::Building(progress) if progress.units_done > 0);
                if building && !std::mem::replace(&mut changed, true) {
                    change(&raster);
                }
                Proceed::Yes
            });
            let error = error.unwrap_err();
            let causes = std::iter::successors(Some(&error as &dyn Error), |&error| error.source());
            let text: Vec<String> = causes.map(ToString::to_string).collect();
            let name = raster.file_name().unwrap().to_str().unwrap();
            assert!(text.join(": ").contains(name), "{what}: {text:?}");
            assert!(text.join(": ").contains("modified"), "{what}: {text:?}");
            assert!(!error.can_be_resumed(), "{what}");
            assert_eq!(fs::read(catalog.join("manifest.1")).unwrap(), before, "{what}");
            assert_eq!(rig::names_in(&catalog.join("archives")).len(), 1, "{what}");
            assert_eq!(rig::names_in(&catalog.join("build")), [] as [&str; 0], "{what}");

            // What was begun with the raster as it was has nothing to do with it as it is again.
            fs::copy(&original.raster, &raster).unwrap();
            let (outcome, _) = subject.resume(&catalog);
            assert_eq!(outcome.resumed_units, 0, "{what}");
            rig::assert_whole(&catalog, &expected, what);
        }
    }
}

/// A raster changed while it was read, the build killed, the raster changed back: its hash is that of
/// the build, and units made of the changed raster were gone on with.
#[test]
fn no_unit_of_a_changed_raster_is_gone_on_with() {
    let original = &SMALL.all[0];
    let expected = original.undisturbed();
    // What is read of one unit ahead is read before the change.
    for (changed_at, killed_at) in [(0, 1), (1, 3), (3, 5)] {
        let home = TempDir::new().unwrap();
        let raster = home.path().join("heights.tif");
        fs::copy(&original.raster, &raster).unwrap();
        let subject = Subject { raster: raster.clone(), ..original.clone() };
        let catalog = home.path().join("catalog");
        let change = || {
            let mut file = File::options().write(true).open(&raster).unwrap();
            // Samples alone: they stand between the header and the directory.
            file.seek(SeekFrom::Start(64)).unwrap();
            file.write_all(&[0x40; 1 << 20]).unwrap();
            file.set_modified(SystemTime::now() + Duration::from_secs(2)).unwrap();
        };
        let killed = std::panic::AssertUnwindSafe(|| {
            ingest(&RealDisk, &subject.request(&catalog), |event| {
                match event {
                    Event::Building(progress) if progress.units_done == changed_at => change(),
                    Event::Building(progress) if progress.units_done == killed_at => {
                        std::panic::resume_unwind(Box::new("killed"))
                    }
                    _ => {}
                }
                Proceed::Yes
            })
        });
        let _ = std::panic::catch_unwind(killed);
        fs::copy(&original.raster, &raster).unwrap();
        subject.resume(&catalog);
        rig::assert_whole(&catalog, &expected, &format!("changed at {changed_at}"));
    }
}
