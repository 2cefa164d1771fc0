//! What is in memory when a view first needs it, with looking ahead and without.

use std::sync::Arc;
use std::time::Duration;

use areoid_cache::{Cache, Options};
use serde_json::json;

use super::Setting;
use super::flights::flights;
use super::planet::{Planet, body};
use super::replay::{fly, view};
use super::skipping::planets;
use crate::bench::report::{Chapter, Relation, Table, Target};
use crate::failure::Failure;

/// Of a load: a disk that is not in memory.
const DELAY: Duration = Duration::from_millis(5);

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
            session.settle(&view(&named.flight, 0.0));
            let before = cache.stats();
            fly(&named.flight, &mut session, |_, _, _| {});
            let stats = cache.stats();
            let first = stats.first_wanted - before.first_wanted;
            let there = (stats.first_resident - before.first_resident) as f64 / first as f64;
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
                loads.to_string(),
                format!("{:.1} %", 100.0 * share),
            ]);
            data.push(json!({
                "flight": named.name, "ahead": is_ahead, "first_wanted": first,
                "resident": there, "loads": loads, "in_vain": share,
            }));
        }
    }
    let head = vec!["flight", "ahead", "newly needed", "there", "loads", "in vain"];
    Ok(Chapter {
        name: "ahead",
        title: "What is there before it is needed",
        notes: vec![
            "Sixty updates a second in real time over a split globe, loads of 5 ms, four at a time. \
             *There* are pages in memory in the first frame that needs them; *in vain* were pages \
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
