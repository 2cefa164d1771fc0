//! Frames: a place of the reference surface, its axes, and where it is seen from the eye.
//!
//! Everything large about a place is computed here, in f64; what is left for the shaders are small
//! offsets from it. The normals of a frame's neighborhood are `n0 + d`, with `d` in the frame's
//! axes east, north and up.

use areoid_formats::body::Ellipsoid;
use areoid_formats::geodesy::Geographic;
use bytemuck::Zeroable;
use glam::{DMat3, DVec3};

use crate::mirror;

/// The terrain at a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Ground {
    pub(crate) position: Geographic,
    /// Not exaggerated. An `f32`, so that the shaders subtract the same number.
    pub(crate) height_m: f32,
}

/// A place and its axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Frame {
    /// Body-fixed meters, an exaggerated height above the reference surface.
    pub(crate) origin: DVec3,
    /// Columns east, north and up. On the axis those of the meridian of longitude 0.
    pub(crate) axes: DMat3,
    /// What heights are told from.
    pub(crate) ground: Ground,
    /// How far from it places are told by it, as a chord.
    pub(crate) reach: f64,
}

/// The point of the surface whose normal is `normal`, a unit vector: `(a² x, a² y, b² z) / w`.
///
/// # Precision
///
/// A few rounding errors of the radius; the normal's angles are never taken.
pub(crate) fn reference_point(ellipsoid: &Ellipsoid, normal: DVec3) -> DVec3 {
    let (a, b) = (ellipsoid.a().0, ellipsoid.b().0);
    let w = (1.0 - ellipsoid.eccentricity_squared() * normal.z * normal.z).sqrt();
    let flattened = (b / a) * (b / a);
    DVec3::new(normal.x, normal.y, flattened * normal.z) * (a / w)
}

/// East, north and up at a unit normal.
pub(crate) fn axes_at(normal: DVec3) -> DMat3 {
    let radius = normal.x.hypot(normal.y);
    let (cosine, sine) =
        if radius == 0.0 { (1.0, 0.0) } else { (normal.x / radius, normal.y / radius) };
    let east = DVec3::new(-sine, cosine, 0.0);
    let north = DVec3::new(-normal.z * cosine, -normal.z * sine, radius);
    DMat3::from_cols(east, north, normal)
}

impl Frame {
    /// The frame at a unit normal.
    pub(crate) fn new(
        ellipsoid: &Ellipsoid,
        normal: DVec3,
        ground: Ground,
        exaggeration: f64,
    ) -> Self {
        let height_m = exaggeration * f64::from(ground.height_m);
        let origin = reference_point(ellipsoid, normal) + height_m * normal;
        Self { origin, axes: axes_at(normal), ground, reach: 0.0 }
    }

    /// The frame for the shaders of one view: rounded to `f32` as an offset from the eye.
    pub(crate) fn seen_from(&self, eye: DVec3) -> mirror::Frame {
        mirror::Frame {
            origin: (self.origin - eye).as_vec3().to_array(),
            height: self.ground.height_m,
            east: self.axes.x_axis.as_vec3().to_array(),
            north: self.axes.y_axis.as_vec3().to_array(),
            up: self.axes.z_axis.as_vec3().to_array(),
            ..Zeroable::zeroed()
        }
    }
}
