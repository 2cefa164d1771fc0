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

mod reader;

mod pages;

mod bounds;

mod source;

use std::collections::HashMap;

use areoid_formats::address::{PageAddress, PageKey};
use areoid_formats::archive::{Archive, ArchiveError, PageEntry};
use rayon::prelude::*;

use self::bounds::{check_bounds, suprema};
use self::pages::check_page;
use self::reader::Reader;
use self::source::measure;
use crate::raster::RasterError;
use crate::truth::Truth;

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

/// Bytes, laws 1 to 4, and, with `source`, the error against what the dataset was made from.
///
/// # Errors
///
/// [`VerifyError`] if something cannot be read at all; damage is in the report.
pub fn verify(archive: &Archive, source: Option<&dyn Truth>) -> Result<Report, VerifyError> {
    let mut report = Report { problems: archive.damage()?, ..Report::default() };
    let pyramid = archive.description().grid.pyramid();
    let entries: HashMap<PageAddress, PageEntry> =
        archive.entries()?.into_iter().map(|entry| (entry.page, entry)).collect();
    let reader = Reader::new(archive, &entries);

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
