//! The directory of a TIFF or BigTIFF file: which values it has, and where.
//!
//! ```text
//! "II" or "MM"  42  offset ──▶ count × { tag  type  count  value or its offset }  next offset ──▶ ..
//! ```
//!
//! The `tiff` crate has a directory reader of its own; it is not used here because it refuses value
//! tables above 1 MiB, which a raster of 130,000 tiles has, and does not say where in the file a
//! fault is. Values are read when they are asked for and are never longer than the file.

use std::collections::BTreeMap;

use super::super::error::RasterError;
use super::super::file::PositionedFile;

/// The order of bytes in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ByteOrder {
    /// `II`.
    Little,
    /// `MM`.
    Big,
}

impl ByteOrder {
    /// That of this machine.
    pub(crate) const HOST: Self =
        if cfg!(target_endian = "little") { Self::Little } else { Self::Big };
}

/// Numbers as a byte order writes them.
macro_rules! from_bytes {
    ($($name:ident: $type:ty, $bytes:literal);* $(;)?) => {
        impl ByteOrder {$(
            /// The number at the start of `bytes`; bytes that are missing count as zeros.
            pub(crate) fn $name(self, bytes: &[u8]) -> $type {
                let mut exact = [0; $bytes];
                for (to, from) in exact.iter_mut().zip(bytes) {
                    *to = *from;
                }
                match self {
                    Self::Little => <$type>::from_le_bytes(exact),
                    #[expect(clippy::big_endian_bytes, reason = "half of all TIFF files are")]
                    Self::Big => <$type>::from_be_bytes(exact),
                }
            }
        )*}
    };
}
from_bytes! { u16: u16, 2; u32: u32, 4; u64: u64, 8; f32: f32, 4; f64: f64, 8 }

/// Where a tag's values are.
#[derive(Clone, Copy, Debug)]
struct Entry {
    kind: u16,
    count: u64,
    /// Offset of the first value in the file.
    offset: u64,
}

/// One directory: a raster, an overview or a mask.
#[derive(Debug)]
pub(crate) struct Directory {
    entries: BTreeMap<u16, Entry>,
    /// Offset of the directory in the file.
    pub(crate) offset: u64,
    /// Offset of the next directory, 0 after the last.
    next: u64,
}

/// A TIFF file of which the header was understood.
#[derive(Debug)]
pub(crate) struct TiffFile {
    pub(crate) file: PositionedFile,
    pub(crate) order: ByteOrder,
    big: bool,
    first: u64,
}

impl TiffFile {
    /// Reads the header.
    pub(crate) fn new(file: PositionedFile) -> Result<Self, RasterError> {
        let path = file.path().to_owned();
        let header = file.read("the TIFF header", 0, 8)?;
        let order = match &header[..2] {
            b"II" => ByteOrder::Little,
            b"MM" => ByteOrder::Big,
            found => {
                let found = format!("{found:02x?}");
                return Err(RasterError::field(&path, "byte order", 0, found, "II or MM"));
            }
        };
        match order.u16(&header[2..]) {
            42 => {
                let first = u64::from(order.u32(&header[4..]));
                Ok(Self { file, order, big: false, first })
            }
            43 => {
                let header = file.read("the BigTIFF header", 0, 16)?;
                let offset_bytes = order.u16(&header[4..]);
                if offset_bytes != 8 {
                    let field = "BigTIFF offset size";
                    return Err(RasterError::field(&path, field, 4, offset_bytes, "8"));
                }
                Ok(Self { first: order.u64(&header[8..]), file, order, big: true })
            }
            found => Err(RasterError::field(&path, "TIFF version", 2, found, "42 or 43")),
        }
    }

    /// The first directory: the raster.
    pub(crate) fn first_directory(&self) -> Result<Directory, RasterError> {
        self.directory(self.first)
    }

    /// The directory after `directory`, if there is one.
    pub(crate) fn next_directory(
        &self,
        directory: &Directory,
    ) -> Result<Option<Directory>, RasterError> {
        if directory.next == 0 { Ok(None) } else { self.directory(directory.next).map(Some) }
    }

    fn directory(&self, offset: u64) -> Result<Directory, RasterError> {
        let what = "a TIFF directory";
        let (count_bytes, entry_bytes, next_bytes) = if self.big { (8, 20, 8) } else { (2, 12, 4) };
        let head = self.file.read(what, offset, count_bytes)?;
        let count = if self.big { self.order.u64(&head) } else { self.order.u16(&head).into() };
        if count == 0 || count > u64::from(u16::MAX) {
            let field = "number of directory entries";
            return Err(RasterError::field(self.file.path(), field, offset, count, "1 to 65535"));
        }
        let start = offset + count_bytes;
        let body = self.file.read(what, start, count * entry_bytes + next_bytes)?;

        let mut entries = BTreeMap::new();
        let mut at = start;
        let mut rest = &body[..];
        for _ in 0..count {
            let (bytes, after) = rest.split_at(if self.big { 20 } else { 12 });
            if let Some((tag, entry)) = self.entry(bytes, at) {
                entries.insert(tag, entry);
            }
            (rest, at) = (after, at + entry_bytes);
        }
        let next = if self.big { self.order.u64(rest) } else { self.order.u32(rest).into() };
        Ok(Directory { entries, offset, next })
    }

    /// The entry in `bytes`, which begin at `at` in the file; `None` if its type is unknown.
    fn entry(&self, bytes: &[u8], at: u64) -> Option<(u16, Entry)> {
        let order = self.order;
        let (tag, kind) = (order.u16(bytes), order.u16(&bytes[2..]));
        let (count, inline_bytes) =
            if self.big { (order.u64(&bytes[4..]), 8) } else { (order.u32(&bytes[4..]).into(), 4) };
        let field = if self.big { 12 } else { 8 };
        let offset = if count.saturating_mul(value_bytes(kind)?) <= inline_bytes {
            at + field as u64
        } else if self.big {
            order.u64(&bytes[field..])
        } else {
            order.u32(&bytes[field..]).into()
        };
        Some((tag, Entry { kind, count, offset }))
    }

    /// The bytes of a tag's values, their type and offset; `None` if the directory has no such tag.
    fn raw(
        &self,
        directory: &Directory,
        tag: Tag,
    ) -> Result<Option<(Vec<u8>, u16, u64)>, RasterError> {
        let Some(&Entry { kind, count, offset }) = directory.entries.get(&tag.0) else {
            return Ok(None);
        };
        let bytes = count.saturating_mul(value_bytes(kind).unwrap_or(1));
        Ok(Some((self.file.read(tag.1, offset, bytes)?, kind, offset)))
    }

    /// All values of a tag of whole numbers.
    pub(crate) fn integers(
        &self,
        directory: &Directory,
        tag: Tag,
    ) -> Result<Option<Vec<u64>>, RasterError> {
        let Some((bytes, kind, offset)) = self.raw(directory, tag)? else { return Ok(None) };
        let order = self.order;
        Ok(Some(match kind {
            1 | 7 => bytes.iter().copied().map(u64::from).collect(),
            3 => bytes.chunks_exact(2).map(|value| order.u16(value).into()).collect(),
            4 | 13 => bytes.chunks_exact(4).map(|value| order.u32(value).into()).collect(),
            16 | 18 => bytes.chunks_exact(8).map(|value| order.u64(value)).collect(),
            _ => return Err(self.wrong_type(tag, kind, offset, "whole numbers")),
        }))
    }

    /// The first value of a tag of whole numbers.
    pub(crate) fn integer(
        &self,
        directory: &Directory,
        tag: Tag,
    ) -> Result<Option<u64>, RasterError> {
        Ok(self.integers(directory, tag)?.and_then(|values| values.first().copied()))
    }

    /// All values of a tag of floating-point numbers.
    pub(crate) fn floats(
        &self,
        directory: &Directory,
        tag: Tag,
    ) -> Result<Option<Vec<f64>>, RasterError> {
        let Some((bytes, kind, offset)) = self.raw(directory, tag)? else { return Ok(None) };
        let order = self.order;
        Ok(Some(match kind {
            11 => bytes.chunks_exact(4).map(|value| order.f32(value).into()).collect(),
            12 => bytes.chunks_exact(8).map(|value| order.f64(value)).collect(),
            _ => return Err(self.wrong_type(tag, kind, offset, "floating-point numbers")),
        }))
    }

    /// A tag of text, up to its first NUL.
    pub(crate) fn text(
        &self,
        directory: &Directory,
        tag: Tag,
    ) -> Result<Option<String>, RasterError> {
        let Some((bytes, _, _)) = self.raw(directory, tag)? else { return Ok(None) };
        let text = bytes.split(|&byte| byte == 0).next().unwrap_or_default();
        Ok(Some(String::from_utf8_lossy(text).into_owned()))
    }

    /// Where a tag's values are in the file, for messages.
    pub(crate) fn offset_of(directory: &Directory, tag: Tag) -> u64 {
        directory.entries.get(&tag.0).map_or(directory.offset, |entry| entry.offset)
    }

    /// An error that names a tag, what it holds and what it should hold.
    pub(crate) fn wrong(
        &self,
        directory: &Directory,
        tag: Tag,
        found: impl ToString,
        expected: impl Into<String>,
    ) -> RasterError {
        let offset = Self::offset_of(directory, tag);
        RasterError::field(self.file.path(), tag.to_string(), offset, found, expected)
    }

    fn wrong_type(&self, tag: Tag, kind: u16, offset: u64, expected: &str) -> RasterError {
        let field = format!("the type of {tag}");
        RasterError::field(self.file.path(), field, offset, kind, format!("a type of {expected}"))
    }
}

/// Bytes of a value of a TIFF type, or `None` for types that TIFF does not have.
const fn value_bytes(kind: u16) -> Option<u64> {
    match kind {
        1 | 2 | 6 | 7 => Some(1),
        3 | 8 => Some(2),
        4 | 9 | 11 | 13 => Some(4),
        5 | 10 | 12 | 16 | 17 | 18 => Some(8),
        _ => None,
    }
}

/// A tag's number and name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Tag(pub(crate) u16, pub(crate) &'static str);

impl std::fmt::Display for Tag {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} (tag {})", self.1, self.0)
    }
}

/// The tags read here.
pub(crate) mod tags {
    use super::Tag;

    pub(crate) const NEW_SUBFILE_TYPE: Tag = Tag(254, "NewSubfileType");
    pub(crate) const IMAGE_WIDTH: Tag = Tag(256, "ImageWidth");
    pub(crate) const IMAGE_LENGTH: Tag = Tag(257, "ImageLength");
    pub(crate) const BITS_PER_SAMPLE: Tag = Tag(258, "BitsPerSample");
    pub(crate) const COMPRESSION: Tag = Tag(259, "Compression");
    pub(crate) const PHOTOMETRIC: Tag = Tag(262, "PhotometricInterpretation");
    pub(crate) const FILL_ORDER: Tag = Tag(266, "FillOrder");
    pub(crate) const STRIP_OFFSETS: Tag = Tag(273, "StripOffsets");
    pub(crate) const SAMPLES_PER_PIXEL: Tag = Tag(277, "SamplesPerPixel");
    pub(crate) const ROWS_PER_STRIP: Tag = Tag(278, "RowsPerStrip");
    pub(crate) const STRIP_BYTE_COUNTS: Tag = Tag(279, "StripByteCounts");
    pub(crate) const PLANAR_CONFIGURATION: Tag = Tag(284, "PlanarConfiguration");
    pub(crate) const PREDICTOR: Tag = Tag(317, "Predictor");
    pub(crate) const COLOR_MAP: Tag = Tag(320, "ColorMap");
    pub(crate) const TILE_WIDTH: Tag = Tag(322, "TileWidth");
    pub(crate) const TILE_LENGTH: Tag = Tag(323, "TileLength");
    pub(crate) const TILE_OFFSETS: Tag = Tag(324, "TileOffsets");
    pub(crate) const TILE_BYTE_COUNTS: Tag = Tag(325, "TileByteCounts");
    pub(crate) const EXTRA_SAMPLES: Tag = Tag(338, "ExtraSamples");
    pub(crate) const SAMPLE_FORMAT: Tag = Tag(339, "SampleFormat");
    pub(crate) const JPEG_TABLES: Tag = Tag(347, "JPEGTables");
    pub(crate) const MODEL_PIXEL_SCALE: Tag = Tag(33550, "ModelPixelScale");
    pub(crate) const MODEL_TIEPOINT: Tag = Tag(33922, "ModelTiepoint");
    pub(crate) const MODEL_TRANSFORMATION: Tag = Tag(34264, "ModelTransformation");
    pub(crate) const GEO_KEY_DIRECTORY: Tag = Tag(34735, "GeoKeyDirectory");
    pub(crate) const GEO_DOUBLE_PARAMS: Tag = Tag(34736, "GeoDoubleParams");
    pub(crate) const GEO_ASCII_PARAMS: Tag = Tag(34737, "GeoAsciiParams");
    pub(crate) const GDAL_METADATA: Tag = Tag(42112, "GDAL_METADATA");
    pub(crate) const GDAL_NODATA: Tag = Tag(42113, "GDAL_NODATA");
}
