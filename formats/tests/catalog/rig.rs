//! Datasets published, and what a catalog shows of them.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use areoid_formats::address::{Level, PageAddress};
use areoid_formats::archive::{
    Archive, ArchiveWriter, ConstantTexel, Description, MipRule, PageEntry, Payload, Source,
};
use areoid_formats::body::Body;
use areoid_formats::catalog::{
    Build, Catalog, CatalogError, Disk, Existing, NewDataset, RealDisk, publish_build,
    publish_builds,
};
use areoid_formats::codec::{self, Quantum};
use areoid_formats::grid::{Grid, Outline};
use areoid_formats::page::Kind;
use areoid_formats::projection::{Crs, Projection};

/// A dataset of two pages: a constant one of `height` and one that is not.
pub(crate) fn publish(
    disk: &dyn Disk,
    folder: &Path,
    name: &str,
    height: u16,
) -> Result<u64, CatalogError> {
    publish_over(Existing::Replace, disk, folder, name, height)
}

pub(crate) fn publish_over(
    existing: Existing,
    disk: &dyn Disk,
    folder: &Path,
    name: &str,
    height: u16,
) -> Result<u64, CatalogError> {
    let (build, dataset) = build(disk, folder, name, height)?;
    publish_build(build, NewDataset { existing, ..dataset })
}

/// The parts of a group and their heights.
pub(crate) type Parts<'a> = &'a [(&'a str, u16)];

/// A group of such datasets.
pub(crate) fn publish_group(
    disk: &dyn Disk,
    folder: &Path,
    group: &str,
    parts: Parts<'_>,
) -> Result<u64, CatalogError> {
    publish_builds(built(disk, folder, group, parts)?)
}

/// The parts of a group, built.
pub(crate) fn built<'a>(
    disk: &'a dyn Disk,
    folder: &Path,
    group: &str,
    parts: Parts<'_>,
) -> Result<Vec<(Build<'a>, NewDataset)>, CatalogError> {
    let parts = parts.iter().map(|(part, height)| {
        let (build, dataset) = build(disk, folder, &format!("{group}.{part}"), *height)?;
        Ok((build, NewDataset { group: Some(group.to_owned()), ..dataset }))
    });
    parts.collect()
}

pub(crate) fn description(name: &str) -> Description {
    let body = Body::parse("mars").unwrap();
    let crs = Crs::new(Projection::Geographic, body.ellipsoid);
    let outline = Outline { origin: [0.0, 10.0], pixel_size: [1.0; 2], width: 12, height: 5 };
    Description {
        dataset: name.to_owned(),
        kind: Kind::Height,
        body,
        grid: Grid::from_outline(crs, outline, 10).unwrap().grid,
        quantum: Quantum::NONE,
        priority: 0,
        feather_texels: 32,
        unit_pages: 8,
        resampling: None,
        mip: MipRule::Mean,
        source: Source::default(),
    }
}

pub(crate) fn build<'a>(
    disk: &'a dyn Disk,
    folder: &Path,
    name: &str,
    height: u16,
) -> Result<(Build<'a>, NewDataset), CatalogError> {
    let height = f32::from(height);
    let entry = PageEntry {
        page: PageAddress::new(Level(1), 0, 0),
        payload: Payload::Constant(ConstantTexel(height.to_le_bytes())),
        valid_fraction: 1.0,
        min: height,
        max: height,
        lowest: height,
        highest: height,
        bound: 0.0,
        source_error: 0.0,
        full: true,
    };
    let stored = Payload::Record { offset: 0, length: 0, checksum: 0 };
    let beside = PageEntry { page: PageAddress::new(Level(1), 0, 1), payload: stored, ..entry };
    let texels: Vec<f32> = (0..100_u8).map(|texel| height + f32::from(texel)).collect();
    let payload = codec::encode_heights(&texels, None, 10, Quantum::NONE).unwrap();

    let build = Build::start(disk, folder, name)?;
    let written = |source| CatalogError::io("write", folder, source);
    let description = description(name);
    let mut writer = ArchiveWriter::new(build, &description).map_err(written)?;
    writer.page(entry, &[]).map_err(written)?;
    writer.page(beside, &payload).map_err(written)?;
    writer.end_unit().map_err(written)?;
    let (build, written) = writer.finish().map_err(written)?;
    let dataset = NewDataset {
        name: name.to_owned(),
        group: None,
        kind: Kind::Height,
        priority: 0,
        body: description.body,
        bytes: written.bytes,
        content: written.content,
        source: Source::default(),
        existing: Existing::Replace,
    };
    Ok((build, dataset))
}

/// What a catalog shows: the height of each dataset, a part behind its group's name and a colon.
/// Every archive must be whole.
pub(crate) type Shown = BTreeMap<String, f32>;

pub(crate) fn height_of(archive: &Archive) -> f32 {
    let entry = archive.find(PageAddress::new(Level(1), 0, 0)).unwrap().unwrap();
    archive.page(&entry).unwrap();
    entry.min
}

pub(crate) fn shown(folder: &Path) -> Shown {
    let (catalog, archives) = match Catalog::open_with_archives(folder) {
        Err(CatalogError::NotACatalog { .. }) => return Shown::new(),
        opened => opened.unwrap(),
    };
    let datasets = catalog.datasets().iter().zip(&archives);
    datasets
        .map(|(record, archive)| {
            assert_eq!(archive.damage().unwrap(), Vec::<String>::new(), "{}", record.name);
            assert_eq!(archive.description().dataset, record.name);
            assert_eq!(archive.len(), record.bytes);
            let group = record.group.as_ref().map(|group| format!("{group}: "));
            (group.unwrap_or_default() + &record.name, height_of(archive))
        })
        .collect()
}

pub(crate) fn names_in(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// Checks that a catalog holds what its manifest names and nothing else, but for unfinished builds.
pub(crate) fn check_swept(folder: &Path) {
    let catalog = Catalog::open(folder).unwrap();
    let mut expected: Vec<_> =
        catalog.datasets().iter().map(|record| record.file.clone()).collect();
    expected.sort();
    assert_eq!(names_in(&folder.join("archives")), expected);
    let manifest = format!("manifest.{}", catalog.generation());
    assert_eq!(names_in(folder), ["archives", "build", "catalog.lock", &manifest]);
}

pub(crate) fn two_datasets() -> (tempfile::TempDir, PathBuf) {
    let home = tempfile::tempdir().unwrap();
    let folder = home.path().join("mars");
    publish(&RealDisk, &folder, "old", 1).unwrap();
    publish(&RealDisk, &folder, "older", 2).unwrap();
    (home, folder)
}

/// The parts of the group of [`with_group`].
pub(crate) const SPLIT: Parts<'static> = &[("band", 4), ("north", 5), ("south", 6)];

/// Two datasets and the group `split`.
pub(crate) fn with_group() -> (tempfile::TempDir, PathBuf) {
    let (home, folder) = two_datasets();
    publish_group(&RealDisk, &folder, "split", SPLIT).unwrap();
    (home, folder)
}

/// A copy of a catalog in which nothing is being built.
pub(crate) fn copied(catalog: &Path) -> (tempfile::TempDir, PathBuf) {
    let home = tempfile::tempdir().unwrap();
    let folder = home.path().join("mars");
    fs::create_dir_all(folder.join("build")).unwrap();
    fs::create_dir_all(folder.join("archives")).unwrap();
    for within in ["", "archives"] {
        for name in names_in(&catalog.join(within)) {
            let file = Path::new(within).join(name);
            if catalog.join(&file).is_file() {
                fs::copy(catalog.join(&file), folder.join(&file)).unwrap();
            }
        }
    }
    (home, folder)
}
