//! A disk that is slow, hangs or fails under the service.

use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;
use std::thread;
use std::time::{Duration, Instant};

use areoid_formats::archive::{Archive, PageEntry, Payload};
use areoid_formats::catalog::DatasetRecord;

use super::snapshot::Served;
use super::*;
use crate::tests::{Gate, Gated, globe_in_a_catalog};

/// How long anything may take that waits for no disk.
const SOON: Duration = Duration::from_secs(20);

struct Rig {
    service: Service,
    gate: Arc<Gate>,
    /// Addresses of pages on the slow disk, and what is there.
    slow: Vec<(String, Vec<u8>)>,
    _folder: tempfile::TempDir,
}

/// A service of a globe, and of a second one behind a gate.
fn rig() -> Rig {
    let folder = globe_in_a_catalog();
    let listen = "127.0.0.1:0".parse().unwrap();
    let service = Service::start(&Options {
        folder: folder.path().to_owned(),
        listen,
        memory_bytes: 64 << 20,
        admin: Some(Admin { listen, is_optional: false, token_file: None, allowed: Vec::new() }),
        threads: Some(2),
        limits: Limits::default(),
    })
    .unwrap();
    let Gated { archive, gate, entries, .. } = Gated::globe();
    // Reads are of pages alone from here on.
    archive.entries().unwrap();
    let globe = service.hub().now().datasets["globe"].record.clone();
    let record = DatasetRecord { name: "slow".to_owned(), bytes: archive.len(), ..globe };
    let slow = entries.iter().filter(|entry| matches!(entry.payload, Payload::Record { .. }));
    let path = |entry: &PageEntry| {
        let page = entry.page;
        let place = format!("{}/{}/{}", page.level.0, page.row, page.col);
        let path = format!("/v1/pages/slow/{}/{place}", record.content);
        (path, archive.payload(entry).unwrap())
    };
    let slow = slow.take(40).map(path).collect();
    let archive: Archive = Arc::into_inner(archive).unwrap();
    assert!(service.hub().add(vec![Served::new(record, Ok(archive), true)]));
    Rig { service, gate, slow, _folder: folder }
}

impl Rig {
    fn get(&self, path: &str) -> (u16, Vec<u8>) {
        get(self.service.public(), path)
    }

    /// All that waits for no disk is there at once.
    fn assert_serves(&self, page: &str) {
        let begun = Instant::now();
        for path in ["/v1/catalog", "/v1/datasets/slow", page] {
            assert_eq!(self.get(path).0, 200, "{path}");
        }
        for path in ["/livez", "/readyz", "/metrics"] {
            assert_eq!(get(self.service.admin().unwrap(), path).0, 200, "{path}");
        }
        assert!(begun.elapsed() < SOON, "{:?}", begun.elapsed());
    }
}

fn get(address: SocketAddr, path: &str) -> (u16, Vec<u8>) {
    let agent = ureq::Agent::config_builder().http_status_as_error(false).build().new_agent();
    let mut answer = agent.get(format!("http://{address}{path}")).call().unwrap();
    (answer.status().as_u16(), answer.body_mut().read_to_vec().unwrap())
}

/// More clients than reads wait for a disk that hangs: what is in memory is served, and when the disk goes on,
/// each has its page, read once for all who asked for it.
#[test]
fn a_disk_that_hangs_keeps_nobody_who_does_not_need_it() {
    let rig = rig();
    let content = &rig.service.hub().now().datasets["globe"].record.content.clone();
    let warm = format!("/v1/pages/globe/{content}/1/0/0");
    assert_eq!(rig.get(&warm).0, 200);
    rig.gate.allow(Some(0));
    let before = rig.gate.passed();
    let clients = rig.slow.iter().chain(&rig.slow).map(|(path, bytes)| {
        let (address, path, bytes) = (rig.service.public(), path.clone(), bytes.clone());
        thread::spawn(move || assert!(get(address, &path) == (200, bytes), "{path}"))
    });
    let clients: Vec<_> = clients.collect();
    let begun = Instant::now();
    while rig.service.hub().metrics.reading.load(Relaxed) < rig.slow.len() as u64 {
        assert!(begun.elapsed() < SOON, "reads do not wait");
        thread::yield_now();
    }
    rig.assert_serves(&warm);
    assert!(clients.iter().all(|client| !client.is_finished()));
    // Slowly, it goes on.
    for _ in 0..10 {
        rig.gate.allow(Some(1));
        rig.assert_serves(&warm);
    }
    rig.gate.allow(None);
    for client in clients {
        client.join().unwrap();
    }
    assert_eq!(rig.gate.passed() - before, rig.slow.len(), "each page is read once");
    rig.service.stop();
}

/// Of a medium that fails each page is an error that names it, and none stays one.
#[test]
fn a_disk_that_fails_is_told_page_by_page_and_asked_again() {
    let rig = rig();
    rig.gate.fail(true);
    for (path, _) in &rig.slow {
        let (status, said) = rig.get(path);
        let said = String::from_utf8(said).unwrap();
        assert!(status == 500 && said.contains("out of order"), "{status} {said}");
    }
    rig.gate.fail(false);
    for (path, bytes) in &rig.slow {
        assert!(rig.get(path) == (200, bytes.clone()), "{path}");
    }
    rig.service.stop();
}
