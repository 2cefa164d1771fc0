//! GeoTIFF and BigTIFF.
//!
//! The first directory is the raster. Later ones that are overviews are ignored; one that is a mask
//! of the raster is refused, because ignoring it would show samples that the file calls invalid.
//!
//! Blocks are tiles, or as many strips as make about a quarter of a MiB.

mod chunks;
mod decode;
mod directory;
mod geokeys;
mod layout;
mod metadata;
mod one_chunk;
mod predictor;

use self::chunks::Chunks;
use self::decode::{ChunkShape, Scratch};
use self::directory::{Directory, TiffFile, tags};
use self::geokeys::GeoKeys;
use self::layout::{Meaning, Pixel};
use super::error::RasterError;
use super::file::{PositionedFile, Witness};
use super::georeference;
use super::outline::Rows;
use super::samples::{Sample, Samples, with_samples};
use super::{Block, Raster, RasterInfo, ReadOptions};

/// Strips are read together until they have about this many bytes.
const BLOCK_BYTES: u64 = 256 << 10;

/// Directories looked at for masks.
const MOST_DIRECTORIES: usize = 1024;

/// An open TIFF file.
///
/// Memory: the table of chunks, 16 bytes each. Reading a block takes its samples as encoded and as
/// handed out, for as long as the call lasts.
#[derive(Debug)]
pub(super) struct TiffRaster {
    tiff: TiffFile,
    info: RasterInfo,
    pixel: Pixel,
    chunks: Chunks,
    rows: Rows,
    /// Files that say where it lies.
    beside: Vec<Witness>,
}

impl TiffRaster {
    pub(super) fn open(file: PositionedFile, options: &ReadOptions) -> Result<Self, RasterError> {
        let path = file.path().to_owned();
        let tiff = TiffFile::new(file)?;
        let directory = tiff.first_directory()?;
        let side = |tag| {
            let value = tiff.integer(&directory, tag)?.unwrap_or(0);
            match u32::try_from(value) {
                Ok(value) if (1..=1 << 31).contains(&value) => Ok(value),
                _ => Err(tiff.wrong(&directory, tag, value, "1 to 2147483648")),
            }
        };
        let size = (side(tags::IMAGE_WIDTH)?, side(tags::IMAGE_LENGTH)?);
        refuse_masks(&tiff, &directory)?;
        let pixel = Pixel::read(&tiff, &directory)?;
        let chunks = Chunks::read(&tiff, &directory, &pixel, size)?;

        let keys = GeoKeys::read(&tiff, &directory)?;
        let steps = geokeys::steps(&tiff, &directory, keys.is_point())?;
        let placed = georeference::place(&path, size, options, steps, || keys.crs(&tiff))?;
        let scaling = metadata::scaling(&tiff, &directory, keys.meters_per_height())?;
        let nodata = match options.nodata {
            Some(nodata) => Some(nodata),
            None => metadata::nodata(&tiff, &directory)?,
        };

        let strips = if chunks.tiled {
            1
        } else {
            let strip_bytes = chunks.row_bytes(&pixel) * u64::from(chunks.height);
            u32::try_from((BLOCK_BYTES / strip_bytes.max(1)).max(1)).unwrap_or(u32::MAX)
        };
        let is_palette = matches!(pixel.meaning, Meaning::Palette(_));
        let info = RasterInfo {
            path,
            width: size.0,
            height: size.1,
            bands: pixel.bands(),
            // A palette's no-data is a place in the table: it becomes alpha.
            has_alpha: pixel.has_alpha || (is_palette && nodata.is_some()),
            sample: pixel.sample,
            crs: placed.crs,
            outline: placed.outline,
            point_registered: keys.is_point(),
            nodata,
            scale: scaling.scale,
            offset: scaling.offset,
            block_width: chunks.width,
            block_height: chunks.height.saturating_mul(strips).min(size.1.max(chunks.height)),
        };
        Ok(Self { tiff, info, pixel, chunks, rows: placed.rows, beside: placed.beside })
    }

    /// Samples of a window of the file, in the file's own order of rows.
    fn read_window(&self, wanted: [u32; 4]) -> Result<Samples, RasterError> {
        let [col, row, width, height] = wanted;
        let chunks = &self.chunks;
        let kept = &self.pixel.kept;
        let everything = chunks.planes == 1 && kept.iter().copied().eq(0..self.pixel.stored);
        let filled = |pixels: [u32; 4], samples: usize| {
            let len = pixels[2] as usize * pixels[3] as usize * samples;
            Samples::filled(self.pixel.sample, len, 0.0)
        };
        Scratch::with(|scratch| {
            let mut window: Option<Samples> = None;
            for down in row / chunks.height..=(row + height - 1) / chunks.height {
                for across in col / chunks.width..=(col + width - 1) / chunks.width {
                    for plane in 0..chunks.planes {
                        let chunk = self.read_chunk([plane.into(), across, down], scratch)?;
                        // Allocated now that a chunk has been read that is long enough.
                        let window = window.get_or_insert_with(|| filled(wanted, kept.len()));
                        let place = chunk.window;
                        let row_inside = place[1].checked_sub(row);
                        if let Some(first_row) = row_inside
                            && everything
                            && (place[0], place[2]) == (col, width)
                            && first_row + place[3] <= height
                        {
                            let row_bytes = window.bytes() / height as usize;
                            let rows = &mut window.as_bytes_mut()[first_row as usize * row_bytes..];
                            self.decode(
                                &chunk,
                                scratch,
                                &mut rows[..place[3] as usize * row_bytes],
                            )?;
                            continue;
                        }
                        let mut samples = filled(place, chunk.shape.samples.into());
                        self.decode(&chunk, scratch, samples.as_bytes_mut())?;
                        for (to_band, &from_band) in kept.iter().enumerate() {
                            let (from_band, from_bands) = match chunks.planes {
                                1 => (from_band, self.pixel.stored),
                                _ if from_band == plane => (0, 1),
                                _ => continue,
                            };
                            let from = Place { window: place, band: from_band, bands: from_bands };
                            let to = Place { window: wanted, band: to_band, bands: kept.len() };
                            copy_samples(&samples, from, window, to);
                        }
                    }
                }
            }
            Ok(window.unwrap_or_else(|| Samples::filled(self.pixel.sample, 0, 0.0)))
        })
    }

    /// Column, row, width and height of a chunk inside the raster.
    fn chunk_window(&self, across: u32, down: u32) -> [u32; 4] {
        let (col, row) = (across * self.chunks.width, down * self.chunks.height);
        let width = self.chunks.width.min(self.info.width - col);
        [col, row, width, self.chunks.height.min(self.info.height - row)]
    }

    /// Reads the chunk of a plane, column and row of chunks into `scratch`.
    fn read_chunk(
        &self,
        [plane, across, down]: [u32; 3],
        scratch: &mut Scratch,
    ) -> Result<Chunk<'_>, RasterError> {
        let chunks = &self.chunks;
        let window = self.chunk_window(across, down);
        let [_, _, width, height] = window;
        let (offset, bytes) = chunks.place(plane, across, down);
        let shape = ChunkShape {
            order: self.tiff.order,
            compression: chunks.compression,
            predictor: chunks.predictor,
            jpeg_tables: chunks.jpeg_tables.as_deref(),
            sample: self.pixel.sample,
            samples: if chunks.planes > 1 { 1 } else { self.pixel.stored },
            // The last strip has only the rows there are.
            encoded: (chunks.width, if chunks.tiled { chunks.height } else { height }),
            clipped: (width, height),
        };
        let chunk = Chunk { window, across, down, offset, bytes, shape };
        if bytes > 0 {
            self.tiff.file.read_into(|| self.name(&chunk), offset, bytes, &mut scratch.chunk)?;
            shape.check_length(&scratch.chunk).map_err(|source| self.damaged(&chunk, source))?;
        }
        Ok(chunk)
    }

    /// Decodes the chunk that was read into `scratch`.
    fn decode(
        &self,
        chunk: &Chunk,
        scratch: &mut Scratch,
        out: &mut [u8],
    ) -> Result<(), RasterError> {
        if chunk.bytes > 0 {
            let Scratch { chunk: bytes, workspace } = scratch;
            let decoded = chunk.shape.decode_into(bytes, workspace, out);
            return decoded.map_err(|source| self.damaged(chunk, source));
        }
        // A chunk that the file leaves out is no data, or zeros where nothing means that.
        let nodata = self.info.nodata.unwrap_or(0.0);
        let len = out.len() / self.pixel.sample.bytes();
        let mut filled = Samples::filled(self.pixel.sample, len, nodata);
        if let (Samples::U8(values), Meaning::YCbCr) = (&mut filled, &self.pixel.meaning) {
            // A gray of that value.
            values.chunks_exact_mut(3).for_each(|pixel| pixel[1..].fill(128));
        }
        out.copy_from_slice(filled.as_bytes());
        Ok(())
    }

    fn name(&self, chunk: &Chunk) -> String {
        let what = if self.chunks.tiled { "tile" } else { "strip" };
        format!("the {what} at column {}, row {}", chunk.across, chunk.down)
    }

    fn damaged(&self, chunk: &Chunk, source: decode::ChunkError) -> RasterError {
        let (path, what) = (self.info.path.clone(), self.name(chunk));
        RasterError::Damaged { path, what, offset: chunk.offset, source }
    }

    /// Samples as bands: colors of palettes and of JPEG become red, green, blue.
    fn bands_of(&self, samples: Samples) -> Samples {
        match (samples, &self.pixel.meaning) {
            (Samples::U8(mut values), Meaning::YCbCr) => {
                for pixel in values.chunks_exact_mut(3) {
                    pixel.copy_from_slice(&rgb_from_ycbcr([pixel[0], pixel[1], pixel[2]]));
                }
                Samples::U8(values)
            }
            (Samples::U8(values), Meaning::Palette(colors)) => {
                let nodata = self.info.nodata.and_then(u8::exactly);
                let mut bands = Vec::with_capacity(values.len() * self.info.samples_per_pixel());
                for value in values {
                    bands.extend(colors[usize::from(value)]);
                    if self.info.has_alpha {
                        bands.push(if Some(value) == nodata { 0 } else { 255 });
                    }
                }
                Samples::U8(bands)
            }
            (samples, _) => samples,
        }
    }
}

/// A chunk whose bytes are in the scratch.
struct Chunk<'raster> {
    /// Column, row, width and height inside the raster.
    window: [u32; 4],
    /// Column and row of chunks.
    across: u32,
    down: u32,
    /// Place in the file; no bytes are a chunk left out.
    offset: u64,
    bytes: u64,
    shape: ChunkShape<'raster>,
}

impl Raster for TiffRaster {
    fn info(&self) -> &RasterInfo {
        &self.info
    }

    fn read_block(&self, block_col: u32, block_row: u32) -> Result<Block, RasterError> {
        let window = self.info.block_window(block_col, block_row);
        let [col, row, width, height] = window.expect("callers ask for blocks that exist");
        let samples = match self.rows {
            Rows::Down => self.read_window([col, row, width, height])?,
            // Blocks are counted from the top and chunks from the bottom: where the height is no
            // multiple of a chunk's, a block has parts of two, and each chunk is decoded twice.
            Rows::Up => {
                let from = self.info.height - row - height;
                let mut samples = self.read_window([col, from, width, height])?;
                let row_len = samples.len() / height as usize;
                with_samples!(&mut samples, values => reverse_rows(values, row_len));
                samples
            }
        };
        Ok(Block { col, row, width, height, samples: self.bands_of(samples) })
    }

    fn check_unchanged(&self) -> Result<(), RasterError> {
        self.tiff.file.check_unchanged()?;
        self.beside.iter().try_for_each(Witness::check_unchanged)
    }
}

/// An internal mask says which pixels are valid; it is not read, so it must not be there.
fn refuse_masks(tiff: &TiffFile, first: &Directory) -> Result<(), RasterError> {
    const MASK: u64 = 4;
    const REDUCED: u64 = 1;
    let mut seen = vec![first.offset];
    let mut next = tiff.next_directory(first)?;
    while let Some(directory) = next {
        if seen.contains(&directory.offset) || seen.len() == MOST_DIRECTORIES {
            let found = format!("directory {} points backward", seen.len());
            let field = "the chain of TIFF directories";
            let offset = directory.offset;
            return Err(RasterError::field(tiff.file.path(), field, offset, found, "an end"));
        }
        seen.push(directory.offset);
        let kind = tiff.integer(&directory, tags::NEW_SUBFILE_TYPE)?.unwrap_or(0);
        if kind & MASK != 0 && kind & REDUCED == 0 {
            return Err(RasterError::not_supported(
                tiff.file.path(),
                format!("an internal mask (directory {})", seen.len()),
                "an alpha band or a no-data value",
            ));
        }
        next = tiff.next_directory(&directory)?;
    }
    Ok(())
}

/// A rectangle of the raster, and one of the bands that its samples have.
#[derive(Clone, Copy)]
struct Place<Band> {
    /// Column, row, width, height.
    window: [u32; 4],
    band: Band,
    bands: Band,
}

/// Copies the samples of one band where two rectangles overlap.
fn copy_samples(from: &Samples, at: Place<u16>, to: &mut Samples, into: Place<usize>) {
    match (from, to) {
        (Samples::U8(from), Samples::U8(to)) => copy_values(from, at, to, into),
        (Samples::I8(from), Samples::I8(to)) => copy_values(from, at, to, into),
        (Samples::U16(from), Samples::U16(to)) => copy_values(from, at, to, into),
        (Samples::I16(from), Samples::I16(to)) => copy_values(from, at, to, into),
        (Samples::U32(from), Samples::U32(to)) => copy_values(from, at, to, into),
        (Samples::I32(from), Samples::I32(to)) => copy_values(from, at, to, into),
        (Samples::F32(from), Samples::F32(to)) => copy_values(from, at, to, into),
        (Samples::F64(from), Samples::F64(to)) => copy_values(from, at, to, into),
        _ => unreachable!("chunks and windows of a raster are of its one sample type"),
    }
}

fn copy_values<T: Copy>(from: &[T], at: Place<u16>, to: &mut [T], into: Place<usize>) {
    let ([from_col, from_row, from_width, from_height], [to_col, to_row, to_width, to_height]) =
        (at.window, into.window);
    let (left, top) = (from_col.max(to_col), from_row.max(to_row));
    let right = (from_col + from_width).min(to_col + to_width);
    let bottom = (from_row + from_height).min(to_row + to_height);
    let (from_bands, to_bands) = (usize::from(at.bands), into.bands);
    let count = (right - left) as usize;
    for row in top..bottom {
        let start = |first_row: u32, first_col: u32, width: u32| {
            (row - first_row) as usize * width as usize + (left - first_col) as usize
        };
        let from =
            &from[start(from_row, from_col, from_width) * from_bands..][..count * from_bands];
        let to = &mut to[start(to_row, to_col, to_width) * to_bands..][..count * to_bands];
        if from_bands == 1 && to_bands == 1 {
            to.copy_from_slice(from);
            continue;
        }
        let values = from[usize::from(at.band)..].iter().step_by(from_bands);
        for (to, value) in to[into.band..].iter_mut().step_by(to_bands).zip(values) {
            *to = *value;
        }
    }
}

fn reverse_rows<T>(values: &mut [T], row_len: usize) {
    let rows = values.len() / row_len.max(1);
    for row in 0..rows / 2 {
        let (above, below) = values.split_at_mut((rows - 1 - row) * row_len);
        above[row * row_len..][..row_len].swap_with_slice(&mut below[..row_len]);
    }
}

/// The color of a JPEG file's Y, Cb, Cr.
///
/// # References
///
/// * ITU-T T.871, *JPEG File Interchange Format*, clause 7, rounded in 16-bit fixed point.
fn rgb_from_ycbcr([y, cb, cr]: [u8; 3]) -> [u8; 3] {
    let (y, cb, cr) = (i32::from(y) << 16, i32::from(cb) - 128, i32::from(cr) - 128);
    let channel = |value: i32| {
        let rounded = (value + (1 << 15)) >> 16;
        u8::try_from(rounded.clamp(0, 255)).expect("clamped to a byte")
    };
    [channel(y + 91_881 * cr), channel(y - 22_554 * cb - 46_802 * cr), channel(y + 116_130 * cb)]
}

#[cfg(test)]
mod tests;
