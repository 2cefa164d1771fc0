//! The levels of a grid and the pages of each: arithmetic on whole numbers, no geography.
//!
//! Every level halves the one below it from the same top-left corner, sizes rounded up, until one
//! page holds it. Outside its outline a level is *extended*:
//!
//! ```text
//!               turned over the pole: row 0, half a turn to the right
//!              +-----------------------------------------------------+
//!    wrapped   |  level: width x height texels                       |  wrapped (or repeated)
//!              +-----------------------------------------------------+
//!               turned over the other pole, or the last row repeated
//! ```
//!
//! A page is a window of `page_side` texels onto the extended level: its interior and one texel of
//! border on each side. Interiors tile the level from the top-left corner; a page cut by the
//! outline keeps its size and shows the extension.
//!
//! # Poles
//!
//! A grid meets a pole in one of two ways ([`PoleContact`]): its outline ends there, or the
//! centers of its outermost *finest* texels lie there (a post-registered grid). In the second case
//! the rows of coarser levels do not mirror onto rows: row `-1-n` of a level halved k times lies,
//! mirrored, at row coordinate n + 2^-k, between two rows, and [`ExtendedRow`] says with what
//! weight.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::address::{Level, PageAddress};

/// How a grid meets a pole.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PoleContact {
    /// It does not: rows past this edge repeat the last one.
    #[default]
    None,
    /// The outline ends at the pole.
    Outline,
    /// The centers of the outermost finest texels lie on the pole.
    Posts,
}

/// What decides the levels and pages of a grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Extent {
    /// Texels in a row of the finest level.
    pub width: u32,
    /// Rows of the finest level.
    pub height: u32,
    /// Whether the rows close around the body.
    pub wraps: bool,
    /// How the top edge meets the north pole. Not `None` only if the grid wraps.
    pub north: PoleContact,
    /// How the bottom edge meets the south pole. Not `None` only if the grid wraps.
    pub south: PoleContact,
}

/// The size of one level in texels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LevelSize {
    /// Texels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// Why an extent has no pyramid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PyramidError {
    /// No texel at all.
    #[error("a grid of {width} x {height} texels is empty")]
    Empty {
        /// Texels in a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// A page side outside the range the format allows.
    #[error("a page side of {found} is not supported: even numbers in 8..=4096")]
    PageSide {
        /// The side asked for.
        found: u32,
    },
    /// More pages in a row or column than a [`PageKey`](crate::address::PageKey) can name.
    #[error("{width} x {height} texels make more than 2^28 pages a side: use larger pages")]
    TooManyPages {
        /// Texels in a row.
        width: u32,
        /// Rows.
        height: u32,
    },
    /// A grid around the body whose size does not halve far enough.
    #[error(
        "{width} x {height} texels around the body do not halve evenly down to 3 x 2 pages: \
         resample to a width of {next_width}"
    )]
    Uneven {
        /// Texels in a row.
        width: u32,
        /// Rows.
        height: u32,
        /// The next width that does.
        next_width: u64,
    },
    /// A pole without a turn around it.
    #[error("a grid that reaches a pole must go around the body")]
    PoleWithoutTurn,
}

/// The levels of a grid, and the pages of each.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pyramid {
    extent: Extent,
    page_side: u32,
    /// Coarsest first. Never empty.
    sizes: Vec<LevelSize>,
}

/// Where a row of an extended level comes from: `(1 - weight) row + weight (next row)`, half a
/// turn away if `turned`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExtendedRow {
    /// A row of the level.
    pub row: u32,
    /// The row after it, or the same one at the level's end.
    pub next: u32,
    /// Weight of `next`: a multiple of a power of two below 1, and 0 wherever rows mirror onto
    /// rows.
    pub weight: f64,
    /// Whether it lies beyond a pole, seen from here.
    pub turned: bool,
}

impl Pyramid {
    /// The border of a page in texels.
    pub const BORDER: u32 = 1;
    /// The most pages in a row of a coarsest level that cannot be halved again.
    pub const MAX_ROOT_COLS: u32 = 3;
    /// The most rows of pages of such a level.
    pub const MAX_ROOT_ROWS: u32 = 2;

    /// Whether a page may have so many texels a side: an even number in 8..=4096.
    #[must_use]
    pub fn is_page_side(texels: u32) -> bool {
        (8..=4096).contains(&texels) && texels.is_multiple_of(2)
    }

    /// Levels for `extent`, in pages of `page_side` texels including the border.
    ///
    /// # Errors
    ///
    /// Any [`PyramidError`].
    pub fn new(extent: Extent, page_side: u32) -> Result<Self, PyramidError> {
        let Extent { width, height, wraps, north, south } = extent;
        if width == 0 || height == 0 {
            return Err(PyramidError::Empty { width, height });
        }
        if !Self::is_page_side(page_side) {
            return Err(PyramidError::PageSide { found: page_side });
        }
        let reaches_pole = north != PoleContact::None || south != PoleContact::None;
        if reaches_pole && !wraps {
            return Err(PyramidError::PoleWithoutTurn);
        }
        let interior = page_side - 2 * Self::BORDER;
        if width.max(height).div_ceil(interior) > PageAddress::MAX_PAGES_PER_SIDE {
            return Err(PyramidError::TooManyPages { width, height });
        }
        let uneven =
            PyramidError::Uneven { width, height, next_width: next_even_width(width, interior) };
        // λ + 180° must fall on a column.
        if reaches_pole && width % 2 == 1 {
            return Err(uneven);
        }

        let mut sizes = vec![LevelSize { width, height }];
        let mut size = sizes[0];
        while size.width > interior || size.height > interior {
            let half = LevelSize { width: size.width.div_ceil(2), height: size.height.div_ceil(2) };
            let width_halves = !wraps || size.width.is_multiple_of(2);
            let half_turn_stays = !reaches_pole || half.width.is_multiple_of(2);
            let rows_halve = south != PoleContact::Outline || size.height.is_multiple_of(2);
            if !(width_halves && half_turn_stays && rows_halve) {
                let fits = size.width <= Self::MAX_ROOT_COLS * interior
                    && size.height <= Self::MAX_ROOT_ROWS * interior;
                if fits {
                    break;
                }
                return Err(uneven);
            }
            sizes.push(half);
            size = half;
        }
        sizes.reverse();
        Ok(Self { extent, page_side, sizes })
    }

    /// What the pyramid was made from.
    #[must_use]
    pub fn extent(&self) -> Extent {
        self.extent
    }

    /// Texels along a page's side, border included.
    #[must_use]
    pub fn page_side(&self) -> u32 {
        self.page_side
    }

    /// Texels along a page's side, border excluded.
    #[must_use]
    pub fn interior(&self) -> u32 {
        self.page_side - 2 * Self::BORDER
    }

    /// The finest level.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "a u32 halves at most 32 times")]
    pub fn finest(&self) -> Level {
        Level((self.sizes.len() - 1) as u8)
    }

    /// All levels, coarsest first.
    pub fn levels(&self) -> impl DoubleEndedIterator<Item = Level> + use<> {
        (0..=self.finest().0).map(Level)
    }

    /// The size of `level` in texels, or `None` if there is no such level.
    #[must_use]
    pub fn size(&self, level: Level) -> Option<LevelSize> {
        self.sizes.get(usize::from(level.0)).copied()
    }

    /// Rows and columns of pages of `level`, or `None` if there is no such level.
    #[must_use]
    pub fn pages(&self, level: Level) -> Option<(u32, u32)> {
        let size = self.size(level)?;
        Some((size.height.div_ceil(self.interior()), size.width.div_ceil(self.interior())))
    }

    /// Whether the pyramid has a place for `page`.
    #[must_use]
    pub fn contains(&self, page: PageAddress) -> bool {
        self.pages(page.level).is_some_and(|(rows, cols)| page.row < rows && page.col < cols)
    }

    /// The pages of the level below that cover `page`: one to four, or none at the finest level.
    pub fn children(&self, page: PageAddress) -> impl Iterator<Item = PageAddress> + '_ {
        page.children().into_iter().filter(|&child| self.contains(child))
    }

    /// The interior of `page` that lies inside the outline: rows and columns of texels.
    ///
    /// # Panics
    ///
    /// If the pyramid does not contain `page`.
    #[must_use]
    pub fn interior_size(&self, page: PageAddress) -> (u32, u32) {
        let size = self.size(page.level).expect("the page is one of this pyramid's");
        let interior = self.interior();
        (
            interior.min(size.height - page.row * interior),
            interior.min(size.width - page.col * interior),
        )
    }

    /// Halvings between the finest level and `level`.
    #[must_use]
    pub fn halvings(&self, level: Level) -> u32 {
        u32::from(self.finest().0 - level.0)
    }

    /// Where row `row` of `level`, extended, comes from.
    ///
    /// # Panics
    ///
    /// If there is no such level.
    #[must_use]
    pub fn extended_row(&self, level: Level, row: i64) -> ExtendedRow {
        let height = i64::from(self.size(level).expect("the level is this pyramid's").height);
        let whole =
            |row, turned| ExtendedRow { row: narrow(row), next: narrow(row), weight: 0.0, turned };
        if (0..height).contains(&row) {
            return whole(row, false);
        }

        // Positions in half texels of the finest level, from the top of the outline.
        let texel = 2_i64 << self.halvings(level);
        let outline = 2 * i64::from(self.extent.height);
        let north = pole_position(self.extent.north, 0, 1);
        let south = pole_position(self.extent.south, outline, -1);
        let mut position = row * texel + texel / 2;
        let mut turned = false;
        while !(0..=outline).contains(&position) {
            let pole = if position < 0 { north } else { south };
            // Two poles in one place could not turn anything into the outline.
            let Some(pole) = pole.filter(|_| north != south) else {
                return whole(if position < 0 { 0 } else { height - 1 }, turned);
            };
            position = 2 * pole - position;
            turned = !turned;
        }

        let offset = (position - texel / 2).clamp(0, (height - 1) * texel);
        let (row, rest) = (offset / texel, offset % texel);
        let next = if rest == 0 { row } else { row + 1 };
        let weight = rest as f64 / texel as f64;
        ExtendedRow { row: narrow(row), next: narrow(next), weight, turned }
    }

    /// Where column `col` of `level`, extended, comes from in a row that is `turned` or not.
    ///
    /// # Panics
    ///
    /// If there is no such level.
    #[must_use]
    pub fn extended_col(&self, level: Level, col: i64, turned: bool) -> u32 {
        let width = i64::from(self.size(level).expect("the level is this pyramid's").width);
        if self.extent.wraps {
            let half_turn = if turned { width / 2 } else { 0 };
            narrow((col + half_turn).rem_euclid(width))
        } else {
            narrow(col.clamp(0, width - 1))
        }
    }

    /// The pages whose interiors hold the texels that show within `halo` texels of the interior of
    /// `page`, or in its window: itself, its neighbors, and those it meets over a pole. Sorted.
    ///
    /// # Panics
    ///
    /// If the pyramid does not contain `page`.
    #[must_use]
    pub fn sources(&self, page: PageAddress, halo: u32) -> Vec<PageAddress> {
        let mut pages = Vec::new();
        for (rows, turned) in
            self.source_rows(page.level, page.row, halo).into_iter().zip([false, true])
        {
            if rows.is_empty() {
                continue;
            }
            let cols = self.source_cols(page.level, page.col, halo, turned);
            for row in rows {
                pages.extend(cols.iter().map(|&col| PageAddress::new(page.level, row, col)));
            }
        }
        pages.sort_unstable();
        pages.dedup();
        pages
    }

    /// The rows of pages that hold what shows within `halo` texels above and below row `row` of pages:
    /// as it is, and turned over a pole. Each sorted.
    ///
    /// # Panics
    ///
    /// If there is no such level, or row of pages in it.
    #[must_use]
    pub fn source_rows(&self, level: Level, row: u32, halo: u32) -> [Vec<u32>; 2] {
        let interior = self.interior();
        let [mut straight, mut turned] = [Vec::new(), Vec::new()];
        let height = i64::from(self.size(level).expect("the level is this pyramid's").height);
        let Range { start: top, end: bottom } = self.span(row, halo);
        // Rows of the level are their own; those past its edges are asked for one by one.
        let own = top.clamp(0, height)..bottom.clamp(0, height);
        straight.extend(narrow(own.start) / interior..=narrow(own.end - 1) / interior);
        for row in (top..own.start).chain(own.end..bottom) {
            let extended = self.extended_row(level, row);
            let rows = if extended.turned { &mut turned } else { &mut straight };
            rows.extend([extended.row / interior, extended.next / interior]);
            rows.dedup();
        }
        for rows in [&mut straight, &mut turned] {
            rows.sort_unstable();
            rows.dedup();
        }
        [straight, turned]
    }

    /// The columns of pages that hold what shows within `halo` texels on both sides of column `col` of
    /// pages, in rows that are turned over a pole or not. Each once.
    ///
    /// # Panics
    ///
    /// If there is no such level.
    #[must_use]
    pub fn source_cols(&self, level: Level, col: u32, halo: u32, turned: bool) -> Vec<u32> {
        let interior = self.interior();
        let width = i64::from(self.size(level).expect("the level is this pyramid's").width);
        let pages =
            |cols: Range<i64>| narrow(cols.start) / interior..=narrow(cols.end - 1) / interior;
        let span = self.span(col, halo);
        if !self.extent.wraps {
            let start = span.start.clamp(0, width - 1);
            return pages(start..span.end.clamp(start + 1, width)).collect();
        }
        let length = (span.end - span.start).min(width);
        let start = i64::from(self.extended_col(level, span.start, turned));
        let straight = pages(start..(start + length).min(width));
        if start + length <= width {
            return straight.collect();
        }
        let mut cols: Vec<u32> = straight.collect();
        cols.extend(pages(0..start + length - width).filter(|col| *col < narrow(start) / interior));
        cols
    }

    /// Rows or columns of texels of a page, and `halo` more on both sides.
    fn span(&self, index: u32, halo: u32) -> Range<i64> {
        let start = i64::from(index * self.interior());
        start - i64::from(halo)..start + i64::from(self.interior() + halo)
    }
}

/// The next width 2m·2^k, with 2m at most three pages, that is not below `width`.
fn next_even_width(width: u32, interior: u32) -> u64 {
    let width = u64::from(width.max(1));
    let most = u64::from(Pyramid::MAX_ROOT_COLS * interior);
    let mut halvings = 0;
    while width.div_ceil(1 << halvings) > most {
        halvings += 1;
    }
    let unit = 2_u64 << halvings;
    width.div_ceil(unit) * unit
}

/// Where a pole lies in half texels of the finest level, for an edge at `edge`.
fn pole_position(contact: PoleContact, edge: i64, inward: i64) -> Option<i64> {
    match contact {
        PoleContact::None => None,
        PoleContact::Outline => Some(edge),
        PoleContact::Posts => Some(edge + inward),
    }
}

/// A row or column that is known to lie in a level.
fn narrow(index: i64) -> u32 {
    u32::try_from(index).expect("an index was clamped to its level, which fits u32")
}

#[cfg(test)]
mod tests;
