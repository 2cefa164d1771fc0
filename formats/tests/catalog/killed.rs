//! Writers that die at every step, or find no room: what they leave is the catalog before the change
//! or after it.

use std::fs;
use std::path::Path;

use areoid_formats::catalog::{Build, CatalogError, Disk, RealDisk, remove_dataset};

use crate::dying::{Dying, Last};
use crate::rig::{
    SPLIT, Shown, check_swept, copied, names_in, publish, publish_group, shown, two_datasets,
    with_group,
};

type Change = fn(&dyn Disk, &Path) -> Result<u64, CatalogError>;

const CHANGES: [(&str, Change); 11] = [
    ("publish", |disk, folder| publish(disk, folder, "new", 7)),
    ("replace", |disk, folder| publish(disk, folder, "old", 7)),
    ("replace by the same", |disk, folder| publish(disk, folder, "old", 1)),
    ("remove", |disk, folder| remove_dataset(disk, folder, "old")),
    ("remove the other", |disk, folder| remove_dataset(disk, folder, "older")),
    ("publish a group", |disk, folder| publish_group(disk, folder, "new", SPLIT)),
    ("replace a dataset by a group", |disk, folder| publish_group(disk, folder, "old", SPLIT)),
    ("replace a group by a dataset", |disk, folder| publish(disk, folder, "split", 7)),
    ("replace a group, in part by the same", |disk, folder| {
        publish_group(disk, folder, "split", &[("band", 4), ("cap", 8), ("north", 9)])
    }),
    ("replace a group by the same", |disk, folder| publish_group(disk, folder, "split", SPLIT)),
    ("remove a group", |disk, folder| remove_dataset(disk, folder, "split")),
];

#[test]
fn a_writer_killed_at_any_step_leaves_the_catalog_before_or_after() {
    let (_home, original) = with_group();
    let before = shown(&original);
    for (name, change) in CHANGES {
        let (_home, folder) = copied(&original);
        change(&RealDisk, &folder).unwrap();
        let after = shown(&folder);

        for last in [Last::Undone, Last::Torn] {
            let mut seen_after = false;
            for steps in 0.. {
                let (_home, folder) = copied(&original);
                let disk = Dying::after(steps, last);
                let result = change(&disk, &folder);
                let left = shown(&folder);
                let what = format!("{name} killed after {steps} steps");
                assert!(left == before || left == after, "{what}: {left:?}");
                let linked = disk.log.lock().unwrap().iter().any(|step| step.starts_with("link"));
                assert_eq!(left == after, linked || before == after, "{what}");
                assert_eq!(result.is_ok(), !disk.died(), "{what}");
                seen_after |= left == after;

                // A live writer, which is another process, takes no notice and clears up.
                for name in names_in(&folder) {
                    if let Some(process) = name.strip_prefix("manifest-") {
                        let of_the_dead = folder.join(format!("manifest-{process}0"));
                        fs::rename(folder.join(&name), of_the_dead).unwrap();
                    }
                }
                publish(&RealDisk, &folder, "live", 3).unwrap();
                let with_live = |mut shown: Shown| {
                    shown.insert("live".to_owned(), 3.0);
                    shown
                };
                assert_eq!(shown(&folder), with_live(left.clone()), "{what}");
                check_swept(&folder);
                // And the dead one's names are free again: what it was about can be done.
                let again = change(&RealDisk, &folder);
                assert!(again.is_ok() || left == after, "{what}: {again:?}");
                assert_eq!(shown(&folder), with_live(after.clone()), "{what}");
                assert_eq!(names_in(&folder.join("build")), [] as [&str; 0], "{what}");
                check_swept(&folder);
                if !disk.died() {
                    break;
                }
            }
            assert!(seen_after, "{name}");
        }
    }
}

#[test]
fn a_first_writer_killed_at_any_step_leaves_no_catalog_or_one() {
    for steps in 0.. {
        let home = tempfile::tempdir().unwrap();
        let folder = home.path().join("a/b");
        let disk = Dying::after(steps, Last::Torn);
        let result = publish(&disk, &folder, "first", 1);
        let left = shown(&folder);
        assert!(left.is_empty() || left == Shown::from([("first".to_owned(), 1.0)]));
        assert!(result.is_err() || !left.is_empty());
        publish(&RealDisk, &folder, "live", 3).unwrap();
        assert_eq!(shown(&folder).len(), left.len() + 1, "{steps}");
        check_swept(&folder);
        if !disk.died() {
            break;
        }
    }
}

/// What must survive a power failure is synced before anything relies on it.
#[test]
fn nothing_is_relied_on_before_it_is_synced() {
    let home = tempfile::tempdir().unwrap();
    let folder = home.path().join("a/b");
    let disk = Dying::after(usize::MAX, Last::Undone);
    publish(&disk, &folder, "old", 1).unwrap();
    let first = std::mem::take(&mut *disk.log.lock().unwrap());
    publish(&disk, &folder, "old", 2).unwrap();
    let second = std::mem::take(&mut *disk.log.lock().unwrap());

    let place = |log: &[String], what: &str, path: &Path| {
        let step = format!("{what} {}", path.display()).trim_end().to_owned();
        let found = log.iter().position(|done| done.trim_end().starts_with(&step));
        found.unwrap_or_else(|| panic!("no {step:?} in {log:#?}"))
    };
    // New folders, each in the one above it, before the build is opened.
    let opened = place(&first, "open", &folder.join("build"));
    for parent in [home.path().to_owned(), home.path().join("a"), folder.clone()] {
        let synced = first.iter().position(|step| *step == format!("sync {}", parent.display()));
        assert!(synced.is_some_and(|synced| synced < opened), "{parent:?} in {first:#?}");
    }

    let archives = folder.join("archives");
    let renamed = place(&second, "rename", &archives);
    let linked = place(&second, "link", &folder.join("manifest.2"));
    let archive_synced = place(&second, "sync file", Path::new(""));
    let name_synced = place(&second, "sync", &archives);
    let manifest_synced = second.iter().rposition(|step| step.starts_with("sync file")).unwrap();
    let generation_synced =
        second.iter().rposition(|step| *step == format!("sync {}", folder.display())).unwrap();
    let old_removed = place(&second, "remove", &folder.join("manifest.1"));
    let archive_removed = place(&second, "remove", &archives);
    assert!(archive_synced < renamed && renamed < name_synced, "{second:#?}");
    // The manifest before the rename: what may find no room comes while the build is still one.
    assert!(manifest_synced < renamed && name_synced < linked, "{second:#?}");
    assert!(linked < generation_synced, "{second:#?}");
    assert!(generation_synced < old_removed && generation_synced < archive_removed, "{second:#?}");
}

/// Whatever a build put beside its archive is gone before a manifest names the dataset: a writer
/// killed behind the link used to leave notes and scratch files that nobody came for, because the
/// next ingest found nothing to do; and a note half written stayed for good.
#[test]
fn nothing_stands_beside_a_published_archive() {
    for steps in 0.. {
        let (_home, folder) = two_datasets();
        let mut build = Build::start(&RealDisk, &folder, "new").unwrap();
        build.scratch().unwrap();
        build.note(b"note").unwrap();
        fs::write(folder.join("build/new.note-new"), b"no").unwrap();
        drop(build);
        let disk = Dying::after(steps, Last::Undone);
        let _ = publish(&disk, &folder, "new", 7);
        if shown(&folder).contains_key("new") {
            assert_eq!(names_in(&folder.join("build")), [] as [&str; 0], "{steps}");
        }
        if !disk.died() {
            break;
        }
    }
}

/// No room for the manifest, which is written last: the build used to be thrown away.
#[test]
fn a_build_is_kept_when_its_manifest_finds_no_room() {
    let (_home, folder) = two_datasets();
    let whole = Dying::after(usize::MAX, Last::Undone);
    publish(&whole, &folder, "old", 7).unwrap();
    let steps = whole.log.lock().unwrap().clone();
    let manifest = steps.iter().rposition(|step| step.starts_with("append")).unwrap();
    let (_home, folder) = two_datasets();
    let before = shown(&folder);
    let full = Dying::after(manifest, Last::Torn);
    assert!(matches!(publish(&full, &folder, "old", 7), Err(CatalogError::Io { .. })));
    assert_eq!(shown(&folder), before);
    assert_eq!(names_in(&folder.join("build")), ["old.part"]);
}
