//! Which page goes when there is no room for another: policies on what recorded flights need.
//!
//! What a frame needs does not depend on what is in memory: it is recorded once for each budget, which
//! bounds it, and replayed under every policy.

mod policy;

use std::sync::Arc;
use std::time::Duration;

use areoid_cache::flight::Flight;
use areoid_cache::{Cache, Options};
use serde_json::json;

use self::policy::{
    Clairvoyant, Need, Outcome, Policy, Ranked, S3Fifo, Trace, deepest, oldest, replay, weighted,
};
use super::Setting;
use super::budget::globe;
use super::flights::{flights, leaps, returns};
use super::planet::{Planet, body};
use super::replay::LARGE;
use crate::bench::report::{Chapter, Relation, Table, Target};
use crate::failure::Failure;

const BUDGETS_MIB: [usize; 2] = [64, 256];

/// Flights with leaps and returns, over the others.
const LONGER: f64 = 6.0;

/// Frames are far enough apart for a page to come.
const STEP: usize = 6;

/// The policy of the cache, the others, and the least there can be.
const POLICIES: [&str; 5] = ["LRU", "S3-FIFO", "deepest first", "error-weighted", "clairvoyant"];

/// Another policy is better if it fetches less than this share of what the cache's does, in the
/// mean, and is nowhere worse by as much.
const BETTER: f64 = 0.95;

pub(super) fn measure(setting: Setting) -> Result<Chapter, Failure> {
    let planet = Planet::new("globe", globe()?, Duration::ZERO);
    let mut all: Vec<(&str, Flight)> =
        flights(setting.seconds)?.into_iter().map(|named| (named.name, named.flight)).collect();
    all.push(("leaps", leaps(LONGER * setting.seconds)?));
    all.push(("returns", returns(LONGER * setting.seconds)?));

    let (mut tables, mut data) = (Vec::new(), Vec::new());
    let mut shares: [Vec<f64>; POLICIES.len()] = Default::default();
    for budget_mib in BUDGETS_MIB {
        let mut rows = Vec::new();
        for (name, flight) in &all {
            let budget_bytes = budget_mib << 20;
            let trace = record(&planet, flight, budget_bytes)?;
            let outcomes = under_all(&trace, budget_bytes);
            let first = outcomes[0].fetched - outcomes[0].again;
            let mut row = vec![(*name).to_owned(), first.to_string()];
            for (shares, outcome) in shares.iter_mut().zip(&outcomes) {
                let mib = outcome.again_bytes as f64 / f64::from(1 << 20);
                row.push(format!("{} ({mib:.0})", outcome.again));
                shares.push(outcome.fetched as f64 / outcomes[0].fetched.max(1) as f64);
            }
            rows.push(row);
            let again: Vec<_> = POLICIES
                .iter()
                .zip(&outcomes)
                .map(|(policy, outcome)| json!({ "policy": policy, "fetched_again": outcome.again, "bytes": outcome.again_bytes }))
                .collect();
            data.push(json!({ "budget_mib": budget_mib, "flight": name, "pages": first, "policies": again }));
        }
        let title = format!("Pages fetched again at {budget_mib} MiB (MiB)");
        tables.push(Table {
            title,
            head: [&["flight", "pages"][..], &POLICIES[..]].concat(),
            rows,
        });
    }
    let (means, best) = compared(&shares);
    tables.push(Table {
        title: "Pages fetched over those of LRU, mean and worst".to_owned(),
        head: vec!["policy", "mean", "worst"],
        rows: means,
    });
    Ok(Chapter {
        name: "eviction",
        title: "Which page goes",
        notes: vec![format!(
            "What settled views need, of every {STEP}th frame of the flights, on pages of 512 texels \
             and a screen of 3840 by 2160 pixels at a quarter of a pixel, \
             replayed under each policy; half of the budget is what a view may need. Leaps and returns \
             take {LONGER:.0} times as long as the others. *Clairvoyant* knows what will be needed \
             (Belady 1966): less cannot be fetched. LRU is what the cache does."
        )],
        tables,
        targets: vec![Target::new(
            "pages fetched over those of the cache's policy, mean of the best other that is nowhere \
             worse by 5 %",
            Relation::AtLeast,
            BETTER,
            Some(best),
        )],
        data: json!(data),
    })
}

/// What a view needs, frame by frame.
fn record(planet: &Arc<Planet>, flight: &Flight, budget_bytes: usize) -> Result<Trace, Failure> {
    let source = (planet.info.clone(), Arc::clone(planet) as _);
    let cache = Cache::with_sources(body(), [source], Options::with_budget(budget_bytes))
        .map_err(|error| Failure::Failed(error.into()))?;
    let mut session = cache.session();
    session.look_ahead = false;
    let needs = LARGE.views(flight).step_by(STEP).map(|view| {
        let selection = session.settle(&view);
        let pages = selection.pages.iter().map(|page| Need {
            name: (page.dataset, page.entry.page),
            error_m: f64::from(page.entry.bound),
            bytes: page.page.bytes(),
        });
        pages.collect()
    });
    Ok(needs.collect())
}

fn under_all(trace: &Trace, budget_bytes: usize) -> [Outcome; POLICIES.len()] {
    let policies: [&mut dyn Policy; POLICIES.len()] = [
        &mut Ranked::by(oldest),
        &mut S3Fifo::default(),
        &mut Ranked::by(deepest),
        &mut Ranked::by(weighted),
        &mut Clairvoyant::of(trace),
    ];
    policies.map(|policy| replay(trace, budget_bytes, policy))
}

/// Rows of each policy's mean and worst share; and the least mean of a real one that is nowhere worse
/// by as much as it has to be better, 1 if there is none.
fn compared(shares: &[Vec<f64>; POLICIES.len()]) -> (Vec<Vec<String>>, f64) {
    let (mut rows, mut best) = (Vec::new(), 1.0_f64);
    for (place, (policy, shares)) in POLICIES.iter().zip(shares).enumerate() {
        let mean = shares.iter().sum::<f64>() / shares.len().max(1) as f64;
        let worst = shares.iter().copied().fold(0.0, f64::max);
        rows.push(vec![(*policy).to_owned(), format!("{mean:.3}"), format!("{worst:.3}")]);
        if place + 1 < POLICIES.len() && worst <= 2.0 - BETTER {
            best = best.min(mean);
        }
    }
    (rows, best)
}
