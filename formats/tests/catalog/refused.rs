//! Changes and names that are refused, and leave everything as it was.

use areoid_formats::archive::Source;
use areoid_formats::body::Body;
use areoid_formats::catalog::{
    Build, CatalogError, Existing, NewDataset, RealDisk, publish_build, remove_dataset,
};
use areoid_formats::page::Kind;

use crate::rig::{check_swept, names_in, publish, publish_over, shown, two_datasets};

#[test]
fn a_second_builder_of_a_name_is_told() {
    let home = tempfile::tempdir().unwrap();
    let one = Build::start(&RealDisk, home.path(), "mola").unwrap();
    let busy =
        |name| matches!(Build::start(&RealDisk, home.path(), name), Err(CatalogError::Busy { .. }));
    assert!(busy("mola"));
    assert!(!busy("viking"));
    drop(one);
    assert!(!busy("mola"), "a lock goes with its builder");

    let one = Build::start(&RealDisk, home.path(), "mola").unwrap();
    one.discard().unwrap();
    assert!(!home.path().join("build/mola.part").exists());
}

#[test]
fn names_that_are_not_plain_are_refused() {
    let home = tempfile::tempdir().unwrap();
    let folder = home.path().join("mars");
    let long = "x".repeat(200);
    for name in
        ["", "../x", "..", ".", ".hidden", "a/b", "a\\b", "a b", "a\0", "-x", "ä", "a\n", &long]
    {
        let refused = Build::start(&RealDisk, &folder, name);
        assert!(matches!(refused, Err(CatalogError::Name { .. })), "{name:?}");
        assert!(!folder.exists(), "{name:?} leaves something behind");
    }
    for name in ["a", "mola.band", "9-x_Y.", &long[..100]] {
        publish(&RealDisk, &folder, name, 1).unwrap();
    }
    assert_eq!(shown(&folder).len(), 4);
    check_swept(&folder);
}

#[test]
fn a_refused_change_leaves_everything() {
    let (_home, folder) = two_datasets();
    let before = (shown(&folder), names_in(&folder));
    let gone = remove_dataset(&RealDisk, &folder, "oldest");
    assert!(matches!(gone, Err(CatalogError::NoSuchDataset { .. })));
    let nowhere = remove_dataset(&RealDisk, &folder.join("build"), "old");
    assert!(matches!(nowhere, Err(CatalogError::NotACatalog { .. })));
    let build = Build::start(&RealDisk, &folder, "moon").unwrap();
    let dataset = NewDataset {
        name: "moon".to_owned(),
        group: None,
        kind: Kind::Height,
        priority: 0,
        body: Body::parse("moon").unwrap(),
        bytes: 0,
        content: 0,
        source: Source::default(),
        existing: Existing::Replace,
    };
    let other = publish_build(build, dataset);
    assert!(matches!(other, Err(CatalogError::OtherBody { .. })));
    assert_eq!((shown(&folder), names_in(&folder)), before);
    assert!(names_in(&folder.join("build")).is_empty());
}

/// Two builders without `--force` who both found no dataset of the name: one looked before the other
/// published and locked the build after. The second replaced what the first had published.
#[test]
fn what_was_published_meanwhile_is_not_replaced_unasked() {
    let (_home, folder) = two_datasets();
    let before = shown(&folder);
    let refused = publish_over(Existing::Keep, &RealDisk, &folder, "old", 7);
    assert!(matches!(refused, Err(CatalogError::Exists { .. })), "{refused:?}");
    assert_eq!(shown(&folder), before);
    assert_eq!(names_in(&folder.join("build")), [] as [&str; 0]);
    check_swept(&folder);
    // The same again is no loss.
    publish_over(Existing::Keep, &RealDisk, &folder, "old", 1).unwrap();
    assert_eq!(shown(&folder), before);
}
