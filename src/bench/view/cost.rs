//! What a frame costs: over the cheapest picture, over fewer datasets, at a pole over the equator.
//!
//! All that is compared is drawn in turn, round after round, so that what else the machine does
//! meets all alike; ratios are those of a round.

use std::path::Path;

use areoid_viewer::yardstick::Yardstick;
use serde_json::{Value, json};

use super::Setting;
use super::stage::{Cost, OVER, Spot, Stage, trivial};
use super::world::{cache, datasets};
use crate::bench::report::{Chapter, Relation, Spread, Table, Target};
use crate::failure::Failure;

/// Datasets of each kind over one another.
const TIMES: [usize; 4] = [1, 2, 4, 8];

/// Meters from which a pole and the equator are looked at.
const ALTITUDES_M: [f64; 3] = [1e5, 5e5, 2.5e6];

const PLENTY: usize = 2 << 30;

/// Of selection and encoding, at so many patches or more.
const CPU_LIMIT_MS: f64 = 2.0;
const PATCHES: usize = 300;
const POLE_LIMIT: f64 = 1.5;

pub(super) fn measure(setting: &Setting) -> Result<Chapter, Failure> {
    let (gpu, size) = (&setting.gpu, setting.size);
    let whole = setting.world.whole()?;
    let split = setting.world.split()?;
    let stage = |catalog: &Path, times, spot| -> Result<Stage, Failure> {
        Ok(Stage::new(gpu, cache(datasets(catalog, times)?, PLENTY)?, size, spot))
    };
    let many = TIMES.iter().map(|&times| stage(&whole, times, OVER));
    let mut many: Vec<Stage> = many.collect::<Result<_, Failure>>()?;
    let spots = ALTITUDES_M.iter().flat_map(|&altitude_m| {
        [0.0, 90.0].map(|latitude| Spot { position: [20.0, latitude], altitude_m, ..OVER })
    });
    let spots: Vec<Spot> = spots.collect();
    let mut globe = stage(&split, 1, spots[0])?;
    let usual_spot = find_usual(&mut many[0]);

    let yardstick = Yardstick::new(gpu, size);
    trivial(gpu, &yardstick);
    let (mut yard, mut usual) = (Vec::new(), Vec::new());
    let (mut drawn, mut ends) = (vec![Vec::new(); TIMES.len()], vec![Vec::new(); spots.len()]);
    for round in 1..=setting.rounds {
        yard.push(trivial(gpu, &yardstick));
        usual.push(many[0].at(usual_spot, round));
        many[0].turn(OVER);
        for (stage, costs) in many.iter_mut().zip(&mut drawn) {
            costs.push(stage.frame(round));
        }
        for (spot, costs) in spots.iter().zip(&mut ends) {
            costs.push(globe.at(*spot, round));
        }
    }

    let names = TIMES.iter().map(|times| format!("{times} of heights and {times} of colors"));
    let overlaps: Vec<Line> =
        names.zip(&drawn).map(|(name, costs)| Line::new(name, costs, &drawn[0], &yard)).collect();
    let yard = &yard;
    let poles = ALTITUDES_M.iter().zip(ends.chunks(2)).flat_map(|(altitude, pair)| {
        ["equator", "pole"].into_iter().zip(pair).map(move |(place, costs)| {
            let name = format!("{place}, from {:.0} km", altitude / 1e3);
            Line::new(name, costs, &pair[0], yard)
        })
    });
    let poles: Vec<Line> = poles.collect();
    let worst = poles.iter().map(|line| line.over.median).fold(0.0, f64::max);
    let cpu = Cpu::new(&usual);
    let mut notes = vec![setting.drawn_with()];
    notes.push(
        "Everything is in memory, and the eye moves by a pixel a frame. Milliseconds are those of \
         the clock, until the device is done: median (least–greatest). *Over trivial* is over one \
         pass of the same size that computes next to nothing. Datasets that overlap are the same \
         one again, which covers everything. CPU is what the thread that draws runs for selection, \
         geometry and encoding."
            .to_owned(),
    );
    Ok(Chapter {
        name: "cost",
        title: "What a frame costs",
        notes,
        tables: vec![
            table("Datasets over one another", "over one", &overlaps),
            table("A pole over the equator, on a split dataset", "over equator", &poles),
            cpu.table(usual_spot),
        ],
        targets: vec![
            Target::new(
                "a frame at a pole over one at the equator, worst altitude",
                Relation::AtMost,
                POLE_LIMIT,
                Some(worst),
            ),
            Target::new(
                format!("CPU of selection and encoding at {} patches, median ms", cpu.patches),
                Relation::AtMost,
                CPU_LIMIT_MS,
                Some(cpu.all.median),
            ),
        ],
        data: json!({
            "trivial_ms": Spread::of(yard.iter().map(|cost| cost.ms)),
            "overlaps": overlaps.iter().map(Line::json).collect::<Vec<_>>(),
            "poles": poles.iter().map(Line::json).collect::<Vec<_>>(),
            "cpu": { "patches": cpu.patches, "all_ms": cpu.all, "select_ms": cpu.select },
        }),
    })
}

/// Where a stage has [`PATCHES`], or as few more as can be; the most there are, if no place has so many.
fn find_usual(stage: &mut Stage) -> Spot {
    let mut best = ((true, usize::MAX), OVER);
    for altitude_m in [4e6, 3e6, 2e6, 1e6, 5e5, 2e5, 1e5] {
        for pitch in [-90.0, -60.0, -30.0, -15.0] {
            let spot = Spot { altitude_m, look: [0.0, pitch], ..OVER };
            let patches = stage.at(spot, 1).patches;
            let off = (patches < PATCHES, patches.abs_diff(PATCHES));
            if off < best.0 {
                best = (off, spot);
            }
        }
    }
    best.1
}

/// A row of ratios.
struct Line {
    name: String,
    ms: Spread,
    over: Spread,
    over_trivial: Spread,
    patches: usize,
    wanted: usize,
}

impl Line {
    fn new(name: String, costs: &[Cost], least: &[Cost], trivial: &[Cost]) -> Self {
        let over = |others: &[Cost]| {
            let pairs = costs.iter().zip(others);
            spread(pairs.map(|(cost, other)| cost.ms / other.ms))
        };
        let last = costs.last().map_or((0, 0), |cost| (cost.patches, cost.wanted));
        let (patches, wanted) = last;
        let ms = spread(costs.iter().map(|cost| cost.ms));
        Self { name, ms, over: over(least), over_trivial: over(trivial), patches, wanted }
    }

    fn json(&self) -> Value {
        json!({
            "name": self.name, "ms": self.ms, "ratio": self.over,
            "over_trivial": self.over_trivial, "patches": self.patches, "wanted": self.wanted,
        })
    }
}

fn table(title: &str, over: &'static str, lines: &[Line]) -> Table {
    let head = vec!["", "ms", over, "over trivial", "patches", "pages"];
    let rows = lines.iter().map(|line| {
        vec![
            line.name.clone(),
            line.ms.text(1),
            line.over.text(2),
            line.over_trivial.text(1),
            line.patches.to_string(),
            line.wanted.to_string(),
        ]
    });
    Table { title: title.to_owned(), head, rows: rows.collect() }
}

/// What the thread that draws runs.
struct Cpu {
    patches: usize,
    all: Spread,
    select: Spread,
}

impl Cpu {
    fn new(costs: &[Cost]) -> Self {
        let patches: Spread = spread(costs.iter().map(|cost| cost.patches as f64));
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a count")]
        let patches = patches.median as usize;
        let all = spread(costs.iter().map(|cost| cost.cpu_ms));
        Self { patches, all, select: spread(costs.iter().map(|cost| cost.select_ms)) }
    }

    fn table(&self, spot: Spot) -> Table {
        let [_, pitch] = spot.look;
        let row = vec![
            format!("{:.0} km, {pitch}°", spot.altitude_m / 1e3),
            self.patches.to_string(),
            self.all.text(2),
            self.select.text(3),
        ];
        let head = vec!["from", "patches", "CPU ms", "of that selection"];
        Table { title: "The thread that draws".to_owned(), head, rows: vec![row] }
    }
}

fn spread(figures: impl Iterator<Item = f64>) -> Spread {
    Spread::of(figures).expect("there is a round at least")
}
