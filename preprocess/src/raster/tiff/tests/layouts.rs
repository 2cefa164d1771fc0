//! Every layout of samples in a file becomes the same blocks.

use super::builder::{TestTiff, Values, globe, value_at};
use super::*;
use crate::raster::convert::{all_colors, all_heights};
use crate::raster::samples::{SampleType, Samples};
use crate::raster::tiff::directory::{ByteOrder, tags};

pub(super) const TYPES: [SampleType; 8] = [
    SampleType::U8,
    SampleType::I8,
    SampleType::U16,
    SampleType::I16,
    SampleType::U32,
    SampleType::I32,
    SampleType::F32,
    SampleType::F64,
];

/// Checks every sample, that blocks lie where the contract says, and that none is missing.
fn check(tiff: &TestTiff) {
    let raster = opened(tiff).unwrap_or_else(|error| panic!("{tiff:?}: {error}"));
    let info = raster.info();
    assert_eq!((info.width, info.height), tiff.size);
    let mut pixels = 0;
    for block in blocks(&*raster) {
        let block = block.unwrap_or_else(|error| panic!("{tiff:?}: {error}"));
        assert_eq!((block.col % info.block_width, block.row % info.block_height), (0, 0));
        assert_eq!(block.samples.sample_type(), tiff.sample);
        let window = [block.col, block.row, block.width, block.height];
        assert_eq!(numbers(&block), tiff.expected(window), "{tiff:?}");
        pixels += block.width * block.height;
    }
    assert_eq!(pixels, tiff.size.0 * tiff.size.1);
}

#[test]
fn every_type_compression_and_predictor_reads_the_same() {
    for sample in TYPES {
        let coded = [5, 8, 50000].into_iter().flat_map(|code| [(code, 1), (code, 2), (code, 3)]);
        for (compression, predictor) in coded.chain([(1, 1), (32773, 1)]) {
            if predictor == 2 && sample.is_float() || predictor == 3 && !sample.is_float() {
                continue;
            }
            for order in [ByteOrder::Little, ByteOrder::Big] {
                let tiff = globe((37, 21), sample);
                check(&TestTiff { compression, predictor, order, ..tiff });
            }
        }
    }
}

#[test]
fn tiles_strips_planes_and_bigtiff_read_the_same() {
    for bands in [1, 2, 3, 4] {
        for (tiled, chunk) in
            [(true, (16, 16)), (true, (64, 32)), (false, (37, 5)), (false, (37, 21))]
        {
            for (planar, big) in [(false, false), (true, false), (false, true), (true, true)] {
                let tiff = globe((37, 21), SampleType::I16);
                let layout = TestTiff { bands, tiled, chunk, planar, big, ..tiff };
                check(&layout);
                check(&TestTiff { compression: 8, predictor: 2, ..layout });
            }
        }
    }
}

#[test]
fn one_pixel_one_row_and_one_column_are_ordinary() {
    for size in [(1, 1), (50, 1), (1, 50)] {
        check(&globe(size, SampleType::F32));
        check(&TestTiff { tiled: false, chunk: (size.0, 1), ..globe(size, SampleType::U8) });
    }
}

#[test]
fn long_strips_of_plain_rows_are_cut_and_short_ones_joined() {
    let size = (2048, 700);
    let whole = TestTiff { tiled: false, chunk: size, ..globe(size, SampleType::F64) };
    assert_eq!(opened(&whole).unwrap().info().block_height, 64);
    check(&whole);
    let rows = TestTiff { chunk: (2048, 1), compression: 8, ..whole };
    assert_eq!(opened(&rows).unwrap().info().block_height, 16);
    check(&rows);
}

#[test]
fn the_encoders_own_lzw_and_deflate_are_read() {
    use tiff::encoder::{Compression, DeflateLevel, Predictor, TiffEncoder, colortype};
    let values: Vec<u16> = (0..64_u32 * 40)
        .map(|index| u16::exactly(value_at(index % 64, index / 64, 0) * 500.0).unwrap())
        .collect();
    for compression in [Compression::Lzw, Compression::Deflate(DeflateLevel::Best)] {
        for predictor in [Predictor::None, Predictor::Horizontal] {
            let mut file = std::io::Cursor::new(Vec::new());
            let encoder = TiffEncoder::new(&mut file).unwrap();
            let mut encoder = encoder.with_compression(compression).with_predictor(predictor);
            let mut image = encoder.new_image::<colortype::Gray16>(64, 40).unwrap();
            image.rows_per_strip(7).unwrap();
            image.write_data(&values).unwrap();
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("a.tif");
            std::fs::write(&path, file.into_inner()).unwrap();
            let extent = Some([0.0, 0.0, 64.0, 40.0]);
            let raster = open(&path, &ReadOptions { extent, ..ReadOptions::default() }).unwrap();
            let block = raster.read_block(0, 0).unwrap();
            assert_eq!(block.samples, Samples::U16(values.clone()), "{predictor:?}");
        }
    }
}

/// GDAL wrote a tile of LZW, cut by the raster's edge, of which the `tiff` crate's reader said "no
/// lzw end code found": its last bytes came out when no input was left.
#[test]
fn lzw_tiles_end_anywhere() {
    for (width, rows) in (1..64).flat_map(|width| [8, 24, 64].map(|rows| (width, rows))) {
        let cut = TestTiff { chunk: (64, rows), ..globe((width, rows), SampleType::U8) };
        check(&TestTiff { compression: 5, ..cut });
    }
}

#[test]
fn tiles_left_out_are_no_data() {
    let sparse = TestTiff { sparse: vec![0, 4], ..globe((40, 20), SampleType::F32) };
    let raster = opened(&sparse.clone().with(tags::GDAL_NODATA, Values::Text("-9999"))).unwrap();
    let block = raster.read_block(0, 0).unwrap();
    assert!(numbers(&block).iter().all(|&value| value == -9999.0));
    let heights = all_heights(&block, raster.info());
    assert!(heights.iter().all(|height| height.is_nan()));
    assert!(numbers(&raster.read_block(1, 0).unwrap()).iter().all(|&value| value >= 0.0));

    let zeros = opened(&TestTiff { compression: 8, ..sparse }).unwrap();
    let block = zeros.read_block(1, 1).unwrap();
    assert_eq!(numbers(&block), vec![0.0; 16 * 4]);
}

#[test]
fn alpha_is_found_and_unnamed_extra_samples_of_colors_are_dropped() {
    let four = TestTiff { bands: 4, ..globe((20, 20), SampleType::U8) };
    let info = |tiff: &TestTiff| {
        let raster = opened(tiff).unwrap();
        (raster.info().bands, raster.info().has_alpha)
    };
    assert_eq!(info(&four), (3, true));
    assert_eq!(info(&four.clone().with(tags::EXTRA_SAMPLES, Values::Short(vec![2]))), (3, true));
    let unnamed = TestTiff { compression: 8, predictor: 2, ..four }
        .with(tags::EXTRA_SAMPLES, Values::Short(vec![0]));
    assert_eq!(info(&unnamed), (3, false));
    let block = opened(&unnamed).unwrap().read_block(0, 0).unwrap();
    let expected: Vec<f64> = (0..3)
        .map(|band| value_at(0, 0, band))
        .chain((0..3).map(|band| value_at(1, 0, band)))
        .collect();
    assert_eq!(numbers(&block)[..6], expected);

    let gray = TestTiff { bands: 2, ..globe((20, 20), SampleType::U8) };
    assert_eq!(info(&gray), (2, false));
    assert_eq!(info(&gray.with(tags::EXTRA_SAMPLES, Values::Short(vec![1]))), (1, true));
}

#[test]
fn palettes_become_colors_and_their_nodata_alpha() {
    let mut map = vec![0_u16; 768];
    for (index, value) in (0_u16..).zip(map.iter_mut()) {
        *value = if index < 256 { index << 8 } else { 0x0700 };
    }
    let palette = globe((20, 20), SampleType::U8)
        .with(tags::PHOTOMETRIC, Values::Short(vec![3]))
        .with(tags::COLOR_MAP, Values::Short(map));
    let raster = opened(&palette).unwrap();
    assert_eq!((raster.info().bands, raster.info().has_alpha), (3, false));
    let block = raster.read_block(0, 0).unwrap();
    assert_eq!(numbers(&block)[3..6], [value_at(1, 0, 0), 7.0, 7.0]);

    let raster = opened(&palette.with(tags::GDAL_NODATA, Values::Text("7"))).unwrap();
    let block = raster.read_block(0, 0).unwrap();
    let (_, alpha) = all_colors(&block, raster.info()).unwrap();
    assert_eq!((alpha[0], alpha[1], alpha[2]), (255, 0, 255));
}

/// A tile of JPEG as libtiff writes it, but with its tables inside.
fn jpeg_tile(color: image::ExtendedColorType, pixels: &[u8]) -> Vec<u8> {
    let mut stream = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut stream, 95)
        .encode(pixels, 16, 16, color)
        .unwrap();
    stream
}

#[test]
fn jpeg_tiles_become_gray_or_rgb() {
    let red: Vec<u8> = [200, 40, 90].repeat(256);
    let gray: Vec<u8> = vec![77; 256];
    let cases = [
        (3, 6, jpeg_tile(image::ExtendedColorType::Rgb8, &red), &[200.0, 40.0, 90.0][..]),
        (1, 1, jpeg_tile(image::ExtendedColorType::L8, &gray), &[77.0][..]),
    ];
    for (bands, photometric, stream, expected) in cases {
        let offset = 2000;
        let mut file = TestTiff { bands, ..globe((16, 16), SampleType::U8) }
            .with(tags::PHOTOMETRIC, Values::Short(vec![photometric]))
            .with(tags::COMPRESSION, Values::Short(vec![7]))
            .with(tags::TILE_OFFSETS, Values::Long(vec![offset]))
            .with(tags::TILE_BYTE_COUNTS, Values::Long(vec![u32::try_from(stream.len()).unwrap()]))
            .bytes();
        assert!(file.len() < offset as usize);
        file.resize(offset as usize, 0);
        file.extend(stream);
        let raster = open_bytes("a.tif", &file).unwrap();
        let block = raster.read_block(0, 0).unwrap();
        for (found, expected) in numbers(&block).iter().zip(expected.iter().cycle()) {
            assert!((found - expected).abs() <= 2.0, "{found} {expected}");
        }
    }
}

#[test]
fn what_cannot_be_read_is_named_with_what_could_be() {
    let with = |tag, value| {
        error_of(&globe((20, 20), SampleType::U8).with(tag, Values::Short(vec![value])))
    };
    assert!(with(tags::COMPRESSION, 34887).contains("LERC compression (code 34887)"));
    assert!(with(tags::COMPRESSION, 34925).contains("LZMA"));
    assert!(with(tags::PHOTOMETRIC, 5).contains("CMYK"));
    assert!(with(tags::PHOTOMETRIC, 0).contains("white is zero"));
    assert!(with(tags::BITS_PER_SAMPLE, 12).contains("unsigned integers of 12 bits"));
    assert!(with(tags::SAMPLE_FORMAT, 5).contains("complex"));
    assert!(with(tags::FILL_ORDER, 2).contains("FillOrder 2"));
    let mask = TestTiff { second_directory: Some(4), ..globe((20, 20), SampleType::U8) };
    assert!(error_of(&mask).contains("an internal mask (directory 2)"));
    let overview = TestTiff { second_directory: Some(1), ..mask };
    check(&overview);
}
