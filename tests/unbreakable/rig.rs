//! Rasters, catalogs, and the binary run on them.

use areoid_preprocess::resample::kernel::{Kernel, RangeLimit};
use areoid_preprocess::resample::target::TargetMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::LazyLock;
use std::time::Duration;

use areoid_formats::archive::MipRule;
use areoid_formats::catalog::{Catalog, CatalogError, RealDisk};
use areoid_preprocess::build::Proceed;
use areoid_preprocess::ingest::{
    self, Event, Existing, IngestError, Outcome, Reading, Request, TargetGrid, Unfinished,
};
use serde_json::Value;
use tempfile::TempDir;

use crate::support::geotiff::{Samples, Writing};
use crate::support::levels::Edge;
use crate::support::raster::{Place, Random, Raster, pixel_center, planet};

/// The dataset under test, in all catalogs.
pub(crate) const NAME: &str = "subject";

/// Texels along a page's side: small pages make many work units of a small raster.
pub(crate) const PAGE: u32 = 32;

/// The side of a work unit in pixels.
pub(crate) const UNIT: usize = 8 * (PAGE as usize - 2);

/// What is ingested, and how.
#[derive(Clone, Debug)]
pub(crate) struct Subject {
    pub(crate) raster: PathBuf,
    pub(crate) step_m: Option<f64>,
    pub(crate) mip: MipRule,
}

/// Whether this is the long form.
pub(crate) fn soak() -> bool {
    std::env::var_os("AREOID_SOAK").is_some_and(|value| value == "1")
}

/// A globe of `units` work units from pole to pole and twice as many around, with holes of all
/// sizes: single texels, whole pages, whole units.
fn globe(units: usize, mut value: impl FnMut(f64) -> f32) -> Raster {
    let shape = (units * UNIT, 2 * units * UNIT);
    Raster::new(Place::Globe(Edge::PoleOnOutline, Edge::PoleOnOutline), shape, None, |row, col| {
        let (latitude, longitude) = pixel_center((row, col), shape);
        let place = (row / UNIT * 5 + col / UNIT) % 11;
        let in_unit = (row % UNIT).min(col % UNIT);
        let hole = match place {
            // Over a unit's edges, and over the antimeridian where the unit is the first.
            3 => in_unit < 70,
            5 => true,
            8 => row % 61 == 0 && col % 13 == 0,
            _ => false,
        };
        if hole { f32::NAN } else { value(planet(longitude, latitude)) }
    })
}

/// Rasters of heights, of heights to be put on a step, of colors, and of heights whose parents look
/// farther than their children.
pub(crate) struct Subjects {
    _folder: TempDir,
    pub(crate) all: Vec<Subject>,
}

impl Subjects {
    pub(crate) fn new(units: usize) -> Self {
        let folder = TempDir::new().unwrap();
        let mut random = Random(units as u64);
        let heights = globe(units, |height| height as f32 + random.unit() as f32);
        let rough = globe(units, |height| (height / 3.0).round() as f32);
        let mut colors = globe(units, |height| ((height + 6000.0) / 50.0) as f32);
        let red = colors.planes[0].clone();
        colors.planes.push(red.iter().map(|code| (code * 3.0) % 256.0).collect());
        colors.planes.push(red.iter().map(|code| 255.0 - code).collect());
        let write = |raster: &Raster, samples, name: &str| {
            Writing::of(raster, samples).write(raster, folder.path(), name)
        };
        let heights = write(&heights, Samples::Float32, "heights.tif");
        let rough = write(&rough, Samples::Int16(-9999), "rough.tif");
        let colors = write(&colors, Samples::Color, "colors.tif");
        let all = vec![
            Subject::new(heights),
            Subject { step_m: Some(7.5), ..Subject::new(rough.clone()) },
            Subject::new(colors),
            Subject { step_m: Some(1.0), mip: MipRule::Kaiser, ..Subject::new(rough) },
        ];
        Self { _folder: folder, all }
    }
}

/// A globe of a few pages.
pub(crate) struct Tiny {
    _folder: TempDir,
    pub(crate) subject: Subject,
}

impl Tiny {
    /// Tiny ones of the same `name` are the same.
    pub(crate) fn new(name: &str) -> Self {
        let folder = TempDir::new().unwrap();
        let first = usize::from(name.as_bytes()[0]);
        let height = |row: usize, col: usize| (row * 7 + col * name.len() + first) as f32;
        let poles = Place::Globe(Edge::PoleOnOutline, Edge::PoleOnOutline);
        let raster = Raster::new(poles, (60, 120), None, height);
        let writing = Writing::of(&raster, Samples::Float32);
        let raster = writing.write(&raster, folder.path(), &format!("{name}.tif"));
        Self { _folder: folder, subject: Subject::new(raster) }
    }
}

/// Those of a test that needs no more than a few units.
pub(crate) static SMALL: LazyLock<Subjects> = LazyLock::new(|| Subjects::new(2));

impl Subject {
    /// Losslessly, by the mean.
    pub(crate) fn new(raster: PathBuf) -> Self {
        Self { raster, step_m: None, mip: MipRule::Mean }
    }

    /// `areoid ingest` of this into `catalog`.
    pub(crate) fn command(&self, catalog: &Path, options: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_areoid"));
        command.arg("ingest").arg(&self.raster).arg("--catalog").arg(catalog);
        command.arg("--json");
        let (page, step) = (PAGE.to_string(), self.step_m.unwrap_or_default().to_string());
        let mip = self.mip.name();
        for (option, value) in
            [("--page-size", &*page), ("--name", NAME), ("--step-m", &step), ("--mip", mip)]
        {
            if !options.contains(&option) {
                command.args([option, value]);
            }
        }
        command.args(options).stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    /// The same, which must succeed, and what it prints.
    pub(crate) fn ingest(&self, catalog: &Path, options: &[&str]) -> Value {
        let output = self.command(catalog, options).output().unwrap();
        serde_json::from_slice(stdout(&output)).unwrap()
    }

    /// The archive that an undisturbed ingest makes.
    pub(crate) fn undisturbed(&self) -> Vec<u8> {
        let home = TempDir::new().unwrap();
        self.ingest(home.path(), &[]);
        archive(home.path())
    }

    pub(crate) fn request(&self, catalog: &Path) -> Request {
        Request {
            rasters: vec![self.raster.clone()],
            catalog: catalog.to_owned(),
            name: Some(NAME.to_owned()),
            kind: None,
            step_m: self.step_m,
            grid: TargetGrid::One(TargetMap::Native),
            pixel_size: None,
            kernel: Kernel::QuinticSpline,
            limit: RangeLimit::None,
            mip: self.mip,
            page_side: PAGE,
            priority: 0,
            threads: Some(2),
            existing: Existing::Keep,
            unfinished: Unfinished::Resume,
            memory_bytes: 0,
            note_every: Duration::from_secs(3600),
            reading: Reading::default(),
        }
    }

    /// Builds in this process up to `units`, the last note `noted` units in.
    pub(crate) fn half_build(&self, catalog: &Path, noted: usize, units: usize) {
        let request = self.request(catalog);
        if noted > 0 {
            let stop = |event: Event| match event {
                Event::Building(progress) if progress.units_done == noted => Proceed::No,
                _ => Proceed::Yes,
            };
            let stopped = unless_busy(|| ingest::ingest(&RealDisk, &request, stop)).unwrap_err();
            assert!(stopped.can_be_resumed(), "{stopped}");
        }
        // A note is written whenever a build stops; one that is killed writes none.
        let kill = |event: Event| match event {
            Event::Building(progress) if progress.units_done >= units => {
                std::panic::resume_unwind(Box::new("killed"))
            }
            _ => Proceed::Yes,
        };
        let die = std::panic::AssertUnwindSafe(|| {
            unless_busy(|| ingest::ingest(&RealDisk, &request, kill))
        });
        assert!(std::panic::catch_unwind(die).is_err());
    }

    /// Goes on in this process, to the end; also tells how many leaves were read for it.
    pub(crate) fn resume(&self, catalog: &Path) -> (Outcome, u64) {
        let mut leaves = 0;
        let mut count = |event: Event| {
            if let Event::Building(progress) = event {
                leaves = progress.leaves;
            }
            Proceed::Yes
        };
        let ingest = || ingest::ingest(&RealDisk, &self.request(catalog), &mut count);
        (unless_busy(ingest).unwrap(), leaves)
    }
}

/// What comes of an ingest once nobody else has its build: a child of another test holds this process's locks
/// until it is another program.
fn unless_busy(
    mut ingest: impl FnMut() -> Result<Outcome, IngestError>,
) -> Result<Outcome, IngestError> {
    loop {
        match ingest() {
            Err(IngestError::Catalog(error)) if matches!(*error, CatalogError::Busy { .. }) => {
                std::thread::yield_now();
            }
            outcome => return outcome,
        }
    }
}

/// What a run printed that succeeded.
pub(crate) fn stdout(output: &Output) -> &[u8] {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    &output.stdout
}

/// Runs `areoid` on a catalog, which must succeed.
pub(crate) fn run(command: &str, catalog: &Path) -> Value {
    let output = Command::new(env!("CARGO_BIN_EXE_areoid"))
        .args([command, catalog.to_str().unwrap(), "--json"])
        .output()
        .unwrap();
    serde_json::from_slice(stdout(&output)).unwrap()
}

/// The bytes of the archive of the dataset under test.
pub(crate) fn archive(catalog: &Path) -> Vec<u8> {
    let opened = Catalog::open(catalog).unwrap();
    fs::read(opened.archive_path(opened.dataset(NAME).unwrap())).unwrap()
}

/// The names of the datasets as `areoid info` lists them.
pub(crate) fn listed(catalog: &Path) -> Vec<String> {
    let info = run("info", catalog);
    let datasets = info["datasets"].as_array().unwrap().iter();
    datasets.map(|dataset| dataset["name"].as_str().unwrap().to_owned()).collect()
}

/// Exit 1, and one `error:` line with its causes; before it warnings and progress, behind it, at most,
/// how to go on.
pub(crate) fn assert_told(output: &Output) -> String {
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert!(output.stdout.is_empty(), "{stderr}");
    let mut lines = stderr.lines().skip_while(|line| !line.starts_with("error: "));
    assert!(lines.next().is_some(), "{stderr}");
    let mut lines = lines.skip_while(|line| line.starts_with("  caused by: "));
    assert!(lines.next().is_none_or(|line| line.starts_with("to go on: ")), "{stderr}");
    assert!(lines.next().is_none(), "{stderr}");
    stderr
}

/// The names in a folder.
pub(crate) fn names_in(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// Copies a catalog, unfinished builds included.
pub(crate) fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for name in names_in(from) {
        let (from, to) = (from.join(&name), to.join(&name));
        if from.is_dir() { copy(&from, &to) } else { fs::copy(&from, &to).map(drop).unwrap() }
    }
}

/// Checks that a catalog has an archive of exactly `bytes` for the dataset under test, that it
/// keeps all laws, and that nothing is left of any build.
pub(crate) fn assert_whole(catalog: &Path, bytes: &[u8], what: &str) {
    assert!(archive(catalog) == bytes, "{what}: the archive differs");
    assert_eq!(names_in(&catalog.join("build")), [] as [&str; 0], "{what}");
    let opened = Catalog::open(catalog).unwrap();
    let archives = names_in(&catalog.join("archives"));
    assert_eq!(archives.len(), opened.datasets().len(), "{what}: {archives:?}");
    let manifest = format!("manifest.{}", opened.generation());
    let names = names_in(catalog);
    assert_eq!(names, ["archives", "build", "catalog.lock", &manifest], "{what}");
}
