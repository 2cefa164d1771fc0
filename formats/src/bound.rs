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
//! Sums are f64 and exact for heights on an integer step; for others [`Window::rounding`] is added.
//! Intervals are kept as f32 rounded outward.
//!
//! # References
//!
//! `ARCHITECTURE.md`, law 1. Nested errors after P-BDAM (Cignoni et al. 2003), §4; the intervals, which
//! let errors of opposite sign cancel, are ours.

/// The least and greatest finest texels under each texel of a window; `least > greatest` where
/// there is none.
#[derive(Clone, Debug, PartialEq)]
pub struct Span {
    /// Least finest texel.
    pub least: Vec<f32>,
    /// Greatest finest texel.
    pub greatest: Vec<f32>,
}

/// One channel of a page's window: `side * side` texels with a border of one, row-major.
#[derive(Clone, Copy, Debug)]
pub struct Window<'a> {
    /// Texels along a side, border included.
    pub side: usize,
    /// Texels; NaN where invalid.
    pub texels: &'a [f32],
    /// The finest texels under each; needed only where a texel of the window is invalid, and
    /// equal to the texels at the finest level.
    pub span: Option<&'a Span>,
}

/// The intervals of a page's interior: `rows * cols` cells, row-major. Where no point of a cell has
/// all taps, its interval is empty: `low > high`.
#[derive(Clone, Debug, PartialEq)]
pub struct Cells {
    /// Rows of cells inside the outline.
    pub rows: usize,
    /// Cells in a row.
    pub cols: usize,
    /// Least `R_l − R_L` in the cell, rounded down.
    pub low: Vec<f32>,
    /// Greatest, rounded up.
    pub high: Vec<f32>,
}

/// A child page, its place under its parent, and what is known of it.
#[derive(Clone, Copy, Debug)]
pub struct Child<'a> {
    /// 0 for the upper children, 1 for the lower.
    pub row: usize,
    /// 0 for the left children, 1 for the right.
    pub col: usize,
    /// Its window.
    pub window: Window<'a>,
    /// Rows and columns of its interior inside the outline.
    pub size: (usize, usize),
    /// Whether it is of the finest level: where a tap of it is missing, law 1 is silent.
    pub finest: bool,
    /// Its intervals; `None` if they are all zero, as for leaves stored without loss.
    pub cells: Option<&'a Cells>,
}

impl Window<'_> {
    /// An upper bound of what rounding may add to a difference of two reconstructions: zero for
    /// whole numbers, whose weighted sums f64 holds exactly.
    #[must_use]
    pub fn rounding(&self) -> f64 {
        let mut largest = 0.0_f32;
        let mut whole = true;
        for &texel in self.texels.iter().filter(|texel| !texel.is_nan()) {
            largest = largest.max(texel.abs());
            whole &= texel == texel.trunc() && texel.abs() < 16_777_216.0;
        }
        if whole { 0.0 } else { f64::from(largest) * 2.0_f64.powi(-48) }
    }

    fn at(&self, row: usize, col: usize) -> f64 {
        f64::from(self.texels[row * self.side + col])
    }
}

impl Cells {
    /// Empty intervals.
    #[must_use]
    pub fn empty(rows: usize, cols: usize) -> Self {
        let count = rows * cols;
        Self { rows, cols, low: vec![f32::INFINITY; count], high: vec![f32::NEG_INFINITY; count] }
    }

    /// The greatest distance from zero of any interval: the page's own bound.
    #[must_use]
    pub fn bound(&self) -> f32 {
        let pairs = self.low.iter().zip(&self.high).filter(|(low, high)| low <= high);
        pairs.fold(0.0, |bound, (low, high)| bound.max(-low).max(*high))
    }

    fn widen(&mut self, row: usize, col: usize, low: f64, high: f64) {
        let at = row * self.cols + col;
        self.low[at] = self.low[at].min(rounded_down(low));
        self.high[at] = self.high[at].max(rounded_up(high));
    }

    fn get(&self, row: usize, col: usize) -> (f64, f64) {
        let at = row * self.cols + col;
        (f64::from(self.low[at]), f64::from(self.high[at]))
    }
}

/// The intervals of a leaf whose texels were rounded: of `stored − original`, reconstructed.
///
/// # Shapes
///
/// Both windows have the same side and are invalid in the same places; `size` is that of the
/// interior inside the outline.
#[must_use]
pub fn leaf_cells(stored: Window<'_>, original: &[f32], size: (usize, usize)) -> Cells {
    let side = stored.side;
    let change: Vec<f64> =
        stored.texels.iter().zip(original).map(|(s, o)| f64::from(*s) - f64::from(*o)).collect();
    let mut cells = Cells::empty(size.0, size.1);
    for row in 0..size.0 {
        for col in 0..size.1 {
            for (down, across) in LATTICE {
                let (top, bottom) = taps(row + 1, down);
                let (left, right) = taps(col + 1, across);
                let corners = [(top, left), (top, right), (bottom, left), (bottom, right)];
                let mean = corners.map(|(r, c)| change[r * side + c]).iter().sum::<f64>() / 4.0;
                if !mean.is_nan() {
                    cells.widen(row, col, mean, mean);
                }
            }
        }
    }
    cells
}

/// The intervals of a page from those of its children.
///
/// # Shapes
///
/// `size` is that of the interior inside the outline; all windows have the same side.
#[must_use]
pub fn parent_cells(parent: Window<'_>, size: (usize, usize), children: &[Child<'_>]) -> Cells {
    let mut cells = Cells::empty(size.0, size.1);
    let parent_rounding = parent.rounding();
    for child in children {
        let rounding = parent_rounding + child.window.rounding();
        let mut rows = LatticeRows::new(parent, *child);
        let holes = parent.texels.iter().chain(child.window.texels).any(|texel| texel.is_nan());
        for row in 0..child.size.0 {
            rows.advance(row);
            for col in 0..child.size.1 {
                let (mut low, mut high) = rows.extremes(col);
                let known = child.cells.map_or((0.0, 0.0), |cells| cells.get(row, col));
                low += known.0 - rounding;
                high += known.1 + rounding;
                if holes && needs_care(parent, child, row, col) {
                    (low, high) = careful(parent, child, row, col, known, rounding);
                }
                let interior = parent.side - 2;
                let at_row = (child.row * interior + row) / 2;
                let at_col = (child.col * interior + col) / 2;
                if low <= high {
                    cells.widen(at_row, at_col, low, high);
                }
            }
        }
    }
    cells
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
/// the weight of the second. Rows and columns of the parent's window.
fn parent_taps(texel: usize, half: usize) -> (usize, usize, f64) {
    // In the parent's texels the point is (texel + half/2)/2, centers are at halves, and the
    // window starts one texel before the interior.
    let parent = texel / 2 + 1;
    let quarter = half as f64 / 4.0;
    if texel.is_multiple_of(2) {
        (parent - 1, parent, 0.5 + quarter)
    } else {
        (parent, parent + 1, quarter)
    }
}

/// `R_l − R_{l+1}` on three lattice rows of a child: the top, the middle and the bottom of one row
/// of its cells.
struct LatticeRows<'a> {
    parent: Window<'a>,
    child: Child<'a>,
    rows: [Vec<f64>; 3],
    coarse: Vec<f64>,
    fine: Vec<f64>,
}

impl<'a> LatticeRows<'a> {
    fn new(parent: Window<'a>, child: Child<'a>) -> Self {
        let row = || vec![0.0; 2 * child.size.1 + 1];
        let rows = [row(), row(), row()];
        let side = || vec![0.0; parent.side];
        Self { parent, child, rows, coarse: side(), fine: side() }
    }

    /// Moves to row `row` of cells.
    fn advance(&mut self, row: usize) {
        if row == 0 {
            self.evaluate(row, 0);
        } else {
            self.rows.swap(0, 2);
        }
        self.evaluate(row, 1);
        self.evaluate(row, 2);
    }

    fn evaluate(&mut self, row: usize, half: usize) {
        let side = self.parent.side;
        let interior = side - 2;
        let (top, bottom) = taps(row + 1, half);
        let fine = self.child.window.texels;
        let upper = &fine[top * side..][..side];
        let lower = &fine[bottom * side..][..side];
        for (sum, (a, b)) in self.fine.iter_mut().zip(upper.iter().zip(lower)) {
            *sum = (f64::from(*a) + f64::from(*b)) * 0.5;
        }
        let (top, bottom, weight) = parent_taps(self.child.row * interior + row, half);
        let upper = &self.parent.texels[top * side..][..side];
        let lower = &self.parent.texels[bottom * side..][..side];
        if weight == 0.0 || weight == 1.0 {
            let only = if weight == 0.0 { upper } else { lower };
            self.coarse.iter_mut().zip(only).for_each(|(sum, a)| *sum = f64::from(*a));
        } else {
            for (sum, (a, b)) in self.coarse.iter_mut().zip(upper.iter().zip(lower)) {
                *sum = f64::from(*a) * (1.0 - weight) + f64::from(*b) * weight;
            }
        }

        let first = self.child.col * interior;
        for (col, pair) in (0..self.child.size.1).zip(self.rows[half].chunks_exact_mut(2)) {
            let at = (first + col) / 2 + 1;
            let (edge, center) = if (first + col).is_multiple_of(2) {
                let (a, b) = (self.coarse[at - 1], self.coarse[at]);
                (a * 0.5 + b * 0.5, a * 0.25 + b * 0.75)
            } else {
                let (a, b) = (self.coarse[at], self.coarse[at + 1]);
                (a, a * 0.75 + b * 0.25)
            };
            pair[0] = edge - (self.fine[col] + self.fine[col + 1]) * 0.5;
            pair[1] = center - self.fine[col + 1];
        }
        let last = self.child.size.1;
        let (left, right, weight) = parent_taps(first + last - 1, 2);
        let coarse = if weight == 1.0 {
            self.coarse[right]
        } else {
            self.coarse[left] * (1.0 - weight) + self.coarse[right] * weight
        };
        self.rows[half][2 * last] = coarse - (self.fine[last] + self.fine[last + 1]) * 0.5;
    }

    /// Least and greatest difference in cell `col` of the current row.
    fn extremes(&self, col: usize) -> (f64, f64) {
        let mut low = f64::INFINITY;
        let mut high = f64::NEG_INFINITY;
        for row in &self.rows {
            for &difference in &row[2 * col..2 * col + 3] {
                low = low.min(difference);
                high = high.max(difference);
            }
        }
        (low, high)
    }
}

/// Whether a tap that the cell could use is missing.
fn needs_care(parent: Window<'_>, child: &Child<'_>, row: usize, col: usize) -> bool {
    let interior = parent.side - 2;
    let fine = (row..row + 3).any(|r| (col..col + 3).any(|c| child.window.at(r, c).is_nan()));
    let (top, bottom, _) = parent_taps(child.row * interior + row, 1);
    let (left, right, _) = parent_taps(child.col * interior + col, 1);
    fine || [(top, left), (top, right), (bottom, left), (bottom, right)]
        .iter()
        .any(|&(r, c)| parent.at(r, c).is_nan())
}

/// The interval of a child cell with missing taps around: point by point.
fn careful(
    parent: Window<'_>,
    child: &Child<'_>,
    row: usize,
    col: usize,
    known: (f64, f64),
    rounding: f64,
) -> (f64, f64) {
    let interior = parent.side - 2;
    let coarse = LATTICE.map(|(down, across)| {
        let (top, bottom, below) = parent_taps(child.row * interior + row, down);
        let (left, right, beside) = parent_taps(child.col * interior + col, across);
        let taps = [
            (top, left, (1.0 - below) * (1.0 - beside)),
            (top, right, (1.0 - below) * beside),
            (bottom, left, below * (1.0 - beside)),
            (bottom, right, below * beside),
        ];
        let weighing = taps.iter().filter(|tap| tap.2 > 0.0);
        weighing.map(|&(r, c, weight)| weight * parent.at(r, c)).sum::<f64>()
    });
    let (least, greatest) = finest_around(child.window, row, col);
    let known_coarse = coarse.iter().filter(|here| !here.is_nan());
    let (lowest, highest) = known_coarse
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &here| {
            (low.min(here), high.max(here))
        });

    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for ((down, across), here) in LATTICE.into_iter().zip(coarse) {
        let (top, bottom) = taps(row + 1, down);
        let (left, right) = taps(col + 1, across);
        let corners = [(top, left), (top, right), (bottom, left), (bottom, right)];
        let fine = corners.map(|(r, c)| child.window.at(r, c)).iter().sum::<f64>() / 4.0;
        if !fine.is_nan() {
            if !here.is_nan() {
                low = low.min(here - fine + known.0 - rounding);
                high = high.max(here - fine + known.1 + rounding);
            }
            continue;
        }
        if child.finest {
            continue;
        }
        // The chain breaks on the quarters and edges that meet here. R_l is bilinear on each, so
        // its extremes are at the points of the lattice beside this one; R_L may be anything.
        for ((other_down, other_across), there) in LATTICE.into_iter().zip(coarse) {
            let beside = other_down.abs_diff(down) <= 1 && other_across.abs_diff(across) <= 1;
            if beside && !there.is_nan() && least <= greatest {
                low = low.min(there - greatest - rounding);
                high = high.max(there - least + rounding);
            }
        }
    }
    // Nothing in the cell is farther apart than the two surfaces' own ranges.
    (low.max(lowest - greatest - rounding), high.min(highest - least + rounding))
}

/// Least and greatest finest texel under a child cell and its eight neighbors.
fn finest_around(window: Window<'_>, row: usize, col: usize) -> (f64, f64) {
    let (mut least, mut greatest) = (f64::INFINITY, f64::NEG_INFINITY);
    for r in row..row + 3 {
        for c in col..col + 3 {
            let at = r * window.side + c;
            let (low, high) = match window.span {
                Some(span) => (span.least[at], span.greatest[at]),
                None => (window.texels[at], window.texels[at]),
            };
            // `min` and `max` pass NaN over.
            least = least.min(f64::from(low));
            greatest = greatest.max(f64::from(high));
        }
    }
    (least, greatest)
}

/// The greatest f32 not above `value`.
#[expect(clippy::cast_possible_truncation, reason = "rounding is the point")]
fn rounded_down(value: f64) -> f32 {
    let nearest = value as f32;
    if f64::from(nearest) > value { nearest.next_down() } else { nearest }
}

/// The least f32 not below `value`.
#[must_use]
#[expect(clippy::cast_possible_truncation, reason = "rounding is the point")]
pub fn rounded_up(value: f64) -> f32 {
    let nearest = value as f32;
    if f64::from(nearest) < value { nearest.next_up() } else { nearest }
}
