//! Coverage: how much of a texel shows in a composition, from its distance to where data end.
//!
//! At the finest level coverage rises from almost nothing beside a hole or the outline to full
//! [`FEATHER_TEXELS`] farther in, linearly with the Euclidean distance. It is made once, there, and
//! coarser levels average it, so that where two datasets blend does not depend on the level shown.

use std::sync::LazyLock;

use areoid_formats::address::PageAddress;
use areoid_formats::pyramid::{PoleContact, Pyramid};

/// Leaf texels over which coverage rises to full.
pub const FEATHER_TEXELS: u32 = 32;

/// Texels around a leaf's interior whose validity decides its coverage.
pub const HALO: u32 = FEATHER_TEXELS + 1;

const REACH: usize = HALO as usize;

/// Which texels of a leaf's interior are valid.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Validity {
    /// None.
    Empty,
    /// All of them.
    Full,
    /// Those with a one, a bit each, rows of `cols` texels one after another.
    Mixed {
        /// Texels in a row.
        cols: usize,
        /// 64 texels a word, the first in the lowest bit.
        bits: Vec<u64>,
    },
}

impl Validity {
    /// Of a leaf with this alpha: `cols` texels of each row, 0 where invalid.
    pub fn of<'a>(cols: usize, rows: impl Iterator<Item = &'a [u8]>) -> Self {
        let (mut bits, mut count, mut valid) = (Vec::new(), 0, 0);
        for &alpha in rows.flatten() {
            if count % 64 == 0 {
                bits.push(0_u64);
            }
            if let Some(word) = bits.last_mut().filter(|_| alpha != 0) {
                *word |= 1 << (count % 64);
                valid += 1;
            }
            count += 1;
        }
        match valid {
            0 => Self::Empty,
            _ if valid == count => Self::Full,
            _ => Self::Mixed { cols, bits },
        }
    }

    /// Copies the validity of consecutive texels of a row, from (`row`, `col`) on.
    fn copy(&self, row: usize, col: usize, out: &mut [bool]) {
        match self {
            Self::Empty => out.fill(false),
            Self::Full => out.fill(true),
            Self::Mixed { cols, bits } => {
                for (at, valid) in (row * cols + col..).zip(out) {
                    *valid = bits[at / 64] >> (at % 64) & 1 == 1;
                }
            }
        }
    }
}

/// The coverage of a leaf's interior inside the outline, in a page's layout; `None` where all of it
/// is full.
///
/// `alpha` is that of the leaf, in the same layout. The distance of a texel is that of its center to
/// the nearest center of an invalid texel or of a place outside the outline, less half a texel: the
/// distance to the edge of the data.
#[must_use]
pub fn coverage<'a>(
    pyramid: &Pyramid,
    page: PageAddress,
    alpha: Option<&[u8]>,
    validity: impl Fn(PageAddress) -> &'a Validity,
) -> Option<Vec<u8>> {
    let sources = pyramid.sources(page, HALO);
    let inside = !sees_outside(pyramid, page);
    if inside && alpha.is_none() && sources.iter().all(|&leaf| *validity(leaf) == Validity::Full) {
        return None;
    }
    let side = pyramid.page_side() as usize;
    let around = Around::new(pyramid, page, validity);
    let down = around.distances_along_columns();
    let (rows, cols) = (around.rows - 2 * REACH, around.cols - 2 * REACH);
    let mut coverage = vec![0; side * side];
    let mut full = true;
    let mut nearest = vec![0; cols];
    for row in 0..rows {
        let down = &down[(row + REACH) * around.cols..][..around.cols];
        nearest.fill(u16::MAX);
        for (across, far) in (0..=2 * REACH).map(|across| (across, across.abs_diff(REACH))) {
            #[expect(clippy::cast_possible_truncation, reason = "at most the reach")]
            let far = (far * far) as u16;
            for (nearest, &down) in nearest.iter_mut().zip(&down[across..]) {
                *nearest = (*nearest).min(down * down + far);
            }
        }
        let to = (row + 1) * side + 1;
        let alpha = alpha.map(|alpha| &alpha[to..][..cols]);
        for (col, (code, &nearest)) in coverage[to..][..cols].iter_mut().zip(&nearest).enumerate() {
            *code = code_at(nearest, alpha.map_or(u8::MAX, |alpha| alpha[col]));
            full &= *code == u8::MAX;
        }
    }
    (!full).then_some(coverage)
}

/// The coverage at a squared distance, in texels, of a texel of this alpha.
fn code_at(nearest: u16, alpha: u8) -> u8 {
    /// Of opaque texels, and their shares. From 32½ texels on they are full.
    static CODES: LazyLock<Vec<(u8, f64)>> = LazyLock::new(|| {
        let share = |nearest: u32| {
            let distance = f64::from(nearest).sqrt() - 0.5;
            (distance / f64::from(FEATHER_TEXELS)).min(1.0)
        };
        (0..=HALO * HALO).map(share).map(|share| (code_of(share, u8::MAX), share)).collect()
    });
    let (code, share) = CODES.get(usize::from(nearest)).copied().unwrap_or((u8::MAX, 1.0));
    match alpha {
        0 => 0,
        u8::MAX => code,
        alpha => code_of(share, alpha),
    }
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "1 to 255")]
fn code_of(share: f64, alpha: u8) -> u8 {
    (share * f64::from(alpha)).round().max(1.0) as u8
}

/// Whether places outside the outline, that no pole or turn leads back from, are within the halo.
fn sees_outside(pyramid: &Pyramid, page: PageAddress) -> bool {
    let interior = pyramid.interior();
    let extent = pyramid.extent();
    let (rows, cols) = pyramid.interior_size(page);
    let near = |start: u32, length: u32, end: u32, before: bool, behind: bool| {
        before && start < HALO || behind && start + length + HALO > end
    };
    let no_pole = |contact| contact == PoleContact::None;
    let (north, south) = (no_pole(extent.north), no_pole(extent.south));
    near(page.row * interior, rows, extent.height, north, south)
        || near(page.col * interior, cols, extent.width, !extent.wraps, !extent.wraps)
}

/// Which texels in and around a leaf's interior are valid.
struct Around {
    rows: usize,
    cols: usize,
    valid: Vec<bool>,
}

impl Around {
    fn new<'a>(
        pyramid: &Pyramid,
        page: PageAddress,
        validity: impl Fn(PageAddress) -> &'a Validity,
    ) -> Self {
        let interior = pyramid.interior();
        let extent = pyramid.extent();
        let (page_rows, page_cols) = pyramid.interior_size(page);
        let (rows, cols) = (page_rows as usize + 2 * REACH, page_cols as usize + 2 * REACH);
        let reach = i64::from(HALO);
        let (top, left) =
            (i64::from(page.row * interior) - reach, i64::from(page.col * interior) - reach);

        // Columns of the window that come from consecutive columns of one leaf.
        let runs = |turned: bool| {
            let mut runs: Vec<(usize, u32, usize, usize)> = Vec::new();
            for to in 0..cols {
                let absolute = left + to as i64;
                if !extent.wraps && !(0..i64::from(extent.width)).contains(&absolute) {
                    continue;
                }
                let col = pyramid.extended_col(page.level, absolute, turned);
                let (leaf, from) = (col / interior, (col % interior) as usize);
                match runs.last_mut() {
                    Some((start, last, first, length))
                        if *start + *length == to && *last == leaf && *first + *length == from =>
                    {
                        *length += 1;
                    }
                    _ => runs.push((to, leaf, from, 1)),
                }
            }
            runs
        };
        let (straight, turned) = (runs(false), runs(true));
        let mut valid = vec![false; rows * cols];
        for (row, valid) in valid.chunks_exact_mut(cols).enumerate() {
            let absolute = top + row as i64;
            let outside = absolute < 0 && extent.north == PoleContact::None
                || absolute >= i64::from(extent.height) && extent.south == PoleContact::None;
            if outside {
                continue;
            }
            // At the finest level rows mirror onto rows.
            let source = pyramid.extended_row(page.level, absolute);
            for &(to, col, from, length) in if source.turned { &turned } else { &straight } {
                let leaf = PageAddress::new(page.level, source.row / interior, col);
                let row = (source.row % interior) as usize;
                validity(leaf).copy(row, from, &mut valid[to..to + length]);
            }
        }
        Self { rows, cols, valid }
    }

    /// For each place the rows to the nearest invalid place of its column, at most twice the
    /// reach.
    fn distances_along_columns(&self) -> Vec<u16> {
        #[expect(clippy::cast_possible_truncation, reason = "66")]
        const FAR: u16 = 2 * REACH as u16;
        let mut distances = vec![FAR; self.valid.len()];
        let mut pass = |rows: &mut dyn Iterator<Item = usize>| {
            let mut above = vec![FAR; self.cols];
            for row in rows {
                let at = row * self.cols..(row + 1) * self.cols;
                let places = distances[at.clone()].iter_mut().zip(&self.valid[at]);
                for ((distance, valid), above) in places.zip(&mut above) {
                    *above = if *valid { (*above + 1).min(FAR) } else { 0 };
                    *distance = (*distance).min(*above);
                }
            }
        };
        pass(&mut (0..self.rows));
        pass(&mut (0..self.rows).rev());
        distances
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn validity_comes_back_bit_by_bit() {
        let alpha: Vec<u8> = (0..90).map(|at| u8::from(at % 7 != 3)).collect();
        let validity = Validity::of(30, alpha.chunks(30));
        let mut out = vec![false; 30];
        for row in 0..3 {
            validity.copy(row, 0, &mut out);
            let expected: Vec<bool> = alpha[row * 30..][..30].iter().map(|&a| a != 0).collect();
            assert_eq!(out, expected);
        }
        assert_eq!(Validity::of(2, [&[0_u8, 0][..]].into_iter()), Validity::Empty);
        assert_eq!(Validity::of(2, [&[9_u8, 1][..]].into_iter()), Validity::Full);
    }
}
