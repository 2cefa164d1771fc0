//! A prepared tile: planes and a mask, in one piece of memory that can be set aside.

use std::io;

use super::super::source::Rect;
use crate::once::Parcel;

/// A square of a source, ready for kernels.
#[derive(Clone, Debug, PartialEq)]
pub struct Prepared {
    cols: usize,
    rows: usize,
    channels: usize,
    /// As many as channels, or twice as many.
    planes: usize,
    alpha: Alpha,
    /// Planes of f32, first of pixels if they are kept beside coefficients, and alpha behind them;
    /// nothing of a tile without data.
    words: Vec<u32>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Alpha {
    /// All is valid and opaque.
    Full,
    /// A byte a pixel.
    Kept,
    /// Nothing is valid here, nor so near that a kernel would reach it.
    Empty,
}

/// Where a tile lies within itself and its halo.
pub(super) struct Inside {
    pub(super) core: Rect,
    pub(super) halo: usize,
    /// Pixels in a row, halo included.
    pub(super) width: usize,
}

impl Inside {
    /// The tile's rows of a plane.
    fn rows<'a, T>(&self, plane: &'a [T]) -> impl Iterator<Item = &'a [T]> {
        let (halo, cols, width) = (self.halo, self.core.cols.len(), self.width);
        plane[halo * width..]
            .chunks(width)
            .take(self.core.rows.len())
            .map(move |row| &row[halo..halo + cols])
    }
}

impl Prepared {
    pub(super) fn empty(inside: &Inside, channels: usize) -> Self {
        let (cols, rows) = (inside.core.cols.len(), inside.core.rows.len());
        Self { cols, rows, channels, planes: channels, alpha: Alpha::Empty, words: Vec::new() }
    }

    /// A tile whose planes are still to be pushed.
    pub(super) fn new(inside: &Inside, channels: usize, alpha: Option<&[u8]>) -> Self {
        let planes = 0;
        let (cols, rows) = (inside.core.cols.len(), inside.core.rows.len());
        let opaque = |alpha: &[u8]| inside.rows(alpha).all(|row| row.iter().all(|&a| a == 255));
        let alpha = if alpha.is_none_or(opaque) { Alpha::Full } else { Alpha::Kept };
        let words = Vec::with_capacity(rows * cols * channels);
        Self { cols, rows, channels, planes, alpha, words }
    }

    pub(super) fn push(&mut self, inside: &Inside, plane: &[f32]) {
        for row in inside.rows(plane) {
            self.words.extend_from_slice(bytemuck::cast_slice(row));
        }
        self.planes += 1;
    }

    /// Appends the mask, if there is need of one.
    pub(super) fn finish(&mut self, inside: &Inside, alpha: Option<&[u8]>) {
        if let (Alpha::Kept, Some(alpha)) = (self.alpha, alpha) {
            let mut bytes = Vec::with_capacity(self.rows * self.cols);
            inside.rows(alpha).for_each(|row| bytes.extend_from_slice(row));
            self.words.extend(bytemuck::pod_collect_to_vec::<u8, u32>(&bytes));
        }
    }

    /// Pixels in a row.
    #[must_use]
    pub fn cols(&self) -> usize {
        self.cols
    }

    /// Rows.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Channels.
    #[must_use]
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// What kernels sum, row-major: pixels or coefficients. `None` if there is nothing here.
    ///
    /// # Panics
    ///
    /// If there is no such channel.
    #[must_use]
    pub fn plane(&self, channel: usize) -> Option<&[f32]> {
        assert!(channel < self.channels, "there are {} channels", self.channels);
        let before = self.planes - self.channels;
        (self.alpha != Alpha::Empty).then(|| self.at(before + channel))
    }

    /// The pixels: [`Self::plane`], if they were not kept beside coefficients.
    ///
    /// # Panics
    ///
    /// If there is no such channel.
    #[must_use]
    pub fn pixels(&self, channel: usize) -> Option<&[f32]> {
        assert!(channel < self.channels, "there are {} channels", self.channels);
        (self.alpha != Alpha::Empty).then(|| self.at(channel))
    }

    /// Alpha, a byte a pixel, 0 where there is no data; `None` if all is opaque, or nothing is here.
    #[must_use]
    pub fn alpha(&self) -> Option<&[u8]> {
        let area = self.rows * self.cols;
        let bytes = || bytemuck::cast_slice(&self.words[self.planes * area..]);
        (self.alpha == Alpha::Kept).then(|| &bytes()[..area])
    }

    /// Whether nothing is valid here, nor so near that a kernel would reach it.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.alpha == Alpha::Empty
    }

    fn at(&self, plane: usize) -> &[f32] {
        let area = self.rows * self.cols;
        bytemuck::cast_slice(&self.words[plane * area..][..area])
    }
}

impl Parcel for Prepared {
    fn bytes(&self) -> &[u8] {
        bytemuck::cast_slice(&self.words)
    }

    fn hollow(&self) -> Self {
        Self { words: Vec::new(), ..*self }
    }

    fn refilled(
        &self,
        len: usize,
        load: impl FnOnce(&mut [u8]) -> io::Result<()>,
    ) -> io::Result<Self> {
        let mut words = vec![0_u32; len / 4];
        load(bytemuck::cast_slice_mut(&mut words))?;
        Ok(Self { words, ..*self })
    }
}
