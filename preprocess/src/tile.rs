//! A page under construction: its interior first, its border when its neighbors are there.
//!
//! ```text
//!   Raw     a leaf as read: texels, and how far each is valid
//!   Tile    a page whose coverage is settled: what its neighbors' borders and its parent look at;
//!           a `Border` closes it
//! ```
//!
//! All have the layout of the finished page, `side * side` texels row-major, so that a page is read,
//! averaged, bordered and encoded where it lies. A page cut by the outline has its border right
//! after the last texel and the extension beyond.

use std::ops::Range;

use areoid_formats::bound::Span;

use crate::texel::{Planes, PlanesView, Texel};

/// A leaf as read. Outside the interior nothing is said.
#[derive(Clone, Debug, PartialEq)]
pub struct Raw {
    /// Texels; NaN or 0 where invalid.
    pub planes: Planes,
    /// Alpha beside each texel, or `None` where all of the interior is opaque and valid. 0 is
    /// invalid.
    pub alpha: Option<Vec<u8>>,
}

/// A page whose coverage is settled.
#[derive(Clone, Debug, PartialEq)]
pub struct Tile<S> {
    /// Texels along a side, border included.
    pub side: usize,
    /// Rows of the interior inside the outline.
    pub rows: usize,
    /// Columns of the interior inside the outline.
    pub cols: usize,
    /// Stored texels, one plane a channel; [`Texel::INVALID`] where invalid.
    pub planes: Vec<Vec<S>>,
    /// The texels before they were rounded to the step, where that changed any (leaves only).
    pub original: Option<Vec<Vec<S>>>,
    /// Coverage beside each texel, or `None` where all are fully covered.
    pub coverage: Option<Vec<u8>>,
    /// The finest texels under each texel, a plane a channel; `None` for leaves, and where the
    /// source cannot have holes.
    pub spans: Option<Vec<Span<S>>>,
    /// Valid texels of the finished page, border included, and the finest under them are not less
    /// or greater than these.
    pub range: (S, S),
}

/// A leaf whose border is closed: all that `R_L` is made of over its interior.
#[derive(Clone, Copy, Debug)]
pub struct Closed<'a> {
    /// Texels along a side, border included.
    pub side: usize,
    /// Texels before they were rounded to the step.
    pub planes: PlanesView<'a>,
    /// Coverage beside each texel, or `None` where all are fully covered. 0 is invalid.
    pub coverage: Option<&'a [u8]>,
}

impl<S: Texel> Tile<S> {
    /// The leaf as it was before it was rounded, lent. Its border must be closed.
    #[must_use]
    pub fn closed(&self) -> Closed<'_> {
        let planes = S::view(self.original.as_ref().unwrap_or(&self.planes));
        Closed { side: self.side, planes, coverage: self.coverage.as_deref() }
    }

    /// A page without a valid texel.
    #[must_use]
    pub fn blank(side: usize, (rows, cols): (usize, usize)) -> Self {
        let planes = vec![vec![S::INVALID; side * side]; S::CHANNELS];
        let coverage = Some(vec![0; side * side]);
        let (original, spans, range) = (None, None, S::NOTHING);
        Self { side, rows, cols, planes, original, coverage, spans, range }
    }

    /// Where a texel of the interior lies.
    #[must_use]
    pub fn at(&self, row: usize, col: usize) -> usize {
        (row + 1) * self.side + col + 1
    }

    /// Where the texels of a row of the interior lie.
    #[must_use]
    pub fn row(&self, row: usize) -> Range<usize> {
        self.at(row, 0)..self.at(row, self.cols)
    }
}

/// A span with no finest texel anywhere.
pub(crate) fn nothing<S: Texel>(count: usize) -> Span<S> {
    let (least, greatest) = S::NOTHING;
    Span { least: vec![least; count], greatest: vec![greatest; count] }
}

/// The parts of a page's rows outside its interior, from the top left.
pub(crate) fn outside(
    (side, rows, cols): (usize, usize, usize),
) -> impl Iterator<Item = (usize, Range<usize>)> {
    (0..side).flat_map(move |row| {
        let inner = (1..=rows).contains(&row);
        let parts = if inner { [0..1, cols + 1..side] } else { [0..side, 0..0] };
        parts.map(|part| (row, part))
    })
}
