//! The manifest: which datasets a generation has.
//!
//! A line with a checksum, then JSON:
//!
//! ```text
//!   areoid-manifest 1 <XXH3 of the JSON, 16 hexadecimal digits>\n
//!   {"generation":7,"body":{…},"datasets":[{"name":"mola","file":"mola-5f0c….areoid",…},…]}
//! ```

use std::fs;
use std::io;
use std::path::Path;

use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::xxh3_64;

use super::error::CatalogError;
use crate::archive::Source;
use crate::body::Body;
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
}

/// A dataset as the manifest knows it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DatasetRecord {
    /// Its name.
    pub name: String,
    /// Its archive, a file in the catalog's `archives` folder.
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

const MAGIC: &str = "areoid-manifest 1 ";
const PREFIX: &str = "manifest.";

impl Manifest {
    /// A catalog before its first dataset.
    #[must_use]
    pub fn empty(body: Body) -> Self {
        Self { generation: 0, body, datasets: Vec::new() }
    }

    pub(super) fn to_bytes(&self) -> Vec<u8> {
        let json = serde_json::to_vec(self).expect("a manifest has no maps with odd keys");
        let mut bytes = format!("{MAGIC}{:016x}\n", xxh3_64(&json)).into_bytes();
        bytes.extend_from_slice(&json);
        bytes
    }

    fn from_bytes(bytes: &[u8], path: &Path) -> Result<Self, CatalogError> {
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
        serde_json::from_slice(json).map_err(|error| invalid(&error.to_string()))
    }
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
        let number = name.to_str().and_then(|name| name.strip_prefix(PREFIX)?.parse::<u64>().ok());
        generations.extend(number);
    }
    Ok(generations)
}

/// The newest manifest in `folder`, or `None` if there is none.
pub(super) fn newest(folder: &Path) -> Result<Option<Manifest>, CatalogError> {
    loop {
        let Some(generation) = generations(folder)?.into_iter().max() else { return Ok(None) };
        let path = folder.join(file_name(generation));
        match fs::read(&path) {
            Ok(bytes) => return Manifest::from_bytes(&bytes, &path).map(Some),
            // A writer put a newer one in its place: look again.
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(CatalogError::io("read", &path, error)),
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
        assert_eq!(Manifest::from_bytes(&whole, path).unwrap(), manifest);
        for at in 0..whole.len() {
            let mut damaged = whole.clone();
            damaged[at] ^= 1;
            assert!(Manifest::from_bytes(&damaged, path).is_err(), "byte {at}");
            assert!(Manifest::from_bytes(&whole[..at], path).is_err(), "{at} bytes");
        }
    }
}
