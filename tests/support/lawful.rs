//! An archive held against the oracle: laws 1 to 4, page by page.

use std::collections::HashMap;

use areoid_formats::address::{Level, PageAddress};
use areoid_formats::archive::{Archive, PageEntry, Payload};
use areoid_formats::page::{Page, Texels};
use areoid_formats::pyramid::Pyramid;

use super::oracle::{Footprint, Oracle};
use super::raster::{Random, Raster};

/// What the archive's bounds are worth.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Tightness {
    /// The largest bound of the level.
    pub(crate) bound: f64,
    /// The largest supremum that brute force finds.
    pub(crate) exact: f64,
}

/// Holds every page of `archive`, whose leaves are the samples of `raster`, against laws 1 to 4.
///
/// Returns how tight the bounds are, finest level first.
///
/// # Panics
///
/// At the first breach.
pub(crate) fn assert_lawful(archive: &Archive, raster: &Raster) -> Vec<Tightness> {
    let pyramid = archive.description().grid.pyramid();
    let oracle = Oracle::new(raster, 0);
    archive.entries().unwrap().iter().for_each(|entry| check_rounding(&oracle, pyramid, entry));
    assert_levels_lawful(archive, raster)
}

/// [`assert_lawful`] where the leaves' own error is of another kind.
pub(crate) fn assert_levels_lawful(archive: &Archive, raster: &Raster) -> Vec<Tightness> {
    let pyramid = archive.description().grid.pyramid();
    let finest = pyramid.finest().0;
    let oracle = Oracle::new(raster, usize::from(finest));
    let entries: HashMap<PageAddress, PageEntry> =
        archive.entries().unwrap().into_iter().map(|entry| (entry.page, entry)).collect();
    let mut tightness = vec![Tightness::default(); usize::from(finest) + 1];
    let mut seen = 0;
    for level in 0..=finest {
        let halvings = usize::from(finest - level);
        for page in pages(&oracle, pyramid, Level(level)) {
            match entries.get(&page) {
                Some(entry) => {
                    seen += 1;
                    let exact = check_bound(&oracle, pyramid, entry);
                    let of_level = &mut tightness[halvings];
                    of_level.bound = of_level.bound.max(f64::from(entry.bound));
                    of_level.exact = of_level.exact.max(exact);
                    check_ranges(&oracle, pyramid, entry);
                    check_nesting(&entries, entry);
                    check_window(&oracle, pyramid, entry, &archive.page(entry).unwrap());
                }
                None => check_empty(&oracle, pyramid, page),
            }
        }
    }
    assert_eq!(seen, entries.len(), "pages outside the levels");
    check_anywhere(&oracle, pyramid, &entries);
    tightness
}

/// All places for pages of a level, from its size as the oracle has it.
fn pages(oracle: &Oracle, pyramid: &Pyramid, level: Level) -> Vec<PageAddress> {
    let halvings = usize::from(pyramid.finest().0 - level.0);
    let interior = pyramid.page_side() as usize - 2;
    let size = oracle.levels.level(halvings);
    let (rows, cols) = (size.height.div_ceil(interior), size.width.div_ceil(interior));
    assert!(level.0 > 0 || (cols <= 3 && rows <= 2), "level 0 has {rows} x {cols} pages");
    let place = |at: usize| {
        let (row, col) = (u32::try_from(at / cols).unwrap(), u32::try_from(at % cols).unwrap());
        PageAddress::new(level, row, col)
    };
    (0..rows * cols).map(place).collect()
}

/// The finest texels under a page.
fn footprint(oracle: &Oracle, pyramid: &Pyramid, page: PageAddress) -> Footprint {
    let texels = (pyramid.page_side() as usize - 2) << (pyramid.finest().0 - page.level.0);
    let span = |index: u32, end: usize| {
        let start = index as usize * texels;
        (start.min(end), (start + texels).min(end))
    };
    let (top, bottom) = span(page.row, oracle.levels.shape.height);
    let (left, right) = span(page.col, oracle.levels.shape.width);
    Footprint { top, bottom, left, right }
}

/// Law 1. Returns the supremum.
fn check_bound(oracle: &Oracle, pyramid: &Pyramid, entry: &PageEntry) -> f64 {
    let page = entry.page;
    let halvings = usize::from(pyramid.finest().0 - page.level.0);
    let supremum = oracle.supremum(halvings, footprint(oracle, pyramid, page));
    let bound = f64::from(entry.bound);
    assert!(
        supremum <= bound * (1.0 + 1e-12) + 1e-9,
        "law 1: {page} is off by {supremum}, its bound is {bound}"
    );
    supremum
}

/// Law 1 at points that are not special.
fn check_anywhere(oracle: &Oracle, pyramid: &Pyramid, entries: &HashMap<PageAddress, PageEntry>) {
    let shape = oracle.levels.shape;
    let mut random = Random(17);
    for _ in 0..500 {
        let (x, y) = (random.unit() * shape.width as f64, random.unit() * shape.height as f64);
        for level in 0..=pyramid.finest().0 {
            let halvings = usize::from(pyramid.finest().0 - level);
            let Some(error) = oracle.error(halvings, x, y) else { continue };
            let texels = ((pyramid.page_side() as usize - 2) << halvings) as f64;
            let page = PageAddress::new(Level(level), (y / texels) as u32, (x / texels) as u32);
            let bound = f64::from(entries[&page].bound);
            assert!(
                error <= bound * (1.0 + 1e-12) + 1e-9,
                "law 1: {page} is off by {error} at {x}, {y}, its bound is {bound}"
            );
        }
    }
}

/// `min` and `max` are those of the finest texels under the page; `lowest` and `highest` hold all
/// that the finest reconstruction takes there.
fn check_ranges(oracle: &Oracle, pyramid: &Pyramid, entry: &PageEntry) {
    let page = entry.page;
    let under = footprint(oracle, pyramid, page);
    match oracle.range(under, 0) {
        Some((min, max)) => {
            assert_eq!((entry.min, entry.max), (min, max), "the finest texels under {page}");
            assert!(entry.lowest <= min && max <= entry.highest, "{page}: {entry:?}");
        }
        None => assert!(entry.min.is_nan() && entry.max.is_nan(), "{page} has no texel under it"),
    }
    // A tap beside the footprint counts only where one under or beside it is reconstructed.
    if let Some((min, max)) = oracle.range(under, 1) {
        assert!(
            entry.lowest <= min && max <= entry.highest || entry.min.is_nan(),
            "{page}: {min} to {max} is more than {} to {}",
            entry.lowest,
            entry.highest
        );
    }
}

/// The source error of leaves that are the samples but for their rounding.
fn check_rounding(oracle: &Oracle, pyramid: &Pyramid, entry: &PageEntry) {
    let page = entry.page;
    let error = oracle.source_error(footprint(oracle, pyramid, page));
    let stated = f64::from(entry.source_error);
    assert!((stated - error).abs() <= 1e-6 * error, "{page} is {error} off the source, {stated}");
}

/// Law 2.
fn check_nesting(entries: &HashMap<PageAddress, PageEntry>, entry: &PageEntry) {
    let Some(parent) = entry.page.parent().map(|parent| entries.get(&parent)) else { return };
    let page = entry.page;
    let Some(parent) = parent else {
        assert!(entry.min.is_nan(), "{page} has texels and no parent");
        return;
    };
    assert!(parent.bound >= entry.bound, "law 2: {page}: {} < {}", parent.bound, entry.bound);
    let inside = |outer: (f32, f32), inner: (f32, f32)| {
        inner.0.is_nan() || outer.0 <= inner.0 && inner.1 <= outer.1
    };
    assert!(inside((parent.min, parent.max), (entry.min, entry.max)), "law 2: range of {page}");
    let wide = ((parent.lowest, parent.highest), (entry.lowest, entry.highest));
    assert!(inside(wide.0, wide.1), "law 2: widened range of {page}");
}

/// Laws 3 and 4: the page is its window of the extended level, bit for bit.
fn check_window(oracle: &Oracle, pyramid: &Pyramid, entry: &PageEntry, page: &Page) {
    let address = entry.page;
    let halvings = usize::from(pyramid.finest().0 - address.level.0);
    let side = pyramid.page_side() as usize;
    let corner = |index: u32| i64::from(index) * (side as i64 - 2) - 1;
    let (top, left) = (corner(address.row), corner(address.col));
    let (mut same, mut full, mut valid) = (true, true, 0);
    let mut first = None;
    for at in 0..side * side {
        let (row, col) = (top + (at / side) as i64, left + (at % side) as i64);
        let coverage = oracle.levels.coverage(halvings, row, col);
        assert_eq!(
            page.coverage_at(at / side, at % side),
            coverage,
            "law 3: coverage of {address} at texel {row}, {col} of its level"
        );
        full &= coverage == 255;
        let inside = row >= 0
            && col >= 0
            && row < oracle.levels.level(halvings).height as i64
            && col < oracle.levels.level(halvings).width as i64
            && (1..side - 1).contains(&(at / side))
            && (1..side - 1).contains(&(at % side));
        valid += usize::from(inside && coverage != 0);
        let expected = texel(oracle, halvings, (row, col), coverage);
        let stored = stored(page, at);
        assert!(
            stored
                .iter()
                .zip(&expected)
                .all(|(s, e)| s.to_bits() == e.to_bits() || s.is_nan() && e.is_nan()),
            "law 3: {address} has {stored:?} at texel {row}, {col} of its level, not {expected:?}"
        );
        same &= bits(first.get_or_insert_with(|| expected.clone())) == bits(&expected);
    }
    assert_eq!(entry.full, full, "whether all of {address} is full");
    let constant = matches!(entry.payload, Payload::Constant(_));
    assert_eq!(constant, same && full, "whether {address} is constant");
    let inside = pyramid.interior_size(address);
    let share = valid as f64 / (f64::from(inside.0) * f64::from(inside.1));
    assert!((f64::from(entry.valid_fraction) - share).abs() < 1e-6, "valid fraction of {address}");
}

fn bits(texel: &[f32]) -> Vec<u32> {
    texel.iter().map(|channel| channel.to_bits()).collect()
}

/// A texel as a page shows it: NaN or black where it is invalid.
fn texel(oracle: &Oracle, halvings: usize, (row, col): (i64, i64), coverage: u8) -> Vec<f32> {
    let channels = oracle.levels.level(halvings).planes.len();
    let blank = if channels == 1 { f32::NAN } else { 0.0 };
    (0..channels)
        .map(|channel| match coverage {
            0 => blank,
            _ => oracle.levels.texel(halvings, channel, row, col),
        })
        .collect()
}

fn stored(page: &Page, at: usize) -> Vec<f32> {
    match page.texels() {
        Texels::Height(heights) => vec![heights[at]],
        Texels::Color(colors) => colors[at].map(f32::from).to_vec(),
    }
}

/// A page that is not stored has no valid texel.
fn check_empty(oracle: &Oracle, pyramid: &Pyramid, page: PageAddress) {
    let halvings = usize::from(pyramid.finest().0 - page.level.0);
    let side = i64::from(pyramid.page_side());
    for at in 0..side * side {
        let row = i64::from(page.row) * (side - 2) - 1 + at / side;
        let col = i64::from(page.col) * (side - 2) - 1 + at % side;
        assert_eq!(oracle.levels.coverage(halvings, row, col), 0, "{page} is missing");
    }
}
