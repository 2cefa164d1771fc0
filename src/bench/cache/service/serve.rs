//! Requests a second and their times, beside nginx.

use std::net::SocketAddr;

use serde_json::{Value, json};

use super::Outside;
use super::pages::{self, SIZES};
use super::servers::{Areoid, Nginx};
use super::wrk::{Load, Wrk, ratio};
use crate::bench::report::{Chapter, Relation, Spread, Table, Target, cores};
use crate::failure::Failure;
use crate::output;

/// Connections, and the share of nginx's requests a second that is wanted.
const CONNECTIONS: [(usize, f64); 3] = [(1, 1.0), (8, 1.0), (64, 0.85)];

/// Our 99th percentile over nginx's.
const MOST_P99: f64 = 1.2;

/// Rounds that are compared: many short ones, as what else the machine does comes and goes by the second. A few where
/// less than a second is asked for, only to see that all is there.
const ROUNDS: usize = 15;
const FEW_ROUNDS: usize = 2;

/// Who is asked, with their runs.
struct Server {
    name: String,
    address: SocketAddr,
    runs: Vec<Load>,
}

/// Measures.
pub(in super::super) fn measure(outside: &Outside<'_>) -> Result<Chapter, Failure> {
    let programs = (outside.peers.program("nginx"), outside.peers.program("wrk"));
    let (mut targets, mut rows, mut data) = (Vec::new(), Vec::new(), Vec::new());
    let (catalog, root) = (outside.work("serve"), outside.work("files"));
    let rounds = if outside.setting.seconds < 1.0 { FEW_ROUNDS } else { ROUNDS };
    let seconds = outside.run_seconds().div_ceil(3);
    std::fs::create_dir_all(&catalog)?;
    for size in SIZES {
        pages::make(outside, size, &catalog)?;
    }
    for size in SIZES {
        let pages = pages::export(&catalog, size, &root)?;
        let kib = pages.mean_bytes / 1024.0;
        let (Some(nginx), Some(wrk)) = programs else {
            targets.extend(CONNECTIONS.iter().flat_map(|&(connections, least)| {
                targets_of(&format!("{kib:.0} KiB, {connections} connections"), least, &[])
            }));
            continue;
        };
        let wrk = Wrk::new(wrk, &pages.paths, &outside.work(size.name).with_extension("lua"))?;
        let areoid = Areoid::start(&catalog, cores(), None)?;
        let nginx = |workers: usize| {
            let folder = outside.work(&format!("nginx{workers}"));
            Nginx::start(nginx, workers, &root, &folder)
        };
        let (many, one) = (nginx(cores())?, nginx(1)?);
        for (connections, least) in CONNECTIONS {
            output::say(format!("serving {kib:.0} KiB over {connections} connections"));
            let server =
                |name: &str, address| Server { name: name.to_owned(), address, runs: Vec::new() };
            let mut servers = [
                server("areoid serve", areoid.public),
                server(&format!("nginx, {} workers", cores()), many.public),
                server("nginx, 1 worker", one.public),
            ];
            for round in 0..=rounds {
                for server in &mut servers {
                    let load = wrk.run(server.address, connections, seconds)?;
                    // The first warms what is to be warm.
                    server.runs.extend((round > 0).then_some(load));
                }
            }
            let what = format!("{kib:.0} KiB, {connections} connections");
            targets.extend(targets_of(&what, least, &servers));
            rows.extend(servers.iter().map(|server| row(&what, server, &servers[0])));
            data.push(json!({
                "page_bytes": pages.mean_bytes,
                "connections": connections,
                "servers": servers.iter().map(figures).collect::<Vec<_>>(),
            }));
        }
    }
    Ok(Chapter {
        name: "serve",
        title: "Serving pages",
        notes: vec![notes(rounds)],
        tables: vec![Table {
            title: "Pages in memory, over the loopback".to_owned(),
            head: vec![
                "",
                "",
                "requests/s",
                "50 % ms",
                "99 % ms",
                "ours/s over",
                "50 % over",
                "99 % over",
            ],
            rows,
        }],
        targets,
        data: json!(data),
    })
}

fn notes(rounds: usize) -> String {
    format!(
        "wrk asks for a few pages in turn over connections that are kept, for some seconds each, of `areoid \
         serve` with a thread a core, of nginx with a worker a core, and of nginx with one, all on the \
         same cores, in turn, round after round; the first of {} rounds is not counted. nginx has the \
         same bytes as files (sendfile, tcp_nopush, no log). Ratios are Areoid's over the other's within \
         a round. Median (least–greatest).",
        rounds + 1
    )
}

fn targets_of(what: &str, least: f64, servers: &[Server]) -> [Target; 2] {
    let ratio = |of| match servers {
        [ours, theirs, ..] => ratio(&ours.runs, &theirs.runs, of).map(|spread| spread.median),
        _ => None,
    };
    let (rate, p99) = (ratio(|load| load.requests_per_s), ratio(|load| load.p99_ms));
    [
        Target::new(format!("{what}: requests/s over nginx's"), Relation::AtLeast, least, rate),
        Target::new(format!("{what}: p99 over nginx's"), Relation::AtMost, MOST_P99, p99),
    ]
}

fn row(what: &str, server: &Server, ours: &Server) -> Vec<String> {
    let spread = |of: fn(&Load) -> f64| Spread::of(server.runs.iter().map(of));
    let over = |of: fn(&Load) -> f64| {
        ratio(&ours.runs, &server.runs, of).filter(|_| server.name != ours.name)
    };
    let text = |spread: Option<Spread>, digits| {
        spread.map_or_else(|| "–".to_owned(), |spread| spread.text(digits))
    };
    vec![
        what.to_owned(),
        server.name.clone(),
        text(spread(|load| load.requests_per_s), 0),
        text(spread(|load| load.p50_ms), 2),
        text(spread(|load| load.p99_ms), 2),
        text(over(|load| load.requests_per_s), 2),
        text(over(|load| load.p50_ms), 2),
        text(over(|load| load.p99_ms), 2),
    ]
}

fn figures(server: &Server) -> Value {
    json!({ "name": server.name, "runs": server.runs })
}
