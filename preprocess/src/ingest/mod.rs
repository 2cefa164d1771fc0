//! Ingest: rasters become a dataset of a catalog, or the parts of a group.
//!
//! ```text
//!   plan ──▶ there already? ──▶ what is left ──▶ build, part by part ──▶ publish all in one step
//! ```

mod request;

mod plan;

mod left;

mod memory;

mod place;

mod saved;

mod tally;

use std::path::Path;
use std::time::Instant;

use areoid_formats::archive::Archive;
pub use areoid_formats::catalog::Existing;
use areoid_formats::catalog::{Catalog, CatalogError, Disk, Finished, publish_archives};
use rayon::ThreadPool;

pub use self::plan::{Opened, latitudes_name, open, reopen};
pub use self::request::{
    Event, IngestError, Leftover, Outcome, PartMade, Reading, Request, Saved, TargetGrid,
    Unfinished,
};

use self::left::{Standing, dataset, in_place, kept, publish_left, stand, stopped};
use self::memory::Memory;
use self::place::{Ready, make_ready, threads, write};
use self::plan::{Part, Plan, plan};
use self::request::{Watch, tell};
use self::saved::{length, saved};
use self::tally::{Tally, units};
use crate::build::{Proceed, Progress};
use crate::estimate::Estimate;

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
    let threads = threads(request)?;
    let mut plan = plan(request, &threads, catalog.as_ref(), &mut watch)?;
    let mut outcome = Outcome {
        dataset: plan.called.clone(),
        parts: Vec::new(),
        saved: None,
        already_there: false,
        generation: 0,
        bytes: 0,
        pixels: 0,
        decoded_blocks: 0,
        estimate: None,
        resumed_units: 0,
        seconds: 0.0,
    };
    let there = loop {
        let Some(opened) = &catalog else { break None };
        match existing(opened, &plan, request.existing) {
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
    if let (Some(catalog), Some(archives)) = (&catalog, there) {
        (outcome.already_there, outcome.generation) = (true, catalog.generation());
        return Ok(outcome.of(&plan, archives.iter().map(whole).collect(), start));
    }

    let mut left = Vec::new();
    for part in &plan.parts {
        left.push(in_place(&request.catalog, &part.description)?);
    }
    if left.iter().all(Option::is_some) {
        let all: Vec<_> = left.drain(..).flatten().collect();
        if let Some(generation) = publish_left(disk, request, &plan, &all, &mut watch)? {
            outcome.generation = generation;
            outcome.resumed_units =
                plan.parts.iter().map(|part| units(&part.description) as u64).sum();
            let parts = all.iter().map(|(archive, _)| whole(archive)).collect();
            return Ok(outcome.of(&plan, parts, start));
        }
        left.resize_with(plan.parts.len(), || None);
    }

    let mut standing = stand(disk, request, &plan, left, &mut watch)?;
    let built = build_all(request, &threads, &mut plan, &mut standing, &mut outcome, &mut watch);
    if let Err(error) = built {
        return Err(stopped(standing, error));
    }
    watch(Event::Publishing);
    let made = standing.iter().map(made).collect();
    outcome.generation = publish(disk, request, &plan, standing)?;
    let read = plan.parts.iter().chain(&plan.instead_of);
    outcome.decoded_blocks = read.map(|part| part.origin.decoded_blocks()).sum();
    Ok(outcome.of(&plan, made, start))
}

/// What is said of an archive's levels, and its length.
type Figures = (areoid_formats::archive::Summary, u64);

fn whole(archive: &Archive) -> Figures {
    (archive.summary().cloned().unwrap_or_default(), archive.len())
}

/// Of a part that is done.
fn made(standing: &Standing<'_>) -> Figures {
    match standing {
        Standing::InPlace(archive, _) => whole(archive),
        Standing::Build(underway) => {
            let written = underway.written.as_ref();
            written.map(|written| (written.summary.clone(), written.bytes)).unwrap_or_default()
        }
    }
}

impl Outcome {
    /// With what was made of each part.
    fn of(self, plan: &Plan, figures: Vec<Figures>, start: Instant) -> Self {
        let made = |(part, (summary, bytes)): (&Part, Figures)| {
            let (name, grid) = (part.description.dataset.clone(), part.description.grid.clone());
            PartMade { name, grid, summary, bytes }
        };
        let parts: Vec<PartMade> = plan.parts.iter().zip(figures).map(made).collect();
        Self {
            saved: plan.instead_of.as_ref().map(|whole| saved(whole, plan.instead_bytes, &parts)),
            bytes: parts.iter().map(|part| part.bytes).sum(),
            parts,
            seconds: start.elapsed().as_secs_f64(),
            ..self
        }
    }
}

/// Builds what is not whole yet, one part after another.
fn build_all(
    request: &Request,
    threads: &ThreadPool,
    plan: &mut Plan,
    standing: &mut [Standing<'_>],
    outcome: &mut Outcome,
    watch: Watch<'_>,
) -> Result<(), IngestError> {
    let mut told = Vec::new();
    let mut least_bytes = 0;
    for (part, standing) in plan.parts.iter().zip(&*standing) {
        let Standing::Build(underway) = standing else { continue };
        least_bytes = least_bytes.max(Memory::share(request, threads, part).least_bytes);
        if let Some(leftover) = underway.leftover.filter(|leftover| !told.contains(leftover)) {
            told.push(leftover);
            tell(watch, Event::Leftover(leftover))?;
        }
    }
    if request.memory_bytes < least_bytes {
        tell(watch, Event::ShortOfMemory { least_bytes })?;
    }
    if let Some(whole) = &mut plan.instead_of {
        plan.instead_bytes = length(request, whole, threads, watch)?;
    }
    let (mut ready, mut estimates) = (Vec::new(), Vec::new());
    for (part, standing) in plan.parts.iter().zip(&*standing) {
        let made_ready = match standing {
            Standing::InPlace(..) => None,
            Standing::Build(underway) => {
                let place = (&underway.build, underway.begun.as_ref());
                Some(make_ready(request, part, place, threads, watch)?)
            }
        };
        let of_grid = || Estimate::of(part.description.grid.pyramid());
        estimates.push(made_ready.as_ref().map_or_else(of_grid, |ready: &Ready| ready.estimate));
        ready.push(made_ready);
    }
    let estimate = Estimate::together(&estimates);
    tell(watch, Event::Estimated(estimate))?;
    outcome.estimate = Some(estimate);

    let mut tally = Tally::new(plan.parts.iter().map(|part| &part.description));
    for ((part, standing), ready) in plan.parts.iter_mut().zip(standing).zip(ready) {
        let (Standing::Build(underway), Some(ready)) = (&mut *standing, ready) else {
            let units = units(&part.description) as u64;
            tell(watch, Event::Leftover(Leftover::Resumed { units, again: 0 }))?;
            outcome.resumed_units += units;
            let progress = tally.skip_part(&part.description, made(standing).1);
            tell(watch, Event::Building(progress))?;
            continue;
        };
        let begun = underway.begun.take();
        outcome.resumed_units += begun.as_ref().map_or(0, |begun| begun.archive.units);
        let mut is_untold = begun.is_some();
        let unit_end = &mut underway.unit_end;
        let mut note = |progress: Progress| {
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
            watch(Event::Building(tally.with(progress)))
        };
        let place = (&mut underway.build, begun);
        underway.written = Some(write(request, part, place, ready, threads, &mut note)?);
        tally.end_part();
    }
    outcome.pixels = tally.pixels();
    Ok(())
}

/// Makes all parts visible in one step.
fn publish(
    disk: &dyn Disk,
    request: &Request,
    plan: &Plan,
    standing: Vec<Standing<'_>>,
) -> Result<u64, IngestError> {
    let archives = plan.parts.iter().zip(standing).map(|(part, standing)| {
        let (finished, archive) = match standing {
            Standing::InPlace(archive, content) => (Finished::InPlace, (archive.len(), content)),
            Standing::Build(underway) => {
                let written = underway.written.expect("parts are written before any is published");
                (Finished::Build(underway.build), (written.bytes, written.content))
            }
        };
        (finished, dataset(request, plan, part, archive))
    });
    publish_archives(disk, &request.catalog, archives.collect()).map_err(|error| match error {
        // Another change has swept what stood in its place: the builds beside it are left.
        CatalogError::Missing { .. } => IngestError::Kept(Box::new(error.into())),
        error => kept(error.into()),
    })
}

/// The newest generation of the catalog, if there is one.
fn newest(folder: &Path) -> Result<Option<Catalog>, IngestError> {
    match Catalog::open(folder) {
        Ok(catalog) => Ok(Some(catalog)),
        Err(CatalogError::NotACatalog { .. }) => Ok(None),
        Err(error) => Err(error.into()),
    }
}

/// The archives that the catalog has under the name of `plan`, if they are the same datasets.
fn existing(
    catalog: &Catalog,
    plan: &Plan,
    policy: Existing,
) -> Result<Option<Vec<Archive>>, IngestError> {
    let group = plan.is_group.then_some(&*plan.called);
    for part in &plan.parts {
        catalog.check_free(&part.description.dataset, group)?;
    }
    let records = catalog.datasets().iter().filter(|record| record.called() == plan.called);
    let records: Vec<_> = records.collect();
    if records.is_empty() {
        return Ok(None);
    }
    let mut archives = Vec::new();
    for Part { description, .. } in &plan.parts {
        let record = records.iter().find(|record| record.name == description.dataset);
        let Some(record) = record else { continue };
        let archive = match (catalog.archive(record), policy) {
            (Ok(archive), _) => archive,
            // What cannot be read can be replaced.
            (Err(_), Existing::Replace) => return Ok(None),
            (Err(error), Existing::Keep) => return Err(error.into()),
        };
        if archive.description() == description && archive.summary().is_some() {
            archives.push(archive);
        }
    }
    if archives.len() == plan.parts.len() && archives.len() == records.len() {
        return Ok(Some(archives));
    }
    match policy {
        Existing::Replace => Ok(None),
        Existing::Keep => Err(CatalogError::Exists { name: plan.called.clone() }.into()),
    }
}
