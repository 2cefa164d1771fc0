//! What `--mip kaiser` is for: coarser levels keep what they can show, and drop what they cannot.
//!
//! Levels are held against the words of the format texel by texel wherever laws are; here against
//! what the rule promises of whole fields.

use std::f64::consts::{PI, TAU};

use areoid_formats::address::{Level, PageAddress};
use areoid_formats::archive::{Archive, MipRule};
use areoid_formats::page::Texels;

use crate::support::levels::Edge;
use crate::support::raster::{Place, Random, Raster};

/// Texels of a row or column on either side of a parent's center.
const TAPS: usize = 6;

/// The level one above the finest, row by row; NaN where it is invalid.
fn first_halved(archive: &Archive) -> Vec<Vec<f32>> {
    let pyramid = archive.description().grid.pyramid();
    let level = Level(pyramid.finest().0 - 1);
    let size = pyramid.size(level).unwrap();
    let interior = pyramid.interior();
    let mut rows = vec![vec![f32::NAN; size.width as usize]; size.height as usize];
    for entry in archive.entries().unwrap().iter().filter(|entry| entry.page.level == level) {
        let PageAddress { row, col, .. } = entry.page;
        let page = archive.page(entry).unwrap();
        let Texels::Height(heights) = page.texels() else { panic!("{} is no height", entry.page) };
        let (down, across) = pyramid.interior_size(entry.page);
        for (r, c) in (0..down).flat_map(|r| (0..across).map(move |c| (r, c))) {
            let from = (r as usize + 1) * page.side() + c as usize + 1;
            rows[(row * interior + r) as usize][(col * interior + c) as usize] = heights[from];
        }
    }
    rows
}

fn halved(raster: &Raster, mip: MipRule, page_side: u32) -> Vec<Vec<f32>> {
    first_halved(&Raster { mip, ..raster.clone() }.archive(page_side))
}

/// How much of a wave of so many texels along rows a rule keeps. All around the body there is no edge.
fn kept(period: f64, mip: MipRule) -> f64 {
    let wave = |_: usize, col: usize| (1000.0 * (TAU * (col as f64 + 0.2) / period).sin()) as f32;
    let raster = Raster::new(Place::Belt, (40, 480), None, wave);
    let rows = halved(&raster, mip, 34);
    // The amplitude of the same wave, by Fourier; its alias, where it is one, has the same.
    let (mut sine, mut cosine) = (0.0, 0.0);
    for (col, &height) in rows[10].iter().enumerate() {
        let phase = TAU * (2.0 * col as f64 + 0.7) / period;
        sine += f64::from(height) * phase.sin();
        cosine += f64::from(height) * phase.cos();
    }
    let count = rows[10].len() as f64;
    2.0 * sine.hypot(cosine) / count / 1000.0
}

/// What the table of the module `lowpass` says, and of longer waves that they stay.
#[test]
fn waves_are_kept_or_dropped() {
    for (period, of_mean, of_kaiser) in [
        (2.5, 0.309, 0.0023),
        (3.0, 0.5, 0.0753),
        (5.0, 0.809, 0.798),
        (6.0, 0.866, 0.926),
        (8.0, 0.924, 0.992),
        (16.0, 0.981, 1.0),
        (48.0, 0.998, 1.0),
    ] {
        let [mean, kaiser] = [MipRule::Mean, MipRule::Kaiser].map(|mip| kept(period, mip));
        assert!((mean - of_mean).abs() < 1e-3, "the mean keeps {mean} of {period} texels");
        assert!(
            (kaiser - of_kaiser).abs() < 1e-3,
            "the low-pass keeps {kaiser} of {period} texels"
        );
        // What a mean keeps, from its own formula.
        assert!((mean - (PI / period).cos()).abs() < 1e-6);
    }
}

/// A slope is its own low-pass, to the bit where heights are whole and so are their means.
#[test]
fn a_ramp_stays_one() {
    let slope = |row: usize, col: usize| (6 * row) as f32 - (10 * col) as f32 + 3.0;
    for step in [None, Some((1.0, 0.0))] {
        let raster = Raster::new(Place::Region, (70, 90), step, slope);
        let rows = halved(&raster, MipRule::Kaiser, 18);
        let (inner_rows, inner_cols) = (TAPS..35 - TAPS, TAPS..45 - TAPS);
        for (row, col) in inner_rows.flat_map(|r| inner_cols.clone().map(move |c| (r, c))) {
            let expected = slope(2 * row, 2 * col) + 3.0 - 5.0;
            assert_eq!(rows[row][col].to_bits(), expected.to_bits(), "{row}, {col}");
        }
    }
}

/// Odd constants too, whose weighted sums have many digits.
#[test]
fn a_constant_stays_one_to_the_bit() {
    for height in [0.1, -8_848.861, 3.402e38, 1.2e-38, 65_504.0] {
        let raster = Raster::new(Place::Region, (50, 50), None, |_, _| height);
        for row in halved(&raster, MipRule::Kaiser, 10) {
            assert!(row.iter().all(|found| found.to_bits() == height.to_bits()), "{height}");
        }
    }
}

/// A cliff between two plains does not ring, and nothing leaves the range of i16 or of f32.
#[test]
fn a_cliff_does_not_ring() {
    let meters = Some((1.0, 0.0));
    for (low, high, step) in [
        (-32_767.0, 32_767.0, meters),
        (f32::MIN, f32::MAX, None),
        (-3.0, -2.0, Some((0.125, 0.0))),
    ] {
        let raster = Raster::new(Place::Region, (64, 64), step, |row, col| {
            if (row + 3 * col) % 64 < 31 { low } else { high }
        });
        for height in halved(&raster, MipRule::Kaiser, 18).concat() {
            assert!((low..=high).contains(&height), "{height}");
        }
    }
}

/// Pages of other sizes: the same texels. So nothing hangs on where pages end.
#[test]
fn texels_do_not_depend_on_pages() {
    let poles = [Edge::PoleOnOutline, Edge::PoleOnPosts].map(|edge| Place::Globe(edge, edge));
    for (place, size) in [(poles[0], (64, 128)), (poles[1], (65, 128)), (Place::Region, (61, 99))] {
        let mut random = Random(5);
        let raster = Raster::new(place, size, None, |row, col| {
            let hole = (row / 7 + col / 17) % 9 == 0;
            if hole { f32::NAN } else { (random.unit() * 900.0) as f32 }
        });
        let bits = |page_side| -> Vec<u32> {
            let rows = halved(&raster, MipRule::Kaiser, page_side);
            rows.concat().iter().map(|height| height.to_bits()).collect()
        };
        assert_eq!(bits(10), bits(34));
        assert_eq!(bits(10), bits(18));
    }
}
