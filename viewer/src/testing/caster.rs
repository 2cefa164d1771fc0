//! An f64 ray caster of the composed surface at its finest level: what a picture is held against.

use areoid_cache::View;
use areoid_formats::body::Ellipsoid;
use areoid_formats::geodesy::Geographic;
use areoid_formats::page::Kind;
use glam::{DVec2, DVec3};

use crate::camera::pixel_angle;
use crate::surface::Surface;

/// Casts rays of a view; pixels are told by their distance from the upper left corner.
pub(crate) struct Caster<'a> {
    pub(crate) view: &'a View,
    pub(crate) body: Ellipsoid,
    pub(crate) surface: &'a Surface,
    pub(crate) exaggeration: f64,
}

/// The middle of a pixel.
pub(crate) fn middle(x: u32, y: u32) -> DVec2 {
    DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5)
}

/// Meters to a ray's end that meets nothing.
pub(crate) const SKY: f64 = f64::INFINITY;

impl Caster<'_> {
    /// The unit vector through a place of the picture.
    pub(crate) fn direction(&self, pixel: DVec2) -> DVec3 {
        let [width, height] = self.view.viewport.map(f64::from);
        let tangent = (self.view.vertical_fov.0 / 2.0).tan();
        let right = (2.0 * pixel.x / width - 1.0) * tangent * width / height;
        let up = (1.0 - 2.0 * pixel.y / height) * tangent;
        (self.view.orientation * DVec3::new(right, up, -1.0)).normalize()
    }

    /// Meters above the terrain along a ray.
    fn above(&self, direction: DVec3, distance_m: f64) -> f64 {
        let point = self.view.eye + distance_m * direction;
        let (place, altitude) = self.body.geographic_from_cartesian(point);
        altitude.0 - self.exaggeration * ground_m(self.surface, place)
    }

    /// Meters along the ray of a place of the picture to the surface, or [`SKY`].
    pub(crate) fn cast(&self, pixel: DVec2) -> f64 {
        /// Steps for each meter above the terrain, which is nowhere steeper as it is, and in pixels at least.
        const STEP: f64 = 0.4;
        const LEAST_PX: f64 = 0.4;

        let direction = self.direction(pixel);
        let outer = self.body.a().0 + self.exaggeration * self.surface.height_range_m().1 + 1.0;
        let step = STEP / self.exaggeration.max(1.0);
        let eye = self.view.eye;
        let middle = -eye.dot(direction);
        let half = (outer * outer - (eye + middle * direction).length_squared()).sqrt();
        if half.is_nan() || middle + half < 0.0 {
            return SKY;
        }
        let (mut near, end) = ((middle - half).max(0.0), middle + half);
        let mut above = self.above(direction, near);
        while near < end {
            let far = near + (step * above).max(LEAST_PX * near * pixel_angle(self.view));
            let next = self.above(direction, far);
            if next < 0.0 {
                let (mut low, mut high) = (near, far);
                for _ in 0..50 {
                    let half = low.midpoint(high);
                    if self.above(direction, half) < 0.0 { high = half } else { low = half }
                }
                return high;
            }
            (near, above) = (far, next);
        }
        SKY
    }

    /// How many pixels a pixel is off that shows something `shown_m` meters away, or [`SKY`]: the
    /// least of its distance from the true surface along its ray, in pixels' widths there, and of the
    /// way to a place of the picture beyond which the truth is on the other side of it.
    pub(crate) fn error_px(&self, pixel: DVec2, shown_m: f64) -> f64 {
        /// Not looked at farther away.
        const FARTHEST: [f64; 8] = [0.1, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, 4.0];

        let truth_m = self.cast(pixel);
        if shown_m == truth_m {
            return 0.0;
        }
        let along = (shown_m - truth_m).abs() / (shown_m.min(truth_m) * pixel_angle(self.view));
        for radius in FARTHEST {
            if along <= radius {
                return along;
            }
            for turn in 0..8 {
                let step = DVec2::from_angle(f64::from(turn) * std::f64::consts::FRAC_PI_4);
                let around_m = self.cast(pixel + radius * step);
                if (around_m - shown_m).signum() != (truth_m - shown_m).signum() {
                    return radius;
                }
            }
        }
        along
    }
}

/// Meters to the ground at a place, 0 where there is none.
pub(crate) fn ground_m(surface: &Surface, place: Geographic) -> f64 {
    surface.compose(Kind::Height, place, 0.0).map_or(0.0, |found| found.value[0])
}

/// The least value that so much of the values is at most.
pub(crate) fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * share).ceil() as usize]
}
