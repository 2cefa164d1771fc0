//! Those who fly, read and change, each on a thread of its own until the round ends.

use std::collections::HashMap;
use std::io::{Read as _, Write as _};
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::thread;
use std::time::{Duration, Instant};

use areoid_cache::camera::Pose;
use areoid_cache::{Cache, DatasetInfo, Options, Selection, Session, View};
use areoid_formats::archive::Archive;
use areoid_formats::catalog::Catalog;
use areoid_formats::geodesy::Geographic;
use areoid_formats::page::{Page, Texels};
use areoid_formats::units::{Degrees, Meters};
use serde_json::{Value, json};

use crate::rig::{NAME, Place, TOKEN, ask, connect, eventually, get};
use crate::server::Process;

pub(crate) const GLOBE: &str = "globe";

/// Inserted and removed through the server.
const GUEST: &str = "guest";

/// Inserted and removed in this process.
const VISITOR: &str = "visitor";

/// See the module.
pub(crate) struct Crowd<'a> {
    cache: &'a Cache,
    place: &'a Place,
    public: SocketAddr,
    admin: SocketAddr,
    /// Those who stay from round to round.
    sessions: Vec<Session>,
    /// The datasets that stay.
    truth: HashMap<String, Arc<Archive>>,
    changes: AtomicU64,
    answers: AtomicU64,
    rounds: u64,
}

/// Numbers that look random: `SplitMix64` (Steele, Lea and Flood 2014).
struct Chance(u64);

impl Chance {
    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut bits = self.0;
        bits = (bits ^ bits >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ bits >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        bits ^ bits >> 31
    }

    /// From 0 to 1.
    fn share(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn below(&mut self, end: u64) -> u64 {
        self.bits() % end
    }

    fn pick<'a, T>(&mut self, all: &'a [T]) -> &'a T {
        let place = usize::try_from(self.below(all.len() as u64)).unwrap();
        &all[place]
    }
}

/// The texels of heights: no data is NaN, which is not equal to itself.
fn bits(page: &Page) -> Vec<u32> {
    let Texels::Height(heights) = page.texels() else { panic!("all of them are heights") };
    heights.iter().map(|height| height.to_bits()).collect()
}

/// An eye that flies on, and leaps now and then.
struct Eye {
    chance: Chance,
    at: [f64; 3],
    heading: f64,
    left: u32,
}

impl Eye {
    fn new(seed: u64) -> Self {
        Self { chance: Chance(seed), at: [0.0; 3], heading: 0.0, left: 0 }
    }

    fn next(&mut self, cache: &Cache) -> View {
        if self.left == 0 {
            let height = 10.0_f64.powf(5.0 + 1.8 * self.chance.share());
            let latitude = if self.chance.below(2) == 0 { 85.0 } else { 60.0 };
            self.at = [
                360.0 * self.chance.share() - 180.0,
                latitude * (2.0 * self.chance.share() - 1.0),
                height,
            ];
            self.heading = 360.0 * self.chance.share();
            self.left = 20 + u32::try_from(self.chance.below(100)).unwrap();
        }
        self.left -= 1;
        self.at[0] += 0.1;
        self.heading += 0.5;
        let [longitude, latitude, height] = self.at;
        let position = Geographic::from_degrees(Degrees(longitude), Degrees(latitude));
        let [heading, pitch] = [self.heading.rem_euclid(360.0), -50.0].map(Degrees);
        let pose = Pose::from_eye(
            &cache.body().ellipsoid,
            position,
            Meters(height),
            heading.into(),
            pitch.into(),
        );
        pose.view(Degrees(45.0).into(), [640, 400], 1.0)
    }
}

impl<'a> Crowd<'a> {
    pub(crate) fn new(cache: &'a Cache, place: &'a Place, server: &Process) -> Self {
        let (catalog, archives) = Catalog::open_with_archives(&place.catalog()).unwrap();
        let records = catalog.datasets().iter();
        let truth =
            records.zip(archives).map(|(record, archive)| (record.name.clone(), Arc::new(archive)));
        Self {
            cache,
            place,
            public: server.public,
            admin: server.admin(),
            sessions: vec![cache.session(), cache.session()],
            truth: truth.collect(),
            changes: AtomicU64::new(0),
            answers: AtomicU64::new(0),
            rounds: 0,
        }
    }

    /// Changes of datasets so far.
    pub(crate) fn changes(&self) -> u64 {
        self.changes.load(Relaxed)
    }

    /// Answers over HTTP so far.
    pub(crate) fn answers(&self) -> u64 {
        self.answers.load(Relaxed)
    }

    /// All of it until `end`; the datasets are those of before then.
    pub(crate) fn round(&mut self, end: Instant) {
        self.rounds += 1;
        let seed = 100 * self.rounds;
        let mut sessions = std::mem::take(&mut self.sessions);
        let this = &*self;
        thread::scope(|scope| {
            for (number, session) in (0..).zip(&mut sessions) {
                scope.spawn(move || this.fly(session, seed + number, end));
            }
            scope.spawn(move || this.come_and_go(seed + 10, end));
            scope.spawn(move || this.change_here(end));
            scope.spawn(move || this.change_there(seed + 20, end));
            scope.spawn(move || this.fly_afar(seed + 30, end));
            for number in 0..2 {
                scope.spawn(move || this.read(seed + 40 + number, end));
            }
        });
        self.sessions = sessions;
    }

    /// Every page that anybody wants comes, and is the right one.
    pub(crate) fn settle(&mut self) {
        let mut eye = Eye::new(self.rounds);
        let mut sessions = std::mem::take(&mut self.sessions);
        for session in &mut sessions {
            let view = eye.next(self.cache);
            let mut last = None;
            eventually("all wanted pages are there", || {
                let now = session.update(&view);
                let is_settled = now.missing == 0 && now.failed.is_empty();
                let is_ours =
                    now.datasets.iter().all(|(_, info)| self.truth.contains_key(&info.name));
                last = Some(now);
                is_settled && is_ours
            });
            self.assert_right(&last.unwrap());
        }
        self.sessions = sessions;
    }

    fn assert_right(&self, selection: &Selection) {
        assert_eq!(selection.pages.len(), selection.wanted);
        assert!(!selection.pages.is_empty());
        for found in &selection.pages {
            let name = &selection.datasets[found.dataset].name;
            let archive = &self.truth[name];
            let entry = archive.find(found.entry.page).unwrap().unwrap();
            let truth: Page = archive.page(&entry).unwrap();
            assert!(bits(&found.page) == bits(&truth), "{name}/{}", found.entry.page);
        }
    }

    fn fly(&self, session: &mut Session, seed: u64, end: Instant) {
        let mut eye = Eye::new(seed);
        while Instant::now() < end {
            let selection = session.update(&eye.next(self.cache));
            assert!(selection.pages.len() <= selection.wanted);
            for page in &selection.pages {
                assert!(selection.datasets.get(page.dataset).is_some(), "a mixture");
            }
            drop(selection);
            thread::sleep(Duration::from_millis(8));
        }
    }

    /// Sessions that live for a moment, single pages, and heights.
    fn come_and_go(&self, seed: u64, end: Instant) {
        let mut chance = Chance(seed);
        while Instant::now() < end {
            let stay = Instant::now() + Duration::from_millis(20 + chance.below(300));
            self.fly(&mut self.cache.session(), chance.bits(), stay.min(end));
            let position = Geographic::from_degrees(
                Degrees(360.0 * chance.share() - 180.0),
                Degrees(180.0 * chance.share() - 90.0),
            );
            // Datasets may go meanwhile, and sessions hold all memory.
            let _ = self.cache.wait_for(self.cache.exact_height(position));
        }
    }

    fn change_here(&self, end: Instant) {
        let archive = &self.truth[NAME];
        let mut priority = 0;
        while Instant::now() < end {
            for _ in 0..2 {
                priority += 1;
                let info = DatasetInfo {
                    name: VISITOR.to_owned(),
                    group: None,
                    kind: archive.description().kind,
                    grid: archive.description().grid.clone(),
                    priority,
                };
                self.cache.insert(info, Arc::clone(archive) as _).unwrap();
                thread::sleep(Duration::from_millis(40));
            }
            assert!(self.cache.remove(VISITOR));
            self.changes.fetch_add(3, Relaxed);
            thread::sleep(Duration::from_millis(40));
        }
    }

    fn change_there(&self, seed: u64, end: Instant) {
        let authorization = format!("Bearer {TOKEN}");
        let headers = [("authorization", authorization.as_str())];
        let mut chance = Chance(seed);
        let mut priority = 0;
        while Instant::now() < end {
            let temporary = chance.below(2) == 0;
            for _ in 0..=chance.below(2) {
                priority += 1;
                let more = json!({ "priority": priority, "temporary": temporary, "force": true });
                let body = self.place.insertion(GUEST, more);
                let answer = ask(self.admin, "POST", "/v1/datasets", &headers, &body).text();
                assert!(answer.contains("inserted"), "{answer}");
                self.changes.fetch_add(1, Relaxed);
            }
            let path = format!("/v1/datasets/{GUEST}");
            assert_eq!(ask(self.admin, "DELETE", &path, &headers, "").status, 200);
            self.changes.fetch_add(1, Relaxed);
        }
    }

    /// Pages of what the catalog has, and now and then the beginning of an archive or of the events.
    fn read(&self, seed: u64, end: Instant) {
        let mut chance = Chance(seed);
        while Instant::now() < end {
            let catalog: Value = get(self.public, "/v1/catalog").json();
            let dataset = chance.pick(catalog["datasets"].as_array().unwrap());
            let text = |key: &str| dataset[key].as_str().unwrap();
            let (name, file) = (text("name"), text("file"));
            for _ in 0..4 {
                let level = chance.below(4);
                let (row, col) = (chance.below(1 << level), chance.below(1 << level));
                let path = format!("/v1/pages/{name}/{}/{level}/{row}/{col}", text("content"));
                let status = get(self.public, &path).status;
                assert!(matches!(status, 200 | 204 | 404), "{path}: {status}");
                self.answers.fetch_add(1, Relaxed);
            }
            let path =
                if chance.below(2) == 0 { "/v1/events" } else { &format!("/v1/archives/{file}") };
            let mut stream = connect(self.public);
            write!(stream, "GET {path} HTTP/1.1\r\nhost: here\r\n\r\n").unwrap();
            stream.read_exact(&mut [0; 10]).unwrap();
        }
    }

    /// A cache of what the server serves, for a moment.
    fn fly_afar(&self, seed: u64, end: Instant) {
        let mut chance = Chance(seed);
        let url = format!("http://{}", self.public);
        while Instant::now() < end {
            let options = Options::with_budget(1 << 20);
            let cache = Cache::open(url.as_str(), options).wait().unwrap();
            let stay = Instant::now() + Duration::from_millis(200 + chance.below(600));
            self.fly(&mut cache.session(), chance.bits(), stay.min(end));
            let stats = cache.stats();
            assert!(stats.peak_bytes <= stats.budget_bytes, "{stats:?}");
            self.answers.fetch_add(stats.loads, Relaxed);
        }
    }
}
