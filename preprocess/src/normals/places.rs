//! Where the texels of a grid's finest level lie in body-fixed axes.

use areoid_formats::geodesy::{Geographic, surface_normal};
use areoid_formats::grid::{Grid, TexelPoint};
use areoid_formats::units::{Meters, Radians};
use glam::DVec3;

/// A place on the reference surface, or the ground above it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    /// Body-fixed meters.
    pub(super) at: DVec3,
    /// The reference surface's unit normal below.
    pub(super) up: DVec3,
    /// Meters above that surface.
    pub(super) height_m: f64,
}

impl Place {
    /// Where no map leads, and no ground is.
    pub(super) const NOWHERE: Self = Self { at: DVec3::NAN, up: DVec3::NAN, height_m: f64::NAN };

    /// What lies `height_m` above a place on the surface; nowhere if that is NaN.
    pub(super) fn raised(self, height_m: f64) -> Self {
        Self { at: self.at + self.up * height_m, height_m, ..self }
    }
}

/// The feet of all texel centers of a grid.
#[derive(Clone, Debug)]
pub(super) struct Places {
    grid: Grid,
    /// Of a map whose columns are meridians and whose rows are parallels, so that a texel costs no
    /// trigonometry.
    tables: Option<Tables>,
}

#[derive(Clone, Debug)]
struct Tables {
    /// Cosine and sine of each column's longitude.
    cols: Vec<[f64; 2]>,
    /// Each row's foot on the meridian of longitude 0.
    rows: Vec<Place>,
}

impl Places {
    pub(super) fn new(grid: &Grid) -> Self {
        let tables = grid.crs().wraps_with_period().and_then(|_| Tables::new(grid));
        Self { grid: grid.clone(), tables }
    }

    /// The foot of a texel's center; NaN where the map shows nothing.
    pub(super) fn foot(&self, row: u32, col: u32) -> Place {
        let Some(tables) = &self.tables else {
            return geographic(&self.grid, row, col)
                .map_or(Place::NOWHERE, |position| foot(&self.grid, position));
        };
        let Place { at, up, height_m } = tables.rows[row as usize];
        let [cos, sin] = tables.cols[col as usize];
        let turned = |v: DVec3| DVec3::new(v.x * cos, v.x * sin, v.z);
        Place { at: turned(at), up: turned(up), height_m }
    }

    /// Whether the map shows something at every texel: it does if it does at the corners, because
    /// what a map shows is a disc or all between two parallels.
    pub(super) fn are_everywhere(&self) -> bool {
        let extent = self.grid.pyramid().extent();
        let (last_row, last_col) = (extent.height - 1, extent.width - 1);
        [(0, 0), (0, last_col), (last_row, 0), (last_row, last_col)]
            .into_iter()
            .all(|(row, col)| !self.foot(row, col).at.is_nan())
    }
}

impl Tables {
    /// `None` if a row lies nowhere.
    fn new(grid: &Grid) -> Option<Self> {
        let extent = grid.pyramid().extent();
        // A row that rounding puts past a pole would be seen from the other side.
        let middle = extent.height / 2;
        let cols = (0..extent.width).map(|col| {
            let longitude = geographic(grid, middle, col)?.longitude;
            let direction = surface_normal(Geographic { longitude, latitude: Radians(0.0) });
            Some([direction.x, direction.y])
        });
        let rows = (0..extent.height).map(|row| {
            let latitude = geographic(grid, row, 0)?.latitude;
            Some(foot(grid, Geographic { longitude: Radians(0.0), latitude }))
        });
        Some(Self { cols: cols.collect::<Option<_>>()?, rows: rows.collect::<Option<_>>()? })
    }
}

fn geographic(grid: &Grid, row: u32, col: u32) -> Option<Geographic> {
    let center = TexelPoint { x: f64::from(col) + 0.5, y: f64::from(row) + 0.5 };
    grid.geographic_from_texel(grid.pyramid().finest(), center)
}

fn foot(grid: &Grid, position: Geographic) -> Place {
    let at = grid.crs().body.cartesian_from_geographic(position, Meters(0.0));
    Place { at, up: surface_normal(position), height_m: 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use areoid_formats::body::Body;
    use areoid_formats::geodesy::LatitudeKind;
    use areoid_formats::grid::Outline;
    use areoid_formats::projection::{Crs, Projection};

    /// Tables are a short cut, to rounding; also of planetocentric rows, and of posts on both poles.
    #[test]
    fn tables_say_what_the_map_says() {
        let body = Body::parse("3000000,2000000").unwrap().ellipsoid;
        let sphere = Body::parse("mars").unwrap().ellipsoid;
        let crs =
            Crs::new(Projection::Geographic, sphere).on_body(body, LatitudeKind::Planetocentric);
        let areas = Outline { origin: [-180.0, 90.0], pixel_size: [5.0; 2], width: 72, height: 36 };
        let posts = Outline { origin: [-2.5, 92.5], pixel_size: [5.0; 2], width: 72, height: 37 };
        for outline in [areas, posts] {
            let grid = Grid::from_outline(crs, outline, 18).unwrap().grid;
            let places = Places::new(&grid);
            assert!(places.tables.is_some() && places.are_everywhere());
            let plain = Places { grid, tables: None };
            for (row, col) in (0..outline.height).flat_map(|row| (0..72).map(move |col| (row, col)))
            {
                let (fast, slow) = (places.foot(row, col), plain.foot(row, col));
                assert!((fast.at - slow.at).length() < 1e-8, "{row} {col}");
                assert!((fast.up - slow.up).length() < 1e-14, "{row} {col}");
            }
        }
    }
}
