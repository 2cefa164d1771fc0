//! What an archive says of itself: its description at the start, its summary at the end.
//!
//! Both are JSON, so that a person with a pager can read them and later versions can add to them.

use std::io;

use serde::{Deserialize, Serialize};

use super::error::ArchiveError;
use super::layout::{MAX_JSON_LEN, Preamble, archive_id};
use crate::body::Body;
use crate::codec::Quantum;
use crate::grid::Grid;
use crate::page::Kind;

/// What is fixed before the first page: the head of the archive.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Description {
    /// The dataset's name.
    pub dataset: String,
    /// What its texels are.
    pub kind: Kind,
    /// The body it shows.
    pub body: Body,
    /// Projection, origin, size and page side.
    pub grid: Grid,
    /// The step its heights are stored on; [`Quantum::NONE`] for colors and normals.
    pub quantum: Quantum,
    /// Higher covers lower in a composition.
    pub priority: i32,
    /// Leaf texels over which coverage rises from the outline and from holes.
    pub feather_texels: u32,
    /// Leaf pages along a side of a work unit.
    pub unit_pages: u32,
    /// What it was made from, and how that was read.
    pub source: Source,
    /// How its leaves were made of pixels of another grid; `None` where they are the pixels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub resampling: Option<Resampling>,
    /// How its coarser texels were made of finer ones.
    #[serde(default, skip_serializing_if = "MipRule::is_mean")]
    pub mip: MipRule,
}

/// How the texels of a level are made of those of the next finer one. A reader need not know: bounds
/// hold for any.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MipRule {
    /// The mean of two by two.
    #[default]
    Mean,
    /// A low-pass over twelve by twelve, Kaiser's window on a sinc; the mean beside holes.
    Kaiser,
    /// One that a later version has.
    #[serde(other)]
    Unknown,
}

impl MipRule {
    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Mean => "mean",
            Self::Kaiser => "kaiser",
            Self::Unknown => "unknown",
        }
    }

    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde calls it so")]
    fn is_mean(&self) -> bool {
        *self == Self::Mean
    }
}

/// How leaves were made of the pixels of another grid.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Resampling {
    /// The kernel's name.
    pub kernel: String,
    /// Whether texels were kept within the range of the pixels around them.
    pub range_limited: bool,
    /// Whether texels are those whose bilinear surface is nearest to what the kernel sees between
    /// the pixels, except beside missing ones, and not its values at their centers.
    #[serde(skip_serializing_if = "is_false", default)]
    pub fitted: bool,
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde calls it so")]
fn is_false(flag: &bool) -> bool {
    !flag
}

/// The rasters a dataset was made from, and the options they were read with.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Source {
    /// The files, in the order given.
    pub files: Vec<SourceFile>,
    /// `--crs`, as text.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub crs: Option<String>,
    /// `--extent`: west, south, east, north in map units.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub extent: Option<[f64; 4]>,
    /// `--nodata`. Text, because JSON has no NaN.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub nodata: Option<String>,
    /// `--body`, as text.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub body: Option<String>,
    /// `--latitudes`.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub latitudes: Option<String>,
}

/// One file of a [`Source`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SourceFile {
    /// Its name without its folder: the bytes of an archive do not depend on where its source lay.
    pub name: String,
    /// Its length in bytes.
    pub bytes: u64,
    /// XXH3 of its contents, 128 bits in hexadecimal.
    pub xxh3: String,
}

/// What is known after the last page.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// One for each level, coarsest first.
    pub levels: Vec<LevelSummary>,
    /// Work units the archive was built in.
    pub units: u64,
}

/// What [`Summary`] says of a level.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LevelSummary {
    /// Pages in the index, constant ones included.
    pub pages: u64,
    /// Constant pages among them.
    pub constant: u64,
    /// Payload bytes of the others.
    pub bytes: u64,
    /// The largest bound of a page, in meters or color codes.
    #[serde(deserialize_with = "infinite_if_null")]
    pub bound_max: f32,
    /// The largest source error of a page.
    #[serde(deserialize_with = "infinite_if_null")]
    pub source_error_max: f32,
}

/// JSON has no infinity: heights near the end of f32 can have one for a bound, written `null`.
fn infinite_if_null<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<f32, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(f32::INFINITY))
}

impl Description {
    /// The description as the archive stores it.
    ///
    /// # Panics
    ///
    /// Never: every field has a JSON form.
    #[must_use]
    pub fn to_json(&self) -> Vec<u8> {
        serde_json::to_vec(self).expect("a description has no maps with odd keys")
    }

    /// The name of an archive of this description, and the bytes that it starts with: preamble and
    /// description.
    ///
    /// # Errors
    ///
    /// If the description takes more than 2^24 bytes.
    pub(super) fn head(&self) -> io::Result<(u64, Vec<u8>)> {
        let json = self.to_json();
        let description_len = u32::try_from(json.len()).ok();
        let description_len =
            description_len
                .filter(|&length| u64::from(length) <= MAX_JSON_LEN)
                .ok_or_else(|| io::Error::other("a description of more than 2^24 bytes"))?;
        let archive = archive_id(&json);
        let mut head = Preamble { description_len, archive }.to_bytes().to_vec();
        head.extend_from_slice(&json);
        Ok((archive, head))
    }

    /// Reads a description and checks that it makes sense.
    ///
    /// # Errors
    ///
    /// [`ArchiveError::Description`].
    pub fn from_json(json: &[u8]) -> Result<Self, ArchiveError> {
        let invalid = |reason: String| ArchiveError::Description { reason };
        let description: Self =
            serde_json::from_slice(json).map_err(|error| invalid(error.to_string()))?;
        if !(1..=64).contains(&description.unit_pages) {
            let found = description.unit_pages;
            return Err(invalid(format!("unit_pages is {found}, expected 1..=64")));
        }
        let Quantum { step, offset } = description.quantum;
        Quantum::new(step, offset).map_err(|error| invalid(error.to_string()))?;
        Ok(description)
    }
}
