//! Where a picture is taken from, and how sharp it has to be.

use areoid_formats::units::Radians;
use glam::{DMat3, DVec3};

/// A pinhole camera in body-fixed space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Body-fixed meters from the body's center.
    pub eye: DVec3,
    /// Columns: right, up, backward, as unit vectors in body-fixed space.
    pub orientation: DMat3,
    /// The whole angle between the lower and the upper edge of the picture.
    pub vertical_fov: Radians,
    /// Width and height of the picture in pixels.
    pub viewport: [u32; 2],
    /// The largest error of a height on the screen, and the largest texel of a color, in pixels.
    pub tolerance_px: f64,
}

impl View {
    /// The direction the camera looks in, a unit vector in body-fixed space.
    #[must_use]
    pub fn axis(&self) -> DVec3 {
        -self.orientation.z_axis
    }
}
