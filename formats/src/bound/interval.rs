//! Intervals, and the numbers that their ends are computed in.

use std::num::Wrapping;
use std::ops::{Add, Mul, Sub};

use super::{Child, Widening, Window};
use crate::lanes::{self, greatest, least, vectorized};

/// The intervals of a page's interior: `rows * cols` cells, row-major. Where no point of a cell has
/// all taps, its interval is empty: `low > high`.
#[derive(Clone, Debug, PartialEq)]
pub struct Cells<C> {
    /// Rows of cells inside the outline.
    pub rows: usize,
    /// Cells in a row.
    pub cols: usize,
    /// Binary logarithm of the sixteenths that an end of whole heights counts by; otherwise 0.
    pub unit_log2: u32,
    /// Least `R_l − R_L` in the cell, rounded down.
    pub low: Vec<C>,
    /// Greatest, rounded up.
    pub high: Vec<C>,
}

/// What a channel is made of: `f32` meters, `i16` whole meters, or `u8` codes.
pub trait Texel: Copy + PartialOrd + Into<f64> + Send + Sync + 'static {
    /// The end of an interval: meters in f32, or in i16 a number of sixteenths, or of
    /// [`Cells::unit_log2`] powers of two of them.
    type Cell: Copy + PartialOrd + std::fmt::Debug + Send + Sync + 'static;
    /// The ends of the interval that contains nothing.
    const EMPTY: (Self::Cell, Self::Cell);
    /// The end of the interval that contains nothing but zero.
    const ZERO: Self::Cell;

    /// The number that an end stands for; infinite for the ends of [`Self::EMPTY`].
    fn end(cell: Self::Cell, unit_log2: u32) -> f64;

    /// The ends of an interval, rounded outward.
    fn outward(low: f64, high: f64, unit_log2: u32) -> (Self::Cell, Self::Cell);

    /// The least unit in which the ends of a parent fit, from the range of all texels looked at and
    /// the greatest bound of a child.
    fn unit_log2(_range: (Self, Self), _known: f64) -> u32 {
        0
    }

    /// Widens the intervals of a parent by those of one child. `range` is that of all texels looked
    /// at.
    fn widen_by_child(
        cells: &mut Cells<Self::Cell>,
        parent: Window<'_, Self>,
        child: &Child<'_, Self>,
        range: (Self, Self),
    );
}

/// Ends of intervals of a row of cells.
#[derive(Clone, Copy)]
pub(super) struct Ends<'a, C> {
    pub(super) low: &'a [C],
    pub(super) high: &'a [C],
}

/// The intervals of a row of cells, and of one more, empty, where the outline cuts the last pair.
pub(super) struct Row<S: Texel> {
    pub(super) low: Vec<S::Cell>,
    pub(super) high: Vec<S::Cell>,
}

impl<S: Texel> Row<S> {
    pub(super) fn empty(cols: usize) -> Self {
        let (least, greatest) = S::EMPTY;
        let count = cols.next_multiple_of(2);
        Self { low: vec![least; count], high: vec![greatest; count] }
    }

    #[inline(always)]
    pub(super) fn widen(&mut self, other: &Self) {
        self.low.iter_mut().zip(&other.low).for_each(|(to, &low)| *to = least(low, *to));
        self.high.iter_mut().zip(&other.high).for_each(|(to, &high)| *to = greatest(high, *to));
    }
}

/// How differences become the ends of intervals.
#[derive(Clone, Copy, Debug)]
pub(super) struct Terms<S> {
    /// Taken from every texel, so that the rest is small.
    pub(super) base: S,
    /// What rounding may have added to a difference.
    pub(super) rounding: f64,
    /// The unit of the child's ends.
    pub(super) known_log2: u32,
    /// The unit of the parent's ends.
    pub(super) unit_log2: u32,
}

impl<S: Texel> Terms<S> {
    /// What is exact: nothing is added.
    pub(super) const fn exact(base: S) -> Self {
        Self { base, rounding: 0.0, known_log2: 0, unit_log2: 0 }
    }
}

/// What differences at the lattice are computed in, in sixteenths.
pub(super) trait Number<S: Texel>:
    Copy + Default + PartialOrd + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self>
{
    /// A weight.
    fn from_weight(weight: u8) -> Self;

    /// A texel less `base`.
    fn from_texel(texel: S, base: S) -> Self;

    /// The lower end of an interval: this many sixteenths more than `known`, in units.
    ///
    /// What is known of a cell is an interval that is not empty, unless a tap around it is missing;
    /// then what comes out is replaced.
    fn low(self, known: S::Cell, terms: Terms<S>) -> S::Cell;

    /// The upper end, likewise.
    fn high(self, known: S::Cell, terms: Terms<S>) -> S::Cell;
}

impl Texel for f32 {
    type Cell = Self;
    const EMPTY: (Self, Self) = (Self::INFINITY, Self::NEG_INFINITY);
    const ZERO: Self = 0.0;

    fn end(cell: Self, _: u32) -> f64 {
        cell.into()
    }

    fn outward(low: f64, high: f64, _: u32) -> (Self, Self) {
        if low > high { Self::EMPTY } else { (rounded_down(low), rounded_up(high)) }
    }

    fn widen_by_child(
        cells: &mut Cells<Self>,
        parent: Window<'_, Self>,
        child: &Child<'_, Self>,
        (least, greatest): (Self, Self),
    ) {
        // For each of the two reconstructions, sums of at most 16 texels, and what is left over.
        let rounding = f64::from(greatest.abs().max(least.abs())) * 2.0_f64.powi(-47);
        let terms = Terms { rounding, ..Terms::exact(0.0) };
        vectorized(Widening::<Self, f64>::new(cells, parent, child, terms));
    }
}

impl Texel for i16 {
    type Cell = Self;
    const EMPTY: (Self, Self) = EMPTY;
    const ZERO: Self = 0;

    fn end(cell: Self, unit_log2: u32) -> f64 {
        end_of(cell) * f64::from(1_u32 << unit_log2)
    }

    fn outward(low: f64, high: f64, unit_log2: u32) -> (Self, Self) {
        let units = 16.0 / f64::from(1_u32 << unit_log2);
        outward(low * units, high * units, FARTHEST)
    }

    fn unit_log2((least, greatest): (Self, Self), known: f64) -> u32 {
        let spread = f64::from(greatest) - f64::from(least);
        let sixteenths = 16.0 * (spread.max(0.0) + known);
        // A unit more, for rounding outward.
        let fits = |log2: &u32| sixteenths / f64::from(1_u32 << log2) + 1.0 <= FARTHEST.into();
        (0..16).find(fits).unwrap_or(16)
    }

    fn widen_by_child(
        cells: &mut Cells<Self>,
        parent: Window<'_, Self>,
        child: &Child<'_, Self>,
        (least, greatest): (Self, Self),
    ) {
        let unit_log2 = cells.unit_log2;
        if unit_log2 == 0 {
            // No texel is 2^10 from the middle, no sum of sixteen 2^14, no difference 2^15.
            let base = least.midpoint(greatest);
            let terms = Terms::exact(base);
            vectorized(Widening::<Self, Wrapping<Self>>::new(cells, parent, child, terms));
        } else {
            let known_log2 = child.cells.map_or(0, |cells| cells.unit_log2);
            let terms = Terms { known_log2, unit_log2, ..Terms::exact(0) };
            vectorized(Widening::<Self, i32>::new(cells, parent, child, terms));
        }
    }
}

impl Texel for u8 {
    type Cell = i16;
    const EMPTY: (i16, i16) = EMPTY;
    const ZERO: i16 = 0;

    fn end(cell: i16, _: u32) -> f64 {
        end_of(cell)
    }

    fn outward(low: f64, high: f64, _: u32) -> (i16, i16) {
        outward(low * 16.0, high * 16.0, WIDEST)
    }

    fn widen_by_child(
        cells: &mut Cells<i16>,
        parent: Window<'_, Self>,
        child: &Child<'_, Self>,
        _: (Self, Self),
    ) {
        let terms = Terms::exact(0);
        vectorized(Widening::<Self, Wrapping<i16>>::new(cells, parent, child, terms));
    }
}

/// The ends of the empty interval of i16; no other has them.
const EMPTY: (i16, i16) = (i16::MAX, i16::MIN);

/// The farthest end of an interval of i16.
const FARTHEST: i16 = i16::MAX - 1;

/// Two reconstructions of codes are no farther apart than the codes themselves, in sixteenths.
const WIDEST: i16 = 255 * 16;

fn end_of(cell: i16) -> f64 {
    match cell {
        i16::MAX => f64::INFINITY,
        i16::MIN => f64::NEG_INFINITY,
        sixteenths => f64::from(sixteenths) / 16.0,
    }
}

/// Ends in their units, no farther out than `farthest`.
#[expect(clippy::cast_possible_truncation, reason = "clamped")]
fn outward(low: f64, high: f64, farthest: i16) -> (i16, i16) {
    if low > high {
        return EMPTY;
    }
    let clamped = |end: f64| end.clamp(-f64::from(farthest), farthest.into()) as i16;
    (clamped(low.floor()), clamped(high.ceil()))
}

impl Number<f32> for f64 {
    #[inline(always)]
    fn from_weight(weight: u8) -> Self {
        weight.into()
    }

    #[inline(always)]
    fn from_texel(texel: f32, _: f32) -> Self {
        texel.into()
    }

    #[inline(always)]
    fn low(self, known: f32, terms: Terms<f32>) -> f32 {
        rounded_down(self / 16.0 + Self::from(known) - terms.rounding)
    }

    #[inline(always)]
    fn high(self, known: f32, terms: Terms<f32>) -> f32 {
        rounded_up(self / 16.0 + Self::from(known) + terms.rounding)
    }
}

/// Wraps only where a texel is not valid.
impl Number<i16> for Wrapping<i16> {
    #[inline(always)]
    fn from_weight(weight: u8) -> Self {
        Self(weight.into())
    }

    #[inline(always)]
    fn from_texel(texel: i16, base: i16) -> Self {
        Self(texel) - Self(base)
    }

    #[inline(always)]
    fn low(self, known: i16, _: Terms<i16>) -> i16 {
        self.0.saturating_add(known)
    }

    #[inline(always)]
    fn high(self, known: i16, _: Terms<i16>) -> i16 {
        self.0.saturating_add(known)
    }
}

impl Number<i16> for i32 {
    #[inline(always)]
    fn from_weight(weight: u8) -> Self {
        weight.into()
    }

    #[inline(always)]
    fn from_texel(texel: i16, _: i16) -> Self {
        texel.into()
    }

    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, reason = "the unit was chosen so that ends fit")]
    fn low(self, known: i16, terms: Terms<i16>) -> i16 {
        ((self + (Self::from(known) << terms.known_log2)) >> terms.unit_log2) as i16
    }

    #[inline(always)]
    #[expect(clippy::cast_possible_truncation, reason = "the unit was chosen so that ends fit")]
    fn high(self, known: i16, terms: Terms<i16>) -> i16 {
        -((-(self + (Self::from(known) << terms.known_log2))) >> terms.unit_log2) as i16
    }
}

impl Number<u8> for Wrapping<i16> {
    #[inline(always)]
    fn from_weight(weight: u8) -> Self {
        Self(weight.into())
    }

    #[inline(always)]
    fn from_texel(texel: u8, _: u8) -> Self {
        Self(texel.into())
    }

    #[inline(always)]
    fn low(self, known: i16, _: Terms<u8>) -> i16 {
        greatest(self.0.saturating_add(known), -WIDEST)
    }

    #[inline(always)]
    fn high(self, known: i16, _: Terms<u8>) -> i16 {
        least(self.0.saturating_add(known), WIDEST)
    }
}

impl<C: Copy + PartialOrd> Cells<C> {
    /// Empty intervals.
    pub(super) fn empty<S: Texel<Cell = C>>(rows: usize, cols: usize, unit_log2: u32) -> Self {
        let (least, greatest) = S::EMPTY;
        let (low, high) = (vec![least; rows * cols], vec![greatest; rows * cols]);
        Self { rows, cols, unit_log2, low, high }
    }

    /// The greatest distance from zero of any interval, in meters or codes: the page's own bound.
    #[must_use]
    pub fn bound<S: Texel<Cell = C>>(&self) -> f32 {
        // Empty intervals, their ends the wrong way round, weigh in nowhere.
        let (low, _) = lanes::extremes(&self.low, S::EMPTY);
        let (_, high) = lanes::extremes(&self.high, S::EMPTY);
        let end = |cell| S::end(cell, self.unit_log2);
        rounded_up((-end(low)).max(end(high)).max(0.0))
    }

    pub(super) fn row(&self, row: usize) -> Ends<'_, C> {
        let row = row * self.cols..(row + 1) * self.cols;
        Ends { low: &self.low[row.clone()], high: &self.high[row] }
    }

    /// Widens the cells of `row` from `col` on by pairs of child cells.
    #[inline(always)]
    pub(super) fn widen_row<S: Texel<Cell = C>>(&mut self, row: usize, col: usize, by: &Row<S>) {
        let from = row * self.cols + col..(row + 1) * self.cols;
        for (to, pair) in self.low[from.clone()].iter_mut().zip(by.low.as_chunks::<2>().0) {
            *to = least(least(pair[0], pair[1]), *to);
        }
        for (to, pair) in self.high[from].iter_mut().zip(by.high.as_chunks::<2>().0) {
            *to = greatest(greatest(pair[0], pair[1]), *to);
        }
    }

    pub(super) fn widen<S: Texel<Cell = C>>(
        &mut self,
        row: usize,
        col: usize,
        low: f64,
        high: f64,
    ) {
        let at = row * self.cols + col;
        let (low, high) = S::outward(low, high, self.unit_log2);
        self.low[at] = least(low, self.low[at]);
        self.high[at] = greatest(high, self.high[at]);
    }
}

/// The greatest f32 not above `value`.
#[expect(clippy::cast_possible_truncation, reason = "rounding is the point")]
#[inline]
fn rounded_down(value: f64) -> f32 {
    let nearest = value as f32;
    if f64::from(nearest) > value { nearest.next_down() } else { nearest }
}

/// The least f32 not below `value`.
#[must_use]
#[expect(clippy::cast_possible_truncation, reason = "rounding is the point")]
#[inline]
pub fn rounded_up(value: f64) -> f32 {
    let nearest = value as f32;
    if f64::from(nearest) < value { nearest.next_up() } else { nearest }
}
