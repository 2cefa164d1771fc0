//! Ingest: rasters become a dataset of a catalog.

mod request;

mod plan;

mod left;

mod place;

use std::path::Path;
use std::time::Instant;

use areoid_formats::archive::{Description, Summary};
pub use areoid_formats::catalog::Existing;
use areoid_formats::catalog::{Build, Catalog, CatalogError, Disk, publish_build};
use areoid_formats::storage::ByteSource as _;

pub use self::plan::{Opened, latitudes_name, open, reopen};
pub use self::request::{Event, IngestError, Leftover, Outcome, Reading, Request, Unfinished};

use self::left::{begin, new_dataset, publish_left};
use self::place::write;
use self::plan::plan;
use self::request::tell;
use crate::build::{Proceed, Progress};
use crate::feather::HALO;
use crate::schedule::Schedule;

/// Leaf pages along a side of a work unit.
pub const UNIT_PAGES: u32 = 8;

/// Ingests; `watch` is told how it goes, and may stop it until all is built: at once before the
/// build, else behind a work unit.
///
/// # Errors
///
/// Any [`IngestError`]; the catalog is then as it was.
pub fn ingest(
    disk: &dyn Disk,
    request: &Request,
    mut watch: impl FnMut(Event) -> Proceed + Send,
) -> Result<Outcome, IngestError> {
    let start = Instant::now();
    tell(&mut watch, Event::Opening)?;
    let mut catalog = newest(&request.catalog)?;
    let (description, mut origin) = plan(request, catalog.as_ref(), &mut watch)?;
    let mut outcome = Outcome {
        dataset: description.dataset.clone(),
        already_there: false,
        generation: 0,
        summary: Summary::default(),
        bytes: 0,
        pixels: 0,
        decoded_blocks: 0,
        estimate: None,
        resumed_units: 0,
        seconds: 0.0,
    };
    let there = loop {
        let Some(opened) = &catalog else { break None };
        match existing(opened, &description, request.existing) {
            // Another process may have replaced or removed it since the catalog was opened.
            Err(IngestError::Catalog(error)) if matches!(*error, CatalogError::Missing { .. }) => {
                let generation = opened.generation();
                catalog = newest(&request.catalog)?;
                if catalog.as_ref().is_none_or(|newer| newer.generation() == generation) {
                    return Err(IngestError::Catalog(error));
                }
            }
            there => break there?,
        }
    };
    if let (Some(catalog), Some((summary, bytes))) = (&catalog, there) {
        (outcome.already_there, outcome.generation) = (true, catalog.generation());
        (outcome.summary, outcome.bytes) = (summary, bytes);
        outcome.seconds = start.elapsed().as_secs_f64();
        return Ok(outcome);
    }

    if let Some((generation, archive)) = publish_left(disk, request, &description, &mut watch)? {
        outcome.generation = generation;
        outcome.summary = archive.summary().cloned().unwrap_or_default();
        outcome.bytes = archive.len();
        let units = Schedule::new(description.grid.pyramid(), UNIT_PAGES, HALO).remaining();
        outcome.resumed_units = units as u64;
        outcome.seconds = start.elapsed().as_secs_f64();
        return Ok(outcome);
    }

    let (mut build, begun, leftover) = begin(disk, request, &description, &mut watch)?;
    outcome.resumed_units = begun.as_ref().map_or(0, |begun| begun.archive.units);
    let mut is_untold = begun.is_some();
    let mut unit_end = begun.as_ref().map(|begun| begun.archive.end);
    let mut note = |event: Event| {
        match event {
            Event::Estimated(estimate) => outcome.estimate = Some(estimate),
            Event::Building(progress) => {
                let Progress { units_done, units_resumed, .. } = progress;
                if std::mem::take(&mut is_untold) {
                    let (units, again) = (units_resumed as u64, units_resumed - units_done);
                    let resumed = Leftover::Resumed { units, again: again as u64 };
                    if watch(Event::Leftover(resumed)) == Proceed::No {
                        return Proceed::No;
                    }
                }
                if units_done > 0 {
                    unit_end.get_or_insert(progress.bytes);
                }
                outcome.pixels = progress.texels - progress.texels_skipped;
            }
            _ => {}
        }
        watch(event)
    };
    let told = leftover.map_or(Ok(()), |leftover| tell(&mut note, Event::Leftover(leftover)));
    let written = told
        .and_then(|()| write(request, &description, &mut *origin, (&mut build, begun), &mut note));
    let written = match written {
        Ok(written) => written,
        Err(error) => return Err(stopped(build, unit_end, error)),
    };
    watch(Event::Publishing);
    let dataset = new_dataset(&description, written.bytes, written.content, request.existing);
    let published = publish_build(build, dataset);
    outcome.generation = published.map_err(|error| kept(error.into()))?;
    (outcome.summary, outcome.bytes) = (written.summary, written.bytes);
    outcome.decoded_blocks = origin.decoded_blocks();
    outcome.seconds = start.elapsed().as_secs_f64();
    Ok(outcome)
}

/// Keeps a build that stopped if that is of use: if its first unit ends at `unit_end`, that is in
/// its file, and the cause may go away.
fn stopped(build: Build<'_>, unit_end: Option<u64>, error: IngestError) -> IngestError {
    // A disk may have had no room for a unit that was done. Where it does not tell, that shows later.
    let length = build.source().map_or(u64::MAX, |source| source.len());
    if unit_end.is_some_and(|end| end <= length) && error.may_go_away() {
        return kept(error);
    }
    // What cannot be removed either is swept by the next build of this name; the first error says
    // more.
    let _ = build.discard();
    error
}

/// The error of an ingest whose build is still there.
fn kept(error: IngestError) -> IngestError {
    if error.may_go_away() { IngestError::Kept(Box::new(error)) } else { error }
}

/// The newest generation of the catalog, if there is one.
fn newest(folder: &Path) -> Result<Option<Catalog>, IngestError> {
    match Catalog::open(folder) {
        Ok(catalog) => Ok(Some(catalog)),
        Err(CatalogError::NotACatalog { .. }) => Ok(None),
        Err(error) => Err(error.into()),
    }
}

/// What the catalog has under the name of `description`, if that is the same dataset.
fn existing(
    catalog: &Catalog,
    description: &Description,
    policy: Existing,
) -> Result<Option<(Summary, u64)>, IngestError> {
    let name = &description.dataset;
    catalog.check_free(name, None)?;
    let other = || match policy {
        Existing::Replace => Ok(None),
        Existing::Keep => Err(CatalogError::Exists { name: name.clone() }.into()),
    };
    let record = match catalog.dataset(name) {
        Ok(record) => record,
        Err(CatalogError::Group { .. }) => return other(),
        Err(_) => return Ok(None),
    };
    let archive = match (catalog.archive(record), policy) {
        (Ok(archive), _) => archive,
        // What cannot be read can be replaced.
        (Err(_), Existing::Replace) => return Ok(None),
        (Err(error), Existing::Keep) => return Err(error.into()),
    };
    if archive.description() == description
        && let Some(summary) = archive.summary()
    {
        return Ok(Some((summary.clone(), archive.len())));
    }
    other()
}
