//! Samples that are whole meters as they are.

use super::super::error::RasterError;
use super::super::samples::{Sample, SampleType, Samples};
use super::super::{Block, RasterInfo};
use super::{Filled, Part, Window};

/// Lays the heights of a window of `block` over `out`: the first band, unscaled.
///
/// What has no data is left as it was: samples that equal the no-data value in their own type, and
/// pixels whose alpha is 0. Elsewhere `alpha`, where it is wanted, becomes 255.
///
/// # Units
///
/// Meters, as far as the file says.
///
/// # Shapes
///
/// `out` and `alpha` begin with the window's first texel; those of the next row follow `stride`
/// later.
///
/// # Errors
///
/// [`RasterError::NotSupported`] unless samples are unscaled integers that fit in 16 bits with a
/// sign.
///
/// # Panics
///
/// See [`super::heights_into`].
pub fn whole_heights_into(
    block: &Block,
    info: &RasterInfo,
    window: &Window,
    out: &mut [i16],
    alpha: Option<&mut [u8]>,
    stride: usize,
) -> Result<Filled, RasterError> {
    let part = Part::new(block, info, window, stride);
    part.check(out.len());
    alpha.iter().for_each(|alpha| part.check(alpha.len()));
    let to = Heights { texels: out, alpha };
    let written = match &block.samples {
        _ if !info.is_whole() => None,
        Samples::U8(values) => Some(heights(values, &part, info, to)),
        Samples::I8(values) => Some(heights(values, &part, info, to)),
        Samples::I16(values) => Some(heights(values, &part, info, to)),
        _ => None,
    };
    let written = written.ok_or_else(|| {
        let found = format!("whole heights of type {:?}", info.sample);
        let supported = format!("unscaled {:?}", [SampleType::U8, SampleType::I8, SampleType::I16]);
        RasterError::not_supported(&info.path, found, supported)
    })?;
    Ok(part.filled(written, written))
}

/// Where heights are laid.
struct Heights<'out> {
    texels: &'out mut [i16],
    alpha: Option<&'out mut [u8]>,
}

/// How many texels were written.
fn heights<T: Sample + Into<i16>>(
    values: &[T],
    part: &Part,
    info: &RasterInfo,
    mut to: Heights,
) -> usize {
    let nodata = info.nodata.and_then(T::exactly);
    let band_of_alpha = info.has_alpha.then(|| usize::from(info.bands));
    let hidden = |pixel: &[T]| band_of_alpha.is_some_and(|band| pixel[band] == T::default());
    let mut written = 0;
    for (row, line) in part.lines(values).enumerate() {
        let row = row * part.stride..row * part.stride + part.width;
        let texels = &mut to.texels[row.clone()];
        let alpha = to.alpha.as_mut().map(|alpha| &mut alpha[row]);
        // One loop for each case, so that the common ones are vector loops.
        written += match (part.samples, nodata) {
            (1, None) => lay(line.iter(), texels, alpha, |&sample| (sample, true)),
            (1, nodata) => {
                lay(line.iter(), texels, alpha, |&sample| (sample, Some(sample) != nodata))
            }
            (samples, nodata) => lay(line.chunks_exact(samples), texels, alpha, |pixel| {
                (pixel[0], Some(pixel[0]) != nodata && !hidden(pixel))
            }),
        };
    }
    written
}

/// Writes what is valid; how many texels that are.
#[inline(always)]
fn lay<S, T: Into<i16>>(
    samples: impl Iterator<Item = S> + Clone,
    texels: &mut [i16],
    alpha: Option<&mut [u8]>,
    height: impl Fn(S) -> (T, bool),
) -> usize {
    let mut written = 0_u32;
    // Everything is stored, if unchanged: a store on a condition is no vector.
    for (texel, sample) in texels.iter_mut().zip(samples.clone()) {
        let (height, valid) = height(sample);
        let mask = i16::from(valid).wrapping_neg();
        *texel = *texel & !mask | height.into() & mask;
        written += u32::from(valid);
    }
    if let Some(alpha) = alpha {
        for (alpha, sample) in alpha.iter_mut().zip(samples) {
            *alpha |= u8::from(height(sample).1).wrapping_neg();
        }
    }
    written as usize
}
