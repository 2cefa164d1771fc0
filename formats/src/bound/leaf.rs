//! The intervals of leaves that were rounded to a step.

use super::{Cells, LATTICE, Texel, Window, taps};

/// The intervals of a leaf whose texels were rounded: of `stored − original`, reconstructed.
///
/// # Shapes
///
/// `original` has the texels of the window before they were rounded; `size` is that of the interior
/// inside the outline.
#[must_use]
pub fn leaf_cells<S: Texel>(
    stored: Window<'_, S>,
    original: &[S],
    size: (usize, usize),
) -> Cells<S::Cell> {
    let side = stored.side;
    let change: Vec<f64> = (0..side * side)
        .map(|at| match stored.coverage {
            Some(coverage) if coverage[at] == 0 => f64::NAN,
            _ => stored.texels[at].into() - original[at].into(),
        })
        .collect();
    let mut cells = Cells::empty::<S>(size.0, size.1, 0);
    for row in 0..size.0 {
        for col in 0..size.1 {
            for (down, across) in LATTICE {
                let (top, bottom) = taps(row + 1, down);
                let (left, right) = taps(col + 1, across);
                let corners = [(top, left), (top, right), (bottom, left), (bottom, right)];
                let mean = corners.map(|(r, c)| change[r * side + c]).iter().sum::<f64>() / 4.0;
                if !mean.is_nan() {
                    cells.widen::<S>(row, col, mean, mean);
                }
            }
        }
    }
    cells
}
