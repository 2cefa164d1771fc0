//! Damaged files end in an error: never in a panic, never in memory that the file does not justify.

use super::builder::{TestTiff, Values, globe};
use super::*;
use crate::raster::samples::SampleType;
use crate::raster::tiff::directory::tags;
use proptest::prelude::*;
use std::io::{Seek, SeekFrom, Write};

fn message(name: &str, bytes: &[u8]) -> String {
    match open_bytes(name, bytes) {
        Err(error) => with_causes(&error),
        Ok(raster) => {
            let error = blocks(&*raster).find_map(Result::err);
            with_causes(&error.expect("a damaged file cannot be read to its end"))
        }
    }
}

#[test]
fn what_is_no_tiff_says_what_it_is() {
    assert!(message("a.tif", b"name,value\n1,2\n").contains("starts with \"name,value"));
    assert!(message("a.tif", b"").contains("it is empty"));
    assert!(message("a.tif", b"II*\0").contains("the TIFF header needs bytes 0..8"));
    assert!(message("a.tif", b"IInsbruck").contains("TIFF version at byte 2"));
    let folder = tempfile::tempdir().unwrap();
    let error = open(folder.path(), &ReadOptions::default()).unwrap_err().to_string();
    assert!(error.contains("a folder is not supported"), "{error}");
    let error = open(&folder.path().join("no.tif"), &ReadOptions::default()).unwrap_err();
    assert!(error.to_string().contains("cannot open"), "{error}");
}

#[test]
fn truncated_files_say_what_is_missing() {
    let bytes = globe((40, 40), SampleType::I16).bytes();
    assert!(message("a.tif", &bytes[..bytes.len() - 4]).contains("a TIFF directory needs bytes"));

    let far = globe((16, 16), SampleType::I16)
        .with(tags::TILE_OFFSETS, Values::Long(vec![100_000]))
        .bytes();
    let error = message("a.tif", &far);
    assert!(error.contains("the tile at column 0, row 0 needs bytes 100000..100512"), "{error}");

    let short = globe((16, 16), SampleType::I16)
        .with(tags::TILE_BYTE_COUNTS, Values::Long(vec![100]))
        .bytes();
    let error = message("a.tif", &short);
    assert!(error.contains("100 bytes cannot hold 512"), "{error}");
}

#[test]
fn sizes_that_cannot_be_are_refused() {
    let sized = |tag, value| {
        message(
            "a.tif",
            &globe((16, 16), SampleType::F64).with(tag, Values::Long(vec![value])).bytes(),
        )
    };
    assert!(sized(tags::IMAGE_WIDTH, 0).contains("ImageWidth (tag 256)"));
    assert!(sized(tags::IMAGE_LENGTH, u32::MAX).contains("is 4294967295, expected"));
    assert!(sized(tags::IMAGE_LENGTH, 1 << 30).contains("TileOffsets (tag 324)"));
    assert!(sized(tags::TILE_WIDTH, 0).contains("TileWidth"));
    assert!(sized(tags::TILE_WIDTH, u32::MAX).contains("a tile or strip of"));
    let huge = TestTiff { tiled: false, chunk: (16, 16), ..globe((16, 16), SampleType::U8) }
        .with(tags::IMAGE_LENGTH, Values::Long(vec![1 << 31]))
        .with(tags::ROWS_PER_STRIP, Values::Long(vec![1 << 31]));
    assert!(message("a.tif", &huge.bytes()).contains("a tile or strip of 34359738368 bytes"));
}

#[test]
fn directories_in_a_circle_end() {
    let mut bytes =
        TestTiff { second_directory: Some(1), ..globe((16, 16), SampleType::U8) }.bytes();
    let first = bytes[4..8].to_vec();
    let end = bytes.len();
    bytes[end - 4..].copy_from_slice(&first);
    assert!(message("a.tif", &bytes).contains("points backward"));
}

/// Small files of every kind.
fn kinds() -> Vec<Vec<u8>> {
    let small = |sample| TestTiff { chunk: (4, 4), ..globe((6, 6), sample) };
    let plain = small(SampleType::I16);
    let strips = TestTiff { tiled: false, chunk: (6, 4), ..plain.clone() };
    [
        plain.clone(),
        TestTiff { big: true, bands: 3, planar: true, ..plain.clone() },
        TestTiff { compression: 8, predictor: 2, ..strips.clone() },
        TestTiff { compression: 50000, predictor: 3, ..small(SampleType::F32) },
        TestTiff { compression: 32773, second_directory: Some(1), ..strips },
        plain.with(tags::COMPRESSION, Values::Short(vec![5])),
        small(SampleType::U8).with(tags::COMPRESSION, Values::Short(vec![7])),
    ]
    .iter()
    .map(TestTiff::bytes)
    .collect()
}

/// Reads what can be read of a file of `len` bytes.
fn read_all(path: &Path, len: usize) {
    if let Ok(raster) = open(path, &ReadOptions::default()) {
        let (across, down) = raster.info().blocks();
        assert!(u64::from(across) * u64::from(down) <= len as u64);
        blocks(&*raster).take(64).for_each(drop);
    }
}

#[test]
fn every_byte_of_a_small_file_may_be_wrong() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.tif");
    for bytes in kinds() {
        std::fs::write(&path, &bytes).unwrap();
        let mut file = std::fs::OpenOptions::new().write(true).open(&path).unwrap();
        let mut put = |at: usize, byte: u8| {
            file.seek(SeekFrom::Start(at as u64)).unwrap();
            file.write_all(&[byte]).unwrap();
        };
        for (at, &byte) in bytes.iter().enumerate() {
            for wrong in [0xff, byte ^ 1, byte ^ 0x80] {
                put(at, wrong);
                read_all(&path, bytes.len());
            }
            put(at, byte);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn no_damage_panics(
        kind in 0..7_usize,
        wrong in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..12),
        end in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let mut bytes = kinds().swap_remove(kind);
        for (at, value) in wrong {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if let Some(end) = end {
            bytes.truncate(end.index(bytes.len()));
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.tif");
        std::fs::write(&path, &bytes).unwrap();
        read_all(&path, bytes.len());
    }
}
