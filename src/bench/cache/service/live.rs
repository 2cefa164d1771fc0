//! Serving while a raster is inserted, and how long after its commit everybody sees it.

use std::fs;
use std::io::{self, BufRead as _, BufReader, Write as _};
use std::net::{SocketAddr, TcpStream};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, SystemTime};

use areoid_cache::insertion_request::InsertRequest;
use areoid_cache::remote::{self, Client};
use serde_json::json;

use super::Outside;
use super::pages::{self, SIZES};
use super::servers::Areoid;
use super::wrk::{Load, Wrk};
use crate::bench::ingest::said;
use crate::bench::processors::{Half, can_be_parted, on};
use crate::bench::rasters::{Look, Recipe};
use crate::bench::report::{Chapter, Relation, Spread, Table, Target, cores};
use crate::failure::Failure;
use crate::output;

/// Width of what is inserted at full size: 100 megapixels, twice as wide as high. It has to halve evenly.
const FULL_WIDTH: u32 = 14_208;

/// The 99th percentile during an insertion over that without one.
const MOST_P99: f64 = 2.0;

/// Seconds from a commit to the last of those who hear of it.
const MOST_SECONDS: f64 = 1.0;

/// Clients that ask.
const CONNECTIONS: usize = 8;

/// Clients that listen to events.
const LISTENERS: usize = 8;

/// Runs one after another without an insertion, before each that is made.
///
/// The 99th percentile of one run is a matter of where the system puts threads: a third of a millisecond or
/// three, whether something is inserted or not. Many short runs tell their median.
const RUNS_IN_A_ROW: usize = 8;

/// However short insertions are, there are no more.
const MOST_INSERTIONS: usize = 8;

const TOKEN: &str = "a token of the benchmark";

/// Where the server runs, and where those who ask.
#[derive(Clone, Copy, Debug)]
struct Setup {
    name: &'static str,
    /// Processors of the server and its insertions, and of those who ask.
    halves: [Option<Half>; 2],
}

const SETUPS: [Setup; 2] = [
    Setup { name: "asked from other cores", halves: [Some(Half::First), Some(Half::Second)] },
    Setup { name: "asked from its own cores", halves: [None; 2] },
];

impl Setup {
    fn is_parted(&self) -> bool {
        self.halves != [None; 2]
    }
}

/// What was found in one of them.
#[derive(Debug)]
struct Case {
    setup: Setup,
    alone: Vec<Load>,
    during: Vec<Load>,
    /// From the commit of an insertion until the last listener heard of it.
    slowest_s: f64,
}

/// Files that all need.
struct Files {
    catalog: PathBuf,
    rasters: PathBuf,
    /// What is inserted.
    raster: PathBuf,
    token: PathBuf,
    wrk: Option<Wrk>,
}

/// Measures.
pub(in super::super) fn measure(outside: &Outside<'_>) -> Result<Chapter, Failure> {
    let folder = outside.work("live");
    let (catalog, rasters) = (folder.join("catalog"), folder.join("rasters"));
    fs::create_dir_all(&catalog)?;
    let width = outside.setting.count(FULL_WIDTH).max(512) / 64 * 64;
    let raster = Recipe::tiled(Look::Height, (width, width / 2)).make(&rasters)?;
    pages::make(outside, SIZES[0], &catalog)?;
    let pages = pages::export(&catalog, SIZES[0], &folder.join("files"))?;
    let token = folder.join("token");
    fs::write(&token, TOKEN)?;
    let wrk = outside.peers.program("wrk");
    let wrk = wrk.map(|wrk| Wrk::new(wrk, &pages.paths, &folder.join("pages.lua"))).transpose()?;
    let files = Files { catalog, rasters, raster, token, wrk };
    // Four for each second of a long one.
    let runs = usize::try_from(outside.run_seconds()).unwrap_or(usize::MAX).saturating_mul(4);
    let setups = SETUPS.iter().filter(|setup| !setup.is_parted() || can_be_parted());
    let cases = setups
        .map(|&setup| Case::measure(setup, &files, runs))
        .collect::<Result<Vec<Case>, Failure>>()?;
    let slowest_s = cases.iter().map(|case| case.slowest_s).fold(0.0, f64::max);
    let delays = [
        ("inserted over HTTP", slowest_s),
        ("by another process", by_another_process(outside, &files)?),
    ];

    let mut targets: Vec<Target> = cases.iter().map(Case::target).collect();
    targets.extend(delays.iter().map(|(what, seconds)| {
        let what = format!("{what}: seconds from the commit to the last of {LISTENERS} sessions");
        Target::new(what, Relation::AtMost, MOST_SECONDS, Some(*seconds))
    }));
    let megapixels = f64::from(width) * f64::from(width / 2) / 1e6;
    Ok(Chapter {
        name: "live",
        title: "Serving during an insertion",
        notes: vec![format!(
            "wrk asks for pages of {:.0} KiB over {CONNECTIONS} connections as fast as they come; then \
             again while {megapixels:.1} megapixels are inserted through the admin listener; and so on, \
             in turn, until there are enough runs of a second, or {MOST_INSERTIONS} insertions. Runs that \
             an insertion did not last for do not count. From other cores: wrk has one half of the \
             processors, the server and its insertions have the other. From its own: both share all of \
             them, and how the system puts wrk's threads beside the server's is a part of what is \
             measured. The commit is when the manifest was written; {LISTENERS} clients listen to events, \
             and the last one counts.",
            pages.mean_bytes / 1024.0,
        )],
        tables: vec![Table {
            title: "Pages in memory, over the loopback".to_owned(),
            head: vec!["", "", "runs", "requests/s", "99 % ms"],
            rows: cases.iter().flat_map(Case::rows).collect(),
        }],
        targets,
        data: json!({
            "page_bytes": pages.mean_bytes,
            "megapixels": megapixels,
            "cases": cases.iter().map(|case| {
                json!({ "setup": case.setup.name, "alone": case.alone, "during": case.during })
            }).collect::<Vec<_>>(),
            "seconds_to_all": delays.iter().map(|(what, seconds)| {
                json!({ "what": what, "seconds": seconds })
            }).collect::<Vec<_>>(),
        }),
    })
}

impl Case {
    /// Runs alone, and during an insertion, in turn.
    fn measure(setup: Setup, files: &Files, runs: usize) -> Result<Self, Failure> {
        let [server, client] = setup.halves;
        let admin = Some((files.token.as_path(), files.rasters.as_path()));
        let areoid = on(server, || Areoid::start(&files.catalog, cores(), admin))?;
        let admin = areoid.admin.ok_or_else(|| io::Error::other("there is no admin listener"))?;
        let run = || {
            let ask = |wrk: &Wrk| on(client, || wrk.run(areoid.public, CONNECTIONS, 1));
            files.wrk.as_ref().map(ask).transpose()
        };
        let mut case = Self { setup, alone: Vec::new(), during: Vec::new(), slowest_s: 0.0 };
        for number in 0..MOST_INSERTIONS {
            // The first warms what is to be warm, and lets what was inserted come to rest.
            run()?;
            output::say(format!("serving, {}", setup.name));
            let in_a_row = runs.saturating_sub(case.alone.len()).min(RUNS_IN_A_ROW);
            for _ in 0..in_a_row {
                case.alone.extend(run()?);
            }
            output::say("serving during an insertion");
            let listeners = listen(areoid.public)?;
            let name = format!("{}-{number}", setup.name.replace(' ', "-"));
            let inserting = insert(admin, &files.raster, name);
            let before = case.during.len();
            while !inserting.is_finished() {
                let Some(load) = run()? else { break };
                // One that the insertion did not last for is none.
                if !inserting.is_finished() {
                    case.during.push(load);
                }
            }
            inserting.join().map_err(|_| io::Error::other("the insertion panicked"))??;
            case.slowest_s = case.slowest_s.max(delay(&files.catalog, listeners)?);
            let is_enough = case.alone.len() >= runs && case.during.len() >= runs;
            // Insertions that are too short will be the next time.
            if is_enough || case.during.len() == before {
                break;
            }
        }
        Ok(case)
    }

    fn target(&self) -> Target {
        let p99 = |loads| Some(spread(loads, |load| load.p99_ms)?.median);
        let ratio = p99(&self.during).zip(p99(&self.alone)).map(|(during, alone)| during / alone);
        let what =
            format!("{}: p99 of pages during an insertion over that without one", self.setup.name);
        Target::new(what, Relation::AtMost, MOST_P99, ratio)
    }

    fn rows(&self) -> [Vec<String>; 2] {
        [("alone", &self.alone), ("during an insertion", &self.during)].map(|(when, loads)| {
            let text = |of, digits| {
                spread(loads, of).map_or_else(|| "–".to_owned(), |spread| spread.text(digits))
            };
            vec![
                self.setup.name.to_owned(),
                when.to_owned(),
                loads.len().to_string(),
                text(|load| load.requests_per_s, 0),
                text(|load| load.p99_ms, 2),
            ]
        })
    }
}

fn spread(loads: &[Load], of: fn(&Load) -> f64) -> Option<Spread> {
    Spread::of(loads.iter().map(of))
}

/// How long it takes until those who listen to a server hear of a dataset that another process ingests.
fn by_another_process(outside: &Outside<'_>, files: &Files) -> Result<f64, Failure> {
    let areoid = Areoid::start(&files.catalog, cores(), None)?;
    let listeners = listen(areoid.public)?;
    let mut ingest = Command::new(std::env::current_exe()?);
    ingest.arg("ingest").arg(outside.work(SIZES[0].name).with_extension("tif"));
    ingest.arg("--catalog").arg(&files.catalog).args(["--name", "other", "--json"]);
    said(&mut ingest)?;
    Ok(delay(&files.catalog, listeners)?)
}

/// Inserts on a thread of its own.
fn insert(admin: SocketAddr, raster: &Path, name: String) -> thread::JoinHandle<io::Result<()>> {
    let raster: PathBuf = raster.to_owned();
    thread::spawn(move || {
        let client = Client::new(&format!("http://{admin}")).map_err(io::Error::other)?;
        let request = json!({ "rasters": [raster.canonicalize()?], "name": name });
        let request: InsertRequest = serde_json::from_value(request)?;
        remote::insert(&client, TOKEN, &request, |_| {}).map_err(io::Error::other)?;
        Ok(())
    })
}

/// Clients that hear of what is inserted, and say when.
fn listen(public: SocketAddr) -> io::Result<mpsc::Receiver<SystemTime>> {
    let (sender, heard) = mpsc::channel();
    for _ in 0..LISTENERS {
        let mut stream = TcpStream::connect(public)?;
        stream.set_read_timeout(Some(Duration::from_secs(3600)))?;
        write!(stream, "GET /v1/events HTTP/1.1\r\nhost: areoid\r\n\r\n")?;
        let mut lines = BufReader::new(stream).lines().map_while(Result::ok);
        // What comes after that it hears.
        if !lines.any(|line| line == "event: hello") {
            return Err(io::Error::other("no events"));
        }
        let sender = sender.clone();
        thread::spawn(move || {
            if lines.any(|line| line == "event: inserted") {
                // Nobody waits any more, or gets it.
                let _ = sender.send(SystemTime::now());
            }
        });
    }
    Ok(heard)
}

/// Seconds from the newest manifest to the last listener.
fn delay(catalog: &Path, heard: mpsc::Receiver<SystemTime>) -> io::Result<f64> {
    let manifests = fs::read_dir(catalog)?
        .flatten()
        .filter(|entry| entry.file_name().to_string_lossy().starts_with("manifest."));
    let written = manifests.filter_map(|entry| entry.metadata().ok()?.modified().ok()).max();
    let written = written.ok_or_else(|| io::Error::other("no manifest"))?;
    let mut last = written;
    for _ in 0..LISTENERS {
        let wait = heard.recv_timeout(Duration::from_secs(30));
        last = last.max(wait.map_err(io::Error::other)?);
    }
    Ok(last.duration_since(written).unwrap_or_default().as_secs_f64())
}
