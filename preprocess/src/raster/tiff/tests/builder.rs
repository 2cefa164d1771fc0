//! TIFF files made byte by byte, of every layout that the reader should understand.

use std::path::PathBuf;

use super::super::super::samples::SampleType;
use super::super::directory::{ByteOrder, Tag, tags};

/// The values of a tag.
#[derive(Clone, Debug)]
pub(super) enum Values {
    Short(Vec<u16>),
    Long(Vec<u32>),
    Double(Vec<f64>),
    Text(&'static str),
}

/// A raster to be written.
#[derive(Clone, Debug)]
pub(super) struct TestTiff {
    pub(super) order: ByteOrder,
    pub(super) big: bool,
    pub(super) size: (u32, u32),
    pub(super) bands: u16,
    pub(super) sample: SampleType,
    /// Width and height of tiles, or the width and rows of strips.
    pub(super) chunk: (u32, u32),
    pub(super) tiled: bool,
    pub(super) planar: bool,
    pub(super) compression: u16,
    pub(super) predictor: u16,
    /// Tags besides those of the layout; they replace those.
    pub(super) tags: Vec<(Tag, Values)>,
    /// Chunks that are left out.
    pub(super) sparse: Vec<usize>,
    /// A second directory of this `NewSubfileType`.
    pub(super) second_directory: Option<u32>,
}

/// A raster of one band on the whole globe.
pub(super) fn globe(size: (u32, u32), sample: SampleType) -> TestTiff {
    let scale = vec![360.0 / f64::from(size.0), 180.0 / f64::from(size.1), 0.0];
    TestTiff {
        order: ByteOrder::Little,
        big: false,
        size,
        bands: 1,
        sample,
        chunk: (16, 16),
        tiled: true,
        planar: false,
        compression: 1,
        predictor: 1,
        tags: vec![
            (tags::MODEL_PIXEL_SCALE, Values::Double(scale)),
            (tags::MODEL_TIEPOINT, Values::Double(vec![0.0, 0.0, 0.0, -180.0, 90.0, 0.0])),
            (
                tags::GEO_KEY_DIRECTORY,
                Values::Short(vec![1, 1, 0, 2, 1024, 0, 1, 2, 2048, 0, 1, 4326]),
            ),
        ],
        sparse: Vec::new(),
        second_directory: None,
    }
}

/// The sample written at a column, row and band: different everywhere, and in any type.
pub(super) fn value_at(col: u32, row: u32, band: u16) -> f64 {
    f64::from((col * 7 + row * 13 + u32::from(band) * 29) % 120)
}

impl TestTiff {
    pub(super) fn with(mut self, tag: Tag, values: Values) -> Self {
        self.tags.push((tag, values));
        self
    }

    pub(super) fn without(mut self, tag: Tag) -> Self {
        self.tags.retain(|(found, _)| *found != tag);
        self
    }

    /// The samples of a window, as the reader should hand them out.
    pub(super) fn expected(&self, [col, row, width, height]: [u32; 4]) -> Vec<f64> {
        let mut values = Vec::new();
        for row in row..row + height {
            for col in col..col + width {
                values.extend((0..self.bands).map(|band| value_at(col, row, band)));
            }
        }
        values
    }

    pub(super) fn write(&self, folder: &tempfile::TempDir) -> PathBuf {
        let path = folder.path().join("test.tif");
        std::fs::write(&path, self.bytes()).unwrap();
        path
    }

    /// The file.
    pub(super) fn bytes(&self) -> Vec<u8> {
        let mut file = Writer { order: self.order, bytes: Vec::new() };
        file.bytes.extend(if self.order == ByteOrder::Little { b"II" } else { b"MM" });
        file.number(2, if self.big { 43 } else { 42 });
        if self.big {
            file.number(2, 8);
            file.number(2, 0);
        }
        let pointer_at = file.bytes.len();
        let word = if self.big { 8 } else { 4 };
        file.number(word, 0);

        let (mut offsets, mut counts) = (Vec::new(), Vec::new());
        for (index, chunk) in self.chunks().into_iter().enumerate() {
            let sparse = self.sparse.contains(&index);
            offsets.push(if sparse { 0 } else { u32::try_from(file.bytes.len()).unwrap() });
            counts.push(if sparse { 0 } else { u32::try_from(chunk.len()).unwrap() });
            if !sparse {
                file.bytes.extend(chunk);
            }
        }
        let mut entries = self.layout_tags(offsets, counts);
        for (tag, values) in &self.tags {
            entries.retain(|(found, _)| found != tag);
            entries.push((*tag, values.clone()));
        }
        entries.sort_by_key(|(tag, _)| tag.0);
        let first = self.directory(&mut file, &entries, 0);
        let (at, next_at) = first;
        file.patch(pointer_at, word, at);
        if let Some(kind) = self.second_directory {
            entries.push((tags::NEW_SUBFILE_TYPE, Values::Long(vec![kind])));
            entries.sort_by_key(|(tag, _)| tag.0);
            let (second, _) = self.directory(&mut file, &entries, 0);
            file.patch(next_at, word, second);
        }
        file.bytes
    }

    /// Writes a directory; its offset, and that of the pointer to the next one.
    fn directory(&self, file: &mut Writer, entries: &[(Tag, Values)], next: u64) -> (u64, usize) {
        let word = if self.big { 8 } else { 4 };
        let mut fields = Vec::new();
        for (tag, values) in entries {
            let (kind, count, bytes) = file.values(values);
            let mut field = Writer { order: self.order, bytes: Vec::new() };
            field.number(2, tag.0.into());
            field.number(2, kind);
            field.number(word, count);
            if bytes.len() <= word {
                field.bytes.extend(&bytes);
                field.bytes.resize(4 + 2 * word, 0);
            } else {
                field.number(word, file.bytes.len() as u64);
                file.bytes.extend(bytes);
            }
            fields.push(field.bytes);
        }
        let at = file.bytes.len() as u64;
        file.number(if self.big { 8 } else { 2 }, fields.len() as u64);
        file.bytes.extend(fields.concat());
        let next_at = file.bytes.len();
        file.number(word, next);
        (at, next_at)
    }

    fn layout_tags(&self, offsets: Vec<u32>, counts: Vec<u32>) -> Vec<(Tag, Values)> {
        let bits = u16::try_from(self.sample.bytes() * 8).unwrap();
        let format = match self.sample {
            SampleType::U8 | SampleType::U16 | SampleType::U32 => 1,
            SampleType::I8 | SampleType::I16 | SampleType::I32 => 2,
            SampleType::F32 | SampleType::F64 => 3,
        };
        let short = |value| Values::Short(vec![value]);
        let bands = usize::from(self.bands);
        let mut entries = vec![
            (tags::IMAGE_WIDTH, Values::Long(vec![self.size.0])),
            (tags::IMAGE_LENGTH, Values::Long(vec![self.size.1])),
            (tags::BITS_PER_SAMPLE, Values::Short(vec![bits; bands])),
            (tags::COMPRESSION, short(self.compression)),
            (tags::PHOTOMETRIC, short(if self.bands >= 3 { 2 } else { 1 })),
            (tags::SAMPLES_PER_PIXEL, short(self.bands)),
            (tags::PLANAR_CONFIGURATION, short(if self.planar { 2 } else { 1 })),
            (tags::PREDICTOR, short(self.predictor)),
            (tags::SAMPLE_FORMAT, Values::Short(vec![format; bands])),
        ];
        entries.extend(if self.tiled {
            vec![
                (tags::TILE_WIDTH, Values::Long(vec![self.chunk.0])),
                (tags::TILE_LENGTH, Values::Long(vec![self.chunk.1])),
                (tags::TILE_OFFSETS, Values::Long(offsets)),
                (tags::TILE_BYTE_COUNTS, Values::Long(counts)),
            ]
        } else {
            vec![
                (tags::ROWS_PER_STRIP, Values::Long(vec![self.chunk.1])),
                (tags::STRIP_OFFSETS, Values::Long(offsets)),
                (tags::STRIP_BYTE_COUNTS, Values::Long(counts)),
            ]
        });
        entries
    }

    /// The chunks' bytes, plane after plane.
    fn chunks(&self) -> Vec<Vec<u8>> {
        let (width, height) = self.chunk;
        let planes: Vec<Vec<u16>> = if self.planar {
            (0..self.bands).map(|band| vec![band]).collect()
        } else {
            vec![(0..self.bands).collect()]
        };
        let mut chunks = Vec::new();
        for bands in &planes {
            for down in 0..self.size.1.div_ceil(height) {
                for across in 0..self.size.0.div_ceil(width) {
                    let rows =
                        if self.tiled { height } else { height.min(self.size.1 - down * height) };
                    let mut bytes = Vec::new();
                    for row in down * height..down * height + rows {
                        bytes.extend(self.row(across * width, row, width, bands));
                    }
                    chunks.push(self.compressed(bytes));
                }
            }
        }
        chunks
    }

    /// The bytes of a row of a chunk, after prediction.
    fn row(&self, col: u32, row: u32, width: u32, bands: &[u16]) -> Vec<u8> {
        let pixels = (col..col + width).flat_map(|col| bands.iter().map(move |&band| (col, band)));
        // Tiles are padded with the raster's last pixels, as GDAL does.
        let (last_col, last_row) = (self.size.0 - 1, self.size.1 - 1);
        let value = |(col, band): (u32, u16)| value_at(col.min(last_col), row.min(last_row), band);
        let values: Vec<f64> = pixels.map(value).collect();
        let mut bytes = Writer { order: self.order, bytes: Vec::new() };
        let bands = bands.len();
        match self.predictor {
            2 => {
                assert!(!self.sample.is_float(), "the test writes integers with this predictor");
                for (index, value) in values.iter().enumerate() {
                    let before = if index < bands { 0.0 } else { values[index - bands] };
                    bytes.sample(self.sample, value - before);
                }
                bytes.bytes
            }
            3 => {
                let mut big = Writer { order: ByteOrder::Big, bytes: Vec::new() };
                values.iter().for_each(|&value| big.sample(self.sample, value));
                let size = self.sample.bytes();
                let mut planes: Vec<u8> = Vec::new();
                for byte in 0..size {
                    planes.extend(big.bytes.iter().skip(byte).step_by(size));
                }
                let mut predicted = planes.clone();
                for index in bands..planes.len() {
                    predicted[index] = planes[index].wrapping_sub(planes[index - bands]);
                }
                predicted
            }
            _ => {
                values.iter().for_each(|&value| bytes.sample(self.sample, value));
                bytes.bytes
            }
        }
    }

    fn compressed(&self, bytes: Vec<u8>) -> Vec<u8> {
        match self.compression {
            1 => bytes,
            5 => weezl::encode::Encoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8)
                .encode(&bytes)
                .unwrap(),
            8 => stored_zlib(&bytes),
            // Runs of up to 128 bytes as they are.
            32773 => bytes
                .chunks(128)
                .flat_map(|run| [&[u8::try_from(run.len() - 1).unwrap()], run].concat())
                .collect(),
            50000 => ruzstd::encoding::compress_to_vec(
                &bytes[..],
                ruzstd::encoding::CompressionLevel::Fastest,
            ),
            other => panic!("the test does not compress with {other}"),
        }
    }
}

/// A zlib stream of stored blocks.
pub(super) fn stored_zlib(bytes: &[u8]) -> Vec<u8> {
    let mut stream = vec![0x78, 0x01];
    let blocks = bytes.chunks(0xffff).count();
    for (index, block) in bytes.chunks(0xffff).enumerate() {
        let len = u16::try_from(block.len()).unwrap();
        stream.push(u8::from(index + 1 == blocks));
        stream.extend(len.to_le_bytes());
        stream.extend((!len).to_le_bytes());
        stream.extend(block);
    }
    let (mut a, mut b) = (1_u32, 0_u32);
    for &byte in bytes {
        a = (a + u32::from(byte)) % 65521;
        b = (b + a) % 65521;
    }
    let mut end = Writer { order: ByteOrder::Big, bytes: stream };
    end.number(4, u64::from(b << 16 | a));
    end.bytes
}

/// Numbers in a byte order.
struct Writer {
    order: ByteOrder,
    bytes: Vec<u8>,
}

impl Writer {
    fn number(&mut self, size: usize, value: u64) {
        let little = value.to_le_bytes();
        match self.order {
            ByteOrder::Little => self.bytes.extend(&little[..size]),
            ByteOrder::Big => self.bytes.extend(little[..size].iter().rev()),
        }
    }

    fn patch(&mut self, at: usize, size: usize, value: u64) {
        let end = self.bytes.split_off(at + size);
        self.bytes.truncate(at);
        self.number(size, value);
        self.bytes.extend(end);
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "the low bytes of a small difference are what a predictor stores"
    )]
    fn sample(&mut self, sample: SampleType, value: f64) {
        match sample {
            SampleType::F32 => self.number(4, (value as f32).to_bits().into()),
            SampleType::F64 => self.number(8, value.to_bits()),
            _ => self.number(sample.bytes(), value as i64 as u64),
        }
    }

    /// Type, count and bytes of a tag's values.
    fn values(&self, values: &Values) -> (u64, u64, Vec<u8>) {
        let mut out = Self { order: self.order, bytes: Vec::new() };
        let (kind, count) = match values {
            Values::Short(values) => {
                values.iter().for_each(|&value| out.number(2, value.into()));
                (3, values.len())
            }
            Values::Long(values) => {
                values.iter().for_each(|&value| out.number(4, value.into()));
                (4, values.len())
            }
            Values::Double(values) => {
                values.iter().for_each(|&value| out.number(8, value.to_bits()));
                (12, values.len())
            }
            Values::Text(text) => {
                out.bytes.extend(text.bytes());
                out.bytes.push(0);
                (2, text.len() + 1)
            }
        };
        (kind, count as u64, out.bytes)
    }
}
