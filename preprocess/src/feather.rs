//! Coverage: how much of a texel shows in a composition, from its distance to where data end.
//!
//! At the finest level coverage rises from almost nothing beside a hole or the outline to full
//! [`FEATHER_TEXELS`] farther in, linearly with the Euclidean distance. It is made once, there, and
//! coarser levels average it, so that where two datasets blend does not depend on the level shown.

use std::collections::HashMap;
use std::sync::Arc;

use areoid_formats::address::PageAddress;
use areoid_formats::pyramid::{PoleContact, Pyramid};

use crate::tile::Raw;

/// Leaf texels over which coverage rises to full.
pub const FEATHER_TEXELS: u32 = 32;

/// Texels around a leaf's interior whose validity decides its coverage.
pub const HALO: u32 = FEATHER_TEXELS + 1;

/// Leaves as read, by page; a leaf without a valid texel is present as `None`.
pub type Raws = HashMap<PageAddress, Option<Arc<Raw>>>;

/// The coverage of a leaf's interior inside the outline; `None` where all of it is full.
///
/// The distance of a texel is that of its center to the nearest center of an invalid texel or of
/// a place outside the outline, less half a texel: the distance to the edge of the data.
///
/// # Panics
///
/// If a leaf within [`HALO`] texels is not among `raws`: the schedule sees to it.
#[must_use]
pub fn coverage(pyramid: &Pyramid, page: PageAddress, raw: &Raw, raws: &Raws) -> Option<Vec<u8>> {
    let valid = Validity::around(pyramid, page, raws);
    if valid.whole() && raw.alpha.is_none() {
        return None;
    }
    let down = valid.distances_along_columns();
    let reach = HALO as usize;
    let mut coverage = vec![0; raw.rows * raw.cols];
    let mut full = true;
    for row in 0..raw.rows {
        for col in 0..raw.cols {
            let alpha = raw.alpha.as_ref().map_or(u8::MAX, |alpha| alpha[row * raw.cols + col]);
            if alpha == 0 {
                full = false;
                continue;
            }
            let center = (row + reach) * valid.cols + col + reach;
            let nearest = (0..=2 * reach)
                .map(|across| {
                    let vertical = u32::from(down[center + across - reach]);
                    let across = across.abs_diff(reach);
                    #[expect(clippy::cast_possible_truncation, reason = "at most the reach")]
                    let across = across as u32;
                    vertical * vertical + across * across
                })
                .min()
                .unwrap_or(u32::MAX);
            let distance = f64::from(nearest).sqrt() - 0.5;
            let share = (distance / f64::from(FEATHER_TEXELS)).min(1.0);
            let code = (share * f64::from(alpha)).round().max(1.0);
            #[expect(clippy::cast_possible_truncation, reason = "1 to 255")]
            #[expect(clippy::cast_sign_loss, reason = "1 to 255")]
            {
                coverage[row * raw.cols + col] = code as u8;
            }
            full &= code >= 255.0;
        }
    }
    (!full).then_some(coverage)
}

/// Which texels in and around a leaf's interior are valid.
struct Validity {
    rows: usize,
    cols: usize,
    valid: Vec<bool>,
}

impl Validity {
    fn around(pyramid: &Pyramid, page: PageAddress, raws: &Raws) -> Self {
        let interior = pyramid.interior();
        let size = pyramid.size(page.level).expect("the page is this pyramid's");
        let extent = pyramid.extent();
        let (page_rows, page_cols) = pyramid.interior_size(page);
        let reach = i64::from(HALO);
        let (rows, cols) =
            (page_rows as usize + 2 * HALO as usize, page_cols as usize + 2 * HALO as usize);
        let (top, left) =
            (i64::from(page.row * interior) - reach, i64::from(page.col * interior) - reach);

        let mut valid = vec![false; rows * cols];
        for row in 0..rows {
            let absolute = top + row as i64;
            let outside = absolute < 0 && extent.north == PoleContact::None
                || absolute >= i64::from(size.height) && extent.south == PoleContact::None;
            if outside {
                continue;
            }
            // At the finest level rows mirror onto rows.
            let source = pyramid.extended_row(page.level, absolute);
            for col in 0..cols {
                let absolute = left + col as i64;
                if !extent.wraps && !(0..i64::from(size.width)).contains(&absolute) {
                    continue;
                }
                let from = pyramid.extended_col(page.level, absolute, source.turned);
                let leaf = PageAddress::new(page.level, source.row / interior, from / interior);
                let raw = raws.get(&leaf).expect("what a feather reaches was read");
                valid[row * cols + col] = raw.as_ref().is_some_and(|raw| {
                    let at =
                        (source.row % interior) as usize * raw.cols + (from % interior) as usize;
                    raw.alpha.as_ref().is_none_or(|alpha| alpha[at] != 0)
                });
            }
        }
        Self { rows, cols, valid }
    }

    fn whole(&self) -> bool {
        self.valid.iter().all(|&valid| valid)
    }

    /// For each place the rows to the nearest invalid place of its column, at most twice the
    /// reach.
    fn distances_along_columns(&self) -> Vec<u8> {
        #[expect(clippy::cast_possible_truncation, reason = "twice the reach is below 255")]
        const FAR: u8 = 2 * HALO as u8;
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
