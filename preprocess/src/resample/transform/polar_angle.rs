//! A source of straight meridians seen from a polar map.
//!
//! With x and y a texel's place east and south of the pole, its column follows from the angle
//! λ = atan2(x, y) and its row from the radius ρ = √(x² + y²) alone. In the frame of the tile's
//! middle, which lies in the direction λₜ,
//!
//! ```text
//! q = across / along      λ = λₜ + atan q = λₜ + q - q³/3 + q⁵/5 - …      v = V(ρ)
//! ```
//!
//! so that columns are continuous over a tile wherever it lies, and no branch of an arc tangent
//! shows.
//!
//! # Precision
//!
//! A tile of half diagonal h at ρₜ has |q| ≤ h / (ρₜ - h). Where that is at most ¼ the series
//! alternates and falls, so n terms leave less than q²ⁿ⁺¹/(2n + 1) radians. Each of both parts
//! keeps to 2⁻²¹ source pixels, or the tile is left to the exact way. (Measured over polar maps of
//! 8192² texels: 6·10⁻⁷ pixels.)

use areoid_formats::lanes::{Wide, vectorized};
use areoid_formats::projection::PolarStereographic;

use super::exact::Pair;
use super::radial::{Polynomial, Radial};
use crate::resample::tile::{Coords, TILE, TargetTile};

/// What each of the two series may leave away, in source pixels.
const EACH_PX: f64 = 1.0 / (1_u64 << 21) as f64;

/// What both together do.
pub(super) const TRUNCATION_PX: f64 = EACH_PX * std::f64::consts::SQRT_2;

/// The steepest quotient that the series takes.
const MOST_QUOTIENT: f64 = 0.25;

/// A polar target over a source of straight meridians.
#[derive(Debug)]
pub(super) struct PolarAngle {
    /// The target's column and row of the pole.
    pole: [f64; 2],
    /// Southward, in columns, to a row.
    south_per_row: f64,
    /// The source's column of the direction λ = 0, and its columns to a radian.
    start: f64,
    per_radian: f64,
    radial: Radial,
}

/// Where a rectangle lies about the pole, in columns of the target.
struct Place {
    /// Least and greatest place east.
    east: [f64; 2],
    /// Least and greatest place south.
    south: [f64; 2],
    /// Its middle.
    middle: [f64; 2],
    /// From the pole to its middle, and from there to a corner.
    radius: f64,
    half: f64,
}

impl PolarAngle {
    pub(super) fn new(pair: &Pair, map: &PolarStereographic) -> Self {
        let (target, source) = (&pair.target, &pair.source);
        let [pixel_x, pixel_y] = target.pixel_size;
        let pole = [
            (map.false_easting.0 - target.origin[0]) / pixel_x - 0.5,
            (target.origin[1] - map.false_northing.0) / pixel_y - 0.5,
        ];
        let south_per_row = map.pole.sign() * pixel_y / pixel_x;
        // Some place straight south of the pole.
        let start = pair.exact(pole[1] + 1.0 / south_per_row, pole[0]).map_or(0.0, |(u, _)| u);
        let per_radian = source.period_px().unwrap_or(0.0) / std::f64::consts::TAU;
        let radial = Radial::new(pair, map, EACH_PX);
        Self { pole, south_per_row, start, per_radian, radial }
    }

    fn place(&self, pair: &Pair, tile: TargetTile) -> Place {
        let height = i64::from(pair.target.height);
        let ends = |first: i64, count: usize| [first, first + count as i64 - 1];
        let east =
            ends(tile.col, tile.cols).map(|col| pair.extended_col(col) as f64 - self.pole[0]);
        let [one, other] = ends(tile.row, tile.rows)
            .map(|row| (row.clamp(0, height - 1) as f64 - self.pole[1]) * self.south_per_row);
        let south = [one.min(other), one.max(other)];
        let middle = [east, south].map(|[low, high]| low.midpoint(high));
        let half = libm::hypot((east[1] - east[0]) / 2.0, (south[1] - south[0]) / 2.0);
        Place { east, south, middle, radius: libm::hypot(middle[0], middle[1]), half }
    }

    /// Whether a tile is so near the pole that it sees many columns.
    pub(super) fn sees_the_pole(&self, pair: &Pair, tile: TargetTile) -> bool {
        self.place(pair, tile).quotient().is_none()
    }

    /// The source's column of direction λ, in the turn nearest the middle of the raster.
    fn column(&self, pair: &Pair, direction: f64) -> f64 {
        pair.source.nearest_turn(self.start + self.per_radian * direction)
    }

    /// All texels of a tile by series, or nothing if they are not exact enough.
    pub(super) fn fill(&self, pair: &Pair, tile: TargetTile, out: &mut Coords) -> bool {
        let place = self.place(pair, tile);
        let Some(quotient) = place.quotient() else { return false };
        let least = |terms: i32| {
            let left = quotient.powi(2 * terms + 1) / f64::from(2 * terms + 1);
            self.per_radian * left <= EACH_PX
        };
        let Some(polynomial) = self.radial.fit(pair, place.radius, place.half) else {
            return false;
        };

        let (mut east, mut south) = ([0.0; TILE], [0.0; TILE]);
        for (at, east) in (tile.col..).zip(&mut east[..tile.cols]) {
            *east = pair.extended_col(at) as f64 - self.pole[0];
        }
        let height = i64::from(pair.target.height);
        for (at, south) in (tile.row..).zip(&mut south[..tile.rows]) {
            *south = (at.clamp(0, height - 1) as f64 - self.pole[1]) * self.south_per_row;
        }
        let [x, y] = place.middle;
        let direction = libm::atan2(x, y);
        let texels = Texels {
            east: &east[..tile.cols],
            south: &south[..tile.rows],
            direction: [x / place.radius, y / place.radius],
            column: self.column(pair, direction),
            per_radian: self.per_radian,
            polynomial: &polynomial,
            out,
        };
        match () {
            () if least(3) => texels.run_with::<3>(),
            () if least(5) => texels.run_with::<5>(),
            () if least(8) => texels.run_with::<8>(),
            () => return false,
        }
        out.range = self.range(pair, tile);
        true
    }

    /// A rectangle about the positions of a rectangle of texels: the directions of its corners, and
    /// the radii of its nearest and farthest place.
    pub(super) fn range(&self, pair: &Pair, tile: TargetTile) -> [f64; 4] {
        const SLACK_PX: f64 = 1.0 / 1024.0;
        let Place { east, south, middle: [x, y], radius, .. } = self.place(pair, tile);
        let nearest = |[low, high]: [f64; 2]| 0.0_f64.clamp(low, high);
        let farthest = |[low, high]: [f64; 2]| low.abs().max(high.abs());
        let near = libm::hypot(nearest(east), nearest(south));
        let far = libm::hypot(farthest(east), farthest(south));
        // What the target's map does not show is past its far end.
        let end = self.radial.far_row();
        let rows = [near, far].map(|radius| self.radial.row(pair, radius).unwrap_or(end));
        let [top, bottom] = [rows[0].min(rows[1]), rows[0].max(rows[1])];

        let (left, right) = if near == 0.0 {
            let middle = (f64::from(pair.source.width) - 1.0) / 2.0;
            let half = pair.source.period_px().unwrap_or(0.0) / 2.0;
            (middle - half, middle + half)
        } else {
            let column = self.column(pair, libm::atan2(x, y));
            let (sine, cosine) = (x / radius, y / radius);
            let corners = [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(i, j)| {
                let (x, y) = (east[i], south[j]);
                libm::atan2(x * cosine - y * sine, x * sine + y * cosine)
            });
            let least = corners.into_iter().fold(f64::INFINITY, f64::min);
            let most = corners.into_iter().fold(f64::NEG_INFINITY, f64::max);
            (column + self.per_radian * least, column + self.per_radian * most)
        };
        [left - SLACK_PX, right + SLACK_PX, top - SLACK_PX, bottom + SLACK_PX]
    }
}

impl Place {
    /// The steepest quotient of the rectangle, if the series takes it.
    fn quotient(&self) -> Option<f64> {
        let nearest = self.radius - self.half;
        let quotient = self.half / nearest;
        (nearest > 0.0 && quotient <= MOST_QUOTIENT).then_some(quotient)
    }
}

/// The texels of a tile.
struct Texels<'a> {
    east: &'a [f64],
    south: &'a [f64],
    /// Sine and cosine of the direction of the tile's middle.
    direction: [f64; 2],
    /// Its column, and columns to a radian.
    column: f64,
    per_radian: f64,
    polynomial: &'a Polynomial,
    out: &'a mut Coords,
}

impl Texels<'_> {
    fn run_with<const TERMS: usize>(self) {
        let few = self.polynomial.is_short();
        if few {
            vectorized(Series::<TERMS, { Polynomial::SHORT }>(self));
        } else {
            vectorized(Series::<TERMS, { Polynomial::LONG }>(self));
        }
    }
}

/// The loop for a number of terms of the arc tangent and of coefficients of V.
struct Series<'a, const TERMS: usize, const COEFFICIENTS: usize>(Texels<'a>);

impl<const TERMS: usize, const COEFFICIENTS: usize> Wide for Series<'_, TERMS, COEFFICIENTS> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Texels { east, south, direction: [sine, cosine], column, per_radian, polynomial, out } =
            self.0;
        let coefficients: [f64; COEFFICIENTS] = polynomial.coefficients();
        let (middle, per_half) = (polynomial.middle, polynomial.per_half);
        let rows = out.u.chunks_exact_mut(east.len()).zip(out.v.chunks_exact_mut(east.len()));
        for ((u, v), &y) in rows.zip(south) {
            let (y_along, y_across) = (y * cosine, y * sine);
            for ((u, v), &x) in u.iter_mut().zip(v).zip(east) {
                let place = ((x * x + y * y).sqrt() - middle) * per_half;
                let mut row = coefficients[COEFFICIENTS - 1];
                for at in (0..COEFFICIENTS - 1).rev() {
                    row = row * place + coefficients[at];
                }
                *v = row;

                let quotient = (x * cosine - y_across) / (x * sine + y_along);
                let square = quotient * quotient;
                let mut sum = 1.0 / (2 * TERMS - 1) as f64;
                for at in (0..TERMS - 1).rev() {
                    sum = 1.0 / (2 * at + 1) as f64 - square * sum;
                }
                *u = column + per_radian * (quotient * sum);
            }
        }
    }
}
