//! A frame while pages are loaded, over one while none is.

use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread;
use std::time::{Duration, Instant};

use areoid_cache::Session;
use areoid_formats::body::Ellipsoid;
use areoid_formats::geodesy::Geographic;
use areoid_formats::units::{Degrees, Meters};
use areoid_viewer::camera::Pose;
use serde_json::json;

use super::Setting;
use super::stage::{Cost, OVER, Stage};
use super::world::{cache, datasets};
use crate::bench::report::{Chapter, Relation, Spread, Table, Target};
use crate::failure::Failure;

/// Far less than all pages, so that every leap loads some.
const BUDGET: usize = 32 << 20;

/// How often the other view leaps at most, and how fine it is.
const LEAP_EVERY: Duration = Duration::from_millis(50);
const LEAP_TOLERANCE_PX: f64 = 0.25;
const LEAP_FROM_M: f64 = 1e5;

/// Times that loads begin and end.
const BLOCKS: u32 = 5;

/// Until loads have begun, or the last of them have ended.
const PAUSE: Duration = Duration::from_millis(100);

const LIMIT: f64 = 1.2;

pub(super) fn measure(setting: &Setting) -> Result<Chapter, Failure> {
    let whole = setting.world.whole()?;
    let cache = cache(datasets(&whole, 1)?, BUDGET)?;
    let ellipsoid = cache.body().ellipsoid;
    let other = cache.session();
    let mut stage = Stage::new(&setting.gpu, cache, setting.size, OVER);
    let (loading, done) = (AtomicBool::new(false), AtomicBool::new(false));
    let each = setting.rounds.div_ceil(BLOCKS);
    let (mut without, mut with, mut loaded) = (Vec::new(), Vec::new(), 0);
    let mut loading_s = 0.0;
    thread::scope(|scope| {
        let named = thread::Builder::new().name("leaps".to_owned());
        let spawned = named.spawn_scoped(scope, || leap(other, &ellipsoid, &loading, &done));
        for block in 0..2 * BLOCKS {
            loading.store(block % 2 == 1, Relaxed);
            thread::sleep(PAUSE);
            let costs: &mut Vec<Cost> = if block % 2 == 1 { &mut with } else { &mut without };
            let before = stage.cache().stats().loads;
            // No view is drawn twice: it would cost nothing.
            costs.extend((0..each).map(|number| stage.frame(1 + each * block + number)));
            if block % 2 == 1 {
                loaded += stage.cache().stats().loads - before;
                loading_s += costs[costs.len() - each as usize..]
                    .iter()
                    .map(|cost| cost.ms / 1e3)
                    .sum::<f64>();
            }
        }
        done.store(true, Relaxed);
        spawned.map(|_| ())
    })?;
    let spread = |costs: &[Cost], figure: fn(&Cost) -> f64| {
        Spread::of(costs.iter().map(figure)).expect("there is a round at least")
    };
    let rate = loaded as f64 / loading_s;
    let row = |name: &str, costs: &[Cost], loads: String| {
        vec![
            name.to_owned(),
            spread(costs, |cost| cost.ms).text(1),
            spread(costs, |cost| cost.cpu_ms).text(2),
            spread(costs, |cost| cost.select_ms).text(3),
            loads,
        ]
    };
    let [with_ms, without_ms] = [&with, &without].map(|costs| spread(costs, |cost| cost.ms));
    let ratio = with_ms.median / without_ms.median;
    Ok(Chapter {
        name: "loads",
        title: "A frame while pages are loaded",
        notes: vec![
            setting.drawn_with(),
            "One view moves by a pixel a frame and has all of its pages. Another of the same cache, \
             on a thread of its own, leaps from place to place, up to twenty times a second, and waits for its pages, \
             which do not fit into the budget together: on and off, five times each. Where the processor draws, \
             loads take it from the picture, too."
                .to_owned(),
        ],
        tables: vec![Table {
            title: "Frames".to_owned(),
            head: vec!["", "ms", "CPU ms", "of that selection", "loads/s"],
            rows: vec![
                row("without", &without, "0".to_owned()),
                row("with", &with, format!("{rate:.0}")),
            ],
        }],
        targets: vec![Target::new(
            "a frame with loads running over one without, medians",
            Relation::AtMost,
            LIMIT,
            Some(ratio),
        )],
        data: json!({
            "with_ms": with_ms, "without_ms": without_ms, "ratio": ratio, "loads_per_s": rate,
            "with_cpu_ms": spread(&with, |cost| cost.cpu_ms),
            "without_cpu_ms": spread(&without, |cost| cost.cpu_ms),
        }),
    })
}

/// Settles at one place after another while it is `loading`, until it is `done`.
fn leap(mut session: Session, ellipsoid: &Ellipsoid, loading: &AtomicBool, done: &AtomicBool) {
    session.look_ahead = false;
    let mut number = 0.0_f64;
    while !done.load(Relaxed) {
        if !loading.load(Relaxed) {
            thread::sleep(Duration::from_millis(1));
            continue;
        }
        let longitude = (137.5 * number).rem_euclid(360.0) - 180.0;
        let latitude = 60.0 * (2.4 * number).sin();
        let place = Geographic::from_degrees(Degrees(longitude), Degrees(latitude));
        let (heading, pitch) = (Degrees(0.0).into(), Degrees(-90.0).into());
        let pose = Pose::from_eye(ellipsoid, place, Meters(LEAP_FROM_M), heading, pitch);
        let begin = Instant::now();
        drop(session.settle(&pose.view(Degrees(45.0).into(), [640, 360], LEAP_TOLERANCE_PX)));
        thread::sleep(LEAP_EVERY.saturating_sub(begin.elapsed()));
        number += 1.0;
    }
}
