//! Catalogs on disk.

use areoid_formats::archive::Archive;

use super::*;
use crate::CacheError;

const OPTIONS: Options = Options { budget_bytes: 16 << 20, concurrent_loads: 2 };

#[test]
fn a_folder_without_a_catalog_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let error = Cache::open(folder.path(), OPTIONS).wait().unwrap_err();
    assert!(matches!(error, CacheError::Catalog(_)), "{error}");
}

#[tokio::test]
async fn sessions_settle_on_any_runtime() {
    let globe = Gated::new("globe", globe(), Kind::Height);
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
        kind: description.kind,
        grid: description.grid,
        priority: 0,
    };
    let cache = Cache::with_archives(mars(), vec![(info, Arc::new(archive))], OPTIONS).unwrap();
    assert!(cache.problems().is_empty());
    let settled = cache.session().settle(&view(0.0, 0.0, 1e6, 0.0));
    assert!(settled.missing == 0 && !settled.pages.is_empty());
}
