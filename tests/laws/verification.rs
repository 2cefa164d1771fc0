//! `areoid verify` finds a promise that is not kept.

use std::fs;
use std::path::Path;

use areoid_formats::archive::record::{
    ALIGNMENT, Marker, RECORD_HEAD_LEN, RecordHead, parse_head, record_len,
};
use areoid_formats::archive::{Archive, ArchiveWriter, PageEntry, Written};
use areoid_formats::catalog::{Build, Catalog, Existing, NewDataset, RealDisk, publish_build};
use serde_json::Value;
use tempfile::TempDir;

use crate::support::areoid::{areoid, areoid_json, assert_verified, ingest, only_archive};
use crate::support::geotiff::{Samples, Writing};
use crate::support::levels::Edge;
use crate::support::raster::{Place, Random, Raster};

/// Writes an archive anew, record by record, each entry as `change` makes it.
fn rewritten(
    bytes: &[u8],
    archive: &Archive,
    change: impl Fn(PageEntry) -> PageEntry,
) -> (Vec<u8>, Written) {
    let description = archive.description();
    let json = description.to_json();
    let id = areoid_formats::archive::layout::archive_id(&json);
    let mut writer = ArchiveWriter::new(Vec::new(), description).unwrap();
    let units = archive.summary().unwrap().units;
    let mut units_seen = 0;
    let mut at = (areoid_formats::archive::layout::PREAMBLE_LEN + json.len())
        .next_multiple_of(ALIGNMENT as usize);
    while units_seen < units {
        let head: &[u8; RECORD_HEAD_LEN] = bytes[at..].first_chunk().unwrap();
        let (head, length) = parse_head(head, id).unwrap();
        let body = &bytes[at + RECORD_HEAD_LEN..][..length as usize];
        match head {
            RecordHead::Page(entry) => writer.page(change(entry), body).unwrap(),
            RecordHead::Marker(head) => {
                let marker = Marker::parse(head, body, at as u64).unwrap();
                for entry in marker.constants {
                    writer.page(change(entry), &[]).unwrap();
                }
                for (first, pages) in marker.empty_runs {
                    let keys = first.get()..first.get() + pages;
                    keys.map(areoid_formats::address::PageKey::from_raw)
                        .for_each(|key| writer.empty(key.into()));
                }
                writer.end_unit().unwrap();
                units_seen += 1;
            }
        }
        at += record_len(length).unwrap() as usize;
    }
    writer.finish().unwrap()
}

/// Puts `bytes` in the place of the dataset's archive.
fn replace(folder: &Path, bytes: &[u8], written: &Written) {
    let catalog = Catalog::open(folder).unwrap();
    let record = catalog.datasets()[0].clone();
    let mut build = Build::start(&RealDisk, folder, &record.name).unwrap();
    std::io::Write::write_all(&mut build, bytes).unwrap();
    let dataset = NewDataset {
        name: record.name,
        group: record.group,
        kind: record.kind,
        priority: record.priority,
        body: catalog.body().clone(),
        bytes: written.bytes,
        content: written.content,
        source: record.source,
        existing: Existing::Replace,
    };
    publish_build(build, dataset).unwrap();
}

/// Runs `areoid verify`, which must fail; what it complains of.
fn complaints(catalog: &Path, options: &[&str]) -> String {
    let verify = [&["verify", catalog.to_str().unwrap(), "--json"], options].concat();
    let output = areoid(&verify);
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["ok"], false);
    report["problems"].to_string()
}

#[test]
fn a_source_error_halved_by_hand_is_found() {
    let mut random = Random(45);
    let place = Place::Globe(Edge::PoleOnOutline, Edge::PoleOnOutline);
    let raster = Raster::new(place, (64, 128), Some((1.0, 0.0)), |_, _| {
        (random.unit() * 900.0).round() as f32
    });
    let folder = TempDir::new().unwrap();
    let file =
        Writing::of(&raster, Samples::Int16(-9999)).write(&raster, folder.path(), "raster.tif");
    let catalog = folder.path().join("catalog");
    ingest(&catalog, &file, &["--page-size", "18", "--grid", "polar-north"]);
    assert_verified(&catalog, &file);

    let archive = only_archive(&catalog);
    let opened = Catalog::open(&catalog).unwrap();
    let bytes = fs::read(opened.archive_path(&opened.datasets()[0])).unwrap();
    let entries = archive.entries().unwrap();
    let finest = archive.description().grid.pyramid().finest();
    let leaves = || entries.iter().filter(|entry| entry.page.level == finest);
    let worst = leaves().map(|entry| entry.source_error).fold(0.0, f32::max);
    let victim = leaves().find(|entry| entry.source_error == worst).unwrap().page;
    let (damaged, written) = rewritten(&bytes, &archive, |entry| {
        let halved = PageEntry { source_error: entry.source_error / 2.0, ..entry };
        if entry.page == victim { halved } else { entry }
    });
    replace(&catalog, &damaged, &written);
    let against = ["--against", file.to_str().unwrap(), "--dataset", "raster"];
    let found = complaints(&catalog, &against);
    assert!(found.contains(&victim.to_string()), "{victim} is not named: {found}");
    // Without the raster there is nothing to hold it against.
    areoid_json(&["verify", catalog.to_str().unwrap()]);
}

#[test]
fn a_bound_halved_by_hand_is_found() {
    let mut random = Random(44);
    let place = Place::Globe(Edge::PoleOnOutline, Edge::PoleOnOutline);
    let raster = Raster::new(place, (64, 128), Some((1.0, 0.0)), |row, col| {
        let hole = row / 9 == 2 && col / 11 == 3;
        if hole { f32::NAN } else { (random.unit() * 900.0).round() as f32 }
    });
    let folder = TempDir::new().unwrap();
    let file =
        Writing::of(&raster, Samples::Int16(-9999)).write(&raster, folder.path(), "raster.tif");
    let catalog = folder.path().join("catalog");
    ingest(&catalog, &file, &["--page-size", "18"]);
    assert_verified(&catalog, &file);

    let archive = only_archive(&catalog);
    let opened = Catalog::open(&catalog).unwrap();
    let bytes = fs::read(opened.archive_path(&opened.datasets()[0])).unwrap();
    let (same, _) = rewritten(&bytes, &archive, |entry| entry);
    assert!(same == bytes, "writing the records again changes the archive");

    let finest = archive.description().grid.pyramid().finest();
    let halved = |entry: PageEntry| PageEntry { bound: entry.bound / 2.0, ..entry };
    // One page of each level that has a bound: both the root's and its children's are watched.
    for level in 0..finest.0 {
        let entries = archive.entries().unwrap();
        let victim = entries.iter().rfind(|entry| entry.page.level.0 == level).unwrap().page;
        let only_it = |entry: PageEntry| if entry.page == victim { halved(entry) } else { entry };
        let (damaged, written) = rewritten(&bytes, &archive, only_it);
        replace(&catalog, &damaged, &written);
        let found = complaints(&catalog, &[]);
        assert!(found.contains("law 1") || found.contains("law 2"), "{found}");
        assert!(found.contains(&victim.to_string()), "{victim} is not named: {found}");
        let against = ["--against", file.to_str().unwrap(), "--dataset", "raster"];
        complaints(&catalog, &against);
    }
    // All above the leaves: no page contradicts another, brute force alone does.
    let all_above =
        |entry: PageEntry| if entry.page.level < finest { halved(entry) } else { entry };
    let (damaged, written) = rewritten(&bytes, &archive, all_above);
    replace(&catalog, &damaged, &written);
    let found = complaints(&catalog, &[]);
    assert!(found.contains("law 1") && !found.contains("law 2"), "{found}");

    replace(&catalog, &bytes, &rewritten(&bytes, &archive, |entry| entry).1);
    assert_verified(&catalog, &file);
}
