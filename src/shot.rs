//! How pictures are taken: what `snapshot`, `fly` and `view` share.

use std::io::{self, Cursor};
use std::path::{Path, PathBuf};

use areoid_cache::{Cache, Session, View};
use areoid_formats::body::Ellipsoid;
use areoid_formats::geodesy::surface_normal;
use areoid_formats::units::Degrees;
use areoid_viewer::camera::Pose;
use areoid_viewer::sun::{days_of_utc, subsolar};
use areoid_viewer::{Atmosphere, Image, Light, Options, Relief, Style};
use image::{ImageBuffer, ImageError, ImageFormat, RgbaImage};

use crate::args::{numbers, position};
use crate::failure::{Failure, in_full};
use crate::output;

/// How good a picture has to be, and what that may take.
#[derive(Clone, Copy, Debug, clap::Args)]
pub(crate) struct Quality {
    /// How far heights may be off on the screen, and how large the texels of a color may be.
    #[arg(long, value_name = "PIXELS", default_value_t = 1.0)]
    pub(crate) tolerance_px: f64,

    /// Memory for pages, in mebibytes.
    #[arg(long, value_name = "MIB", default_value_t = 1024)]
    pub(crate) memory_mib: usize,
}

/// A camera without its place.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Shot {
    /// Size of the picture in pixels.
    #[arg(long, value_name = "WxH", default_value = "1280x720", value_parser = size)]
    pub(crate) size: [u32; 2],

    /// The angle between the lower and the upper edge of the picture.
    #[arg(long, value_name = "DEGREES", default_value_t = 45.0)]
    fov_deg: f64,

    #[command(flatten)]
    pub(crate) quality: Quality,

    /// Factor on heights, whose errors stay within the tolerance.
    #[arg(long, value_name = "FACTOR", allow_hyphen_values = true, default_value_t = 1.0)]
    pub(crate) exaggeration: f64,

    /// Where the sun stands in the zenith, in degrees [default: 45° west and 30° north of the eye,
    /// wherever that is].
    #[arg(long, value_name = "LON,LAT", allow_hyphen_values = true, value_parser = numbers::<2>)]
    sun: Option<[f64; 2]>,

    /// Put the sun where it stood over the Earth or Mars at a time in UTC.
    #[arg(long, value_name = "YYYY-MM-DD[THH:MM:SS]", value_parser = days, conflicts_with = "sun")]
    date: Option<f64>,

    /// The same light everywhere, as on maps: from an azimuth and an elevation in degrees [default: 315,45].
    #[arg(
        long,
        value_name = "AZIMUTH,ELEVATION",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "315,45",
        allow_hyphen_values = true,
        value_parser = numbers::<2>,
        conflicts_with_all = ["sun", "date"],
    )]
    relief: Option<[f64; 2]>,

    /// Show the air of the Earth or Mars.
    #[arg(long)]
    atmosphere: bool,

    /// Factor on light.
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    exposure: f64,

    /// How datasets take part: weights, order, luminance, colors by height, as the README has it.
    #[arg(long, value_name = "F.json")]
    style: Option<PathBuf>,
}

/// Pixels of the largest picture: its buffers take 32 bytes a pixel.
const MOST_PIXELS: u32 = 8192 * 2048;

impl Quality {
    pub(crate) fn check(&self) -> Result<(), Failure> {
        if !(self.tolerance_px > 0.0 && self.tolerance_px.is_finite()) {
            return misused("--tolerance-px must be a positive number");
        }
        if self.memory_mib == 0 {
            return misused("--memory-mib must be at least 1");
        }
        Ok(())
    }

    pub(crate) fn memory_bytes(&self) -> u64 {
        (self.memory_mib as u64).saturating_mul(1 << 20)
    }
}

impl Shot {
    pub(crate) fn check(&self) -> Result<(), Failure> {
        if !(self.fov_deg > 0.0 && self.fov_deg < 180.0) {
            return misused("--fov-deg must lie between 0 and 180");
        }
        if !(0.0..=1000.0).contains(&self.exaggeration) {
            return misused("--exaggeration must lie between 0 and 1000");
        }
        if let Some(sun) = self.sun {
            position(sun).map_err(Failure::Misused)?;
        }
        if self.relief.is_some_and(|[_, elevation]| !(-90.0..=90.0).contains(&elevation)) {
            return misused("--relief: the elevation is -90 to 90 degrees");
        }
        if !(1e-3..=1e3).contains(&self.exposure) {
            return misused("--exposure must lie between 0.001 and 1000");
        }
        self.quality.check()
    }

    /// How pictures of a cache are drawn.
    pub(crate) fn options(&self, cache: &Cache) -> Result<Options, Failure> {
        let body = &cache.body().ellipsoid;
        let known = |what: &str| {
            Failure::Misused(format!(
                "{what} is for the Earth and Mars: the catalog shows another body"
            ))
        };
        let atmosphere = if self.atmosphere {
            Some(Atmosphere::of(body).ok_or_else(|| known("--atmosphere"))?)
        } else {
            None
        };
        if self.date.is_some() && subsolar(body, 0.0).is_none() {
            return Err(known("--date"));
        }
        Ok(Options {
            vertical_exaggeration: self.exaggeration,
            style: read_style(self.style.as_deref(), cache)?,
            atmosphere,
            relief: self.relief.map(Relief::from_degrees),
            exposure: self.exposure,
            ..Options::default()
        })
    }

    /// What a session has to know of the pictures: nothing is loaded of what a style leaves out.
    pub(crate) fn prepare(&self, session: &mut Session, options: &Options) {
        session.blends = true;
        session.exaggerate(options.vertical_exaggeration);
        if self.style.is_some() {
            let style = options.style.clone();
            session.hide(move |info| style.hides(&info.name));
        }
    }

    /// What is seen from a pose.
    pub(crate) fn view(&self, pose: Pose) -> View {
        pose.view(Degrees(self.fov_deg).into(), self.size, self.quality.tolerance_px)
    }

    /// The light over an eye above a longitude and a latitude in degrees.
    pub(crate) fn light(
        &self,
        body: &Ellipsoid,
        [longitude, latitude]: [f64; 2],
    ) -> Result<Light, Failure> {
        let beside = [longitude - 45.0, (latitude + 30.0).clamp(-90.0, 90.0)];
        let dated = self.date.and_then(|days| subsolar(body, days));
        let sun = match dated {
            Some(sun) => sun,
            None => position(self.sun.unwrap_or(beside)).map_err(Failure::Misused)?,
        };
        Ok(Light { toward_sun: surface_normal(sun), ambient: Light::AMBIENT })
    }
}

/// A picture as the bytes of a PNG.
pub(crate) fn png(picture: Image) -> Result<Vec<u8>, ImageError> {
    let mut bytes = Cursor::new(Vec::new());
    let picture: RgbaImage = ImageBuffer::from_raw(picture.width, picture.height, picture.rgba)
        .expect("four samples a pixel");
    picture.write_to(&mut bytes, ImageFormat::Png)?;
    Ok(bytes.into_inner())
}

/// The style in a file, if there is one, for a cache's datasets.
pub(crate) fn read_style(path: Option<&Path>, cache: &Cache) -> Result<Style, Failure> {
    let Some(path) = path else { return Ok(Style::default()) };
    let shown = path.display();
    let text = std::fs::read_to_string(path).map_err(|source| {
        io::Error::new(source.kind(), format!("cannot read the style {shown}: {source}"))
    })?;
    let style = Style::from_json(&text)
        .map_err(|error| io::Error::other(format!("{shown}: {}", in_full(&error))))?;
    let datasets = cache.datasets();
    for name in style.unknown(&datasets) {
        output::say(format_args!("warning: {shown} names {name:?}, which is no dataset here"));
    }
    for name in style.idle_ramps(&datasets) {
        output::say(format_args!("warning: {shown} has a ramp for {name:?}, which has no heights"));
    }
    Ok(style)
}

fn days(text: &str) -> Result<f64, String> {
    days_of_utc(text).ok_or_else(|| format!("{text:?}: expected a date in UTC"))
}

/// `WIDTHxHEIGHT`.
pub(crate) fn size(text: &str) -> Result<[u32; 2], String> {
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

fn misused(reason: &str) -> Result<(), Failure> {
    Err(Failure::Misused(reason.to_owned()))
}
