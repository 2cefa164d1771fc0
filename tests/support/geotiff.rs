//! Rasters as files.

use std::fs::File;
use std::path::{Path, PathBuf};

use areoid_formats::grid::Outline;
use tiff::encoder::colortype::{ColorType, Gray32Float, GrayI16, RGBA8};
use tiff::encoder::{TiffEncoder, TiffValue};
use tiff::tags::Tag;

use super::raster::Raster;

/// What a file says that its samples do not.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Writing {
    /// Where the outer corner of the first pixel is, and how large pixels are.
    pub(crate) outline: Outline,
    /// EPSG code of a projected system; geographic WGS84 if `None`.
    pub(crate) projected: Option<u16>,
    /// Whether the file gives the centers of its pixels (`PixelIsPoint`) rather than corners.
    pub(crate) points: bool,
    /// Whether the first column is written once more behind the last.
    pub(crate) closed: bool,
    pub(crate) samples: Samples,
}

/// How samples are written.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Samples {
    /// Missing ones as this value, which the file declares.
    Int16(i16),
    /// Missing ones as NaN, which the file declares or not.
    Float32,
    /// Missing ones as this value, which the file declares.
    Float32With(f32),
    /// Codes of red, green and blue; missing ones without alpha.
    #[allow(dead_code, reason = "only the laws look at colors")]
    Color,
}

impl Writing {
    /// The customary file of a made-up raster.
    pub(crate) fn of(raster: &Raster, samples: Samples) -> Self {
        let outline = raster.outline;
        Self { outline, projected: None, points: false, closed: false, samples }
    }

    /// Writes `raster` to `folder/name`.
    pub(crate) fn write(&self, raster: &Raster, folder: &Path, name: &str) -> PathBuf {
        let path = folder.join(name);
        let width = raster.shape.width;
        let columns = if self.closed { width + 1 } else { width };
        let plane = &raster.planes[0];
        let heights: Vec<f32> = (0..raster.shape.height)
            .flat_map(|row| (0..columns).map(move |col| plane[row * width + col % width]))
            .collect();
        let size = (columns, raster.shape.height);
        match self.samples {
            Samples::Int16(missing) => {
                let code = |height: f32| if height.is_nan() { missing } else { height as i16 };
                let codes: Vec<i16> = heights.into_iter().map(code).collect();
                self.encode::<GrayI16>(&path, size, &codes, Some(missing.to_string()));
            }
            Samples::Float32 => self.encode::<Gray32Float>(&path, size, &heights, None),
            Samples::Float32With(missing) => {
                let code = |height: f32| if height.is_nan() { missing } else { height };
                let codes: Vec<f32> = heights.into_iter().map(code).collect();
                self.encode::<Gray32Float>(&path, size, &codes, Some(missing.to_string()));
            }
            Samples::Color => {
                let codes: Vec<u8> = (0..raster.shape.height * width)
                    .flat_map(|at| {
                        let [red, green, blue] =
                            [0, 1, 2].map(|channel| raster.planes[channel][at]);
                        let alpha = if red.is_nan() { 0 } else { 255 };
                        [red as u8, green as u8, blue as u8, alpha]
                    })
                    .collect();
                self.encode::<RGBA8>(&path, (width, raster.shape.height), &codes, None);
            }
        }
        path
    }

    fn encode<C: ColorType>(
        &self,
        path: &Path,
        (width, height): (usize, usize),
        samples: &[C::Inner],
        missing: Option<String>,
    ) where
        [C::Inner]: TiffValue,
    {
        let Outline { origin: [left, top], pixel_size: [pixel_x, pixel_y], .. } = self.outline;
        let corner = if self.points { 0.5 } else { 0.0 };
        let place = [0.0, 0.0, 0.0, left + corner * pixel_x, top - corner * pixel_y, 0.0];
        let registration = if self.points { 2 } else { 1 };
        let (model, key, code) = match self.projected {
            Some(code) => (1, 3072, code),
            None => (2, 2048, 4326),
        };
        let keys: [u16; 16] =
            [1, 1, 0, 3, 1024, 0, 1, model, 1025, 0, 1, registration, key, 0, 1, code];

        let mut encoder = TiffEncoder::new(File::create(path).unwrap()).unwrap();
        let (width, height) = (u32::try_from(width).unwrap(), u32::try_from(height).unwrap());
        let mut image = encoder.new_image::<C>(width, height).unwrap();
        let tags = image.encoder();
        tags.write_tag(Tag::ModelPixelScaleTag, &[pixel_x, pixel_y, 0.0][..]).unwrap();
        tags.write_tag(Tag::ModelTiepointTag, &place[..]).unwrap();
        tags.write_tag(Tag::GeoKeyDirectoryTag, &keys[..]).unwrap();
        if let Some(missing) = missing {
            tags.write_tag(Tag::GdalNodata, missing.as_str()).unwrap();
        }
        // Several strips, and the last of another height.
        image.rows_per_strip(50).unwrap();
        image.write_data(samples).unwrap();
    }
}
