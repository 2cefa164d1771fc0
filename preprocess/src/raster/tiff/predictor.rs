//! Undoing what a predictor did to rows of samples, in place.
//!
//! ```text
//!   2, horizontal      a  b-a  c-b  d-c ..                        sums within each band
//!   3, floating point  all first bytes │ all second bytes │ ..    sums of bytes, then woven
//! ```
//!
//! # References
//!
//! * Adobe, *TIFF 6.0*, section 14; *TIFF Technical Note 3*, 2005 (floating point).

use std::num::Wrapping;
use std::ops::Add;

use bytemuck::Pod;

/// Undoes horizontal differencing of rows of whole pixels, in the host's order of bytes.
///
/// Differences are those of integers of the samples' width, also for floating-point samples.
///
/// # Panics
///
/// If `rows` is not aligned as its samples are, or `sample_bytes` is not 1, 2, 4 or 8.
pub(super) fn undo_horizontal(
    rows: &mut [u8],
    row_bytes: usize,
    sample_bytes: usize,
    samples: usize,
) {
    match sample_bytes {
        1 => sum_rows::<Wrapping<u8>>(bytemuck::cast_slice_mut(rows), row_bytes, samples),
        2 => sum_rows::<Wrapping<u16>>(bytemuck::cast_slice_mut(rows), row_bytes / 2, samples),
        4 => sum_rows::<Wrapping<u32>>(bytemuck::cast_slice_mut(rows), row_bytes / 4, samples),
        8 => sum_rows::<Wrapping<u64>>(bytemuck::cast_slice_mut(rows), row_bytes / 8, samples),
        other => unreachable!("samples of {other} bytes"),
    }
}

fn sum_rows<T: Pod + Add<Output = T>>(rows: &mut [T], row_len: usize, samples: usize) {
    rows.chunks_exact_mut(row_len).for_each(|row| sum(row, samples));
}

/// Sums each band of a row. The sums stay in registers: read back from memory, each would wait for
/// the store before it.
fn sum<T: Pod + Add<Output = T>>(row: &mut [T], samples: usize) {
    match samples {
        1 => sum_pixels::<T, 1>(row),
        2 => sum_pixels::<T, 2>(row),
        3 => sum_pixels::<T, 3>(row),
        4 => sum_pixels::<T, 4>(row),
        _ => {
            for index in samples..row.len() {
                row[index] = row[index] + row[index - samples];
            }
        }
    }
}

fn sum_pixels<T: Pod + Add<Output = T>, const SAMPLES: usize>(row: &mut [T]) {
    let mut sums = [T::zeroed(); SAMPLES];
    for pixel in row.as_chunks_mut::<SAMPLES>().0 {
        for (value, sum) in pixel.iter_mut().zip(&mut sums) {
            *sum = *sum + *value;
            *value = *sum;
        }
    }
}

/// Undoes the floating-point predictor of one row, of which the first samples are written to
/// `out` in the host's order of bytes. `row` then holds the sums.
///
/// # Panics
///
/// If `SAMPLE_BYTES` does not divide both lengths, or `out` is longer than `row`.
pub(super) fn undo_floating<const SAMPLE_BYTES: usize>(
    row: &mut [u8],
    samples: usize,
    out: &mut [u8],
) {
    assert!(out.len() <= row.len(), "a row is cut, not made longer");
    sum::<Wrapping<u8>>(bytemuck::cast_slice_mut(row), samples);
    let plane_bytes = row.len() / SAMPLE_BYTES;
    let mut planes = row.chunks_exact(plane_bytes);
    // The first plane holds the highest bytes.
    let planes: [&[u8]; SAMPLE_BYTES] =
        std::array::from_fn(|_| planes.next().expect("as many planes as bytes of a sample"));
    for (index, value) in out.as_chunks_mut::<SAMPLE_BYTES>().0.iter_mut().enumerate() {
        let high_first: [u8; SAMPLE_BYTES] = std::array::from_fn(|byte| planes[byte][index]);
        *value = high_first;
        if cfg!(target_endian = "little") {
            value.reverse();
        }
    }
}

/// Reverses the bytes of every sample.
///
/// # Panics
///
/// See [`undo_horizontal`].
pub(super) fn swap_bytes(rows: &mut [u8], sample_bytes: usize) {
    match sample_bytes {
        1 => {}
        2 => bytemuck::cast_slice_mut(rows).iter_mut().for_each(|v: &mut u16| *v = v.swap_bytes()),
        4 => bytemuck::cast_slice_mut(rows).iter_mut().for_each(|v: &mut u32| *v = v.swap_bytes()),
        8 => bytemuck::cast_slice_mut(rows).iter_mut().for_each(|v: &mut u64| *v = v.swap_bytes()),
        other => unreachable!("samples of {other} bytes"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_are_those_of_one_sample_after_the_other() {
        let row: Vec<u16> = (0..100_u16).map(|value| value.wrapping_mul(40503)).collect();
        for (samples, len) in (1..7).flat_map(|samples| (0..16).map(move |len| (samples, len))) {
            let row = &row[..samples * len];
            let mut expected = row.to_vec();
            for index in samples..expected.len() {
                expected[index] = expected[index].wrapping_add(expected[index - samples]);
            }
            let mut summed: Vec<Wrapping<u16>> = row.iter().copied().map(Wrapping).collect();
            sum(&mut summed, samples);
            assert!(summed.iter().map(|value| value.0).eq(expected), "{samples} {len}");
        }
    }
}
