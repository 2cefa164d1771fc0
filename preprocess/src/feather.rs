//! Coverage: how much of a texel shows in a composition, from its distance to where data end.
//!
//! At the finest level coverage rises from almost nothing beside a hole or the outline to full
//! [`FEATHER_TEXELS`] farther in, linearly with the Euclidean distance. It is made once, there, and
//! coarser levels average it, so that where two datasets blend does not depend on the level shown.

use std::sync::LazyLock;

use areoid_formats::address::PageAddress;
use areoid_formats::lanes::{self, greatest, least};
use areoid_formats::pyramid::{PoleContact, Pyramid};

/// Leaf texels over which coverage rises to full.
pub const FEATHER_TEXELS: u32 = 32;

/// Texels around a leaf's interior whose validity decides its coverage.
pub const HALO: u32 = FEATHER_TEXELS + 1;

const REACH: usize = HALO as usize;

/// From here on coverage is full: farther is the same.
#[expect(clippy::cast_possible_truncation, reason = "33")]
const FAR: u8 = HALO as u8;

const FAR_SQUARED: u16 = FAR as u16 * FAR as u16;

/// Which texels of a leaf's interior are valid.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Validity {
    /// None.
    Empty,
    /// All of them.
    Full,
    /// Those with a one, a bit each.
    Mixed {
        /// Texels in a row.
        cols: usize,
        /// 8 texels a byte, the first in the lowest bit. A row begins with a byte of its own, and
        /// takes one for each 8 texels and another for the rest; a last byte follows the last row.
        bits: Vec<u8>,
    },
}

impl Validity {
    /// Of a leaf with this alpha: `cols` texels of each row, 0 where invalid.
    pub fn of<'a>(cols: usize, rows: impl Iterator<Item = &'a [u8]>) -> Self {
        let mut bits = Vec::new();
        let mut count = 0;
        for row in rows {
            let (eights, rest) = row.as_chunks();
            bits.extend(eights.iter().map(|&alpha| lanes::present(alpha)));
            let mut last = [0; 8];
            last[..rest.len()].copy_from_slice(rest);
            bits.push(lanes::present(last));
            count += row.len();
        }
        bits.push(0);
        let valid: u32 = bits.iter().map(|bits| bits.count_ones()).sum();
        match valid as usize {
            0 => Self::Empty,
            valid if valid == count => Self::Full,
            _ => Self::Mixed { cols, bits },
        }
    }

    /// Bytes of the bits of a leaf.
    pub(crate) const fn length(rows: usize, cols: usize) -> usize {
        rows * (cols / 8 + 1) + 1
    }

    /// Copies the validity of consecutive texels of a row, from (`row`, `col`) on: 255 or 0.
    fn copy(&self, row: usize, col: usize, out: &mut [u8]) {
        match self {
            Self::Empty => out.fill(0),
            Self::Full => out.fill(u8::MAX),
            Self::Mixed { cols, bits } => {
                // What follows the row is read as well, and not looked at.
                let row = &bits[row * (cols / 8 + 1) + col / 8..];
                let (eights, rest) = out.as_chunks_mut();
                let pairs = || row.iter().zip(&row[1..]);
                let eight = |(&low, &high): (&u8, &u8)| {
                    let [bits, _] = (u16::from_le_bytes([low, high]) >> (col % 8)).to_le_bytes();
                    lanes::spread(bits)
                };
                for (out, pair) in eights.iter_mut().zip(pairs()) {
                    *out = eight(pair);
                }
                if let Some(pair) = pairs().nth(eights.len()) {
                    rest.copy_from_slice(&eight(pair)[..rest.len()]);
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
    let mut coverage = vec![0; side * side];
    let cols = around.cols - 2 * REACH;
    for row in 0..around.rows - 2 * REACH {
        let to = (row + 1) * side + 1;
        let down = &around.distances[(row + REACH) * around.stride..][..around.stride];
        let alpha = alpha.map(|alpha| &alpha[to..][..cols]);
        let out = &mut coverage[to..][..cols];
        lanes::vectorized(FeatheredRow { down, alpha, out });
    }
    let is_full =
        |row: usize| lanes::none(&coverage[(row + 1) * side + 1..][..cols], |code| code != u8::MAX);
    let full = (0..around.rows - 2 * REACH).all(is_full);
    (!full).then_some(coverage)
}

/// The coverage of a row, all zero before.
struct FeatheredRow<'a> {
    /// Distances along the columns, those of [`REACH`] columns more on both sides.
    down: &'a [u8],
    alpha: Option<&'a [u8]>,
    out: &'a mut [u8],
}

/// Texels of a row that go together.
const BLOCK: usize = 64;

impl lanes::Wide for FeatheredRow<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { down, alpha, out } = self;
        let codes = &*CODES;
        for (block, out) in out.chunks_mut(BLOCK).enumerate() {
            let from = block * BLOCK;
            let down: &[u8; BLOCK + 2 * REACH] = down[from..].first_chunk().expect("whole blocks");
            let farthest =
                down[REACH..REACH + BLOCK].iter().fold(0, |far, &down| greatest(down, far));
            if farthest == 0 {
                continue;
            }
            let nearest = if down.iter().fold(FAR, |near, &down| least(down, near)) == FAR {
                [FAR_SQUARED; BLOCK]
            } else {
                nearest(down, farthest.into())
            };
            for (code, &nearest) in out.iter_mut().zip(&nearest) {
                *code = codes[usize::from(nearest)];
            }
            let Some(alpha) = alpha.map(|alpha| &alpha[from..][..out.len()]) else { continue };
            let hazy = alpha.iter().fold(false, |hazy, &alpha| hazy | (alpha.wrapping_add(1) > 1));
            for ((code, &nearest), &alpha) in
                out.iter_mut().zip(&nearest).zip(alpha).filter(|_| hazy)
            {
                *code = if alpha == 0 { 0 } else { code_at(nearest, alpha) };
            }
        }
    }
}

/// Squared distances to the nearest invalid places, if no texel of the block has one farther than
/// `farthest` in its column: no other column as far away as that has one nearer.
#[inline(always)]
fn nearest(down: &[u8; BLOCK + 2 * REACH], farthest: usize) -> [u16; BLOCK] {
    let squares = down.map(|down| u16::from(down) * u16::from(down));
    let mut nearest = [FAR_SQUARED; BLOCK];
    for across in 0..=farthest {
        #[expect(clippy::cast_possible_truncation, reason = "at most the reach")]
        let far = (across * across) as u16;
        let (left, right) =
            (&squares[REACH - across..][..BLOCK], &squares[REACH + across..][..BLOCK]);
        for ((nearest, &left), &right) in nearest.iter_mut().zip(left).zip(right) {
            *nearest = least(least(left, right) + far, *nearest);
        }
    }
    nearest
}

/// A texel's coverage where it is opaque, by its squared distance; that of an invalid one is 0.
static CODES: LazyLock<[u8; FAR_SQUARED as usize + 1]> = LazyLock::new(|| {
    std::array::from_fn(|nearest| match u16::try_from(nearest) {
        Ok(nearest) if nearest > 0 => code_at(nearest, u8::MAX),
        _ => 0,
    })
});

/// The coverage of a valid texel of this alpha at a squared distance.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "1 to 255")]
fn code_at(nearest: u16, alpha: u8) -> u8 {
    let distance = f64::from(nearest).sqrt() - 0.5;
    let share = (distance / f64::from(FEATHER_TEXELS)).min(1.0);
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

/// How far places in and around a leaf's interior are from the nearest invalid one of their column.
struct Around {
    rows: usize,
    cols: usize,
    /// Columns in a row, and more that count as valid, so that there are whole blocks.
    stride: usize,
    /// Rows, at most [`FAR`].
    distances: Vec<u8>,
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
        let stride = (page_cols as usize).next_multiple_of(BLOCK) + 2 * REACH;
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
        let mut distances = vec![0; rows * stride];
        let (mut valid, mut above) = (vec![0; stride], vec![FAR; stride]);
        valid[cols..].fill(u8::MAX);
        for (row, distances) in distances.chunks_exact_mut(stride).enumerate() {
            let absolute = top + row as i64;
            let outside = absolute < 0 && extent.north == PoleContact::None
                || absolute >= i64::from(extent.height) && extent.south == PoleContact::None;
            valid[..cols].fill(0);
            if !outside {
                // At the finest level rows mirror onto rows.
                let source = pyramid.extended_row(page.level, absolute);
                for &(to, col, from, length) in if source.turned { &turned } else { &straight } {
                    let leaf = PageAddress::new(page.level, source.row / interior, col);
                    let row = (source.row % interior) as usize;
                    validity(leaf).copy(row, from, &mut valid[to..to + length]);
                }
            }
            for ((distance, above), valid) in distances.iter_mut().zip(&mut above).zip(&valid) {
                *above = least(*above + 1, FAR) & valid;
                *distance = *above;
            }
        }
        let mut below = vec![FAR; stride];
        for distances in distances.chunks_exact_mut(stride).rev() {
            for (distance, below) in distances.iter_mut().zip(&mut below) {
                *below = least(*below + 1, *distance);
                *distance = *below;
            }
        }
        Self { rows, cols, stride, distances }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn validity_comes_back_bit_by_bit() {
        let alpha: Vec<u8> = (0..90).map(|at| if at % 7 == 3 { 0 } else { at }).collect();
        let validity = Validity::of(30, alpha.chunks(30));
        for (row, alpha) in alpha.chunks(30).enumerate() {
            for from in 0..30 {
                let mut out = vec![1; 30 - from];
                validity.copy(row, from, &mut out);
                let expected = alpha[from..].iter().map(|&alpha| 255 * u8::from(alpha != 0));
                assert_eq!(out, expected.collect::<Vec<_>>());
            }
        }
        assert_eq!(Validity::of(2, [&[0_u8, 0][..]].into_iter()), Validity::Empty);
        assert_eq!(Validity::of(2, [&[9_u8, 1][..]].into_iter()), Validity::Full);
    }
}
