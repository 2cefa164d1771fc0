//! The source past its edges: wrapped, turned over a pole, or mirrored.
//!
//! ```text
//!             row -1 is row 0 half a turn away (outline), or row 1 (posts)
//!            +------------------------------------------------------------+
//!    wrapped |  width x height pixels                                     | wrapped,
//!            +------------------------------------------------------------+ or mirrored
//!             mirrored at the center of the last row: row height is row height - 2
//! ```
//!
//! Mirrored pixels are there for kernels to reach into; nothing is valid where they lie. A mirror at
//! the pixel's center is the end that the interpolating splines have here.
//!
//! Half a turn of an odd number of columns falls between two columns; the western one is taken. That
//! is off by (n + 1/2) π / width of a row's spacing on the ground, n rows beyond the pole.

use std::ops::Range;

use areoid_formats::pyramid::{Extent, PoleContact};

/// Where the pixels past the edges of an extent come from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Extension {
    extent: Extent,
}

/// Where a row or column of the extended source comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pixel {
    /// The row or column of the source.
    pub index: u32,
    /// Whether it lies beyond a pole, seen from here.
    pub turned: bool,
    /// Whether there are data: not so where an edge mirrors.
    pub real: bool,
}

/// Neighboring rows or columns of the extended source that are neighbors in the source, too.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Run {
    /// Where they begin in the range that was asked for.
    pub at: usize,
    /// How many.
    pub len: usize,
    /// Where the first comes from.
    pub first: Pixel,
    /// Whether they go up and not down in the source, or left and not right.
    pub backward: bool,
}

impl Run {
    /// The rows or columns of the source.
    #[must_use]
    pub fn range(self) -> Range<u32> {
        let (first, len) = (self.first.index, narrow(self.len as i64));
        if self.backward { first + 1 - len..first + 1 } else { first..first + len }
    }
}

impl Extension {
    /// The extension of a source.
    #[must_use]
    pub fn new(extent: Extent) -> Self {
        Self { extent }
    }

    /// The source's own pixels.
    #[must_use]
    pub fn extent(self) -> Extent {
        self.extent
    }

    /// Where a row comes from.
    #[must_use]
    pub fn row(self, row: i64) -> Pixel {
        let last = i64::from(self.extent.height) - 1;
        let (mut row, mut turned, mut real) = (row, false, true);
        while !(0..=last).contains(&row) {
            let (contact, mirror) =
                if row < 0 { (self.extent.north, 0) } else { (self.extent.south, 2 * last) };
            // Half a pixel beyond the outermost centers, or at them.
            let outline = if row < 0 { -1 } else { 1 };
            row = match contact {
                PoleContact::Outline => mirror + outline - row,
                // Two poles in one place, or one row between two mirrors.
                PoleContact::Posts | PoleContact::None if last == 0 => 0,
                PoleContact::Posts | PoleContact::None => mirror - row,
            };
            turned ^= contact != PoleContact::None;
            real &= contact != PoleContact::None;
        }
        Pixel { index: narrow(row), turned, real }
    }

    /// Where a column comes from in a row that is turned or not.
    #[must_use]
    pub fn col(self, col: i64, turned: bool) -> Pixel {
        let width = i64::from(self.extent.width);
        if self.extent.wraps {
            let half_turn = if turned { width / 2 } else { 0 };
            let index = narrow((col + half_turn).rem_euclid(width));
            return Pixel { index, turned, real: true };
        }
        let real = (0..width).contains(&col);
        let period = (2 * (width - 1)).max(1);
        let within = col.rem_euclid(period);
        Pixel { index: narrow(within.min(period - within).min(width - 1)), turned, real }
    }

    /// The rows of a range, in runs.
    #[must_use]
    pub fn rows(self, rows: Range<i64>) -> Vec<Run> {
        runs(rows, self.extent.height, |row| self.row(row))
    }

    /// The columns of a range in rows that are turned or not, in runs.
    #[must_use]
    pub fn cols(self, cols: Range<i64>, turned: bool) -> Vec<Run> {
        let plain = if turned && self.extent.wraps { 0 } else { self.extent.width };
        runs(cols, plain, |col| self.col(col, turned))
    }
}

/// What indices come from; the first `plain` from themselves.
fn runs(indices: Range<i64>, plain: u32, origin: impl Fn(i64) -> Pixel) -> Vec<Run> {
    let (mut runs, start): (Vec<Run>, i64) = (Vec::new(), indices.start);
    let mut index = start;
    while index < indices.end {
        let (next, at) = (origin(index), count(start, index));
        if (0..i64::from(plain)).contains(&index) {
            let end = indices.end.min(i64::from(plain));
            runs.push(Run { at, len: count(index, end), first: next, backward: false });
            index = end;
            continue;
        }
        index += 1;
        if let Some(run) = runs.last_mut()
            && (run.first.turned, run.first.real) == (next.turned, next.real)
        {
            let (first, len) = (i64::from(run.first.index), run.len as i64);
            let forward = i64::from(next.index) == first + len && (!run.backward || len == 1);
            let backward = i64::from(next.index) == first - len && (run.backward || len == 1);
            if forward || backward {
                run.backward = backward;
                run.len += 1;
                continue;
            }
        }
        runs.push(Run { at, len: 1, first: next, backward: false });
    }
    runs
}

fn count(start: i64, end: i64) -> usize {
    usize::try_from(end - start).expect("a range goes up")
}

fn narrow(index: i64) -> u32 {
    u32::try_from(index).expect("inside the source")
}

#[cfg(test)]
mod tests {
    use super::*;
    use areoid_formats::pyramid::Pyramid;
    use proptest::prelude::*;

    fn extent(width: u32, height: u32, north: PoleContact, south: PoleContact) -> Extent {
        let wraps = north != PoleContact::None || south != PoleContact::None;
        Extent { width, height, wraps, north, south }
    }

    #[test]
    fn edges_that_nothing_continues_mirror() {
        let extension = Extension::new(extent(4, 3, PoleContact::None, PoleContact::None));
        let rows = (-3..6).map(|row| extension.row(row));
        let expected = [1, 2, 1, 0, 1, 2, 1, 0, 1];
        assert!(rows.clone().map(|row| row.index).eq(expected));
        assert!(rows.map(|row| row.real).eq((-3..6).map(|row| (0..3).contains(&row))));
        let cols = (-4..8).map(|col| extension.col(col, false).index);
        assert!(cols.eq([2, 3, 2, 1, 0, 1, 2, 3, 2, 1, 0, 1]));
    }

    #[test]
    fn one_pixel_is_everywhere() {
        let extension = Extension::new(extent(1, 1, PoleContact::None, PoleContact::None));
        for at in -3..3 {
            assert_eq!((extension.row(at).index, extension.col(at, false).index), (0, 0));
        }
    }

    proptest! {
        /// The extension of the levels of a grid, where that is defined by whole rows.
        #[test]
        fn wraps_and_turns_are_those_of_a_level(
            half_width in 4..40_u32, height in 2..40_u32,
            north in 0..3_u8, south in 0..3_u8, row in -60..100_i64, col in -100..200_i64,
        ) {
            let contact = |at: u8| [PoleContact::None, PoleContact::Outline, PoleContact::Posts]
                [usize::from(at)];
            let mut extent = extent(2 * half_width, height, contact(north), contact(south));
            extent.wraps = true;
            let extension = Extension::new(extent);
            let Ok(pyramid) = Pyramid::new(extent, 512) else { return Ok(()) };
            let finest = pyramid.finest();
            let (here, wanted) = (extension.row(row), pyramid.extended_row(finest, row));
            if here.real {
                prop_assert_eq!((here.index, here.turned), (wanted.row, wanted.turned));
            }
            for turned in [false, true] {
                let wanted = pyramid.extended_col(finest, col, turned);
                prop_assert_eq!(extension.col(col, turned).index, wanted);
            }
        }

        #[test]
        fn runs_say_what_each_index_does(
            width in 1..9_u32, height in 1..9_u32, wraps: bool,
            start in -30..30_i64, len in 0..40_i64,
        ) {
            let mut extent = extent(width, height, PoleContact::None, PoleContact::None);
            extent.wraps = wraps;
            let extension = Extension::new(extent);
            let range = start..start + len;
            let spread = |runs: Vec<Run>| -> Vec<u32> {
                runs.into_iter()
                    .flat_map(|run| {
                        let range = run.range();
                        if run.backward { range.rev().collect::<Vec<_>>() } else { range.collect() }
                    })
                    .collect()
            };
            let rows: Vec<u32> = range.clone().map(|row| extension.row(row).index).collect();
            prop_assert_eq!(spread(extension.rows(range.clone())), rows);
            let cols: Vec<u32> =
                range.clone().map(|col| extension.col(col, false).index).collect();
            prop_assert_eq!(spread(extension.cols(range, false)), cols);
        }
    }
}
