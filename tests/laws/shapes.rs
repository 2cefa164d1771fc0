//! Laws 1 to 4 on fields chosen to be hard: what a smooth planet never shows.

use areoid_formats::archive::MipRule;

use crate::support::lawful::assert_lawful;
use crate::support::levels::Edge;
use crate::support::raster::{Codes, Place, Random, Raster};

const METERS: Option<(f64, f64)> = Some((1.0, 0.0));
const AREAS: Place = Place::Globe(Edge::PoleOnOutline, Edge::PoleOnOutline);
const POSTS: Place = Place::Globe(Edge::PoleOnPosts, Edge::PoleOnPosts);

/// The field on a region, a belt and globes, lossless, on a step that loses, and as floats, by the
/// mean and by the low-pass.
fn check(field: impl Fn(usize, usize) -> f32) {
    for (place, size) in [
        (Place::Region, (61, 133)),
        (Place::Belt, (47, 128)),
        (AREAS, (64, 128)),
        (POSTS, (65, 128)),
    ] {
        for step in [METERS, Some((10.0, 0.0)), None] {
            let raster = Raster::new(place, size, step, &field);
            for (page_side, mip) in
                [(10, MipRule::Mean), (34, MipRule::Mean), (10, MipRule::Kaiser)]
            {
                let raster = Raster { mip, ..raster.clone() };
                assert_lawful(&raster.archive(page_side), &raster);
            }
        }
    }
}

#[test]
fn a_checkerboard() {
    check(|row, col| if (row + col) % 2 == 0 { -1000.0 } else { 1000.0 });
}

#[test]
fn a_checkerboard_of_data_and_none() {
    check(|row, col| if (row + col) % 2 == 0 { f32::NAN } else { row as f32 });
}

#[test]
fn a_spike() {
    for place in [(0, 0), (31, 63)] {
        check(|row, col| if (row, col) == place { 20_000.0 } else { 0.0 });
    }
}

#[test]
fn a_single_texel_with_data() {
    for place in [(0, 0), (46, 127)] {
        check(|row, col| if (row, col) == place { 123.0 } else { f32::NAN });
    }
}

#[test]
fn ramps() {
    check(|row, _| 17.0 * row as f32);
    check(|_, col| 17.0 * col as f32);
    check(|row, col| 3.0 * row as f32 - 5.0 * col as f32);
}

#[test]
fn a_plain_is_constant() {
    check(|_, _| 7.0);
    let raster = Raster::new(AREAS, (64, 128), METERS, |_, _| 7.0);
    let raster = Raster { mip: MipRule::Kaiser, ..raster };
    let archive = raster.archive(18);
    assert!(archive.summary().unwrap().levels.iter().all(|level| level.pages == level.constant));
}

/// Colors go through the same laws in codes, one channel at a time.
#[test]
fn colors() {
    for (place, size) in [(Place::Region, (61, 83)), (AREAS, (64, 128)), (POSTS, (65, 64))] {
        let mut random = Random(3);
        let mut raster = Raster::new(place, size, None, |row, col| {
            let hole = (row / 7 + col / 9) % 5 == 0;
            if hole { f32::NAN } else { (random.unit() * 255.0).round() as f32 }
        });
        let red = raster.planes[0].clone();
        let derived = |code: fn(f32) -> f32| red.iter().map(|&red| code(red)).collect();
        raster.planes.push(derived(|red| 255.0 - red));
        raster.planes.push(derived(|red| (red / 16.0).floor() * 16.0));
        assert_lawful(&raster.archive(18), &raster);
        raster.mip = MipRule::Kaiser;
        assert_lawful(&raster.archive(18), &raster);
    }
}

/// Codes of normals are averaged as they are.
#[test]
fn normals() {
    for (place, size) in [(Place::Region, (61, 83)), (AREAS, (64, 128)), (POSTS, (65, 64))] {
        let mut random = Random(4);
        let mut raster = Raster::new(place, size, None, |row, col| {
            let hole = (row / 9 + col / 7) % 5 == 0;
            if hole { f32::NAN } else { (1.0 + random.unit() * 254.0).round() as f32 }
        });
        let x = raster.planes[0].clone();
        let derived = |code: fn(f32) -> f32| x.iter().map(|&x| code(x)).collect();
        raster.planes.push(derived(|x| 256.0 - x));
        raster.planes.push(derived(|x| (x / 64.0).floor() * 64.0 + 1.0));
        raster.codes = Codes::Normals;
        assert_lawful(&raster.archive(18), &raster);
        raster.mip = MipRule::Kaiser;
        assert_lawful(&raster.archive(18), &raster);
    }
}
