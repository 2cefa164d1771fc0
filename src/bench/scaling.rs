//! The same terrain at growing sizes: time should grow as the pixels do. And the largest of them with
//! little memory: that should be all it takes.

use std::fs::File;
use std::io;
use std::path::PathBuf;

use serde_json::{Value, json};

use super::ingest::Setting;
use super::pairs::MIB;
use super::rasters::{Look, Recipe};
use super::report::{Chapter, Relation, Spread, Table, Target};
use super::timing::{Contender, Taken};
use crate::output;

/// Megapixels at full size; the last is 43200 by 21600.
const FULL_MEGAPIXELS: [f64; 4] = [50.0, 200.0, 450.0, 933.12];

/// The limit given to one more ingest of the largest, in MiB.
const MEMORY_MIB: u32 = 512;

/// Large maps take long: no more rounds than this.
const MOST_ROUNDS: usize = 5;

/// Small maps are ingested again in a round until they are a share of the largest's pixels: what takes
/// half a second differs from one time to the next by what is to be told.
const SHARE_OF_LARGEST: f64 = 0.2;

/// Processor seconds per pixel may differ so much from those of the smallest map.
const LINEAR_WITHIN: f64 = 0.1;

/// The maps.
pub(super) fn recipes(setting: &Setting) -> Vec<Recipe> {
    let sizes = FULL_MEGAPIXELS.iter();
    sizes.map(|&size| Recipe::tiled(Look::Height, setting.map(size))).collect()
}

/// What was measured of one map.
struct Map {
    recipe: Recipe,
    path: PathBuf,
    /// The limit given to its ingest; the program's own if `None`.
    memory_mib: Option<u32>,
    /// Its runs, round by round.
    rounds: Vec<Vec<Taken>>,
    /// `peak_memory_bytes` as each ingest says it.
    said_peaks: Vec<f64>,
}

/// Measures.
pub(super) fn measure(setting: &Setting) -> io::Result<Chapter> {
    let recipes = recipes(setting).into_iter().map(|recipe| (recipe, None));
    let largest = recipes.clone().next_back().map(|(recipe, _)| (recipe, Some(MEMORY_MIB)));
    let mut maps = Vec::new();
    for (recipe, memory_mib) in recipes.chain(largest) {
        let path = recipe.make(&setting.rasters())?;
        maps.push(Map { recipe, path, memory_mib, rounds: Vec::new(), said_peaks: Vec::new() });
    }
    let largest = maps.iter().map(|map| map.recipe.megapixels()).fold(0.0, f64::max);
    for _ in 0..setting.runs.min(MOST_ROUNDS) {
        for map in &mut maps {
            output::say(format!("running {}", map.recipe.name()));
            let mut round = Vec::new();
            while (round.len() as f64) < SHARE_OF_LARGEST * largest / map.recipe.megapixels() {
                round.push(map.run(setting)?);
            }
            map.rounds.push(round);
        }
    }

    let rows = maps.iter().map(Map::row).collect();
    let smallest = maps.first().expect("there are five maps").costs();
    let free = maps.iter().filter(|map| map.memory_mib.is_none());
    let off = free.map(|map| {
        let costs = map.costs();
        let ratios = costs.iter().zip(&smallest).map(|(cost, smallest)| cost / smallest);
        (Spread::of(ratios).expect("there is at least one round").median - 1.0).abs()
    });
    let off = off.fold(0.0, f64::max);
    let last = maps.last().expect("there are five maps");
    let polled = last.spread(|taken| taken.peak_anonymous_bytes as f64 / MIB).max;
    let told = last.said_peaks.iter().fold(0.0, |most: f64, &peak| most.max(peak)) / MIB;
    let name = format!("{}×{}", last.recipe.width, last.recipe.height);
    let targets = vec![
        Target::new(
            "CPU per pixel: farthest from that of the smallest map",
            Relation::AtMost,
            LINEAR_WITHIN,
            Some(off),
        ),
        Target::new(
            format!("{name}, --memory-mib {MEMORY_MIB}: peak memory in MiB, polled or told"),
            Relation::AtMost,
            MEMORY_MIB.into(),
            Some(polled.max(told)),
        ),
    ];
    let head = vec![
        "map",
        "--memory-mib",
        "Mpx",
        "wall s",
        "CPU s",
        "CPU ms per Mpx",
        "anonymous MiB, polled",
        "as told",
        "resident MiB",
    ];
    Ok(Chapter {
        name: "scaling",
        title: "From small maps to large",
        notes: vec![format!(
            "`areoid ingest` of the same terrain, sizes in turn, each file read once before its run, \
             small ones several times a round; the target is held against ratios within a round. At \
             last the largest with --memory-mib {MEMORY_MIB}, where most of what waits goes to the \
             scratch file. Memory is polled from outside every 5 ms, and as the ingest itself tells \
             it. Median (least–greatest)."
        )],
        tables: vec![Table { title: "Sizes".to_owned(), head, rows }],
        targets,
        data: maps.iter().map(Map::json).collect(),
    })
}

impl Map {
    fn run(&mut self, setting: &Setting) -> io::Result<Taken> {
        io::copy(&mut File::open(&self.path)?, &mut io::sink())?;
        let folder = setting.work().join("scaling");
        let mut ingest = setting.ingest(&self.path, &folder.join("catalog"));
        ingest.args(self.memory_mib.map(|mib| format!("--memory-mib={mib}")));
        let mut contender =
            Contender { name: "areoid ingest".to_owned(), steps: vec![ingest], folder };
        let (taken, said) = contender.run()?.map_err(io::Error::other)?;
        let said: Value = serde_json::from_str(&said)?;
        self.said_peaks.extend(said["peak_memory_bytes"].as_f64());
        Ok(taken)
    }

    /// Processor seconds a megapixel, round by round.
    fn costs(&self) -> Vec<f64> {
        let cost = |runs: &Vec<Taken>| {
            let seconds: f64 = runs.iter().map(|taken| taken.cpu_s).sum();
            seconds / (runs.len() as f64 * self.recipe.megapixels())
        };
        self.rounds.iter().map(cost).collect()
    }

    fn spread(&self, figure: impl Fn(&Taken) -> f64) -> Spread {
        Spread::of(self.rounds.iter().flatten().map(figure)).expect("there is at least one run")
    }

    fn row(&self) -> Vec<String> {
        let megapixels = self.recipe.megapixels();
        let told = Spread::of(self.said_peaks.iter().map(|peak| peak / MIB));
        vec![
            format!("{}×{}", self.recipe.width, self.recipe.height),
            self.memory_mib.map_or_else(|| "default".to_owned(), |mib| mib.to_string()),
            format!("{megapixels:.1}"),
            self.spread(|taken| taken.wall_s).text(2),
            self.spread(|taken| taken.cpu_s).text(2),
            self.spread(|taken| 1e3 * taken.cpu_s / megapixels).text(1),
            self.spread(|taken| taken.peak_anonymous_bytes as f64 / MIB).text(0),
            told.map_or_else(|| "–".to_owned(), |told| told.text(0)),
            self.spread(|taken| taken.peak_resident_bytes as f64 / MIB).text(0),
        ]
    }

    fn json(&self) -> Value {
        json!({
            "raster": self.recipe.name(),
            "width": self.recipe.width,
            "height": self.recipe.height,
            "memory_mib": self.memory_mib,
            "rounds": self.rounds,
            "told_peak_memory_bytes": self.said_peaks,
        })
    }
}
