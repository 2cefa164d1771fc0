//! JPEG and PNG, placed by a world file or by the caller.
//!
//! These formats cannot be read in pieces: the first block asked for decodes the whole image, which
//! then stays for as long as the raster does. Memory: width × height × samples, once; up to
//! [`GREATEST_BYTES`].

use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use std::sync::{Mutex, OnceLock, PoisonError};

use image::{ColorType, DynamicImage, ImageDecoder, ImageError, ImageReader, Limits};

use super::error::RasterError;
use super::file::{PositionedFile, Witness};
use super::georeference;
use super::outline::Rows;
use super::samples::{SampleType, Samples};
use super::{Block, Raster, RasterInfo, ReadOptions};

/// Images whose samples take more bytes are refused.
const GREATEST_BYTES: u64 = 8 << 30;

/// Rows of a block.
const BLOCK_ROWS: u32 = 64;

/// An open JPEG or PNG.
#[derive(Debug)]
pub(super) struct ImageRaster {
    /// Open for as long as the raster is, so that a file of the same name is known for another.
    file: PositionedFile,
    info: RasterInfo,
    rows: Rows,
    /// Files that say where it lies.
    beside: Vec<Witness>,
    decoded: OnceLock<Samples>,
    /// Held by the thread that decodes.
    decoding: Mutex<()>,
}

impl ImageRaster {
    pub(super) fn open(file: PositionedFile, options: &ReadOptions) -> Result<Self, RasterError> {
        let path = file.path();
        let decoder =
            reader(path)?.into_decoder().map_err(|error| image_error(path, "header", error))?;
        let size = decoder.dimensions();
        let color = decoder.color_type();
        let (bands, has_alpha, sample) = match color {
            ColorType::L8 => (1, false, SampleType::U8),
            ColorType::La8 => (1, true, SampleType::U8),
            ColorType::Rgb8 => (3, false, SampleType::U8),
            ColorType::Rgba8 => (3, true, SampleType::U8),
            ColorType::L16 => (1, false, SampleType::U16),
            ColorType::La16 => (1, true, SampleType::U16),
            ColorType::Rgb16 => (3, false, SampleType::U16),
            ColorType::Rgba16 => (3, true, SampleType::U16),
            other => {
                let supported = "gray or RGB of 8 or 16 bits, with or without alpha";
                return Err(RasterError::not_supported(path, format!("{other:?}"), supported));
            }
        };
        let bytes = decoder.total_bytes();
        if size.0 == 0 || size.1 == 0 || bytes > GREATEST_BYTES {
            return Err(RasterError::not_supported(
                path,
                format!("an image of {} × {} ({bytes} bytes)", size.0, size.1),
                format!("images of 1 × 1 to {GREATEST_BYTES} bytes"),
            ));
        }
        let placed = georeference::place(path, size, options, None, || Ok(None))?;
        let info = RasterInfo {
            path: path.to_owned(),
            width: size.0,
            height: size.1,
            bands,
            has_alpha,
            sample,
            crs: placed.crs,
            outline: placed.outline,
            point_registered: false,
            nodata: options.nodata,
            scale: 1.0,
            offset: 0.0,
            block_width: size.0,
            block_height: BLOCK_ROWS.min(size.1),
        };
        let (decoded, decoding) = (OnceLock::new(), Mutex::new(()));
        Ok(Self { info, rows: placed.rows, beside: placed.beside, decoded, decoding, file })
    }

    /// The whole image, decoded by the first who asks.
    fn decoded(&self) -> Result<&Samples, RasterError> {
        let _one_at_a_time = self.decoding.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(samples) = self.decoded.get() {
            return Ok(samples);
        }
        let samples = self.decode()?;
        Ok(self.decoded.get_or_init(|| samples))
    }

    fn decode(&self) -> Result<Samples, RasterError> {
        let path = &self.info.path;
        let image = reader(path)?.decode().map_err(|error| image_error(path, "image", error))?;
        let size = (image.width(), image.height());
        let samples = match image {
            DynamicImage::ImageLuma8(image) => Samples::U8(image.into_raw()),
            DynamicImage::ImageLumaA8(image) => Samples::U8(image.into_raw()),
            DynamicImage::ImageRgb8(image) => Samples::U8(image.into_raw()),
            DynamicImage::ImageRgba8(image) => Samples::U8(image.into_raw()),
            DynamicImage::ImageLuma16(image) => Samples::U16(image.into_raw()),
            DynamicImage::ImageLumaA16(image) => Samples::U16(image.into_raw()),
            DynamicImage::ImageRgb16(image) => Samples::U16(image.into_raw()),
            DynamicImage::ImageRgba16(image) => Samples::U16(image.into_raw()),
            other => {
                let found = format!("{:?}", other.color());
                return Err(RasterError::not_supported(path, found, "integer samples"));
            }
        };
        let expected =
            self.info.width as usize * self.info.height as usize * self.info.samples_per_pixel();
        if size != (self.info.width, self.info.height)
            || samples.len() != expected
            || samples.sample_type() != self.info.sample
        {
            return Err(damaged(path, "image", "it changed since it was opened"));
        }
        Ok(samples)
    }
}

impl Raster for ImageRaster {
    fn info(&self) -> &RasterInfo {
        &self.info
    }

    fn read_block(&self, block_col: u32, block_row: u32) -> Result<Block, RasterError> {
        let window = self.info.block_window(block_col, block_row);
        let [col, row, width, height] = window.expect("callers ask for blocks that exist");
        let row_len = width as usize * self.info.samples_per_pixel();
        let first = match self.rows {
            Rows::Down => row,
            Rows::Up => self.info.height - row - height,
        };
        let range = first as usize * row_len..(first + height) as usize * row_len;
        let rows = self.rows;
        let samples = match self.decoded()? {
            Samples::U8(values) => Samples::U8(cut(&values[range], row_len, rows)),
            Samples::U16(values) => Samples::U16(cut(&values[range], row_len, rows)),
            _ => unreachable!("images decode to 8 or 16 bits"),
        };
        Ok(Block { col, row, width, height, samples })
    }

    fn check_unchanged(&self) -> Result<(), RasterError> {
        self.file.check_unchanged()?;
        self.beside.iter().try_for_each(Witness::check_unchanged)
    }
}

/// A copy of some rows, in the order in which they are handed out.
fn cut<T: Copy>(values: &[T], row_len: usize, rows: Rows) -> Vec<T> {
    match rows {
        Rows::Down => values.to_vec(),
        Rows::Up => values.rchunks_exact(row_len).flatten().copied().collect(),
    }
}

fn reader(path: &Path) -> Result<ImageReader<BufReader<File>>, RasterError> {
    let mut reader = ImageReader::open(path)
        .and_then(ImageReader::with_guessed_format)
        .map_err(RasterError::io("open", path))?;
    let mut limits = Limits::default();
    limits.max_alloc = Some(GREATEST_BYTES);
    reader.limits(limits);
    Ok(reader)
}

fn image_error(path: &Path, what: &str, error: ImageError) -> RasterError {
    match error {
        ImageError::IoError(source) if source.kind() != std::io::ErrorKind::UnexpectedEof => {
            RasterError::io("read", path)(source)
        }
        error => damaged(path, what, error),
    }
}

fn damaged(
    path: &Path,
    what: &str,
    source: impl Into<Box<dyn std::error::Error + Send + Sync>>,
) -> RasterError {
    let what = format!("the {what}");
    RasterError::Damaged { path: path.to_owned(), what, offset: 0, source: source.into() }
}

#[cfg(test)]
mod tests {
    use super::super::convert::{all_colors, all_heights};
    use super::super::open;
    use super::*;
    use areoid_formats::body::Body;
    use image::{ExtendedColorType, ImageBuffer, Luma, Rgba};
    use std::path::PathBuf;
    use tempfile::TempDir;

    const WORLD: &str = "1 0 0 -1 -59.5 69.5";

    fn saved(name: &str, world: Option<&str>) -> (TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        let image =
            ImageBuffer::from_fn(120, 140, |x, y| Luma([u16::try_from(x * 200 + y).unwrap()]));
        image.save(&path).unwrap();
        if let Some(world) = world {
            std::fs::write(path.with_extension("wld"), world).unwrap();
        }
        (folder, path)
    }

    #[test]
    fn a_sixteen_bit_png_is_heights_in_blocks_of_rows() {
        let (_folder, path) = saved("a.png", Some(WORLD));
        let raster = open(&path, &ReadOptions::default()).unwrap();
        let info = raster.info();
        assert_eq!((info.bands, info.sample, info.blocks()), (1, SampleType::U16, (1, 3)));
        assert_eq!((info.outline.origin, info.crs), ([-60.0, 70.0], None));
        let block = raster.read_block(0, 2).unwrap();
        assert_eq!((block.row, block.height), (128, 12));
        let heights = all_heights(&block, info);
        assert_eq!(heights[120 + 3], 3.0 * 200.0 + 129.0);
    }

    #[test]
    fn a_south_up_world_file_turns_the_image_over() {
        let (_folder, path) = saved("a.png", Some("1 0 0 1 0.5 -69.5"));
        let raster = open(&path, &ReadOptions::default()).unwrap();
        assert_eq!(raster.info().outline.origin, [0.0, 70.0]);
        let block = raster.read_block(0, 0).unwrap();
        let Samples::U16(values) = block.samples else { panic!("16 bits") };
        assert_eq!((values[0], values[120]), (139, 138));
    }

    #[test]
    fn the_body_makes_an_image_geographic() {
        let (_folder, path) = saved("a.png", Some(WORLD));
        let body = Some(Body::parse("moon").unwrap());
        let raster = open(&path, &ReadOptions { body, ..ReadOptions::default() }).unwrap();
        assert_eq!(raster.info().crs.unwrap().body.a().0, 1_737_400.0);
    }

    #[test]
    fn alpha_of_a_png_hides_pixels() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.PNG");
        let image = ImageBuffer::from_fn(2, 1, |x, _| Rgba([9_u8, 8, 7, u8::from(x == 0)]));
        image.save_with_format(&path, image::ImageFormat::Png).unwrap();
        let options = ReadOptions { extent: Some([0.0, 0.0, 2.0, 1.0]), ..ReadOptions::default() };
        let raster = open(&path, &options).unwrap();
        let block = raster.read_block(0, 0).unwrap();
        let (rgb, alpha) = all_colors(&block, raster.info()).unwrap();
        assert_eq!((rgb[0], &alpha[..]), ([9, 8, 7], &[1, 0][..]));
    }

    #[test]
    fn an_image_that_nothing_places_names_the_files_looked_for() {
        let (_folder, path) = saved("a.png", None);
        let error = open(&path, &ReadOptions::default()).unwrap_err().to_string();
        assert!(error.contains("a.pgw") && error.contains("a.WLD"), "{error}");
    }

    #[test]
    fn a_world_file_written_to_is_told() {
        let (_folder, path) = saved("a.png", Some(WORLD));
        let raster = open(&path, &ReadOptions::default()).unwrap();
        raster.read_block(0, 0).unwrap();
        raster.check_unchanged().unwrap();
        std::fs::write(path.with_extension("wld"), "1 0 0 -1 -59.5 69.5 ").unwrap();
        let error = raster.check_unchanged().unwrap_err().to_string();
        assert!(error.contains("a.wld was modified while it was read"), "{error}");
        let raster = open(&path, &ReadOptions::default()).unwrap();
        std::fs::write(&path, "no image").unwrap();
        let error = raster.check_unchanged().unwrap_err().to_string();
        assert!(error.contains("a.png was modified while it was read"), "{error}");
    }

    #[test]
    fn damaged_images_are_errors() {
        let folder = tempfile::tempdir().unwrap();
        let options = ReadOptions { extent: Some([0.0, 0.0, 8.0, 8.0]), ..ReadOptions::default() };
        let pixels: Vec<u8> = (0..192).collect();
        let mut jpeg = Vec::new();
        let encoder = image::codecs::jpeg::JpegEncoder::new(&mut jpeg);
        image::ImageEncoder::write_image(encoder, &pixels, 8, 8, ExtendedColorType::Rgb8).unwrap();
        let mut png = Vec::new();
        let encoder = image::codecs::png::PngEncoder::new(&mut png);
        image::ImageEncoder::write_image(encoder, &pixels, 8, 8, ExtendedColorType::Rgb8).unwrap();
        let path = folder.path().join("a.jpg");
        for whole in [jpeg, png] {
            for end in 8..whole.len() {
                std::fs::write(&path, &whole[..end]).unwrap();
                if let Ok(raster) = open(&path, &options) {
                    let _ = raster.read_block(0, 0);
                }
            }
            std::fs::write(&path, &whole[..whole.len() / 3]).unwrap();
            let result = open(&path, &options).and_then(|raster| raster.read_block(0, 0));
            assert!(result.unwrap_err().to_string().contains("is damaged"));
        }
    }
}
