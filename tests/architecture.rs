//! The shape of the workspace: data flows one way, and so do dependencies.
//!
//! ```text
//! raster --> pages --> index --> cache --> atlas --> pixels
//! \______ preprocess ______/     \cache/   \___ viewer ___/
//!            \________________ formats ________________/
//! ```

#![expect(clippy::unwrap_used, reason = "a failed test may panic")]

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

/// What `package` depends on, tests and benches aside.
fn dependencies(package: &str) -> BTreeSet<String> {
    let manifest = Path::new(env!("CARGO_MANIFEST_DIR")).join(package).join("Cargo.toml");
    let manifest = fs::read_to_string(manifest).unwrap();
    let (_, section) = manifest.split_once("\n[dependencies]\n").unwrap();
    section
        .lines()
        .take_while(|line| !line.starts_with('['))
        .filter_map(|line| line.split(['.', ' ', '=']).next())
        .filter(|name| !name.is_empty())
        .map(str::to_owned)
        .collect()
}

fn assert_depends(package: &str, ours: &[&str], strangers: &[&str]) {
    let found = dependencies(package);
    let own: BTreeSet<&str> =
        found.iter().filter_map(|name| name.strip_prefix("areoid-")).collect();
    assert_eq!(own, ours.iter().copied().collect(), "{package}");
    for stranger in strangers {
        assert!(!found.contains(*stranger), "{package} must know nothing of {stranger}");
    }
}

#[test]
fn data_flow_one_way() {
    assert_depends("formats", &[], &["rayon", "tokio", "wgpu", "winit"]);
    assert_depends("preprocess", &["formats"], &["tokio", "wgpu", "winit"]);
    assert_depends("cache", &["formats", "preprocess"], &["rayon", "wgpu", "winit"]);
    assert_depends("viewer", &["cache", "formats"], &["tiff", "rayon", "tokio"]);
}
