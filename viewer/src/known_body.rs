//! Which of the bodies that more is known of a catalog shows.

use areoid_formats::body::Ellipsoid;

/// A body with an atmosphere and a sun at a date.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum KnownBody {
    Earth,
    Mars,
}

/// Spheres that maps of the Earth are made on differ by a thousandth of its radius.
const WITHIN: f64 = 5e-3;

impl KnownBody {
    /// The body of this size.
    pub(crate) fn of(body: &Ellipsoid) -> Option<Self> {
        let is_near = |radius_m: f64| (body.a().0 / radius_m - 1.0).abs() < WITHIN;
        if is_near(Ellipsoid::WGS84.a().0) {
            Some(Self::Earth)
        } else if is_near(3_396_190.0) {
            Some(Self::Mars)
        } else {
            None
        }
    }
}
