//! Verification: an archive held against the laws, and against the rasters it was made from.
//!
//! Nothing that the builder knew is used: pages are read back, and each law is computed anew from
//! their texels.
//!
//! * **Law 1.** `R_l − R_L` is bilinear between the knots of both levels, which all lie on half
//!   texels of the finest level: its exact supremum is found among those points.
//! * **Law 2.** Bounds and ranges of a page contain those of its children.
//! * **Law 3.** Every page is cut anew from the interiors of the pages it draws on.
//! * **Law 4.** Ranges are recomputed from valid texels alone; the codec admits no height without
//!   coverage and no coverage without a height.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use areoid_formats::address::{PageAddress, PageKey};
use areoid_formats::archive::{Archive, ArchiveError, PageEntry};
use areoid_formats::page::{Page, Texels};
use areoid_formats::pyramid::Pyramid;
use rayon::prelude::*;

use crate::border::Border;
use crate::build::Leaves;
use crate::raster::RasterError;
use crate::texel::{Planes, Texel};
use crate::tile::{Raw, Tile};

/// What a verification found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// Every breach, in words; empty if all is well.
    pub problems: Vec<String>,
    /// One for each level, coarsest first.
    pub levels: Vec<LevelReport>,
    /// One for each page above the finest level that has leaves to be held against, in the order
    /// of keys.
    pub pages: Vec<PageError>,
}

/// How far a page is from the finest level, and says it may be; in meters or color codes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PageError {
    /// Which page.
    pub page: PageAddress,
    /// What it says.
    pub bound: f64,
    /// The supremum of `|R_l − R_L|` over the page, with the stored leaves for `R_L`.
    pub exact: f64,
}

/// What a verification found about a level, in meters or color codes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LevelReport {
    /// The largest bound of a page.
    pub bound_max: f64,
    /// The supremum of `|R_l − R_L|`.
    pub exact_max: f64,
    /// Against a raster: the largest error at its pixel centers.
    pub measured_max: f64,
    /// Against a raster: the root of the mean square error at its pixel centers.
    pub measured_rms: f64,
}

/// A verification that could not be done.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VerifyError {
    /// The archive's medium failed.
    #[error(transparent)]
    Archive(#[from] ArchiveError),
    /// The raster cannot be read.
    #[error(transparent)]
    Raster(#[from] RasterError),
}

/// Pages kept decoded while verifying.
const KEPT_PAGES: usize = 256;

/// Bytes, laws 1 to 4, and, with `source`, the error against the source on the same grid.
///
/// # Errors
///
/// [`VerifyError`] if something cannot be read at all; damage is in the report.
pub fn verify(archive: &Archive, source: Option<&dyn Leaves>) -> Result<Report, VerifyError> {
    let mut report = Report { problems: archive.damage()?, ..Report::default() };
    let pyramid = archive.description().grid.pyramid();
    let entries: HashMap<PageAddress, PageEntry> =
        archive.entries()?.into_iter().map(|entry| (entry.page, entry)).collect();
    let reader = Reader { archive, entries: &entries, pages: Mutex::default() };

    for level in pyramid.levels() {
        let bounds = entries.values().filter(|entry| entry.page.level == level);
        let bound_max = bounds.map(|entry| f64::from(entry.bound)).fold(0.0, f64::max);
        report.levels.push(LevelReport { bound_max, ..LevelReport::default() });
    }
    let mut sorted: Vec<&PageEntry> = entries.values().collect();
    sorted.sort_by_key(|entry| PageKey::from(entry.page));

    let of_pages: Vec<String> = sorted
        .par_iter()
        .map(|entry| check_page(&reader, entry))
        .collect::<Result<Vec<_>, _>>()?
        .concat();
    report.problems.extend(of_pages);

    let leaves = sorted.iter().filter(|entry| entry.page.level == pyramid.finest());
    let suprema: Vec<(PageAddress, f64)> = leaves
        .map(|entry| entry.page)
        .collect::<Vec<_>>()
        .par_iter()
        .map(|&leaf| suprema(&reader, leaf))
        .collect::<Result<Vec<_>, _>>()?
        .concat();
    check_bounds(&reader, &suprema, &mut report);

    if let Some(source) = source {
        measure(&reader, source, &mut report)?;
    }
    Ok(report)
}

/// Decoded pages, a few of them at a time. Damaged ones read as absent: they are reported once, by
/// the look at every byte.
struct Reader<'a> {
    archive: &'a Archive,
    entries: &'a HashMap<PageAddress, PageEntry>,
    pages: Mutex<HashMap<PageAddress, Option<Arc<Page>>>>,
}

impl Reader<'_> {
    fn page(&self, address: PageAddress) -> Result<Option<Arc<Page>>, ArchiveError> {
        let lock = || self.pages.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(held) = lock().get(&address) {
            return Ok(held.clone());
        }
        let page = match self.entries.get(&address).map(|entry| self.archive.page(entry)) {
            Some(Err(error @ ArchiveError::Read { .. })) => return Err(error),
            Some(Ok(page)) => Some(Arc::new(page)),
            Some(Err(_)) | None => None,
        };
        let mut pages = lock();
        if pages.len() >= KEPT_PAGES {
            pages.clear();
        }
        pages.insert(address, page.clone());
        Ok(page)
    }

    fn pyramid(&self) -> &Pyramid {
        self.archive.description().grid.pyramid()
    }

    fn name(&self, page: PageAddress) -> String {
        format!("{}/{page}", self.archive.description().dataset)
    }
}

/// Laws 2, 3 and 4 for one page.
fn check_page(reader: &Reader<'_>, entry: &PageEntry) -> Result<Vec<String>, ArchiveError> {
    let pyramid = reader.pyramid();
    let name = reader.name(entry.page);
    let mut problems = Vec::new();
    let Some(page) = reader.page(entry.page)? else { return Ok(problems) };

    let within = |outer: (f32, f32), inner: (f32, f32)| {
        inner.0.is_nan() || outer.0 <= inner.0 && inner.1 <= outer.1
    };
    for child in pyramid.children(entry.page).filter_map(|child| reader.entries.get(&child)) {
        if entry.bound.is_nan() || entry.bound < child.bound {
            let (bound, below) = (entry.bound, child.bound);
            problems.push(format!("law 2: bound {bound} of {name} is below a child's, {below}"));
        }
        let nested = within((entry.min, entry.max), (child.min, child.max))
            && within((entry.lowest, entry.highest), (child.lowest, child.highest));
        if !nested {
            problems.push(format!("law 2: the range of {name} does not contain a child's"));
        }
    }

    if entry.page.level == pyramid.finest() {
        let (min, max) = range(&page, pyramid.interior_size(entry.page));
        let same = |one: f32, other: f32| one.to_bits() == other.to_bits() || one == other;
        if !(min.is_nan() && entry.min.is_nan() || same(min, entry.min) && same(max, entry.max)) {
            let (least, greatest) = (entry.min, entry.max);
            problems.push(format!(
                "law 4: {name} says {least} to {greatest}, its valid texels are {min} to {max}"
            ));
        }
    }
    if !matches_extension(reader, entry.page, &page)? {
        problems.push(format!("law 3: {name} is not its window of the extended level"));
    }
    Ok(problems)
}

/// Least and greatest valid texel of the interior, over channels.
fn range(page: &Page, (rows, cols): (u32, u32)) -> (f32, f32) {
    let mut range = (f32::NAN, f32::NAN);
    for row in 1..=rows as usize {
        for col in 1..=cols as usize {
            if page.coverage_at(row, col) != 0 {
                for channel in texel(page, row * page.side() + col) {
                    range = (range.0.min(channel), range.1.max(channel));
                }
            }
        }
    }
    range
}

/// The channels of a texel.
fn texel(page: &Page, at: usize) -> Vec<f32> {
    match page.texels() {
        Texels::Height(heights) => vec![heights[at]],
        Texels::Color(colors) => colors[at].map(f32::from).to_vec(),
    }
}

/// Whether a page equals, bit for bit, what is cut from the interiors of the pages it draws on.
fn matches_extension(
    reader: &Reader<'_>,
    address: PageAddress,
    page: &Page,
) -> Result<bool, ArchiveError> {
    match page.texels() {
        Texels::Height(_) => matches_extension_of::<f32>(reader, address, page),
        Texels::Color(_) => matches_extension_of::<u8>(reader, address, page),
    }
}

fn matches_extension_of<S: Texel>(
    reader: &Reader<'_>,
    address: PageAddress,
    page: &Page,
) -> Result<bool, ArchiveError> {
    let pyramid = reader.pyramid();
    let mut tiles: HashMap<PageAddress, Tile<S>> = HashMap::new();
    for source in pyramid.sources(address, Pyramid::BORDER) {
        match reader.page(source)? {
            Some(page) => {
                drop(tiles.insert(source, interior(&page, pyramid.interior_size(source))))
            }
            // Nothing can be said of a page beside a damaged one.
            None if reader.entries.contains_key(&source) => return Ok(true),
            None => {}
        }
    }
    let quantum = reader.archive.description().quantum;
    let border = Border::around(pyramid, address, |source| tiles.get(&source), quantum);
    let mut cut = interior::<S>(page, pyramid.interior_size(address));
    cut.close(&border);
    let all =
        |code: u8| cut.coverage.as_ref().is_some_and(|codes| codes.iter().all(|&c| c == code));
    if all(0) {
        return Ok(false);
    }
    let coverage = if all(u8::MAX) { None } else { cut.coverage.as_deref() };
    if coverage != page.coverage() {
        return Ok(false);
    }
    Ok((0..page.side() * page.side()).all(|at| {
        if page.coverage().is_some_and(|coverage| coverage[at] == 0) {
            return true;
        }
        let stored = texel(page, at);
        stored.iter().zip(&cut.planes).all(|(&t, plane)| f64::from(t) == plane[at].into())
    }))
}

/// The interior of a page inside the outline, the border left blank.
fn interior<S: Texel>(page: &Page, (rows, cols): (u32, u32)) -> Tile<S> {
    let planes = match page.texels() {
        Texels::Height(heights) => Planes::Height(heights.clone()),
        Texels::Color(colors) => {
            Planes::Color([0, 1, 2].map(|channel| colors.iter().map(|c| c[channel]).collect()))
        }
    };
    let planes = S::channels(planes, page.coverage());
    let blank = Tile::<S>::blank(page.side(), (rows as usize, cols as usize));
    let mut tile = Tile { planes: blank.planes.clone(), ..blank };
    let mut codes = vec![0; page.side() * page.side()];
    for row in 0..tile.rows {
        let row = tile.row(row);
        for (to, from) in tile.planes.iter_mut().zip(&planes) {
            to[row.clone()].copy_from_slice(&from[row.clone()]);
        }
        match page.coverage() {
            Some(coverage) => codes[row.clone()].copy_from_slice(&coverage[row]),
            None => codes[row].fill(u8::MAX),
        }
    }
    tile.coverage = Some(codes);
    tile
}

/// A leaf's ancestors, itself included, that are there.
fn ancestors(
    reader: &Reader<'_>,
    leaf: PageAddress,
) -> Result<Vec<(PageAddress, Arc<Page>)>, ArchiveError> {
    let mut found = Vec::new();
    let mut next = Some(leaf);
    while let Some(address) = next {
        if let Some(page) = reader.page(address)? {
            found.push((address, page));
        }
        next = address.parent();
    }
    Ok(found)
}

/// Where a point of a leaf's interior, in texels from the leaf's corner, lies in the window of an
/// ancestor.
struct Placed {
    scale: f64,
    origin: (f64, f64),
}

impl Placed {
    fn new(pyramid: &Pyramid, leaf: PageAddress, ancestor: PageAddress) -> Self {
        let interior = f64::from(pyramid.interior());
        let halvings = i32::from(leaf.level.0) - i32::from(ancestor.level.0);
        let scale = 2.0_f64.powi(-halvings);
        let place = |leaf: u32, ancestor: u32| {
            f64::from(leaf) * interior * scale - f64::from(ancestor) * interior
                + f64::from(Pyramid::BORDER)
        };
        Self { scale, origin: (place(leaf.col, ancestor.col), place(leaf.row, ancestor.row)) }
    }

    fn at(&self, x: f64, y: f64) -> (f64, f64) {
        (self.origin.0 + x * self.scale, self.origin.1 + y * self.scale)
    }
}

/// The exact supremum of `|R_l − R_L|` over the interior of `leaf` for every ancestor.
fn suprema(
    reader: &Reader<'_>,
    leaf: PageAddress,
) -> Result<Vec<(PageAddress, f64)>, ArchiveError> {
    let pyramid = reader.pyramid();
    let Some(leaf_page) = reader.page(leaf)? else { return Ok(Vec::new()) };
    let (rows, cols) = pyramid.interior_size(leaf);
    let mut found = Vec::new();
    for (address, page) in ancestors(reader, leaf)? {
        if address == leaf {
            continue;
        }
        let placed = Placed::new(pyramid, leaf, address);
        let mut largest = 0.0_f64;
        for row in 0..=2 * rows {
            let y = f64::from(row) / 2.0;
            for col in 0..=2 * cols {
                let x = f64::from(col) / 2.0;
                if let Some(error) =
                    difference(&leaf_page, (x + 1.0, y + 1.0), &page, placed.at(x, y))
                {
                    largest = largest.max(error);
                }
            }
        }
        found.push((address, largest));
    }
    Ok(found)
}

/// The largest difference over channels of two reconstructions, where all taps of both are valid.
fn difference(one: &Page, at: (f64, f64), other: &Page, there: (f64, f64)) -> Option<f64> {
    let one = one.reconstruct(at.0, at.1).filter(|found| found.valid_weight >= 1.0)?;
    let other = other.reconstruct(there.0, there.1).filter(|found| found.valid_weight >= 1.0)?;
    let differences = one.value.iter().zip(other.value).map(|(one, other)| (one - other).abs());
    Some(differences.fold(0.0, f64::max))
}

/// Holds the suprema against the bounds.
fn check_bounds(reader: &Reader<'_>, suprema: &[(PageAddress, f64)], report: &mut Report) {
    let finest = reader.pyramid().finest();
    // What quantization may add: 0 for lossless leaves.
    let leaves = reader.entries.values().filter(|entry| entry.page.level == finest);
    let slack = leaves.map(|entry| f64::from(entry.bound)).fold(0.0, f64::max);
    let mut by_page: HashMap<PageAddress, f64> = HashMap::new();
    for &(page, supremum) in suprema {
        let largest = by_page.entry(page).or_default();
        *largest = largest.max(supremum);
    }
    let mut breaches: Vec<String> = Vec::new();
    let mut suprema: Vec<(PageAddress, f64)> = by_page.into_iter().collect();
    suprema.sort_by_key(|&(page, _)| PageKey::from(page));
    for (page, supremum) in suprema {
        let level = &mut report.levels[usize::from(page.level.0)];
        level.exact_max = level.exact_max.max(supremum);
        let bound = reader.entries.get(&page).map_or(0.0, |entry| f64::from(entry.bound));
        report.pages.push(PageError { page, bound, exact: supremum });
        // Reconstructing in f64 rounds, too.
        let rounding = 1e-12 * supremum;
        if bound.is_nan() || supremum - rounding > bound + slack {
            let name = reader.name(page);
            breaches.push(format!("law 1: {name} is off by {supremum}, its bound is {bound}"));
        }
    }
    breaches.sort();
    report.problems.extend(breaches);
}

/// Errors of a level against a raster.
#[derive(Clone, Copy, Default)]
struct Errors {
    largest: f64,
    squares: f64,
    count: u64,
}

/// Holds every level against the source, at the source's pixel centers.
fn measure(
    reader: &Reader<'_>,
    source: &dyn Leaves,
    report: &mut Report,
) -> Result<(), VerifyError> {
    let pyramid = reader.pyramid();
    let finest = pyramid.finest();
    let (rows, cols) = pyramid.pages(finest).expect("a pyramid has a finest level");
    let leaves: Vec<PageAddress> = (0..rows)
        .flat_map(|row| (0..cols).map(move |col| PageAddress::new(finest, row, col)))
        .collect();
    let measured: Vec<(PageAddress, Errors)> = leaves
        .par_iter()
        .map(|&leaf| measure_leaf(reader, source, leaf))
        .collect::<Result<Vec<_>, VerifyError>>()?
        .concat();

    let mut sums = vec![Errors::default(); report.levels.len()];
    let mut breaches = Vec::new();
    for (page, errors) in measured {
        let sum = &mut sums[usize::from(page.level.0)];
        sum.largest = sum.largest.max(errors.largest);
        sum.squares += errors.squares;
        sum.count += errors.count;
        let allowed = reader
            .entries
            .get(&page)
            .map_or(0.0, |entry| f64::from(entry.bound) + f64::from(entry.source_error));
        if allowed.is_nan() || errors.largest * (1.0 - 1e-12) > allowed {
            let (name, error) = (reader.name(page), errors.largest);
            breaches.push(format!("{name} is off the source by {error}, allowed are {allowed}"));
        }
    }
    breaches.sort();
    breaches.dedup();
    report.problems.extend(breaches);
    for (level, sum) in report.levels.iter_mut().zip(sums) {
        level.measured_max = sum.largest;
        level.measured_rms = (sum.squares / sum.count.max(1) as f64).sqrt();
    }
    Ok(())
}

fn measure_leaf(
    reader: &Reader<'_>,
    source: &dyn Leaves,
    leaf: PageAddress,
) -> Result<Vec<(PageAddress, Errors)>, VerifyError> {
    let Some(raw) = source.read(leaf)? else { return Ok(Vec::new()) };
    let Some(leaf_page) = reader.page(leaf)? else {
        let errors = Errors { largest: f64::INFINITY, squares: 0.0, count: 0 };
        return Ok(vec![(leaf, errors)]);
    };
    let pyramid = reader.pyramid();
    let side = pyramid.page_side() as usize;
    let (rows, cols) = pyramid.interior_size(leaf);
    let (rows, cols) = (rows as usize, cols as usize);
    let mut found = Vec::new();
    for (address, page) in ancestors(reader, leaf)? {
        let placed = Placed::new(pyramid, leaf, address);
        let mut errors = Errors::default();
        for row in 0..rows {
            for col in 0..cols {
                let (x, y) = (col as f64 + 0.5, row as f64 + 0.5);
                let whole = |page: &Page, (x, y)| {
                    page.reconstruct(x, y).filter(|found| found.valid_weight >= 1.0)
                };
                let (Some(_), Some(here)) =
                    (whole(&leaf_page, (x + 1.0, y + 1.0)), whole(&page, placed.at(x, y)))
                else {
                    continue;
                };
                let error = error_at(&raw, (row + 1) * side + col + 1, here.value);
                errors.largest = errors.largest.max(error);
                errors.squares += error * error;
                errors.count += 1;
            }
        }
        found.push((address, errors));
    }
    Ok(found)
}

/// How far `value` is from a sample, the farthest channel. A sample that is no data where the page
/// has a value is an infinite error.
fn error_at(raw: &Raw, at: usize, value: [f64; 3]) -> f64 {
    if raw.alpha.as_ref().is_some_and(|alpha| alpha[at] == 0) {
        return f64::INFINITY;
    }
    match &raw.planes {
        Planes::Height(plane) => (f64::from(plane[at]) - value[0]).abs(),
        Planes::WholeHeight(plane) => (f64::from(plane[at]) - value[0]).abs(),
        Planes::Color(planes) => {
            let errors =
                planes.iter().zip(value).map(|(plane, v)| (f64::from(plane[at]) - v).abs());
            errors.fold(0.0, f64::max)
        }
    }
}
