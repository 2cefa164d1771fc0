//! The same bytes for any threads and memory; nothing to do for the same input; memory is bounded.

use areoid_formats::archive::MipRule;
use areoid_formats::catalog::Catalog;
use tempfile::TempDir;

use super::rig::{self, SMALL, Subject};
use crate::support::geotiff::{Samples, Writing};
use crate::support::raster::{Place, Raster};

#[test]
fn an_archive_is_the_same_for_any_threads_and_any_memory() {
    for subject in &SMALL.all {
        let expected = subject.undisturbed();
        for threads in ["1", "2", "4", "8"] {
            let all = [("0", "0"), ("2048", "3600")];
            // Both for the first; the others alternate.
            let first = std::ptr::eq(subject, &raw const SMALL.all[0]);
            let some = if first { &all[..] } else { &all[usize::from(threads > "2")..][..1] };
            for &(memory, note_every) in some {
                let catalog = TempDir::new().unwrap();
                let options =
                    ["--threads", threads, "--memory-mib", memory, "--note-every-s", note_every];
                subject.ingest(catalog.path(), &options);
                rig::assert_whole(catalog.path(), &expected, &format!("{options:?}"));
            }
        }
    }
}

#[test]
fn the_same_input_again_is_nothing_to_do() {
    let catalog = TempDir::new().unwrap();
    let subject = &SMALL.all[1];
    subject.ingest(catalog.path(), &[]);
    let generation = Catalog::open(catalog.path()).unwrap().generation();
    let archive = rig::archive(catalog.path());
    for options in [&[][..], &["--resume"], &["--force"], &["--resume", "--threads", "1"]] {
        let summary = subject.ingest(catalog.path(), options);
        assert_eq!(summary["already_there"], true, "{options:?}");
        assert_eq!(summary["generation"], generation, "{options:?}");
        rig::assert_whole(catalog.path(), &archive, &format!("{options:?}"));
    }
    let mut said = std::process::Command::new(env!("CARGO_BIN_EXE_areoid"));
    said.arg("ingest").arg(&subject.raster).arg("--catalog").arg(catalog.path());
    said.args(["--page-size", "32", "--name", rig::NAME, "--step-m", "7.5"]);
    let said = said.output().unwrap();
    assert!(String::from_utf8_lossy(rig::stdout(&said)).contains("nothing to do"), "{said:?}");
    assert_eq!(Catalog::open(catalog.path()).unwrap().generation(), generation);

    // Another step is another dataset, which needs to be asked for; so is another rule.
    for options in [["--step-m", "9"], ["--mip", "kaiser"]] {
        let told = subject.command(catalog.path(), &options).output().unwrap();
        let told = rig::assert_told(&told);
        assert!(told.contains("--force"), "{told}");
    }
    rig::assert_whole(catalog.path(), &archive, "after a refusal");
}

/// A raster whose frontier alone is larger than what the build is given.
#[test]
fn memory_is_bounded_whatever_the_frontier() {
    let folder = TempDir::new().unwrap();
    // All around the globe, one unit after another: the frontier is as wide as the raster.
    let shape = (2 * 8 * 62, 24 * 8 * 62);
    let raster = Raster::new(Place::Belt, shape, None, |row, col| {
        let (row, col) = (row as u32, col as u32);
        if row % 97 == 0 && col % 89 == 0 {
            f32::NAN
        } else {
            (row ^ col) as f32
                + (row.wrapping_mul(2_654_435_761) ^ col.wrapping_mul(40_503)) as u8 as f32
        }
    });
    let path = Writing::of(&raster, Samples::Float32).write(&raster, folder.path(), "belt.tif");
    let ingest = |memory: &str, mip: MipRule| {
        let subject = Subject { mip, ..Subject::new(path.clone()) };
        let catalog = TempDir::new().unwrap();
        let options =
            ["--page-size", "64", "--memory-mib", memory, "--threads", "2", "--note-every-s", "1"];
        let output = subject.command(catalog.path(), &options).output().unwrap();
        let summary: serde_json::Value = serde_json::from_slice(rig::stdout(&output)).unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        // A slow machine is told of progress, too.
        let warning = said.lines().find(|line| line.starts_with("warning: ")).map(str::to_owned);
        (summary["peak_memory_bytes"].as_u64().unwrap(), rig::archive(catalog.path()), warning)
    };
    let (plenty, expected, _) = ingest("4096", MipRule::Mean);
    let (little, bytes, warning) = ingest("64", MipRule::Mean);
    assert_eq!(warning, None);
    // Less than it can do with is told, with what it can do with.
    let (least, the_same, warning) = ingest("1", MipRule::Mean);
    let wanted = warning.as_deref().and_then(|warning| {
        let wanted =
            warning.strip_prefix("warning: a step of the work needs more than --memory-mib 1: ");
        wanted?.strip_suffix(" is the least")
    });
    let wanted: u64 = wanted.unwrap_or_else(|| panic!("{warning:?}")).parse().unwrap();
    assert!(the_same == expected);
    assert_eq!(ingest(&wanted.to_string(), MipRule::Mean).2, None, "{wanted} MiB");
    println!("peak {} MiB with plenty, {} MiB of 64", plenty >> 20, little >> 20);
    assert!(bytes == expected);
    let (around, bytes, warning) = ingest("64", MipRule::Kaiser);
    assert_eq!(warning, None);
    println!("peak {} MiB of 64 where parents look around", around >> 20);
    assert!(bytes == ingest("4096", MipRule::Kaiser).1 && bytes != expected);
    // Where the system does not tell, there is nothing to compare.
    if cfg!(target_os = "linux") {
        assert!(plenty > 66 << 20, "{plenty}: nothing had to go to the scratch file");
        assert!(little < 64 << 20, "{little}");
        assert!(around < 64 << 20, "{around}");
        assert!(least < wanted << 20, "{least} bytes, {wanted} MiB were said to do");
    }
}
