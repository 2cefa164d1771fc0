//! What `cache/HTTP.md` says.

use std::fs;
use std::io::{BufRead as _, BufReader, Write as _};
use std::process::Command;

use areoid_formats::address::{Level, PageAddress};
use areoid_formats::catalog::Catalog;

use super::rig::{Serving, TOKEN, ask, connect, get};

#[test]
fn the_catalog_is_that_of_info_and_is_not_sent_twice() {
    let serving = Serving::new();
    let answer = serving.get("/v1/catalog");
    assert_eq!((answer.status, answer.header("content-type")), (200, "application/json"));
    let info = Command::new(env!("CARGO_BIN_EXE_areoid"))
        .args(["info", "--json"])
        .arg(serving.place.catalog())
        .output()
        .unwrap();
    let info: serde_json::Value = serde_json::from_slice(&info.stdout).unwrap();
    let served = answer.json();
    assert_eq!(served["body"], info["body"]);
    for (key, value) in info["datasets"][0].as_object().unwrap() {
        assert_eq!(&served["datasets"][0][key], value, "{key}");
    }
    let tag = answer.header("etag");
    assert!(tag.starts_with('"'), "{tag}");
    let again = ask(serving.address(), "GET", "/v1/catalog", &[("if-none-match", tag)], "");
    assert_eq!((again.status, again.body.len()), (304, 0));

    let one = serving.get("/v1/datasets/pole");
    assert_eq!(one.json(), served["datasets"][0]);
    for path in
        ["/v1/datasets/nobody", "/v1/datasets/", "/", "/v1", "/v1/catalog/x", "/v1/datasets/../x"]
    {
        let missing = serving.get(path);
        assert_eq!(missing.status, 404, "{path}");
        assert!(missing.json()["error"].is_string(), "{path}");
    }
}

#[test]
fn a_page_is_its_payload_from_disk_and_then_from_memory() {
    let serving = Serving::new();
    let (pages, _) = serving.subject();
    let (_, archives) = Catalog::open_with_archives(&serving.place.catalog()).unwrap();
    let entries = archives[0].entries().unwrap();
    for entry in &entries {
        let PageAddress { level: Level(level), row, col } = entry.page;
        let path = format!("{pages}/{level}/{row}/{col}");
        for _ in 0..2 {
            let answer = serving.get(&path);
            assert_eq!(
                (answer.status, &answer.body),
                (200, &archives[0].payload(entry).unwrap()),
                "{path}"
            );
            assert_eq!(answer.header("areoid-bound").parse(), Ok(entry.bound));
            assert_eq!(answer.header("areoid-min").parse(), Ok(entry.min));
            assert_eq!(answer.header("areoid-valid-fraction").parse(), Ok(entry.valid_fraction));
            assert!(answer.header("cache-control").contains("immutable"));
            let tag = answer.header("etag");
            let again = ask(serving.address(), "GET", &path, &[("if-none-match", tag)], "");
            assert_eq!((again.status, again.body.len()), (304, 0));
        }
        let head = ask(serving.address(), "HEAD", &path, &[], "");
        let length = archives[0].payload(entry).unwrap().len().to_string();
        assert_eq!(
            (head.status, head.header("content-length"), head.body.len()),
            (200, length.as_str(), 0)
        );
    }
    let count = entries.len() as f64;
    assert_eq!(serving.metric("areoid_page_faults_total"), count);
    assert_eq!(serving.metric("areoid_page_hits_total"), 4.0 * count);

    // Pages without a valid texel, and pages that are none.
    let pyramid = archives[0].description().grid.pyramid();
    for level in pyramid.levels() {
        let (rows, cols) = pyramid.pages(level).unwrap();
        for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
            let page = PageAddress { level, row, col };
            let is_there = entries.iter().any(|entry| entry.page == page);
            let answer = ask(
                serving.address(),
                "HEAD",
                &format!("{pages}/{}/{row}/{col}", level.0),
                &[],
                "",
            );
            assert_eq!(answer.status, if is_there { 200 } else { 204 }, "{page:?}");
        }
        assert_eq!(serving.get(&format!("{pages}/{}/{rows}/0", level.0)).status, 404);
    }
    assert_eq!(serving.get(&format!("{pages}/99/0/0")).status, 404);
    for odd in ["0/-1/0", "0/+0/0", "0/00/0", "0//0", "0/0/99999999999999999999"] {
        assert_eq!(serving.get(&format!("{pages}/{odd}")).status, 400, "{odd}");
    }
    assert_eq!(serving.get("/v1/pages/pole/0123456789abcdef/0/0/0").status, 404);
    assert_eq!(serving.get(&format!("{pages}/0/0")).status, 404);
}

/// Whatever has a tag.
#[test]
fn what_is_in_memory_has_a_tag_and_ranges() {
    let serving = Serving::new();
    let (pages, _) = serving.subject();
    let page = format!("{pages}/0/0/0");
    for path in [page.as_str(), "/v1/catalog", "/v1/datasets/pole", "/v1/height?lon=30&lat=80"] {
        let whole = serving.get(path);
        let (tag, length) = (whole.header("etag").to_owned(), whole.body.len());
        let range = |headers: &[(&str, &str)]| ask(serving.address(), "GET", path, headers, "");
        let part = range(&[("range", "bytes=2-11"), ("if-range", &tag)]);
        assert_eq!((part.status, part.header("etag")), (206, tag.as_str()), "{path}");
        assert_eq!(part.header("content-range"), format!("bytes 2-11/{length}"));
        assert_eq!(part.body, whole.body[2..12]);
        assert_eq!(range(&[("range", "bytes=0-1"), ("if-range", "\"other\"")]).body, whole.body);
        let beyond = range(&[("range", "bytes=9999999-")]);
        assert_eq!(
            (beyond.status, beyond.header("content-range")),
            (416, format!("bytes */{length}").as_str())
        );
        let known = range(&[("range", "bytes=2-11"), ("if-none-match", &tag)]);
        assert_eq!((known.status, known.body.len()), (304, 0));
        // Again, from memory.
        assert_eq!(serving.get(path).body, whole.body);
    }
}

#[test]
fn an_archive_is_a_file_with_ranges() {
    let serving = Serving::new();
    let (_, file) = serving.subject();
    let path = format!("/v1/archives/{file}");
    let bytes = fs::read(serving.place.archive()).unwrap();
    let whole = serving.get(&path);
    assert_eq!(whole.status, 200);
    assert!(whole.body == bytes, "other bytes");
    let range = |range: &str| ask(serving.address(), "GET", &path, &[("range", range)], "");
    let part = range("bytes=100-300099");
    assert_eq!((part.status, part.header("content-length")), (206, "300000"));
    assert!(part.body == bytes[100..300_100], "other bytes");
    let last = range("bytes=-5");
    assert_eq!(last.body, bytes[bytes.len() - 5..]);
    assert_eq!(
        last.header("content-range"),
        format!("bytes {}-{}/{}", bytes.len() - 5, bytes.len() - 1, bytes.len())
    );
    let beyond = range("bytes=99999999999-");
    assert_eq!(
        (beyond.status, beyond.header("content-range")),
        (416, format!("bytes */{}", bytes.len()).as_str())
    );
    let stale = [("range", "bytes=0-9"), ("if-range", "\"other\"")];
    assert_eq!(ask(serving.address(), "GET", &path, &stale, "").status, 200);
    let head = ask(serving.address(), "HEAD", &path, &[], "");
    assert_eq!(head.header("content-length"), bytes.len().to_string());
    assert_eq!((head.header("accept-ranges"), head.body.len()), ("bytes", 0));
    for other in ["pole-0000000000000000.areoid", "manifest.1", "..%2fmanifest.1", "", "-"] {
        assert_eq!(serving.get(&format!("/v1/archives/{other}")).status, 404, "{other}");
    }
}

#[test]
fn a_height_is_that_of_the_command_line() {
    let serving = Serving::new();
    let answer = serving.get("/v1/height?lon=30&lat=80").json();
    let told = Command::new(env!("CARGO_BIN_EXE_areoid"))
        .args(["height", "--json", "--at", "30,80"])
        .arg(serving.place.catalog())
        .output()
        .unwrap();
    let told: serde_json::Value = serde_json::from_slice(&told.stdout).unwrap();
    assert_eq!(answer, told["points"][0]);
    assert!(serving.get("/v1/height?lon=30&lat=-80").json()["height_m"].is_null());
    for query in
        ["", "?lon=1", "?lon=1&lat=91", "?lon=x&lat=1", "?lon=inf&lat=0", "?lon=NaN&lat=NaN"]
    {
        assert_eq!(serving.get(&format!("/v1/height{query}")).status, 400, "{query}");
    }
}

#[test]
fn events_tell_what_comes_and_goes() {
    let serving = Serving::new();
    let mut stream = connect(serving.address());
    stream.write_all(b"GET /v1/events HTTP/1.1\r\nhost: here\r\n\r\n").unwrap();
    let mut lines = BufReader::new(stream).lines().map(Result::unwrap);
    let mut next = |event: &str| {
        lines.find(|line| line.starts_with("event: ") && line.ends_with(event)).unwrap()
    };
    next("hello");
    assert!(
        serving
            .insert(&serving.place.insertion("new", serde_json::json!({})))
            .text()
            .contains("inserted")
    );
    next("inserted");
    let more = serde_json::json!({ "force": true, "priority": 3 });
    assert!(serving.insert(&serving.place.insertion("new", more)).text().contains("inserted"));
    next("replaced");
    assert_eq!(serving.remove("new").status, 200);
    next("removed");
}

#[test]
fn the_admin_listener_tells_its_state_to_anybody() {
    let serving = Serving::new();
    for (path, text) in [("/livez", "alive\n"), ("/readyz", "ready\n")] {
        let answer = get(serving.admin(), path);
        assert_eq!((answer.status, answer.text().as_str()), (200, text));
    }
    assert!(
        get(serving.admin(), "/metrics")
            .text()
            .contains("\n# TYPE areoid_requests_total counter\n")
    );
    // Neither listener does the other's work.
    assert_eq!(get(serving.admin(), "/v1/catalog").status, 404);
    let token = format!("Bearer {TOKEN}");
    let public =
        ask(serving.address(), "DELETE", "/v1/datasets/pole", &[("authorization", &token)], "");
    assert_eq!((public.status, serving.names().len()), (405, 1));
}

#[test]
fn http2_is_understood_from_its_first_bytes() {
    let serving = Serving::new();
    let mut stream = connect(serving.address());
    // The preface in two pieces, and empty settings.
    stream.write_all(b"PR").unwrap();
    stream.flush().unwrap();
    stream.write_all(b"I * HTTP/2.0\r\n\r\nSM\r\n\r\n\0\0\0\x04\0\0\0\0\0").unwrap();
    let mut frame = [0; 9];
    std::io::Read::read_exact(&mut stream, &mut frame).unwrap();
    assert_eq!(frame[3], 4, "settings: {frame:?}");
}
