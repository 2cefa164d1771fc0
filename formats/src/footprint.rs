//! The ground under a page, and how far its shell reaches in a direction.
//!
//! On a map whose x is longitude and whose y is latitude, a page is a rectangle of both, and the
//! extent of its shell along any direction has a closed form:
//!
//! ```text
//! p(λ, φ, h) = (R cos δ, R sin δ, Z)    δ = λ - middle    R = (N + h) cos φ    Z = (N b²/a² + h) sin φ
//! ```
//!
//! For a direction in the plane of the middle meridian, `x R cos δ + z Z` is linear in cos δ and in
//! h, so that its extremes lie at the ends of both; along φ its slope is
//! `(M + h) (z cos φ - x cos δ sin φ)`, which vanishes at `tan φ = z / (x cos δ)` alone.
//!
//! On a polar stereographic map the page is sampled on a lattice. What lies between the samples is
//! within `Σ Δ² max |p″| / 8` of their convex hull, one term for each direction of the map: linear
//! interpolation misses a curve by no more. On a sphere of radius r the map gives
//! `|p″| = (4 r / C²) (1 + τ²)^(-3/2)`, with `C` its radius at τ = 1 and τ = tan(θ/2) the half-angle
//! tangent of the colatitude: the curvature of the sphere and the change of scale together.

use std::f64::consts::{FRAC_PI_2, PI};

use glam::{DMat3, DVec3};

use crate::address::PageAddress;
use crate::body::Ellipsoid;
use crate::geodesy::{Geographic, surface_normal};
use crate::grid::Grid;
use crate::projection::{MapPoint, PolarStereographic, Pole, Projection};
use crate::units::{Meters, Radians};

/// The interior of a page on the map, clipped to the outline of the finest level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct MapRectangle {
    pub(crate) left: f64,
    pub(crate) right: f64,
    pub(crate) bottom: f64,
    pub(crate) top: f64,
}

/// The ground under a page.
#[derive(Clone, Debug)]
pub(crate) enum Footprint {
    /// All longitudes within `half_width` of the middle one, all latitudes from south to north.
    Geographic(GeographicRectangle),
    /// Points on the ground whose convex hull misses it by no more than `sag`.
    Sampled(Samples),
    /// Who knows: a page that reaches outside its projection.
    Anywhere,
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct GeographicRectangle {
    middle: f64,
    half_width: f64,
    south: f64,
    north: f64,
    /// Radians by which the rows reach past a pole.
    past_pole: f64,
}

#[derive(Clone, Debug)]
pub(crate) struct Samples {
    /// Planetographic normals; the ground point of each follows from it.
    normals: Vec<DVec3>,
    /// Normal at the middle of the page, and a tangent there along x of the map.
    up: DVec3,
    right: DVec3,
    /// Meters between the hull of the samples and the ground, at height 0.
    sag: f64,
    /// The latitude nearest the equator, as an absolute value.
    lowest_latitude: f64,
}

/// Extents along three axes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Extents {
    pub(crate) axes: DMat3,
    pub(crate) min: DVec3,
    pub(crate) max: DVec3,
}

impl MapRectangle {
    pub(crate) fn new(grid: &Grid, page: PageAddress) -> Self {
        let extent = grid.pyramid().extent();
        let interior = f64::from(grid.pyramid().interior());
        let finest = f64::from(grid.pyramid().halvings(page.level)).exp2();
        let span = |index: u32, count: u32, pixel: f64| {
            let index = f64::from(index);
            let end = f64::from(count);
            let start = (index * interior * finest).min(end);
            (start * pixel, ((index + 1.0) * interior * finest).min(end) * pixel)
        };
        let ([x, y], [pixel_x, pixel_y]) = (grid.origin(), grid.pixel_size());
        let (left, right) = span(page.col, extent.width, pixel_x);
        let (top, bottom) = span(page.row, extent.height, pixel_y);
        Self { left: x + left, right: x + right, bottom: y - bottom, top: y - top }
    }
}

impl Footprint {
    pub(crate) fn new(grid: &Grid, page: PageAddress) -> Self {
        let rectangle = MapRectangle::new(grid, page);
        let found = match &grid.crs().projection {
            Projection::PolarStereographic(map) => {
                Samples::new(grid, map, rectangle).map(Self::Sampled)
            }
            Projection::Geographic | Projection::Equirectangular(_) => {
                GeographicRectangle::new(grid, rectangle).map(Self::Geographic)
            }
        };
        found.unwrap_or(Self::Anywhere)
    }

    /// The extents of the shell between two heights, which are above every center of curvature.
    pub(crate) fn extents(&self, body: &Ellipsoid, heights: [f64; 2]) -> Option<Extents> {
        match self {
            Self::Geographic(rectangle) => Some(rectangle.extents(body, heights)),
            Self::Sampled(samples) => Some(samples.extents(body, heights)),
            Self::Anywhere => None,
        }
    }

    /// The latitude nearest the equator, as an absolute value: radii are greatest there.
    pub(crate) fn lowest_latitude(&self) -> f64 {
        match self {
            Self::Geographic(GeographicRectangle { south, north, .. }) => {
                if *south <= 0.0 && *north >= 0.0 { 0.0 } else { south.abs().min(north.abs()) }
            }
            Self::Sampled(samples) => samples.lowest_latitude,
            Self::Anywhere => 0.0,
        }
    }
}

impl GeographicRectangle {
    fn new(grid: &Grid, rectangle: MapRectangle) -> Option<Self> {
        let crs = grid.crs();
        let period = crs.wraps_with_period()?;
        let (north_pole, south_pole) = (crs.y_of_pole(Pole::North)?, crs.y_of_pole(Pole::South)?);
        let x = rectangle.left.midpoint(rectangle.right);
        let latitude = |y: f64| {
            let position = crs.unproject(MapPoint { x, y: y.clamp(south_pole, north_pole) })?;
            Some((position.longitude.0, position.latitude.0))
        };
        let ((middle, north), (_, south)) = (latitude(rectangle.top)?, latitude(rectangle.bottom)?);
        let past = (rectangle.top - north_pole).max(south_pole - rectangle.bottom).max(0.0);
        Some(Self {
            middle,
            half_width: (PI * (rectangle.right - rectangle.left) / period).min(PI),
            south,
            north,
            past_pole: past * PI / (north_pole - south_pole),
        })
    }

    fn extents(&self, body: &Ellipsoid, heights: [f64; 2]) -> Extents {
        // A wide page is seen along the axes of the body, a narrow one along its own vertical.
        let tilt = if self.half_width < FRAC_PI_2 { self.south.midpoint(self.north) } else { 0.0 };
        let (sin_tilt, cos_tilt) = tilt.sin_cos();
        let (sin_middle, cos_middle) = self.middle.sin_cos();
        let outward = DVec3::new(cos_middle, sin_middle, 0.0);
        let axes = DMat3::from_cols(
            DVec3::new(-sin_middle, cos_middle, 0.0),
            DVec3::Z * cos_tilt - outward * sin_tilt,
            outward * cos_tilt + DVec3::Z * sin_tilt,
        );

        let east = self.widest(body, heights);
        let north = self.along(body, heights, -sin_tilt, cos_tilt);
        let up = self.along(body, heights, cos_tilt, sin_tilt);
        // Past a pole the ground is a cap around it, seen twice in case latitudes are converted.
        let ratio = body.a().0 / body.b().0;
        let cap = 2.0 * self.past_pole * ratio.powi(4) * (body.a().0 + heights[1].max(0.0));
        Extents {
            axes,
            min: DVec3::new(-east, north.0, up.0) - DVec3::splat(cap),
            max: DVec3::new(east, north.1, up.1) + DVec3::splat(cap),
        }
    }

    /// The greatest distance from the plane of the middle meridian.
    fn widest(&self, body: &Ellipsoid, heights: [f64; 2]) -> f64 {
        let latitude = if self.south <= 0.0 && self.north >= 0.0 {
            0.0
        } else {
            self.south.abs().min(self.north.abs())
        };
        let radius = meridian_point(body, latitude, heights[1]).0;
        if self.half_width < FRAC_PI_2 { radius * self.half_width.sin() } else { radius }
    }

    /// The least and greatest `x R cos δ + z Z`.
    fn along(&self, body: &Ellipsoid, heights: [f64; 2], x: f64, z: f64) -> (f64, f64) {
        let (mut least, mut greatest) = (f64::INFINITY, f64::NEG_INFINITY);
        for x in [x, x * self.half_width.cos()] {
            let (summit, foot) = (z.atan2(x), (-z).atan2(-x));
            for latitude in [self.south, self.north, summit, foot] {
                if !(self.south..=self.north).contains(&latitude) {
                    continue;
                }
                for height in heights {
                    let (radius, height_above_equator) = meridian_point(body, latitude, height);
                    let along = x * radius + z * height_above_equator;
                    (least, greatest) = (least.min(along), greatest.max(along));
                }
            }
        }
        (least, greatest)
    }
}

/// (R, Z): the point of the meridian at a latitude and a height.
fn meridian_point(body: &Ellipsoid, latitude: f64, height: f64) -> (f64, f64) {
    let position = Geographic { longitude: Radians(0.0), latitude: Radians(latitude) };
    let point = body.cartesian_from_geographic(position, Meters(height));
    (point.x, point.z)
}

impl Samples {
    /// The hull of the samples may miss the ground by this share of half the page's side.
    const SAG_SHARE: f64 = 0.01;
    /// The most steps of the lattice along a side.
    const MOST_STEPS: f64 = 5.0;

    fn new(grid: &Grid, map: &PolarStereographic, page: MapRectangle) -> Option<Self> {
        let crs = grid.crs();
        let center =
            MapPoint { x: page.left.midpoint(page.right), y: page.bottom.midpoint(page.top) };
        let pole = MapPoint { x: map.false_easting.0, y: map.false_northing.0 };
        let nearest = MapPoint {
            x: pole.x.clamp(page.left, page.right),
            y: pole.y.clamp(page.bottom, page.top),
        };
        let farthest = MapPoint {
            x: if center.x < pole.x { page.left } else { page.right },
            y: if center.y < pole.y { page.bottom } else { page.top },
        };
        let from_pole = |point: MapPoint| (point.x - pole.x).hypot(point.y - pole.y);

        // p″ of the sphere, and what flattening can add: a few factors of the axes' ratio, of the
        // body and of the surface the map is computed on.
        let unit = map.radius_at_pole(&crs.ellipsoid);
        let radius = crs.body.a().0;
        let ratio = |surface: &Ellipsoid| surface.a().0 / surface.b().0;
        let flattening = (ratio(&crs.body) * ratio(&crs.ellipsoid)).powi(6);
        let tau2 = (from_pole(nearest) / unit).powi(2);
        let second_derivative = flattening * 4.0 * radius / (unit * unit) * (1.0 + tau2).powf(-1.5);
        let scale = 2.0 * radius / (unit * (1.0 + (from_pole(center) / unit).powi(2)));
        let steps = |side: f64| {
            let wanted = side * second_derivative / (2.0 * Self::SAG_SHARE * scale);
            wanted.sqrt().ceil().clamp(1.0, Self::MOST_STEPS)
        };
        let (width, height) = (page.right - page.left, page.top - page.bottom);
        let (columns, rows) = (steps(width), steps(height));
        let sag = second_derivative / 8.0 * ((width / columns).powi(2) + (height / rows).powi(2));

        let normal = |x: f64, y: f64| Some(surface_normal(crs.unproject(MapPoint { x, y })?));
        let mut normals = Vec::new();
        let mut row = 0.0;
        while row <= rows {
            let mut column = 0.0;
            while column <= columns {
                let x = page.left + width * column / columns;
                normals.push(normal(x, page.bottom + height * row / rows)?);
                column += 1.0;
            }
            row += 1.0;
        }
        let up = normal(center.x, center.y)?;
        let eastmost = normal(page.right, center.y)?;
        let across = eastmost - up * up.dot(eastmost);

        let latitude = |point: MapPoint| Some(crs.unproject(point)?.latitude.0);
        let (one, other) = (latitude(nearest)?, latitude(farthest)?);
        let crosses_equator = one.signum() != other.signum();
        Some(Self {
            normals,
            up,
            right: across.try_normalize().unwrap_or_else(|| up.any_orthonormal_vector()),
            sag,
            lowest_latitude: if crosses_equator { 0.0 } else { one.abs().min(other.abs()) },
        })
    }

    fn extents(&self, body: &Ellipsoid, heights: [f64; 2]) -> Extents {
        let axes = DMat3::from_cols(self.right, self.up.cross(self.right), self.up);
        let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for &normal in &self.normals {
            let ground = ground_point(body, normal);
            for height in heights {
                let along = axes.transpose_mul_vec3(ground + height * normal);
                (min, max) = (min.min(along), max.max(along));
            }
        }
        // The shell above the ground is as curved as the ground, times its larger radius.
        let least_curvature_radius = body.b().0 * (body.b().0 / body.a().0);
        let sag = self.sag * (1.0 + heights[1].max(0.0) / least_curvature_radius);
        Extents { axes, min: min - DVec3::splat(sag), max: max + DVec3::splat(sag) }
    }
}

/// The point of the surface with this unit normal.
fn ground_point(body: &Ellipsoid, normal: DVec3) -> DVec3 {
    let n = body.prime_vertical_radius(normal.z);
    let flattened = (body.b().0 / body.a().0).powi(2);
    DVec3::new(n * normal.x, n * normal.y, n * flattened * normal.z)
}
