//! Datasets that come and go as one.

use std::fs;
use std::path::Path;

use areoid_formats::catalog::{
    Build, Catalog, CatalogError, Existing, Finished, NewDataset, RealDisk, publish_archives,
    publish_build, publish_builds, remove_dataset, stray,
};
use areoid_formats::storage::ByteSource as _;

use crate::dying::{Dying, Last};
use crate::rig::{
    Parts, SPLIT, build, built, check_swept, description, names_in, publish, publish_group, shown,
    two_datasets, with_group,
};

/// The datasets that a name means, and their numbers.
fn members(folder: &Path, name: &str) -> Vec<(String, u32)> {
    let catalog = Catalog::open(folder).unwrap();
    let records = catalog.named(name).unwrap();
    records.iter().map(|record| (record.name.clone(), record.item)).collect()
}

#[test]
fn a_name_means_a_dataset_or_all_parts_of_a_group() {
    let (_home, folder) = with_group();
    let names = |name| members(&folder, name).into_iter().map(|(name, _)| name).collect::<Vec<_>>();
    assert_eq!(names("split"), ["split.band", "split.north", "split.south"]);
    assert_eq!(names("split.north"), ["split.north"]);
    assert_eq!(names("old"), ["old"]);

    let catalog = Catalog::open(&folder).unwrap();
    let unknown = |name| matches!(catalog.named(name), Err(CatalogError::NoSuchDataset { .. }));
    assert!(["spli", "split.", "split.cap", "band", ""].into_iter().all(unknown));
    assert_eq!(catalog.dataset("split.north").unwrap().called(), "split");
    let told = catalog.dataset("split").unwrap_err().to_string();
    assert_eq!(told, "split is a group: name one of split.band, split.north, split.south");
}

/// A plain dataset, a group, another group and a plain dataset again under one name.
#[test]
fn a_dataset_and_a_group_replace_each_other() {
    let (_home, folder) = two_datasets();
    let generation = Catalog::open(&folder).unwrap().generation();
    publish_group(&RealDisk, &folder, "old", SPLIT).unwrap();
    assert_eq!(members(&folder, "old").len(), 3);
    publish_group(&RealDisk, &folder, "old", &[("cap", 1)]).unwrap();
    assert_eq!(members(&folder, "old"), [("old.cap".to_owned(), 0)]);
    publish(&RealDisk, &folder, "old", 8).unwrap();
    assert_eq!(members(&folder, "old"), [("old".to_owned(), 0)]);
    publish_group(&RealDisk, &folder, "old", SPLIT).unwrap();
    remove_dataset(&RealDisk, &folder, "old").unwrap();
    assert!(shown(&folder).keys().eq(["older"]));
    assert_eq!(Catalog::open(&folder).unwrap().generation(), generation + 5);
    check_swept(&folder);
}

/// A part that is replaced keeps its number, also where new parts would take one before it.
#[test]
fn parts_keep_their_numbers() {
    let (_home, folder) = with_group();
    let numbered = |parts: &[(&str, u32)]| -> Vec<_> {
        parts.iter().map(|(part, item)| (format!("split.{part}"), *item)).collect()
    };
    assert_eq!(members(&folder, "split"), numbered(&[("band", 2), ("north", 3), ("south", 4)]));
    let parts = [("cap", 7), ("south", 7), ("zone", 7)];
    publish_group(&RealDisk, &folder, "split", &parts).unwrap();
    let expected = [("cap", 2), ("south", 4), ("zone", 3)];
    assert_eq!(members(&folder, "split"), numbered(&expected));
    let (catalog, _) = Catalog::open_with_archives(&folder).unwrap();
    assert!(catalog.datasets().iter().all(|record| catalog.bvh().get(record.item).is_some()));
}

#[test]
fn what_the_user_calls_the_same_is_not_replaced_unasked() {
    let (_home, folder) = with_group();
    let before = shown(&folder);
    let keep = |name: &str, parts: Parts<'_>| {
        let built = built(&RealDisk, &folder, name, parts).unwrap().into_iter();
        let one_asks = built.enumerate().map(|(place, (build, dataset))| {
            let existing = if place == 1 { Existing::Keep } else { Existing::Replace };
            (build, NewDataset { existing, ..dataset })
        });
        publish_builds(one_asks.collect())
    };
    let other = [("band", 4), ("north", 5), ("south", 7)];
    let fewer = [("band", 4), ("north", 5)];
    for refused in [keep("split", &other), keep("split", &fewer), keep("old", SPLIT)] {
        let is_told = matches!(&refused, Err(CatalogError::Exists { name }) if !name.contains('.'));
        assert!(is_told, "{refused:?}");
    }
    let (plain, dataset) = build(&RealDisk, &folder, "split", 4).unwrap();
    let refused = publish_build(plain, NewDataset { existing: Existing::Keep, ..dataset });
    assert!(matches!(refused, Err(CatalogError::Exists { .. })), "{refused:?}");
    assert_eq!(shown(&folder), before);
    assert_eq!(names_in(&folder.join("build")), [] as [&str; 0]);
    // The same again is no loss, and another name is free.
    keep("split", SPLIT).unwrap();
    assert_eq!(shown(&folder), before);
    keep("other", SPLIT).unwrap();
    check_swept(&folder);
}

/// A part taken for a dataset of its own, and a dataset for a part: neither goes unasked.
#[test]
fn names_that_meet_are_refused() {
    let (_home, folder) = with_group();
    publish(&RealDisk, &folder, "alone.band", 3).unwrap();
    publish_group(&RealDisk, &folder, "group.band", SPLIT).unwrap();
    let before = shown(&folder);

    let a_part = |result: Result<u64, CatalogError>| {
        assert!(matches!(result, Err(CatalogError::Part { .. })), "{result:?}");
    };
    a_part(remove_dataset(&RealDisk, &folder, "split.band"));
    a_part(publish(&RealDisk, &folder, "split.band", 9));
    a_part(publish_group(&RealDisk, &folder, "split.band", SPLIT));
    a_part(publish_group(&RealDisk, &folder, "group", &[("band.north", 1)]));
    for group in ["alone", "group"] {
        let taken = publish_group(&RealDisk, &folder, group, SPLIT);
        assert!(matches!(taken, Err(CatalogError::PartTaken { .. })), "{taken:?}");
    }
    let catalog = Catalog::open(&folder).unwrap();
    assert!(catalog.check_free("split.band", None).is_err());
    assert!(catalog.check_free("alone.band", Some("alone")).is_err());
    for (name, group) in [("split", None), ("old", None), ("split.x", Some("split"))] {
        catalog.check_free(name, group).unwrap();
    }
    assert_eq!(shown(&folder), before);
    assert_eq!(names_in(&folder.join("build")), [] as [&str; 0]);
}

/// Killed among its renames, a group is a mixture of archives in their places and whole builds. All
/// are there, and only have to be published.
#[test]
fn what_is_left_of_a_group_is_published_without_building() {
    let mut seen = [0; 4];
    let (_home, folder) = two_datasets();
    let whole = Dying::after(usize::MAX, Last::Undone);
    built(&whole, &folder, "split", SPLIT).unwrap();
    let steps_to_build = whole.log.lock().unwrap().len();
    for steps in steps_to_build.. {
        let (_home, folder) = two_datasets();
        let disk = Dying::after(steps, Last::Undone);
        let builds = built(&disk, &folder, "split", SPLIT).unwrap();
        let datasets: Vec<_> = builds.iter().map(|(_, dataset)| dataset.clone()).collect();
        let killed = publish_builds(builds);
        assert_eq!(killed.is_ok(), !disk.died());
        let names = |name: &str| shown(&folder).keys().any(|shown| shown.starts_with(name));
        if !names("split") {
            let found: Vec<_> = datasets
                .into_iter()
                .map(|dataset| {
                    let name = &dataset.name;
                    if stray(&folder, &description(name)).unwrap().is_some() {
                        return (Finished::InPlace, dataset);
                    }
                    let build = Build::resume(&RealDisk, &folder, name).unwrap();
                    assert_eq!(build.source().unwrap().len(), dataset.bytes, "{name}: {steps}");
                    (Finished::Build(build), dataset)
                })
                .collect();
            seen[found.iter().filter(|(found, _)| matches!(found, Finished::InPlace)).count()] += 1;
            publish_archives(&RealDisk, &folder, found).unwrap();
        }
        assert_eq!(shown(&folder).len(), 5, "{steps}");
        assert_eq!(names_in(&folder.join("build")), [] as [&str; 0], "{steps}");
        if !disk.died() {
            break;
        }
    }
    assert!(seen.iter().all(|&times| times > 0), "{seen:?}");
}

/// What stood in its place was swept: the builds beside it wait for it to be built again.
#[test]
fn builds_wait_for_a_part_that_was_swept() {
    let (_home, folder) = two_datasets();
    let before = shown(&folder);
    let mut parts = built(&RealDisk, &folder, "split", SPLIT).unwrap();
    let (band, dataset) = parts.remove(0);
    band.discard().unwrap();
    let mut archives = vec![(Finished::InPlace, dataset)];
    archives.extend(parts.into_iter().map(|(build, dataset)| (Finished::Build(build), dataset)));
    let missing = publish_archives(&RealDisk, &folder, archives);
    assert!(matches!(missing, Err(CatalogError::Missing { .. })), "{missing:?}");
    assert_eq!(shown(&folder), before);
    assert_eq!(names_in(&folder.join("build")), ["split.north.part", "split.south.part"]);
}

/// The parts of a group are on the medium, and so are their names, before the manifest has its own.
#[test]
fn no_part_is_relied_on_before_it_is_synced() {
    let (_home, folder) = two_datasets();
    let disk = Dying::after(usize::MAX, Last::Undone);
    let builds = built(&disk, &folder, "split", SPLIT).unwrap();
    disk.log.lock().unwrap().clear();
    publish_builds(builds).unwrap();
    let log = disk.log.lock().unwrap();
    let places = |what: &str, path: &Path| -> Vec<usize> {
        let step = format!("{what} {}", path.display());
        let found = log.iter().enumerate().filter(|(_, done)| done.starts_with(step.trim_end()));
        found.map(|(place, _)| place).collect()
    };
    let archives = folder.join("archives");
    let synced = places("sync file", Path::new(""));
    let renamed = places("rename", &archives);
    let named = places("sync", &archives);
    let linked = places("link", &folder);
    // Three archives and the manifest, then three renames, one sync for them, and the link.
    assert_eq!((synced.len(), renamed.len(), named.len(), linked.len()), (4, 3, 1, 1), "{log:#?}");
    assert!(synced[3] < renamed[0] && renamed[2] < named[0] && named[0] < linked[0], "{log:#?}");
}

/// A manifest whose checksum holds, of a group that no writer makes.
#[test]
fn a_forged_group_is_refused() {
    let (_home, folder) = with_group();
    let path = folder.join("manifest.3");
    let good = String::from_utf8(fs::read(&path).unwrap()).unwrap();
    let json = good.split_once('\n').unwrap().1;
    let forge = |from: &str, to: &str| {
        assert!(json.contains(from), "{from}");
        let json = json.replace(from, to);
        let sum = xxhash_rust::xxh3::xxh3_64(json.as_bytes());
        fs::write(&path, format!("areoid-manifest 1 {sum:016x}\n{json}")).unwrap();
        Catalog::open(&folder)
    };
    forge("older", "older").unwrap();
    for (from, to) in [
        (r#""group":"split""#, r#""group":"spli""#),
        (r#""group":"split""#, r#""group":"split.band""#),
        (r#""group":"split""#, r#""group":"split.""#),
        (r#""group":"split""#, r#""group":"""#),
        (r#""group":"split""#, r#""group":"old""#),
        // A dataset with the name of the group.
        ("older", "split"),
    ] {
        let refused = forge(from, to);
        assert!(matches!(refused, Err(CatalogError::Manifest { .. })), "{to}: {refused:?}");
    }
}
