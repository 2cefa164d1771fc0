//! The part of a source that a target tile's taps lie in, continuous whatever edges it crosses.

use std::sync::Arc;

use areoid_formats::lanes;

use super::extension::{Pixel, Run};
use super::needs::PreparedAt;
use super::prepare::{PREPARED, Prepared, PreparedSource};
use crate::raster::RasterError;

/// Taps for a tile of texels, copied from prepared tiles.
///
/// Its columns and rows are those of the extended source, as [`Coords`](super::tile::Coords) has
/// them. One window serves many tiles in turn, so that its memory is used again.
#[derive(Debug, Default)]
pub struct Window {
    /// What kernels sum, a plane a channel; of splines the pixels, too, if they are wanted.
    planes: Vec<Vec<f32>>,
    pixels: Vec<Vec<f32>>,
    /// 0 where there is no data; only if something is not opaque.
    alpha: Vec<u8>,
    masked: bool,
    stride: usize,
    col: i64,
    row: i64,
}

/// A plane of a window.
#[derive(Clone, Copy, Debug)]
pub(super) struct View<'a> {
    /// Rows from the top, each with [`Self::SLACK`] more numbers behind it.
    pub(super) data: &'a [f32],
    pub(super) stride: usize,
    /// Column of the first pixel in the extended source.
    pub(super) col: i64,
    /// Its row.
    pub(super) row: i64,
}

impl View<'_> {
    /// Numbers behind each row that may be read, and mean nothing.
    pub(super) const SLACK: usize = 8;

    /// Index of the pixel at a column and row, both whole.
    ///
    /// # Panics
    ///
    /// Maybe, if there is none; else the index is of another, or of none.
    #[inline(always)]
    pub(super) fn index(&self, col: f64, row: f64) -> usize {
        let (col, row) = (col - self.col as f64, row - self.row as f64);
        debug_assert!(col >= 0.0 && row >= 0.0, "{col}, {row} lies outside the window");
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "in the window"
        )]
        let index = row as usize * self.stride + col as usize;
        index
    }
}

impl Window {
    /// Fills the window for texels within `range`, as in
    /// [`Coords::range`](super::tile::Coords::range), whose taps reach `reach` pixels along columns
    /// and along rows; false if no texel there can be valid. Tiles that are not `wanted`, as the
    /// corners of a rectangle about turned texels, are not made: 0 stands there.
    ///
    /// # Errors
    ///
    /// [`RasterError`] if a tile cannot be made.
    ///
    /// # Panics
    ///
    /// If the range is none.
    pub fn assemble(
        &mut self,
        source: &PreparedSource,
        range: [f64; 4],
        reach: [i64; 2],
        wanted: impl Fn(PreparedAt) -> bool,
    ) -> Result<bool, RasterError> {
        let [cols, rows] = [[range[0], range[1]], [range[2], range[3]]];
        #[expect(clippy::cast_possible_truncation, reason = "places of pixels")]
        let span = |[first, last]: [f64; 2], reach: i64| {
            (first.floor() as i64 + 1 - reach, last.floor() as i64 + 1 + reach)
        };
        let ((left, right), (top, bottom)) = (span(cols, reach[0]), span(rows, reach[1]));
        let width = usize::try_from(right - left).expect("ranges go up");
        let height = usize::try_from(bottom - top).expect("ranges go up");
        (self.col, self.row, self.stride) = (left, top, width + View::SLACK);
        let len = self.stride * height + View::SLACK;
        let channels = source.channels();
        for plane in sized(&mut self.planes, channels) {
            plane.resize(len, 0.0);
        }
        for plane in sized(&mut self.pixels, if source.keeps_pixels() { channels } else { 0 }) {
            plane.resize(len, 0.0);
        }

        // Beyond an edge that mirrors nothing is valid; taps that merely reach there matter not.
        let extension = source.extension();
        let ends = |[first, last]: [f64; 2], origin: &dyn Fn(i64) -> Pixel| {
            #[expect(clippy::cast_possible_truncation, reason = "places of pixels")]
            let nearest = |at: f64| (at + 0.5).floor() as i64;
            origin(nearest(first)).real && origin(nearest(last)).real
        };
        let real =
            ends(cols, &|col| extension.col(col, false)) && ends(rows, &|row| extension.row(row));
        self.masked = false;
        if !real {
            self.mask(len);
        }
        let mut any = false;
        let runs = extension.rows(top..bottom);
        for rows in split(&runs) {
            for cols in split(&extension.cols(left..right, rows.first.turned)) {
                let (col, row) = (cols.first.index / PREPARED, rows.first.index / PREPARED);
                if !wanted(PreparedAt { row, col }) {
                    self.blank(rows, cols);
                    continue;
                }
                let tile = source.get(col, row)?;
                any |= !tile.is_empty() && rows.first.real && cols.first.real;
                self.lay(&tile, rows, cols, len, real);
            }
        }
        if any && self.masked {
            let rows = self.alpha.chunks(self.stride).take(height);
            let (least, greatest) =
                rows.fold((u8::MAX, 0), |found, row| lanes::extremes(&row[..width], found));
            self.masked = least < u8::MAX;
            any = greatest > 0;
        }
        Ok(any)
    }

    /// A plane of what kernels sum.
    pub(super) fn view(&self, channel: usize) -> View<'_> {
        let Self { stride, col, row, .. } = *self;
        View { data: &self.planes[channel], stride, col, row }
    }

    /// A plane of pixels.
    pub(super) fn pixels(&self, channel: usize) -> View<'_> {
        let view = self.view(channel);
        View { data: self.pixels.get(channel).map_or(view.data, |plane| plane), ..view }
    }

    /// Alpha beside the pixels of a plane, or `None` if all are valid and opaque.
    pub(super) fn alpha(&self) -> Option<&[u8]> {
        self.masked.then_some(&self.alpha[..])
    }

    /// Channels of the source.
    #[must_use]
    pub fn channels(&self) -> usize {
        self.planes.len()
    }

    /// Copies what a tile has of a run of rows and columns, both inside it.
    fn lay(&mut self, tile: &Arc<Prepared>, rows: Run, cols: Run, len: usize, real: bool) {
        let (from_col, from_row) = (cols.range().start % PREPARED, rows.range().start % PREPARED);
        let lines = |row: usize| {
            let row = if rows.backward { rows.len - 1 - row } else { row };
            (from_row as usize + row) * tile.cols() + from_col as usize
        };
        let at = |row: usize, stride: usize| (rows.at + row) * stride + cols.at;
        let stride = self.stride;
        for (channel, plane) in self.planes.iter_mut().enumerate() {
            copy(tile.plane(channel), plane, rows.len, cols, &lines, |row| at(row, stride));
        }
        for (channel, plane) in self.pixels.iter_mut().enumerate() {
            copy(tile.pixels(channel), plane, rows.len, cols, &lines, |row| at(row, stride));
        }

        let there = rows.first.real && cols.first.real;
        if there && tile.alpha().is_none() && !tile.is_empty() {
            return;
        }
        if there || !real {
            self.mask(len);
            let alpha = tile.alpha().filter(|_| there);
            copy(alpha, &mut self.alpha, rows.len, cols, &lines, |row| at(row, stride));
        }
    }

    /// Lays zeros over a run of rows and columns.
    fn blank(&mut self, rows: Run, cols: Run) {
        for plane in self.planes.iter_mut().chain(&mut self.pixels) {
            for row in rows.at..rows.at + rows.len {
                plane[row * self.stride + cols.at..][..cols.len].fill(0.0);
            }
        }
    }

    /// Makes everything opaque, unless something is not already.
    fn mask(&mut self, len: usize) {
        if !self.masked {
            self.alpha.clear();
            self.alpha.resize(len, u8::MAX);
            self.masked = true;
        }
    }
}

/// As many planes as are wanted.
fn sized(planes: &mut Vec<Vec<f32>>, count: usize) -> &mut [Vec<f32>] {
    planes.resize_with(count, Vec::new);
    planes
}

/// Copies rows of `cols` from where `from` says to where `to` says, or zeros if there is nothing.
fn copy<T: Copy + Default>(
    plane: Option<&[T]>,
    out: &mut [T],
    rows: usize,
    cols: Run,
    from: &impl Fn(usize) -> usize,
    to: impl Fn(usize) -> usize,
) {
    for row in 0..rows {
        let out = &mut out[to(row)..][..cols.len];
        let Some(plane) = plane else {
            out.fill(T::default());
            continue;
        };
        let line = &plane[from(row)..][..cols.len];
        if cols.backward {
            out.iter_mut().zip(line.iter().rev()).for_each(|(out, &line)| *out = line);
        } else {
            out.copy_from_slice(line);
        }
    }
}

/// The parts of runs that lie in one prepared tile each.
fn split(runs: &[Run]) -> impl Iterator<Item = Run> {
    runs.iter().flat_map(|&run| {
        let mut done = 0;
        std::iter::from_fn(move || {
            let left = run.len - done;
            if left == 0 {
                return None;
            }
            let index = run.first.index;
            let done_here = u32::try_from(done).expect("a source's columns");
            let index = if run.backward { index - done_here } else { index + done_here };
            let room =
                if run.backward { index % PREPARED + 1 } else { PREPARED - index % PREPARED };
            let len = left.min(room as usize);
            let part = Run { at: run.at + done, len, first: Pixel { index, ..run.first }, ..run };
            done += len;
            Some(part)
        })
    })
}
