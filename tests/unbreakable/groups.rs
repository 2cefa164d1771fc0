//! Three datasets that are one to the user.

use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use areoid_formats::catalog::{Build, Catalog, Existing, NewDataset, RealDisk, publish_builds};
use serde_json::Value;
use tempfile::TempDir;

use super::rig::{self, Tiny};

const MEMBERS: [&str; 3] = ["mola.band", "mola.north", "mola.south"];

/// A catalog of the group `mola` and a dataset `other` that covers it. The rasters of the parts
/// differ, and a later part covers those before it.
fn with_group() -> (TempDir, PathBuf) {
    let home = TempDir::new().unwrap();
    let (alone, catalog) = (home.path().join("alone"), home.path().join("catalog"));
    for (name, priority) in MEMBERS.into_iter().zip(["0", "1", "2"]) {
        let part = name.strip_prefix("mola.").unwrap();
        let options = ["--name", name, "--priority", priority];
        Tiny::new(part).subject.ingest(&alone, &options);
    }
    Tiny::new("other").subject.ingest(&catalog, &["--name", "other", "--priority", "9"]);
    let opened = Catalog::open(&alone).unwrap();
    let builds = opened.datasets().iter().cloned().map(|record| {
        let mut build = Build::start(&RealDisk, &catalog, &record.name).unwrap();
        build.write_all(&fs::read(opened.archive_path(&record)).unwrap()).unwrap();
        let dataset = NewDataset {
            name: record.name,
            group: Some("mola".to_owned()),
            kind: record.kind,
            priority: record.priority,
            body: opened.body().clone(),
            bytes: record.bytes,
            content: u64::from_str_radix(&record.content, 16).unwrap(),
            source: record.source,
            existing: Existing::Keep,
        };
        (build, dataset)
    });
    publish_builds(builds.collect()).unwrap();
    (home, catalog)
}

fn areoid(catalog: &Path, command: &str, arguments: &[&str]) -> Output {
    let mut areoid = Command::new(env!("CARGO_BIN_EXE_areoid"));
    areoid.arg(command).arg(catalog).args(arguments).output().unwrap()
}

/// What a command that must succeed prints.
fn told(catalog: &Path, command: &str, arguments: &[&str]) -> Value {
    let output = areoid(catalog, command, &[arguments, &["--json"]].concat());
    serde_json::from_slice(rig::stdout(&output)).unwrap()
}

/// The distinct `key`s in a list, in its order.
fn each(list: &Value, key: &str) -> Vec<String> {
    let all = list.as_array().unwrap().iter();
    let mut all: Vec<_> = all.map(|one| one[key].as_str().unwrap_or("-").to_owned()).collect();
    all.dedup();
    all
}

#[test]
fn a_group_answers_to_its_name() {
    let (_home, catalog) = with_group();
    let info = |arguments: &[&str]| told(&catalog, "info", arguments)["datasets"].clone();
    assert_eq!(each(&info(&[]), "name"), [&MEMBERS[..], &["other"]].concat());
    assert_eq!(each(&info(&[]), "group"), ["mola", "-"]);
    assert_eq!(each(&info(&["mola"]), "name"), MEMBERS);
    assert_eq!(each(&info(&["mola.north"]), "name"), ["mola.north"]);
    assert!(info(&["other"])[0]["group"].is_null());
    let text = areoid(&catalog, "info", &["mola"]);
    let text = String::from_utf8_lossy(rig::stdout(&text)).into_owned();
    assert!(text.contains("\nmola.north, part of mola: height"), "{text}");

    let verified = |name| {
        let report = told(&catalog, "verify", &["--dataset", name]);
        assert_eq!(report["ok"], true, "{report}");
        each(&report["levels"], "dataset")
    };
    assert_eq!(verified("mola"), MEMBERS);
    assert_eq!(verified("mola.south"), ["mola.south"]);

    let height = |arguments: &[&str]| {
        let answer = told(&catalog, "height", &[&["--at=20,40"], arguments].concat());
        let found = answer["points"][0].clone();
        (found["height_m"].as_f64().unwrap(), found["datasets"].to_string())
    };
    assert_eq!(height(&[]).1, r#"["other"]"#);
    let (whole, south) = (height(&["--dataset", "mola"]), height(&["--dataset", "mola.south"]));
    assert_eq!(whole, south);
    assert_eq!(whole.1, r#"["mola.south"]"#);
    assert_ne!(height(&["--dataset", "mola.band"]).0, whole.0);
}

#[test]
fn a_page_is_of_one_part() {
    let (_home, catalog) = with_group();
    let page = told(&catalog, "page", &["mola.band", "0", "0", "0"]);
    assert_eq!(page["dataset"], "mola.band");
    let refused = rig::assert_told(&areoid(&catalog, "page", &["mola", "0", "0", "0"]));
    assert!(refused.contains(&MEMBERS.join(", ")), "{refused}");
}

#[test]
fn a_group_goes_as_a_whole() {
    let (_home, catalog) = with_group();
    let refused = rig::assert_told(&areoid(&catalog, "remove", &["mola.band"]));
    assert!(refused.contains("mola.band is a part of mola"), "{refused}");
    let removed = told(&catalog, "remove", &["mola"]);
    assert_eq!((&removed["removed"], &removed["generation"]), (&"mola".into(), &3.into()));
    assert_eq!(rig::listed(&catalog), ["other"]);
    assert_eq!(rig::names_in(&catalog.join("archives")).len(), 1);
}

/// A raster on its own grid under the name of the group, and under that of a part.
#[test]
fn an_ingest_replaces_a_group_if_it_may() {
    let (_home, catalog) = with_group();
    let tiny = Tiny::new("mola");
    let ingest = |options: &[&str]| tiny.subject.command(&catalog, options).output().unwrap();
    let refused = rig::assert_told(&ingest(&["--name", "mola"]));
    assert!(refused.contains("called mola is there already"), "{refused}");
    for options in [&["--name", "mola.band"][..], &["--name", "mola.band", "--force"]] {
        let refused = rig::assert_told(&ingest(options));
        assert!(refused.contains("mola.band is a part of mola"), "{refused}");
    }
    assert_eq!(rig::listed(&catalog), [&MEMBERS[..], &["other"]].concat());
    // Nothing is left of them.
    assert_eq!(rig::names_in(&catalog.join("build")), [] as [&str; 0]);

    rig::stdout(&ingest(&["--name", "mola", "--force"]));
    assert_eq!(rig::listed(&catalog), ["mola", "other"]);
    assert_eq!(rig::names_in(&catalog.join("archives")).len(), 2);
}
