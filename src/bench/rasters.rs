//! The rasters that are measured with: made once, kept, and made anew by nobody who has them.

use std::fs;
use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::geotiff::{Blocks, Format, Place};
use super::terrain::{MISSING, Terrain};
use crate::output;

/// What a raster shows of the terrain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Look {
    /// Heights, whole meters.
    Height,
    /// The same with holes.
    Holes,
    /// Colors: what is high is light, and light comes from the west.
    Color,
}

/// A raster that can be made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Recipe {
    pub(super) look: Look,
    pub(super) width: u32,
    pub(super) height: u32,
    pub(super) blocks: Blocks,
}

/// Counts what changes the samples that a recipe stands for: a file of another is not used.
const TERRAIN: u32 = 1;

/// Rows made at a time by one thread.
const CHUNK_ROWS: u32 = 32;

impl Recipe {
    /// In tiles of 512 pixels.
    pub(super) fn tiled(look: Look, (width, height): (u32, u32)) -> Self {
        Self { look, width, height, blocks: Blocks::Tiles(512) }
    }

    /// In strips of 16 rows.
    pub(super) fn striped(look: Look, (width, height): (u32, u32)) -> Self {
        Self { look, width, height, blocks: Blocks::Strips(16) }
    }

    /// Millions of pixels.
    pub(super) fn megapixels(&self) -> f64 {
        f64::from(self.width) * f64::from(self.height) / 1e6
    }

    /// The file's name without its ending.
    pub(super) fn name(&self) -> String {
        let look = match self.look {
            Look::Height => "height",
            Look::Holes => "holes",
            Look::Color => "color",
        };
        let blocks = match self.blocks {
            Blocks::Tiles(side) => format!("tiles{side}"),
            Blocks::Strips(rows) => format!("strips{rows}"),
        };
        format!("terrain{TERRAIN}_{look}_{}x{}_{blocks}", self.width, self.height)
    }

    /// The raster in `folder`, made if it is not there.
    pub(super) fn make(&self, folder: &Path) -> io::Result<PathBuf> {
        let path = folder.join(self.name()).with_extension("tif");
        if path.is_file() {
            return Ok(path);
        }
        output::say(format!("making {}", path.display()));
        fs::create_dir_all(folder)?;
        let unfinished = path.with_extension(format!("{}.tmp", std::process::id()));
        let (bands, sample_bytes) = match self.look {
            Look::Height | Look::Holes => (1, 2),
            Look::Color => (3, 1),
        };
        let Self { width, height, blocks, look } = *self;
        let missing = (look == Look::Holes).then_some(MISSING);
        let place = Place::Globe;
        let format = Format { width, height, bands, sample_bytes, missing, place, blocks };
        let heights = Terrain::heights(width, height);
        let holes = Terrain::holes(width, height);
        format.write(&unfinished, |rows| {
            let chunks: Vec<Range<u32>> = rows
                .clone()
                .step_by(CHUNK_ROWS as usize)
                .map(|first| first..(first + CHUNK_ROWS).min(rows.end))
                .collect();
            let samples = chunks.into_par_iter().map(|rows| match look {
                Look::Height => {
                    heights.rows(rows).into_iter().flat_map(stored).collect::<Vec<u8>>()
                }
                Look::Holes => with_holes(&heights.rows(rows.clone()), &holes.rows(rows)),
                Look::Color => colors(&heights.rows(rows), width as usize),
            });
            samples.collect::<Vec<_>>().concat()
        })?;
        fs::rename(&unfinished, &path)?;
        Ok(path)
    }
}

#[expect(clippy::cast_possible_truncation, reason = "casts of floats saturate")]
fn stored(height: f32) -> [u8; 2] {
    (height.round() as i16).max(MISSING + 1).to_le_bytes()
}

pub(super) fn with_holes(heights: &[f32], holes: &[f32]) -> Vec<u8> {
    let samples = heights.iter().zip(holes);
    samples
        .flat_map(|(&height, &hole)| match Terrain::is_hole(hole) {
            true => MISSING.to_le_bytes(),
            false => stored(height),
        })
        .collect()
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "casts saturate")]
fn colors(heights: &[f32], width: usize) -> Vec<u8> {
    /// Light on the slope of a meter to a pixel, in codes.
    const LIGHT: f32 = 1.5;
    /// Codes to a meter of height.
    const TINT: f32 = 0.02;
    let mut colors = Vec::with_capacity(3 * heights.len());
    for row in heights.chunks_exact(width) {
        for (col, &height) in row.iter().enumerate() {
            let slope = height - row[if col == 0 { width - 1 } else { col - 1 }];
            let light = (LIGHT * slope).clamp(-60.0, 60.0);
            let tint = (TINT * height).clamp(-50.0, 50.0);
            colors.extend([
                (170.0 + tint * 0.8 + light) as u8,
                (115.0 + tint + light * 0.8) as u8,
                (75.0 + tint * 0.7 + light * 0.6) as u8,
            ]);
        }
    }
    colors
}
