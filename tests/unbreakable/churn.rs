//! Processes that ingest, replace and remove in one catalog at once, while others read it.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use areoid_formats::catalog::Catalog;
use tempfile::TempDir;

use super::rig::{self, SMALL, Subject, Tiny, soak};
use crate::support::raster::Random;

const SHARED: &str = "shared";
const STEADY: &str = "steady";

/// The newest generation, every page of it read.
fn read_all(catalog: &Path) -> (u64, BTreeMap<String, String>) {
    let (opened, archives) = Catalog::open_with_archives(catalog).unwrap();
    for archive in &archives {
        for entry in archive.entries().unwrap() {
            archive.page(&entry).unwrap();
        }
    }
    let contents =
        opened.datasets().iter().map(|record| (record.name.clone(), record.content.clone()));
    (opened.generation(), contents.collect())
}

/// What a dataset called `name` of `input` holds.
fn content(input: &Subject, name: &str) -> String {
    let home = TempDir::new().unwrap();
    input.ingest(home.path(), &["--name", name]);
    read_all(home.path()).1[name].clone()
}

/// Reads until `done`; generations never go back, and what never changes is always there.
fn watch(catalog: &Path, done: &AtomicBool, steady: &str) -> u64 {
    let (mut generation, mut looks) = (0, 0);
    while !done.load(Ordering::Relaxed) {
        let (now, contents) = read_all(catalog);
        assert!(now >= generation, "a catalog does not go back");
        assert_eq!(contents[STEADY], steady);
        (generation, looks) = (now, looks + 1);
    }
    looks
}

/// Tells readers to stop, also when a test fails.
struct Done<'a>(&'a AtomicBool);

impl Drop for Done<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// One process after another, until `until`.
struct Writer {
    catalog: PathBuf,
    inputs: [Subject; 2],
    random: Random,
    /// Which input its own datasets hold, by what its last successful commands did.
    own: BTreeMap<String, Option<usize>>,
    succeeded: u32,
    told: u32,
}

impl Writer {
    fn new(who: u64, catalog: &Path, inputs: &[Subject; 2]) -> Self {
        let own = ["a", "b"].map(|name| (format!("{name}{who}"), None));
        let (catalog, inputs) = (catalog.to_owned(), inputs.clone());
        Self { catalog, inputs, random: Random(who), own: own.into(), succeeded: 0, told: 0 }
    }

    fn work(mut self, until: Instant) -> Self {
        while Instant::now() < until {
            let draw = self.random.bits() as usize;
            let name = self.own.keys().map(String::as_str).chain([SHARED]).nth(draw % 3).unwrap();
            let name = name.to_owned();
            match draw / 3 % 4 {
                0 => self.remove(&name),
                which => self.ingest(&name, which % 2, which == 3),
            }
        }
        self
    }

    fn ingest(&mut self, name: &str, which: usize, keep: bool) {
        let mut options = vec!["--name", name, "--threads", "2"];
        options.extend((!keep).then_some("--force"));
        let output = self.inputs[which].command(&self.catalog, &options).output().unwrap();
        if output.status.success() {
            self.succeeded += 1;
            self.own.entry(name.to_owned()).and_modify(|holds| *holds = Some(which));
            return;
        }
        let told = rig::assert_told(&output);
        let busy = name == SHARED && told.contains("another process is building shared");
        let exists = keep && told.contains("is there already");
        assert!(busy || exists, "{options:?}: {told}");
        if let Some(&holds) = self.own.get(name) {
            assert_eq!(holds, Some(1 - which), "{told}");
        }
        self.told += 1;
    }

    fn remove(&mut self, name: &str) {
        let mut command = Command::new(env!("CARGO_BIN_EXE_areoid"));
        let output = command.arg("remove").arg(&self.catalog).arg(name).output().unwrap();
        let held = self.own.get(name).copied();
        if output.status.success() {
            assert_ne!(held, Some(None), "{name} was not there");
            self.succeeded += 1;
            self.own.entry(name.to_owned()).and_modify(|holds| *holds = None);
            return;
        }
        let told = rig::assert_told(&output);
        assert!(told.contains(&format!("no dataset called {name}")), "{told}");
        assert!(matches!(held, None | Some(None)), "{told}");
        self.told += 1;
    }
}

#[test]
fn processes_in_one_catalog_lose_no_update_and_no_reader_misses_a_file() {
    let home = TempDir::new().unwrap();
    let catalog = home.path().join("catalog");
    let tiny = ["one", "two"].map(Tiny::new);
    let inputs = tiny.each_ref().map(|tiny| tiny.subject.clone());
    inputs[0].ingest(&catalog, &["--name", STEADY]);
    let steady = content(&inputs[0], STEADY);
    let until = Instant::now() + Duration::from_secs(if soak() { 60 } else { 3 });

    let done = AtomicBool::new(false);
    let (writers, looks) = std::thread::scope(|scope| {
        let reader = scope.spawn(|| watch(&catalog, &done, &steady));
        let writers = [1, 2].map(|who| {
            let writer = Writer::new(who, &catalog, &inputs);
            scope.spawn(move || writer.work(until))
        });
        let writers = writers.map(std::thread::ScopedJoinHandle::join);
        done.store(true, Ordering::Relaxed);
        (writers.map(Result::unwrap), reader.join().unwrap())
    });

    let (generation, mut contents) = read_all(&catalog);
    assert_eq!(contents.remove(STEADY), Some(steady));
    let shared = contents.remove(SHARED);
    let possible = inputs.each_ref().map(|input| content(input, SHARED));
    assert!(shared.is_none_or(|shared| possible.contains(&shared)));
    let mut expected = BTreeMap::new();
    for (name, holds) in writers.iter().flat_map(|writer| &writer.own) {
        expected.extend(holds.map(|which| (name.clone(), content(&inputs[which], name))));
    }
    assert_eq!(contents, expected);
    assert_eq!(rig::names_in(&catalog.join("build")), [] as [&str; 0]);
    let archives = rig::names_in(&catalog.join("archives"));
    assert_eq!(archives.len(), Catalog::open(&catalog).unwrap().datasets().len());
    assert_eq!(rig::run("verify", &catalog)["ok"], true);
    let [one, two] = writers;
    let figures = [one.succeeded, one.told, two.succeeded, two.told];
    println!("succeeded and told: {figures:?}, generation {generation}, {looks} looks");
    assert!(looks > 0 && one.succeeded.min(two.succeeded) > 3, "{figures:?}");
}

#[test]
fn force_replaces_in_one_step() {
    let home = TempDir::new().unwrap();
    let catalog = home.path().join("catalog");
    let (old, new) = (&SMALL.all[0], &SMALL.all[1]);
    old.ingest(&catalog, &[]);
    let contents = [old, new].map(|subject| content(subject, rig::NAME));
    let done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let reader = scope.spawn(|| {
            let mut seen = [false; 2];
            while !done.load(Ordering::Relaxed) {
                let (_, now) = read_all(&catalog);
                let which = contents.iter().position(|content| *content == now[rig::NAME]);
                seen[which.unwrap()] = true;
            }
            seen
        });
        {
            let _done = Done(&done);
            for subject in [new, old, new, old] {
                subject.ingest(&catalog, &["--force"]);
            }
        }
        assert_eq!(reader.join().unwrap(), [true; 2]);
    });
}
