//! A disk without room: one clear error, the catalog as it was, and after making room `--resume` to
//! the same bytes.

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use tempfile::TempDir;

use crate::mounted::Mounted;

use super::rig::{self, NAME, SMALL, Subject, Tiny, soak};

const OTHER: &str = "other";

/// The manifest and archives of a catalog, with their bytes.
fn committed(catalog: &Path) -> Vec<(String, Vec<u8>)> {
    let manifest = |name: &String| name.starts_with("manifest.");
    let mut names: Vec<String> = rig::names_in(catalog).into_iter().filter(manifest).collect();
    names.extend(rig::names_in(&catalog.join("archives")).iter().map(|n| format!("archives/{n}")));
    names.into_iter().map(|name| (name.clone(), fs::read(catalog.join(name)).unwrap())).collect()
}

/// Checks that an ingest failed for `cause` and took nothing from the catalog; whether it told how to
/// go on.
fn assert_nothing_lost(
    output: &Output,
    cause: &str,
    catalog: &Path,
    before: &[(String, Vec<u8>)],
) -> bool {
    let told = rig::assert_told(output);
    assert!(told.contains(cause), "{told}");
    assert!(committed(catalog) == before, "{told}");
    assert_eq!(rig::listed(catalog), [OTHER]);
    told.contains("to go on: ")
}

fn with_another(catalog: &Path) -> Vec<(String, Vec<u8>)> {
    Tiny::new("other").subject.ingest(catalog, &["--name", OTHER]);
    committed(catalog)
}

/// Runs an ingest that may write no file larger than `blocks` of 512 bytes.
fn limited(subject: &Subject, catalog: &Path, blocks: u64, options: &[&str]) -> Output {
    let command = subject.command(catalog, options);
    let mut shell = Command::new("sh");
    shell.args(["-c", "trap '' XFSZ; ulimit -f \"$0\"; exec \"$@\"", &blocks.to_string()]);
    shell.arg(command.get_program()).args(command.get_args()).output().unwrap()
}

#[test]
fn a_file_that_may_not_grow_is_told_and_gone_on_with() {
    let mut half_way = 0;
    for subject in &SMALL.all {
        let archive = subject.undisturbed();
        let blocks = archive.len() as u64 / 512;
        for (twentieths, memory) in [(1, "0"), (12, "0"), (19, "2048")] {
            let home = TempDir::new().unwrap();
            let before = with_another(home.path());
            let options = ["--memory-mib", memory, "--note-every-s", "0"];
            let limit = blocks * twentieths / 20;
            let output = limited(subject, home.path(), limit, &options);
            let hint = assert_nothing_lost(&output, "File too large", home.path(), &before);
            let summary = subject.ingest(home.path(), &["--resume"]);
            let resumed = summary["resumed_units"].as_u64() > Some(0);
            assert_eq!(hint, resumed, "{twentieths} twentieths");
            half_way += u32::from(resumed);
            rig::assert_whole(home.path(), &archive, &format!("{twentieths} twentieths"));
        }
    }
    assert!(half_way > 2, "{half_way}");
}

/// Sizes around those where each file finds no room: the archive, the scratch file, the note, the
/// manifest.
#[test]
fn a_full_file_system_is_told_and_gone_on_with() {
    let (mut full, mut half_way) = (0, 0);
    for subject in &SMALL.all {
        let archive = subject.undisturbed();
        let other = {
            let home = TempDir::new().unwrap();
            with_another(home.path()).iter().map(|(_, bytes)| bytes.len() as u64).sum::<u64>()
        };
        let page = 4096;
        let (whole, pages) = (other + archive.len() as u64, archive.len() as u64 / page);
        let sizes = [pages / 2, pages / 4, 2, 1, 0].map(|missing| whole - missing * page);
        let sizes = sizes.into_iter().chain((1..10).map(|more| whole + more * page));
        // All of them for one subject, a few for the others.
        let every = if std::ptr::eq(subject, &raw const SMALL.all[0]) || soak() { 1 } else { 4 };
        for size in sizes.step_by(every) {
            let Some(disk) = Mounted::new(size.next_multiple_of(page)) else {
                println!("not allowed to mount a file system: not tested here");
                return;
            };
            let catalog = disk.path().join("catalog");
            let before = with_another(&catalog);
            let output = subject
                .command(&catalog, &["--memory-mib", "2048", "--note-every-s", "3600"])
                .output()
                .unwrap();
            let what = format!("{size} bytes for {whole}");
            if !output.status.success() {
                full += 1;
                let hint =
                    assert_nothing_lost(&output, "No space left on device", &catalog, &before);
                disk.resize(64 << 20);
                let summary = subject.ingest(&catalog, &["--resume"]);
                let units = summary["resumed_units"].as_u64().unwrap();
                assert_eq!(hint, units > 0, "{what}");
                half_way += u32::from(units > 0);
                if size >= whole {
                    assert!(units > 0, "{what}: {NAME} was done, and was begun again");
                }
            }
            rig::assert_whole(&catalog, &archive, &what);
        }
    }
    println!("{full} full file systems, {half_way} half-way builds");
    assert!(half_way > 6, "{half_way} of {full}");
}
