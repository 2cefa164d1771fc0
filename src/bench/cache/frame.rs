//! What an update costs the thread that draws, while all else goes on.

use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::thread;
use std::time::{Duration, Instant};

use areoid_cache::insertion::{self, InsertError, Lifetime};
use areoid_cache::insertion_request::InsertRequest;
use areoid_cache::{Cache, Options};
use areoid_formats::body::Body;
use areoid_preprocess::build::Proceed;
use areoid_preprocess::ingest::Request;
use serde_json::json;

use super::Setting;
use super::flights::flights;
use super::patches::{Patch, patch, patches};
use super::planet::body;
use super::replay::{WINDOW, clock, fly, in_real_time};
use crate::bench::rasters::{Look, Recipe};
use crate::bench::report::{Chapter, Relation, Table, Target, quantile};
use crate::failure::Failure;

const DATASETS: u32 = 10_000;

/// Milliseconds of the thread, at the 99th percentile.
const LIMIT_MS: f64 = 1.0;

pub(super) fn measure(setting: Setting, folder: &Path) -> Result<Chapter, Failure> {
    let busy = Busy::new(&folder.join("work").join("frame"))?;
    let delay = Duration::from_millis(20);
    let count = setting.count(DATASETS);
    let all = patches(count, delay)?;
    let pages: u64 = all.iter().map(|patch| patch.pages()).sum();
    let sources = all.into_iter().map(|patch| (patch.info.clone(), patch as _));
    let options = Options { concurrent_loads: 64, ..Options::with_budget(1 << 30) };
    let cache = Cache::with_sources(body(), sources, options)
        .map_err(|error| Failure::Failed(error.into()))?;

    let (mut rows, mut data, mut worst) = (Vec::new(), Vec::new(), 0.0_f64);
    for named in flights(setting.seconds)? {
        let mut session = cache.session();
        let (mut took_ms, mut visited, mut seen, mut wanted) = (Vec::new(), 0, 0, 0);
        let before = cache.stats();
        let [changes, insertions] = beside(&cache, count, delay, &busy, || {
            fly(&named.flight, WINDOW, &mut session, |_, selection, took| {
                took_ms.push(took.as_secs_f64() * 1e3);
                visited += selection.visited;
                seen += selection.wanted + selection.culled;
                wanted += selection.wanted;
            });
        })?;
        let stats = cache.stats();
        let frames = took_ms.len();
        took_ms.sort_by(f64::total_cmp);
        let of = |share| quantile(&took_ms, share);
        worst = worst.max(of(0.99));
        rows.push(vec![
            named.name.to_owned(),
            frames.to_string(),
            format!("{:.3}", of(0.5)),
            format!("{:.3}", of(0.99)),
            format!("{:.3}", of(1.0)),
            format!("{:.0}", wanted as f64 / frames as f64),
            format!("{:.0}", visited as f64 / frames as f64),
            format!("{:.2}", visited as f64 / seen.max(1) as f64),
            (stats.repeated - before.repeated).to_string(),
            changes.to_string(),
            insertions.to_string(),
        ]);
        data.push(json!({
            "flight": named.name,
            "frames": frames,
            "update_ms": { "median": of(0.5), "p99": of(0.99), "max": of(1.0) },
            "wanted": wanted as f64 / frames as f64,
            "visited": visited as f64 / frames as f64,
            "repeated": stats.repeated - before.repeated,
            "changes": changes,
            "insertions": insertions,
        }));
    }
    let mut took_ms = Vec::new();
    let lines = Lines::default();
    let [changes, insertions] = beside(&cache, count, delay, &busy, || {
        in_real_time(setting.seconds, |_| took_ms.push(lines.read().as_secs_f64() * 1e3));
    })?;
    took_ms.sort_by(f64::total_cmp);
    let [median, p99, max] = [0.5, 0.99, 1.0].map(|share| quantile(&took_ms, share));
    let mut row = vec!["memory alone".to_owned(), took_ms.len().to_string()];
    row.extend([median, p99, max].map(|ms| format!("{ms:.3}")));
    row.extend(["", "", "", ""].map(str::to_owned));
    row.extend([changes, insertions].map(|number| number.to_string()));
    rows.push(row);
    let alone = json!({ "median": median, "p99": p99, "max": max });

    let head = vec![
        "flight",
        "frames",
        "median ms",
        "p99 ms",
        "max ms",
        "wanted",
        "visited",
        "over least",
        "repeated",
        "changes",
        "ingests",
    ];
    let title = format!(
        "Updates of a view of {count} datasets and {:.1} million pages",
        pages as f64 / 1e6
    );
    Ok(Chapter {
        name: "frame",
        title: "What a frame costs",
        notes: vec![
            "Sixty updates a second in real time, in milliseconds of the processor time of the thread \
             that makes them, while up to 64 loads of 20 ms each are under way, datasets come and go \
             ten times a second, and a raster is inserted into a catalog over and over, with the \
             priority that insertions have. \
             *Visited* are nodes of the tree over the datasets and pages; the least is the wanted \
             pages and those that had to be looked at to be left out. *Repeated* updates found the \
             tables in use and answered as the one before."
                .to_owned(),
            format!(
                "*Memory alone* is a thread that reads {} lines of a processor's cache in the place of each \
                 update, a mebibyte, beside the same insertions and without loads: what the machine does to whoever \
                 reads so much. Those reads wait for one another less than an update's do.",
                Lines::READ
            ),
        ],
        tables: vec![Table { title, head, rows }],
        targets: vec![Target::new(
            "an update, p99 of all flights, ms of its thread",
            Relation::AtMost,
            LIMIT_MS,
            Some(worst),
        )],
        data: json!({
            "datasets": count,
            "pages": pages,
            "flights": data,
            "memory_alone_ms": alone,
        }),
    })
}

/// Lines of a processor's cache, more than are read.
struct Lines(Vec<[u64; 8]>);

impl Default for Lines {
    fn default() -> Self {
        Self(vec![[1; 8]; 8 * Self::READ])
    }
}

impl Lines {
    const READ: usize = 1 << 14;

    /// Reads some, in an order that nothing foresees; the time of the thread that it takes.
    fn read(&self) -> Duration {
        let before = clock();
        // An odd factor leads to each but once.
        let places = (0..Self::READ).map(|place| place * 88_949 % self.0.len());
        black_box(places.map(|place| self.0[place][0]).sum::<u64>());
        clock().saturating_sub(before)
    }
}

/// Width of the raster that is inserted meanwhile.
const WIDTH: u32 = 4096;

/// What keeps the processors busy.
struct Busy {
    request: Request,
    body: Body,
    /// How many names were given.
    names: AtomicU64,
}

impl Busy {
    fn new(folder: &Path) -> Result<Self, Failure> {
        let raster = Recipe::tiled(Look::Height, (WIDTH, WIDTH / 2)).make(folder)?;
        let asked = json!({ "rasters": [raster] });
        let asked: InsertRequest = serde_json::from_value(asked)?;
        let request = asked.request(folder.join("catalog"));
        let request = request.map_err(|reason| Failure::Failed(reason.into()))?;
        Ok(Self { request, body: body(), names: AtomicU64::new(0) })
    }

    /// Inserts over and over; how often.
    fn insert(&self, done: &AtomicBool) -> Result<u64, InsertError> {
        let mut count = 0;
        while !done.load(Relaxed) {
            let watch = |_| if done.load(Relaxed) { Proceed::No } else { Proceed::Yes };
            // What is there already would not be built again.
            let name = format!("busy-{}", self.names.fetch_add(1, Relaxed));
            let request = Request { name: Some(name), ..self.request.clone() };
            match insertion::insert(request, Lifetime::Kept, &self.body, watch) {
                Ok(_) => count += 1,
                Err(_) if done.load(Relaxed) => {}
                Err(error) => return Err(error),
            }
        }
        Ok(count)
    }
}

/// Does something while datasets come and go and a raster is inserted; how many changes there were, and insertions.
fn beside(
    cache: &Cache,
    count: u32,
    delay: Duration,
    busy: &Busy,
    job: impl FnOnce(),
) -> Result<[u64; 2], Failure> {
    let extra: Vec<Arc<Patch>> = (0..10)
        .map(|number| patch(997 * number + 13, count + 7919, delay))
        .collect::<Result<_, _>>()?;
    let (done, changes) = (AtomicBool::new(false), AtomicU64::new(0));
    thread::scope(|scope| {
        let named = thread::Builder::new().name("changes".to_owned());
        let spawned = named.spawn_scoped(scope, || {
            let (start, mut round) = (Instant::now(), 0_u32);
            while !done.load(Relaxed) {
                let patch = &extra[round as usize / 2 % extra.len()];
                if round.is_multiple_of(2) {
                    let mut info = patch.info.clone();
                    info.name = format!("extra-{}", round / 2 % 10);
                    // An index in memory is always read.
                    let _inserted = cache.insert(info, Arc::clone(patch) as _);
                } else {
                    cache.remove(&format!("extra-{}", round / 2 % 10));
                }
                changes.fetch_add(1, Relaxed);
                round += 1;
                let next = Duration::from_millis(100) * round;
                thread::sleep(next.saturating_sub(start.elapsed()));
            }
        });
        let inserting = scope.spawn(|| busy.insert(&done));
        job();
        done.store(true, Relaxed);
        spawned?;
        let panicked = |_| Failure::Failed("the insertion panicked".into());
        Ok([
            changes.load(Relaxed),
            inserting.join().map_err(panicked)?.map_err(|error| Failure::Failed(error.into()))?,
        ])
    })
}
