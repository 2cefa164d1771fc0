//! Everything at once, again and again: flights, insertions, replacements, removals, readers from
//! afar. Between two rounds all stop, and what they left is looked at: every wanted page comes, the
//! catalog is as it was, and memory and descriptors are what they were.
//!
//! ```text
//!   crowd ─┬─ flies through one cache ───┐
//!          ├─ changes its datasets ──────┴─ this process ──┐
//!          ├─ reads, and goes away half-way, over HTTP     ├─ one catalog
//!          ├─ flies through a cache of the server's pages  │
//!          └─ inserts, replaces, removes ── areoid serve ──┘
//! ```
//!
//! A few seconds; `AREOID_SOAK=1` makes it an hour. It has a process of its own: what others do would
//! show in its memory.

#![cfg(target_os = "linux")]
#![expect(clippy::unwrap_used, reason = "a failed test may panic")]
#![expect(clippy::print_stdout, reason = "figures, for whoever asks for them")]

#[path = "service/rig.rs"]
#[expect(dead_code, reason = "some of it is for the tests of the service")]
mod rig;
#[path = "service/server.rs"]
#[expect(dead_code, reason = "some of it is for the tests of the service")]
mod server;
mod soak {
    pub(crate) mod crowd;
}

use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use areoid_cache::{Cache, Options};

use rig::{NAME, Place, eventually, get, soak};
use server::Process;
use soak::crowd::{Crowd, GLOBE};

/// Of decoded pages: a tenth of what the catalog has.
const BUDGET_BYTES: usize = 2 << 20;

/// What memory may have grown by between the second quarter of the rounds and the last.
const SLACK_BYTES: u64 = 6 << 20;

/// What a process holds: bytes of memory that are its own, not those of files, and open descriptors.
#[derive(Clone, Copy, Debug)]
struct Held {
    bytes: u64,
    descriptors: usize,
}

impl Held {
    /// `process` is its number, or `self`.
    fn now(process: &str) -> Self {
        let status = fs::read_to_string(format!("/proc/{process}/status")).unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:")).unwrap();
        let kib: u64 = line.trim().strip_suffix(" kB").unwrap().trim().parse().unwrap();
        let descriptors = fs::read_dir(format!("/proc/{process}/fd")).unwrap().count();
        Self { bytes: kib << 10, descriptors }
    }
}

fn ingest_globe(catalog: &Path) {
    let raster = Path::new(env!("CARGO_MANIFEST_DIR")).join("demo/mars/mola_height_8ppd.tif");
    let mut command = Command::new(env!("CARGO_BIN_EXE_areoid"));
    command.arg("ingest").arg(raster).arg("--catalog").arg(catalog);
    let output = command.args(["--name", GLOBE, "--page-size", "64", "--json"]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// The median of a quarter of the rounds, counted from 0.
fn quarter(held: &[Held], number: usize) -> u64 {
    let mut bytes: Vec<u64> = held.iter().map(|held| held.bytes).collect();
    let quarter = &mut bytes[held.len() * number / 4..held.len() * (number + 1) / 4];
    quarter.sort_unstable();
    quarter[quarter.len() / 2]
}

#[test]
fn after_all_of_it_nothing_is_stuck_and_nothing_has_grown() {
    let (rounds, round) =
        if soak() { (200, Duration::from_secs(18)) } else { (8, Duration::from_secs(1)) };
    let place = Place::new();
    ingest_globe(&place.catalog());
    // Each thread's own arena would keep what it once held: minutes pass until all of them have.
    let first = "export MALLOC_ARENA_MAX=1;";
    let server = Process::start_on(&place, &place.catalog(), first, &["--memory-mib", "4"]);
    let serving = server.child.id().to_string();
    let cache =
        Cache::open(place.catalog().as_path(), Options::with_budget(BUDGET_BYTES)).wait().unwrap();
    let mut crowd = Crowd::new(&cache, &place, &server);
    let names = || -> Vec<String> {
        let datasets = cache.datasets();
        let mut names: Vec<_> = datasets.iter().map(|(_, info)| info.name.clone()).collect();
        names.sort();
        names
    };

    let (mut ours, mut theirs): (Vec<Held>, Vec<Held>) = (Vec::new(), Vec::new());
    let start = Instant::now();
    for number in 0..rounds {
        crowd.round(Instant::now() + round);

        eventually("the catalog is as it was", || {
            let catalog = get(server.public, "/v1/catalog").json();
            let served = catalog["datasets"].as_array().unwrap().len();
            names() == [GLOBE, NAME] && served == 2
        });
        crowd.settle();
        eventually("no load is under way", || cache.stats().reserved_bytes == 0);
        let stats = cache.stats();
        assert!(stats.peak_bytes <= BUDGET_BYTES, "{stats:?}");
        assert_eq!(stats.errors, 0, "{stats:?}");

        let most = |held: &[Held]| held.iter().take(2).map(|held| held.descriptors).max();
        let (mut now, mut there) = (Held::now("self"), Held::now(&serving));
        if number >= 2 {
            eventually("no descriptor has leaked", || {
                (now, there) = (Held::now("self"), Held::now(&serving));
                Some(now.descriptors) <= most(&ours) && Some(there.descriptors) <= most(&theirs)
            });
        }
        println!(
            "{:6.0} s: {now:?}, serving {there:?}, {} loads, {} evictions, {} changes, {} answers",
            start.elapsed().as_secs_f64(),
            stats.loads,
            stats.evictions,
            crowd.changes(),
            crowd.answers(),
        );
        ours.push(now);
        theirs.push(there);
    }

    let stats = cache.stats();
    assert!(stats.evictions > 0, "nothing was short: {stats:?}");
    assert!(crowd.changes() > rounds && crowd.answers() > rounds);
    for (whose, held) in [("ours", &ours), ("the server's", &theirs)] {
        let (early, late) = (quarter(held, 1), quarter(held, 3));
        println!("{whose}: {early} bytes in the second quarter, {late} in the last");
        assert!(late <= early + SLACK_BYTES, "{whose} has grown from {early} to {late} bytes");
    }
}
