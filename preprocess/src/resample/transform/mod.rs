//! From the texels of a target grid to the pixels of a source, to far less than a pixel.
//!
//! Every projection here turns with longitude, so each pair of them splits into an angle and one
//! function of one variable, and nothing of two variables is ever interpolated:
//!
//! ```text
//!   target        source        column and row of the source
//!   cylindrical ◀ cylindrical   a table of columns, a table of rows               cylindrical.rs
//!   cylindrical ◀ polar         (sin, cos) by column times the radius by row      polar_tables.rs
//!   polar       ◀ cylindrical   arc tangent of a rotated quotient, V(radius)      polar_angle.rs
//!   polar       ◀ polar         a sum of column and row, about one pole           similar.rs
//!   any         ◀ any           through the body, one by one                      exact.rs
//! ```
//!
//! # Conventions
//!
//! Texels and pixels are counted from their centers: (0, 0) is the center of the first. A row or
//! column of the target past its outline is that of the extended level.
//!
//! # Outside the source
//!
//! Positions farther outside the source's outline than ¼ pixel, and texels that the source's
//! projection does not show, stand ¼ pixel outside it: the pixel nearest to them is none of the
//! source's, and a window around them no larger than one around the outline.

mod cylindrical;
mod exact;
mod polar_angle;
mod polar_tables;
mod radial;
mod similar;

use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

use areoid_formats::body::Body;
use areoid_formats::grid::Placement;
use areoid_formats::projection::Projection;

use self::cylindrical::Cylindrical;
use self::exact::Pair;
use self::polar_angle::PolarAngle;
use self::polar_tables::PolarTables;
use self::similar::Similar;
use super::tile::{Coords, Footprint, TILE, TargetTile};

/// How exact positions are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Precision {
    /// Every texel through the body, one by one.
    Exact,
    /// Within so many pixels of the source. Far better is met.
    Within {
        /// Source pixels.
        px: f64,
    },
}

impl Default for Precision {
    fn default() -> Self {
        Self::Within { px: 1.0 / 64.0 }
    }
}

/// Texels by the way in which their positions were found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TransformCounts {
    /// Products of tables.
    pub tables: u64,
    /// Truncated series.
    pub series: u64,
    /// One by one.
    pub exact: u64,
}

/// Where the texels of a target lie in a source.
///
/// The target is a grid's finest level, or the pixels of another raster: with both exchanged it is
/// the way back.
///
/// Any thread may ask, and gets the same bits.
#[derive(Debug)]
pub struct Transform {
    pair: Pair,
    case: Case,
    precision: Precision,
    by_tables: AtomicU64,
    by_series: AtomicU64,
    by_exact: AtomicU64,
}

#[derive(Debug)]
enum Case {
    Cylindrical(Cylindrical),
    PolarTables(PolarTables),
    PolarAngle(PolarAngle),
    Similar(Similar),
    Exact,
}

/// Whole turns between columns as they come and as the source has them.
enum Turn {
    /// All by the same number of columns.
    By(f64),
    /// Each by its own: both ends of the raster are near.
    Each,
}

/// How far outside the centers of the outermost pixels positions may lie.
const BEYOND_PX: f64 = 0.75;

/// Texels along a side of a tile beside a pole.
const POLE_TILE: usize = 8;

/// Rounding errors of coordinates: of a sum of a few products of tables and positions as large as
/// the raster, and as many in what they are compared with.
const ROUNDING: f64 = 1.0 / (1_u64 << 44) as f64;

impl Transform {
    /// The way from `target` to `source`, or `None` if they show other bodies.
    ///
    /// Positions on the body are carried over unchanged between surfaces that differ a little, as
    /// [`Crs`](areoid_formats::projection::Crs) has them: latitudes planetographic.
    #[must_use]
    pub fn new(target: &Placement, source: &Placement, precision: Precision) -> Option<Self> {
        let [target_body, source_body] =
            [target.crs.body, source.crs.body].map(Body::from_ellipsoid);
        if !target_body.same_as(&source_body) {
            return None;
        }
        let pair = Pair::new(*target, *source);
        let case = match (&target.crs.projection, &source.crs.projection) {
            (Projection::PolarStereographic(_), Projection::PolarStereographic(_)) => {
                Similar::new(&pair).map_or(Case::Exact, Case::Similar)
            }
            (Projection::PolarStereographic(map), _) => {
                Case::PolarAngle(PolarAngle::new(&pair, map))
            }
            (_, Projection::PolarStereographic(map)) => {
                Case::PolarTables(PolarTables::new(&pair, map))
            }
            _ => Case::Cylindrical(Cylindrical::new(&pair)),
        };
        let made = Self {
            pair,
            case,
            precision,
            by_tables: AtomicU64::new(0),
            by_series: AtomicU64::new(0),
            by_exact: AtomicU64::new(0),
        };
        let exact = matches!(precision, Precision::Within { px } if px < made.bound_px());
        Some(if exact { Self { precision: Precision::Exact, ..made } } else { made })
    }

    /// The target.
    #[must_use]
    pub fn target(&self) -> &Placement {
        &self.pair.target
    }

    /// The source.
    #[must_use]
    pub fn source(&self) -> &Placement {
        &self.pair.source
    }

    /// Rows and columns of texels in tiles: of [`TILE`] texels a side, smaller beside a pole where
    /// a few texels see many columns of the source.
    #[must_use]
    pub fn tiles(&self, rows: Range<i64>, cols: Range<i64>) -> Vec<TargetTile> {
        let mut tiles = Vec::new();
        for tile in cut(rows, cols, TILE) {
            match &self.case {
                Case::PolarAngle(case) if case.sees_the_pole(&self.pair, tile) => {
                    tiles.extend(cut(rows_of(tile), cols_of(tile), POLE_TILE));
                }
                _ => tiles.push(tile),
            }
        }
        tiles
    }

    /// The positions of a tile's texels.
    ///
    /// # Precision
    ///
    /// [`Self::bound_px`] of what [`Self::exact`] says, whole turns apart where the source's map
    /// goes around the body; see the module for what lies outside the source.
    ///
    /// # Domain
    ///
    /// Tiles of the target and the texel around it.
    ///
    /// # Panics
    ///
    /// If the tile lies outside it, or is larger than [`TILE`].
    pub fn coords(&self, tile: TargetTile, out: &mut Coords) -> Footprint {
        self.places(tile, out);
        self.footprint(tile)
    }

    /// [`Self::coords`] where nobody asks for the footprint.
    pub(super) fn places(&self, tile: TargetTile, out: &mut Coords) {
        assert!(tile.rows <= TILE && tile.cols <= TILE, "a tile of at most {TILE} texels a side");
        let texels = tile.rows * tile.cols;
        out.u.resize(texels, 0.0);
        out.v.resize(texels, 0.0);
        let fast = self.precision != Precision::Exact;
        let counter = match &self.case {
            Case::Cylindrical(case) if fast => {
                case.fill(&self.pair, tile, out);
                &self.by_tables
            }
            Case::PolarTables(case) if fast => {
                case.fill(tile, out);
                &self.by_tables
            }
            Case::PolarAngle(case) if fast && case.fill(&self.pair, tile, out) => &self.by_series,
            Case::Similar(case) if fast => {
                case.fill(&self.pair, tile, out);
                &self.by_tables
            }
            _ => {
                self.pair.fill(tile, out);
                &self.by_exact
            }
        };
        counter.fetch_add(texels as u64, Ordering::Relaxed);
        self.settle(out);
    }

    /// A rectangle that holds the positions of a tile's texels: least and greatest column, least
    /// and greatest row. `None` if all of them are outside the source.
    ///
    /// A bound, but between polar maps that are not similar, where it is estimated from places on the tile's rim.
    /// Any rectangle of texels will do for a tile here. Columns are not wrapped; where rows of the
    /// source do not close but its map does, they may be a turn away.
    #[must_use]
    pub fn range(&self, tile: TargetTile) -> Option<[f64; 4]> {
        let [mut left, mut right, top, bottom] = match &self.case {
            Case::Cylindrical(case) => case.range(&self.pair, tile),
            Case::PolarTables(case) => case.range(tile),
            Case::PolarAngle(case) => case.range(&self.pair, tile),
            Case::Similar(case) => case.range(&self.pair, tile),
            Case::Exact => self.pair.range(tile),
        };
        let [[least_u, most_u], [least_v, most_v]] = self.limits();
        let (top, bottom) = (top.max(least_v), bottom.min(most_v));
        if !self.source().wraps {
            match self.turn(left, right) {
                Turn::By(columns) => (left, right) = (left + columns, right + columns),
                Turn::Each => (left, right) = (least_u, most_u),
            }
            (left, right) = (left.max(least_u), right.min(most_u));
        }
        // A quarter of a pixel outside is outside.
        let outside = |low: f64, high: f64, [least, most]: [f64; 2]| {
            low > high || low >= most || high <= least
        };
        let beside = !self.source().wraps && outside(left, right, [least_u, most_u]);
        let none = beside || outside(top, bottom, [least_v, most_v]);
        (!none).then_some([left, right, top, bottom])
    }

    /// Whether [`Self::range`] is a bound, and no estimate.
    #[must_use]
    pub(super) fn ranges_are_bounds(&self) -> bool {
        !matches!(self.case, Case::Exact)
    }

    /// Where a place among the target's texels lies in the source: the oracle of [`Self::coords`].
    ///
    /// # Domain
    ///
    /// Rows and columns of texel centers, whole or not, also past a pole; `None` where a
    /// projection has no answer.
    #[must_use]
    pub fn exact(&self, row: f64, col: f64) -> Option<(f64, f64)> {
        self.pair.exact(row, col)
    }

    /// Where a place among the source's pixels lies in the target, row first, inside its outline or
    /// not, in the turn nearest its middle; `None` where a projection has no answer.
    #[must_use]
    pub fn back(&self, u: f64, v: f64) -> Option<(f64, f64)> {
        self.pair.back(u, v)
    }

    /// The most that positions differ from [`Self::exact`], in source pixels, all over the grid.
    ///
    /// The truncated series keep to 2⁻²¹ pixels each or are not used; the rest is rounding.
    #[must_use]
    pub fn bound_px(&self) -> f64 {
        let truncated = match &self.case {
            _ if self.precision == Precision::Exact => 0.0,
            Case::PolarAngle(_) => polar_angle::TRUNCATION_PX,
            _ => 0.0,
        };
        truncated + ROUNDING * self.largest_px()
    }

    /// Texels so far, by the way in which their positions were found.
    #[must_use]
    pub fn counts(&self) -> TransformCounts {
        let count = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        TransformCounts {
            tables: count(&self.by_tables),
            series: count(&self.by_series),
            exact: count(&self.by_exact),
        }
    }

    /// The largest number that a position is computed from.
    fn largest_px(&self) -> f64 {
        let source = self.source();
        let map = (source.origin[0] / source.pixel_size[0])
            .abs()
            .max((source.origin[1] / source.pixel_size[1]).abs());
        let own = f64::from(source.width.max(source.height));
        let period = source.period_px().unwrap_or(0.0);
        map.max(own).max(period) + own
    }

    /// Least and greatest column, least and greatest row that positions may have.
    fn limits(&self) -> [[f64; 2]; 2] {
        let axis = |count: u32| [-BEYOND_PX, f64::from(count) - 1.0 + BEYOND_PX];
        [axis(self.source().width), axis(self.source().height)]
    }

    /// How columns `left..=right` about a source whose rows do not close come to lie in it: the
    /// turn of their middle may not be that of those that are inside.
    fn turn(&self, left: f64, right: f64) -> Turn {
        let [[least, most], _] = self.limits();
        match self.source().period_px() {
            Some(period) if right - period >= least && left <= most => Turn::Each,
            Some(period) if left + period <= most && right >= least => Turn::Each,
            Some(period) if right - period >= least => Turn::By(-period),
            Some(period) if left + period <= most => Turn::By(period),
            _ => Turn::By(0.0),
        }
    }

    /// Brings positions to the turn and the limits that the module promises.
    fn settle(&self, out: &mut Coords) {
        let [u_limits, v_limits] = self.limits();
        if !self.source().wraps {
            match self.turn(out.range[0], out.range[1]) {
                Turn::By(0.0) => {}
                Turn::By(columns) => {
                    for u in out.u.iter_mut().chain(&mut out.range[..2]) {
                        *u += columns;
                    }
                }
                Turn::Each => {
                    for u in &mut out.u {
                        *u = self.source().nearest_turn(*u).clamp(u_limits[0], u_limits[1]);
                    }
                    [out.range[0], out.range[1]] = u_limits;
                }
            }
            confine(&mut out.u, u_limits, &mut out.range[..2]);
        }
        confine(&mut out.v, v_limits, &mut out.range[2..]);
    }

    /// The footprint of a texel in the middle of the tile.
    #[must_use]
    pub fn footprint(&self, tile: TargetTile) -> Footprint {
        let [texel_u, texel_v] = self.pair.footprint(tile);
        let [detail_u, detail_v] = self.pair.detail(tile);
        Footprint { texel_u, texel_v, detail_u, detail_v }
    }
}

/// Brings values and their range between limits.
fn confine(values: &mut [f64], [least, most]: [f64; 2], range: &mut [f64]) {
    if range[0] < least || range[1] > most {
        for value in values.iter_mut().chain(range) {
            *value = value.clamp(least, most);
        }
    }
}

fn rows_of(tile: TargetTile) -> Range<i64> {
    tile.row..tile.row + tile.rows as i64
}

fn cols_of(tile: TargetTile) -> Range<i64> {
    tile.col..tile.col + tile.cols as i64
}

/// A rectangle cut into pieces of at most `side` texels.
fn cut(rows: Range<i64>, cols: Range<i64>, side: usize) -> impl Iterator<Item = TargetTile> {
    let pieces = move |range: Range<i64>| {
        let end = range.end;
        range.step_by(side).map(move |start| {
            let length = usize::try_from(end - start).expect("a range starts before its end");
            (start, length.min(side))
        })
    };
    pieces(rows).flat_map(move |(row, rows)| {
        pieces(cols.clone()).map(move |(col, cols)| TargetTile { row, col, rows, cols })
    })
}

#[cfg(test)]
pub(super) mod tests;
