//! The manifest: which datasets a generation has.
//!
//! A line with a checksum, then JSON:
//!
//! ```text
//!   areoid-manifest 1 <XXH3 of the JSON, 16 hexadecimal digits>\n
//!   {"generation":7,"body":{…},"datasets":[{"name":"mola","file":"mola-5f0c….areoid",…},…]}
//! ```

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::Path;

use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::xxh3_64;

use super::error::CatalogError;
use crate::archive::Source;
use crate::body::Body;
use crate::bounds::Aabb;
use crate::bvh::Bvh;
use crate::page::Kind;

/// The datasets of one generation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// How often the catalog has changed.
    pub generation: u64,
    /// The body that all datasets show.
    pub body: Body,
    /// The datasets, sorted by name; no name twice.
    pub datasets: Vec<DatasetRecord>,
    /// A box around each dataset, by its [`item`](DatasetRecord::item).
    pub bvh: Bvh,
}

/// A dataset as the manifest knows it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DatasetRecord {
    /// Its name.
    pub name: String,
    /// Its number in the tree of boxes: that of no other dataset, and its own for good.
    pub item: u32,
    /// Its archive, a file in the catalog's `archives` folder: [`DatasetRecord::file_of`] its name
    /// and content.
    pub file: String,
    /// What its texels are.
    pub kind: Kind,
    /// Higher covers lower.
    pub priority: i32,
    /// Length of the archive in bytes.
    pub bytes: u64,
    /// The archive's content as 16 hexadecimal digits.
    pub content: String,
    /// What it was made from.
    pub source: Source,
}

impl DatasetRecord {
    /// The name of the archive that holds `content` of the dataset `name`.
    #[must_use]
    pub fn file_of(name: &str, content: &str) -> String {
        format!("{name}-{content}.areoid")
    }

    /// Whether a writer would have written it: above all, whether its file is one in the folder
    /// of archives and nowhere else.
    fn is_sound(&self) -> bool {
        let digits = |c: char| matches!(c, '0'..='9' | 'a'..='f');
        check_name(&self.name).is_ok()
            && self.content.len() == 16
            && self.content.chars().all(digits)
            && self.file == Self::file_of(&self.name, &self.content)
    }
}

const MAGIC: &str = "areoid-manifest 1 ";
const PREFIX: &str = "manifest.";

impl Manifest {
    /// A catalog before its first dataset.
    #[must_use]
    pub fn empty(body: Body) -> Self {
        Self { generation: 0, body, datasets: Vec::new(), bvh: Bvh::default() }
    }

    /// Takes a dataset out, if there is one of this name.
    pub(super) fn take_out(&mut self, name: &str) -> Option<DatasetRecord> {
        let place = self.datasets.iter().position(|record| record.name == name)?;
        let record = self.datasets.remove(place);
        self.bvh.remove(record.item);
        Some(record)
    }

    /// Puts a dataset in, in the place of one of its name, with a box around it.
    pub(super) fn put_in(&mut self, record: DatasetRecord, bounds: Aabb) {
        self.take_out(&record.name);
        self.bvh.insert(record.item, bounds);
        self.datasets.push(record);
        self.datasets.sort_by(|one, other| one.name.cmp(&other.name));
    }

    /// The least number that no dataset has.
    pub(super) fn free_item(&self) -> u32 {
        let taken: BTreeSet<u32> = self.datasets.iter().map(|record| record.item).collect();
        (0..).find(|item| !taken.contains(item)).expect("fewer than 2^32 datasets")
    }

    pub(super) fn to_bytes(&self) -> Vec<u8> {
        let json = serde_json::to_vec(self).expect("a manifest has no maps with odd keys");
        let mut bytes = format!("{MAGIC}{:016x}\n", xxh3_64(&json)).into_bytes();
        bytes.extend_from_slice(&json);
        bytes
    }

    /// Reads the manifest of `generation` from the bytes of the file at `path`.
    fn from_bytes(bytes: &[u8], generation: u64, path: &Path) -> Result<Self, CatalogError> {
        let invalid =
            |reason: &str| CatalogError::Manifest { path: path.to_owned(), reason: reason.into() };
        let end = bytes.iter().position(|&byte| byte == b'\n').unwrap_or(bytes.len());
        let (line, json) = bytes.split_at(end);
        let sum = line
            .strip_prefix(MAGIC.as_bytes())
            .ok_or_else(|| invalid("it does not start with \"areoid-manifest 1\""))?;
        let json = json.get(1..).unwrap_or_default();
        if sum != format!("{:016x}", xxh3_64(json)).as_bytes() {
            return Err(invalid("its checksum does not match"));
        }
        let manifest: Self =
            serde_json::from_slice(json).map_err(|error| invalid(&error.to_string()))?;
        if manifest.generation != generation {
            return Err(invalid("its name says another generation"));
        }
        if let Some(record) = manifest.datasets.iter().find(|record| !record.is_sound()) {
            return Err(invalid(&format!(
                "no dataset {:?} has a file {:?}",
                record.name, record.file
            )));
        }
        if !manifest.datasets.is_sorted_by(|one, other| one.name < other.name) {
            return Err(invalid("its datasets are not in the order of their names"));
        }
        let items: BTreeSet<u32> = manifest.datasets.iter().map(|record| record.item).collect();
        let in_tree = items.iter().all(|&item| manifest.bvh.get(item).is_some());
        if items.len() != manifest.datasets.len() || manifest.bvh.len() != items.len() || !in_tree {
            return Err(invalid("its boxes are not those of its datasets"));
        }
        Ok(manifest)
    }
}

/// Refuses names that are not plain file names on every system.
pub(super) fn check_name(name: &str) -> Result<(), CatalogError> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    let plain = (1..=100).contains(&name.len())
        && name.chars().all(allowed)
        && name.starts_with(|c: char| c.is_ascii_alphanumeric());
    if plain { Ok(()) } else { Err(CatalogError::Name { name: name.to_owned() }) }
}

/// The name of the manifest of a generation.
pub(super) fn file_name(generation: u64) -> String {
    format!("{PREFIX}{generation}")
}

/// The generations whose manifests lie in `folder`.
pub(super) fn generations(folder: &Path) -> Result<Vec<u64>, CatalogError> {
    let failed = |source| CatalogError::io("list", folder, source);
    let listing = match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        listing => listing.map_err(failed)?,
    };
    let mut generations = Vec::new();
    for entry in listing {
        let name = entry.map_err(failed)?.file_name();
        let Some(name) = name.to_str() else { continue };
        let number = name.strip_prefix(PREFIX).and_then(|number| number.parse::<u64>().ok());
        // `manifest.+7` and `manifest.07` are somebody's copies, not generation 7.
        generations.extend(number.filter(|&generation| file_name(generation) == name));
    }
    Ok(generations)
}

/// How often a listing without a manifest, or with one that is gone, is made anew before it is
/// believed. A folder may change while it is listed, so one listing can miss the new manifest as
/// well as the old one; to do so time and again takes a writer each time.
const LISTINGS: u32 = 16;

/// The newest manifest in `folder`, or `None` if there is none.
pub(super) fn newest(folder: &Path) -> Result<Option<Manifest>, CatalogError> {
    let mut newest_seen = None;
    let mut tries = 0;
    loop {
        let generation = generations(folder)?.into_iter().max();
        let missing = match generation {
            None => None,
            Some(generation) => {
                let path = folder.join(file_name(generation));
                match fs::read(&path) {
                    Ok(bytes) => return Manifest::from_bytes(&bytes, generation, &path).map(Some),
                    // A writer put a newer one in its place: look again.
                    Err(error) if error.kind() == io::ErrorKind::NotFound => Some((path, error)),
                    Err(error) => return Err(CatalogError::io("read", &path, error)),
                }
            }
        };
        // A catalog that moves on is worth any number of looks.
        tries = if generation > newest_seen { 0 } else { tries + 1 };
        newest_seen = newest_seen.max(generation);
        if tries == LISTINGS {
            return match missing {
                Some((path, error)) => Err(CatalogError::io("read", &path, error)),
                None => Ok(None),
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_damaged_manifest_is_refused() {
        let manifest = Manifest::empty(Body::parse("mars").unwrap());
        let whole = manifest.to_bytes();
        let path = Path::new("manifest.0");
        assert_eq!(Manifest::from_bytes(&whole, 0, path).unwrap(), manifest);
        assert!(Manifest::from_bytes(&whole, 1, path).is_err());
        for at in 0..whole.len() {
            let mut damaged = whole.clone();
            damaged[at] ^= 1;
            assert!(Manifest::from_bytes(&damaged, 0, path).is_err(), "byte {at}");
            assert!(Manifest::from_bytes(&whole[..at], 0, path).is_err(), "{at} bytes");
        }
    }
}
