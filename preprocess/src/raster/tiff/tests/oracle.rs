//! The reader's own decoding of a chunk against that of the `tiff` crate.

use super::builder::stored_zlib;
use crate::raster::samples::SampleType;
use crate::raster::tiff::decode::{ChunkShape, Workspace};
use crate::raster::tiff::directory::ByteOrder;
use crate::raster::tiff::layout::Compression;
use std::io::Write;

/// Bytes without a pattern, some of them in runs.
fn bytes(len: usize) -> Vec<u8> {
    let mut state = 1_u32;
    let mut bytes = Vec::with_capacity(len + 200);
    while bytes.len() < len {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let [_, _, run, value] = state.to_le_bytes();
        bytes.extend(std::iter::repeat_n(value, if run < 20 { 190 } else { 1 }));
    }
    bytes.truncate(len);
    bytes
}

/// Runs of equal bytes as such, others as they are.
fn pack_bits(bytes: &[u8]) -> Vec<u8> {
    let mut packed = Vec::new();
    for run in bytes.chunk_by(|a, b| a == b).flat_map(|run| run.chunks(128)) {
        match run {
            [value] => packed.extend([0, *value]),
            run => packed.extend([u8::try_from(257 - run.len()).unwrap(), run[0]]),
        }
    }
    packed
}

fn compressed(compression: Compression, plain: &[u8]) -> Vec<Vec<u8>> {
    match compression {
        Compression::None => vec![plain.to_vec()],
        Compression::Deflate => {
            let mut encoder =
                flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::default());
            encoder.write_all(plain).unwrap();
            vec![encoder.finish().unwrap(), stored_zlib(plain)]
        }
        Compression::PackBits => vec![pack_bits(plain)],
        Compression::Lzw => {
            let mut encoder =
                weezl::encode::Encoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8);
            vec![encoder.encode(plain).unwrap()]
        }
        Compression::Zstd => {
            let level = ruzstd::encoding::CompressionLevel::Fastest;
            vec![ruzstd::encoding::compress_to_vec(plain, level)]
        }
        Compression::Jpeg => unreachable!("JPEG is decoded by the crate"),
    }
}

/// Any bytes are samples of some raster after any predictor.
#[test]
fn every_chunk_decodes_as_the_tiff_crate_decodes_it() {
    let mut workspace = Workspace::default();
    for sample in super::layouts::TYPES {
        for predictor in if sample.is_float() { 1..=3 } else { 1..=2 } {
            for (order, samples) in [ByteOrder::Little, ByteOrder::Big]
                .into_iter()
                .flat_map(|order| (1..7).map(move |samples| (order, samples)))
            {
                let encoded = (21, 9);
                for clipped in [encoded, (21, 4), (13, 9), (1, 1)] {
                    let plain_shape = ChunkShape {
                        order,
                        compression: Compression::None,
                        predictor,
                        jpeg_tables: None,
                        sample,
                        samples,
                        encoded,
                        clipped,
                    };
                    let plain = bytes(usize::try_from(plain_shape.encoded_bytes()).unwrap());
                    check(&plain_shape, &plain, &mut workspace);
                }
            }
        }
    }
}

fn check(plain_shape: &ChunkShape, plain: &[u8], workspace: &mut Workspace) {
    let expected = plain_shape.decode_with_tiff(plain).unwrap();
    for compression in [
        Compression::None,
        Compression::Deflate,
        Compression::PackBits,
        Compression::Lzw,
        Compression::Zstd,
    ] {
        let shape = ChunkShape { compression, ..*plain_shape };
        for chunk in compressed(compression, plain) {
            shape.check_length(&chunk).unwrap();
            if matches!(compression, Compression::Deflate | Compression::PackBits) {
                assert_eq!(shape.decode_with_tiff(&chunk).unwrap().as_bytes(), expected.as_bytes());
            }
            let mut decoded = crate::raster::Samples::filled(shape.sample, expected.len(), 1.0);
            shape.decode_into(&chunk, workspace, decoded.as_bytes_mut()).unwrap();
            assert_eq!(decoded.as_bytes(), expected.as_bytes(), "{shape:?}");
        }
    }
}

#[test]
fn a_chunk_cut_short_is_an_error_in_every_compression() {
    let shape = ChunkShape {
        order: ByteOrder::Little,
        compression: Compression::None,
        predictor: 1,
        jpeg_tables: None,
        sample: SampleType::U16,
        samples: 1,
        encoded: (16, 16),
        clipped: (16, 16),
    };
    let plain = bytes(512);
    for compression in [
        Compression::None,
        Compression::Deflate,
        Compression::PackBits,
        Compression::Lzw,
        Compression::Zstd,
    ] {
        let shape = ChunkShape { compression, ..shape };
        for chunk in compressed(compression, &plain) {
            let mut out = crate::raster::Samples::filled(shape.sample, 256, 0.0);
            // Checksums and marks of the end may be missing.
            for len in 0..chunk.len() - 8 {
                let cut = &chunk[..len];
                let result = shape.check_length(cut).and_then(|()| {
                    shape.decode_into(cut, &mut Workspace::default(), out.as_bytes_mut())
                });
                assert!(result.is_err(), "{compression:?} {len} of {}", chunk.len());
            }
        }
    }
}
