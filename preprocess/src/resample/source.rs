//! What is resampled: pixels by the rectangle.

use std::fmt::Debug;
use std::ops::Range;
use std::path::Path;

use areoid_formats::lanes;
use areoid_formats::page::Kind;
use areoid_formats::pyramid::Extent;

use crate::raster::RasterError;

/// A rectangle of a source's pixels, not empty and inside it.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Rect {
    /// Columns.
    pub cols: Range<u32>,
    /// Rows, counted downward.
    pub rows: Range<u32>,
}

/// Where pixels go. The planes begin with a rectangle's first pixel.
#[derive(Debug)]
pub enum Pixels<'a> {
    /// Meters.
    Heights(&'a mut [f32]),
    /// sRGB codes.
    Colors {
        /// Red, green and blue.
        planes: [&'a mut [u8]; 3],
        /// Alpha, at least 1 where there is data.
        alpha: &'a mut [u8],
    },
}

/// A raster, or several on one grid, over whatever cache of blocks.
///
/// # Contract
///
/// * Any thread may call anything at any time.
/// * [`Self::read`] writes finite heights, or codes and their alpha, where there is data, and
///   leaves pixels as they were where there is none: no sentinel ever comes out.
/// * Each of the rectangles that [`PreparedSource::reads`](super::prepare::PreparedSource::reads)
///   lists for a tile is read once for every time the tile is made, which is once if its uses were
///   announced.
pub trait Source: Send + Sync + Debug {
    /// Its pixels, and what continues them past their edges.
    fn extent(&self) -> Extent;

    /// Heights, or colors.
    fn kind(&self) -> Kind;

    /// What errors name.
    fn path(&self) -> &Path;

    /// Lays the pixels of `rect` over planes whose rows are `stride` apart.
    ///
    /// # Errors
    ///
    /// [`RasterError`] if a block cannot be read.
    fn read(&self, rect: &Rect, pixels: Pixels<'_>, stride: usize) -> Result<(), RasterError>;
}

/// The pixels of a rectangle, in memory that the next one uses again.
#[derive(Debug, Default)]
pub(super) struct Patch {
    /// Meters, NaN where there are none.
    pub(super) heights: Vec<f32>,
    /// Red, green and blue codes.
    pub(super) codes: [Vec<u8>; 3],
    /// Alpha beside codes, 0 where there are none.
    pub(super) alpha: Vec<u8>,
}

impl Patch {
    /// Whether there is data in a rectangle of what was read as `rect`, both of the same source of `kind`.
    pub(super) fn has_data(&self, kind: Kind, rect: &Rect, part: &Rect) -> bool {
        let stride = rect.cols.len();
        let from = (part.cols.start - rect.cols.start) as usize;
        let rows = part.rows.start - rect.rows.start..part.rows.end - rect.rows.start;
        let line = |row: u32| {
            let first = row as usize * stride + from;
            first..first + part.cols.len()
        };
        rows.map(line).any(|line| match kind {
            Kind::Height => !lanes::none(&self.heights[line], |height| !height.is_nan()),
            Kind::Color | Kind::Normal => !lanes::none(&self.alpha[line], |alpha| alpha != 0),
        })
    }

    /// Reads `rect`, row by row, by its source's kind.
    ///
    /// # Errors
    ///
    /// That of [`Source::read`].
    pub(super) fn read(&mut self, source: &dyn Source, rect: &Rect) -> Result<(), RasterError> {
        let (cols, count) = (rect.cols.len(), rect.cols.len() * rect.rows.len());
        match source.kind() {
            Kind::Height => {
                self.heights.clear();
                self.heights.resize(count, f32::NAN);
                source.read(rect, Pixels::Heights(&mut self.heights), cols)
            }
            Kind::Color | Kind::Normal => {
                self.codes.iter_mut().for_each(|plane| plane.resize(count, 0));
                self.alpha.clear();
                self.alpha.resize(count, 0);
                let planes = self.codes.each_mut().map(|plane| &mut plane[..]);
                source.read(rect, Pixels::Colors { planes, alpha: &mut self.alpha }, cols)
            }
        }
    }
}

/// The twin in memory.
#[cfg(test)]
pub(crate) mod test_support {
    use super::*;
    use std::sync::Mutex;

    /// Pixels in memory: heights that are NaN where there are none, or codes.
    #[derive(Debug)]
    pub(crate) struct InMemory {
        pub(crate) extent: Extent,
        pub(crate) heights: Vec<f32>,
        /// Red, green, blue and alpha of each pixel, of a source of colors.
        pub(crate) colors: Option<Vec<[u8; 4]>>,
        /// The rectangles that were read.
        pub(crate) read: Mutex<Vec<Rect>>,
    }

    impl InMemory {
        /// Heights by column and row.
        pub(crate) fn heights(extent: Extent, height: impl Fn(u32, u32) -> f32) -> Self {
            let pixels = (0..extent.height)
                .flat_map(|row| (0..extent.width).map(move |col| (col, row)))
                .map(|(col, row)| height(col, row));
            Self { extent, heights: pixels.collect(), colors: None, read: Mutex::default() }
        }

        /// Colors by column and row.
        pub(crate) fn colors(extent: Extent, color: impl Fn(u32, u32) -> [u8; 4]) -> Self {
            let pixels = (0..extent.height)
                .flat_map(|row| (0..extent.width).map(move |col| (col, row)))
                .map(|(col, row)| color(col, row));
            let colors = Some(pixels.collect());
            Self { extent, heights: Vec::new(), colors, read: Mutex::default() }
        }
    }

    impl Source for InMemory {
        fn extent(&self) -> Extent {
            self.extent
        }

        fn kind(&self) -> Kind {
            if self.colors.is_some() { Kind::Color } else { Kind::Height }
        }

        fn path(&self) -> &Path {
            Path::new("memory.tif")
        }

        fn read(&self, rect: &Rect, pixels: Pixels<'_>, stride: usize) -> Result<(), RasterError> {
            self.read.lock().unwrap().push(rect.clone());
            let places = rect.rows.clone().enumerate().flat_map(|(down, row)| {
                rect.cols.clone().enumerate().map(move |(right, col)| {
                    (
                        down * stride + right,
                        row as usize * self.extent.width as usize + col as usize,
                    )
                })
            });
            match pixels {
                Pixels::Heights(out) => {
                    for (to, from) in places.filter(|&(_, from)| !self.heights[from].is_nan()) {
                        out[to] = self.heights[from];
                    }
                }
                Pixels::Colors { planes, alpha } => {
                    let colors = self.colors.as_ref().expect("a source of colors");
                    for (to, from) in places.filter(|&(_, from)| colors[from][3] != 0) {
                        for channel in 0..3 {
                            planes[channel][to] = colors[from][channel];
                        }
                        alpha[to] = colors[from][3];
                    }
                }
            }
            Ok(())
        }
    }
}
