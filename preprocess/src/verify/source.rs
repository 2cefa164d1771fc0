//! The error of every level against the rasters that the archive was made from.

use areoid_formats::address::PageAddress;
use areoid_formats::page::Page;
use rayon::prelude::*;

use super::bounds::{Placed, ancestors};
use super::reader::Reader;
use super::{Report, VerifyError};
use crate::build::Leaves;
use crate::texel::Planes;
use crate::tile::Raw;

/// Errors of a level against a raster.
#[derive(Clone, Copy, Default)]
struct Errors {
    largest: f64,
    squares: f64,
    count: u64,
}

/// Holds every level against the source, at the source's pixel centers.
pub(super) fn measure(
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
