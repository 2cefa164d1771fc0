//! How far apart on the ground the points of a map are.
//!
//! The ground is the body's surface: `dE = N cos φ dλ` and `dN = M dφ` with the radii of curvature
//! N and M. A map of planetocentric latitudes adds the factor `dφ / dφc`.
//!
//! # References
//!
//! J. P. Snyder, *Map Projections: A Working Manual*, USGS Professional Paper 1395, 1987,
//! section 4: scale factors on the ellipsoid.

use super::{Crs, PolarStereographic, Projection};
use crate::geodesy::{Geographic, sin_cos_of_latitude};

impl Crs {
    /// Ground meters east and north per map unit of x and y: `[[∂E/∂x, ∂E/∂y], [∂N/∂x, ∂N/∂y]]`.
    ///
    /// # Domain
    ///
    /// That of [`Self::project`]; NaN outside. At a pole, east and north are those of the
    /// position's own meridian. There a map that draws the pole as a line has ∂E/∂x = 0.
    ///
    /// # Precision
    ///
    /// A few rounding errors of the largest entry.
    #[must_use]
    pub fn ground_jacobian(&self, position: Geographic) -> [[f64; 2]; 2] {
        const NONE: [[f64; 2]; 2] = [[f64::NAN; 2]; 2];
        let Some(map_latitude) = self.map_latitude(position.latitude) else { return NONE };

        let (sine, cosine) = sin_cos_of_latitude(position.latitude);
        let n = self.body.prime_vertical_radius(sine);
        // Along the meridian, to a radian of the map's latitude.
        let m = self.body.meridian_radius(sine) * self.graphic_per_map_latitude(sine, cosine);
        match &self.projection {
            Projection::Geographic => {
                let radians_per_degree = 1f64.to_radians();
                [[n * cosine * radians_per_degree, 0.0], [0.0, m * radians_per_degree]]
            }
            Projection::Equirectangular(map) => {
                let per_longitude = map.meters_per_radian_of_longitude(&self.ellipsoid);
                [[n * cosine / per_longitude, 0.0], [0.0, m / self.ellipsoid.a().0]]
            }
            Projection::PolarStereographic(map) => {
                let Some(theta) = map.colatitude(map_latitude) else { return NONE };
                let east = n * self.sine_per_map_sine(sine, cosine);
                self.polar_jacobian(map, theta, position, east, m)
            }
        }
    }

    /// The largest and smallest ground meters of a step on the map, over all directions, for
    /// pixels of `pixel_size` map units: the singular values of the scaled Jacobian.
    ///
    /// # Domain
    ///
    /// That of [`Self::ground_jacobian`]; NaN outside.
    #[must_use]
    pub fn principal_scales(&self, position: Geographic, pixel_size: [f64; 2]) -> (f64, f64) {
        let [[ex, ey], [nx, ny]] = self.ground_jacobian(position);
        let [width, height] = pixel_size;
        let (ex, ey, nx, ny) = (ex * width, ey * height, nx * width, ny * height);
        let largest = (libm::hypot(ex + ny, ey - nx) + libm::hypot(ex - ny, ey + nx)) / 2.0;
        // By the determinant: the difference of the two square roots would cancel.
        let smallest = if largest == 0.0 { 0.0 } else { (ex * ny - ey * nx).abs() / largest };
        (largest, smallest)
    }

    /// The Jacobian of a polar map, from ground meters `east` to a unit of sin θ·dλ and `north` to
    /// a radian of the map's latitude.
    fn polar_jacobian(
        &self,
        map: &PolarStereographic,
        theta: f64,
        position: Geographic,
        east: f64,
        north: f64,
    ) -> [[f64; 2]; 2] {
        let sign = map.pole.sign();
        let (sine, cosine) = libm::sincos(position.longitude.0 - map.central_meridian.0);
        let radius_per_sine = map.radius_per_sine(&self.ellipsoid, theta);

        // Conformality: dρ/dθ = (ρ / sin θ) M / N.
        let e2 = self.ellipsoid.eccentricity_squared();
        let curvatures = (1.0 - e2) / (1.0 - e2 * libm::cos(theta).powi(2));
        let along_parallel = east / radius_per_sine;
        let along_meridian = north / (radius_per_sine * curvatures);

        // Eastward is (cos, ± sin) on the map, away from the pole (sin, ∓ cos).
        [
            [along_parallel * cosine, along_parallel * sign * sine],
            [-sign * along_meridian * sine, along_meridian * cosine],
        ]
    }

    /// (a / b)² of the body where latitudes are converted, or 1.
    fn latitude_ratio(&self) -> f64 {
        if self.converts_latitudes() { (self.body.a().0 / self.body.b().0).powi(2) } else { 1.0 }
    }

    /// dφ / dφc = (q² cos² φ + sin² φ) / q, with q = (a / b)².
    fn graphic_per_map_latitude(&self, sine: f64, cosine: f64) -> f64 {
        let q = self.latitude_ratio();
        ((q * cosine).powi(2) + sine * sine) / q
    }

    /// cos φ / cos φc = √(cos² φ + sin² φ / q²), with q = (a / b)²: finite at the pole.
    fn sine_per_map_sine(&self, sine: f64, cosine: f64) -> f64 {
        libm::hypot(cosine, sine / self.latitude_ratio())
    }
}
