//! What of a map its sources show.

use std::f64::consts::FRAC_PI_2;

use areoid_formats::geodesy::Geographic;
use areoid_formats::grid::Placement;
use areoid_formats::projection::{Crs, Pole, Projection};
use areoid_formats::pyramid::PoleContact;
use areoid_formats::units::Radians;

/// A rectangle of a map; around the body where it is as wide as a turn.
#[derive(Clone, Copy, Debug)]
pub(super) struct Area {
    pub(super) left: f64,
    pub(super) right: f64,
    pub(super) bottom: f64,
    pub(super) top: f64,
}

/// Samples along an edge of an outline. Between two of them a rim of 10⁵ pixels bends by 10⁻² of
/// one.
const SAMPLES: u32 = 4096;

impl Area {
    pub(super) const NONE: Self = Self {
        left: f64::INFINITY,
        right: f64::NEG_INFINITY,
        bottom: f64::INFINITY,
        top: f64::NEG_INFINITY,
    };

    pub(super) fn is_empty(&self) -> bool {
        self.left > self.right || self.bottom > self.top
    }

    pub(super) fn with(self, other: Self) -> Self {
        Self {
            left: self.left.min(other.left),
            right: self.right.max(other.right),
            bottom: self.bottom.min(other.bottom),
            top: self.top.max(other.top),
        }
    }

    fn with_point(self, x: f64, y: f64) -> Self {
        self.with(Self { left: x, right: x, bottom: y, top: y })
    }

    /// What of the map of `crs` a source shows: from its rim, and the poles inside it.
    pub(super) fn of(source: &Placement, crs: &Crs) -> Self {
        if *crs == source.crs {
            let [left, top] = source.origin;
            let [width, height] = [
                f64::from(source.width) * source.pixel_size[0],
                f64::from(source.height) * source.pixel_size[1],
            ];
            return Self { left, right: left + width, bottom: top - height, top }.within_poles(crs);
        }
        let center = match &crs.projection {
            Projection::PolarStereographic(map) => Some(map.pole),
            _ => None,
        };
        let period = crs.wraps_with_period();
        let mut area = Self::NONE;
        let mut last_x: Option<f64> = None;
        for position in rim(source) {
            let Some(point) = crs.project(onto_hemisphere(position, center)) else { continue };
            let mut x = point.x;
            // Around the body from sample to sample, the shorter way.
            if let (Some(period), Some(last)) = (period, last_x) {
                x -= period * ((x - last) / period).round();
            }
            last_x = Some(x);
            area = area.with_point(x, point.y);
        }
        for pole in [Pole::North, Pole::South] {
            if !shows(source, pole) || center.is_some_and(|center| center != pole) {
                continue;
            }
            let latitude = Radians(pole.sign() * FRAC_PI_2);
            if let Some(point) = crs.project(Geographic { latitude, ..Geographic::default() }) {
                let x = if period.is_some() { area.left } else { point.x };
                area = area.with_point(x, point.y);
            }
            if let Some(period) = period {
                area.right = area.left + period;
            }
        }
        if let Some(period) = period.filter(|_| source.wraps) {
            area.right = area.left + period;
        }
        if center.is_some_and(|pole| !reaches_hemisphere(source, pole)) {
            return Self::NONE;
        }
        area
    }

    fn within_poles(self, crs: &Crs) -> Self {
        let top = crs.y_of_pole(Pole::North).map_or(self.top, |y| y.min(self.top));
        let bottom = crs.y_of_pole(Pole::South).map_or(self.bottom, |y| y.max(self.bottom));
        Self { top, bottom, ..self }
    }
}

/// Positions along the outline of a source, around it once. An outline past a pole or the end of
/// its map has none there.
fn rim(source: &Placement) -> impl Iterator<Item = Geographic> + '_ {
    let (right, bottom) = (f64::from(source.width) - 0.5, f64::from(source.height) - 0.5);
    let corners = [(-0.5, -0.5), (right, -0.5), (right, bottom), (-0.5, bottom), (-0.5, -0.5)];
    let sides = corners.into_iter().zip(corners.into_iter().skip(1));
    sides.flat_map(move |((u, v), (to_u, to_v))| {
        (0..SAMPLES).filter_map(move |at| {
            let share = f64::from(at) / f64::from(SAMPLES);
            let (u, v) = (u + (to_u - u) * share, v + (to_v - v) * share);
            let mut point = source.map_from_pixel(u, v);
            // Posts on a pole reach half a row past it.
            for pole in [Pole::North, Pole::South] {
                if let Some(y) = source.crs.y_of_pole(pole) {
                    point.y = pole.sign() * (pole.sign() * point.y).min(pole.sign() * y);
                }
            }
            source.crs.unproject(point)
        })
    })
}

/// A position, or that on the equator below it where it lies beyond.
fn onto_hemisphere(position: Geographic, center: Option<Pole>) -> Geographic {
    let Some(pole) = center else { return position };
    let latitude = pole.sign() * (pole.sign() * position.latitude.0).max(0.0);
    Geographic { latitude: Radians(latitude), ..position }
}

/// Whether any of the source is on the pole's side of the equator.
fn reaches_hemisphere(source: &Placement, pole: Pole) -> bool {
    shows(source, pole) || rim(source).any(|it| pole.sign() * it.latitude.0 > 1e-9)
}

/// Whether a pole lies in the outline of a source.
fn shows(source: &Placement, pole: Pole) -> bool {
    if source.crs.wraps_with_period().is_some() {
        let contact = if pole == Pole::North { source.north } else { source.south };
        return contact != PoleContact::None;
    }
    let latitude = Radians(pole.sign() * FRAC_PI_2);
    let Some(point) = source.crs.project(Geographic { latitude, ..Geographic::default() }) else {
        return false;
    };
    let (u, v) = source.pixel_from_map(point);
    (-0.5..=f64::from(source.width) - 0.5).contains(&u)
        && (-0.5..=f64::from(source.height) - 0.5).contains(&v)
}
