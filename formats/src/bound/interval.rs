//! Intervals, and the numbers that their ends are computed in.

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
    /// Least `R_l − R_L` in the cell, rounded down.
    pub low: Vec<C>,
    /// Greatest, rounded up.
    pub high: Vec<C>,
}

/// What a channel is made of: `f32` meters or `u8` codes.
pub trait Texel: Copy + PartialOrd + Into<f64> + Send + Sync + 'static {
    /// The end of an interval: meters in f32, or sixteenths of a code in i16.
    type Cell: Copy + PartialOrd + std::fmt::Debug + Send + Sync + 'static;
    /// The ends of the interval that contains nothing.
    const EMPTY: (Self::Cell, Self::Cell);
    /// The end of the interval that contains nothing but zero.
    const ZERO: Self::Cell;

    /// The number that an end stands for; infinite for the ends of [`Self::EMPTY`].
    fn end(cell: Self::Cell) -> f64;

    /// The ends of an interval, rounded outward.
    fn outward(low: f64, high: f64) -> (Self::Cell, Self::Cell);

    /// Widens the intervals of a parent by those of one child.
    fn widen_by_child(
        cells: &mut Cells<Self::Cell>,
        parent: Window<'_, Self>,
        child: &Child<'_, Self>,
        texels: Magnitude,
    );
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

/// What differences at the lattice are computed in, in sixteenths.
pub(super) trait Number<S: Texel>:
    Copy
    + Default
    + PartialOrd
    + From<u8>
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
{
    fn from_texel(texel: S) -> Self;

    /// The lower end of an interval: this many sixteenths more than `known`, less `rounding`.
    fn low(self, known: S::Cell, rounding: f64) -> S::Cell;

    /// The upper end, likewise.
    fn high(self, known: S::Cell, rounding: f64) -> S::Cell;
}

impl Texel for f32 {
    type Cell = Self;
    const EMPTY: (Self, Self) = (Self::INFINITY, Self::NEG_INFINITY);
    const ZERO: Self = 0.0;

    fn end(cell: Self) -> f64 {
        cell.into()
    }

    fn outward(low: f64, high: f64) -> (Self, Self) {
        (rounded_down(low), rounded_up(high))
    }

    fn widen_by_child(
        cells: &mut Cells<Self>,
        parent: Window<'_, Self>,
        child: &Child<'_, Self>,
        texels: Magnitude,
    ) {
        let known = child.cells.map_or(0.0, Cells::bound::<Self>);
        if texels.is_small() && known < LARGEST {
            vectorized(Widening::<Self, Self>::new(cells, parent, child, 0.0));
        } else {
            // One for each of the two reconstructions.
            let rounding = 2.0 * texels.rounding();
            vectorized(Widening::<Self, f64>::new(cells, parent, child, rounding));
        }
    }
}

impl Texel for u8 {
    type Cell = i16;
    const EMPTY: (i16, i16) = (i16::MAX, i16::MIN);
    const ZERO: i16 = 0;

    fn end(cell: i16) -> f64 {
        match cell {
            i16::MAX => f64::INFINITY,
            i16::MIN => f64::NEG_INFINITY,
            sixteenths => f64::from(sixteenths) / 16.0,
        }
    }

    fn outward(low: f64, high: f64) -> (i16, i16) {
        if low > high {
            return Self::EMPTY;
        }
        let sixteenths = |codes: f64| (codes * 16.0).clamp(-f64::from(WIDEST), WIDEST.into());
        #[expect(clippy::cast_possible_truncation, reason = "clamped")]
        (sixteenths(low).floor() as i16, sixteenths(high).ceil() as i16)
    }

    fn widen_by_child(
        cells: &mut Cells<i16>,
        parent: Window<'_, Self>,
        child: &Child<'_, Self>,
        _: Magnitude,
    ) {
        vectorized(Widening::<Self, i16>::new(cells, parent, child, 0.0));
    }
}

impl Number<f32> for f32 {
    #[inline(always)]
    fn from_texel(texel: f32) -> Self {
        texel
    }

    #[inline(always)]
    fn low(self, known: f32, _: f64) -> f32 {
        self * SIXTEENTH + known
    }

    #[inline(always)]
    fn high(self, known: f32, _: f64) -> f32 {
        self * SIXTEENTH + known
    }
}

impl Number<f32> for f64 {
    #[inline(always)]
    fn from_texel(texel: f32) -> Self {
        texel.into()
    }

    #[inline(always)]
    fn low(self, known: f32, rounding: f64) -> f32 {
        rounded_down(self / 16.0 + Self::from(known) - rounding)
    }

    #[inline(always)]
    fn high(self, known: f32, rounding: f64) -> f32 {
        rounded_up(self / 16.0 + Self::from(known) + rounding)
    }
}

impl Number<u8> for i16 {
    #[inline(always)]
    fn from_texel(texel: u8) -> Self {
        texel.into()
    }

    #[inline(always)]
    fn low(self, known: i16, _: f64) -> i16 {
        greatest(self.saturating_add(known), -WIDEST)
    }

    #[inline(always)]
    fn high(self, known: i16, _: f64) -> i16 {
        least(self.saturating_add(known), WIDEST)
    }
}

const SIXTEENTH: f32 = 1.0 / 16.0;

/// Two reconstructions of codes are no farther apart than the codes themselves, in sixteenths.
const WIDEST: i16 = 255 * 16;

/// Whole heights below this, and intervals, whose sums f32 holds to the sixteenth: with their sum
/// below 2^20 m there are 20 bits before the point and four behind it.
const LARGEST: f32 = 131_072.0;

/// How large the texels of a page and its children are, those of their windows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Magnitude {
    /// No texel is farther from zero.
    pub largest: f32,
    /// Whether all are whole numbers, and what is known of the children whole sixteenths.
    pub whole: bool,
}

impl Magnitude {
    fn is_small(self) -> bool {
        self.whole && self.largest < LARGEST
    }

    /// An upper bound of what rounding may add to a reconstruction: zero for whole numbers, whose
    /// weighted sums f64 holds exactly.
    fn rounding(self) -> f64 {
        if self.is_small() { 0.0 } else { f64::from(self.largest) * 2.0_f64.powi(-48) }
    }
}

impl<C: Copy + PartialOrd> Cells<C> {
    /// Empty intervals.
    pub(super) fn empty<S: Texel<Cell = C>>(rows: usize, cols: usize) -> Self {
        let (least, greatest) = S::EMPTY;
        Self { rows, cols, low: vec![least; rows * cols], high: vec![greatest; rows * cols] }
    }

    /// The greatest distance from zero of any interval, in meters or codes: the page's own bound.
    #[must_use]
    pub fn bound<S: Texel<Cell = C>>(&self) -> f32 {
        // Empty intervals, their ends the wrong way round, weigh in nowhere.
        let (low, _) = lanes::extremes(&self.low, S::EMPTY);
        let (_, high) = lanes::extremes(&self.high, S::EMPTY);
        rounded_up((-S::end(low)).max(S::end(high)).max(0.0))
    }

    pub(super) fn row(&self, row: usize) -> (&[C], &[C]) {
        let row = row * self.cols..(row + 1) * self.cols;
        (&self.low[row.clone()], &self.high[row])
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
        let (low, high) = S::outward(low, high);
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
