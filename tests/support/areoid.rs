//! The command line, run as anyone would.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use areoid_formats::archive::Archive;
use areoid_formats::catalog::Catalog;
use serde_json::Value;

/// Runs `areoid`.
pub(crate) fn areoid(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_areoid")).args(arguments).output().unwrap()
}

/// Runs `areoid`, which must succeed, and reads what it prints.
pub(crate) fn areoid_json(arguments: &[&str]) -> Value {
    let output = areoid(&[arguments, &["--json"]].concat());
    let errors = String::from_utf8_lossy(&output.stderr);
    let printed = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "areoid {arguments:?}: {errors}{printed}");
    serde_json::from_slice(&output.stdout).unwrap()
}

/// Ingests a raster into the catalog at `catalog`.
pub(crate) fn ingest(catalog: &Path, raster: &Path, options: &[&str]) -> Value {
    let (catalog, raster) = (catalog.to_str().unwrap(), raster.to_str().unwrap());
    areoid_json(&[&["ingest", raster, "--catalog", catalog], options].concat())
}

/// The archive of a catalog's only dataset.
pub(crate) fn only_archive(catalog: &Path) -> Archive {
    let (_, mut archives) = Catalog::open_with_archives(catalog).unwrap();
    assert_eq!(archives.len(), 1, "datasets");
    archives.remove(0)
}

/// The heights at positions in degrees, longitude first; `None` where there is none.
pub(crate) fn heights(catalog: &Path, points: &[[f64; 2]], options: &[&str]) -> Vec<Option<f64>> {
    let mut text = "lon,lat\n".to_owned();
    for [longitude, latitude] in points {
        writeln!(text, "{longitude},{latitude}").unwrap();
    }
    let file = tempfile::NamedTempFile::new().unwrap();
    fs::write(file.path(), text).unwrap();
    let (catalog, points_file) = (catalog.to_str().unwrap(), file.path().to_str().unwrap());
    let answer = areoid_json(&[&["height", catalog, "--points", points_file], options].concat());
    let answers = answer["points"].as_array().unwrap();
    assert_eq!(answers.len(), points.len());
    answers.iter().map(|point| point["height_m"].as_f64()).collect()
}

/// Holds a catalog against all laws, and its dataset `raster` against the file it was made from.
pub(crate) fn assert_verified(catalog: &Path, raster: &Path) {
    let (catalog, raster) = (catalog.to_str().unwrap(), raster.to_str().unwrap());
    for arguments in
        [&["verify", catalog][..], &["verify", catalog, "--against", raster, "--dataset", "raster"]]
    {
        let report = areoid_json(arguments);
        assert_eq!(report["ok"], true, "{report}");
        assert_eq!(report["problems"].as_array().map(Vec::len), Some(0));
    }
}
