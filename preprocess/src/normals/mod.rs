//! Normals of heights, on whatever grid those come.
//!
//! ```text
//!   heights of a leaf ──▶ kept until the last leaf that looks at them ──▶ normals of a leaf
//!   and of those around it, each made once                                (slope, codes)
//! ```
//!
//! A texel looks at its four neighbors on the finest level *extended*: around the antimeridian and over
//! the poles. What a leaf needs beyond its own heights are other leaves' texels, the same that those
//! show: so normals are the same whichever page shows them, and none is worse at a page's edge.
//!
//! # Precision
//!
//! Central differences over two texels: off by a sixth of a texel squared times the third derivatives
//! of the ground, and by half a texel times the second beside outlines and holes. Heights in whole
//! meters are heights on terraces: toward a pole of an equirectangular grid, where columns crowd, a
//! meter between two of them is a slope. Polar grids have no such place.

mod places;

mod slope;

use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;

use self::places::{Place, Places};
use crate::build::Leaves;
use crate::once::{OnceCache, OnceError, Overflow, Parcel};
use crate::origin::Origin;
use crate::raster::RasterError;
use crate::texel::{Planes, PlanesView};
use crate::tile::{Closed, Raw};
use areoid_formats::address::PageAddress;
use areoid_formats::grid::Grid;
use areoid_formats::normal;
use areoid_formats::pyramid::{PoleContact, Pyramid};

/// Leaves of normals from leaves of heights.
#[derive(Debug)]
pub struct Normals {
    heights: Box<dyn Origin>,
    kept: OnceCache<HeightLeaf>,
    places: Places,
}

/// The heights of a leaf's interior, row by row; NaN where there are none, and none at all in a leaf
/// without data.
#[derive(Debug)]
struct HeightLeaf {
    cols: usize,
    heights: Vec<f32>,
}

impl Normals {
    /// The normals of `heights`, in meters above the reference surface of their grid.
    #[must_use]
    pub fn new(heights: Box<dyn Origin>) -> Self {
        let places = Places::new(heights.grid());
        let kept = cache(heights.grid().pyramid(), None);
        Self { heights, kept, places }
    }

    fn pyramid(&self) -> &Pyramid {
        self.heights.grid().pyramid()
    }

    /// The heights of a leaf, made now if they were not yet.
    fn leaf(&self, page: PageAddress) -> Result<Arc<HeightLeaf>, RasterError> {
        let make = || Ok(HeightLeaf::new(self.pyramid(), page, self.heights.read(page)?));
        self.kept.get(page.col, page.row, make).map_err(|error| {
            let failed =
                |action, source| RasterError::io(action, std::path::Path::new("heights"))(source);
            match error {
                OnceError::Make(error) => error,
                OnceError::SetAside(source) => failed("set aside", source),
                OnceError::ReadBack(source) => failed("read back", source),
            }
        })
    }
}

/// Leaves of heights with their uses announced: one for each leaf of normals that looks at them.
fn cache(pyramid: &Pyramid, overflow: Option<&Arc<Overflow>>) -> OnceCache<HeightLeaf> {
    let (rows, cols) = pyramid.pages(pyramid.finest()).expect("a pyramid has a finest level");
    let mut uses = vec![0; rows as usize * cols as usize];
    for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
        for leaf in sources(pyramid, PageAddress::new(pyramid.finest(), row, col)) {
            uses[leaf.row as usize * cols as usize + leaf.col as usize] += 1;
        }
    }
    let uses = |col: u32, row: u32| uses[row as usize * cols as usize + col as usize];
    let mut kept = OnceCache::new((cols, rows), uses);
    overflow.into_iter().for_each(|overflow| kept.spill(Arc::clone(overflow)));
    kept
}

/// The leaves that the normals of `page` look at.
fn sources(pyramid: &Pyramid, page: PageAddress) -> Vec<PageAddress> {
    let mut found = pyramid.sources(page, Pyramid::BORDER);
    let interior = pyramid.interior();
    let (rows, cols) = pyramid.interior_size(page);
    let [top, left] = [page.row, page.col].map(|index| index * interior);
    for row in [top, top + rows - 1] {
        let Some(beside) = row_beside_pole(pyramid, row) else { continue };
        for col in (left..left + cols).flat_map(|col| across_pole(pyramid, col)) {
            found.push(PageAddress::new(page.level, beside / interior, col / interior));
        }
    }
    found.sort_unstable();
    found.dedup();
    found
}

/// The row next to one that lies on a pole with all of its centers.
fn row_beside_pole(pyramid: &Pyramid, row: u32) -> Option<u32> {
    let extent = pyramid.extent();
    let last = extent.height - 1;
    let beside = if row == 0 && extent.north == PoleContact::Posts {
        pyramid.extended_row(pyramid.finest(), -1)
    } else if row == last && extent.south == PoleContact::Posts {
        pyramid.extended_row(pyramid.finest(), i64::from(last) + 1)
    } else {
        return None;
    };
    Some(beside.row)
}

/// The columns of that row a quarter turn to the left and to the right of one, opposite one another.
fn across_pole(pyramid: &Pyramid, col: u32) -> [u32; 2] {
    let width = i64::from(pyramid.extent().width);
    let right = pyramid.extended_col(pyramid.finest(), i64::from(col) + width / 4, false);
    let left = pyramid.extended_col(pyramid.finest(), i64::from(right), true);
    [left, right]
}

impl Leaves for Normals {
    fn read(&self, page: PageAddress) -> Result<Option<Raw>, RasterError> {
        let pyramid = self.pyramid();
        let sources = sources(pyramid, page);
        let leaves = sources.iter().map(|&leaf| Ok((leaf, self.leaf(leaf)?)));
        let leaves = leaves.collect::<Result<BTreeMap<_, _>, RasterError>>()?;
        let raw = Around { pyramid, places: &self.places, leaves }.normals(page);
        self.release(&sources);
        Ok(raw)
    }

    fn skip(&self, page: PageAddress) {
        self.release(&sources(self.pyramid(), page));
    }

    fn source_error(
        &self,
        page: PageAddress,
        leaf: Option<&Closed<'_>>,
    ) -> Result<Option<f32>, RasterError> {
        // Nothing is held against the heights.
        self.heights.source_error(page, None)?;
        Ok(leaf.map(|leaf| if has_limits(leaf) { CLAMPED_CODES } else { ROUNDED_CODES }))
    }

    fn check_unchanged(&self) -> Result<(), RasterError> {
        self.heights.check_unchanged()
    }

    fn may_have_holes(&self) -> bool {
        self.heights.may_have_holes() || !self.places.are_everywhere()
    }
}

/// The most that a normal is rounded by, in codes.
const ROUNDED_CODES: f32 = 0.5;

/// The most that one is off whose codes are at their limits: a difference of two unit vectors is at
/// most 2.
const CLAMPED_CODES: f32 = 127.5;

/// Whether a code of a leaf is at its limits, where it may have been brought.
fn has_limits(leaf: &Closed<'_>) -> bool {
    let PlanesView::Color(planes) = leaf.planes else { return false };
    let valid = |at: usize| leaf.coverage.is_none_or(|coverage| coverage[at] != 0);
    planes.iter().any(|plane| {
        plane.iter().enumerate().any(|(at, &code)| matches!(code, 1 | u8::MAX) && valid(at))
    })
}

impl Normals {
    fn release(&self, sources: &[PageAddress]) {
        for leaf in sources {
            if self.kept.release(leaf.col, leaf.row) {
                // Nobody looked at it, and nobody will.
                self.heights.skip(*leaf);
            }
        }
    }
}

impl Origin for Normals {
    fn grid(&self) -> &Grid {
        self.heights.grid()
    }

    fn apart(&self) -> Box<dyn Origin> {
        Box::new(Self::new(self.heights.apart()))
    }

    fn spill(&mut self, overflow: &Arc<Overflow>) {
        self.heights.spill(overflow);
        self.kept = cache(self.pyramid(), Some(overflow));
    }

    fn decoded_blocks(&self) -> u64 {
        self.heights.decoded_blocks()
    }

    fn blocks(&self) -> u64 {
        self.heights.blocks()
    }

    fn decoded_for(&self, leaves: &[PageAddress]) -> u64 {
        let sources = leaves.iter().flat_map(|&leaf| sources(self.pyramid(), leaf));
        let mut sources: Vec<_> = sources.collect();
        sources.sort_unstable();
        sources.dedup();
        self.heights.decoded_for(&sources)
    }
}

/// A leaf and what its normals look at.
struct Around<'a> {
    pyramid: &'a Pyramid,
    places: &'a Places,
    leaves: BTreeMap<PageAddress, Arc<HeightLeaf>>,
}

impl Around<'_> {
    /// The normals of a leaf; `None` if none is valid.
    fn normals(&self, page: PageAddress) -> Option<Raw> {
        let own = &self.leaves[&page];
        if own.heights.is_empty() {
            return None;
        }
        let interior = self.pyramid.interior();
        let side = self.pyramid.page_side() as usize;
        let (rows, cols) = self.pyramid.interior_size(page);
        let [top, left] = [page.row, page.col].map(|index| index * interior);
        let mut planes = [0; 3].map(|code: u8| vec![code; side * side]);
        let mut alpha = vec![0; side * side];
        let mut valid = 0;
        let line = |row: i64| self.line(row, left, cols);
        let (mut above, mut here) = (line(i64::from(top) - 1), line(top.into()));
        for row in 0..rows {
            let below = line(i64::from(top + row) + 1);
            let beside_pole = row_beside_pole(self.pyramid, top + row);
            for col in 0..cols {
                let at = col as usize + 1;
                if here[at].at.is_nan() {
                    continue;
                }
                let across = match beside_pole {
                    Some(row) => {
                        across_pole(self.pyramid, left + col).map(|col| self.place(row, col))
                    }
                    None => [here[at - 1], here[at + 1]],
                };
                let ground = slope::normal(here[at], [across, [above[at], below[at]]]);
                let codes = normal::codes(normal::exact_codes(ground, here[at].up));
                let to = (row as usize + 1) * side + at;
                for (plane, code) in planes.iter_mut().zip(codes) {
                    plane[to] = code;
                }
                alpha[to] = u8::MAX;
                valid += 1;
            }
            above = std::mem::replace(&mut here, below);
        }
        let alpha = (valid < rows * cols).then_some(alpha);
        let planes = Planes::Color(planes);
        (valid > 0).then_some(Raw { planes, alpha })
    }

    /// The places of `cols` texels of a row of the level extended from column `left` on, and of one
    /// more on each side; nowhere if there is no height, or only one repeated past the outline.
    fn line(&self, row: i64, left: u32, cols: u32) -> Vec<Place> {
        let (extent, finest) = (self.pyramid.extent(), self.pyramid.finest());
        let source = self.pyramid.extended_row(finest, row);
        let is_repeated = i64::from(source.row) != row && !source.turned;
        let span = i64::from(left) - 1..i64::from(left + cols) + 1;
        span.map(|col| {
            if is_repeated || !extent.wraps && !(0..i64::from(extent.width)).contains(&col) {
                return Place::NOWHERE;
            }
            self.place(source.row, self.pyramid.extended_col(finest, col, source.turned))
        })
        .collect()
    }

    /// Where the ground is at a texel; nowhere if there is no height.
    fn place(&self, row: u32, col: u32) -> Place {
        let interior = self.pyramid.interior();
        let leaf = PageAddress::new(self.pyramid.finest(), row / interior, col / interior);
        let height = self.leaves[&leaf].at((row % interior) as usize, (col % interior) as usize);
        self.places.foot(row, col).raised(height.into())
    }
}

impl HeightLeaf {
    fn new(pyramid: &Pyramid, page: PageAddress, raw: Option<Raw>) -> Self {
        let side = pyramid.page_side() as usize;
        let (rows, cols) = pyramid.interior_size(page);
        let cols = cols as usize;
        let Some(Raw { planes, alpha, .. }) = raw else {
            return Self { cols, heights: Vec::new() };
        };
        let height = |at: usize| match &planes {
            _ if alpha.as_ref().is_some_and(|alpha| alpha[at] == 0) => f32::NAN,
            Planes::Height(plane) => plane[at],
            Planes::WholeHeight(plane) => plane[at].into(),
            Planes::Color(_) => panic!("normals are made of heights"),
        };
        let row = |row: usize| (row + 1) * side + 1..(row + 1) * side + 1 + cols;
        let heights = (0..rows as usize).flat_map(row).map(height).collect();
        Self { cols, heights }
    }

    fn at(&self, row: usize, col: usize) -> f32 {
        self.heights.get(row * self.cols + col).copied().unwrap_or(f32::NAN)
    }
}

impl Parcel for HeightLeaf {
    fn bytes(&self) -> &[u8] {
        bytemuck::cast_slice(&self.heights)
    }

    fn hollow(&self) -> Self {
        Self { cols: self.cols, heights: Vec::new() }
    }

    fn refilled(
        &self,
        len: usize,
        load: impl FnOnce(&mut [u8]) -> io::Result<()>,
    ) -> io::Result<Self> {
        let mut heights = vec![0.0; len / size_of::<f32>()];
        load(bytemuck::cast_slice_mut(&mut heights))?;
        Ok(Self { cols: self.cols, heights })
    }
}

#[cfg(test)]
mod tests;
