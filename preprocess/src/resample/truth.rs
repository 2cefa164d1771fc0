//! Pixels on one grid as what a dataset on another was made from.
//!
//! Nothing of what leaves are made with is used: each pixel finds its place among the texels through
//! the body, one by one.

use areoid_formats::grid::{Grid, Placement, TexelPoint};
use areoid_formats::page::Kind;
use areoid_formats::pyramid::{Extent, Pyramid};

use super::OtherBody;
use super::rasters::Rasters;
use super::source::{Patch, Rect, Source as _};
use super::tile::TargetTile;
use super::transform::{Precision, Transform};
use crate::mosaic::Layout;
use crate::raster::RasterError;
use crate::truth::{Sample, Truth};

/// Pixels along a side of a parcel.
const PARCEL: u32 = 256;

/// How far from a pole a post on it may be put, in pixels.
const POST_PX: f64 = 1e-9;

/// The pixels that a resampled dataset was made from.
#[derive(Debug)]
pub struct SourcePixels {
    grid: Grid,
    transform: Transform,
    rasters: Rasters,
    parcels: Vec<Rect>,
}

impl SourcePixels {
    /// Those of `layout`, `kind` at `placement`, under `grid`.
    ///
    /// # Errors
    ///
    /// [`OtherBody`].
    pub fn new(
        grid: Grid,
        layout: &Layout,
        placement: Placement,
        kind: Kind,
    ) -> Result<Self, OtherBody> {
        let transform = Transform::new(&grid.placement(), &placement, Precision::Exact);
        let transform = transform.ok_or(OtherBody)?;
        let span = |start: u32, length: u32| start..(start + PARCEL).min(length);
        let parcels = (0..placement.height).step_by(PARCEL as usize).flat_map(|row| {
            (0..placement.width).step_by(PARCEL as usize).map(move |col| Rect {
                cols: span(col, placement.width),
                rows: span(row, placement.height),
            })
        });
        let parcels: Vec<Rect> = parcels.collect();
        let rasters = Rasters::new(layout, placement, kind, &parcels);
        Ok(Self { grid, transform, rasters, parcels })
    }

    /// Whether any of them may lie under the grid.
    #[must_use]
    pub fn are_on_grid(&self) -> bool {
        let Extent { width, height, .. } = self.grid.pyramid().extent();
        let whole = TargetTile { row: 0, col: 0, rows: height as usize, cols: width as usize };
        self.transform.range(whole).is_some()
    }

    /// Where a pixel's center lies; `None` outside the outline.
    fn place(&self, row: u32, col: u32, value: [f64; 3]) -> Option<Sample> {
        let (u, v) = (f64::from(col), f64::from(row));
        // A post on a pole may lie past it by rounding.
        let inward = if row == 0 { POST_PX } else { -POST_PX };
        let (row, col) =
            self.transform.back(u, v).or_else(|| self.transform.back(u, v + inward))?;
        let Extent { width, height, .. } = self.grid.pyramid().extent();
        let (x, y) = (col + 0.5, row + 0.5);
        let inside =
            (0.0..=f64::from(width)).contains(&x) && (0.0..=f64::from(height)).contains(&y);
        let finest = self.grid.pyramid().finest();
        let at = self.grid.window_from_texel(finest, TexelPoint { x, y });
        let border = f64::from(Pyramid::BORDER);
        let (x, y, value) = (at.x - border, at.y - border, Some(value));
        inside.then_some(Sample { leaf: at.page, x, y, value })
    }
}

impl Truth for SourcePixels {
    fn parcels(&self) -> u64 {
        self.parcels.len() as u64
    }

    fn samples(&self, parcel: u64) -> Result<Vec<Sample>, RasterError> {
        let Some(rect) = usize::try_from(parcel).ok().and_then(|at| self.parcels.get(at)) else {
            return Ok(Vec::new());
        };
        let mut patch = Patch::default();
        patch.read(&self.rasters, rect)?;
        let Patch { heights, codes, alpha } = &patch;
        let value = |at: usize| match self.rasters.kind() {
            Kind::Height => (!heights[at].is_nan()).then(|| [f64::from(heights[at]), 0.0, 0.0]),
            Kind::Color | Kind::Normal => {
                (alpha[at] != 0).then(|| codes.each_ref().map(|plane| f64::from(plane[at])))
            }
        };
        let places = rect.rows.clone().flat_map(|row| rect.cols.clone().map(move |col| (row, col)));
        let samples = places.enumerate();
        Ok(samples.filter_map(|(at, (row, col))| self.place(row, col, value(at)?)).collect())
    }

    fn is_texels(&self) -> bool {
        false
    }
}
