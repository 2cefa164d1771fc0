//! Datasets whose pages have the length that is wanted: noise, which no codec makes shorter.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use areoid_formats::archive::Payload;
use areoid_formats::catalog::Catalog;

use super::Outside;
use crate::bench::geotiff::{Blocks, Format, Place};
use crate::bench::ingest::said;
use crate::failure::Failure;

/// A length, and the noise that makes it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Size {
    pub(super) name: &'static str,
    /// Heights are whole meters from 0 to one less than that.
    heights: u32,
}

/// About 180 and 500 KiB, of 512 by 512 heights.
pub(super) const SIZES: [Size; 2] =
    [Size { name: "noise180", heights: 42 }, Size { name: "noise500", heights: 1 << 15 }];

/// Pages of one length, as they are asked for.
#[derive(Clone, Debug)]
pub(super) struct Pages {
    pub(super) paths: Vec<String>,
    pub(super) mean_bytes: f64,
}

/// So many are asked for in turn: all of them stay in memory, and none in a processor's nearest cache.
const MOST: usize = 15;

/// Makes a dataset of a size in `catalog`.
pub(super) fn make(outside: &Outside<'_>, size: Size, catalog: &Path) -> Result<(), Failure> {
    let width = (outside.setting.count(4096) / 512).max(2) * 512;
    let raster = outside.work(size.name).with_extension("tif");
    let blocks = Blocks::Tiles(512);
    let (height, place) = (width / 2, Place::Globe);
    let format = Format { width, height, bands: 1, sample_bytes: 2, missing: None, place, blocks };
    format.write(&raster, |rows| {
        let places = rows.flat_map(|row| (0..width).map(move |col| (row, col)));
        places.flat_map(|(row, col)| height_at(size.heights, row, col).to_le_bytes()).collect()
    })?;
    let mut ingest = Command::new(std::env::current_exe()?);
    ingest.arg("ingest").arg(&raster).arg("--catalog").arg(catalog).arg("--json");
    said(&mut ingest)?;
    Ok(())
}

fn height_at(heights: u32, row: u32, col: u32) -> u16 {
    // SplitMix64 (Steele, Lea and Flood 2014).
    let bits = (u64::from(row) << 32 | u64::from(col)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let bits = (bits ^ bits >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let bits = (bits ^ bits >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    // The upper half times the count, over 2³²: less than the count.
    u16::try_from(((bits >> 32) * u64::from(heights)) >> 32).unwrap_or(0)
}

/// The longest pages of a size, which are written as files under `root` by the paths that they have over
/// HTTP, too.
pub(super) fn export(catalog: &Path, size: Size, root: &Path) -> Result<Pages, Failure> {
    let (catalog, archives) = Catalog::open_with_archives(catalog)?;
    let datasets = catalog.datasets().iter().zip(archives);
    let mut found = datasets.filter(|(record, _)| record.name == size.name);
    let Some((record, archive)) = found.next() else {
        return Err(std::io::Error::other("no dataset was made").into());
    };
    let length = |payload: &Payload| match payload {
        Payload::Record { length, .. } => *length,
        Payload::Constant(_) => 0,
    };
    let mut entries = archive.entries()?;
    entries.sort_by_key(|entry| std::cmp::Reverse(length(&entry.payload)));
    let longest = entries.first().map_or(0, |entry| length(&entry.payload));
    entries.retain(|entry| length(&entry.payload) >= longest - longest / 10);
    entries.truncate(MOST);
    let (mut paths, mut bytes) = (Vec::new(), 0);
    for entry in &entries {
        let page = entry.page;
        let (name, content) = (&record.name, &record.content);
        let path = format!("/v1/pages/{name}/{content}/{}/{}/{}", page.level.0, page.row, page.col);
        let file: PathBuf = root.join(&path[1..]);
        if let Some(folder) = file.parent() {
            fs::create_dir_all(folder)?;
        }
        let payload = archive.payload(entry)?;
        bytes += payload.len();
        fs::write(file, payload)?;
        paths.push(path);
    }
    let mean_bytes = bytes as f64 / paths.len() as f64;
    Ok(Pages { paths, mean_bytes })
}
