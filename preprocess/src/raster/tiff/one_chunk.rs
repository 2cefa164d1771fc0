//! One chunk decoded by the `tiff` crate: JPEG, and what the reader's own decoder is tested against.
//!
//! The crate decodes it as the only chunk of a file made up in memory: a directory that describes
//! just this chunk, and the chunk's bytes behind it. So decoding needs no pool of decoders and no
//! second table of offsets, any thread can do it, and what the crate would do to a whole raster
//! (planes after the first dropped, palettes refused, white-is-zero inverted, extra samples dropped
//! before the predictor is undone) cannot happen.

use std::io::Cursor;

use tiff::decoder::{Decoder, DecodingResult, Limits};

use super::super::samples::{SampleType, Samples};
use super::decode::{ChunkError, ChunkShape};
use super::directory::ByteOrder;

impl ChunkShape<'_> {
    /// Decodes a chunk of these bytes to `clipped` pixels. LZW and ZSTD must be undone before.
    pub(super) fn decode_with_tiff(&self, chunk: &[u8]) -> Result<Samples, ChunkError> {
        let bytes = usize::try_from(self.encoded_bytes())?;
        let limits = {
            let mut limits = Limits::default();
            limits.decoding_buffer_size = bytes;
            limits.intermediate_buffer_size = chunk.len().max(bytes);
            limits
        };
        let file = self.file_of(chunk)?;
        let decoded = Decoder::new(Cursor::new(file))?.with_limits(limits).read_chunk(0)?;
        let samples = match decoded {
            DecodingResult::U8(values) => Samples::U8(values),
            DecodingResult::I8(values) => Samples::I8(values),
            DecodingResult::U16(values) => Samples::U16(values),
            DecodingResult::I16(values) => Samples::I16(values),
            DecodingResult::U32(values) => Samples::U32(values),
            DecodingResult::I32(values) => Samples::I32(values),
            DecodingResult::F32(values) => Samples::F32(values),
            DecodingResult::F64(values) => Samples::F64(values),
            _ => return Err("the samples decode to another type".into()),
        };
        let (width, height) = (self.clipped.0 as usize, self.clipped.1 as usize);
        let expected = width * height * usize::from(self.samples);
        if samples.len() != expected || samples.sample_type() != self.sample {
            return Err(format!("{} samples decode, not {expected}", samples.len()).into());
        }
        Ok(samples)
    }

    /// A TIFF file of which `chunk` is the only tile.
    fn file_of(&self, chunk: &[u8]) -> Result<Vec<u8>, ChunkError> {
        const HEADER_BYTES: u32 = 8;
        const ENTRY_BYTES: u32 = 12;
        const SHORT: u16 = 3;
        const LONG: u16 = 4;
        const UNDEFINED: u16 = 7;
        let (bits, format): (u16, u16) = match self.sample {
            SampleType::U8 => (8, 1),
            SampleType::I8 => (8, 2),
            SampleType::U16 => (16, 1),
            SampleType::I16 => (16, 2),
            SampleType::U32 => (32, 1),
            SampleType::I32 => (32, 2),
            SampleType::F32 => (32, 3),
            SampleType::F64 => (64, 3),
        };
        let tables = self.jpeg_tables.unwrap_or_default();
        let entry_count = 13 + u16::from(!tables.is_empty());
        let tables_at = HEADER_BYTES + 2 + u32::from(entry_count) * ENTRY_BYTES + 4;
        let chunk_at = tables_at + u32::try_from(tables.len())?;

        let mut file = Output { order: self.order, bytes: Vec::new() };
        file.bytes.reserve_exact(chunk_at as usize + chunk.len());
        file.bytes.extend(match self.order {
            ByteOrder::Little => b"II",
            ByteOrder::Big => b"MM",
        });
        file.short(42);
        file.long(HEADER_BYTES);
        file.short(entry_count);
        file.entry(256, LONG, self.clipped.0);
        file.entry(257, LONG, self.clipped.1);
        file.entry(258, SHORT, bits.into());
        file.entry(259, SHORT, self.compression.code().into());
        file.entry(262, SHORT, 1); // gray, whatever the samples mean: nothing is converted
        file.entry(277, SHORT, self.samples.into());
        file.entry(284, SHORT, 1);
        file.entry(317, SHORT, self.predictor.into());
        file.entry(322, LONG, self.encoded.0);
        file.entry(323, LONG, self.encoded.1);
        file.entry(324, LONG, chunk_at);
        file.entry(325, LONG, u32::try_from(chunk.len())?);
        file.entry(339, SHORT, format.into());
        if !tables.is_empty() {
            file.short(347);
            file.short(UNDEFINED);
            file.long(u32::try_from(tables.len())?);
            file.long(tables_at);
        }
        file.long(0);
        file.bytes.extend(tables);
        file.bytes.extend(chunk);
        Ok(file.bytes)
    }

    /// Checks the size that a JPEG stream claims, which would size the decoder's buffers.
    pub(super) fn check_jpeg(&self, chunk: &[u8]) -> Result<(), ChunkError> {
        let (width, height, components) = jpeg_frame(chunk).ok_or("no JPEG frame")?;
        let (wanted_width, wanted_height) = self.encoded;
        let fits = u32::from(width) == wanted_width
            && u32::from(height) >= self.clipped.1
            && u32::from(height) <= wanted_height
            && u16::from(components) == self.samples;
        if !fits {
            return Err(format!(
                "a JPEG frame of {width} × {height} with {components} components, \
                 not {wanted_width} × {wanted_height} with {}",
                self.samples
            )
            .into());
        }
        Ok(())
    }
}

/// Bytes in a file's order.
struct Output {
    order: ByteOrder,
    bytes: Vec<u8>,
}

impl Output {
    fn short(&mut self, value: u16) {
        self.bytes.extend(match self.order {
            ByteOrder::Little => value.to_le_bytes(),
            #[expect(clippy::big_endian_bytes, reason = "the order of the file being read")]
            ByteOrder::Big => value.to_be_bytes(),
        });
    }

    fn long(&mut self, value: u32) {
        self.bytes.extend(match self.order {
            ByteOrder::Little => value.to_le_bytes(),
            #[expect(clippy::big_endian_bytes, reason = "the order of the file being read")]
            ByteOrder::Big => value.to_be_bytes(),
        });
    }

    /// An entry with one value of type SHORT (3) or LONG (4).
    fn entry(&mut self, tag: u16, kind: u16, value: u32) {
        self.short(tag);
        self.short(kind);
        self.long(1);
        match u16::try_from(value) {
            Ok(value) if kind == 3 => {
                self.short(value);
                self.short(0);
            }
            _ => self.long(value),
        }
    }
}

/// Width, height and components of a JPEG stream's frame.
fn jpeg_frame(stream: &[u8]) -> Option<(u16, u16, u8)> {
    let short = |at: usize| Some(ByteOrder::Big.u16(stream.get(at..at + 2)?));
    let mut at = 2;
    loop {
        let &[0xff, marker] = stream.get(at..at + 2)? else { return None };
        match marker {
            0xff => at += 1,
            0x01 | 0xd0..=0xd8 => at += 2,
            // Start of frame, but for the codes of tables that share its range.
            0xc0..=0xcf if !matches!(marker, 0xc4 | 0xc8 | 0xcc) => {
                return Some((short(at + 7)?, short(at + 5)?, *stream.get(at + 9)?));
            }
            0xd9 | 0xda => return None,
            _ => at += 2 + usize::from(short(at + 2)?),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jpeg_frame_is_found_behind_other_segments() {
        let stream = [
            &[0xff, 0xd8, 0xff, 0xe0, 0, 4, 1, 2][..],
            &[0xff, 0xc4, 0, 3, 9],
            &[0xff, 0xc0, 0, 11, 8, 1, 0, 2, 0, 3],
        ]
        .concat();
        assert_eq!(jpeg_frame(&stream), Some((512, 256, 3)));
        for len in 0..stream.len() {
            assert_eq!(jpeg_frame(&stream[..len]), None);
        }
    }
}
