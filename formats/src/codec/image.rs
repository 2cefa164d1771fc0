//! One channel of lanes as bytes: a predictor, and a bit plane per bit.
//!
//! ```text
//!   0           predictor, u8
//!   1           methods: 2 bits a plane, plane k at bit 2 (k mod 4) of byte 1 + k / 4
//!   1 + w/4     for each sparse or LZ4 plane, from plane 0 up: its length in bytes, u32
//!   ..          for each plane, from plane 0 up: its bytes
//! ```

use super::bits::{BAND, Lane, stride, turn, turn_back};
use super::error::DecodeError;
use super::planes::{self, Method, PlaneWriter};
use super::predict::{Predictor, cheapest, fill_holes, residual_row, restore_row};
use super::reader::Reader;
use crate::lanes::{Wide, vectorized};

/// Buffers for one lane image, kept between pages.
#[derive(Debug, Default)]
pub(super) struct ImageScratch<L> {
    /// The lanes of a page to be written: `side * side`.
    lanes: Vec<L>,
    /// Padded rows: those of a band, and the one above them.
    band: Vec<L>,
}

impl<L: Lane> ImageScratch<L> {
    /// Makes room for the lanes of a page, and gives them.
    pub(super) fn lanes_mut(&mut self, side: usize) -> &mut [L] {
        self.lanes.resize(side * side, L::default());
        &mut self.lanes
    }

    /// Makes room for a band and the row above it, and gives them.
    pub(super) fn band_mut(&mut self, side: usize) -> &mut [L] {
        resize_band(&mut self.band, side)
    }
}

fn resize_band<L: Lane>(band: &mut Vec<L>, side: usize) -> &mut [L] {
    band.resize((BAND + 1) * stride(side), L::default());
    band
}

/// Buffers that lanes of any width share.
#[derive(Debug, Default)]
pub(super) struct PlaneScratch {
    planes: Vec<u8>,
    lengths: Vec<u8>,
    bodies: Vec<u8>,
    writer: PlaneWriter,
}

/// Bytes of a plane.
const fn plane_len(side: usize) -> usize {
    side.div_ceil(BAND) * side
}

/// Appends the image of `scratch.lanes` to `out`; lanes without coverage are overwritten.
///
/// Without a predictor the cheapest is found.
pub(super) fn write<L: Lane>(
    scratch: &mut ImageScratch<L>,
    shared: &mut PlaneScratch,
    coverage: Option<&[u8]>,
    side: usize,
    predictor: Option<Predictor>,
    out: &mut Vec<u8>,
) {
    let ImageScratch { lanes, band } = scratch;
    let band = resize_band(band, side);
    let predictor = predictor.unwrap_or_else(|| {
        let fill = |y: usize, row: &mut [L]| row.copy_from_slice(&lanes[y * side..][..side]);
        cheapest(side, coverage, band, fill).0
    });
    if let Some(coverage) = coverage {
        fill_holes(predictor, coverage, side, lanes);
    }
    let plane_len = plane_len(side);
    shared.planes.resize(L::BITS * plane_len, 0);
    let live = vectorized(Split { predictor, lanes, side, band, planes: &mut shared.planes });

    out.push(predictor as u8);
    let methods_at = out.len();
    out.resize(methods_at + L::BITS / 4, 0);
    shared.lengths.clear();
    shared.bodies.clear();
    for (k, plane) in shared.planes.chunks_exact(plane_len).take(L::BITS).enumerate() {
        if live >> k & 1 == 0 {
            continue;
        }
        let start = shared.bodies.len();
        let method = shared.writer.write(plane, &mut shared.bodies);
        out[methods_at + k / 4] |= (method as u8) << (2 * (k % 4));
        if matches!(method, Method::Sparse | Method::Lz4) {
            let len = shared.bodies.len() - start;
            let len = u32::try_from(len).expect("a plane is at most 2.1 MB");
            shared.lengths.extend_from_slice(&len.to_le_bytes());
        }
    }
    out.extend_from_slice(&shared.lengths);
    out.extend_from_slice(&shared.bodies);
}

/// Splits residuals into planes; bit `k` of what it returns says that plane `k` has a one. The
/// others are left as they are, or in part.
struct Split<'a, L> {
    predictor: Predictor,
    lanes: &'a [L],
    side: usize,
    band: &'a mut [L],
    planes: &'a mut [u8],
}

impl<L: Lane> Wide for Split<'_, L> {
    type Output = u32;

    #[inline(always)]
    fn run(self) -> u32 {
        let Self { predictor, lanes, side, band, planes } = self;
        let (stride, plane_len) = (stride(side), plane_len(side));
        band.fill(L::default());
        let mut live = L::default();
        for (start, rows) in (0..plane_len).step_by(side).zip(lanes.chunks(BAND * side)) {
            let first = start * BAND;
            let mut above = &lanes[first.saturating_sub(side)..first];
            let mut union = L::default();
            for (row, residuals) in rows.chunks_exact(side).zip(band.chunks_exact_mut(stride)) {
                let residuals = &mut residuals[..side];
                residual_row(predictor, above, row, residuals);
                union = residuals.iter().fold(union, |union, &residual| union.or(residual));
                above = row;
            }
            // Rows past the last are empty.
            let rows = rows.len() / side;
            band[rows * stride..].fill(L::default());

            for (byte, planes) in planes.chunks_exact_mut(BAND * plane_len).enumerate() {
                if union.byte(byte) != 0 {
                    if live.byte(byte) == 0 {
                        // Bands before this one had nothing to write.
                        planes.chunks_exact_mut(plane_len).for_each(|plane| plane[..start].fill(0));
                    }
                    let mut planes = planes.chunks_exact_mut(plane_len);
                    let mut next = |_| &mut planes.next().expect("eight planes")[start..][..side];
                    turn(band, byte, std::array::from_fn(&mut next));
                } else if live.byte(byte) != 0 {
                    let planes = planes.chunks_exact_mut(plane_len);
                    planes.for_each(|plane| plane[start..][..side].fill(0));
                }
            }
            live = live.or(union);
        }
        live.into()
    }
}

/// Reads an image, and gives `sink` each row and its number, from row 0 down.
pub(super) fn read<L: Lane>(
    reader: &mut Reader<'_>,
    side: usize,
    scratch: &mut ImageScratch<L>,
    shared: &mut PlaneScratch,
    sink: impl FnMut(usize, &[L]),
) -> Result<(), DecodeError> {
    let offset = reader.position();
    let [number] = reader.array("predictor")?;
    let predictor = *Predictor::ALL.get(usize::from(number)).ok_or(DecodeError::Field {
        field: "predictor",
        offset,
        expected: "0 to 3",
        found: number.into(),
    })?;
    let packed = reader.bytes("plane methods", L::BITS / 4)?;
    let method = |k: usize| Method::from_low_bits(packed[k / 4] >> (2 * (k % 4)));

    let plane_len = plane_len(side);
    let mut lens = [0; 32];
    for (k, len) in lens[..L::BITS].iter_mut().enumerate() {
        let offset = reader.position();
        *len = match method(k) {
            Method::Zero => 0,
            Method::Raw => plane_len,
            Method::Sparse | Method::Lz4 => {
                let found = u32::from_le_bytes(reader.array("plane length")?);
                let len = usize::try_from(found).ok().filter(|&len| len < plane_len);
                len.ok_or(DecodeError::Field {
                    field: "plane length",
                    offset,
                    expected: "less than a raw plane",
                    found: found.into(),
                })?
            }
        };
    }

    shared.planes.resize(L::BITS * plane_len, 0);
    let mut planes = [None; 32];
    for (k, plane) in shared.planes.chunks_exact_mut(plane_len).take(L::BITS).enumerate() {
        let offset = reader.position();
        let bytes = reader.bytes("bit plane", lens[k])?;
        planes[k] = match method(k) {
            Method::Zero => None,
            Method::Raw => Some(bytes),
            method => {
                planes::read(method, bytes, plane)
                    .ok_or(DecodeError::Plane { plane: k, offset })?;
                Some(&*plane)
            }
        };
    }
    let (planes, band) = (&planes[..L::BITS], scratch.band_mut(side));
    vectorized(Join { predictor, planes, side, band, sink });
    Ok(())
}

/// Joins planes to residuals and undoes the prediction: the inverse of [`split`].
struct Join<'a, L, F> {
    predictor: Predictor,
    planes: &'a [Option<&'a [u8]>],
    side: usize,
    band: &'a mut [L],
    /// Gets each row and its number, from row 0 down.
    sink: F,
}

impl<L: Lane, F: FnMut(usize, &[L])> Wide for Join<'_, L, F> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { predictor, planes, side, band, mut sink } = self;
        let stride = stride(side);
        let (above, rows) = band.split_at_mut(stride);
        for first in (0..side).step_by(BAND) {
            rows.fill(L::default());
            for (byte, planes) in planes.as_chunks::<BAND>().0.iter().enumerate() {
                let start = first / BAND * side;
                let of_band = planes.map(|plane| plane.map(|plane| &plane[start..][..side]));
                turn_back(of_band, byte, rows);
            }
            let mut before: &[L] = if first == 0 { &[] } else { &above[..side] };
            for (y, row) in (first..side.min(first + BAND)).zip(rows.chunks_exact_mut(stride)) {
                let row = &mut row[..side];
                restore_row(predictor, before, row);
                sink(y, row);
                before = row;
            }
            above.copy_from_slice(&rows[(BAND - 1) * stride..]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The planes of `lanes`, bit by bit as the format has them.
    fn planes_by_hand(predictor: Predictor, lanes: &[u16], side: usize) -> Vec<u8> {
        let mut planes = vec![0; 16 * plane_len(side)];
        for y in 0..side {
            let mut residuals = vec![0; side];
            let above = &lanes[y.saturating_sub(1) * side..y * side];
            residual_row(predictor, above, &lanes[y * side..][..side], &mut residuals);
            for (x, residual) in residuals.into_iter().enumerate() {
                for k in 0..16 {
                    let bit = residual.byte(k / 8) >> (k % 8) & 1;
                    planes[k * plane_len(side) + y / BAND * side + x] |= bit << (y % BAND);
                }
            }
        }
        planes
    }

    proptest! {
        /// Also where an upper byte comes to life, or falls silent, in the middle of a page.
        #[test]
        fn lanes_split_as_the_format_says_and_join_again(
            side in prop::sample::select(vec![4_usize, 8, 10, 23, 66]),
            noise in prop::collection::vec(any::<u16>(), 97),
            live_bands in any::<u8>(),
        ) {
            let lanes: Vec<u16> = (0..side * side)
                .zip(noise.into_iter().cycle())
                .map(|(i, lane)| if live_bands >> (i / side / BAND % 8) & 1 == 1 { lane } else { lane & 15 })
                .collect();
            for predictor in Predictor::ALL {
                // Whatever the buffers held before.
                let mut band = vec![0xa5a5; (BAND + 1) * stride(side)];
                let mut planes = vec![0xa5; 16 * plane_len(side)];
                let into = (&mut band[..], &mut planes[..]);
                let split = Split { predictor, lanes: &lanes, side, band: into.0, planes: into.1 };
                let live = vectorized(split);

                let expected = planes_by_hand(predictor, &lanes, side);
                let (planes, expected) =
                    (planes.chunks(plane_len(side)), expected.chunks(plane_len(side)));
                let mut sources = [None; 16];
                for (k, (plane, expected)) in planes.zip(expected).enumerate() {
                    prop_assert_eq!(live >> k & 1 == 1, expected.iter().any(|&byte| byte != 0));
                    if live >> k & 1 == 1 {
                        prop_assert_eq!(plane, expected, "plane {}", k);
                        sources[k] = Some(plane);
                    }
                }

                band.fill(0x5a5a);
                let mut back = Vec::new();
                let sink = |y, row: &[u16]| {
                    assert_eq!(back.len(), y * side);
                    back.extend_from_slice(row);
                };
                vectorized(Join { predictor, planes: &sources, side, band: &mut band, sink });
                prop_assert_eq!(&back, &lanes);
            }
        }
    }
}
