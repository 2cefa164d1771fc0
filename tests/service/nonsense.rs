//! Servers that answer nonsense: an error in bounded time and memory, and nothing worse.

use std::io::{Read as _, Write as _};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::thread;
use std::time::{Duration, Instant};

use areoid_cache::remote::{Client, RemoteCatalog, RemoteError};
use areoid_cache::{Cache, CacheError, Options, PageSource as _};
use areoid_formats::archive::{ArchiveError, Payload};
use serde_json::Value;

use super::rig::{Serving, ask};

/// What is done with a request for a path and a range, if one is asked for.
type Deed =
    dyn Fn(&mut TcpStream, &str, Option<(usize, usize)>) -> std::io::Result<()> + Send + Sync;

/// A server of one's own making. It lives as long as its process: nobody waits for it.
fn server(
    deed: impl Fn(&mut TcpStream, &str, Option<(usize, usize)>) -> std::io::Result<()>
    + Send
    + Sync
    + 'static,
) -> SocketAddr {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let (address, deed): (_, Arc<Deed>) = (listener.local_addr().unwrap(), Arc::new(deed));
    thread::spawn(move || {
        for stream in listener.incoming().map_while(Result::ok) {
            let deed = Arc::clone(&deed);
            thread::spawn(move || answer(stream, &*deed));
        }
    });
    address
}

fn answer(mut stream: TcpStream, deed: &Deed) {
    let (mut head, mut byte) = (Vec::new(), [0]);
    while !head.ends_with(b"\r\n\r\n") && stream.read_exact(&mut byte).is_ok() {
        head.push(byte[0]);
    }
    let head = String::from_utf8_lossy(&head).into_owned();
    let Some(path) = head.split(' ').nth(1) else { return };
    let range = head.lines().find_map(|line| {
        let (from, to) = line
            .to_lowercase()
            .strip_prefix("range: bytes=")?
            .split_once('-')
            .map(|(from, to)| (from.to_owned(), to.to_owned()))?;
        Some((from.parse().ok()?, to.parse().ok()?))
    });
    // A client that has had enough closes.
    let _ = deed(&mut stream, path, range);
}

fn whole(stream: &mut TcpStream, status: &str, headers: &str, body: &[u8]) -> std::io::Result<()> {
    let length = body.len();
    write!(
        stream,
        "HTTP/1.1 {status}\r\nconnection: close\r\ncontent-length: {length}\r\n{headers}\r\n"
    )?;
    stream.write_all(body)
}

/// The catalog of an honest server, its archive's file and bytes, and its content.
fn truth() -> (Value, Vec<u8>, String) {
    let serving = Serving::new();
    let catalog = serving.get("/v1/catalog").json();
    let content = catalog["datasets"][0]["content"].as_str().unwrap().to_owned();
    let (_, file) = serving.subject();
    let bytes = ask(serving.address(), "GET", &format!("/v1/archives/{file}"), &[], "").body;
    (catalog, bytes, content)
}

fn part(stream: &mut TcpStream, tag: &str, bytes: &[u8]) -> std::io::Result<()> {
    whole(stream, "206 Partial Content", &format!("etag: \"{tag}\"\r\n"), bytes)
}

fn open(address: SocketAddr) -> Result<Cache, CacheError> {
    Cache::open(format!("http://{address}").as_str(), Options::with_budget(16 << 20)).wait()
}

/// Sends what never ends, and counts what is taken of it.
fn endless(stream: &mut TcpStream, head: &str, taken: &AtomicU64) -> std::io::Result<()> {
    stream.write_all(head.as_bytes())?;
    let piece = [b"10000\r\n".as_slice(), &[b' '; 0x10000], b"\r\n"].concat();
    loop {
        stream.write_all(&piece)?;
        taken.fetch_add(piece.len() as u64, Relaxed);
    }
}

#[test]
fn archives_of_nonsense_are_left_out() {
    let (catalog, bytes, content) = truth();
    let taken = Arc::new(AtomicU64::new(0));
    let ways = [
        "garbage",
        "zeros",
        "truncated",
        "longer",
        "endless",
        "another",
        "500",
        "404",
        "200",
        "closed",
        "no http",
    ];
    for way in ways {
        let (catalog, bytes, content) = (catalog.to_string(), bytes.clone(), content.clone());
        let counted = Arc::clone(&taken);
        let address = server(move |stream, path, range| {
            if path == "/v1/catalog" {
                return whole(stream, "200 OK", "", catalog.as_bytes());
            }
            let Some((from, to)) = range else { return whole(stream, "404 Not Found", "", b"") };
            let asked = &bytes[from..=to];
            match way {
                "garbage" => part(
                    stream,
                    &content,
                    &asked.iter().rev().map(|byte| byte ^ 0x5a).collect::<Vec<_>>(),
                ),
                "zeros" => part(stream, &content, &vec![0; asked.len()]),
                "truncated" => {
                    write!(
                        stream,
                        "HTTP/1.1 206 Partial Content\r\netag: \"{content}\"\r\ncontent-length: {}\r\n\r\n",
                        asked.len()
                    )?;
                    stream.write_all(&asked[..asked.len() / 2])
                }
                "longer" => part(stream, &content, &[asked, b"more"].concat()),
                "endless" => {
                    let head = format!(
                        "HTTP/1.1 206 Partial Content\r\netag: \"{content}\"\r\ntransfer-encoding: chunked\r\n\r\n"
                    );
                    endless(stream, &head, &counted)
                }
                "another" => part(stream, "0123456789abcdef", asked),
                "500" => {
                    whole(stream, "500 Internal Server Error", "", b"{\"error\": \"the disk\"}")
                }
                "404" => whole(stream, "404 Not Found", "", b""),
                "200" => whole(stream, "200 OK", "", &bytes),
                "closed" => Ok(()),
                _ => stream.write_all(b"220 ready\r\n\r\n"),
            }
        });
        let begin = Instant::now();
        match open(address) {
            Ok(cache) => {
                assert_eq!((cache.datasets().len(), cache.problems().len()), (0, 1), "{way}");
                assert_ne!(way, "closed");
            }
            // Nobody is there any more: what is left of the catalog is no state of it.
            Err(error) => assert!(way == "closed", "{way}: {error}"),
        }
        assert!(begin.elapsed() < Duration::from_secs(10), "{way} took {:?}", begin.elapsed());
    }
    let taken = taken.load(Relaxed);
    assert!((1..64 << 20).contains(&taken), "{taken} bytes of what never ends were taken");
}

#[test]
fn catalogs_of_nonsense_are_refused() {
    let (catalog, _, _) = truth();
    let altered = |change: &dyn Fn(&mut Value)| {
        let mut altered = catalog.clone();
        change(&mut altered);
        altered.to_string()
    };
    for text in [
        String::new(),
        "[1, 2".to_owned(),
        "{}".to_owned(),
        "[".repeat(1 << 20),
        altered(&|catalog| catalog["body"]["a_m"] = (-1.0).into()),
        altered(&|catalog| {
            let twice = catalog["datasets"][0].clone();
            catalog["datasets"].as_array_mut().unwrap().push(twice);
        }),
        altered(&|catalog| catalog["datasets"][0]["bytes"] = "many".into()),
    ] {
        let start: String = text.chars().take(60).collect();
        let address = server(move |stream, _, _| whole(stream, "200 OK", "", text.as_bytes()));
        let error = open(address).unwrap_err();
        assert!(
            matches!(error, CacheError::Remote(RemoteError::Answer { .. })),
            "{start}: {error}"
        );
    }
    // Names that lead elsewhere, and archives longer than anything.
    for (key, value) in [
        ("file", Value::from("../../etc/passwd")),
        ("content", "../../0123456789".into()),
        ("name", "a\u{1b}[2Jb".into()),
        ("bytes", u64::MAX.into()),
        ("bytes", (1_u64 << 50).into()),
        ("bytes", 0.into()),
    ] {
        let text = altered(&|catalog| catalog["datasets"][0][key] = value.clone());
        let asked = Arc::new(AtomicBool::new(false));
        let seen = Arc::clone(&asked);
        let address = server(move |stream, path, range| match range {
            None => whole(stream, "200 OK", "", text.as_bytes()),
            Some((from, to)) => {
                seen.fetch_or(path.contains("..") || path.contains('\u{1b}'), Relaxed);
                let length = (to - from + 1).min(8 << 20);
                part(stream, "0123456789abcdef", &vec![0; length])
            }
        });
        let cache = open(address).unwrap();
        assert_eq!((cache.datasets().len(), cache.problems().len()), (0, 1), "{key}: {value}");
        assert!(!asked.load(Relaxed), "{key}: {value} was asked for");
    }
}

/// A catalog of 64 MiB at most is read.
#[test]
fn a_catalog_without_end_is_refused() {
    let taken = Arc::new(AtomicU64::new(0));
    let counted = Arc::clone(&taken);
    let address = server(move |stream, _, _| {
        endless(stream, "HTTP/1.1 200 OK\r\ntransfer-encoding: chunked\r\n\r\n", &counted)
    });
    open(address).unwrap_err();
    let taken = taken.load(Relaxed);
    assert!((1 << 20..128 << 20).contains(&taken), "{taken} bytes of what never ends were taken");
}

/// Bytes that are wrong once are told by their checksum, and right the next time.
#[test]
fn a_damaged_page_is_told_and_no_other() {
    let (catalog, bytes, content) = truth();
    let is_damaged = Arc::new(AtomicBool::new(false));
    let asked = Arc::new(AtomicU64::new(0));
    let (damaged, counted) = (Arc::clone(&is_damaged), Arc::clone(&asked));
    let text = catalog.to_string();
    let address = server(move |stream, _, range| match range {
        None => whole(stream, "200 OK", "", text.as_bytes()),
        Some((from, to)) => {
            counted.fetch_add(1, Relaxed);
            let mut part_of = bytes[from..=to].to_vec();
            if damaged.load(Relaxed) {
                let middle = part_of.len() / 2;
                part_of[middle] ^= 1;
            }
            part(stream, &content, &part_of)
        }
    });
    let remote =
        RemoteCatalog::open(&Client::new(&format!("http://{address}")).unwrap(), None).unwrap();
    let pages = &remote.datasets[0].pages;
    let entries = pages.archive().entries().unwrap();
    let stored: Vec<_> = entries
        .iter()
        .filter(|entry| matches!(entry.payload, Payload::Record { .. }))
        .take(3)
        .collect();
    is_damaged.store(true, Relaxed);
    let before = asked.load(Relaxed);
    let error = pages.payload(stored[1]).unwrap_err();
    assert!(matches!(error, ArchiveError::PageChecksum { .. }), "{error}");
    assert_eq!(asked.load(Relaxed), before + 1, "damage is not asked for again at once");
    is_damaged.store(false, Relaxed);
    for entry in stored {
        pages.decode(entry, &pages.payload(entry).unwrap()).unwrap();
    }
}

/// An archive that the server does not have is not asked for by each of its pages.
#[test]
fn a_missing_archive_is_asked_for_once() {
    let (catalog, bytes, content) = truth();
    let (is_gone, asked) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
    let (gone, counted) = (Arc::clone(&is_gone), Arc::clone(&asked));
    let text = catalog.to_string();
    let address = server(move |stream, _, range| match range {
        None => whole(stream, "200 OK", "", text.as_bytes()),
        Some(_) if gone.load(Relaxed) => {
            counted.fetch_add(1, Relaxed);
            whole(stream, "404 Not Found", "", b"")
        }
        Some((from, to)) => part(stream, &content, &bytes[from..=to]),
    });
    let remote =
        RemoteCatalog::open(&Client::new(&format!("http://{address}")).unwrap(), None).unwrap();
    let pages = &remote.datasets[0].pages;
    let entries = pages.archive().entries().unwrap();
    is_gone.store(true, Relaxed);
    let mut failed = 0;
    for entry in &entries {
        failed += u64::from(pages.payload(entry).is_err());
    }
    assert!(failed > 10, "{failed} pages");
    assert_eq!(asked.load(Relaxed), 1);
}
