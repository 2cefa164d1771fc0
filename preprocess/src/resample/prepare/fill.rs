//! Values where there is no data, so that kernels need not ask.
//!
//! Ring by ring, a pixel beside others takes the mean of those of its eight neighbors that have a
//! value, and beyond the last ring a row repeats what it had last. Texels in a hole are masked
//! afterward; what is filled in reaches the valid ones beside it through the taps of a kernel, where
//! it does what leaving those taps out would do, and farther only through a spline's coefficients,
//! by less than a pole's power.
//!
//! A mean of equal values is that value to the bit. A mean, and not a slope continued: that would
//! double the noise of the rim at every ring.

/// Fills in the pixels whose `alpha` is 0 of rows of `width`: what stands there is not looked at.
///
/// Where none is valid all become 0.
pub(super) fn fill(pixels: &mut [f32], alpha: &[u8], width: usize, rings: usize, room: &mut Room) {
    let Room { known, next, values } = room;
    known.clear();
    known.extend(alpha.iter().map(|&alpha| alpha != 0));
    rim(known, width, next);
    for _ring in 0..rings {
        values.clear();
        values.extend(next.iter().map(|&at| mean(pixels, known, width, at)));
        for (&at, &value) in next.iter().zip(&*values) {
            pixels[at] = value;
            known[at] = true;
        }
        let filled = std::mem::take(next);
        for at in filled {
            next.extend(around(at, width, known.len()).filter(|&beside| !known[beside]));
        }
        next.sort_unstable();
        next.dedup();
        if next.is_empty() {
            break;
        }
    }
    repeat(pixels, known, width);
}

/// Memory that [`fill`] uses again.
#[derive(Debug, Default)]
pub(super) struct Room {
    /// Which pixels have a value.
    known: Vec<bool>,
    /// Those to be filled next, and with what.
    next: Vec<usize>,
    values: Vec<f32>,
}

/// The pixels without a value that lie beside one that has one.
fn rim(known: &[bool], width: usize, rim: &mut Vec<usize>) {
    rim.clear();
    let is_known = |at: usize| known[at];
    for (row, line) in known.chunks_exact(width).enumerate() {
        if line.iter().all(|&known| known) {
            continue;
        }
        let unknown = line.iter().enumerate().filter(|&(_, &known)| !known);
        rim.extend(
            unknown
                .map(|(col, _)| row * width + col)
                .filter(|&at| around(at, width, known.len()).any(is_known)),
        );
    }
}

/// The neighbors of a pixel.
fn around(at: usize, width: usize, len: usize) -> impl Iterator<Item = usize> {
    let (row, col) = (at / width, at % width);
    let rows = row.saturating_sub(1)..(row + 2).min(len / width);
    let cols = col.saturating_sub(1)..(col + 2).min(width);
    rows.flat_map(move |row| cols.clone().map(move |col| row * width + col))
        .filter(move |&beside| beside != at)
}

fn mean(pixels: &[f32], known: &[bool], width: usize, at: usize) -> f32 {
    let values = around(at, width, known.len()).filter(|&beside| known[beside]);
    let (sum, count) = values
        .fold((0.0, 0.0), |(sum, count), beside| (sum + f64::from(pixels[beside]), count + 1.0));
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the point")]
    let mean = (sum / count) as f32;
    mean
}

/// Gives what is left in a row the value to its left, or the first one in the row or of all.
fn repeat(pixels: &mut [f32], known: &[bool], width: usize) {
    let first = known.iter().position(|&known| known).map_or(0.0, |at| pixels[at]);
    for (pixels, known) in pixels.chunks_exact_mut(width).zip(known.chunks_exact(width)) {
        let mut value = known.iter().position(|&known| known).map_or(first, |at| pixels[at]);
        for (pixel, &known) in pixels.iter_mut().zip(known) {
            value = if known { *pixel } else { value };
            *pixel = value;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_hole_takes_the_mean_around_it_and_equal_values_stay() {
        let mut pixels = vec![1.0, 2.0, 3.0, 4.0, 1e30, 6.0, 7.0, 8.0, 14.0];
        let mut alpha = [255; 9];
        alpha[4] = 0;
        fill(&mut pixels, &alpha, 3, 2, &mut Room::default());
        assert_eq!(pixels[4], 45.0 / 8.0);

        let mut pixels = vec![1234.567_f32; 400];
        let alpha: Vec<u8> = (0..400).map(|at| u8::from(at % 7 == 0 && at % 20 < 9)).collect();
        fill(&mut pixels, &alpha, 20, 2, &mut Room::default());
        assert!(pixels.iter().all(|pixel| pixel.to_bits() == 1234.567_f32.to_bits()));
    }

    #[test]
    fn where_nothing_is_valid_there_is_nothing() {
        let mut pixels = vec![1e30; 12];
        fill(&mut pixels, &[0; 12], 4, 3, &mut Room::default());
        assert_eq!(pixels, [0.0; 12]);
    }

    proptest! {
        #[test]
        fn what_stands_in_a_hole_is_not_looked_at(
            valid in prop::collection::vec(prop::bool::weighted(0.3), 60), rings in 0..5_usize,
        ) {
            let alpha: Vec<u8> = valid.iter().map(|&valid| u8::from(valid)).collect();
            let filled = |sentinel: f32| {
                let mut pixels: Vec<f32> = (0..60)
                    .map(|at| if valid[at] { (at * 37 % 29) as f32 } else { sentinel })
                    .collect();
                fill(&mut pixels, &alpha, 10, rings, &mut Room::default());
                pixels
            };
            let (one, other) = (filled(1e30), filled(f32::NAN));
            prop_assert_eq!(&one, &other);
            prop_assert!(one.iter().all(|&pixel| (0.0..29.0).contains(&pixel)));
            for at in (0..60).filter(|&at| valid[at]) {
                prop_assert_eq!(one[at], (at * 37 % 29) as f32);
            }
        }
    }
}
