//! Samples to what pages hold: heights in meters, whole or not, and colors of 8 bits.
//!
//! The functions lay a window of a block over planes of a destination whose rows are `stride`
//! texels apart, and leave those texels as they were that have no data: several rasters over one
//! another are several calls on planes that were blank at first.

mod whole;

pub use self::whole::whole_heights_into;

use std::ops::Range;

use areoid_formats::lanes::{self, Wide};

use super::error::RasterError;
use super::samples::{Sample, SampleType, Samples, with_samples};
use super::{Block, RasterInfo};

/// A rectangle of a raster's pixels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Window {
    /// Columns of the raster.
    pub cols: Range<u32>,
    /// Rows of the raster, counted downward.
    pub rows: Range<u32>,
}

/// How much of a destination was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filled {
    /// Every texel, and each is opaque: no mask need be looked at.
    All,
    /// Some texels, or some that are not opaque.
    Part,
    /// No texel at all.
    Nothing,
}

impl Window {
    /// All of a block.
    #[must_use]
    pub const fn of(block: &Block) -> Self {
        Self { cols: block.col..block.col + block.width, rows: block.row..block.row + block.height }
    }
}

/// Lays the heights of a window of `block` over `out`: the first band, scaled.
///
/// What has no data is left as it was: NaN, infinities, samples that equal the no-data value in
/// their own type, pixels whose alpha is 0, and heights beyond the range of an `f32`.
///
/// # Units
///
/// Meters, as far as the file says: `sample * scale + offset`.
///
/// # Shapes
///
/// `out` begins with the window's first texel; those of the next row follow `stride` later.
///
/// # Precision
///
/// Scaled in `f64` and rounded once.
///
/// # Panics
///
/// If the window is not inside the block, the block's samples are not those of `info`, or `out` or
/// `stride` is too short for the window.
pub fn heights_into(
    block: &Block,
    info: &RasterInfo,
    window: &Window,
    out: &mut [f32],
    stride: usize,
) -> Filled {
    let part = Part::new(block, info, window, stride);
    part.check(out.len());
    let written = with_samples!(&block.samples, values => heights(values, &part, info, out));
    part.filled(written, written)
}

fn heights<T: Sample>(values: &[T], part: &Part, info: &RasterInfo, out: &mut [f32]) -> usize {
    let nodata = info.nodata.and_then(T::exactly);
    let (scale, offset) = (info.scale, info.offset);
    let lines = || part.lines(values);
    let rows = out.chunks_mut(part.stride).map(|row| &mut row[..part.width]);
    #[expect(clippy::cast_possible_truncation, reason = "the one rounding that is documented")]
    let scaled = |sample: T| (sample.number() * scale + offset) as f32;
    // What it is for a scale of 1 and no offset, which compilers turn into one conversion.
    #[expect(clippy::cast_possible_truncation, reason = "the one rounding that is documented")]
    let plain = |sample: T| (sample.number() + 0.0) as f32;
    let is_plain = (scale, offset) == (1.0, 0.0);

    if part.samples > 1 {
        let alpha = info.has_alpha.then(|| usize::from(info.bands));
        let hidden = |pixel: &[T]| alpha.is_some_and(|alpha| pixel[alpha] == T::default());
        return lines()
            .zip(rows)
            .map(|(line, row)| {
                let pixels = line.chunks_exact(part.samples);
                lay(pixels, row, |pixel| {
                    (scaled(pixel[0]), Some(pixel[0]) != nodata && !hidden(pixel))
                })
            })
            .sum();
    }
    // One loop for each case, so that each is a vector loop without the others' questions.
    lines()
        .zip(rows)
        .map(|(line, row)| match (nodata, is_plain) {
            (None, true) => lay_line(line, row, |&sample| (plain(sample), true)),
            (None, false) => lay_line(line, row, |&sample| (scaled(sample), true)),
            (Some(nodata), true) => {
                lay_line(line, row, |&sample| (plain(sample), sample != nodata))
            }
            (Some(nodata), false) => {
                lay_line(line, row, |&sample| (scaled(sample), sample != nodata))
            }
        })
        .sum()
}

/// [`lay`] in the widest vectors that there are.
fn lay_line<T>(samples: &[T], row: &mut [f32], height: impl Fn(&T) -> (f32, bool)) -> usize {
    struct Line<'a, T, F>(&'a [T], &'a mut [f32], F);
    impl<T, F: Fn(&T) -> (f32, bool)> Wide for Line<'_, T, F> {
        type Output = usize;

        #[inline(always)]
        fn run(self) -> usize {
            lay(self.0, self.1, self.2)
        }
    }
    lanes::vectorized(Line(samples, row, height))
}

/// Writes what is valid and finite; how many texels that are.
#[inline(always)]
fn lay<S>(
    samples: impl IntoIterator<Item = S>,
    row: &mut [f32],
    height: impl Fn(S) -> (f32, bool),
) -> usize {
    let mut written = 0_u32;
    for (texel, sample) in row.iter_mut().zip(samples) {
        let (height, valid) = height(sample);
        let valid = valid & height.is_finite();
        // A choice by bits: stores of some lanes alone are slow.
        let chosen = 0_u32.wrapping_sub(u32::from(valid));
        *texel = f32::from_bits(height.to_bits() & chosen | texel.to_bits() & !chosen);
        written += u32::from(valid);
    }
    written as usize
}

/// Lays the colors of a window of `block` over three planes: its first three bands, or its only one
/// three times.
///
/// What has no data is left as it was: where the file's own alpha is 0, or where every color band
/// equals the no-data value. Elsewhere alpha, where it is wanted, becomes the file's, at least 1, or
/// 255. Samples of 16 bits become the nearest of 8.
///
/// # Shapes
///
/// Each plane and `alpha` begin with the window's first texel; those of the next row follow
/// `stride` later.
///
/// # Errors
///
/// [`RasterError::NotSupported`] unless samples are unsigned integers of 8 or 16 bits.
///
/// # Panics
///
/// See [`heights_into`].
pub fn colors_into(
    block: &Block,
    info: &RasterInfo,
    window: &Window,
    planes: [&mut [u8]; 3],
    alpha: Option<&mut [u8]>,
    stride: usize,
) -> Result<Filled, RasterError> {
    let part = Part::new(block, info, window, stride);
    planes.iter().for_each(|plane| part.check(plane.len()));
    alpha.iter().for_each(|alpha| part.check(alpha.len()));
    let to = Colors { planes, alpha };
    Ok(match &block.samples {
        Samples::U8(values) => colors(values, &part, info, |value| value, to),
        Samples::U16(values) => colors(values, &part, info, byte_of, to),
        _ => {
            let found = format!("colors of type {:?}", info.sample);
            let supported = format!("{:?} and {:?}", SampleType::U8, SampleType::U16);
            return Err(RasterError::not_supported(&info.path, found, supported));
        }
    })
}

/// Where colors are laid.
struct Colors<'out> {
    planes: [&'out mut [u8]; 3],
    alpha: Option<&'out mut [u8]>,
}

fn colors<T: Sample>(
    values: &[T],
    part: &Part,
    info: &RasterInfo,
    byte: impl Fn(T) -> u8,
    to: Colors,
) -> Filled {
    let nodata = info.nodata.and_then(T::exactly);
    let bands = usize::from(info.bands);
    let places = if bands >= 3 { [0, 1, 2] } else { [0; 3] };
    let always_opaque = nodata.is_none() && !info.has_alpha;
    let (mut written, mut opaque) = (0, 0);
    let Colors { planes: [reds, greens, blues], alpha: mut alphas } = to;
    for (row, line) in part.lines(values).enumerate() {
        let row = row * part.stride..row * part.stride + part.width;
        let [red, green, blue] = [&mut *reds, greens, blues].map(|plane| &mut plane[row.clone()]);
        let alpha = alphas.as_mut().map(|alpha| &mut alpha[row]);
        if always_opaque {
            let planes = [red, green, blue];
            match part.samples {
                1 => split::<T, 1>(line, [0; 3], &byte, planes),
                3 => lanes::vectorized(Split { line, places, byte: &byte, planes }),
                _ => {
                    let [red, green, blue] = planes;
                    for (index, pixel) in line.chunks_exact(part.samples).enumerate() {
                        let [r, g, b] = places.map(|place| byte(pixel[place]));
                        (red[index], green[index], blue[index]) = (r, g, b);
                    }
                }
            }
            alpha.into_iter().for_each(|alpha| alpha.fill(255));
            (written, opaque) = (written + part.width, opaque + part.width);
            continue;
        }
        let mut alpha = alpha;
        for (index, pixel) in line.chunks_exact(part.samples).enumerate() {
            let empty =
                nodata.is_some_and(|nodata| pixel[..bands].iter().all(|&band| band == nodata));
            let opacity = match info.has_alpha {
                false => 255,
                true if pixel[bands] == T::default() => 0,
                // A trace of 16 bits must not become the 0 that means no data.
                true => byte(pixel[bands]).max(1),
            };
            if !empty && opacity > 0 {
                let [r, g, b] = places.map(|place| byte(pixel[place]));
                (red[index], green[index], blue[index]) = (r, g, b);
                if let Some(alpha) = &mut alpha {
                    alpha[index] = opacity;
                }
                written += 1;
                opaque += usize::from(opacity == 255);
            }
        }
    }
    part.filled(written, opaque)
}

/// [`split`] of pixels of three samples in wide vectors.
struct Split<'a, T, B> {
    line: &'a [T],
    places: [usize; 3],
    byte: &'a B,
    planes: [&'a mut [u8]; 3],
}

impl<T: Copy, B: Fn(T) -> u8> Wide for Split<'_, T, B> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        split::<T, 3>(self.line, self.places, self.byte, self.planes);
    }
}

/// Splits pixels of a fixed number of samples into planes.
#[inline(always)]
fn split<T: Copy, const SAMPLES: usize>(
    line: &[T],
    places: [usize; 3],
    byte: impl Fn(T) -> u8,
    [red, green, blue]: [&mut [u8]; 3],
) {
    let texels = red.iter_mut().zip(green).zip(blue);
    for (((red, green), blue), pixel) in texels.zip(line.as_chunks::<SAMPLES>().0) {
        let [r, g, b] = places.map(|place| byte(pixel[place]));
        (*red, *green, *blue) = (r, g, b);
    }
}

/// The nearest 8-bit value of a 16-bit one: 0 to 0, 65535 to 255.
fn byte_of(value: u16) -> u8 {
    u8::try_from((u32::from(value) + 128) / 257).expect("65663 / 257 is 255")
}

/// A window of a block's samples, and the destination's stride.
struct Part {
    /// Samples of a pixel.
    samples: usize,
    /// Samples of a row of the block.
    line: usize,
    /// The first sample of the window in its rows.
    first: usize,
    rows: Range<usize>,
    /// Pixels of the window.
    width: usize,
    stride: usize,
}

impl Part {
    fn new(block: &Block, info: &RasterInfo, window: &Window, stride: usize) -> Self {
        let whole = Window::of(block);
        let inside = |part: &Range<u32>, whole: &Range<u32>| {
            whole.start <= part.start && part.start <= part.end && part.end <= whole.end
        };
        assert!(
            inside(&window.cols, &whole.cols) && inside(&window.rows, &whole.rows),
            "the window is inside the block"
        );
        let samples = info.samples_per_pixel();
        let line = block.width as usize * samples;
        assert_eq!(
            block.samples.len(),
            line * block.height as usize,
            "the block is one of this raster"
        );
        let width = (window.cols.end - window.cols.start) as usize;
        assert!(width <= stride, "rows of the destination do not overlap");
        Self {
            samples,
            line,
            first: (window.cols.start - block.col) as usize * samples,
            rows: (window.rows.start - block.row) as usize..(window.rows.end - block.row) as usize,
            width,
            stride: stride.max(1),
        }
    }

    /// Checks that a destination of `len` texels has all rows.
    fn check(&self, len: usize) {
        let needed =
            self.rows.len().checked_sub(1).map_or(0, |last| last * self.stride + self.width);
        assert!(len >= needed, "the destination has {len} texels, not {needed}");
    }

    /// The window's rows of samples.
    fn lines<'values, T>(&self, values: &'values [T]) -> impl Iterator<Item = &'values [T]> {
        let Self { line, first, .. } = *self;
        let len = self.width * self.samples;
        self.rows.clone().map(move |row| &values[row * line + first..][..len])
    }

    fn filled(&self, written: usize, opaque: usize) -> Filled {
        if opaque == self.width * self.rows.len() {
            Filled::All
        } else if written > 0 {
            Filled::Part
        } else {
            Filled::Nothing
        }
    }
}

/// Heights of a whole block, NaN where there is no data.
#[cfg(test)]
pub(crate) fn all_heights(block: &Block, info: &RasterInfo) -> Vec<f32> {
    let mut heights = vec![f32::NAN; block.width as usize * block.height as usize];
    heights_into(block, info, &Window::of(block), &mut heights, block.width as usize);
    heights
}

/// Colors of a whole block and their alpha, 0 where there is no data.
#[cfg(test)]
pub(crate) fn all_colors(
    block: &Block,
    info: &RasterInfo,
) -> Result<(Vec<[u8; 3]>, Vec<u8>), RasterError> {
    let [mut red, mut green, mut blue, mut alpha] =
        std::array::from_fn(|_| vec![0; block.width as usize * block.height as usize]);
    let planes = [&mut red[..], &mut green, &mut blue];
    colors_into(block, info, &Window::of(block), planes, Some(&mut alpha), block.width as usize)?;
    let colors = red.iter().zip(green).zip(blue).map(|((&red, green), blue)| [red, green, blue]);
    Ok((colors.collect(), alpha))
}

#[cfg(test)]
mod tests;
