//! Writing `GeoTIFF`s as planetary archives have them: DEFLATE with horizontal differencing, in
//! tiles or strips, on Mars's sphere, the globe or a hemisphere.
//!
//! The encoder of the `tiff` crate writes no tiles. Blocks are written as their rows are made; the
//! directory follows them, and the header is pointed at it last:
//!
//! ```text
//!   header ─┐  block, block, ..  values of long tags  directory
//!           └───────────────────────────────────────▶┘
//! ```
//!
//! Files that may pass 4 GiB are `BigTIFF`s.
//!
//! # References
//!
//! * Adobe, *TIFF 6.0*, sections 2, 14 and 15; *The BigTIFF File Format*.
//! * OGC 19-008r4, *OGC GeoTIFF Standard*, version 1.1.

use std::fs::File;
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::Path;

use flate2::Compression;
use flate2::write::ZlibEncoder;
use rayon::prelude::*;

/// Radius of the sphere that Mars's data products are on, in meters.
pub(super) const MARS_RADIUS_M: f64 = 3_396_190.0;

/// Files whose samples take more than this are `BigTIFF`s.
const CLASSIC_BYTES: u64 = 3_500_000_000;

/// How a file's samples are cut into blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Blocks {
    /// Squares of so many pixels.
    Tiles(u32),
    /// So many whole rows.
    Strips(u32),
}

/// What a raster shows of Mars.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// All of it, longitude by latitude.
    Globe,
    /// Its northern half, likewise.
    Half,
    /// The northern hemisphere about the pole, polar stereographic: so many pixels from the pole to
    /// the equator.
    North {
        /// Pixels.
        radius_px: u32,
    },
}

/// A raster, sample by sample.
#[derive(Clone, Copy, Debug)]
pub(super) struct Format {
    pub(super) width: u32,
    pub(super) height: u32,
    /// 1 or 3.
    pub(super) bands: u16,
    /// 1, unsigned, 2, signed, or 4, floating point.
    pub(super) sample_bytes: u16,
    pub(super) missing: Option<i16>,
    pub(super) place: Place,
    pub(super) blocks: Blocks,
}

impl Format {
    fn pixel_bytes(&self) -> usize {
        usize::from(self.bands) * usize::from(self.sample_bytes)
    }

    /// Floating-point samples are stored as they are.
    fn is_differenced(&self) -> bool {
        self.sample_bytes < 4
    }

    /// Width and height of a block, as it is stored.
    fn block(&self) -> (u32, u32) {
        match self.blocks {
            Blocks::Tiles(side) => (side, side),
            Blocks::Strips(rows) => (self.width, rows),
        }
    }

    /// Writes the file; `rows` makes the samples of whole rows, bands side by side, little-endian.
    pub(super) fn write(
        &self,
        path: &Path,
        rows: impl Fn(Range<u32>) -> Vec<u8>,
    ) -> io::Result<()> {
        let samples = u64::from(self.width) * u64::from(self.height) * self.pixel_bytes() as u64;
        let offsets = if samples > CLASSIC_BYTES { Offsets::Eight } else { Offsets::Four };
        self.write_to(BufWriter::new(File::create(path)?), offsets, rows)
    }

    fn write_to(
        &self,
        sink: impl Write + Seek,
        width: Offsets,
        rows: impl Fn(Range<u32>) -> Vec<u8>,
    ) -> io::Result<()> {
        let mut file = Writer::start(sink, width)?;
        let (block_width, block_height) = self.block();
        let (mut offsets, mut lengths) = (Vec::new(), Vec::new());
        for first in (0..self.height).step_by(block_height as usize) {
            let band = rows(first..(first + block_height).min(self.height));
            let blocks: Vec<Vec<u8>> = (0..self.width.div_ceil(block_width))
                .into_par_iter()
                .map(|across| self.encode(&band, across))
                .collect::<io::Result<_>>()?;
            for block in blocks {
                offsets.push(file.append(&block)?);
                lengths.push(block.len() as u64);
            }
        }
        file.finish(self.tags(offsets, lengths))
    }

    /// One block of a row of blocks, compressed.
    fn encode(&self, band: &[u8], across: u32) -> io::Result<Vec<u8>> {
        let pixel = self.pixel_bytes();
        let stride = self.width as usize * pixel;
        let (block_width, block_height) = self.block();
        let start = (across * block_width) as usize * pixel;
        let end = stride.min(start + block_width as usize * pixel);
        // Strips end with the raster, tiles are whole.
        let rows = match self.blocks {
            Blocks::Tiles(_) => block_height as usize,
            Blocks::Strips(_) => band.len() / stride,
        };
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::new(6));
        let mut line = vec![0; block_width as usize * pixel];
        for row in 0..rows {
            line.fill(0);
            if let Some(source) = band.get(row * stride..(row + 1) * stride) {
                line[..end - start].copy_from_slice(&source[start..end]);
            }
            if self.is_differenced() {
                difference(&mut line, usize::from(self.bands), usize::from(self.sample_bytes));
            }
            encoder.write_all(&line)?;
        }
        encoder.finish()
    }

    fn tags(&self, offsets: Vec<u64>, lengths: Vec<u64>) -> Vec<(u16, Values)> {
        use Values::{Double, Long, Place, Short, Text};
        let bands = usize::from(self.bands);
        let format = match self.sample_bytes {
            1 => 1,
            2 => 2,
            _ => 3,
        };
        let [left, top, dx, dy] = self.place.corner_and_pixel((self.width, self.height));
        let (keys, numbers) = self.place.keys();
        let mut tags = vec![
            (256, Long(vec![self.width])),
            (257, Long(vec![self.height])),
            (258, Short(vec![8 * self.sample_bytes; bands])),
            (259, Short(vec![8])),
            (262, Short(vec![if self.bands == 3 { 2 } else { 1 }])),
            (277, Short(vec![self.bands])),
            (284, Short(vec![1])),
            (317, Short(vec![if self.is_differenced() { 2 } else { 1 }])),
            (339, Short(vec![format; bands])),
            (33550, Double(vec![dx, dy, 0.0])),
            (33922, Double(vec![0.0, 0.0, 0.0, left, top, 0.0])),
            (34735, Short(keys)),
            (34736, Double(numbers)),
            (34737, Text(CITATION.to_owned())),
        ];
        tags.extend(match self.blocks {
            Blocks::Tiles(side) => [
                (322, Long(vec![side])),
                (323, Long(vec![side])),
                (324, Place(offsets)),
                (325, Place(lengths)),
            ],
            Blocks::Strips(rows) => [
                (273, Place(offsets)),
                (278, Long(vec![rows])),
                (279, Place(lengths)),
                (274, Short(vec![1])),
            ],
        });
        tags.extend(self.missing.map(|missing| (42113, Text(missing.to_string()))));
        tags.sort_by_key(|&(tag, _)| tag);
        tags
    }
}

const CITATION: &str = "Mars 2000 Sphere|";

impl Place {
    /// Left, top, and the pixel's width and height, in degrees or meters.
    pub(super) fn corner_and_pixel(self, (width, height): (u32, u32)) -> [f64; 4] {
        match self {
            Self::Globe => [-180.0, 90.0, 360.0 / f64::from(width), 180.0 / f64::from(height)],
            Self::Half => [-180.0, 90.0, 360.0 / f64::from(width), 90.0 / f64::from(height)],
            Self::North { radius_px } => {
                // Map meters from the pole to the equator: 2 R tan 45°.
                let pixel = 2.0 * MARS_RADIUS_M / f64::from(radius_px);
                [-pixel * f64::from(width) / 2.0, pixel * f64::from(height) / 2.0, pixel, pixel]
            }
        }
    }

    /// The same as a PROJ string.
    pub(super) fn proj(self) -> String {
        match self {
            Self::Globe | Self::Half => format!("+proj=longlat +R={MARS_RADIUS_M} +no_defs"),
            Self::North { .. } => {
                format!(
                    "+proj=stere +lat_0=90 +lon_0=0 +k=1 +x_0=0 +y_0=0 +R={MARS_RADIUS_M} +units=m +no_defs"
                )
            }
        }
    }

    /// The directory of keys, and the numbers it points to.
    fn keys(self) -> (Vec<u16>, Vec<f64>) {
        const RADII: [f64; 2] = [MARS_RADIUS_M, MARS_RADIUS_M];
        match self {
            Self::Globe | Self::Half => (key_directory(&[(1024, 2)], &[]), RADII.to_vec()),
            Self::North { .. } => {
                let system = [(1024, 1)];
                // A projection of its own, polar stereographic, in meters.
                let map = [(3072, 32767), (3074, 32767), (3075, 15), (3076, 9001)];
                let numbers = [90.0, 0.0, 0.0, 1.0, 0.0];
                let [latitude, easting, northing, scale, longitude] =
                    [3081, 3082, 3083, 3092, 3095];
                let names = [latitude, easting, northing, scale, longitude];
                let keys = key_directory(&[&system[..], &map[..]].concat(), &names);
                (keys, [&RADII[..], &numbers[..]].concat())
            }
        }
    }
}

/// Keys of a system on a sphere whose radii are the first two numbers, cells, with more keys that
/// say a value, and keys that name the numbers behind the radii.
fn key_directory(values: &[(u16, u16)], numbers: &[u16]) -> Vec<u16> {
    let mut keys: Vec<[u16; 4]> = vec![
        [1025, 0, 1, 1],      // cells
        [2048, 0, 1, 32767],  // a system of its own
        [2049, 34737, 17, 0], // its name
        [2050, 0, 1, 32767],  // a datum of its own
        [2054, 0, 1, 9102],   // degrees
        [2057, 34736, 1, 0],  // semi-major axis
        [2058, 34736, 1, 1],  // semi-minor axis
    ];
    keys.extend(values.iter().map(|&(key, value)| [key, 0, 1, value]));
    keys.extend(numbers.iter().zip(2..).map(|(&key, at)| [key, 34736, 1, at]));
    keys.sort_unstable();
    let count = u16::try_from(keys.len()).expect("a few keys");
    [[1, 1, 0, count]].into_iter().chain(keys).flatten().collect()
}

/// Horizontal differencing (predictor 2), of one row.
pub(super) fn difference(line: &mut [u8], bands: usize, sample_bytes: usize) {
    let step = bands * sample_bytes;
    if sample_bytes == 1 {
        for at in (step..line.len()).rev() {
            line[at] = line[at].wrapping_sub(line[at - step]);
        }
    } else {
        for at in (step..line.len()).step_by(2).rev() {
            let sample = |at: usize| i16::from_le_bytes([line[at], line[at + 1]]);
            let difference = sample(at).wrapping_sub(sample(at - step));
            line[at..at + 2].copy_from_slice(&difference.to_le_bytes());
        }
    }
}

/// The values of a tag. A place is an offset or a length: 4 bytes, or 8 in a `BigTIFF`.
enum Values {
    Short(Vec<u16>),
    Long(Vec<u32>),
    Double(Vec<f64>),
    Text(String),
    Place(Vec<u64>),
}

/// How wide a file's offsets are, in bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Offsets {
    /// TIFF.
    Four,
    /// `BigTIFF`.
    Eight,
}

/// A file that grows block by block.
struct Writer<W> {
    sink: W,
    at: u64,
    is_big: bool,
}

impl<W: Write + Seek> Writer<W> {
    fn start(mut sink: W, offsets: Offsets) -> io::Result<Self> {
        let is_big = offsets == Offsets::Eight;
        let header: &[u8] = if is_big {
            &[b'I', b'I', 43, 0, 8, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]
        } else {
            &[b'I', b'I', 42, 0, 0, 0, 0, 0]
        };
        sink.write_all(header)?;
        Ok(Self { sink, at: header.len() as u64, is_big })
    }

    /// Appends at an even offset, which it returns.
    fn append(&mut self, bytes: &[u8]) -> io::Result<u64> {
        let at = self.at;
        self.sink.write_all(bytes)?;
        self.at += bytes.len() as u64;
        if !self.at.is_multiple_of(2) {
            self.sink.write_all(&[0])?;
            self.at += 1;
        }
        Ok(at)
    }

    /// A number as wide as an offset.
    fn place(&self, value: u64) -> Vec<u8> {
        let bytes = value.to_le_bytes();
        bytes[..if self.is_big { 8 } else { 4 }].to_vec()
    }

    fn finish(mut self, tags: Vec<(u16, Values)>) -> io::Result<()> {
        let inline = if self.is_big { 8 } else { 4 };
        let mut directory = match u16::try_from(tags.len()).expect("a few tags") {
            count if self.is_big => u64::from(count).to_le_bytes().to_vec(),
            count => count.to_le_bytes().to_vec(),
        };
        for (tag, values) in tags {
            let (kind, count, mut bytes) = self.bytes_of(values);
            if bytes.len() > inline {
                let at = self.append(&bytes)?;
                bytes = self.place(at);
            }
            bytes.resize(inline, 0);
            directory.extend(tag.to_le_bytes());
            directory.extend(kind.to_le_bytes());
            directory.extend(self.place(count as u64));
            directory.extend(bytes);
        }
        directory.extend(self.place(0));
        let at = self.append(&directory)?;
        self.sink.seek(SeekFrom::Start(if self.is_big { 8 } else { 4 }))?;
        let pointer = self.place(at);
        self.sink.write_all(&pointer)?;
        self.sink.flush()
    }

    /// TIFF's number of a type, how many values, and their bytes.
    fn bytes_of(&self, values: Values) -> (u16, usize, Vec<u8>) {
        match values {
            Values::Short(values) => {
                (3, values.len(), values.iter().flat_map(|value| value.to_le_bytes()).collect())
            }
            Values::Long(values) => {
                (4, values.len(), values.iter().flat_map(|value| value.to_le_bytes()).collect())
            }
            Values::Double(values) => {
                (12, values.len(), values.iter().flat_map(|value| value.to_le_bytes()).collect())
            }
            Values::Text(text) => (2, text.len() + 1, [text.as_bytes(), &[0]].concat()),
            Values::Place(values) => {
                let kind = if self.is_big { 16 } else { 4 };
                (kind, values.len(), values.iter().flat_map(|&value| self.place(value)).collect())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use areoid_preprocess::raster::{self, ReadOptions, Samples};

    /// Samples that no two pixels near one another share.
    fn samples(format: &Format, rows: Range<u32>) -> Vec<u8> {
        let values = u64::from(format.width) * u64::from(format.bands);
        let bytes = usize::from(format.sample_bytes);
        (u64::from(rows.start) * values..u64::from(rows.end) * values)
            .flat_map(|place| (place * 40_503 % 65_521).to_le_bytes().into_iter().take(bytes))
            .collect()
    }

    #[test]
    fn what_is_written_is_read_in_tiles_and_strips_and_with_both_widths_of_offsets() {
        for blocks in [Blocks::Tiles(16), Blocks::Strips(5)] {
            for offsets in [Offsets::Four, Offsets::Eight] {
                for (bands, sample_bytes, missing) in [(1, 2, Some(-32_768)), (3, 1, None)] {
                    let (width, height) = (74, 37);
                    let place = Place::Globe;
                    let format =
                        Format { width, height, bands, sample_bytes, missing, place, blocks };
                    let file = tempfile::Builder::new().suffix(".tif").tempfile().unwrap();
                    format
                        .write_to(file.as_file(), offsets, |rows| samples(&format, rows))
                        .unwrap();

                    let found = raster::open(file.path(), &ReadOptions::default()).unwrap();
                    let info = found.info();
                    assert_eq!((info.width, info.height, info.bands), (width, height, bands));
                    assert_eq!(info.nodata, missing.map(f64::from));
                    assert_eq!(info.outline.extent(width, height), [-180.0, -90.0, 180.0, 90.0]);
                    assert_eq!(info.crs.unwrap().ellipsoid.a().0, MARS_RADIUS_M);
                    let stride = width as usize * format.pixel_bytes();
                    let (across, down) = info.blocks();
                    for place in 0..across * down {
                        let block = found.read_block(place % across, place / across).unwrap();
                        let at = block.col as usize * format.pixel_bytes();
                        let len = block.width as usize * format.pixel_bytes();
                        let expected = samples(&format, block.row..block.row + block.height);
                        let expected: Vec<u8> = expected
                            .chunks_exact(stride)
                            .flat_map(|row| row[at..at + len].to_vec())
                            .collect();
                        let read: Vec<u8> = match block.samples {
                            Samples::U8(samples) => samples,
                            Samples::I16(samples) => {
                                samples.iter().flat_map(|sample| sample.to_le_bytes()).collect()
                            }
                            other => panic!("{other:?}"),
                        };
                        assert_eq!(read, expected, "{format:?} {offsets:?} block {place}");
                    }
                }
            }
        }
    }
}
