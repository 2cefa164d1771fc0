//! Killed at random instants: every catalog opens and verifies, every resumed archive is that of
//! an undisturbed ingest.

use std::os::unix::process::ExitStatusExt as _;
use std::time::{Duration, Instant};

use serde_json::Value;
use tempfile::TempDir;

use super::rig::{self, NAME, Subject, Subjects, Tiny, soak, stdout};
use crate::support::raster::Random;

const OTHER: &str = "other";

/// Options that change nothing in the archive.
fn any_options(random: &mut Random) -> Vec<&'static str> {
    let mut one_of = |choices: &[&'static str]| choices[random.bits() as usize % choices.len()];
    let threads = one_of(&["1", "2", "4", "8"]);
    let memory = one_of(&["0", "2048"]);
    let note_every = one_of(&["0", "0.05", "3600"]);
    vec!["--threads", threads, "--memory-mib", memory, "--note-every-s", note_every]
}

/// How it ended for a run that was to be killed.
enum End {
    Killed,
    Done(Value),
}

/// Runs an ingest and kills it at a random instant of `duration`.
fn kill(
    random: &mut Random,
    subject: &Subject,
    catalog: &TempDir,
    options: &[&str],
    duration: Duration,
) -> End {
    let mut process = subject.command(catalog.path(), options).spawn().unwrap();
    std::thread::sleep(duration.mul_f64(random.unit()));
    process.kill().unwrap();
    let output = process.wait_with_output().unwrap();
    if output.status.signal() == Some(9) {
        return End::Killed;
    }
    End::Done(serde_json::from_slice(stdout(&output)).unwrap())
}

/// What the kills of a test hit.
#[derive(Debug, Default)]
struct Tally {
    runs: u32,
    kills: u32,
    /// Kills that left an archive with records.
    half_way: u32,
    /// Kills behind the link of the new manifest.
    published: u32,
    /// Resumed runs that found work units done.
    resumed: u32,
    units: u64,
}

#[test]
fn killed_at_any_instant_a_catalog_opens_and_the_archive_is_resumed() {
    let subjects = Subjects::new(3);
    let runs = if soak() { 200 } else { 12 };
    let template = TempDir::new().unwrap();
    let tiny = Tiny::new("other");
    let other = &tiny.subject;
    other.ingest(template.path(), &["--name", OTHER]);
    // What `--force` replaces.
    let replaced = TempDir::new().unwrap();
    rig::copy(template.path(), replaced.path());
    other.ingest(replaced.path(), &[]);
    let old = rig::archive(replaced.path());

    let undisturbed: Vec<(Vec<u8>, Duration)> = subjects
        .all
        .iter()
        .map(|subject| {
            let start = Instant::now();
            let archive = subject.undisturbed();
            let duration = start.elapsed();
            // Every resumed archive is this one: it is held against the laws once.
            let home = TempDir::new().unwrap();
            subject.ingest(home.path(), &[]);
            assert_eq!(rig::run("verify", home.path())["ok"], true);
            (archive, duration)
        })
        .collect();
    let mut random = Random(0x0a7e_01d5);
    let mut tally = Tally::default();
    for run in 0..runs {
        let which = run % subjects.all.len();
        let (subject, (archive, duration)) = (&subjects.all[which], &undisturbed[which]);
        let force = run / subjects.all.len() % 3 == 2;
        let catalog = TempDir::new().unwrap();
        rig::copy(if force { &replaced } else { &template }.path(), catalog.path());
        let check = |after: &str| -> bool {
            let names = rig::listed(catalog.path());
            let has = names.iter().any(|name| name == NAME);
            assert_eq!(names.len(), 1 + usize::from(has), "{after}: {names:?}");
            assert!(names.contains(&OTHER.to_owned()) && (has || !force), "{after}: {names:?}");
            let now = has.then(|| rig::archive(catalog.path()));
            if now.as_ref() != Some(archive) {
                assert_eq!(rig::run("verify", catalog.path())["ok"], true, "{after}");
            }
            assert!(now.iter().all(|now| now == archive || force && *now == old), "{after}");
            now.is_some_and(|now| now == *archive)
        };

        let mut done = None;
        for attempt in 0..1 + random.bits() % 3 {
            let mut options = any_options(&mut random);
            options.extend(force.then_some("--force"));
            options.extend((attempt > 0).then_some("--resume"));
            let what = format!("run {run}, attempt {attempt}, {options:?}");
            match kill(&mut random, subject, &catalog, &options, *duration) {
                End::Done(summary) => {
                    done = Some(summary);
                    break;
                }
                End::Killed => {
                    tally.kills += 1;
                    let part = catalog.path().join(format!("build/{NAME}.part"));
                    let begun = part.metadata().is_ok_and(|part| part.len() > 4096);
                    tally.half_way += u32::from(begun);
                    tally.published += u32::from(check(&what));
                }
            }
        }
        let mut options = any_options(&mut random);
        options.extend(["--resume"]);
        options.extend(force.then_some("--force"));
        let summary = done.unwrap_or_else(|| subject.ingest(catalog.path(), &options));
        let units = summary["resumed_units"].as_u64().unwrap();
        tally.resumed += u32::from(units > 0);
        tally.units += units;
        tally.runs += 1;
        if soak() && run % 20 == 19 {
            println!("{tally:?}");
        }
        let what = format!("run {run}, resumed with {options:?}");
        assert!(check(&what), "{what}");
        if summary["already_there"] == true {
            // Killed behind the link: what was to be swept is by the next change.
            other.ingest(catalog.path(), &["--name", "next"]);
        }
        rig::assert_whole(catalog.path(), archive, &what);
    }
    println!("{tally:?}, undisturbed in {:?}", undisturbed.iter().map(|u| u.1).collect::<Vec<_>>());
    // Else the test proves nothing.
    assert!(tally.half_way * 4 >= tally.runs, "{tally:?}");
    assert!(tally.resumed * 4 >= tally.runs, "{tally:?}");
}
