//! What is in memory when a view first needs it, with looking ahead and without.

use std::sync::Arc;
use std::time::{Duration, Instant};

use areoid_cache::{Cache, Options, Stats};
use serde_json::json;

use super::Setting;
use super::flights::flights;
use super::planet::{Planet, body};
use super::replay::{WINDOW, fly};
use super::skipping::planets;
use crate::bench::report::{Chapter, Relation, Table, Target};
use crate::failure::Failure;

/// Of a load: a disk that is not in memory.
const DELAY: Duration = Duration::from_millis(5);

/// How long nothing is known of how a view moves.
const SETTING_OUT: Duration = Duration::from_millis(500);

/// Shares of pages that are there when first needed, and that were fetched in vain.
const LEAST_RESIDENT: f64 = 0.9;
const MOST_VAIN: f64 = 0.25;

pub(super) fn measure(setting: Setting) -> Result<Chapter, Failure> {
    let planets: Vec<Arc<Planet>> = planets(setting)?
        .into_iter()
        .map(|planet| Planet::new(&planet.info.name, planet.info.grid.clone(), DELAY))
        .collect();
    let (mut rows, mut data) = (Vec::new(), Vec::new());
    let (mut resident, mut vain) = (1.0_f64, 0.0_f64);
    for named in flights(setting.seconds)? {
        for is_ahead in [false, true] {
            let sources =
                planets.iter().map(|planet| (planet.info.clone(), Arc::clone(planet) as _));
            let cache = Cache::with_sources(body(), sources, Options::with_budget(1 << 30))
                .map_err(|error| Failure::Failed(error.into()))?;
            let mut session = cache.session();
            session.look_ahead = is_ahead;
            session.settle(&WINDOW.view(&named.flight, 0.0));
            let before = cache.stats();
            let (start, mut early) = (Instant::now(), before);
            fly(&named.flight, WINDOW, &mut session, |_, _, _| {
                if start.elapsed() < SETTING_OUT {
                    early = cache.stats();
                }
            });
            let stats = cache.stats();
            let first = stats.first_wanted - before.first_wanted;
            let there = share_there(&before, &stats);
            let there_later = share_there(&early, &stats);
            let loads = stats.loads - before.loads;
            let unused = stats.ahead - stats.ahead_used;
            let share = unused as f64 / loads.max(1) as f64;
            if is_ahead {
                (resident, vain) = (resident.min(there), vain.max(share));
            }
            rows.push(vec![
                named.name.to_owned(),
                if is_ahead { "yes" } else { "no" }.to_owned(),
                first.to_string(),
                format!("{:.1} %", 100.0 * there),
                format!("{:.1} %", 100.0 * there_later),
                loads.to_string(),
                format!("{:.1} %", 100.0 * share),
            ]);
            data.push(json!({
                "flight": named.name, "ahead": is_ahead, "first_wanted": first,
                "resident": there, "resident_later": there_later, "loads": loads, "in_vain": share,
            }));
        }
    }
    let head = vec!["flight", "ahead", "newly needed", "there", "under way", "loads", "in vain"];
    Ok(Chapter {
        name: "ahead",
        title: "What is there before it is needed",
        notes: vec![
            "Sixty updates a second in real time over a split globe, loads of 5 ms, four at a time. \
             *There* are pages in memory in the first frame that needs them, and, *under way*, those \
             of them that are needed after the first half second, before which no motion is known \
             that could be looked ahead in; *in vain* were pages \
             loaded ahead that no frame needed, over all loads."
                .to_owned(),
        ],
        tables: vec![Table { title: "Looking half a second ahead".to_owned(), head, rows }],
        targets: vec![
            Target::new(
                "pages there when first needed, worst flight",
                Relation::AtLeast,
                LEAST_RESIDENT,
                Some(resident),
            ),
            Target::new(
                "pages fetched in vain, worst flight",
                Relation::AtMost,
                MOST_VAIN,
                Some(vain),
            ),
        ],
        data: json!(data),
    })
}

/// The share of the pages first needed between two moments that were there; all of none.
fn share_there(before: &Stats, after: &Stats) -> f64 {
    match after.first_wanted - before.first_wanted {
        0 => 1.0,
        wanted => (after.first_resident - before.first_resident) as f64 / wanted as f64,
    }
}
