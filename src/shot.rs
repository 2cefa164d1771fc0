//! How pictures are taken: what `snapshot`, `fly` and `view` share.

use std::io::Cursor;

use areoid_cache::View;
use areoid_formats::geodesy::surface_normal;
use areoid_formats::units::Degrees;
use areoid_viewer::camera::Pose;
use areoid_viewer::{Image, Light};
use image::{ImageBuffer, ImageError, ImageFormat, RgbaImage};

use crate::args::{numbers, position};
use crate::failure::Failure;

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
#[derive(Clone, Copy, Debug, clap::Args)]
pub(crate) struct Shot {
    /// Size of the picture in pixels.
    #[arg(long, value_name = "WxH", default_value = "1280x720", value_parser = size)]
    pub(crate) size: [u32; 2],

    /// The angle between the lower and the upper edge of the picture.
    #[arg(long, value_name = "DEGREES", default_value_t = 45.0)]
    fov_deg: f64,

    #[command(flatten)]
    pub(crate) quality: Quality,

    /// Factor on heights, which multiplies their errors, too.
    #[arg(long, value_name = "FACTOR", allow_hyphen_values = true, default_value_t = 1.0)]
    pub(crate) exaggeration: f64,

    /// Where the sun stands in the zenith, in degrees [default: 45° west and 30° north of the eye,
    /// wherever that is].
    #[arg(long, value_name = "LON,LAT", allow_hyphen_values = true, value_parser = numbers::<2>)]
    sun: Option<[f64; 2]>,
}

/// Pixels of the largest picture: its deferred buffer takes 40 bytes a pixel.
const MOST_PIXELS: u32 = 8192 * 2048;

/// Light from everywhere, so that the night side is not black.
const AMBIENT: f64 = 0.06;

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
        self.quality.check()
    }

    /// What is seen from a pose.
    pub(crate) fn view(&self, pose: Pose) -> View {
        pose.view(Degrees(self.fov_deg).into(), self.size, self.quality.tolerance_px)
    }

    /// The light over an eye above a longitude and a latitude in degrees.
    pub(crate) fn light(&self, [longitude, latitude]: [f64; 2]) -> Result<Light, Failure> {
        let beside = [longitude - 45.0, (latitude + 30.0).clamp(-90.0, 90.0)];
        let sun = position(self.sun.unwrap_or(beside)).map_err(Failure::Misused)?;
        Ok(Light { toward_sun: surface_normal(sun), ambient: AMBIENT })
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

/// WIDTHxHEIGHT.
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
