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
    /// The group that it is a part of: what the user names, replaces and removes as one. Its name is
    /// the group's, a dot, and what part it is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub group: Option<String>,
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

    /// What the user calls it: its group, if it is a part of one.
    #[must_use]
    pub fn called(&self) -> &str {
        self.group.as_ref().unwrap_or(&self.name)
    }

    /// Whether `name` means it: its own name, or that of its group.
    #[must_use]
    pub fn answers_to(&self, name: &str) -> bool {
        self.name == name || self.called() == name
    }

    /// Whether a writer would have written it: above all, whether its file is one in the folder
    /// of archives and nowhere else.
    fn is_sound(&self) -> bool {
        let digits = |c: char| matches!(c, '0'..='9' | 'a'..='f');
        check_name(&self.name).is_ok()
            && self.group.as_ref().is_none_or(|group| is_part(&self.name, group))
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

    /// The dataset that the user calls `name`, or the parts of the group.
    pub(super) fn parts(&self, name: &str) -> impl Iterator<Item = &DatasetRecord> {
        self.datasets.iter().filter(move |record| record.called() == name)
    }

    /// Refuses a dataset `name`, of `group` if it is a part, whose name or whose group's is that of
    /// a dataset or a group which it would not replace.
    pub(super) fn check_free(&self, name: &str, group: Option<&str>) -> Result<(), CatalogError> {
        let called = group.unwrap_or(name);
        for other in self.datasets.iter().filter(|other| other.called() != called) {
            if let Some(owner) = &other.group
                && (other.name == name || other.name == called)
            {
                return Err(CatalogError::Part { name: other.name.clone(), group: owner.clone() });
            }
            if other.called() == name {
                let (name, group) = (name.to_owned(), called.to_owned());
                return Err(CatalogError::PartTaken { name, group });
            }
        }
        Ok(())
    }

    /// Takes out all datasets but those to keep.
    pub(super) fn retain(&mut self, keep: impl Fn(&DatasetRecord) -> bool) {
        for record in self.datasets.extract_if(.., |record| !keep(record)) {
            self.bvh.remove(record.item);
        }
    }

    /// Puts a dataset in, in the place of one of its name, with a box around it.
    pub(super) fn put_in(&mut self, record: DatasetRecord, bounds: Aabb) {
        self.retain(|before| before.name != record.name);
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
        let groups: BTreeSet<&str> =
            manifest.datasets.iter().filter_map(|record| record.group.as_deref()).collect();
        if manifest.datasets.iter().any(|record| groups.contains(record.name.as_str())) {
            return Err(invalid("a dataset and a group have one name"));
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
///
/// # Errors
///
/// [`CatalogError::Name`].
pub fn check_name(name: &str) -> Result<(), CatalogError> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
    let plain = (1..=100).contains(&name.len())
        && name.chars().all(allowed)
        && name.starts_with(|c: char| c.is_ascii_alphanumeric());
    if plain { Ok(()) } else { Err(CatalogError::Name { name: name.to_owned() }) }
}

/// Whether `name` is that of a part of `group`.
pub(super) fn is_part(name: &str, group: &str) -> bool {
    let part = name.strip_prefix(group).and_then(|rest| rest.strip_prefix('.'));
    part.is_some_and(|part| !part.is_empty())
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

    /// What was written before there were groups is read, and written as it was.
    #[test]
    fn a_manifest_without_groups_keeps_its_bytes() {
        let old = concat!(
            "areoid-manifest 1 f3dda9134a18c63e\n",
            r#"{"generation":1,"body":{"name":"mars","ellipsoid":{"a":3396190.0,"b":3396190.0}},"#,
            r#""datasets":[{"name":"old","item":0,"file":"old-0c33aa654024bbc9.areoid","#,
            r#""kind":"height","priority":0,"bytes":717881,"content":"0c33aa654024bbc9","#,
            r#""source":{"files":[{"name":"mola_north_polar_4km.tif","bytes":499113,"#,
            r#""xxh3":"dfdac38bc736a5e20d6498cae7f89a8e"}]}}],"bvh":[{"item":0,"bounds":{"#,
            r#""min":[-1920529.9998724444,-1920529.9998724444,2298163.529594564],"#,
            r#""max":[1920529.9998724444,1920529.9998724444,3396255.00339619]}}]}"#,
        );
        let manifest = Manifest::from_bytes(old.as_bytes(), 1, Path::new("manifest.1")).unwrap();
        assert_eq!(manifest.datasets[0].group, None);
        assert_eq!(String::from_utf8(manifest.to_bytes()).unwrap(), old);
    }

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
