//! How to go on is told where there is something to go on with, and nowhere else.

use std::fs::{self, File};
use std::io::{Seek as _, SeekFrom, Write as _};
use std::path::PathBuf;

use tempfile::TempDir;
use tiff::decoder::Decoder;
use tiff::encoder::colortype::GrayI16;
use tiff::encoder::{Compression, DeflateLevel, TiffEncoder};
use tiff::tags::Tag;

use super::rig::{self, Subject, UNIT};

/// A globe of two rows of units in compressed strips, of which one, counted from the top, does not
/// decode.
fn damaged(folder: &TempDir, pick: fn(&[u64]) -> u64) -> PathBuf {
    let path = folder.path().join("damaged.tif");
    let (width, height) = (4 * UNIT, 2 * UNIT);
    let degrees = 360.0 / width as f64;
    let mut encoder = TiffEncoder::new(File::create(&path).unwrap()).unwrap();
    encoder = encoder.with_compression(Compression::Deflate(DeflateLevel::Fast));
    let mut image = encoder.new_image::<GrayI16>(width as u32, height as u32).unwrap();
    let tags = image.encoder();
    let keys: [u16; 16] = [1, 1, 0, 3, 1024, 0, 1, 2, 1025, 0, 1, 1, 2048, 0, 1, 4326];
    tags.write_tag(Tag::ModelPixelScaleTag, &[degrees, degrees, 0.0][..]).unwrap();
    tags.write_tag(Tag::ModelTiepointTag, &[0.0, 0.0, 0.0, -180.0, 90.0, 0.0][..]).unwrap();
    tags.write_tag(Tag::GeoKeyDirectoryTag, &keys[..]).unwrap();
    image.rows_per_strip(50).unwrap();
    let samples: Vec<i16> = (0..width * height).map(|at| (at * 7 % 1009) as i16).collect();
    image.write_data(&samples).unwrap();

    let mut decoder = Decoder::new(File::open(&path).unwrap()).unwrap();
    let strips = decoder.get_tag_u64_vec(Tag::StripOffsets).unwrap();
    let mut file = File::options().write(true).open(&path).unwrap();
    file.seek(SeekFrom::Start(pick(&strips))).unwrap();
    file.write_all(&[0xff; 40]).unwrap();
    path
}

/// The raster is what it is: the next ingest would fail as this one did. It used to be advised
/// nevertheless, and for a build that had just been thrown away.
#[test]
fn damage_that_stays_is_nothing_to_go_on_with() {
    let picks: [fn(&[u64]) -> u64; 2] = [|strips| strips[0], |strips| strips[strips.len() - 1]];
    for pick in picks {
        let home = TempDir::new().unwrap();
        let subject = Subject { raster: damaged(&home, pick), step_m: None };
        let catalog = home.path().join("catalog");
        for options in [&["--note-every-s", "0"][..], &["--resume"]] {
            let told = rig::assert_told(&subject.command(&catalog, options).output().unwrap());
            assert!(told.contains("damaged"), "{told}");
            assert!(!told.contains("to go on"), "{told}");
            assert_eq!(rig::names_in(&catalog.join("build")), [] as [&str; 0]);
        }
        fs::remove_dir_all(catalog).unwrap();
    }
}
