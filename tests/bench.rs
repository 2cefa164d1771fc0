//! `areoid bench`: reports are complete, and say who was not there to be compared with.

#![expect(clippy::unwrap_used, reason = "a failed test may panic")]

#[cfg(all(feature = "viewer", target_os = "linux"))]
mod support {
    pub(crate) mod validation;
}

use std::fs;
use std::path::Path;
use std::process::Command;
use std::thread;

use serde_json::Value;

/// `areoid bench ingest` into `folder`, where no other program is to be found; its JSON.
fn ingest(folder: &Path, options: &[&str]) -> Value {
    let output = Command::new(env!("CARGO_BIN_EXE_areoid"))
        .args(["bench", "ingest", "--json", "--runs", "1", "-o"])
        .arg(folder)
        .args(options)
        .current_dir(folder)
        .env("PATH", "")
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn array<'a>(document: &'a Value, pointer: &str) -> &'a [Value] {
    document.pointer(pointer).and_then(Value::as_array).map(Vec::as_slice).unwrap()
}

#[test]
fn a_tiny_book_is_complete_and_names_who_is_absent() {
    let folder = tempfile::tempdir().unwrap();
    let report = ingest(folder.path(), &["--megapixels", "0.02"]);
    let written = fs::read(folder.path().join("ingest.json")).unwrap();
    assert_eq!(serde_json::from_slice::<Value>(&written).unwrap(), report);

    for peer in array(&report, "/peers") {
        assert_eq!(peer["found"], false, "{peer}");
    }
    let tables = fs::read_to_string(folder.path().join("ingest.md")).unwrap();
    assert!(tables.contains(
        "Absent, and not compared with: vips, lz4, gdal_translate, gdalwarp, python osgeo."
    ));

    let rasters = array(&report, "/chapters/pairs");
    assert_eq!(rasters.len(), 4);
    for raster in rasters {
        let contenders = array(raster, "/contenders");
        let names: Vec<_> = contenders.iter().map(|runs| runs["name"].as_str().unwrap()).collect();
        assert_eq!(names, ["areoid ingest", "areoid decode"]);
        for contender in contenders {
            assert_eq!(contender["failed"], Value::Null);
            assert!(contender["runs"][0]["wall_s"].as_f64().unwrap() > 0.0);
        }
    }
    assert_eq!(array(&report, "/chapters/tightness").len(), 2);
    let leaves = &report["chapters"]["size"][0];
    assert!(leaves["stored_bytes"].as_u64().unwrap() > 0 && leaves["over_gdal"].is_null());
    assert!(leaves["decode_int16_bytes_per_s"]["median"].as_f64().unwrap() > 0.0);
    for map in array(&report, "/chapters/scaling") {
        assert!(map["rounds"][0][0]["peak_resident_bytes"].as_u64().is_some());
    }

    let targets = array(&report, "/targets");
    for target in targets {
        assert_eq!(target["met"].is_null(), target["measured"].is_null(), "{target}");
        assert!(tables.contains(target["what"].as_str().unwrap()), "{target}");
    }
    let absent = targets.iter().filter(|target| target["what"].as_str().unwrap().contains("vips"));
    assert!(absent.into_iter().all(|target| target["measured"].is_null()));
    assert!(!folder.path().join("work").exists(), "nothing but results and rasters stays");
}

#[test]
fn bounds_of_made_up_terrain_hold_and_its_rasters_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let options = ["--megapixels", "1.2", "--chapter", "tightness"];
    let report = ingest(folder.path(), &options);
    let rasters = || {
        let files = fs::read_dir(folder.path().join("rasters")).unwrap();
        let mut found: Vec<_> = files
            .map(|file| file.unwrap())
            .map(|file| (file.path(), file.metadata().unwrap().modified().unwrap()))
            .collect();
        found.sort();
        found
    };
    let made = rasters();
    assert_eq!(made.len(), 2);
    let terrain = &report["chapters"]["tightness"][0];
    assert_eq!(array(terrain, "/problems"), &[] as &[Value]);
    assert_eq!(terrain["has_holes"], false);
    assert!(terrain["levels"][0]["min"].as_f64().unwrap() >= 1.0, "{terrain}");
    assert_eq!(report["chapters"]["tightness"][1]["has_holes"], true);

    assert_eq!(ingest(folder.path(), &options)["chapters"], report["chapters"]);
    assert_eq!(rasters(), made);
}

/// The cache's book at a size that says nothing but that all of it is measured.
#[test]
fn a_tiny_book_of_the_cache_is_complete() {
    let folder = tempfile::tempdir().unwrap();
    let output = Command::new(env!("CARGO_BIN_EXE_areoid"))
        .args(["bench", "cache", "--json", "--seconds", "0.2", "--share", "0.002", "-o"])
        .arg(folder.path())
        .args(["--chapter", "frame", "skipping", "ahead", "budget", "eviction", "lookups", "tree"])
        .current_dir(folder.path())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    let written = fs::read(folder.path().join("cache.json")).unwrap();
    assert_eq!(serde_json::from_slice::<Value>(&written).unwrap(), report);
    let tables = fs::read_to_string(folder.path().join("cache.md")).unwrap();
    let targets = array(&report, "/targets");
    assert!(targets.len() >= 15, "{}", targets.len());
    for target in targets {
        assert!(target["measured"].as_f64().is_some(), "{target}");
        assert!(tables.contains(target["what"].as_str().unwrap()), "{target}");
    }
    for chapter in ["frame", "skipping", "ahead", "budget", "eviction", "lookups", "tree"] {
        assert!(!report["chapters"][chapter].is_null(), "{chapter}");
    }
    assert!(!folder.path().join("work").exists());
}

fn can_be_parted() -> bool {
    cfg!(target_os = "linux") && thread::available_parallelism().is_ok_and(|cores| cores.get() > 1)
}

/// The service's chapters at a size that says nothing, with `path` to look for others in; the report, its
/// tables, and what is left.
fn serving(path: Option<&str>) -> (Value, String) {
    let folder = tempfile::tempdir().unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_areoid"));
    command.args(["bench", "cache", "--json", "--seconds", "0.2", "--share", "0.04", "-o"]);
    command.arg(folder.path()).args(["--chapter", "serve", "live"]).current_dir(folder.path());
    command.envs(path.map(|path| ("PATH", path)));
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(!folder.path().join("work").exists(), "nothing but results stays");
    let tables = fs::read_to_string(folder.path().join("cache.md")).unwrap();
    (serde_json::from_slice(&output.stdout).unwrap(), tables)
}

#[test]
fn serving_is_not_measured_without_those_who_ask_and_says_so() {
    let (report, tables) = serving(Some(""));
    assert!(tables.contains("Absent, and not compared with: nginx, wrk."), "{tables}");
    let targets = array(&report, "/targets");
    // Where there is one core, nobody can be asked from another one.
    let setups = if can_be_parted() { 2 } else { 1 };
    assert_eq!(targets.len(), 12 + setups + 2);
    let (asked, seen) = targets.split_at(12 + setups);
    assert!(asked.iter().all(|target| target["measured"].is_null()), "{asked:?}");
    // How soon an insertion is seen is measured by itself.
    for target in seen {
        assert!(target["measured"].as_f64().unwrap() < 30.0, "{target}");
    }
    assert_eq!(array(&report, "/chapters/serve"), &[] as &[Value]);
}

#[test]
fn serving_is_measured_beside_nginx_where_that_is_installed() {
    let (report, tables) = serving(None);
    let peers = array(&report, "/peers");
    if peers.iter().any(|peer| peer["found"] == false) {
        assert!(tables.contains("Absent, and not compared with: "), "{tables}");
        return;
    }
    let cases = array(&report, "/chapters/serve");
    assert_eq!(cases.len(), 6);
    for case in cases {
        let servers = array(case, "/servers");
        assert_eq!(servers.len(), 3, "{case}");
        for server in servers {
            let runs = array(server, "/runs");
            assert!(runs.iter().all(|run| run["requests_per_s"].as_f64().unwrap() > 0.0), "{case}");
            assert!(runs.iter().all(|run| run["p99_ms"].as_f64() >= run["p50_ms"].as_f64()));
        }
    }
    let measured = array(&report, "/targets").iter().filter(|one| one["measured"].is_f64());
    assert!(measured.count() >= 12 + 2, "{report}");
    let cases = array(&report, "/chapters/live/cases");
    assert_eq!(cases.len(), if can_be_parted() { 2 } else { 1 });
    for case in cases {
        let alone = array(case, "/alone");
        assert!(!alone.is_empty() && alone.iter().all(|run| run["p99_ms"].as_f64() > Some(0.0)));
    }
}

/// The viewer's book at a size that says nothing but that all of it is measured.
#[cfg(feature = "viewer")]
#[test]
fn a_tiny_book_of_the_viewer_is_complete() {
    let folder = tempfile::tempdir().unwrap();
    #[cfg(target_os = "linux")]
    let validation = support::validation::Validation::new(folder.path());
    let mut command = Command::new(env!("CARGO_BIN_EXE_areoid"));
    #[cfg(target_os = "linux")]
    validation.watch(&mut command);
    let output = command
        .args(["bench", "view", "--json", "--megapixels", "0.1", "--size", "64x36"])
        .args(["--rounds", "2", "--frames", "2", "--pace", "fast", "-o"])
        .arg(folder.path())
        .current_dir(folder.path())
        .env("XDG_RUNTIME_DIR", std::env::temp_dir())
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    #[cfg(target_os = "linux")]
    validation.assert_silent();
    let written = fs::read(folder.path().join("view.json")).unwrap();
    assert_eq!(serde_json::from_slice::<Value>(&written).unwrap(), report);
    let tables = fs::read_to_string(folder.path().join("view.md")).unwrap();
    let adapter = report["options"]["adapter"].as_str().unwrap();
    assert!(tables.contains(adapter), "{tables}");

    let flights = array(&report, "/chapters/flights");
    assert_eq!(flights.len(), 4);
    for flight in flights {
        assert_eq!(flight["summary"]["frames"], 2);
        assert!(flight["summary"]["frames_per_s"].as_f64().unwrap() > 0.0, "{flight}");
        assert!(tables.contains(flight["flight"].as_str().unwrap()));
    }
    let cost = &report["chapters"]["cost"];
    assert!(cost["trivial_ms"]["median"].as_f64().unwrap() > 0.0);
    let overlaps = array(cost, "/overlaps");
    assert_eq!((overlaps.len(), array(cost, "/poles").len()), (4, 6));
    assert_eq!(overlaps[0]["ratio"]["median"], 1.0);
    assert!(overlaps[3]["wanted"].as_u64().unwrap() == 8 * overlaps[0]["wanted"].as_u64().unwrap());
    let skipping = array(&report, "/chapters/skipping");
    assert_eq!(skipping.len(), 10);
    for view in skipping {
        let of = |key: &str| view[key].as_u64().unwrap_or_else(|| panic!("{key} in {view}"));
        for (all, seen) in
            [("pages", "pages_seen"), ("patches", "patches_seen"), ("bytes_uploaded", "bytes_seen")]
        {
            assert!(of(seen) > 0 && of(seen) <= of(all), "{view}");
        }
        assert!(of("pixels") > 100 && of("points") > 100, "{view}");
        assert_eq!((of("again_bytes"), &view["again_drawn"]), (0, &Value::Bool(false)), "{view}");
    }
    let targets = array(&report, "/targets");
    assert_eq!(targets.len(), 5);
    for target in targets {
        let is_rest = target["what"].as_str().unwrap().ends_with("at rest");
        assert_eq!(target["measured"].as_f64().unwrap() == 0.0, is_rest, "{target}");
        assert!(tables.contains(target["what"].as_str().unwrap()), "{target}");
    }
    assert!(!folder.path().join("work").exists(), "nothing but results and rasters stays");
}
