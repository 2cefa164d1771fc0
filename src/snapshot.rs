//! `areoid snapshot`.

use std::io::Cursor;
use std::path::PathBuf;
use std::process::ExitCode;

use areoid_cache::{Selection, View};
use areoid_formats::body::Body;
use areoid_formats::units::{Degrees, Meters};
use areoid_viewer::camera::Pose;
use areoid_viewer::{Aovs, Gpu, Light, Options, Renderer};
use image::{ImageBuffer, ImageFormat, RgbaImage};
use serde_json::json;

use crate::args::{numbers, position};
use crate::failure::Failure;
use crate::place::Source;
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

    /// Size of the picture in pixels.
    #[arg(long, value_name = "WxH", default_value = "1280x720", value_parser = size)]
    size: [u32; 2],

    /// The angle between the lower and the upper edge of the picture.
    #[arg(long, value_name = "DEGREES", default_value_t = 45.0)]
    fov_deg: f64,

    /// How far heights may be off on the screen, and how large the texels of a color may be.
    #[arg(long, value_name = "PIXELS", default_value_t = 1.0)]
    tolerance_px: f64,

    /// Where the sun stands in the zenith, in degrees [default: 45° west and 30° north of the eye].
    #[arg(long, value_name = "LON,LAT", allow_hyphen_values = true, value_parser = numbers::<2>)]
    sun: Option<[f64; 2]>,

    /// Memory for pages, in mebibytes.
    #[arg(long, value_name = "MIB", default_value_t = 1024)]
    memory_mib: usize,

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

/// Pixels of the largest picture: its deferred buffer takes 40 bytes a pixel.
const MOST_PIXELS: u32 = 8192 * 2048;

/// Light from everywhere, so that the night side is not black.
const AMBIENT: f64 = 0.06;

impl Args {
    pub(crate) fn run(self) -> Result<ExitCode, Failure> {
        self.check()?;
        let cache = self.source.open(self.memory_mib)?;
        let view = self.view(cache.body())?;
        let light = self.light()?;

        let gpu = Gpu::headless()?;
        let mut renderer = Renderer::new(&gpu, cache.body().ellipsoid);
        let mut session = cache.session();
        let selection = session.settle(&view);
        for failed in &selection.failed {
            let name = &selection.datasets[failed.dataset].name;
            output::say(format_args!("warning: {name}/{}: {}", failed.page, failed.error));
        }
        let statistics = renderer.render(&view, &selection, &light, &Options::default());

        let picture = renderer.read_color();
        let mut png = Cursor::new(Vec::new());
        let picture: RgbaImage = ImageBuffer::from_raw(picture.width, picture.height, picture.rgba)
            .expect("four samples a pixel");
        picture.write_to(&mut png, ImageFormat::Png)?;
        let mut files = vec![(self.output.clone(), png.into_inner())];
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
        let unmet = selection.tolerance_px > self.tolerance_px || selection.missing > 0;
        if unmet {
            output::say(format_args!(
                "warning: --memory-mib is too little for this view: {} pages are missing, and the \
                 tolerance met is {} pixels",
                selection.missing, selection.tolerance_px
            ));
        }
        let bare = selection.pages.is_empty() && !cache.datasets().is_empty() && unmet;
        let whole = selection.failed.is_empty()
            && cache.problems().is_empty()
            && selection.missing == 0
            && !bare;
        Ok(if whole { ExitCode::SUCCESS } else { ExitCode::FAILURE })
    }

    fn check(&self) -> Result<(), Failure> {
        let misused = |reason: &str| Err(Failure::Misused(reason.to_owned()));
        if !(self.fov_deg > 0.0 && self.fov_deg < 180.0) {
            return misused("--fov-deg must lie between 0 and 180");
        }
        if !(self.tolerance_px > 0.0 && self.tolerance_px.is_finite()) {
            return misused("--tolerance-px must be a positive number");
        }
        if self.memory_mib == 0 {
            return misused("--memory-mib must be at least 1");
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
        Ok(pose.view(Degrees(self.fov_deg).into(), self.size, self.tolerance_px))
    }

    fn light(&self) -> Result<Light, Failure> {
        let [longitude, latitude, _] = self.eye;
        let beside = [longitude - 45.0, (latitude + 30.0).clamp(-90.0, 90.0)];
        let sun = position(self.sun.unwrap_or(beside)).map_err(Failure::Misused)?;
        let toward_sun = areoid_formats::geodesy::surface_normal(sun);
        Ok(Light { toward_sun, ambient: AMBIENT })
    }
}

/// What was selected, for people and scripts.
fn report(selection: &Selection) -> serde_json::Value {
    let bytes: usize = selection.pages.iter().map(|resident| resident.page.bytes()).sum();
    json!({
        "pages": selection.pages.len(),
        "wanted": selection.wanted,
        "missing": selection.missing,
        "failed": selection.failed.len(),
        "bytes": bytes,
        "tolerance_px": selection.tolerance_px,
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

fn size(text: &str) -> Result<[u32; 2], String> {
    let invalid = || {
        format!("{text:?}: expected WIDTHxHEIGHT, each 1 to 8192, and at most {MOST_PIXELS} pixels")
    };
    let (width, height) = text.split_once('x').ok_or_else(invalid)?;
    let side = |text: &str| {
        text.parse::<u32>().ok().filter(|side| (1..=8192).contains(side)).ok_or_else(invalid)
    };
    let size = [side(width)?, side(height)?];
    if size[0] * size[1] > MOST_PIXELS { Err(invalid()) } else { Ok(size) }
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
