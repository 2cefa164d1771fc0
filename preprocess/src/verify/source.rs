//! The error of every level against the rasters that the archive was made from.

use areoid_formats::address::{PageAddress, PageKey};
use areoid_formats::page::Page;
use rayon::prelude::*;

use super::bounds::{Placed, ancestors};
use super::reader::Reader;
use super::{Report, VerifyError};
use crate::truth::{Around, Sample, Truth};

/// Errors of a level against a raster.
#[derive(Clone, Copy, Default)]
struct Errors {
    largest: f64,
    squares: f64,
    count: u64,
    /// The largest sample.
    magnitude: f64,
}

/// Four weights add up to one to this accuracy.
const WEIGHTS: f64 = 1e-9;

/// What reconstructing in f64 changes, of the numbers that are added and of the difference.
const ROUNDING: f64 = 1e-12;

/// Holds every level against the source, at the source's pixel centers.
pub(super) fn measure(
    reader: &Reader<'_>,
    source: &dyn Truth,
    report: &mut Report,
) -> Result<(), VerifyError> {
    let measured: Vec<(PageAddress, Errors)> = (0..source.parcels())
        .into_par_iter()
        .map(|parcel| measure_parcel(reader, source, parcel))
        .collect::<Result<Vec<_>, VerifyError>>()?
        .concat();

    let mut sums = vec![Errors::default(); report.levels.len()];
    let mut breaches = Vec::new();
    for (page, errors) in measured {
        let sum = &mut sums[usize::from(page.level.0)];
        // What has no value on one side is a breach, and no distance.
        if errors.largest.is_finite() {
            sum.largest = sum.largest.max(errors.largest);
        }
        sum.squares += errors.squares;
        sum.count += errors.count;
        let allowed = reader
            .entries
            .get(&page)
            .map_or(0.0, |entry| f64::from(entry.bound) + f64::from(entry.source_error));
        let least = errors.largest * (1.0 - ROUNDING) - errors.magnitude * ROUNDING;
        if allowed.is_nan() || least > allowed {
            let (name, error) = (reader.name(page), errors.largest);
            breaches.push(if error.is_finite() {
                format!("{name} is off the source by {error}, allowed are {allowed}")
            } else {
                format!("{name} has no data where the source has, or has where the source has none")
            });
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

fn measure_parcel(
    reader: &Reader<'_>,
    source: &dyn Truth,
    parcel: u64,
) -> Result<Vec<(PageAddress, Errors)>, VerifyError> {
    let mut samples = source.samples(parcel)?;
    samples.sort_by_key(|sample| PageKey::from(sample.leaf));
    let mut found = Vec::new();
    for samples in samples.chunk_by(|one, other| one.leaf == other.leaf) {
        measure_leaf(reader, samples, source.is_texels(), &mut found)?;
    }
    Ok(found)
}

/// Holds a leaf and the pages above it against samples of its interior.
fn measure_leaf(
    reader: &Reader<'_>,
    samples: &[Sample],
    is_texels: bool,
    found: &mut Vec<(PageAddress, Errors)>,
) -> Result<(), VerifyError> {
    let leaf = samples[0].leaf;
    let breach = || (leaf, Errors { largest: f64::INFINITY, ..Errors::default() });
    let Some(leaf_page) = reader.page(leaf)? else {
        if is_texels || samples.iter().any(|sample| sample.around == Around::Data) {
            found.push(breach());
        }
        return Ok(());
    };
    let is_off = |sample: &Sample| {
        let here = leaf_page.reconstruct(sample.x + 1.0, sample.y + 1.0);
        match sample.around {
            Around::Data => here.is_none_or(|found| found.valid_weight < 1.0 - WEIGHTS),
            Around::Nothing => here.is_some(),
            Around::Unknown => false,
        }
    };
    if samples.iter().any(is_off) {
        found.push(breach());
    }
    for (address, page) in ancestors(reader, leaf)? {
        let placed = Placed::new(reader.pyramid(), leaf, address);
        let mut errors = Errors::default();
        for &Sample { x, y, value, .. } in samples {
            let whole = |page: &Page, (x, y)| {
                page.reconstruct(x, y).filter(|found| found.valid_weight >= 1.0 - WEIGHTS)
            };
            let (Some(_), Some(here)) =
                (whole(&leaf_page, (x + 1.0, y + 1.0)), whole(&page, placed.at(x, y)))
            else {
                continue;
            };
            let error = error_at(value, here.value);
            errors.largest = errors.largest.max(error);
            errors.squares += error * error;
            errors.count += 1;
            let sizes = value.into_iter().flatten().map(f64::abs);
            errors.magnitude = sizes.fold(errors.magnitude, f64::max);
        }
        found.push((address, errors));
    }
    Ok(())
}

/// How far `value` is from a sample, the farthest channel. A sample that is no data where the page
/// has a value is an infinite error.
fn error_at(sample: Option<[f64; 3]>, value: [f64; 3]) -> f64 {
    let Some(sample) = sample else { return f64::INFINITY };
    let errors = sample.iter().zip(value).map(|(sample, value)| (sample - value).abs());
    errors.fold(0.0, f64::max)
}
