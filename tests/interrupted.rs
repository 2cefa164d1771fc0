//! An ingest that is stopped says how to go on, and what goes on makes the same archive.

#![cfg(unix)]
#![expect(clippy::unwrap_used, reason = "a failed test may panic")]

use std::fs;
use std::io::{BufRead as _, BufReader, Read as _};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

use serde_json::Value;
use tempfile::TempDir;
use tiff::encoder::TiffEncoder;
use tiff::encoder::colortype::GrayI16;
use tiff::tags::Tag;

/// A name that a shell would not leave in one piece.
const RASTER: &str = "map of Mars.tif";
/// Leaves of 14 x 14 texels make some forty work units of such a raster.
const SIDE: u32 = 700;
const OPTIONS: [&str; 6] = ["--page-size", "16", "--name", "map-of-mars", "--note-every-s", "0"];
const HINT: &str = "to go on: ";

/// A folder with a raster that takes a while.
struct Bench {
    folder: TempDir,
}

impl Bench {
    fn new() -> Self {
        let bench = Self { folder: TempDir::new().unwrap() };
        bench.write_raster(0);
        bench
    }

    fn write_raster(&self, seed: u32) {
        let noise = |at: u32| at.wrapping_add(seed).wrapping_mul(0x9e37_79b9) >> 24;
        let samples: Vec<i16> =
            (0..SIDE * SIDE).map(|at| i16::try_from(at % SIDE + noise(at)).unwrap()).collect();
        let file = fs::File::create(self.path(RASTER)).unwrap();
        let mut encoder = TiffEncoder::new(file).unwrap();
        let mut image = encoder.new_image::<GrayI16>(SIDE, SIDE).unwrap();
        let tags = image.encoder();
        let keys: [u16; 16] = [1, 1, 0, 3, 1024, 0, 1, 2, 1025, 0, 1, 1, 2048, 0, 1, 4326];
        tags.write_tag(Tag::ModelPixelScaleTag, &[0.01, 0.01, 0.0][..]).unwrap();
        tags.write_tag(Tag::ModelTiepointTag, &[0.0, 0.0, 0.0, 10.0, 50.0, 0.0][..]).unwrap();
        tags.write_tag(Tag::GeoKeyDirectoryTag, &keys[..]).unwrap();
        image.write_data(&samples).unwrap();
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn command(&self, catalog: &str, more: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_areoid"));
        command.current_dir(self.folder.path());
        command.args(["ingest", RASTER, "--catalog", catalog]).args(OPTIONS).args(more);
        command
    }

    fn ingest(&self, catalog: &str, more: &[&str]) -> Output {
        self.command(catalog, more).output().unwrap()
    }

    /// Stops an ingest as soon as it has noted a unit; what it says on stderr.
    fn interrupted(&self, catalog: &str, signal: &str) -> String {
        let mut child = self
            .command(catalog, &[])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let note = self.path(catalog).join("build/map-of-mars.note");
        while !note.exists() {
            assert!(child.try_wait().unwrap().is_none(), "it ended before it was stopped");
            std::thread::yield_now();
        }
        send(signal, &child);
        let output = child.wait_with_output().unwrap();
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(output.stdout.is_empty());
        said
    }
}

fn send(signal: &str, child: &Child) {
    let process = child.id().to_string();
    assert!(Command::new("kill").args([signal, &process]).status().unwrap().success());
}

/// The command a hint names.
fn hint(said: &str) -> &str {
    said.lines().find_map(|line| line.strip_prefix(HINT)).unwrap_or_else(|| panic!("{said}"))
}

fn succeeded(output: &Output) -> String {
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    said
}

fn json(output: &Output) -> Value {
    succeeded(output);
    serde_json::from_slice(&output.stdout).unwrap()
}

/// The archive of the only dataset.
fn archive(catalog: &Path) -> Vec<u8> {
    let files: Vec<_> = fs::read_dir(catalog.join("archives")).unwrap().collect();
    assert_eq!(files.len(), 1);
    fs::read(files.into_iter().next().unwrap().unwrap().path()).unwrap()
}

#[test]
fn the_command_that_an_interrupted_ingest_prints_makes_the_same_archive() {
    let bench = Bench::new();
    let undisturbed = json(&bench.ingest("undisturbed", &["--json"]));
    assert_eq!(undisturbed["resumed_units"], 0);
    let expected = archive(&bench.path("undisturbed"));
    let figures = ["pages", "bytes", "bound", "source_error"];

    for (catalog, signal) in [("interrupted", "-INT"), ("terminated", "-TERM")] {
        let said = bench.interrupted(catalog, signal);
        assert!(said.contains("stopping after this unit; once more stops at once"), "{said}");
        let errors = said.lines().filter(|line| line.starts_with("error: "));
        let errors: Vec<_> = errors.collect();
        assert!(matches!(errors[..], [one] if one.starts_with("error: interrupted after ")));
        assert!(said.lines().all(|line| !line.contains("caused by")), "{said}");

        let command = format!("{} --json", hint(&said));
        let mut shell = Command::new("sh");
        shell.current_dir(bench.folder.path()).args(["-c", &command]);
        let resumed = json(&shell.output().unwrap());
        assert!(resumed["resumed_units"].as_u64() > Some(0), "{resumed}");
        for figure in figures {
            assert_eq!(resumed[figure], undisturbed[figure], "{figure}");
        }
        assert_eq!(archive(&bench.path(catalog)), expected);

        let again = bench.ingest(catalog, &["--resume"]);
        succeeded(&again);
        assert!(String::from_utf8_lossy(&again.stdout).contains("nothing to do"), "{again:?}");
    }
}

#[test]
fn what_becomes_of_an_unfinished_build_is_said() {
    let bench = Bench::new();
    let fresh = succeeded(&bench.ingest("fresh", &["--resume"]));
    assert_eq!(fresh, "", "nothing to go on with is nothing to speak of");
    let expected = archive(&bench.path("fresh"));

    bench.interrupted("discarded", "-INT");
    let said = succeeded(&bench.ingest("discarded", &[]));
    assert!(said.contains("is discarded; --resume would have gone on with it"), "{said}");
    assert_eq!(archive(&bench.path("discarded")), expected);

    bench.interrupted("other", "-INT");
    bench.write_raster(77);
    let other = bench.ingest("other", &["--resume", "--json"]);
    let said = succeeded(&other);
    assert!(said.contains("is discarded: it is of another input"), "{said}");
    assert_eq!(json(&other)["resumed_units"], 0);
}

#[test]
fn a_second_signal_ends_at_once() {
    let bench = Bench::new();
    let mut child = bench.command("catalog", &[]).stderr(Stdio::piped()).spawn().unwrap();
    let note = bench.path("catalog/build/map-of-mars.note");
    while !note.exists() {
        assert!(child.try_wait().unwrap().is_none(), "it ended before it was stopped");
        std::thread::yield_now();
    }
    // Two signals that have not been taken are one: so the first is waited for.
    send("-INT", &child);
    let mut said = BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    said.read_line(&mut line).unwrap();
    assert!(line.contains("once more stops at once"), "{line}");
    // Whichever is first, its own end or the signal, it ends with an error.
    let _ = Command::new("kill").args(["-INT", &child.id().to_string()]).output();
    assert_eq!(child.wait().unwrap().code(), Some(1));
    let mut rest = String::new();
    said.read_to_string(&mut rest).unwrap();
    succeeded(&bench.ingest("catalog", &["--resume"]));
}
