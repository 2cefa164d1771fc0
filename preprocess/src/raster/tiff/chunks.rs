//! Where the chunks of a TIFF file are, tiles and strips alike.
//!
//! ```text
//!            across                        across = 1
//!      +------+------+--+              +----------------+
//!      |  0   |  1   |2 |  down        |       0        |  down
//!      +------+------+--+              +----------------+
//!      |  3   |  4   |5 |              |       1        |
//!      +------+------+--+              +----------------+
//!       tiles: whole, cut               strips: the last one has
//!       when they are decoded           only the rows there are
//! ```
//!
//! Planes of a planar file follow one another.

use super::super::error::RasterError;
use super::directory::{Directory, Tag, TiffFile, tags};
use super::layout::{Compression, Pixel, small};

/// A chunk's samples may take this much memory, in bytes.
const GREATEST_CHUNK_BYTES: u64 = 1 << 30;

/// Strips of uncompressed rows are read in pieces of about this many bytes.
const PIECE_BYTES: u64 = 1 << 20;

/// The chunks of a raster.
#[derive(Debug)]
pub(crate) struct Chunks {
    pub(crate) tiled: bool,
    /// Pixels of a whole chunk.
    pub(crate) width: u32,
    pub(crate) height: u32,
    /// Chunks in a row of chunks, and rows of chunks.
    pub(crate) across: u32,
    pub(crate) down: u32,
    /// Planes: the samples of a pixel if each has its own, otherwise 1.
    pub(crate) planes: u16,
    pub(crate) compression: Compression,
    pub(crate) predictor: u16,
    pub(crate) jpeg_tables: Option<Vec<u8>>,
    /// Offset and length in bytes of every chunk.
    places: Vec<(u64, u64)>,
}

impl Chunks {
    /// Reads and checks the tables for a raster of `width` × `height`.
    pub(crate) fn read(
        tiff: &TiffFile,
        directory: &Directory,
        pixel: &Pixel,
        (image_width, image_height): (u32, u32),
    ) -> Result<Self, RasterError> {
        let tiled = tiff.integer(directory, tags::TILE_WIDTH)?.is_some();
        let (width, height) = if tiled {
            let width = side(tiff, directory, tags::TILE_WIDTH, None)?;
            (width, side(tiff, directory, tags::TILE_LENGTH, None)?)
        } else {
            let rows = side(tiff, directory, tags::ROWS_PER_STRIP, Some(image_height))?;
            (image_width, rows.min(image_height))
        };
        let planes = match small(tiff, directory, tags::PLANAR_CONFIGURATION, 1)? {
            1 => 1,
            2 => pixel.stored,
            found => {
                return Err(tiff.wrong(directory, tags::PLANAR_CONFIGURATION, found, "1 or 2"));
            }
        };
        let compression = Compression::read(tiff, directory)?;
        let predictor = small(tiff, directory, tags::PREDICTOR, 1)?;
        let predictor = if compression.has_predictor() { predictor } else { 1 };
        match predictor {
            1 | 2 => {}
            3 if pixel.sample.is_float() => {}
            found => {
                let expected = "1, 2, or 3 for floating-point samples";
                return Err(tiff.wrong(directory, tags::PREDICTOR, found, expected));
            }
        }
        if small(tiff, directory, tags::FILL_ORDER, 1)? != 1 {
            let found = "bytes with their bits reversed (FillOrder 2)";
            return Err(RasterError::not_supported(tiff.file.path(), found, "FillOrder 1"));
        }
        let mut jpeg_tables = None;
        if compression == Compression::Jpeg {
            let tables = tiff.integers(directory, tags::JPEG_TABLES)?;
            jpeg_tables =
                tables.map(|bytes| bytes.iter().filter_map(|&byte| byte.try_into().ok()).collect());
        }

        let mut chunks = Self {
            tiled,
            width,
            height,
            across: image_width.div_ceil(width),
            down: image_height.div_ceil(height),
            planes,
            compression,
            predictor,
            jpeg_tables,
            places: Vec::new(),
        };
        chunks.places = chunks.read_places(tiff, directory)?;
        chunks.check_size(tiff, pixel, image_height)?;
        Ok(chunks)
    }

    /// Offset and length of the chunk at `(across, down)` of a plane; length 0 is a chunk that the
    /// file leaves out.
    pub(crate) fn place(&self, plane: u32, across: u32, down: u32) -> (u64, u64) {
        let row = u64::from(plane) * u64::from(self.down) + u64::from(down);
        let index = row * u64::from(self.across) + u64::from(across);
        usize::try_from(index)
            .ok()
            .and_then(|index| self.places.get(index).copied())
            .unwrap_or((0, 0))
    }

    /// Bytes of a row of a whole chunk.
    pub(crate) fn row_bytes(&self, pixel: &Pixel) -> u64 {
        let samples = if self.planes > 1 { 1 } else { u64::from(pixel.stored) };
        u64::from(self.width) * samples * pixel.sample.bytes() as u64
    }

    fn read_places(
        &self,
        tiff: &TiffFile,
        directory: &Directory,
    ) -> Result<Vec<(u64, u64)>, RasterError> {
        let (offsets_tag, counts_tag) = if self.tiled {
            (tags::TILE_OFFSETS, tags::TILE_BYTE_COUNTS)
        } else {
            (tags::STRIP_OFFSETS, tags::STRIP_BYTE_COUNTS)
        };
        let expected = u64::from(self.across)
            .saturating_mul(self.down.into())
            .saturating_mul(self.planes.into());
        let table = |tag| {
            let values = tiff.integers(directory, tag)?.unwrap_or_default();
            if (values.len() as u64) < expected {
                let found = format!("{} values", values.len());
                return Err(tiff.wrong(directory, tag, found, format!("{expected} values")));
            }
            Ok(values)
        };
        let (offsets, counts) = (table(offsets_tag)?, table(counts_tag)?);
        Ok(offsets.into_iter().zip(counts).collect())
    }

    /// Refuses chunks too large to decode in one piece; those of uncompressed rows are cut instead.
    fn check_size(
        &mut self,
        tiff: &TiffFile,
        pixel: &Pixel,
        image_height: u32,
    ) -> Result<(), RasterError> {
        let row_bytes = self.row_bytes(pixel);
        if !self.tiled && self.compression == Compression::None {
            self.cut_strips(row_bytes, image_height, tiff.file.len());
        }
        let chunk_bytes = row_bytes.saturating_mul(self.height.into());
        if chunk_bytes > GREATEST_CHUNK_BYTES {
            return Err(RasterError::not_supported(
                tiff.file.path(),
                format!(
                    "a tile or strip of {chunk_bytes} bytes ({} × {})",
                    self.width, self.height
                ),
                format!("tiles and strips up to {GREATEST_CHUNK_BYTES} bytes"),
            ));
        }
        Ok(())
    }

    /// Cuts long strips of uncompressed rows into pieces that are read one at a time.
    ///
    /// Only strips that are whole and inside the file are cut, so that there are never more pieces
    /// than the file's length justifies.
    fn cut_strips(&mut self, row_bytes: u64, image_height: u32, file_bytes: u64) {
        let rows = (PIECE_BYTES / row_bytes.max(1)).clamp(1, u32::MAX.into());
        let Ok(rows) = u32::try_from(rows) else { return };
        if self.height / 4 < rows || self.places.len() > 1 << 16 {
            return;
        }
        let mut cut = Vec::new();
        for plane in 0..self.planes {
            for down in 0..self.down {
                let (offset, bytes) = self.place(plane.into(), 0, down);
                let strip_rows = self.height.min(image_height - down * self.height);
                let whole = row_bytes.checked_mul(strip_rows.into()) == Some(bytes)
                    && offset.checked_add(bytes).is_some_and(|end| end <= file_bytes);
                if !whole || (self.down > 1 && !self.height.is_multiple_of(rows)) {
                    return;
                }
                cut.extend((0..strip_rows).step_by(rows as usize).map(|row| {
                    let count = u64::from(rows.min(strip_rows - row)) * row_bytes;
                    (offset + u64::from(row) * row_bytes, count)
                }));
            }
        }
        (self.height, self.down, self.places) = (rows, image_height.div_ceil(rows), cut);
    }
}

/// A side of a chunk, which is at least one pixel.
fn side(
    tiff: &TiffFile,
    directory: &Directory,
    tag: Tag,
    default: Option<u32>,
) -> Result<u32, RasterError> {
    let value = tiff.integer(directory, tag)?.or(default.map(u64::from)).unwrap_or(0);
    match u32::try_from(value) {
        Ok(value) if value > 0 => Ok(value),
        _ => Err(tiff.wrong(directory, tag, value, "1 to 4294967295")),
    }
}
