//! Law 8: an archive's bytes depend on its input and options alone.

use std::fs;
use std::path::Path;

use areoid_formats::catalog::Catalog;
use tempfile::TempDir;

use crate::support::areoid::ingest;
use crate::support::geotiff::{Samples, Writing};
use crate::support::levels::Edge;
use crate::support::raster::{Place, Random, Raster};

/// Name and bytes of the archive of a catalog's only dataset.
fn archive_file(catalog: &Path) -> (String, Vec<u8>) {
    let catalog = Catalog::open(catalog).unwrap();
    let [record] = catalog.datasets() else { panic!("one dataset was ingested") };
    (record.file.clone(), fs::read(catalog.archive_path(record)).unwrap())
}

#[test]
fn bytes_depend_on_nothing_but_the_input() {
    let mut random = Random(2);
    let place = Place::Globe(Edge::PoleOnOutline, Edge::PoleOnOutline);
    let raster = Raster::new(place, (128, 256), Some((1.0, 0.0)), |row, col| {
        let hole = (row / 20 + col / 30) % 3 == 0;
        let plain = col > 150 && row > 50;
        let height = if plain { 9.0 } else { (random.unit() * 4000.0).round() as f32 };
        if hole { f32::NAN } else { height }
    });
    for options in [
        &[][..],
        &["--mip", "kaiser"],
        &["--grid", "polar-north", "--mip", "kaiser"],
        &["--pixel-size-m", "90000"],
    ] {
        check(&raster, options);
    }
}

/// The same with one thread and eight.
fn check(raster: &Raster, options: &[&str]) {
    let mut first: Option<(String, Vec<u8>)> = None;
    for threads in ["1", "2", "4", "8", "8", "1"] {
        let folder = TempDir::new().unwrap();
        let file = Writing::of(raster, Samples::Int16(-1)).write(raster, folder.path(), "g.tif");
        let catalog = folder.path().join("catalog");
        ingest(&catalog, &file, &[&["--threads", threads, "--page-size", "18"], options].concat());
        let found = archive_file(&catalog);
        let expected = first.get_or_insert_with(|| found.clone());
        assert_eq!(found.0, expected.0, "the name of the archive with {threads} threads");
        assert!(found.1 == expected.1, "the bytes of the archive with {threads} threads");
    }
    let (_, bytes) = first.unwrap();
    assert!(bytes.len() > 1 << 19, "an archive of {} bytes tries little", bytes.len());
}
