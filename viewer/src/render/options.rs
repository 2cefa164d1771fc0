//! What a frame is drawn with, and what comes of it.

use areoid_formats::units::{Degrees, Radians};
use glam::DVec3;

use crate::atmosphere::Atmosphere;
use crate::style::Style;

/// Where light comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// Toward the sun, body-fixed, of any length but 0.
    pub toward_sun: DVec3,
    /// Share of light that comes from everywhere, 0 to 1.
    pub ambient: f64,
}

impl Light {
    /// A share of light from everywhere with which the night side is not black.
    pub const AMBIENT: f64 = 0.06;
}

/// How to draw.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Factor on heights: 1 is true to scale.
    pub vertical_exaggeration: f64,
    /// sRGB codes where no planet is.
    pub background: [u8; 3],
    /// Bytes of pages that one frame may write to the GPU.
    pub upload_limit_bytes: u64,
    /// How long one frame may write to the GPU: a page that has begun is written whole.
    pub upload_limit_seconds: f64,
    /// Samples of color along a pixel's footprint at most, up to 16; where it is longer they are blurred.
    /// At 0 footprints are taken as round and as wide as the pixel, and alias.
    pub anisotropy: u32,
    /// How the datasets take part.
    pub style: Style,
    /// The air, if it shows.
    pub atmosphere: Option<Atmosphere>,
    /// Light from one direction of the map everywhere, instead of the sun's.
    pub relief: Option<Relief>,
    /// Factor on light.
    pub exposure: f64,
    /// What is shown of how it was made.
    pub debug: Debug,
    /// The time of the frame, since any moment.
    pub seconds: f64,
    /// How long a page that has come takes to show wholly; at 0 it does at once.
    pub fade_seconds: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            vertical_exaggeration: 1.0,
            background: [0; 3],
            upload_limit_bytes: u64::MAX,
            upload_limit_seconds: f64::INFINITY,
            anisotropy: 8,
            style: Style::default(),
            atmosphere: None,
            relief: None,
            exposure: 1.0,
            debug: Debug::Off,
            seconds: 0.0,
            fade_seconds: 0.0,
        }
    }
}

/// What the picture shows instead of the ground's colors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Debug {
    /// Nothing else.
    #[default]
    Off,
    /// A color for each level of detail.
    Level,
    /// A color for each dataset.
    Dataset,
    /// The outlines of pages.
    Borders,
    /// Red where a coarser page stands in, blue where a finer one does.
    Residency,
    /// How far heights may be off, over the tolerance: green to yellow below it, red above.
    Error,
}

/// The light of shaded relief: on maps from the northwest, halfway up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Relief {
    /// Where it comes from, clockwise from north.
    pub azimuth: Radians,
    /// Above the horizon.
    pub elevation: Radians,
}

impl Relief {
    /// From an azimuth and an elevation.
    #[must_use]
    pub fn from_degrees([azimuth, elevation]: [f64; 2]) -> Self {
        Self { azimuth: Degrees(azimuth).into(), elevation: Degrees(elevation).into() }
    }
}

impl Default for Relief {
    fn default() -> Self {
        Self::from_degrees([315.0, 45.0])
    }
}

impl Options {
    /// As a window draws: an upload is no longer than a frame can bear, and what comes fades in.
    #[must_use]
    pub fn interactive() -> Self {
        Self {
            upload_limit_bytes: 16 << 20,
            upload_limit_seconds: 0.004,
            fade_seconds: 0.25,
            ..Self::default()
        }
    }
}

/// A picture: four bytes a pixel, red first, row by row from the top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// sRGB codes and an alpha of 255.
    pub rgba: Vec<u8>,
}

impl Image {
    /// Pictures from left to right; it is as high as the lowest of them.
    pub(crate) fn side_by_side(pictures: &[Self]) -> Self {
        let height = pictures.iter().map(|picture| picture.height).min().unwrap_or(0);
        let row = |picture: &Self, row: u32| {
            let bytes = 4 * picture.width as usize;
            let start = row as usize * bytes;
            start..start + bytes
        };
        let rows = (0..height).flat_map(|at| {
            pictures.iter().flat_map(move |picture| &picture.rgba[row(picture, at)])
        });
        let width = pictures.iter().map(|picture| picture.width).sum();
        Self { width, height, rgba: rows.copied().collect() }
    }
}

/// What a frame cost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameStatistics {
    /// Patches drawn.
    pub patches: usize,
    /// Triangles drawn.
    pub triangles: usize,
    /// Pages written to the GPU.
    pub uploaded_pages: usize,
    /// Bytes of their texels.
    pub uploaded_bytes: u64,
    /// Pages put off to the next frame: draw again.
    pub pending_pages: usize,
    /// Pages that do not show wholly yet: draw again.
    pub coming_pages: usize,
    /// Whether nothing was drawn, because the picture is that of the frame before.
    pub is_same: bool,
    /// Pages for which the atlas has no room.
    pub left_out_pages: usize,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_stand_side_by_side_row_by_row() {
        let of = |width: u32, codes: &[u8]| {
            let rgba: Vec<u8> = codes.iter().flat_map(|&code| [code; 4]).collect();
            Image { width, height: u32::try_from(codes.len()).unwrap() / width, rgba }
        };
        let (left, right) = (of(2, &[1, 2, 5, 6]), of(1, &[3, 7, 9]));
        assert_eq!(Image::side_by_side(&[left.clone(), right]), of(3, &[1, 2, 3, 5, 6, 7]));
        assert_eq!(Image::side_by_side(std::slice::from_ref(&left)), left);
    }
}
