//! How to go on is told where there is something to go on with, and nowhere else.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::{Seek as _, SeekFrom, Write as _};
use std::path::PathBuf;

use areoid_formats::catalog::RealDisk;
use areoid_preprocess::build::Proceed;
use areoid_preprocess::ingest::{Event, Request, Unfinished, ingest};
use tempfile::TempDir;
use tiff::decoder::Decoder;
use tiff::encoder::colortype::GrayI16;
use tiff::encoder::{Compression, DeflateLevel, TiffEncoder};
use tiff::tags::Tag;

use super::rig::{self, SMALL, Subject, UNIT};

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
        let subject = Subject::new(damaged(&home, pick));
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

/// What an ingest does from its first event to its end, stopped at each event once, with what is left
/// of an earlier one in its way.
#[test]
fn a_wish_to_stop_is_heeded_whenever_it_comes() {
    let subject = &SMALL.all[1];
    let expected = subject.undisturbed();
    let left = TempDir::new().unwrap();
    subject.half_build(left.path(), 2, 4);
    for unfinished in [Unfinished::Resume, Unfinished::Discard] {
        let mut heard = BTreeSet::new();
        for stop_at in 0.. {
            let catalog = TempDir::new().unwrap();
            rig::copy(left.path(), catalog.path());
            let request = Request { unfinished, ..subject.request(catalog.path()) };
            let mut events = Vec::new();
            let stopped = ingest(&RealDisk, &request, |event| {
                events.push(event);
                if events.len() > stop_at { Proceed::No } else { Proceed::Yes }
            });
            heard.extend(events.iter().map(|event| name_of(*event)));
            let what = format!("{unfinished:?}, stopped at {stop_at}: {:?}", events.last());
            match stopped {
                Ok(_) => {
                    assert!(matches!(events[stop_at], Event::Publishing), "{what}");
                    break;
                }
                Err(error) => {
                    assert!(error.is_interruption(), "{what}: {error}");
                    assert_eq!(events.len(), stop_at + 1, "{what}");
                    // Until it looks there, it cannot know what is left.
                    let unknown = matches!(events[stop_at], Event::Opening | Event::Hashing { .. });
                    let names = rig::names_in(&catalog.path().join("build"));
                    let left = !names.is_empty() && !unknown;
                    assert_eq!(error.can_be_resumed(), left, "{what}: {names:?}");
                }
            }
            let (outcome, _) = subject.resume(catalog.path());
            assert!(unfinished == Unfinished::Discard || outcome.resumed_units >= 4, "{what}");
            rig::assert_whole(catalog.path(), &expected, &what);
        }
        let before = ["Building", "Estimated", "Hashing", "Leftover", "Measuring", "Opening"];
        assert!(before.iter().all(|&event| heard.contains(event)), "{heard:?}");
        assert_eq!(heard.contains("Checking"), unfinished == Unfinished::Resume);
    }
}

/// The name of an event's variant.
fn name_of(event: Event) -> String {
    let text = format!("{event:?}");
    text.split(|c: char| !c.is_alphanumeric()).next().unwrap().to_owned()
}
