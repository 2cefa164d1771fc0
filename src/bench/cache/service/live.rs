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

/// Runs without an insertion, and with one.
const ROUNDS: usize = 4;

const TOKEN: &str = "a token of the benchmark";

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
    let areoid = Areoid::start(&catalog, cores(), Some((&token, &rasters)))?;
    let wrk = outside.peers.program("wrk");
    let wrk = wrk.map(|wrk| Wrk::new(wrk, &pages.paths, &folder.join("pages.lua"))).transpose()?;
    let run = || -> Result<Option<Load>, Failure> {
        let load =
            wrk.as_ref().map(|wrk| wrk.run(areoid.public, CONNECTIONS, outside.run_seconds()));
        Ok(load.transpose()?)
    };

    output::say("serving alone");
    let (mut alone, mut during) = (Vec::new(), Vec::new());
    for round in 0..=ROUNDS {
        // The first warms what is to be warm.
        alone.extend(run()?.filter(|_| round > 0));
    }
    output::say("serving during an insertion");
    let listeners = listen(areoid.public)?;
    let admin = areoid.admin.ok_or_else(|| io::Error::other("there is no admin listener"))?;
    let inserting = insert(admin, &raster);
    while during.len() < ROUNDS && !inserting.is_finished() {
        match run()? {
            // A run that the insertion did not last for is none.
            Some(load) if !inserting.is_finished() => during.push(load),
            _ => break,
        }
    }
    output::say("waiting for the insertion");
    inserting.join().map_err(|_| io::Error::other("the insertion panicked"))??;
    let mut delays = vec![("inserted over HTTP", delay(&catalog, listeners)?)];
    let listeners = listen(areoid.public)?;
    let mut ingest = Command::new(std::env::current_exe()?);
    ingest.arg("ingest").arg(outside.work(SIZES[0].name).with_extension("tif"));
    ingest.arg("--catalog").arg(&catalog).args(["--name", "other", "--json"]);
    said(&mut ingest)?;
    delays.push(("by another process", delay(&catalog, listeners)?));
    drop(areoid);

    let p99 = |loads: &[Load]| Spread::of(loads.iter().map(|load| load.p99_ms));
    let rate = |loads: &[Load]| Spread::of(loads.iter().map(|load| load.requests_per_s));
    let ratio = p99(&during).zip(p99(&alone)).map(|(during, alone)| during.median / alone.median);
    let mut targets = vec![Target::new(
        "p99 of pages during an insertion over that without one",
        Relation::AtMost,
        MOST_P99,
        ratio,
    )];
    targets.extend(delays.iter().map(|(what, seconds)| {
        let what = format!("{what}: seconds from the commit to the last of {LISTENERS} sessions");
        Target::new(what, Relation::AtMost, MOST_SECONDS, Some(*seconds))
    }));
    let text = |spread: Option<Spread>, digits| {
        spread.map_or_else(|| "–".to_owned(), |spread| spread.text(digits))
    };
    let row = |what: &str, loads: &[Load]| {
        vec![what.to_owned(), text(rate(loads), 0), text(p99(loads), 2)]
    };
    let megapixels = f64::from(width) * f64::from(width / 2) / 1e6;
    Ok(Chapter {
        name: "live",
        title: "Serving during an insertion",
        notes: vec![format!(
            "wrk asks for pages of {:.0} KiB over {CONNECTIONS} connections as fast as they come, on the \
             cores that serve them; then again while {megapixels:.1} megapixels are inserted through the \
             admin listener. The load ends before the insertion does. The commit is when the manifest \
             was written; {LISTENERS} clients listen to events, and the last one counts.",
            pages.mean_bytes / 1024.0
        )],
        tables: vec![Table {
            title: "Pages in memory, over the loopback".to_owned(),
            head: vec!["", "requests/s", "99 % ms"],
            rows: vec![row("alone", &alone), row("during an insertion", &during)],
        }],
        targets,
        data: json!({
            "page_bytes": pages.mean_bytes,
            "megapixels": megapixels,
            "alone": alone,
            "during": during,
            "seconds_to_all": delays.iter().map(|(what, seconds)| {
                json!({ "what": what, "seconds": seconds })
            }).collect::<Vec<_>>(),
        }),
    })
}

/// Inserts on a thread of its own.
fn insert(admin: SocketAddr, raster: &Path) -> thread::JoinHandle<io::Result<()>> {
    let raster: PathBuf = raster.to_owned();
    thread::spawn(move || {
        let client = Client::new(&format!("http://{admin}")).map_err(io::Error::other)?;
        let request = json!({ "rasters": [raster.canonicalize()?], "name": "inserted" });
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
