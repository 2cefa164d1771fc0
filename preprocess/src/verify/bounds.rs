//! Law 1: the exact supremum of `|R_l − R_L|` under each page.

use std::collections::HashMap;
use std::sync::Arc;

use areoid_formats::address::{PageAddress, PageKey};
use areoid_formats::archive::ArchiveError;
use areoid_formats::page::Page;
use areoid_formats::pyramid::Pyramid;

use super::reader::Reader;
use super::{PageError, Report};

/// A leaf's ancestors, itself included, that are there.
pub(super) fn ancestors(
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
pub(super) struct Placed {
    scale: f64,
    origin: (f64, f64),
}

impl Placed {
    pub(super) fn new(pyramid: &Pyramid, leaf: PageAddress, ancestor: PageAddress) -> Self {
        let interior = f64::from(pyramid.interior());
        let halvings = i32::from(leaf.level.0) - i32::from(ancestor.level.0);
        let scale = 2.0_f64.powi(-halvings);
        let place = |leaf: u32, ancestor: u32| {
            f64::from(leaf) * interior * scale - f64::from(ancestor) * interior
                + f64::from(Pyramid::BORDER)
        };
        Self { scale, origin: (place(leaf.col, ancestor.col), place(leaf.row, ancestor.row)) }
    }

    pub(super) fn at(&self, x: f64, y: f64) -> (f64, f64) {
        (self.origin.0 + x * self.scale, self.origin.1 + y * self.scale)
    }
}

/// The exact supremum of `|R_l − R_L|` over the interior of `leaf` for every ancestor.
pub(super) fn suprema(
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
pub(super) fn check_bounds(
    reader: &Reader<'_>,
    suprema: &[(PageAddress, f64)],
    report: &mut Report,
) {
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
