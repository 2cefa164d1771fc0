//! Grids: where on the body the texels of each level lie.
//!
//! ```text
//!   geographic ──Crs──▶ map (x right, y up) ──Grid──▶ texels of a level (x right, y down)
//! ```
//!
//! Texels are **cells**: the center of texel (0, 0) is at (0.5, 0.5), and the outer corner of the
//! grid, its [`origin`](Grid::origin), at (0, 0) of every level.

use serde::{Deserialize, Serialize};

pub use crate::placement::{GridError, Outline, Placement};

use crate::address::{Level, PageAddress};
use crate::geodesy::Geographic;
use crate::placement::{nominal_pixel, shown_at};
use crate::projection::{Crs, MapPoint};
use crate::pyramid::{Extent, Pyramid};
use crate::units::Meters;

/// A place in the texels of one level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TexelPoint {
    /// Texels to the right of the outline's left edge.
    pub x: f64,
    /// Texels down from its top edge.
    pub y: f64,
}

/// A place in the window of one page, in texels from the window's top-left corner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WindowPoint {
    /// The page.
    pub page: PageAddress,
    /// Texels to the right; the interior starts at 1.
    pub x: f64,
    /// Texels down; the interior starts at 1.
    pub y: f64,
}

/// A projection, an origin, a finest pixel size, and the levels above it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "GridParts", into = "GridParts")]
pub struct Grid {
    crs: Crs,
    origin: [f64; 2],
    pixel_size: [f64; 2],
    pyramid: Pyramid,
}

/// What of a [`Grid`] is written down.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct GridParts {
    crs: Crs,
    origin: [f64; 2],
    pixel_size: [f64; 2],
    extent: Extent,
    page_side: u32,
}

/// What [`Grid::from_outline`] made of a raster.
#[derive(Clone, Debug, PartialEq)]
pub struct NativeGrid {
    /// The grid on which texels of the finest level are the raster's pixels.
    pub grid: Grid,
    /// Columns dropped at the right because they repeat the first: 0 or 1.
    pub dropped_columns: u32,
}

impl Grid {
    /// A grid whose finest level has `extent`.
    ///
    /// # Units
    ///
    /// Map units: the outer corner of the first texel, top left, and the size of a texel.
    ///
    /// # Errors
    ///
    /// A [`GridError`] if the numbers are no place or size, or the extent has no pyramid.
    pub fn new(
        crs: Crs,
        origin: [f64; 2],
        pixel_size: [f64; 2],
        extent: Extent,
        page_side: u32,
    ) -> Result<Self, GridError> {
        if !pixel_size.iter().all(|&size| size > 0.0 && size.is_finite()) {
            return Err(GridError::PixelSize(pixel_size[0], pixel_size[1]));
        }
        if !origin.iter().all(|edge| edge.is_finite()) {
            return Err(GridError::Origin(origin[0], origin[1]));
        }
        let pyramid = Pyramid::new(extent, page_side)?;
        Ok(Self { crs, origin, pixel_size, pyramid })
    }

    /// The grid on which the leaves of a raster are its own pixels: its [`Placement`], where that
    /// has a pyramid.
    ///
    /// # Errors
    ///
    /// Any [`GridError`].
    pub fn from_outline(
        crs: Crs,
        outline: Outline,
        page_side: u32,
    ) -> Result<NativeGrid, GridError> {
        let placement = Placement::from_outline(crs, outline)?;
        let Placement { origin, pixel_size, dropped_columns, .. } = placement;
        let grid = Self::new(crs, origin, pixel_size, placement.extent(), page_side)?;
        Ok(NativeGrid { grid, dropped_columns })
    }

    /// Projection and body.
    #[must_use]
    pub fn crs(&self) -> &Crs {
        &self.crs
    }

    /// Map coordinates of the outer corner of the first texel, top left.
    #[must_use]
    pub fn origin(&self) -> [f64; 2] {
        self.origin
    }

    /// Map units to a texel of the finest level, both positive.
    #[must_use]
    pub fn pixel_size(&self) -> [f64; 2] {
        self.pixel_size
    }

    /// The levels and their pages.
    #[must_use]
    pub fn pyramid(&self) -> &Pyramid {
        &self.pyramid
    }

    /// Where the texels of the finest level lie on the map.
    #[must_use]
    pub fn placement(&self) -> Placement {
        let Extent { width, height, wraps, north, south } = self.pyramid.extent();
        let (crs, origin, pixel_size) = (self.crs, self.origin, self.pixel_size);
        let dropped_columns = 0;
        Placement { crs, origin, pixel_size, width, height, wraps, north, south, dropped_columns }
    }

    /// Map units to a texel of `level`.
    #[must_use]
    pub fn pixel_size_at(&self, level: Level) -> [f64; 2] {
        let scale = 2.0_f64.powi(i32::from(self.pyramid.finest().0) - i32::from(level.0));
        self.pixel_size.map(|size| size * scale)
    }

    /// Where a place on the map lies in the texels of `level`, inside the outline or not.
    ///
    /// On a map that goes around the body the turn is chosen in which the point is nearest the
    /// outline; on a grid that wraps, x is in `[0, width)`.
    #[must_use]
    pub fn texel_from_map(&self, level: Level, point: MapPoint) -> TexelPoint {
        let [pixel_x, pixel_y] = self.pixel_size_at(level);
        let mut across = point.x - self.origin[0];
        if let Some(period) = self.crs.wraps_with_period() {
            let span = f64::from(self.pyramid.extent().width) * self.pixel_size[0];
            across = across.rem_euclid(period);
            // The remainder of a number just below zero rounds up to the period itself.
            if across >= period || across > span.midpoint(period) {
                across -= period;
            }
            if self.pyramid.extent().wraps {
                across = across.max(0.0);
            }
        }
        TexelPoint { x: across / pixel_x, y: (self.origin[1] - point.y) / pixel_y }
    }

    /// Where a position lies in the texels of `level`, or `None` where the projection has no
    /// answer or the point is outside the outline.
    #[must_use]
    pub fn locate(&self, level: Level, position: Geographic) -> Option<TexelPoint> {
        let point = self.texel_from_map(level, self.crs.project(position)?);
        let finest = 2.0_f64.powi(i32::from(level.0) - i32::from(self.pyramid.finest().0));
        let extent = self.pyramid.extent();
        let (width, height) = (f64::from(extent.width) * finest, f64::from(extent.height) * finest);
        let inside = (0.0..=width).contains(&point.x) && (0.0..=height).contains(&point.y);
        inside.then_some(point)
    }

    /// The position shown at a point of `level`, also where a post-registered grid reaches past a
    /// pole; `None` outside the domain of the projection.
    #[must_use]
    pub fn geographic_from_texel(&self, level: Level, point: TexelPoint) -> Option<Geographic> {
        let [pixel_x, pixel_y] = self.pixel_size_at(level);
        let x = self.origin[0] + point.x * pixel_x;
        let y = self.origin[1] - point.y * pixel_y;
        shown_at(&self.crs, MapPoint { x, y })
    }

    /// The page whose interior holds a point of `level` and where it lies in its window. Points
    /// outside the outline go to the page nearest to them.
    ///
    /// # Panics
    ///
    /// If the pyramid has no such level.
    #[must_use]
    pub fn window_from_texel(&self, level: Level, point: TexelPoint) -> WindowPoint {
        let (rows, cols) = self.pyramid.pages(level).expect("the level is this grid's");
        let interior = f64::from(self.pyramid.interior());
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "float to integer saturates, and the result is clamped to the level"
        )]
        let index = |texels: f64, count: u32| ((texels / interior) as u32).min(count - 1);
        let (row, col) = (index(point.y, rows), index(point.x, cols));
        let border = f64::from(Pyramid::BORDER);
        WindowPoint {
            page: PageAddress::new(level, row, col),
            x: point.x - f64::from(col) * interior + border,
            y: point.y - f64::from(row) * interior + border,
        }
    }

    /// Ground meters to a texel of the finest level where the map is truest: the pixel size by
    /// which compositions sort datasets.
    #[must_use]
    pub fn nominal_pixel(&self) -> Meters {
        nominal_pixel(&self.crs, self.pixel_size)
    }

    /// The weight of this grid in a composition at a position: how finely and how evenly it
    /// samples the ground there, in texels per square meter.
    ///
    /// With σ₁ ≥ σ₂ the ground meters of a texel along the two principal directions, q =
    /// (1/σ₁²)·(σ₂/σ₁): a grid counts by its coarser direction, and less the more it is squeezed.
    /// It falls to (nearly) nothing where an equirectangular grid crowds its columns at a pole,
    /// and a grid ten times finer outweighs another a hundred times.
    ///
    /// # Domain
    ///
    /// Positive wherever the projection has an answer, 0 elsewhere.
    ///
    /// # References
    ///
    /// After Kooima 2008, §4.1.2, who weights projections by the Jacobian's stretch; the factor
    /// for texel density is ours, so that resolution and projection are one scale.
    #[must_use]
    pub fn quality(&self, position: Geographic) -> f64 {
        let (largest, smallest) = self.crs.principal_scales(position, self.pixel_size);
        if !(largest.is_finite() && smallest.is_finite() && largest > 0.0) {
            return 0.0;
        }
        // At a pole a lone global grid must still weigh something.
        let evenness = (smallest / largest).max(2.0_f64.powi(-20));
        evenness / (largest * largest)
    }
}

impl TryFrom<GridParts> for Grid {
    type Error = GridError;

    fn try_from(parts: GridParts) -> Result<Self, GridError> {
        let GridParts { crs, origin, pixel_size, extent, page_side } = parts;
        Self::new(crs, origin, pixel_size, extent, page_side)
    }
}

impl From<Grid> for GridParts {
    fn from(grid: Grid) -> Self {
        Self {
            crs: grid.crs,
            origin: grid.origin,
            pixel_size: grid.pixel_size,
            extent: grid.pyramid.extent(),
            page_side: grid.pyramid.page_side(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::Body;
    use crate::projection::Projection;
    use crate::pyramid::PoleContact;
    use crate::units::Degrees;

    fn mars_degrees() -> Crs {
        Crs::new(Projection::Geographic, Body::parse("mars").unwrap().ellipsoid)
    }

    fn outline(origin: [f64; 2], pixel: f64, width: u32, height: u32) -> Outline {
        Outline { origin, pixel_size: [pixel; 2], width, height }
    }

    fn native(outline: Outline) -> NativeGrid {
        Grid::from_outline(mars_degrees(), outline, 512).unwrap()
    }

    #[test]
    fn a_globe_of_areas_is_recognized() {
        let made = native(outline([0.0, 90.0], 0.125, 2880, 1440));
        let extent = made.grid.pyramid().extent();
        assert!(extent.wraps);
        assert_eq!((extent.north, extent.south), (PoleContact::Outline, PoleContact::Outline));
        assert_eq!((made.dropped_columns, made.grid.pixel_size()), (0, [0.125; 2]));
    }

    #[test]
    fn a_globe_of_posts_is_recognized_and_its_last_column_dropped() {
        let half = 0.5;
        let made = native(outline([-half, 90.0 + half], 1.0, 361, 181));
        let extent = made.grid.pyramid().extent();
        assert_eq!((extent.width, extent.height, made.dropped_columns), (360, 181, 1));
        assert_eq!((extent.north, extent.south), (PoleContact::Posts, PoleContact::Posts));
        assert_eq!(made.grid.origin(), [-0.5, 90.5]);
    }

    #[test]
    fn rounded_numbers_become_exact() {
        let made = native(outline([-180.0, 90.0], 0.083_333, 4320, 2160));
        assert_eq!(made.grid.pixel_size(), [360.0 / 4320.0; 2]);
        assert_eq!(made.grid.origin()[1], 90.0);
    }

    #[test]
    fn a_region_is_left_alone() {
        let made = native(outline([350.0, 20.0], 0.1, 200, 100));
        assert!(!made.grid.pyramid().extent().wraps);
        assert_eq!((made.grid.origin(), made.grid.pixel_size()), ([350.0, 20.0], [0.1; 2]));
    }

    #[test]
    fn outlines_that_make_no_sense_are_refused() {
        let refuse = |made| Grid::from_outline(mars_degrees(), made, 512).unwrap_err();
        let past = refuse(outline([0.0, 95.0], 1.0, 10, 10));
        assert!(matches!(past, GridError::PastPole { .. }), "{past}");
        let turns = refuse(outline([0.0, 90.0], 1.0, 400, 10));
        assert!(matches!(turns, GridError::ManyTurns { .. }), "{turns}");
        let size = refuse(outline([0.0, 90.0], f64::NAN, 4, 10));
        assert!(matches!(size, GridError::PixelSize(..)), "{size}");
    }

    /// A region across the antimeridian, asked for on both of its sides.
    #[test]
    fn positions_are_found_in_the_turn_of_the_outline() {
        let grid = native(outline([350.0, 20.0], 0.1, 200, 100)).grid;
        let finest = grid.pyramid().finest();
        for (longitude, x) in [(-9.95, 0.5), (5.05, 150.5), (350.05, 0.5), (365.05, 150.5)] {
            let position = Geographic::from_degrees(Degrees(longitude), Degrees(15.05));
            let point = grid.locate(finest, position).unwrap();
            assert!((point.x - x).abs() < 1e-9 && (point.y - 49.5).abs() < 1e-9, "{point:?}");
        }
        let outside = Geographic::from_degrees(Degrees(20.0), Degrees(15.0));
        assert_eq!(grid.locate(finest, outside), None);
    }

    #[test]
    fn a_texel_past_the_pole_is_seen_from_the_other_side() {
        let grid = native(outline([-0.5, 90.5], 1.0, 361, 181)).grid;
        let corner = TexelPoint { x: 10.5, y: 0.25 };
        let seen = grid.geographic_from_texel(grid.pyramid().finest(), corner).unwrap();
        assert!((Degrees::from(seen.latitude).0 - 89.75).abs() < 1e-9);
        assert!((Degrees::from(seen.longitude).0 + 170.0).abs() < 1e-9);
    }

    #[test]
    fn the_last_column_leads_to_the_first() {
        let grid = native(outline([0.0, 90.0], 0.125, 2880, 1440)).grid;
        let finest = grid.pyramid().finest();
        let at = |longitude| {
            let position = Geographic::from_degrees(Degrees(longitude), Degrees(0.0));
            grid.locate(finest, position).unwrap().x
        };
        assert!(at(0.0) < 1e-9 && at(360.0) < 1e-9);
        assert!((at(-1e-13) - 2880.0).abs() < 1e-6 || at(-1e-13) < 1e-6);
        assert!((at(-0.0625) - 2879.5).abs() < 1e-9);
    }

    #[test]
    fn quality_prefers_the_finer_and_the_truer_grid() {
        let globe = native(outline([0.0, 90.0], 0.125, 2880, 1440)).grid;
        let at =
            |latitude| globe.quality(Geographic::from_degrees(Degrees(10.0), Degrees(latitude)));
        assert!((at(60.0) / at(0.0) - 0.5).abs() < 1e-9);
        assert!(at(90.0) > 0.0 && at(90.0) < 1e-4 * at(0.0));
    }
}
