//! Rasters side by side and over one another: where each lies among their common pixels.

use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use areoid_formats::grid::{Grid, GridError, Outline, Placement};
use areoid_formats::projection::Crs;
use areoid_formats::pyramid::{Extent, PoleContact};

use crate::raster::Raster;

/// How far a raster may lie off the common grid, in pixels.
const ALIGNMENT_PX: f64 = 1e-3;

/// Why rasters make no dataset.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MosaicError {
    /// No raster at all.
    #[error("no raster to read")]
    Empty,
    /// The outline makes no grid.
    #[error("{} makes no grid", path.display())]
    Grid {
        /// The raster, or the first of several.
        path: PathBuf,
        /// Why.
        source: GridError,
    },
    /// Rasters that do not share a grid.
    #[error(
        "{} does not lie on the grid of {}: {reason}; rasters on several grids are not supported yet",
        other.display(), first.display()
    )]
    OffGrid {
        /// The first raster.
        first: PathBuf,
        /// The one that differs.
        other: PathBuf,
        /// In what.
        reason: String,
    },
    /// Rasters of different kinds of samples.
    #[error("{} and {} hold different kinds of samples", first.display(), other.display())]
    OtherSamples {
        /// The first raster.
        first: PathBuf,
        /// The one that differs.
        other: PathBuf,
    },
}

/// Rasters that share a projection and a pixel size, a whole number of pixels apart.
#[derive(Clone, Debug)]
pub struct Layout {
    crs: Crs,
    outline: Outline,
    parts: Vec<Placed>,
}

/// A raster and where its first pixel lies in a layout.
#[derive(Clone, Debug)]
pub struct Placed {
    /// The raster.
    pub raster: Arc<dyn Raster>,
    /// Column of its first pixel.
    pub col: u32,
    /// Row of its first pixel.
    pub row: u32,
}

impl Layout {
    /// Places `rasters`, all on `crs`, among the pixels of the first.
    ///
    /// # Errors
    ///
    /// [`MosaicError`] if one does not share them.
    ///
    /// # Panics
    ///
    /// Never: without a raster it fails.
    pub fn new(rasters: Vec<Arc<dyn Raster>>, crs: Crs) -> Result<Self, MosaicError> {
        let first = Arc::clone(rasters.first().ok_or(MosaicError::Empty)?);
        let first = first.info();
        let [pixel_x, pixel_y] = first.outline.pixel_size;
        let [left, top] = first.outline.origin;

        // Offsets in pixels from the first raster's corner.
        let mut places = Vec::new();
        for raster in &rasters {
            let info = raster.info();
            let off_grid = |reason: String| MosaicError::OffGrid {
                first: first.path.clone(),
                other: info.path.clone(),
                reason,
            };
            if info.crs != first.crs {
                return Err(off_grid("another projection".to_owned()));
            }
            if (info.sample, info.bands) != (first.sample, first.bands)
                || (info.scale, info.offset) != (first.scale, first.offset)
            {
                let (first, other) = (first.path.clone(), info.path.clone());
                return Err(MosaicError::OtherSamples { first, other });
            }
            let [width, height] = info.outline.pixel_size;
            let drift = ((width / pixel_x - 1.0).abs() * f64::from(info.width))
                .max((height / pixel_y - 1.0).abs() * f64::from(info.height));
            let [x, y] = info.outline.origin;
            let (col, row) = ((x - left) / pixel_x, (top - y) / pixel_y);
            let off = (col - col.round()).abs().max((row - row.round()).abs());
            if drift.max(off).is_nan() || drift > ALIGNMENT_PX {
                return Err(off_grid(format!("pixels of {width} x {height}")));
            }
            if off > ALIGNMENT_PX {
                return Err(off_grid(format!("{off:.3} pixels beside it")));
            }
            places.push((col.round(), row.round()));
        }

        let extreme = |values: &mut dyn Iterator<Item = f64>, pick: fn(f64, f64) -> f64| {
            values.reduce(pick).expect("there is a first raster")
        };
        let (least_col, least_row) = (
            extreme(&mut places.iter().map(|place| place.0), f64::min),
            extreme(&mut places.iter().map(|place| place.1), f64::min),
        );
        let ends = || rasters.iter().map(|raster| raster.info()).zip(&places);
        let width = extreme(
            &mut ends().map(|(info, place)| place.0 - least_col + f64::from(info.width)),
            f64::max,
        );
        let height = extreme(
            &mut ends().map(|(info, place)| place.1 - least_row + f64::from(info.height)),
            f64::max,
        );
        let too_large = || MosaicError::OffGrid {
            first: first.path.clone(),
            other: first.path.clone(),
            reason: format!("together they span {width} x {height} pixels"),
        };
        let outline = Outline {
            origin: [left + least_col * pixel_x, top - least_row * pixel_y],
            pixel_size: [pixel_x, pixel_y],
            width: whole(width).ok_or_else(too_large)?,
            height: whole(height).ok_or_else(too_large)?,
        };
        let parts = rasters
            .into_iter()
            .zip(places)
            .map(|(raster, (col, row))| {
                let col = whole(col - least_col).ok_or_else(too_large)?;
                let row = whole(row - least_row).ok_or_else(too_large)?;
                Ok(Placed { raster, col, row })
            })
            .collect::<Result<_, MosaicError>>()?;
        Ok(Self { crs, outline, parts })
    }

    /// What the coordinates of the outline are.
    #[must_use]
    pub fn crs(&self) -> Crs {
        self.crs
    }

    /// Where the pixels lie.
    #[must_use]
    pub fn outline(&self) -> Outline {
        self.outline
    }

    /// What the outline means on its map.
    ///
    /// # Errors
    ///
    /// [`MosaicError::Grid`] if nothing.
    pub fn placement(&self) -> Result<Placement, MosaicError> {
        Placement::from_outline(self.crs, self.outline).map_err(|source| {
            let path = self.parts[0].raster.info().path.clone();
            MosaicError::Grid { path, source }
        })
    }

    /// The grid of some of the rows: the pixels lie where they do on the grid of all.
    ///
    /// # Errors
    ///
    /// [`MosaicError::Grid`] if they make none.
    pub fn grid_of_rows(&self, rows: Range<u32>, page_side: u32) -> Result<Grid, MosaicError> {
        let placement = self.placement()?;
        let Placement { crs, origin: [left, top], pixel_size, height, .. } = placement;
        let contact = |reached, contact| if reached { contact } else { PoleContact::None };
        let extent = Extent {
            height: rows.len().try_into().unwrap_or(height),
            north: contact(rows.start == 0, placement.north),
            south: contact(rows.end == height, placement.south),
            ..placement.extent()
        };
        let origin = [left, top - f64::from(rows.start) * pixel_size[1]];
        Grid::new(crs, origin, pixel_size, extent, page_side).map_err(|source| {
            let path = self.parts[0].raster.info().path.clone();
            MosaicError::Grid { path, source }
        })
    }

    /// The rows of the grid of all rows that `grid` has, if it lies on it; else all.
    #[must_use]
    pub fn rows_of(&self, grid: &Grid) -> Range<u32> {
        let Outline { height, .. } = self.outline;
        let all = 0..height;
        let Ok(placement) = self.placement() else { return all };
        let rows = (placement.origin[1] - grid.origin()[1]) / placement.pixel_size[1];
        let Some(start) = whole(rows.round()) else { return all };
        let rows = start..start.saturating_add(grid.pyramid().extent().height);
        if rows.end <= height { rows } else { all }
    }

    /// The rasters, each over those before it.
    #[must_use]
    pub fn parts(&self) -> &[Placed] {
        &self.parts
    }
}

/// A whole number of pixels that a grid can have.
fn whole(pixels: f64) -> Option<u32> {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "in range")]
    (0.0..=f64::from(u32::MAX)).contains(&pixels).then_some(pixels as u32)
}
