//! The binary: signals, descriptors, killed during an insertion.

use std::fs;
use std::io::{Read as _, Write as _};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::path::Path;
use std::process::Command;
use std::thread;
use std::time::{Duration, Instant};

use serde_json::json;

use super::rig::{Place, ask, begin_to_insert, connect, eventually, exchange, get, rest, soak};
use super::server::Process;

/// Asks for an archive more often than any socket buffers, and does not read.
fn stall(process: &Process, place: &Place) -> TcpStream {
    let file = place.archive().file_name().unwrap().to_str().unwrap().to_owned();
    let mut stream = connect(process.public);
    for _ in 0..50 {
        let _ = write!(stream, "GET /v1/archives/{file} HTTP/1.1\r\nhost: here\r\n\r\n");
    }
    // Stuck, and not only under way: again and again the same.
    let (mut before, mut looks) = (String::new(), 0);
    eventually("it is stuck", || {
        let metrics = get(process.admin(), "/metrics").text();
        let is_same = metrics == before && metrics.contains("requests_in_flight 1");
        (before, looks) = (metrics, if is_same { looks + 1 } else { 0 });
        looks == 20
    });
    stream
}

#[test]
fn asked_to_end_it_finishes_what_it_has_begun() {
    let place = Place::new();
    let mut process = Process::start(&place, "");
    let archive = fs::read(place.archive()).unwrap();
    let mut stream = stall(&process, &place);
    let idle = connect(process.public);
    process.signal("-TERM");
    eventually("nobody is taken any more", || TcpStream::connect(process.public).is_err());
    let mut all = Vec::new();
    stream.read_to_end(&mut all).unwrap();
    // All answers are whole, the last one too.
    let (mut rest, mut answers) = (&all[..], 0);
    while !rest.is_empty() {
        let end = rest.windows(4).position(|window| window == b"\r\n\r\n").unwrap() + 4;
        assert!(rest[end..].starts_with(&archive), "answer {answers} is cut");
        (rest, answers) = (&rest[end + archive.len()..], answers + 1);
    }
    assert!((1..50).contains(&answers), "{answers}");
    drop(idle);
    assert!(process.child.wait().unwrap().success());
}

/// A port of the loopback with nobody there nor at the next.
fn two_ports() -> u16 {
    let is_free = |port: u16| TcpListener::bind((Ipv4Addr::LOCALHOST, port)).is_ok();
    let any = |_| TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let pair = |port: &u16| port.checked_add(1).is_some_and(is_free) && is_free(*port);
    (0..100).map(any).find(pair).unwrap()
}

#[test]
fn its_state_is_told_on_the_loopback_behind_the_public_port() {
    let place = Place::new();
    let start = |listen: &str, admin: &[&str]| {
        let options = [&["--listen", listen][..], admin].concat();
        Process::start_bare(&place.catalog(), &options)
    };
    let listen = format!("127.0.0.1:{}", two_ports());
    let process = start(&listen, &[]);
    assert_eq!(process.admin().port(), process.public.port() + 1);
    assert!(process.admin().ip().is_loopback());
    assert_eq!(get(process.admin(), "/livez").status, 200);
    let change = ask(process.admin(), "DELETE", "/v1/datasets/pole", &[], "");
    assert_eq!(change.status, 403, "without a token nobody changes anything");
    // What others have taken is done without, unless it was asked for.
    let port = process.public.port();
    drop(process);
    let _other = TcpListener::bind((Ipv4Addr::LOCALHOST, port + 1)).unwrap();
    let process = start(&listen, &[]);
    assert!(!process.has_admin() && get(process.public, "/v1/catalog").status == 200);
    drop(process);
    let output = Command::new(env!("CARGO_BIN_EXE_areoid"))
        .arg("serve")
        .arg(place.catalog())
        .args(["--listen", &listen, "--admin", &format!("127.0.0.1:{}", port + 1)])
        .output()
        .unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success() && said.contains("cannot listen on"), "{said}");
    assert!(!start("127.0.0.1:0", &["--admin", "none"]).has_admin());
}

#[test]
fn asked_twice_it_ends_at_once() {
    let place = Place::new();
    let mut process = Process::start(&place, "");
    // The drain would take its ten seconds.
    let _stream = stall(&process, &place);
    let start = Instant::now();
    process.signal("-TERM");
    eventually("nobody is taken any more", || TcpStream::connect(process.admin()).is_err());
    assert!(process.child.try_wait().unwrap().is_none(), "it does not wait for whom it serves");
    process.signal("-TERM");
    process.child.wait().unwrap();
    assert!(start.elapsed() < Duration::from_secs(8), "{:?}", start.elapsed());
}

#[test]
fn without_descriptors_it_lives_and_goes_on() {
    let place = Place::new();
    let process = Process::start(&place, "ulimit -n 64;");
    let mut streams = Vec::new();
    for _ in 0..100 {
        streams.push(connect(process.public));
    }
    // Those that were taken are served, and the processor is not burnt on those that were not.
    streams[0].write_all(b"GET /v1/catalog HTTP/1.1\r\nhost: here\r\n\r\n").unwrap();
    streams[0].read_exact(&mut [0; 10]).unwrap();
    let ticks = || -> u64 {
        let stat = fs::read_to_string(format!("/proc/{}/stat", process.child.id())).unwrap();
        stat.rsplit_once(") ")
            .unwrap()
            .1
            .split(' ')
            .skip(11)
            .take(2)
            .map(|ticks| ticks.parse::<u64>().unwrap())
            .sum()
    };
    let before = ticks();
    thread::sleep(Duration::from_millis(500));
    assert!(ticks() - before < 20, "it spins");
    drop(streams);
    eventually("it is back", || {
        exchange(process.public, b"GET /v1/catalog HTTP/1.0\r\n\r\n")
            .is_some_and(|answer| answer.status == 200)
    });
}

/// One that takes a while.
fn long_insertion(place: &Place, name: &str) -> String {
    let globe = Path::new(env!("CARGO_MANIFEST_DIR")).join("demo/mars/mola_height_8ppd.tif");
    fs::copy(globe, place.path("rasters/globe.tif")).unwrap();
    place.insertion(name, json!({ "rasters": [place.path("rasters/globe.tif")] }))
}

/// Where a thread may be, as the system tells it.
#[cfg(target_os = "linux")]
#[test]
fn during_an_insertion_each_thread_that_answers_has_a_core_of_its_own() {
    use nix::sched::{CpuSet, sched_getaffinity};
    use nix::unistd::Pid;

    let cores = sched_getaffinity(Pid::from_raw(0)).unwrap();
    let cores = (0..CpuSet::count()).filter(|&core| cores.is_set(core).unwrap()).count();
    let place = Place::new();
    let bodies = ["one", "another", "third"].map(|name| long_insertion(&place, name));
    let threads = ["--threads", &cores.to_string()];
    let process = Process::start_on(&place, &place.catalog(), "", &threads);
    let lists = || -> Vec<String> {
        let threads = fs::read_dir(format!("/proc/{}/task", process.child.id())).unwrap();
        let status =
            threads.map(|thread| fs::read_to_string(thread.unwrap().path().join("status")));
        // One may have ended meanwhile.
        let status = status.flatten().filter(|status| status.starts_with("Name:\tareoid-http-"));
        let list = |status: String| {
            let mut lines = status.lines();
            lines.find_map(|line| line.strip_prefix("Cpus_allowed_list:\t")).unwrap().to_owned()
        };
        status.map(list).collect()
    };
    // A thread is called by its name once it runs.
    eventually("all have begun", || lists().len() == cores);
    let before = lists();
    let inserting = bodies.map(|body| begin_to_insert(process.admin(), &body));
    eventually("each has its own", || {
        let mut lists = lists();
        lists.sort();
        lists.dedup();
        lists.len() == cores && lists.iter().all(|list| list.parse::<usize>().is_ok())
    });
    for stream in inserting {
        assert!(rest(stream).unwrap().text().contains("inserted"));
    }
    eventually("they go anywhere again", || lists() == before);
}

/// The insertion outlived its client, and the service did not wait for it.
#[test]
fn asked_to_end_during_an_insertion_that_nobody_waits_for_it_leaves_nothing() {
    let place = Place::new();
    let body = long_insertion(&place, "new");
    let mut process = Process::start(&place, "");
    let stream = begin_to_insert(process.admin(), &body);
    let builds = || fs::read_dir(place.catalog().join("build")).map_or(0, Iterator::count);
    eventually("it builds", || builds() > 0);
    drop(stream);
    process.signal("-TERM");
    assert!(process.child.wait().unwrap().success());
    assert_eq!(builds(), 0);
    assert!(
        !place
            .catalog()
            .join("archives")
            .read_dir()
            .unwrap()
            .any(|entry| { entry.unwrap().file_name().to_string_lossy().starts_with("new") })
    );
}

#[test]
fn killed_during_an_insertion_it_has_lost_nothing() {
    let place = Place::new();
    for round in 0..if soak() { 40 } else { 4 } {
        let mut process = Process::start(&place, "");
        assert!(get(process.public, "/v1/catalog").text().contains("\"pole\""));
        let body = place.insertion(
            "new",
            json!({ "temporary": round % 2 == 0, "force": true, "priority": round }),
        );
        let mut stream = begin_to_insert(process.admin(), &body);
        stream.read_exact(&mut [0; 12]).unwrap();
        thread::sleep(Duration::from_millis(40 * (round % 7)));
        process.child.kill().unwrap();
        process.child.wait().unwrap();
    }
    let process = Process::start(&place, "");
    let temporary = fs::read_dir(place.catalog()).unwrap().map(Result::unwrap);
    let left = temporary.filter(|entry| entry.file_name().to_string_lossy().contains('-'));
    assert_eq!(left.count(), 0);
    assert_eq!(fs::read_dir(place.catalog().join("build")).map_or(0, Iterator::count), 0);
    let catalog = get(process.public, "/v1/catalog").text();
    assert!(catalog.contains("\"pole\"") && !catalog.contains("\"error\""), "{catalog}");
}
