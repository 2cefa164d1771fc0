//! One chunk of a TIFF file, from its bytes to samples.
//!
//! ```text
//!   bytes ──decompress──▶ encoded rows ──cut──▶ rows in the raster ──order, predictor──▶ samples
//!              └── straight into the samples where nothing is cut ──┘
//! ```
//!
//! Rows below the raster's edge are not decompressed. JPEG is left to the `tiff` crate; the rest is
//! not, because that reads a chunk as a file, row by row, through buffers of its own. Its ZSTD is a
//! C library besides, and its LZW reader takes the end of some whole streams for an unexpected one
//! (`tiff` 0.11.3: the last bytes come out when no input is left, which it calls no progress).

use std::cell::RefCell;
use std::io::Read;

use zune_inflate::errors::DecodeErrorStatus;
use zune_inflate::{DeflateDecoder, DeflateOptions};

use super::super::samples::SampleType;
use super::directory::ByteOrder;
use super::layout::Compression;
use super::predictor;

/// Buffers larger than this are given back after each chunk, in bytes.
const KEPT_BYTES: usize = 16 << 20;

/// What a chunk's bytes mean.
#[derive(Clone, Copy, Debug)]
pub(super) struct ChunkShape<'tables> {
    pub(super) order: ByteOrder,
    pub(super) compression: Compression,
    pub(super) predictor: u16,
    pub(super) jpeg_tables: Option<&'tables [u8]>,
    pub(super) sample: SampleType,
    /// Samples of a pixel.
    pub(super) samples: u16,
    /// Pixels as encoded.
    pub(super) encoded: (u32, u32),
    /// Pixels inside the raster: those decoded.
    pub(super) clipped: (u32, u32),
}

/// Why a chunk does not decode.
pub(super) type ChunkError = Box<dyn std::error::Error + Send + Sync>;

/// What decoding needs besides its input and output, kept from chunk to chunk.
#[derive(Debug, Default)]
pub(super) struct Workspace {
    encoded_rows: Vec<u8>,
}

/// What a thread keeps from block to block: a chunk as read, and the decoder's workspace.
#[derive(Debug, Default)]
pub(super) struct Scratch {
    pub(super) chunk: Vec<u8>,
    pub(super) workspace: Workspace,
}

impl Scratch {
    /// Calls `read` with the scratch of this thread, which must not ask for it again.
    pub(super) fn with<T>(read: impl FnOnce(&mut Self) -> T) -> T {
        thread_local!(static SCRATCH: RefCell<Scratch> = RefCell::default());
        SCRATCH.with_borrow_mut(|scratch| {
            let result = read(scratch);
            for buffer in [&mut scratch.chunk, &mut scratch.workspace.encoded_rows] {
                if buffer.capacity() > KEPT_BYTES {
                    *buffer = Vec::new();
                }
            }
            result
        })
    }
}

impl ChunkShape<'_> {
    /// Bytes of the samples as encoded, before compression.
    pub(super) fn encoded_bytes(&self) -> u64 {
        let pixels = u64::from(self.encoded.0) * u64::from(self.encoded.1);
        pixels.saturating_mul(self.pixel_bytes() as u64)
    }

    /// Bytes of the samples inside the raster.
    pub(super) fn clipped_bytes(&self) -> usize {
        self.clipped.0 as usize * self.clipped.1 as usize * self.pixel_bytes()
    }

    fn pixel_bytes(&self) -> usize {
        usize::from(self.samples) * self.sample.bytes()
    }

    /// Refuses a chunk that is too short for its samples, before they are allocated.
    pub(super) fn check_length(&self, chunk: &[u8]) -> Result<(), ChunkError> {
        let greatest = self.compression.greatest_ratio();
        if (chunk.len() as u64).saturating_mul(greatest) < self.encoded_bytes() {
            let (found, wanted) = (chunk.len(), self.encoded_bytes());
            return Err(format!("{found} bytes cannot hold {wanted} of samples").into());
        }
        Ok(())
    }

    /// Decodes a chunk that [`Self::check_length`] accepted to the samples of its `clipped` pixels,
    /// in the host's order of bytes.
    ///
    /// # Panics
    ///
    /// If `out` has not [`Self::clipped_bytes`], or is not aligned as its samples are.
    pub(super) fn decode_into(
        &self,
        chunk: &[u8],
        workspace: &mut Workspace,
        out: &mut [u8],
    ) -> Result<(), ChunkError> {
        assert_eq!(out.len(), self.clipped_bytes(), "the output is that of the chunk");
        if self.compression == Compression::Jpeg {
            self.check_jpeg(chunk)?;
            out.copy_from_slice(self.decode_with_tiff(chunk)?.as_bytes());
            return Ok(());
        }
        let pixel_bytes = self.pixel_bytes();
        let encoded_row = self.encoded.0 as usize * pixel_bytes;
        let clipped_row = self.clipped.0 as usize * pixel_bytes;
        let Workspace { encoded_rows } = workspace;
        if encoded_row == clipped_row && self.predictor != 3 {
            self.decompress(chunk, out)?;
        } else {
            // Zeros are needed only where the buffer grows.
            encoded_rows.resize(encoded_row * self.clipped.1 as usize, 0);
            self.decompress(chunk, encoded_rows)?;
            let rows = encoded_rows.chunks_exact_mut(encoded_row);
            for (from, to) in rows.zip(out.chunks_exact_mut(clipped_row)) {
                match (self.predictor, self.sample) {
                    (3, SampleType::F32) => {
                        predictor::undo_floating::<4>(from, self.samples.into(), to);
                    }
                    (3, SampleType::F64) => {
                        predictor::undo_floating::<8>(from, self.samples.into(), to);
                    }
                    _ => to.copy_from_slice(&from[..clipped_row]),
                }
            }
        }
        let bytes = self.sample.bytes();
        // The floating-point predictor has an order of its own.
        if self.predictor != 3 && self.order != ByteOrder::HOST {
            predictor::swap_bytes(out, bytes);
        }
        if self.predictor == 2 {
            predictor::undo_horizontal(out, clipped_row, bytes, self.samples.into());
        }
        Ok(())
    }

    /// Fills `out` with the first bytes that the chunk stands for; what follows is not looked at.
    fn decompress(&self, chunk: &[u8], out: &mut [u8]) -> Result<(), ChunkError> {
        match self.compression {
            Compression::None => {
                let bytes = chunk.get(..out.len());
                out.copy_from_slice(bytes.ok_or_else(|| too_short(chunk.len(), out.len()))?);
                Ok(())
            }
            Compression::Deflate => inflate(chunk, usize::try_from(self.encoded_bytes())?, out),
            Compression::Lzw => unlzw(chunk, out),
            Compression::Zstd => unzstd(chunk, out),
            Compression::PackBits => unpack_bits(chunk, out),
            Compression::Jpeg => unreachable!("JPEG is decoded elsewhere"),
        }
    }
}

fn too_short(found: usize, wanted: usize) -> ChunkError {
    format!("{found} bytes decode, not {wanted}").into()
}

/// Fills `out` from a zlib stream that stands for `whole` bytes. A stream without its checksum, or
/// with more behind what is wanted, will do; one with a wrong checksum will not.
fn inflate(chunk: &[u8], whole: usize, out: &mut [u8]) -> Result<(), ChunkError> {
    // The decoder writes ahead: with less room it moves all it has to a larger place at the end.
    const AHEAD: usize = 1024;
    let options = DeflateOptions::default()
        .set_confirm_checksum(true)
        .set_size_hint(whole + AHEAD)
        .set_limit(whole);
    let decoded = match DeflateDecoder::new_with_options(chunk, options).decode_zlib() {
        Ok(decoded) => decoded,
        Err(error) => match error.error {
            DecodeErrorStatus::OutputLimitExceeded(..) | DecodeErrorStatus::InsufficientData
                if error.data.len() >= out.len() =>
            {
                error.data
            }
            status => return Err(format!("{status:?}").into()),
        },
    };
    let bytes = decoded.get(..out.len()).ok_or_else(|| too_short(decoded.len(), out.len()))?;
    out.copy_from_slice(bytes);
    Ok(())
}

fn unzstd(chunk: &[u8], out: &mut [u8]) -> Result<(), ChunkError> {
    let mut decoder = ruzstd::decoding::StreamingDecoder::new(chunk)?;
    let mut done = 0;
    while done < out.len() {
        match decoder.read(&mut out[done..])? {
            0 => return Err(too_short(done, out.len())),
            count => done += count,
        }
    }
    Ok(())
}

fn unlzw(chunk: &[u8], out: &mut [u8]) -> Result<(), ChunkError> {
    let mut decoder = weezl::decode::Decoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8);
    let (mut rest, mut done) = (chunk, 0);
    while done < out.len() {
        let step = decoder.decode_bytes(rest, &mut out[done..]);
        (rest, done) = (&rest[step.consumed_in..], done + step.consumed_out);
        let stuck = step.consumed_in == 0 && step.consumed_out == 0;
        if matches!(step.status?, weezl::LzwStatus::Done) || stuck {
            break;
        }
    }
    if done < out.len() { Err(too_short(done, out.len())) } else { Ok(()) }
}

/// # References
///
/// * Adobe, *TIFF 6.0*, section 9.
fn unpack_bits(chunk: &[u8], out: &mut [u8]) -> Result<(), ChunkError> {
    const NOTHING: u8 = 128;
    let (mut rest, mut done) = (chunk, 0);
    while done < out.len() {
        let Some((&head, after)) = rest.split_first() else {
            return Err(too_short(done, out.len()));
        };
        rest = after;
        let room = out.len() - done;
        if head < NOTHING {
            let count = (usize::from(head) + 1).min(room);
            let Some((run, after)) = rest.split_at_checked(count) else {
                return Err(too_short(done + rest.len(), out.len()));
            };
            out[done..done + count].copy_from_slice(run);
            (rest, done) = (after, done + count);
        } else if head > NOTHING {
            let Some((&value, after)) = rest.split_first() else {
                return Err(too_short(done, out.len()));
            };
            let count = (257 - usize::from(head)).min(room);
            out[done..done + count].fill(value);
            (rest, done) = (after, done + count);
        }
    }
    Ok(())
}
