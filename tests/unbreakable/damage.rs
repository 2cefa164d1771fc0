//! What a killed build left is damaged before it is gone on with: more is done again, and the bytes
//! are the same.

use std::fs;
use std::path::{Path, PathBuf};

use areoid_formats::catalog::RealDisk;
use areoid_preprocess::build::Proceed;
use areoid_preprocess::ingest::{Event, Leftover, ingest};
use areoid_preprocess::note::Note;
use areoid_preprocess::scratch::{Scratch, Slot};
use tempfile::TempDir;

use super::rig::{self, NAME, SMALL, Subject, soak};
use crate::support::raster::Random;

/// Units of the small subjects and leaves of a unit; the archive has `DONE` of them, the note speaks of `NOTED`.
const UNITS: u64 = 8;
const LEAVES: u64 = 64;
const NOTED: usize = 3;
const DONE: usize = 6;

/// A killed build and what an undisturbed one makes.
struct Victim {
    subject: &'static Subject,
    left: TempDir,
    archive: Vec<u8>,
}

impl Victim {
    fn new(subject: &'static Subject) -> Self {
        let left = TempDir::new().unwrap();
        subject.half_build(left.path(), NOTED, DONE);
        let names = ["note", "part", "scratch"].map(|extension| format!("{NAME}.{extension}"));
        assert_eq!(rig::names_in(&left.path().join("build")), names);
        Self { subject, left, archive: subject.undisturbed() }
    }

    /// Units found and leaves read by a build that goes on after `harm`.
    fn resumed_after(&self, what: &str, harm: impl FnOnce(&Path)) -> (u64, u64) {
        let catalog = TempDir::new().unwrap();
        rig::copy(self.left.path(), catalog.path());
        harm(&catalog.path().join("build"));
        let (outcome, leaves) = self.subject.resume(catalog.path());
        rig::assert_whole(catalog.path(), &self.archive, what);
        assert!(!outcome.already_there, "{what}");
        (outcome.resumed_units, leaves)
    }
}

/// How often something random is tried.
fn times(short: u32, long: u32) -> u32 {
    if soak() { long } else { short }
}

fn file(build: &Path, extension: &str) -> PathBuf {
    build.join(format!("{NAME}.{extension}"))
}

fn change(path: &Path, change: impl FnOnce(&mut Vec<u8>)) {
    let mut bytes = fs::read(path).unwrap();
    change(&mut bytes);
    fs::write(path, bytes).unwrap();
}

#[test]
fn a_note_saves_reading_again_what_it_speaks_of() {
    for subject in &SMALL.all {
        let victim = Victim::new(subject);
        let (units, noted) = victim.resumed_after("unharmed", |_| {});
        assert_eq!(units, DONE as u64);
        let (_, all) = victim.resumed_after("no note", |build| {
            fs::remove_file(file(build, "note")).unwrap();
        });
        assert_eq!((noted, all), (LEAVES * (UNITS - NOTED as u64), LEAVES * UNITS));
    }
}

/// A note that does not hold was announced as if it did, and the room it names stayed taken.
#[test]
fn a_note_of_no_use_is_not_announced_and_takes_no_room() {
    for subject in &SMALL.all {
        let victim = Victim::new(subject);
        // Units that are announced to be done again, and the length of the scratch file in the end.
        let gone_on_after = |harm: &dyn Fn(&Path)| {
            let catalog = TempDir::new().unwrap();
            rig::copy(victim.left.path(), catalog.path());
            let build = catalog.path().join("build");
            harm(&build);
            let (mut announced, mut length) = (Vec::new(), 0);
            let outcome = ingest(&RealDisk, &subject.request(catalog.path()), |event| {
                match event {
                    Event::Leftover(Leftover::Resumed { units, again }) => {
                        assert_eq!(units, DONE as u64);
                        announced.push(again);
                    }
                    Event::Building(_) => {
                        length = fs::metadata(file(&build, "scratch")).unwrap().len();
                    }
                    _ => {}
                }
                Proceed::Yes
            });
            assert_eq!(outcome.unwrap().resumed_units, DONE as u64);
            rig::assert_whole(catalog.path(), &victim.archive, "announced");
            assert!(matches!(announced[..], [_]), "{announced:?}");
            (announced[0], length)
        };
        let (again, _) = gone_on_after(&|_| {});
        assert_eq!(again, (DONE - NOTED) as u64);
        let without = gone_on_after(&|build| fs::remove_file(file(build, "note")).unwrap());
        let flipped = gone_on_after(&|build| {
            change(&file(build, "scratch"), |scratch| {
                let note = Note::from_bytes(&fs::read(file(build, "note")).unwrap()).unwrap();
                scratch[note.pages[0].1.offset as usize] ^= 1;
            });
        });
        assert_eq!((without.0, flipped.0), (DONE as u64, DONE as u64));
        // Pages come in any order, and fit the room of others more or less.
        let (without, flipped) = (without.1 as f64, flipped.1 as f64);
        assert!(flipped < 1.1 * without, "{flipped} bytes, without a note {without}");
    }
}

/// Its checksums hold, and what it says of the scratch file does not: such a build failed whenever it
/// was gone on with.
#[test]
fn a_note_that_mistakes_its_pages_is_no_note() {
    for subject in &SMALL.all {
        let victim = Victim::new(subject);
        let mistaken = |mistake: &dyn Fn(&mut Note)| {
            let (units, leaves) = victim.resumed_after("a note mistaken", |build| {
                change(&file(build, "note"), |bytes| {
                    let mut note = Note::from_bytes(bytes).unwrap();
                    mistake(&mut note);
                    *bytes = note.to_bytes();
                });
            });
            assert_eq!((units, leaves), (DONE as u64, LEAVES * UNITS));
        };
        let scratch = fs::read(file(&victim.left.path().join("build"), "scratch")).unwrap();
        mistaken(&|note| {
            let slot = &mut note.pages[0].1;
            let (start, half) = (slot.offset as usize, slot.length as usize / 2);
            let other = Scratch::new(tempfile::tempfile().unwrap(), &[]).unwrap();
            let of_half = other.put(&[&scratch[start..start + half]]).unwrap();
            *slot = Slot { offset: slot.offset, ..of_half };
        });
        mistaken(&|note| note.archive ^= 1);
        mistaken(&|note| note.units = UNITS + 1);
    }
}

#[test]
fn a_damaged_note_is_no_note() {
    for (seed, subject) in (0..).zip(&SMALL.all) {
        let victim = Victim::new(subject);
        let mut random = Random(seed);
        for _ in 0..times(1, 9) {
            let at = random.unit();
            let place = |bytes: &Vec<u8>| (at * bytes.len() as f64) as usize;
            let (units, _) = victim.resumed_after("a note cut", |build| {
                change(&file(build, "note"), |note| note.truncate(place(note)));
            });
            assert_eq!(units, DONE as u64);
            let (units, _) = victim.resumed_after("a note flipped", |build| {
                change(&file(build, "note"), |note| {
                    let at = place(note);
                    note[at] ^= 4;
                });
            });
            assert_eq!(units, DONE as u64);
        }
        victim.resumed_after("half a note beside", |build| {
            fs::write(file(build, "note-new"), "0123").unwrap();
        });
    }
}

#[test]
fn anothers_files_are_not_believed() {
    let victims: Vec<Victim> = SMALL.all.iter().map(Victim::new).collect();
    for (one, other) in [(0, 1), (1, 0), (2, 1)] {
        let (victim, other) = (&victims[one], victims[other].left.path().join("build"));
        for extensions in [&["note"][..], &["scratch"], &["note", "scratch"]] {
            let (units, _) = victim.resumed_after("another's note", |build| {
                for extension in extensions {
                    fs::copy(file(&other, extension), file(build, extension)).unwrap();
                }
            });
            assert_eq!(units, DONE as u64);
        }
        let (units, _) = victim.resumed_after("another's archive", |build| {
            fs::copy(file(&other, "part"), file(build, "part")).unwrap();
        });
        assert_eq!(units, 0);
    }
}

#[test]
fn a_scratch_file_is_believed_by_its_checksums_alone() {
    for (seed, subject) in (7..).zip(&SMALL.all) {
        let victim = Victim::new(subject);
        let mut random = Random(seed);
        for _ in 0..times(1, 9) {
            let at = random.unit();
            let (units, _) = victim.resumed_after("a scratch file cut", |build| {
                change(&file(build, "scratch"), |scratch| {
                    scratch.truncate((at * scratch.len() as f64) as usize);
                });
            });
            assert_eq!(units, DONE as u64);
            let mut noise = Random(random.bits());
            victim.resumed_after("a scratch file overwritten", |build| {
                change(&file(build, "scratch"), |scratch| {
                    let start = (at * scratch.len() as f64) as usize;
                    scratch[start..].fill_with(|| noise.bits() as u8);
                });
            });
        }
        victim.resumed_after("no scratch file", |build| {
            fs::remove_file(file(build, "scratch")).unwrap();
        });
    }
}

/// A byte of the padding behind a record was proven by nothing: flipped, it stayed in the archive.
#[test]
fn an_archive_is_gone_on_with_from_before_its_damage() {
    for (seed, subject) in (20..).zip(&SMALL.all) {
        let victim = Victim::new(subject);
        let mut random = Random(seed);
        let mut found = [false; UNITS as usize];
        for _ in 0..times(4, 30) {
            let at = random.unit();
            let (cut, _) = victim.resumed_after("an archive cut", |build| {
                change(&file(build, "part"), |part| {
                    part.truncate((at * part.len() as f64) as usize);
                });
            });
            let (flipped, _) = victim.resumed_after("an archive flipped", |build| {
                change(&file(build, "part"), |part| {
                    let at = (at * part.len() as f64) as usize;
                    part[at] ^= 1;
                });
            });
            assert!(cut < DONE as u64 && flipped == cut, "{flipped} units of {cut}");
            found[cut as usize] = true;
        }
        assert!(found.iter().filter(|&&found| found).count() > 1, "{found:?}");
        let (units, _) = victim.resumed_after("an empty archive", |build| {
            fs::write(file(build, "part"), "").unwrap();
        });
        assert_eq!(units, 0);
        // Behind the last marker nothing counts.
        let (units, _) = victim.resumed_after("an archive with something behind", |build| {
            change(&file(build, "part"), |part| part.extend(vec![0xa5; 10_000]));
        });
        assert_eq!(units, DONE as u64);
    }
}

/// All units done and only the index missing: nothing is read again, whatever became of the note.
#[test]
fn an_archive_that_only_lacks_its_end_needs_no_raster() {
    for subject in &SMALL.all {
        let left = TempDir::new().unwrap();
        subject.half_build(left.path(), 0, UNITS as usize);
        let victim = Victim { subject, left, archive: subject.undisturbed() };
        let (units, leaves) = victim.resumed_after("all units", |_| {});
        assert_eq!((units, leaves), (UNITS, 0));
    }
}

/// Wherever the last note was and wherever the build ended.
#[test]
fn any_note_and_any_end_go_on_to_the_same_bytes() {
    let mut random = Random(99);
    for subject in &SMALL.all {
        let archive = subject.undisturbed();
        for _ in 0..times(2, 20) {
            let catalog = TempDir::new().unwrap();
            let mut ends = [0, 1, 2, 3].map(|_| 1 + random.bits() as usize % (UNITS as usize - 1));
            ends.sort_unstable();
            let [first, second, third, last] = ends;
            subject.half_build(catalog.path(), first, second);
            if third > second && last > third {
                subject.half_build(catalog.path(), third, last);
            }
            let (outcome, _) = subject.resume(catalog.path());
            assert!(outcome.resumed_units >= second as u64, "{ends:?}");
            rig::assert_whole(catalog.path(), &archive, &format!("{ends:?}"));
        }
    }
}
