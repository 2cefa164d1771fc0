//! Where a raster's pixels lie on its map.

use std::path::Path;

use super::error::RasterError;

/// The rectangle of a raster on its map, rows downward.
///
/// # Units
///
/// Degrees for geographic systems, meters for projected ones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outline {
    /// x and y of the *outer corner* of the first (top left) pixel, whatever the file's own
    /// registration: the half pixel of `PixelIsPoint` and of world files is taken off already.
    pub origin: [f64; 2],
    /// Width and height of a pixel, both positive.
    pub pixel_size: [f64; 2],
}

impl Outline {
    /// West, south, east, north of a raster of `width` × `height` pixels.
    #[must_use]
    pub fn extent(&self, width: u32, height: u32) -> [f64; 4] {
        let ([x, y], [dx, dy]) = (self.origin, self.pixel_size);
        [x, y - dy * f64::from(height), x + dx * f64::from(width), y]
    }

    /// The outline of `width` × `height` pixels between west, south, east and north.
    ///
    /// # Errors
    ///
    /// [`RasterError::Option`] unless west is less than east and south less than north.
    pub(crate) fn from_extent(
        path: &Path,
        extent: [f64; 4],
        (width, height): (u32, u32),
    ) -> Result<Self, RasterError> {
        let [west, south, east, north] = extent;
        if !(extent.iter().all(|edge| edge.is_finite()) && west < east && south < north) {
            return Err(RasterError::Option {
                path: path.to_owned(),
                option: "--extent",
                found: format!("{west},{south},{east},{north}"),
                expected: "W,S,E,N with W < E and S < N (E may pass 180)".to_owned(),
            });
        }
        Ok(Self {
            origin: [west, north],
            pixel_size: [(east - west) / f64::from(width), (north - south) / f64::from(height)],
        })
    }
}

/// A file's own geotransform: pixel (0, 0)'s outer corner and the signed steps to the next pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Steps {
    pub(crate) corner: [f64; 2],
    /// Map units to the next column and to the next row; the second is negative with north up.
    pub(crate) step: [f64; 2],
}

/// Which way the rows of a file run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Rows {
    /// The first row is the northernmost.
    Down,
    /// The first row is the southernmost: rows are handed out in reverse.
    Up,
}

impl Steps {
    /// The outline, and which way the rows run, of a raster `height` pixels high; `None` if the
    /// columns run westward or anything is zero or not finite.
    pub(crate) fn outline(&self, height: u32) -> Option<(Outline, Rows)> {
        let ([x, y], [dx, dy]) = (self.corner, self.step);
        if !(x.is_finite() && y.is_finite() && dx.is_finite() && dy.is_finite() && dx > 0.0) {
            return None;
        }
        let (top, rows) = match dy {
            _ if dy < 0.0 => (y, Rows::Down),
            _ if dy > 0.0 => (y + dy * f64::from(height), Rows::Up),
            _ => return None,
        };
        Some((Outline { origin: [x, top], pixel_size: [dx, dy.abs()] }, rows))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn south_up_rasters_are_turned_over() {
        let up = Steps { corner: [1.0, -90.0], step: [0.5, 2.0] };
        let (outline, rows) = up.outline(90).unwrap();
        assert_eq!(rows, Rows::Up);
        assert_eq!(outline, Outline { origin: [1.0, 90.0], pixel_size: [0.5, 2.0] });
        assert_eq!(outline.extent(4, 90), [1.0, -90.0, 3.0, 90.0]);
    }

    #[test]
    fn an_extent_must_be_the_right_way_round() {
        let path = Path::new("a.png");
        let outline = Outline::from_extent(path, [170.0, -10.0, 190.0, 10.0], (40, 10)).unwrap();
        assert_eq!(outline, Outline { origin: [170.0, 10.0], pixel_size: [0.5, 2.0] });
        assert!(Outline::from_extent(path, [10.0, 0.0, -10.0, 1.0], (1, 1)).is_err());
        assert!(Outline::from_extent(path, [0.0, 0.0, f64::NAN, 1.0], (1, 1)).is_err());
    }
}
