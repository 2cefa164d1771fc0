//! A ray caster in f64: rays of a camera, marched to the composed heights of a catalog of Mars.

use areoid_formats::geodesy::Geographic;
use areoid_formats::query::HeightQuery;
use areoid_formats::units::Radians;
use glam::DVec3;

/// The sphere of the demo's data, in meters.
pub(crate) const MARS_RADIUS: f64 = 3_396_190.0;

/// No height of Mars is above this.
const HIGHEST: f64 = 24_000.0;

/// A camera of square pixels.
pub(crate) struct Camera {
    pub(crate) eye: DVec3,
    right: DVec3,
    up: DVec3,
    forward: DVec3,
    /// Pixels along a side.
    side: f64,
    /// Tangent to a pixel at the center.
    pub(crate) pixel_angle: f64,
}

/// Where a ray meets the surface.
pub(crate) struct Hit {
    pub(crate) point: DVec3,
    pub(crate) height: f64,
}

fn point([longitude, latitude, height]: [f64; 3]) -> DVec3 {
    let (sin, cos) = latitude.to_radians().sin_cos();
    let longitude = longitude.to_radians();
    let normal = DVec3::new(cos * longitude.cos(), cos * longitude.sin(), sin);
    normal * (MARS_RADIUS + height)
}

impl Camera {
    /// At `eye`, looking at `target` (degrees, meters), the zenith up; straight down, north up.
    pub(crate) fn new(eye: [f64; 3], target: [f64; 3], fov_deg: f64, side: usize) -> Self {
        let at = point(eye);
        let forward = (point(target) - at).normalize();
        let (sin, cos) = eye[0].to_radians().sin_cos();
        let north = DVec3::new(
            -eye[1].to_radians().sin() * cos,
            -eye[1].to_radians().sin() * sin,
            eye[1].to_radians().cos(),
        );
        let zenith = at.normalize();
        let straight = forward.cross(zenith).length() < 1e-6;
        let right = forward.cross(if straight { north } else { zenith }).normalize();
        let up = right.cross(forward);
        let side = side as f64;
        let pixel_angle = 2.0 * (fov_deg.to_radians() / 2.0).tan() / side;
        Self { eye: at, right, up, forward, side, pixel_angle }
    }

    /// The direction through the center of a pixel.
    pub(crate) fn ray(&self, row: usize, col: usize) -> DVec3 {
        let x = (col as f64 + 0.5 - self.side / 2.0) * self.pixel_angle;
        let y = (self.side / 2.0 - row as f64 - 0.5) * self.pixel_angle;
        (self.forward + x * self.right + y * self.up).normalize()
    }
}

/// How far `at` is above the composed surface, and the surface's height there.
fn above(query: &mut HeightQuery<'_>, at: DVec3) -> (f64, f64) {
    let radius = at.length();
    let position = Geographic {
        longitude: Radians(at.y.atan2(at.x)),
        latitude: Radians((at.z / radius).clamp(-1.0, 1.0).asin()),
    };
    let height = query.height(position).unwrap().unwrap().height_m;
    (radius - MARS_RADIUS - height, height)
}

/// Marches a ray from above the highest mountain down in steps of 400 m, then halves the last.
pub(crate) fn cast(query: &mut HeightQuery<'_>, eye: DVec3, ray: DVec3) -> Option<Hit> {
    let shell = |radius: f64| {
        let along = -eye.dot(ray);
        let nearest = eye.length_squared() - along * along;
        let half = (radius * radius - nearest).max(0.0).sqrt();
        (nearest < radius * radius).then_some((along - half, along + half))
    };
    let (start, end) = shell(MARS_RADIUS + HIGHEST)?;
    let mut low = start.max(0.0);
    let mut high = low;
    loop {
        let (clear, _) = above(query, eye + high * ray);
        if clear <= 0.0 {
            break;
        }
        low = high;
        // A surface no steeper than 45° is not reached sooner than this.
        high += (clear * 0.5).max(400.0);
        if high > end {
            return None;
        }
    }
    for _ in 0..40 {
        let middle = low.midpoint(high);
        if above(query, eye + middle * ray).0 > 0.0 { low = middle } else { high = middle }
    }
    let at = eye + high * ray;
    let (_, height) = above(query, at);
    Some(Hit { point: at, height })
}
