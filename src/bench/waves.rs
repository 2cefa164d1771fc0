//! A field whose value is known everywhere: plane waves through space, seen on the sphere.
//!
//! ```text
//!   f(p) = A Σ cos(k dᵢ·p + φᵢ)      p on the unit sphere, dᵢ spread over it, k = 2π / wavelength
//! ```
//!
//! Along the ground a wave is nowhere shorter than its wavelength, and nothing is sampled twice. With each
//! direction come those a quarter, a half and three quarters of a turn about the axis from it.
//! Positions are closed forms of the maps written down here, none of the program's own.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use super::geotiff::Place;

/// Directions of a field within a quarter of a turn, and waves in all.
const DIRECTIONS: u32 = 12;
const WAVES: u32 = 4 * DIRECTIONS;

/// The root of the mean square of a field, in meters.
pub(super) const STRENGTH_M: f64 = 1000.0;

/// Plane waves of one wavelength.
#[derive(Clone, Debug)]
pub(super) struct Waves {
    /// Direction times wave number, and phase.
    waves: Vec<([f64; 3], f64)>,
}

impl Waves {
    /// Waves so long on a sphere of radius 1.
    pub(super) fn new(wavelength: f64) -> Self {
        // A spiral over the sphere, and phases that do not repeat.
        let golden = (5.0_f64.sqrt() - 1.0) / 2.0;
        let wave = |at: u32| {
            let (step, quarter) = (f64::from(at / 4), f64::from(at % 4));
            let z = 1.0 - (2.0 * step + 1.0) / f64::from(DIRECTIONS);
            let around = TAU * golden * step + 0.7 + FRAC_PI_2 * quarter;
            let across = (1.0 - z * z).sqrt();
            let direction = [across * around.cos(), across * around.sin(), z];
            (
                direction.map(|part| part * TAU / wavelength),
                TAU * (golden * f64::from(at * at)).fract(),
            )
        };
        Self { waves: (0..WAVES).map(wave).collect() }
    }

    /// The field a quarter of a turn east of this.
    pub(super) fn turned(&self) -> Self {
        let turned = |&([x, y, z], phase): &([f64; 3], f64)| ([-y, x, z], phase);
        Self { waves: self.waves.iter().map(turned).collect() }
    }

    /// The field at a place on the sphere, in meters.
    pub(super) fn at(&self, [x, y, z]: [f64; 3]) -> f64 {
        let waves = self.waves.iter();
        let sum: f64 = waves.map(|([a, b, c], phase)| (a * x + b * y + c * z + phase).cos()).sum();
        STRENGTH_M * (2.0 / f64::from(WAVES)).sqrt() * sum
    }
}

/// A place on the sphere.
#[derive(Clone, Copy, Debug)]
pub(super) struct Position {
    /// Radians, from -π to π.
    pub(super) longitude: f64,
    /// Radians.
    pub(super) latitude: f64,
}

impl Position {
    /// The same as a unit vector.
    pub(super) fn vector(self) -> [f64; 3] {
        let (sine, cosine) = self.latitude.sin_cos();
        [cosine * self.longitude.cos(), cosine * self.longitude.sin(), sine]
    }
}

impl Place {
    /// What the center of a pixel shows on a raster of that size.
    pub(super) fn position(self, size: (u32, u32), row: u32, col: u32) -> Position {
        let (right, down) = (f64::from(col) + 0.5, f64::from(row) + 0.5);
        let (width, height) = (f64::from(size.0), f64::from(size.1));
        match self {
            Self::Globe => Position {
                longitude: TAU * right / width - PI,
                latitude: FRAC_PI_2 - PI * down / height,
            },
            Self::Half => Position {
                longitude: TAU * right / width - PI,
                latitude: FRAC_PI_2 - FRAC_PI_2 * down / height,
            },
            Self::North { radius_px } => {
                let (east, south) = (right - width / 2.0, down - height / 2.0);
                let radius = east.hypot(south) / f64::from(radius_px);
                Position { longitude: east.atan2(south), latitude: FRAC_PI_2 - 2.0 * radius.atan() }
            }
        }
    }

    /// A pixel on the sphere of radius 1 where it is largest.
    pub(super) fn pixel_rad(self, (width, _): (u32, u32)) -> f64 {
        match self {
            Self::Globe | Self::Half => TAU / f64::from(width),
            Self::North { radius_px } => 2.0 / f64::from(radius_px),
        }
    }
}
