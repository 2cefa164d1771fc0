//! Catalogs on disk.

use std::io::Write;
use std::path::Path;

use areoid_formats::catalog::{
    Build, Existing, NewDataset, RealDisk, publish_build, remove_dataset,
};

use super::*;
use crate::CacheError;

const OPTIONS: Options =
    Options { budget_bytes: 16 << 20, in_flight_bytes: 4 << 20, concurrent_loads: 2 };

#[test]
fn a_folder_without_a_catalog_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let error = Cache::open(folder.path(), OPTIONS).wait().unwrap_err();
    assert!(matches!(error, CacheError::Catalog(_)), "{error}");
}

/// Makes a dataset of a catalog; `priority` is all that tells two of a name apart.
fn publish(folder: &Path, name: &str, grid: Grid, priority: i32) {
    let (description, bytes) = planet(name, grid, Kind::Height);
    let mut build = Build::start(&RealDisk, folder, name).unwrap();
    build.write_all(&bytes).unwrap();
    let dataset = NewDataset {
        name: name.to_owned(),
        group: None,
        kind: Kind::Height,
        priority,
        body: mars(),
        bytes: bytes.len() as u64,
        content: Archive::open(Box::new(bytes)).unwrap().content().unwrap(),
        source: description.source,
        existing: Existing::Replace,
    };
    publish_build(build, dataset).unwrap();
}

pub(crate) fn globe_in_a_catalog() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    publish(folder.path(), "globe", globe(), 0);
    folder
}

/// Two datasets, then the archive of one is cut, and damaged beyond reading: the other still opens, and
/// what has happened is told.
#[test]
fn a_catalog_opens_with_what_can_be_read() {
    let folder = tempfile::tempdir().unwrap();
    for (name, grid) in [("globe", globe()), ("cap", cap())] {
        publish(folder.path(), name, grid, 3);
    }
    let opening = Cache::open(folder.path(), OPTIONS);
    assert!(opening.progress().opened <= 2);
    let cache = opening.wait().unwrap();
    let names: Vec<_> = cache.datasets().iter().map(|(_, info)| info.name.clone()).collect();
    assert_eq!((names, cache.problems().len()), (vec!["cap".to_owned(), "globe".to_owned()], 0));
    let settled = cache.session().settle(&view(0.0, 88.0, 4e5, 0.0));
    assert!(settled.missing == 0 && settled.pages.iter().any(|page| page.dataset == 0));

    let archives = std::fs::read_dir(folder.path().join("archives")).unwrap();
    let cap = archives
        .map(|file| file.unwrap().path())
        .find(|path| path.file_name().unwrap().to_str().unwrap().starts_with("cap"));
    let cap = cap.unwrap();
    let bytes = std::fs::read(&cap).unwrap();
    std::fs::write(&cap, &bytes[..bytes.len() / 2]).unwrap();
    let cut = Cache::open(folder.path(), OPTIONS).wait().unwrap();
    let told = cut.problems()[0].to_string();
    assert!(told.contains("is damaged: of") && cut.problems().len() == 1, "{told}");
    assert_eq!(cut.datasets().len(), 2);
    std::fs::write(cap, b"no archive").unwrap();
    let cache = Cache::open(folder.path(), OPTIONS).wait().unwrap();
    assert_eq!((cache.datasets().len(), cache.problems().len()), (1, 1));
}

#[tokio::test]
async fn sessions_settle_on_any_runtime() {
    let globe = Gated::globe();
    let cache = globe.cache(OPTIONS.budget_bytes, 2);
    let mut session = cache.session();
    let settled = session.settled(&view(0.0, 0.0, 1e6, 0.0)).await;
    assert!(settled.missing == 0 && !settled.pages.is_empty());
}

/// An index without a summary is rebuilt by a loader, not by the frame.
#[test]
fn an_archive_without_its_end_is_read_through() {
    let (description, mut bytes) = planet("globe", globe(), Kind::Height);
    let len = bytes.len();
    bytes[len - 20] ^= 1;
    let archive = Archive::open(Box::new(bytes)).unwrap();
    let info = DatasetInfo {
        name: description.dataset,
        group: None,
        kind: description.kind,
        grid: description.grid,
        priority: 0,
    };
    let cache = Cache::with_archives(mars(), vec![(info, Arc::new(archive))], OPTIONS).unwrap();
    assert!(cache.problems().is_empty());
    let settled = cache.session().settle(&view(0.0, 0.0, 1e6, 0.0));
    assert!(settled.missing == 0 && !settled.pages.is_empty());
}

/// Whoever changes the catalog's folder: open sessions see it, and what they had stays.
#[test]
fn a_cache_follows_its_folder() {
    let folder = tempfile::tempdir().unwrap();
    publish(folder.path(), "globe", globe(), 0);
    let cache = Cache::open(folder.path(), OPTIONS).wait().unwrap();
    let mut session = cache.session();
    let pole = view(0.0, 88.0, 4e5, 0.0);
    let first = session.settle(&pole);
    let names = |selection: &Selection| {
        selection.datasets.iter().map(|(_, info)| info.name.clone()).collect::<Vec<_>>()
    };
    assert_eq!(names(&first), ["globe"]);
    publish(folder.path(), "cap", cap(), 1);
    let second = loop {
        let now = session.update(&pole);
        if now.scene != first.scene && now.missing == 0 {
            break now;
        }
        std::thread::yield_now();
    };
    assert_eq!(names(&second), ["globe", "cap"]);
    for page in &first.pages {
        assert!(second.pages.iter().any(|now| Arc::ptr_eq(now, page)), "dropped for nothing");
    }
    remove_dataset(&RealDisk, folder.path(), "globe").unwrap();
    let third = loop {
        let now = session.update(&pole);
        if now.scene != second.scene && now.missing == 0 {
            break now;
        }
        std::thread::yield_now();
    };
    assert_eq!(names(&third), ["cap"]);
}
