//! Pixels on one grid as what a dataset on another was made from.
//!
//! Nothing of what leaves are made with is used: each pixel finds its place among the texels through
//! the body, one by one.
//!
//! Which texels have data is known where the pixels say it with one voice: a texel has the validity
//! of the pixel whose cell its center lies in, or of most of those in its footprint. Those of the four
//! texels around a pixel are no farther from it than two footprints and a pixel.

use std::ops::Range;

use areoid_formats::grid::{Grid, Placement, TexelPoint};
use areoid_formats::page::Kind;
use areoid_formats::pyramid::{Extent, Pyramid};

use super::OtherBody;
use super::rasters::Rasters;
use super::source::{Patch, Rect, Source as _};
use super::tile::{Footprint, TargetTile};
use super::transform::{Precision, Transform};
use crate::mosaic::Layout;
use crate::raster::RasterError;
use crate::truth::{Around, Sample, Truth};

/// Pixels along a side of a parcel.
const PARCEL: u32 = 512;

/// Pixels beside a parcel that are looked at, too: texels of up to 21 pixels are known by them.
const MARGIN: u32 = 64;

/// Pixels along a side of what is taken to have texels of one size.
const PATCH: u32 = 32;

/// How far from a pole a post on it may be put, in pixels.
const POST_PX: f64 = 1e-9;

/// The pixels that a resampled dataset was made from.
#[derive(Debug)]
pub struct SourcePixels {
    grid: Grid,
    transform: Transform,
    rasters: Rasters,
    parcels: Vec<Rect>,
}

impl SourcePixels {
    /// Those of `layout`, `kind` at `placement`, under `grid`.
    ///
    /// # Errors
    ///
    /// [`OtherBody`].
    pub fn new(
        grid: Grid,
        layout: &Layout,
        placement: Placement,
        kind: Kind,
    ) -> Result<Self, OtherBody> {
        let transform = Transform::new(&grid.placement(), &placement, Precision::Exact);
        let transform = transform.ok_or(OtherBody)?;
        let span = |start: u32, length: u32| start..(start + PARCEL).min(length);
        let parcels = (0..placement.height).step_by(PARCEL as usize).flat_map(|row| {
            (0..placement.width).step_by(PARCEL as usize).map(move |col| Rect {
                cols: span(col, placement.width),
                rows: span(row, placement.height),
            })
        });
        let parcels: Vec<Rect> = parcels.collect();
        let read: Vec<Rect> = parcels.iter().map(|rect| with_margin(rect, &placement)).collect();
        let rasters = Rasters::new(layout, placement, kind, &read);
        Ok(Self { grid, transform, rasters, parcels })
    }

    /// Whether any of them may lie under the grid.
    #[must_use]
    pub fn are_on_grid(&self) -> bool {
        let Extent { width, height, .. } = self.grid.pyramid().extent();
        let whole = TargetTile { row: 0, col: 0, rows: height as usize, cols: width as usize };
        self.transform.range(whole).is_some()
    }

    /// Where a pixel's center lies in the grid's texels, column first; `None` outside the outline.
    fn texel(&self, [row, col]: [u32; 2]) -> Option<TexelPoint> {
        let (u, v) = (f64::from(col), f64::from(row));
        // A post on a pole may lie past it by rounding.
        let inward = if row == 0 { POST_PX } else { -POST_PX };
        let (row, col) =
            self.transform.back(u, v).or_else(|| self.transform.back(u, v + inward))?;
        let Extent { width, height, .. } = self.grid.pyramid().extent();
        let (x, y) = (col + 0.5, row + 0.5);
        let inside =
            (0.0..=f64::from(width)).contains(&x) && (0.0..=f64::from(height)).contains(&y);
        inside.then_some(TexelPoint { x, y })
    }

    fn sample(&self, pixel: [u32; 2], value: Option<[f64; 3]>, around: Around) -> Option<Sample> {
        let texel = self.texel(pixel)?;
        let at = self.grid.window_from_texel(self.grid.pyramid().finest(), texel);
        let border = f64::from(Pyramid::BORDER);
        Some(Sample { leaf: at.page, x: at.x - border, y: at.y - border, value, around })
    }

    /// How far the pixels are, along columns and rows, that make the texels around one of `rect`;
    /// `None` where that is not known, or too far.
    fn reach(&self, rect: &Rect) -> Option<[u32; 2]> {
        let ends = |range: &Range<u32>| [range.start, range.end - 1];
        let probes = ends(&rect.rows).map(|row| ends(&rect.cols).map(|col| [row, col]));
        let mut reach = [0.0_f64; 2];
        for probe in probes.concat() {
            let TexelPoint { x, y } = self.texel(probe)?;
            #[expect(clippy::cast_possible_truncation, reason = "inside the grid")]
            let [row, col] = [y, x].map(|place| place.floor() as i64);
            let Footprint { texel_u, texel_v, .. } =
                self.transform.footprint(TargetTile { row, col, rows: 1, cols: 1 });
            reach = [reach[0].max(texel_u), reach[1].max(texel_v)];
        }
        // Half of it again for texels that grow between the corners.
        let reach = reach.map(|texel| (3.0 * texel + 1.0).ceil());
        let is_near = reach.iter().all(|&pixels| pixels <= f64::from(MARGIN));
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "at most the margin"
        )]
        let reach = is_near.then(|| reach.map(|pixels| pixels as u32));
        reach
    }
}

/// A rectangle and what is beside it, inside the source.
fn with_margin(rect: &Rect, source: &Placement) -> Rect {
    let wide = |range: &Range<u32>, length: u32| {
        range.start.saturating_sub(MARGIN)..(range.end + MARGIN).min(length)
    };
    Rect { cols: wide(&rect.cols, source.width), rows: wide(&rect.rows, source.height) }
}

/// How many pixels of a rectangle have data, above and to the left of each corner.
struct Counts<'a> {
    rect: &'a Rect,
    counts: Vec<u32>,
}

impl<'a> Counts<'a> {
    fn new(rect: &'a Rect, has: impl Fn(usize) -> bool) -> Self {
        let cols = rect.cols.len();
        let mut counts = vec![0; (cols + 1) * (rect.rows.len() + 1)];
        for row in 0..rect.rows.len() {
            let mut line = 0;
            for col in 0..cols {
                line += u32::from(has(row * cols + col));
                let at = (row + 1) * (cols + 1) + col + 1;
                counts[at] = counts[at - cols - 1] + line;
            }
        }
        Self { rect, counts }
    }

    /// What the pixels no farther than `reach` from one have together.
    fn around(&self, [row, col]: [u32; 2], [across, down]: [u32; 2]) -> Around {
        let Rect { cols, rows } = self.rect;
        let inside = |at: u32, reach: u32, range: &Range<u32>| {
            at >= range.start + reach && at + reach < range.end
        };
        if !inside(col, across, cols) || !inside(row, down, rows) {
            return Around::Unknown;
        }
        let (left, top) =
            ((col - across - cols.start) as usize, (row - down - rows.start) as usize);
        let (wide, high) = (2 * across + 1, 2 * down + 1);
        let (right, bottom) = (left + wide as usize, top + high as usize);
        let at = |row: usize, col: usize| self.counts[row * (cols.len() + 1) + col];
        match at(bottom, right) + at(top, left) - at(top, right) - at(bottom, left) {
            0 => Around::Nothing,
            count if count == wide * high => Around::Data,
            _ => Around::Unknown,
        }
    }
}

impl Truth for SourcePixels {
    fn parcels(&self) -> u64 {
        self.parcels.len() as u64
    }

    fn samples(&self, parcel: u64) -> Result<Vec<Sample>, RasterError> {
        let Some(rect) = usize::try_from(parcel).ok().and_then(|at| self.parcels.get(at)) else {
            return Ok(Vec::new());
        };
        let read = with_margin(rect, self.transform.source());
        let mut patch = Patch::default();
        patch.read(&self.rasters, &read)?;
        let Patch { heights, codes, alpha } = &patch;
        let value = |at: usize| match self.rasters.kind() {
            Kind::Height => (!heights[at].is_nan()).then(|| [f64::from(heights[at]), 0.0, 0.0]),
            Kind::Color | Kind::Normal => {
                (alpha[at] != 0).then(|| codes.each_ref().map(|plane| f64::from(plane[at])))
            }
        };
        let counts = Counts::new(&read, |at| value(at).is_some());
        let mut samples = Vec::new();
        for piece in pieces(rect) {
            let reach = self.reach(&piece);
            for row in piece.rows {
                let line = (row - read.rows.start) as usize * read.cols.len();
                for col in piece.cols.clone() {
                    let value = value(line + (col - read.cols.start) as usize);
                    let around =
                        reach.map_or(Around::Unknown, |reach| counts.around([row, col], reach));
                    if value.is_some() || around == Around::Nothing {
                        samples.extend(self.sample([row, col], value, around));
                    }
                }
            }
        }
        Ok(samples)
    }

    fn is_texels(&self) -> bool {
        false
    }
}

/// A rectangle in squares of [`PATCH`] pixels.
fn pieces(rect: &Rect) -> impl Iterator<Item = Rect> + use<> {
    let cut = |range: &Range<u32>| {
        let end = range.end;
        range.clone().step_by(PATCH as usize).map(move |start| start..(start + PATCH).min(end))
    };
    let cols = cut(&rect.cols);
    cut(&rect.rows)
        .flat_map(move |rows| cols.clone().map(move |cols| Rect { cols, rows: rows.clone() }))
}
