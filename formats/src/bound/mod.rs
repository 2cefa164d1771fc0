//! Law 1: how far a level is from the finest, proven cell by cell.
//!
//! For every texel cell of a level this module carries the interval `[low, high]` that contains
//! `R_l − R_L` at all points of the cell where every tap of both is valid. A cell's interval comes
//! from its (up to four) child cells:
//!
//! ```text
//!   R_l − R_L  =  (R_l − R_{l+1})  +  (R_{l+1} − R_L)
//!                 exact extremes       the child cell's interval
//! ```
//!
//! Within a child cell `R_l` is one bilinear patch, because the centers of coarse texels lie on
//! child cells' corners, and `R_{l+1}` is four, cut at the child texel's center. Their difference
//! is bilinear on each of the four quarters, so its extremes over the cell are among the nine
//! points of a 3×3 lattice: corners, edge midpoints, center.
//!
//! ```text
//!   o---o---o     o  points where the difference is evaluated
//!   |   |   |
//!   o---o---o     the center is the child texel's own
//!   |   |   |
//!   o---o---o
//! ```
//!
//! Where a tap of `R_{l+1}` is missing but none of `R_l` is, the chain breaks; on the quarters and
//! edges that meet there `R_l` is held against the least and greatest *finest* texels under the
//! child cell and its eight neighbors ([`Span`]), which contain every tap of `R_L` in the cell.
//!
//! # Precision
//!
//! At the lattice all weights are sixteenths, so differences of whole numbers are whole sixteenths.
//! i16 holds those of color codes, and of whole heights where a page and its children span less
//! than 2^11 m less what is known of the children; where they span more, i32 does, and ends are
//! rounded outward to the least power of two of sixteenths that lets them fit in i16. Other heights
//! take f64 sums, an allowance for their rounding, and intervals rounded outward to f32.
//!
//! # References
//!
//! `ARCHITECTURE.md`, law 1. Nested errors after P-BDAM (Cignoni et al. 2003), §4; the intervals, which
//! let errors of opposite sign cancel, are ours.

mod holes;
mod interval;
mod lattice;
mod leaf;
mod solid;

pub use interval::{Cells, Texel, rounded_up};
pub use leaf::leaf_cells;

use std::marker::PhantomData;

use interval::Terms;
use lattice::Lattice;
use solid::Solid;

use crate::lanes::Wide;

/// The least and greatest finest texels under each texel of a window; `least > greatest` where
/// there is none.
#[derive(Clone, Debug, PartialEq)]
pub struct Span<S> {
    /// Least finest texel.
    pub least: Vec<S>,
    /// Greatest finest texel.
    pub greatest: Vec<S>,
}

/// One channel of a page's window: `side * side` texels with a border of one, row-major.
#[derive(Clone, Copy, Debug)]
pub struct Window<'a, S> {
    /// Texels along a side, border included.
    pub side: usize,
    /// Texels; anything where invalid.
    pub texels: &'a [S],
    /// 0 beside an invalid texel; `None` where all are valid.
    pub coverage: Option<&'a [u8]>,
    /// The finest texels under each; needed only where a texel of the window or of its parent's is
    /// invalid, and equal to the texels at the finest level.
    pub span: Option<&'a Span<S>>,
}

impl<S: Texel> Window<'_, S> {
    /// The texel at a row and column, NaN if it is invalid.
    fn at(&self, row: usize, col: usize) -> f64 {
        let at = row * self.side + col;
        match self.coverage {
            Some(coverage) if coverage[at] == 0 => f64::NAN,
            _ => self.texels[at].into(),
        }
    }
}

/// A child page, its place under its parent, and what is known of it.
#[derive(Clone, Copy, Debug)]
pub struct Child<'a, S: Texel> {
    /// 0 for the upper children, 1 for the lower.
    pub row: usize,
    /// 0 for the left children, 1 for the right.
    pub col: usize,
    /// Its window.
    pub window: Window<'a, S>,
    /// Rows and columns of its interior inside the outline.
    pub size: (usize, usize),
    /// Whether it is of the finest level: where a tap of it is missing, law 1 is silent.
    pub finest: bool,
    /// Its intervals, those of all channels; `None` if they are all zero, as for leaves stored
    /// without loss.
    pub cells: Option<&'a Cells<S::Cell>>,
}

/// A page and its children in one channel.
#[derive(Clone, Debug)]
pub struct Family<'a, S: Texel> {
    /// The page.
    pub parent: Window<'a, S>,
    /// Its children.
    pub children: Vec<Child<'a, S>>,
}

/// The intervals of a page from those of its children: for each cell one that holds for all
/// channels.
///
/// # Shapes
///
/// `size` is that of the interior inside the outline; all windows have the same side. No valid texel
/// of a window or of its span is less or greater than `range`.
#[must_use]
pub fn parent_cells<S: Texel>(
    channels: &[Family<'_, S>],
    size: (usize, usize),
    range: (S, S),
) -> Cells<S::Cell> {
    let known = channels.first().into_iter().flat_map(|channel| &channel.children);
    let known = known.filter_map(|child| child.cells);
    let bound = known.clone().map(Cells::bound::<S>).fold(0.0, f32::max);
    let finer = known.map(|cells| cells.unit_log2).max().unwrap_or(0);
    let unit_log2 = S::unit_log2(range, bound.into()).max(finer);
    let mut cells = Cells::empty::<S>(size.0, size.1, unit_log2);
    for Family { parent, children } in channels {
        for child in children {
            S::widen_by_child(&mut cells, *parent, child, range);
        }
    }
    cells
}

/// [`parent_cells`] for one child, in the arithmetic of `T`.
struct Widening<'a, S: Texel, T> {
    cells: &'a mut Cells<S::Cell>,
    parent: Window<'a, S>,
    child: &'a Child<'a, S>,
    terms: Terms<S>,
    arithmetic: PhantomData<T>,
}

impl<'a, S: Texel, T> Widening<'a, S, T> {
    fn new(
        cells: &'a mut Cells<S::Cell>,
        parent: Window<'a, S>,
        child: &'a Child<'a, S>,
        terms: Terms<S>,
    ) -> Self {
        Self { cells, parent, child, terms, arithmetic: PhantomData }
    }
}

impl<S: Texel, T: interval::Number<S>> Wide for Widening<'_, S, T> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { cells, parent, child, terms, .. } = self;
        if solid::is_solid(parent, child) {
            Solid::<S, T>::new(parent, *child, terms).widen(cells);
            return;
        }
        let interior = parent.side - 2;
        let (rows, cols) = child.size;
        let mut lattice = Lattice::<S, T>::new(parent, *child, terms);
        let mut holes = holes::Holes::new(parent, *child, terms);
        let mut pair = interval::Row::<S>::empty(cols);
        let mut lower = interval::Row::<S>::empty(cols);
        for row in 0..rows {
            let known = child.cells.map(|cells| cells.row(row));
            let intervals = if row % 2 == 0 { &mut pair } else { &mut lower };
            lattice.advance(row);
            lattice.intervals(known, intervals);
            holes.mend(row, known, intervals);
            if row % 2 == 1 {
                pair.widen(&lower);
            }
            if row % 2 == 1 || row + 1 == rows {
                cells.widen_row((child.row * interior + row) / 2, child.col * interior / 2, &pair);
            }
        }
    }
}

/// The nine points of a cell, in half texels from its corner.
const LATTICE: [(usize, usize); 9] =
    [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2), (2, 0), (2, 1), (2, 2)];

/// The two taps of a child's reconstruction at `half` half texels into texel `at`: each weighs a
/// half, and they are the same one at the center.
fn taps(at: usize, half: usize) -> (usize, usize) {
    match half {
        0 => (at - 1, at),
        1 => (at, at),
        _ => (at, at + 1),
    }
}

/// The two taps of the parent's reconstruction at `half` half texels into child texel `texel`, and
/// the weight of the second in quarters. Rows and columns of the parent's window.
fn parent_taps(texel: usize, half: usize) -> (usize, usize, u8) {
    // In the parent's texels the point is (texel + half/2)/2, centers are at halves, and the
    // window starts one texel before the interior.
    let parent = texel / 2 + 1;
    #[expect(clippy::cast_possible_truncation, reason = "0, 1 or 2")]
    let half = half as u8;
    if texel.is_multiple_of(2) {
        (parent - 1, parent, 2 + half)
    } else {
        (parent, parent + 1, half)
    }
}

#[cfg(test)]
mod tests;
