//! Damaged and missing files, clients that misbehave, too many of everything: others are served.

use std::fs::{self, OpenOptions};
use std::io::{Read as _, Write as _};
use std::net::Shutdown;
use std::os::unix::fs::FileExt as _;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use areoid_cache::service::Service;
use areoid_formats::address::{Level, PageAddress};
use areoid_formats::archive::{Archive, Payload};
use areoid_formats::catalog::Catalog;
use proptest::prelude::*;
use tiff::encoder::TiffEncoder;
use tiff::encoder::colortype::Gray16;

use super::rig::{
    Answer, EQUIRECTANGULAR, LONG, Place, Serving, ask, connect, eventually, exchange, get,
};

/// Where the stored pages of the subject lie, as their paths behind its own, and offsets.
fn stored(serving: &Serving) -> Vec<(String, u64)> {
    let (_, archives) = Catalog::open_with_archives(&serving.place.catalog()).unwrap();
    stored_in(&archives[0])
}

fn stored_in(archive: &Archive) -> Vec<(String, u64)> {
    let entries = archive.entries().unwrap();
    let stored = entries.iter().filter_map(|entry| match entry.payload {
        Payload::Record { offset, length, .. } => {
            let PageAddress { level: Level(level), row, col } = entry.page;
            Some((format!("{level}/{row}/{col}"), offset + 96 + u64::from(length / 2)))
        }
        Payload::Constant(_) => None,
    });
    stored.collect()
}

#[test]
fn a_damaged_page_fails_and_no_other() {
    let serving = Serving::new();
    let (pages, _) = serving.subject();
    let stored = stored(&serving);
    let (victim, at) = &stored[stored.len() / 2];
    let file = OpenOptions::new().write(true).read(true).open(serving.place.archive()).unwrap();
    let mut byte = [0];
    file.read_exact_at(&mut byte, *at).unwrap();
    file.write_all_at(&[!byte[0]], *at).unwrap();
    for (page, _) in &stored {
        let answer = serving.get(&format!("{pages}/{page}"));
        if page == victim {
            assert_eq!(answer.status, 500);
            assert!(answer.text().contains("checksum"), "{}", answer.text());
        } else {
            assert_eq!(answer.status, 200, "{page}");
        }
    }
    // Nothing of it was kept: repaired, it is served.
    file.write_all_at(&byte, *at).unwrap();
    assert_eq!(serving.get(&format!("{pages}/{victim}")).status, 200);
}

/// Whether a file's system says what of it is in memory, which its first byte is.
#[cfg(target_os = "linux")]
fn tells_what_is_in_memory(path: &Path) -> bool {
    use std::io::IoSliceMut;

    use rustix::io::{ReadWriteFlags, preadv2};
    let (file, mut byte) = (fs::File::open(path).unwrap(), [0]);
    file.read_exact_at(&mut byte, 0).unwrap();
    preadv2(&file, &mut [IoSliceMut::new(&mut byte)], 0, ReadWriteFlags::NOWAIT) == Ok(1)
}

#[cfg(not(target_os = "linux"))]
fn tells_what_is_in_memory(_: &Path) -> bool {
    false
}

/// Large pages in memory are sent from their archive where the system can, if their thread has others to
/// serve; not from one that was touched.
#[test]
fn what_is_in_memory_is_served_whatever_becomes_of_its_archive() {
    let serving = Serving::new();
    let raster = serving.place.path("noise.tif");
    let mut state = 1_u32;
    let mut noise = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 16) as u16
    };
    let heights: Vec<u16> = (0..1024 * 512).map(|_| noise()).collect();
    let mut encoder = TiffEncoder::new(fs::File::create(&raster).unwrap()).unwrap();
    encoder.write_image::<Gray16>(1024, 512, &heights).unwrap();
    let mut ingest = Command::new(env!("CARGO_BIN_EXE_areoid"));
    ingest.arg("ingest").arg(raster).arg("--catalog").arg(serving.place.catalog());
    ingest.args(["--crs", EQUIRECTANGULAR, "--body", "mars"]);
    ingest.args(["--extent", "-10669445.6,-5334722.8,10669445.6,5334722.8"]);
    assert!(ingest.output().unwrap().status.success());
    eventually("it is served", || serving.names().contains(&"noise".to_owned()));

    let (_, archives) = Catalog::open_with_archives(&serving.place.catalog()).unwrap();
    let all = serving.get("/v1/catalog").json();
    let mut datasets = all["datasets"].as_array().unwrap().iter().zip(&archives);
    let (dataset, archive) = datasets.find(|(dataset, _)| dataset["name"] == "noise").unwrap();
    let word = |key: &str| dataset[key].as_str().unwrap().to_owned();
    let (content, file) = (word("content"), word("file"));
    let pages = stored_in(archive);
    let get = || -> Vec<Vec<u8>> {
        let path = |page: &String| format!("/v1/pages/noise/{content}/{page}");
        pages.iter().map(|(page, _)| serving.get(&path(page)).body).collect()
    };
    let before = get();
    let large = before.iter().filter(|body| body.len() > 400_000).count();
    assert!(large > 1, "{large} of {}", before.len());
    let path = serving.place.catalog().join("archives").join(file);
    let filed = || serving.metric("areoid_filed_bytes_total");
    // Whoever asks by metrics is counted, too.
    eventually("nobody is there", || serving.metric("areoid_connections") == 1.0);
    let mut alone = connect(serving.address());
    for (place, (page, _)) in pages.iter().enumerate() {
        let close = if place + 1 == pages.len() { "connection: close\r\n" } else { "" };
        let path = format!("/v1/pages/noise/{content}/{page}");
        write!(alone, "GET {path} HTTP/1.1\r\nhost: here\r\n{close}\r\n").unwrap();
    }
    let mut answers = Vec::new();
    alone.read_to_end(&mut answers).unwrap();
    let mut left = &answers[..];
    for body in &before {
        let head = left.windows(4).position(|window| window == b"\r\n\r\n").unwrap();
        assert!(left[head + 4..].starts_with(body), "from memory");
        left = &left[head + 4 + body.len()..];
    }
    assert!(left.is_empty() && filed() == 0.0);

    // So that whoever comes is not alone on a thread.
    let _others = [(); 4].map(|()| connect(serving.address()));
    eventually("they are there", || serving.metric("areoid_connections") > 4.0);
    assert!(get() == before, "from the archive");
    let from_archive = filed();
    assert_eq!(from_archive > 0.0, tells_what_is_in_memory(&path));
    let archive = OpenOptions::new().write(true).open(&path).unwrap();
    for (_, at) in &pages {
        archive.write_all_at(&[0xa5; 64], *at).unwrap();
    }
    assert!(get() == before, "from one that was written to");
    archive.set_len(pages[0].1).unwrap();
    assert!(get() == before, "from one that was cut");
    fs::remove_file(path).unwrap();
    assert!(get() == before, "from none");
    assert_eq!(filed(), from_archive);
}

#[test]
fn an_archive_that_was_cut_before_is_told() {
    let whole = Serving::new().get("/v1/catalog").json();
    assert!(whole["datasets"][0].get("damage").is_none());
    let place = Place::new();
    let archive = OpenOptions::new().write(true).open(place.archive()).unwrap();
    let length = archive.metadata().unwrap().len();
    archive.set_len(length - 5000).unwrap();
    let service = Service::start(&place.options()).unwrap();
    let cut = get(service.public(), "/v1/catalog").json();
    let damage = cut["datasets"][0]["damage"].as_str().unwrap();
    let found = format!("of {length} bytes it has {}", length - 5000);
    assert!(damage.ends_with(&found), "{damage}");
    assert!(!damage.contains(place.archive().parent().unwrap().to_str().unwrap()), "{damage}");
}

#[test]
fn an_archive_cut_under_the_service_is_an_error_and_no_signal() {
    let serving = Serving::new();
    let (pages, file) = serving.subject();
    let stored = stored(&serving);
    let (last, at) = stored.last().unwrap();
    assert_eq!(serving.get(&format!("{pages}/{}", stored[0].0)).status, 200);
    let archive = OpenOptions::new().write(true).open(serving.place.archive()).unwrap();
    archive.set_len(*at).unwrap();
    let failed = serving.get(&format!("{pages}/{last}"));
    assert_eq!(failed.status, 500);
    for said in [last.as_str(), file.as_str(), "the file ends before byte"] {
        assert!(failed.text().contains(said), "{}", failed.text());
    }
    assert_eq!(serving.get(&format!("{pages}/{}", stored[0].0)).status, 200);
    let beyond = format!("bytes={}-", at + 1);
    assert_eq!(
        ask(serving.address(), "GET", &format!("/v1/archives/{file}"), &[("range", &beyond)], "")
            .status,
        500
    );
    // Begun, it cannot become an error any more: it ends too early, which the client sees.
    let whole = serving.get(&format!("/v1/archives/{file}"));
    assert!(whole.body.len().to_string() != whole.header("content-length"));
    assert_eq!(serving.get("/v1/catalog").status, 200);
}

#[test]
fn a_deleted_archive_is_served_while_it_is_open() {
    let serving = Serving::new();
    let (pages, _) = serving.subject();
    fs::remove_file(serving.place.archive()).unwrap();
    assert_eq!(serving.get(&format!("{pages}/0/0/0")).status, 200);
}

#[test]
fn a_header_that_comes_too_slowly_ends_the_connection() {
    let serving = Serving::with(|options| options.limits.header = Duration::from_millis(300));
    for begun in ["", "P", "G", "GET /v1/catalog HTTP/1.1\r\nhost: he"] {
        let mut stream = connect(serving.address());
        stream.write_all(begun.as_bytes()).unwrap();
        let start = Instant::now();
        let mut rest = Vec::new();
        // It may be reset: what was sent was not read to its end.
        let _ = stream.read_to_end(&mut rest);
        assert!(start.elapsed() < LONG / 2, "{begun:?}");
        assert!(!String::from_utf8_lossy(&rest).contains("200 OK"));
    }
    eventually("the connections are gone", || serving.metric("areoid_connections") < 2.0);
}

/// Nothing else may come on a connection while a header has not ended: it kept its place for ever.
#[test]
fn an_http2_header_that_never_ends_ends_the_connection() {
    let serving = Serving::with(|options| {
        options.limits.header = Duration::from_millis(300);
        options.limits.stalled = Duration::from_secs(3600);
    });
    let settings = [0, 0, 0, 4, 0, 0, 0, 0, 0];
    // Of 16,384 bytes, on the first stream; its end is not marked.
    let header = [0, 0x40, 0, 1, 0, 0, 0, 0, 1];
    for begun in [&b""[..], &settings, &[settings, header].concat()] {
        let mut stream = connect(serving.address());
        stream.write_all(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n").unwrap();
        stream.write_all(begun).unwrap();
        eventually("it is taken", || serving.metric("areoid_connections") >= 2.0);
        eventually("it is given up", || {
            // A byte at a time.
            let _ = stream.write_all(&[0]);
            serving.metric("areoid_connections") < 2.0
        });
    }
    assert_eq!(serving.get("/v1/catalog").status, 200);
}

#[test]
fn a_client_that_takes_little_all_the_time_is_given_up() {
    let serving = Serving::with(|options| options.limits.stalled = Duration::from_secs(1));
    let (_, file) = serving.subject();
    let mut stream = connect(serving.address());
    for _ in 0..50 {
        let _ = write!(stream, "GET /v1/archives/{file} HTTP/1.1\r\nhost: here\r\n\r\n");
    }
    eventually("it is begun", || serving.metric("areoid_requests_in_flight") == 1.0);
    let start = Instant::now();
    eventually("it is given up", || {
        // A piece of 256 KiB would take it more than a second, but it never takes nothing for as long.
        std::thread::sleep(Duration::from_millis(90));
        let _ = stream.read(&mut [0; 16 << 10]);
        serving.metric("areoid_requests_in_flight") == 0.0
    });
    assert!(start.elapsed() < LONG / 2, "{:?}", start.elapsed());
    assert_eq!(serving.get("/v1/catalog").status, 200);
}

#[test]
fn a_client_that_takes_nothing_is_given_up() {
    let serving = Serving::with(|options| options.limits.stalled = Duration::from_millis(300));
    let (_, file) = serving.subject();
    let mut stream = connect(serving.address());
    // More than any socket buffers.
    for _ in 0..50 {
        let _ = write!(stream, "GET /v1/archives/{file} HTTP/1.1\r\nhost: here\r\n\r\n");
    }
    eventually("it is given up", || serving.metric("areoid_connections") < 2.0);
    assert_eq!(serving.get("/v1/catalog").status, 200);
}

#[test]
fn a_thousand_idle_connections_keep_nobody_out() {
    let serving = Serving::new();
    let idle: Vec<_> = (0..1000).map(|_| connect(serving.address())).collect();
    eventually("all are taken", || serving.metric("areoid_connections") >= 1000.0);
    let (pages, _) = serving.subject();
    assert_eq!(serving.get(&format!("{pages}/0/0/0")).status, 200);
    drop(idle);
    eventually("all are gone", || serving.metric("areoid_connections") < 10.0);
}

#[test]
fn a_client_that_goes_in_the_middle_leaves_nothing() {
    let serving = Serving::new();
    let (pages, file) = serving.subject();
    for path in [format!("{pages}/0/0/0"), format!("/v1/archives/{file}"), "/v1/events".to_owned()]
    {
        for _ in 0..20 {
            let mut stream = connect(serving.address());
            write!(stream, "GET {path} HTTP/1.1\r\nhost: here\r\n\r\n").unwrap();
            stream.read_exact(&mut [0; 10]).unwrap();
            stream.shutdown(Shutdown::Both).unwrap();
        }
    }
    eventually("all are gone", || {
        serving.metric("areoid_connections") < 2.0
            && serving.metric("areoid_requests_in_flight") == 0.0
    });
}

#[test]
fn too_many_requests_and_connections_are_told_so_at_once() {
    let serving =
        Serving::with(|options| (options.limits.requests, options.limits.connections) = (1, 3));
    let (_, file) = serving.subject();
    // One that does not read holds the only place.
    let mut stalled = connect(serving.address());
    for _ in 0..50 {
        let _ = write!(stalled, "GET /v1/archives/{file} HTTP/1.1\r\nhost: here\r\n\r\n");
    }
    eventually("it is full", || serving.metric("areoid_requests_in_flight") == 1.0);
    let start = Instant::now();
    let refused = serving.get("/v1/catalog");
    assert_eq!((refused.status, refused.header("retry-after")), (503, "1"));
    assert!(start.elapsed() < Duration::from_secs(5));

    eventually("only the first is left", || serving.metric("areoid_connections") <= 2.0);
    let idle = [connect(serving.address()), connect(serving.address())];
    eventually("all places are taken", || serving.metric("areoid_connections") >= 4.0);
    let refused = exchange(serving.address(), b"").unwrap();
    assert_eq!((refused.status, refused.header("retry-after")), (503, "1"));
    drop((stalled, idle));
    eventually("there is room", || {
        let answer: Option<Answer> =
            exchange(serving.address(), b"GET /v1/catalog HTTP/1.0\r\n\r\n");
        answer.is_some_and(|answer| answer.status == 200)
    });
}

#[test]
fn a_header_that_is_too_large_is_refused() {
    let serving = Serving::new();
    // Whether it comes at once or not.
    let long = [64 << 10, 33_000, 40_000].map(|count| "x".repeat(count));
    let many = vec![("x-one", "1"); 200];
    for headers in long.iter().map(|long| vec![("x-long", long.as_str())]).chain([many]) {
        assert_eq!(ask(serving.address(), "GET", "/v1/catalog", &headers, "").status, 431);
    }
    let short = "x".repeat(30_000);
    let headers = [("x-long", short.as_str())];
    assert_eq!(ask(serving.address(), "GET", "/v1/catalog", &headers, "").status, 200);
}

/// One service for all cases.
#[test]
fn garbage_is_refused_and_harms_nobody() {
    let serving = Serving::new();
    let (pages, _) = serving.subject();
    let piece = prop_oneof![
        prop::collection::vec(any::<u8>(), 0..60),
        prop::sample::select(
            vec![
                "GET ",
                "/v1/",
                "pages/",
                "archives/",
                "height?lon=",
                "%",
                "..",
                "/",
                "-",
                " HTTP/1.1\r\n",
                "\r\n",
                "\r\n\r\n",
                "range: bytes=",
                "host: x\r\n",
                "content-length: 5\r\n",
                "PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
                "transfer-encoding: chunked\r\n",
                "18446744073709551616",
                "if-none-match: ",
                "\"",
                "POST ",
                &pages,
            ]
            .into_iter()
            .map(|text| text.as_bytes().to_vec())
            .collect::<Vec<_>>()
        ),
    ];
    proptest!(ProptestConfig::with_cases(256), |(pieces in prop::collection::vec(piece, 1..12))| {
        for address in [serving.address(), serving.admin()] {
            let mut stream = connect(address);
            let _ = stream.write_all(&pieces.concat());
            let _ = stream.shutdown(Shutdown::Write);
            let mut answer = Vec::new();
            let _ = stream.read_to_end(&mut answer);
            let answer = String::from_utf8_lossy(&answer);
            prop_assert!(!answer.starts_with("HTTP/1.1 5"), "{answer}");
        }
    });
    assert_eq!(serving.get(&format!("{pages}/0/0/0")).status, 200);
    assert_eq!(serving.names(), ["pole"]);
}
