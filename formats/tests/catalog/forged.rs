//! Files in a catalog's folder that no writer left there.

use std::fs;

use areoid_formats::catalog::{Catalog, CatalogError, RealDisk};

use crate::rig::{publish, shown, two_datasets};

/// Files with names like a manifest's: somebody's copies, links to nowhere, the last generation.
#[test]
fn odd_files_do_not_hang_or_mislead() {
    let (_home, folder) = two_datasets();
    let before = shown(&folder);
    for name in
        ["manifest.007", "manifest.+9", "manifest.9x", "manifest.", "manifest.99999999999999999999"]
    {
        fs::write(folder.join(name), "nothing").unwrap();
        assert_eq!(shown(&folder), before, "{name}");
        fs::remove_file(folder.join(name)).unwrap();
    }
    let generation = Catalog::open(&folder).unwrap().generation();
    // Generation 2 under the name of generation 8.
    fs::copy(folder.join(format!("manifest.{generation}")), folder.join("manifest.8")).unwrap();
    assert!(matches!(Catalog::open(&folder), Err(CatalogError::Manifest { .. })));
    assert!(publish(&RealDisk, &folder, "x", 1).is_err());
    fs::remove_file(folder.join("manifest.8")).unwrap();
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink("nowhere", folder.join("manifest.8")).unwrap();
        assert!(matches!(Catalog::open(&folder), Err(CatalogError::Io { .. })));
        fs::remove_file(folder.join("manifest.8")).unwrap();
    }
    assert_eq!(shown(&folder), before);
}

/// A manifest whose checksum holds leads nowhere but into the folder of archives.
#[test]
fn a_forged_manifest_is_refused() {
    let (_home, folder) = two_datasets();
    let path = folder.join("manifest.2");
    let good = String::from_utf8(fs::read(&path).unwrap()).unwrap();
    let json = good.split_once('\n').unwrap().1;
    let file = Catalog::open(&folder).unwrap().dataset("old").unwrap().file.clone();
    let forge = |from: &str, to: &str| {
        assert!(json.contains(from), "{from}");
        let json = json.replace(from, to);
        let sum = xxhash_rust::xxh3::xxh3_64(json.as_bytes());
        fs::write(&path, format!("areoid-manifest 1 {sum:016x}\n{json}")).unwrap();
        Catalog::open(&folder)
    };
    forge("old", "old").unwrap();
    for (from, to) in [
        (file.as_str(), "../../secret"),
        (file.as_str(), "/etc/passwd"),
        (file.as_str(), ""),
        (r#""name":"old""#, r#""name":"../x""#),
        (r#""name":"older""#, r#""name":"old""#),
        (r#""generation":2"#, r#""generation":18446744073709551615"#),
        (r#""generation":2"#, r#""generation":-1"#),
    ] {
        let refused = forge(from, to);
        assert!(matches!(refused, Err(CatalogError::Manifest { .. })), "{to}: {refused:?}");
    }
    fs::rename(&path, folder.join("manifest.18446744073709551615")).unwrap();
    assert!(publish(&RealDisk, &folder, "x", 1).is_err());
}
