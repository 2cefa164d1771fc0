//! A catalog of more datasets than a process may have files open.

use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

use serde_json::Value;
use tempfile::TempDir;

use super::rig::{self, Tiny};

const DATASETS: usize = 60;

/// Beside three streams, the program's own and those of its threads.
const DESCRIPTORS: usize = 20;

/// What `areoid` prints with so few descriptors.
fn run(command: &str, catalog: &Path, options: &[&str]) -> Value {
    let mut shell = Command::new("sh");
    shell.args(["-c", "ulimit -n \"$0\"; exec \"$@\"", &DESCRIPTORS.to_string()]);
    shell.args([env!("CARGO_BIN_EXE_areoid"), command]).arg(catalog).arg("--json").args(options);
    let output = shell.output().unwrap();
    assert!(output.status.success(), "{command}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn a_catalog_has_more_datasets_than_files_are_open() {
    let home = TempDir::new().unwrap();
    let tiny = Tiny::new("tiny");
    for number in 0..DATASETS {
        tiny.subject.ingest(home.path(), &["--name", &format!("tiny-{number}")]);
    }
    let info = run("info", home.path(), &[]);
    assert_eq!(info["datasets"].as_array().unwrap().len(), DATASETS);
    assert_eq!(run("verify", home.path(), &[])["ok"], true);
    // Datasets of one priority answer together, each read of its own file.
    let height = run("height", home.path(), &["--at", "10,20"]);
    let datasets: BTreeSet<_> = height["points"][0]["datasets"]
        .as_array()
        .unwrap()
        .iter()
        .map(|name| name.as_str().unwrap().to_owned())
        .collect();
    assert_eq!(datasets, rig::listed(home.path()).into_iter().collect());
}
