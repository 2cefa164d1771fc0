//! Memory in flight: budgets that hold, and pages that are decoded twice.

use std::collections::HashMap;
use std::fs;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use areoid_cache::{Cache, Options, PageSource};
use areoid_formats::address::PageAddress;
use areoid_formats::archive::{ArchiveError, PageEntry};
use areoid_formats::grid::{Grid, Outline};
use areoid_formats::page::Page;
use areoid_formats::projection::{Crs, Projection};
use serde_json::json;

use super::Setting;
use super::flights::leaps;
use super::planet::{Planet, body};
use super::replay::{LARGE, fly};
use crate::bench::report::{Chapter, Relation, Table, Target};
use crate::failure::Failure;

/// Of decoded pages.
const BUDGETS_MIB: [usize; 3] = [64, 256, 1024];

/// A flight of a budget over one of the other chapters.
const LONGER: f64 = 10.0;

/// What a process may take beside its budget: code, index, selections.
const BESIDE_MIB: f64 = 64.0;

/// A planet that knows when each page was decoded.
#[derive(Debug)]
struct Watched {
    planet: Arc<Planet>,
    decoded: Mutex<HashMap<PageAddress, Instant>>,
    again: AtomicU64,
}

pub(super) fn measure(setting: Setting) -> Result<Chapter, Failure> {
    let seconds = setting.seconds * LONGER;
    let flight = leaps(seconds)?;
    let (mut rows, mut data, mut targets) = (Vec::new(), Vec::new(), Vec::new());
    for budget_mib in BUDGETS_MIB {
        let watched = Arc::new(watched()?);
        let before_mib = resident_mib();
        let source = (watched.planet.info.clone(), Arc::clone(&watched) as _);
        let options = Options::with_budget(budget_mib << 20);
        let cache = Cache::with_sources(body(), [source], options)
            .map_err(|error| Failure::Failed(error.into()))?;
        let mut session = cache.session();
        let (mut peak_mib, mut evicted_on_screen, mut last) = (0.0_f64, 0_u64, None);
        fly(&flight, LARGE, &mut session, |_, selection, _| {
            peak_mib = peak_mib.max(resident_mib());
            // What is on the screen and still wanted has to be the very page that it was.
            if let Some(before) = last.replace(Arc::clone(selection)) {
                evicted_on_screen += replaced(&before, selection);
            }
        });
        drop(last);
        let stats = cache.stats();
        let again = watched.again.load(Relaxed);
        let beside = peak_mib - before_mib - budget_mib as f64;
        rows.push(vec![
            format!("{budget_mib} MiB"),
            stats.loads.to_string(),
            stats.evictions.to_string(),
            format!("{:.1}", stats.peak_bytes as f64 / f64::from(1 << 20)),
            format!("{peak_mib:.0} ({before_mib:.0} before)"),
            again.to_string(),
            evicted_on_screen.to_string(),
        ]);
        targets.push(Target::new(
            format!("resident memory beside {budget_mib} MiB, MiB"),
            Relation::AtMost,
            BESIDE_MIB,
            Some(beside),
        ));
        if budget_mib == 256 {
            let what = "pages decoded twice within a second at 256 MiB";
            targets.push(Target::new(what, Relation::AtMost, 0.0, Some(again as f64)));
        }
        targets.push(Target::new(
            format!("pages on the screen evicted at {budget_mib} MiB"),
            Relation::AtMost,
            0.0,
            Some(evicted_on_screen as f64),
        ));
        data.push(json!({
            "budget_mib": budget_mib, "loads": stats.loads, "evictions": stats.evictions,
            "peak_bytes": stats.peak_bytes, "peak_resident_mib": peak_mib,
            "resident_before_mib": before_mib, "decoded_again_within_1_s": again,
        }));
    }
    let head =
        vec!["budget", "loads", "evictions", "peak MiB", "process MiB", "decoded again", "lost"];
    Ok(Chapter {
        name: "budget",
        title: "Memory in flight",
        notes: vec![format!(
            "A flight of {seconds:.0} s in real time with a leap every five seconds, on pages of 512 \
             texels, loads of 2 ms, on a screen of 3840 by 2160 pixels at a quarter of a pixel: views that \
             need more than any of the budgets. That decoded pages and loads never pass the budget is asserted \
             at every change. *Decoded again* are pages decoded twice within a second, *lost* those \
             that were on the screen, were still wanted, and were another copy in the next frame."
        )],
        tables: vec![Table { title: "Budgets".to_owned(), head, rows }],
        targets,
        data: json!(data),
    })
}

fn watched() -> Result<Watched, Failure> {
    let planet = Planet::new("globe", globe()?, Duration::from_millis(2));
    Ok(Watched { planet, decoded: Mutex::default(), again: AtomicU64::new(0) })
}

/// Pages of 512 texels: 1 MiB each.
pub(super) fn globe() -> Result<Grid, Failure> {
    let outline = Outline {
        origin: [-180.0, 90.0],
        pixel_size: [360.0 / 49_152.0; 2],
        width: 49_152,
        height: 24_576,
    };
    let crs = Crs::new(Projection::Geographic, body().ellipsoid);
    let placed = Grid::from_outline(crs, outline, 512)
        .map_err(|error| std::io::Error::other(error.to_string()))?;
    Ok(placed.grid)
}

/// Pages of both selections that are not the same copy.
fn replaced(before: &areoid_cache::Selection, after: &areoid_cache::Selection) -> u64 {
    let now: HashMap<_, _> = after
        .pages
        .iter()
        .map(|page| ((page.dataset, page.entry.page), Arc::as_ptr(page)))
        .collect();
    let other = before.pages.iter().filter(|page| {
        let found = now.get(&(page.dataset, page.entry.page));
        found.is_some_and(|found| !std::ptr::eq(*found, Arc::as_ptr(page)))
    });
    other.count() as u64
}

/// Resident memory of this process, without the files it maps; 0 if the system does not tell.
fn resident_mib() -> f64 {
    let read = || {
        let status = fs::read_to_string("/proc/self/status").ok()?;
        let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:"))?;
        line.trim().strip_suffix("kB")?.trim().parse::<f64>().ok()
    };
    read().unwrap_or(0.0) / 1024.0
}

impl PageSource for Watched {
    fn find_resident(&self, page: PageAddress) -> Option<Option<PageEntry>> {
        self.planet.find_resident(page)
    }

    fn find(&self, page: PageAddress) -> Result<Option<PageEntry>, ArchiveError> {
        self.planet.find(page)
    }

    fn payload(&self, entry: &PageEntry) -> Result<Vec<u8>, ArchiveError> {
        self.planet.payload(entry)
    }

    fn decode(&self, entry: &PageEntry, payload: &[u8]) -> Result<Page, ArchiveError> {
        let now = Instant::now();
        let mut decoded = self.decoded.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(before) = decoded.insert(entry.page, now) {
            let soon = now - before < Duration::from_secs(1);
            self.again.fetch_add(u64::from(soon), Relaxed);
        }
        drop(decoded);
        self.planet.decode(entry, payload)
    }
}
