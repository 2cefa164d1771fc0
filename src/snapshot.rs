//! `areoid snapshot`.

use std::path::PathBuf;
use std::process::ExitCode;

use areoid_cache::{Selection, View};
use areoid_formats::body::Body;
use areoid_formats::units::{Degrees, Meters};
use areoid_viewer::camera::Pose;
use areoid_viewer::{Aovs, Gpu, Renderer};
use serde_json::json;

use crate::args::{numbers, position};
use crate::failure::Failure;
use crate::place::Source;
use crate::shot::{Shot, png};
use crate::{npy, output};

/// Draw one picture, complete: wait until every page the view needs is there.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    source: Source,

    /// Where the eye is: degrees, and meters above the reference surface.
    #[arg(long, value_name = "LON,LAT,ALT_M", allow_hyphen_values = true, value_parser = numbers::<3>)]
    eye: [f64; 3],

    /// Where the eye looks: degrees clockwise from north and up from the horizon
    /// [default: straight down].
    #[arg(
        long,
        value_name = "HEADING,PITCH",
        allow_hyphen_values = true,
        value_parser = numbers::<2>,
        conflicts_with = "target"
    )]
    look: Option<[f64; 2]>,

    /// What the eye looks at: degrees, and meters above the reference surface [default height: 0].
    #[arg(long, value_name = "LON,LAT[,H_M]", allow_hyphen_values = true, value_parser = target)]
    target: Option<[f64; 3]>,

    #[command(flatten)]
    shot: Shot,

    /// Where to write the picture, a PNG.
    #[arg(short, long, value_name = "F.png")]
    output: PathBuf,

    /// Also write what the pixels show, as NumPy arrays: position (f64 body-fixed meters),
    /// geographic (f64 degrees), height, level, depth (f32). NaN off the planet.
    #[arg(long, value_name = "NAME=F.npy", value_parser = aov)]
    aov: Vec<(Aov, PathBuf)>,

    /// Print what was drawn as JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, clap::ValueEnum)]
enum Aov {
    Position,
    Geographic,
    Height,
    Level,
    Depth,
}

impl Args {
    pub(crate) fn run(self) -> Result<ExitCode, Failure> {
        self.shot.check()?;
        self.check()?;
        let quality = self.shot.quality;
        let cache = self.source.open(quality.memory_mib)?;
        let view = self.view(cache.body())?;
        let [longitude, latitude, _] = self.eye;
        let ellipsoid = &cache.body().ellipsoid;
        let light = self.shot.light(ellipsoid, [longitude, latitude])?;
        let options = self.shot.options(&cache)?;

        let gpu = Gpu::headless()?;
        let mut renderer =
            Renderer::with_budget(&gpu, cache.body().ellipsoid, quality.memory_bytes());
        let mut session = cache.session();
        self.shot.prepare(&mut session, &options);
        let selection = session.settle(&view);
        for failed in &selection.failed {
            let name = &selection.datasets[failed.dataset].name;
            output::say(format_args!("warning: {name}/{}: {}", failed.page, failed.error));
        }
        let statistics = renderer.render(&view, &selection, &light, &options);

        let mut files = vec![(self.output.clone(), png(renderer.read_color())?)];
        if !self.aov.is_empty() {
            let aovs = renderer.read_aovs();
            files.extend(self.aov.iter().map(|(aov, path)| (path.clone(), encode(*aov, &aovs))));
        }
        for (path, bytes) in files {
            output::write_file(&path, &bytes)?;
        }
        if self.json {
            let mut report = report(&selection);
            report["patches"] = json!(statistics.patches);
            report["triangles"] = json!(statistics.triangles);
            report["adapter"] = json!(gpu.description());
            output::json(&report)?;
        }
        let unmet = selection.tolerance_px > quality.tolerance_px || selection.missing > 0;
        if unmet {
            output::say(format_args!(
                "warning: --memory-mib is too little for this view: {} pages are missing, and the \
                 tolerance met is {} pixels",
                selection.missing, selection.tolerance_px
            ));
        }
        if statistics.left_out_pages > 0 {
            output::say(format_args!(
                "warning: {} pages have no room on the GPU; coarser ones stand in",
                statistics.left_out_pages
            ));
        }
        let bare = selection.pages.is_empty() && !cache.datasets().is_empty() && unmet;
        let whole = selection.failed.is_empty()
            && cache.problems().is_empty()
            && (selection.missing, statistics.left_out_pages) == (0, 0)
            && !bare;
        Ok(if whole { ExitCode::SUCCESS } else { ExitCode::FAILURE })
    }

    /// Whether each file is named once, and there is a direction to look in.
    fn check(&self) -> Result<(), Failure> {
        let misused = |reason: String| Err(Failure::Misused(reason));
        let same = |one: &PathBuf, other: &PathBuf| {
            std::path::absolute(one).ok() == std::path::absolute(other).ok()
        };
        let paths = || std::iter::once(&self.output).chain(self.aov.iter().map(|(_, path)| path));
        if let Some(twice) = paths()
            .enumerate()
            .find_map(|(i, path)| paths().take(i).find(|other| same(other, path)))
        {
            return misused(format!("{} is to be written twice", twice.display()));
        }
        if self.look.is_some_and(|[_, pitch]| !(-90.0..=90.0).contains(&pitch)) {
            return misused("--look: the pitch is -90 to 90 degrees".to_owned());
        }
        if self.target.is_some_and(|target| target == self.eye) {
            return misused("--target is where the eye is".to_owned());
        }
        Ok(())
    }

    fn view(&self, body: &Body) -> Result<View, Failure> {
        let [longitude, latitude, altitude] = self.eye;
        let at = position([longitude, latitude]).map_err(Failure::Misused)?;
        let (ellipsoid, altitude) = (&body.ellipsoid, Meters(altitude));
        let pose = if let Some([longitude, latitude, height]) = self.target {
            let target = position([longitude, latitude]).map_err(Failure::Misused)?;
            let target = ellipsoid.cartesian_from_geographic(target, Meters(height));
            Pose::looking_at(ellipsoid, at, altitude, target)
        } else {
            let [heading, pitch] = self.look.unwrap_or([0.0, -90.0]).map(Degrees);
            Pose::from_eye(ellipsoid, at, altitude, heading.into(), pitch.into())
        };
        Ok(self.shot.view(pose))
    }
}

/// What was selected, for people and scripts.
fn report(selection: &Selection) -> serde_json::Value {
    let bytes: usize = selection.pages.iter().map(|resident| resident.page.bytes()).sum();
    json!({
        "pages": selection.pages.len(),
        "beneath": selection.beneath.len(),
        "wanted": selection.wanted,
        "missing": selection.missing,
        "failed": selection.failed.len(),
        "bytes": bytes,
        "tolerance_px": selection.tolerance_px,
        "error_px": selection.error_px,
        "visited": selection.visited,
        "culled": selection.culled,
    })
}

fn encode(aov: Aov, aovs: &Aovs) -> Vec<u8> {
    let (height, width) = (aovs.height as usize, aovs.width as usize);
    match aov {
        Aov::Position => npy::to_bytes(&[height, width, 3], aovs.position.as_flattened()),
        Aov::Geographic => npy::to_bytes(&[height, width, 2], aovs.geographic.as_flattened()),
        Aov::Height => npy::to_bytes(&[height, width], &aovs.height_m),
        Aov::Level => npy::to_bytes(&[height, width], &aovs.level),
        Aov::Depth => npy::to_bytes(&[height, width], &aovs.depth_m),
    }
}

fn target(text: &str) -> Result<[f64; 3], String> {
    match numbers::<3>(text) {
        Ok(target) => Ok(target),
        Err(_) => numbers::<2>(text).map(|[longitude, latitude]| [longitude, latitude, 0.0]),
    }
}

fn aov(text: &str) -> Result<(Aov, PathBuf), String> {
    let (name, path) = text.split_once('=').ok_or("expected NAME=FILE")?;
    let aov = <Aov as clap::ValueEnum>::from_str(name, false)
        .map_err(|_| format!("{name:?}: expected position, geographic, height, level or depth"))?;
    Ok((aov, path.into()))
}
