//! The source's row as a function of the distance from the pole: V(ρ), by polynomials that are
//! certified before they are used.
//!
//! With the conformal latitude χ, `tan(π/4 - χ/2) = ρ / C` exactly, and the latitude on the
//! source's map is χ plus an odd function of period π: it holds the ellipsoid, and every change
//! between kinds of latitude. So, with k rows to a radian,
//!
//! ```text
//! V = v₀ ± k (χ + g(χ))      g(χ) = Σ cⱼ sin 2jχ      C = the equator's ρ
//! ```
//!
//! # Precision
//!
//! Interpolation in n Chebyshev nodes on an interval of half width h leaves
//!
//! * of χ = π/2 - 2 atan(ρ/C), as |dᵐ atan| ≤ (m - 1)!: at most k (h/C)ⁿ / (n 2ⁿ⁻²) rows;
//! * of g at most 4 M k ϱ¹⁻ⁿ / (ϱ - 1), with M a bound of |g| on the ellipse of foci ρₜ ± h whose
//!   axes add up to 2ϱh. It lies in the disc |ρ - ρₜ| ≤ C/2 if ϱ + 1/ϱ ≤ C/h. There |Im χ| ≤ ln 3,
//!   and |g| ≤ Σ |cⱼ| cosh(2j ln 3).
//!
//! The cⱼ are found from g at 15 latitudes. They must fall fast enough that those left away count
//! for less than those found, or nothing is certified: surfaces flatter than any planet are left to
//! the exact way.
//!
//! # References
//!
//! * L. N. Trefethen, *Approximation Theory and Approximation Practice*, 2013, theorem 8.2.
//! * J. P. Snyder, *Map Projections: A Working Manual*, 1987, section 3: series of latitudes.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

use areoid_formats::geodesy::Geographic;
use areoid_formats::projection::{MapPoint, PolarStereographic, Pole};

use super::exact::Pair;

/// V(ρ) of one target and source.
#[derive(Debug)]
pub(super) struct Radial {
    lines: Lines,
    /// C, in columns of the target.
    scale: f64,
    /// k: rows of the source to a radian.
    rows_per_radian: f64,
    /// M, if it was found.
    deviation: Option<f64>,
    /// What a polynomial may leave away, in rows.
    tolerance: f64,
}

/// What of target and source decides rows.
#[derive(Debug)]
struct Lines {
    map: PolarStereographic,
    pixel_x: f64,
}

/// V on an interval of radii.
#[derive(Debug)]
pub(super) struct Polynomial {
    /// The interval's middle, and 1 to its half width.
    pub(super) middle: f64,
    pub(super) per_half: f64,
    coefficients: [f64; Self::LONG],
    count: usize,
}

/// Latitudes at which g is sampled: π/2 · j/16.
const SAMPLES: usize = 16;
/// Its coefficients that stand above the rounding of what they are found from.
const TERMS: usize = 8;

impl Radial {
    pub(super) fn new(pair: &Pair, map: &PolarStereographic, tolerance: f64) -> Self {
        let source = &pair.source;
        let pixel_x = pair.target.pixel_size[0];
        let ends = [Pole::North, Pole::South]
            .map(|pole| source.crs.y_of_pole(pole).expect("the source draws poles as lines"));
        let mut made = Self {
            lines: Lines { map: *map, pixel_x },
            scale: radius_of_equator(pair, map) / pixel_x,
            rows_per_radian: (ends[0] - ends[1]) / PI / source.pixel_size[1],
            deviation: None,
            tolerance,
        };
        let equator = (source.origin[1] - ends[0].midpoint(ends[1])) / source.pixel_size[1] - 0.5;
        made.deviation = made.bound_of_deviation(pair, equator);
        made
    }

    /// V itself, through the body; `None` past the end of the target's map.
    pub(super) fn row(&self, pair: &Pair, radius: f64) -> Option<f64> {
        let map = &self.lines.map;
        let east = MapPoint {
            x: map.false_easting.0 + radius * self.lines.pixel_x,
            y: map.false_northing.0,
        };
        let latitude = pair.target.crs.unproject(east)?.latitude;
        let shown = pair.source.crs.project(Geographic { latitude, ..Geographic::default() })?;
        Some(pair.source.pixel_from_map(shown).1)
    }

    /// A row past those of the pole that the target's map cannot show.
    pub(super) fn far_row(&self) -> f64 {
        self.lines.map.pole.sign() * f64::INFINITY
    }

    /// V within `half` of `middle`, columns of the target, to the tolerance.
    pub(super) fn fit(&self, pair: &Pair, middle: f64, half: f64) -> Option<Polynomial> {
        // A tile of one texel has no width; no interval reaches past the pole, where V turns.
        let half = half.max(0.5_f64.min(middle / 4.0));
        let count = [Polynomial::SHORT, Polynomial::LONG]
            .into_iter()
            .find(|&count| self.bound(half, count).is_some_and(|rows| rows <= self.tolerance))?;
        let mut nodes = [0.0; Polynomial::LONG];
        let mut rows = [0.0; Polynomial::LONG];
        for at in 0..count {
            nodes[at] = libm::cos(PI * (2 * at + 1) as f64 / (2 * count) as f64);
            rows[at] = self.row(pair, middle + half * nodes[at])?;
        }
        let coefficients = coefficients(&nodes[..count], rows);
        Some(Polynomial { middle, per_half: 1.0 / half, coefficients, count })
    }

    /// The most that interpolation in `count` nodes leaves, in rows.
    fn bound(&self, half: f64, count: usize) -> Option<f64> {
        let (ratio, n) = (self.scale / half, count as f64);
        let power = i32::try_from(count).expect("a polynomial is short");
        let angle = self.rows_per_radian * ratio.powi(-power) / (n * 2.0_f64.powi(power - 2));
        let rho = (ratio + (ratio * ratio - 4.0).sqrt()) / 2.0;
        let deviation = 4.0 * self.deviation? * self.rows_per_radian * rho.powi(1 - power);
        // NaN where C is less than the interval.
        let bound = angle + deviation / (rho - 1.0);
        bound.is_finite().then_some(bound)
    }

    /// M, twice what the coefficients found amount to; `None` if they do not fall.
    fn bound_of_deviation(&self, pair: &Pair, equator: f64) -> Option<f64> {
        let mut samples = [0.0; SAMPLES];
        for (at, sample) in samples.iter_mut().enumerate().skip(1) {
            let conformal = FRAC_PI_2 * at as f64 / SAMPLES as f64;
            let radius = self.scale * libm::tan(FRAC_PI_4 - conformal / 2.0);
            let latitude = (equator - self.row(pair, radius)?) / self.rows_per_radian;
            *sample = self.lines.map.pole.sign() * latitude - conformal;
        }
        let mut terms = [0.0; TERMS];
        for (at, term) in (1..).zip(&mut terms) {
            let waves = (1..SAMPLES).map(|sample| {
                samples[sample] * libm::sin(PI * (at * sample) as f64 / SAMPLES as f64)
            });
            let coefficient = 2.0 / SAMPLES as f64 * waves.sum::<f64>();
            *term = coefficient.abs() * libm::cosh(2.0 * at as f64 * libm::log(3.0_f64));
        }
        let all: f64 = terms.iter().sum();
        let last: f64 = terms[TERMS - 3..].iter().sum();
        (last <= all / 4.0 || all < 1e-6).then_some(2.0 * all)
    }
}

impl Polynomial {
    /// Coefficients where C is large against a tile.
    pub(super) const SHORT: usize = 6;
    /// Coefficients where it is not.
    pub(super) const LONG: usize = 10;

    pub(super) fn is_short(&self) -> bool {
        self.count == Self::SHORT
    }

    /// The coefficients of powers of the place in the interval, from -1 to 1.
    pub(super) fn coefficients<const N: usize>(&self) -> [f64; N] {
        std::array::from_fn(|at| self.coefficients[at])
    }
}

/// Map meters from the pole to the equator, where every kind of latitude is 0: C.
fn radius_of_equator(pair: &Pair, map: &PolarStereographic) -> f64 {
    let equator = Geographic { longitude: map.central_meridian, ..Geographic::default() };
    let shown = pair.target.crs.project(equator).expect("polar maps reach past the equator");
    (shown.y - map.false_northing.0).abs()
}

/// The coefficients of the polynomial through `values` at `nodes`, by Newton's divided differences.
fn coefficients(nodes: &[f64], values: [f64; Polynomial::LONG]) -> [f64; Polynomial::LONG] {
    let count = nodes.len();
    let mut differences = values;
    for order in 1..count {
        for at in (order..count).rev() {
            differences[at] =
                (differences[at] - differences[at - 1]) / (nodes[at] - nodes[at - order]);
        }
    }
    let mut powers = [0.0; Polynomial::LONG];
    for at in (0..count).rev() {
        // Times (x - node), plus the next difference.
        for power in (0..count).rev() {
            let below = if power == 0 { differences[at] } else { powers[power - 1] };
            powers[power] = below - powers[power] * nodes[at];
        }
    }
    powers
}
