//! A render loop without a renderer: opens a catalog, moves an eye over it, takes pages, and puts
//! one more dataset in while it runs.
//!
//! ```text
//! cargo run --release --package areoid-cache --example flight -- CATALOG [OTHER_CATALOG]
//! ```
//!
//! The catalog is a folder or a server's address. The datasets of the other one, a folder, appear
//! half-way.

#![expect(clippy::print_stdout, reason = "an example says what it does")]

use std::error::Error;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use areoid_cache::flight::{Flight, Key};
use areoid_cache::{Cache, DatasetInfo, Options, Place};
use areoid_formats::catalog::Catalog;
use areoid_formats::units::Degrees;

/// Frames a second, and seconds.
const FRAMES: u32 = 60;
const SECONDS: u32 = 4;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let catalog = arguments.next().ok_or("which catalog?")?;
    let other = arguments.next();

    // Opening reads no page, and could be awaited as well.
    let place = Place::from(catalog.as_str());
    let options = Options::for_place(&place, 256 << 20);
    let cache = Cache::open(place, options).wait()?;
    let ellipsoid = cache.body().ellipsoid;
    let flight = Flight::new(vec![
        Key { seconds: 0.0, eye: [-133.8, 5.0, 3e6], look: [0.0, -90.0] },
        Key { seconds: f64::from(SECONDS), eye: [-133.8, 18.0, 1e5], look: [0.0, -30.0] },
    ])?;

    // One session for each rendering context, used by the thread that draws.
    let mut session = cache.session();
    let start = Instant::now();
    for frame in 0..FRAMES * SECONDS {
        let seconds = f64::from(frame) / f64::from(FRAMES);
        let pose = flight.pose(&ellipsoid, seconds);
        let view = pose.view(Degrees(45.0).into(), [1280, 720], 1.0);

        // Never waits: what is in memory now, and what is missing is on its way.
        let selection = session.update(&view);
        for page in &selection.pages {
            // Here a renderer uploads `page.page` if it does not have it yet, and draws it.
            let _dataset = &selection.datasets[page.dataset];
        }
        if frame.is_multiple_of(FRAMES / 2) {
            let (below, _) = ellipsoid.geographic_from_cartesian(view.eye);
            let height = selection.height(below);
            println!(
                "{seconds:.1} s: {} pages of {} datasets, {} missing, {}",
                selection.pages.len(),
                selection.datasets.len(),
                selection.missing,
                height.map_or_else(
                    || "no height below".to_owned(),
                    |height| format!(
                        "{:.0} m below, give or take {:.0}",
                        height.height_m, height.bound_m
                    ),
                ),
            );
        }
        if frame == FRAMES * SECONDS / 2
            && let Some(other) = &other
        {
            insert_all(&cache, Path::new(other))?;
        }
        let next = Duration::from_secs(1) * (frame + 1) / FRAMES;
        std::thread::sleep(next.saturating_sub(start.elapsed()));
    }
    println!("{:?}", cache.stats());
    Ok(())
}

/// Every session sees them from now on. A catalog's own changes are followed by themselves.
fn insert_all(cache: &Cache, folder: &Path) -> Result<(), Box<dyn Error>> {
    let (catalog, archives) = Catalog::open_with_archives(folder)?;
    let all = catalog.datasets().iter().zip(archives).map(|(record, archive)| {
        let grid = archive.description().grid.clone();
        let (name, group) = (record.name.clone(), record.group.clone());
        let (kind, priority) = (record.kind, record.priority);
        (DatasetInfo { name, group, kind, grid, priority }, Arc::new(archive) as _)
    });
    Ok(cache.insert_all(all)?)
}
