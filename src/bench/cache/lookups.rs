//! Finding a page in memory, and loading one, in process.

use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::time::Instant;

use areoid_cache::{Cache, DatasetInfo, Options};
use areoid_formats::archive::{Archive, PageEntry};
use areoid_formats::catalog::Catalog;
use serde_json::json;

use super::Setting;
use crate::bench::rasters::{Look, Recipe};
use crate::bench::report::{Chapter, Relation, Spread, Table, Target};
use crate::bench::timing;
use crate::failure::Failure;

/// Millions of lookups a second.
const LEAST_LOOKUPS: f64 = 10.0;

/// A page through the cache over one read and decoded in a bare loop.
const MOST_FAULT: f64 = 1.3;

/// Rounds that are compared.
const ROUNDS: usize = 7;

const LOOKUPS: usize = 5_000_000;

pub(super) fn measure(setting: Setting, folder: &Path) -> Result<Chapter, Failure> {
    let archive = Arc::new(made(setting, folder)?);
    let entries = archive.entries().map_err(|error| Failure::Failed(error.into()))?;
    let mut faults = Vec::new();
    let (mut bare_us, mut cached_us, mut millions) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        // Kept, as a cache does: memory that is used again costs the system nothing.
        let mut kept = Vec::with_capacity(entries.len());
        let start = Instant::now();
        for entry in &entries {
            let payload = archive.payload(entry).map_err(|error| Failure::Failed(error.into()))?;
            let page =
                archive.decode(entry, &payload).map_err(|error| Failure::Failed(error.into()))?;
            kept.push(page);
        }
        let bare = start.elapsed().as_secs_f64() / entries.len() as f64;
        drop(kept);

        let cache = cache(&archive)?;
        let start = Instant::now();
        cache.wait_for(async {
            for entry in &entries {
                let page = cache.page(0, entry.page).await;
                std::hint::black_box(&page.map_err(|error| Failure::Failed(error.into()))?);
            }
            Ok::<_, Failure>(())
        })?;
        let cached = start.elapsed().as_secs_f64() / entries.len() as f64;
        faults.push(cached / bare);
        bare_us.push(bare * 1e6);
        cached_us.push(cached * 1e6);
        millions.push(lookups(&cache, &entries));
    }
    let spread = |figures: Vec<f64>| Spread::of(figures.into_iter());
    let text = |spread: Option<Spread>, digits| {
        spread.map_or_else(|| "–".to_owned(), |spread| spread.text(digits))
    };
    let (faults, millions) = (spread(faults), spread(millions));
    let (bare_us, cached_us) = (spread(bare_us), spread(cached_us));
    let rows = vec![
        vec!["read and decoded in a loop, µs a page".to_owned(), text(bare_us, 0)],
        vec!["through the cache, one after another, µs a page".to_owned(), text(cached_us, 0)],
        vec!["ratio, round by round".to_owned(), text(faults, 3)],
        vec!["found in memory, millions a second".to_owned(), text(millions, 1)],
    ];
    Ok(Chapter {
        name: "lookups",
        title: "Finding a page, and loading one",
        notes: vec![format!(
            "{} pages of made-up terrain, 512 texels a side, on a medium that has them in memory. One \
             thread asks; the loop keeps its pages, too.",
            entries.len()
        )],
        tables: vec![Table {
            title: "In process".to_owned(),
            head: vec!["", "median (range)"],
            rows,
        }],
        targets: vec![
            Target::new(
                "a page through the cache over a bare loop",
                Relation::AtMost,
                MOST_FAULT,
                faults.map(|spread| spread.median),
            ),
            Target::new(
                "pages found in memory, millions a second on a core",
                Relation::AtLeast,
                LEAST_LOOKUPS,
                millions.map(|spread| spread.median),
            ),
        ],
        data: json!({
            "pages": entries.len(), "bare_us": bare_us, "cached_us": cached_us, "ratio": faults,
            "million_lookups_per_s": millions,
        }),
    })
}

/// Millions of pages found in a second, all over those in memory.
fn lookups(cache: &Cache, entries: &[PageEntry]) -> f64 {
    let start = Instant::now();
    let mut place = 0;
    for _ in 0..LOOKUPS {
        place = (place + 7919) % entries.len();
        std::hint::black_box(cache.resident(0, entries[place].page).is_some());
    }
    LOOKUPS as f64 / 1e6 / start.elapsed().as_secs_f64()
}

fn cache(archive: &Arc<Archive>) -> Result<Cache, Failure> {
    let description = archive.description();
    let info = DatasetInfo {
        name: description.dataset.clone(),
        group: None,
        kind: description.kind,
        grid: description.grid.clone(),
        priority: description.priority,
    };
    let archives = vec![(info, Arc::clone(archive))];
    Cache::with_archives(description.body.clone(), archives, Options::with_budget(4 << 30))
        .map_err(|error| Failure::Failed(error.into()))
}

/// An archive of made-up terrain.
fn made(setting: Setting, folder: &Path) -> Result<Archive, Failure> {
    let width = (setting.count(4096) / 512).max(1) * 512;
    let raster = Recipe::tiled(Look::Height, (width, width / 2)).make(&folder.join("rasters"))?;
    let catalog = folder.join("work").join("catalog");
    timing::remove(&catalog)?;
    std::fs::create_dir_all(&catalog)?;
    let mut ingest = Command::new(std::env::current_exe()?);
    ingest.arg("ingest").arg(&raster).arg("--catalog").arg(&catalog).arg("--json");
    crate::bench::ingest::said(&mut ingest)?;
    let (_, archives) = Catalog::open_with_archives(&catalog)?;
    let archive = archives.into_iter().next();
    archive.ok_or_else(|| std::io::Error::other("no dataset was made").into())
}
