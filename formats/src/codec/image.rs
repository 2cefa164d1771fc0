//! One channel of lanes as bytes: a predictor, and a bit plane per bit.
//!
//! ```text
//!   0           predictor, u8
//!   1           methods: 2 bits a plane, plane k at bit 2 (k mod 4) of byte 1 + k / 4
//!   1 + w/4     for each sparse or LZ4 plane, from plane 0 up: its length in bytes, u32
//!   ..          for each plane, from plane 0 up: its bytes
//! ```

use super::bits::{BLOCK, Lane, shuffle, stride, unshuffle};
use super::error::DecodeError;
use super::planes::{self, Method, PlaneWriter};
use super::predict::{Predictor, fill_holes, residual_row, restore_row};
use super::reader::Reader;

/// Buffers for one lane image, kept between pages.
#[derive(Debug, Default)]
pub(super) struct ImageScratch<L> {
    /// The lanes: `side * side`, then padding up to a whole block.
    pub(super) lanes: Vec<L>,
    residuals: Vec<L>,
}

impl<L: Lane> ImageScratch<L> {
    /// Makes room for the lanes of a page, and gives them.
    pub(super) fn lanes_mut(&mut self, side: usize) -> &mut [L] {
        resize(&mut self.lanes, side);
        &mut self.lanes[..side * side]
    }
}

/// Makes room for the lanes of a page, padded to a whole block with zeros.
fn resize<L: Lane>(lanes: &mut Vec<L>, side: usize) {
    let len = side * side;
    lanes.resize(len.next_multiple_of(BLOCK), L::default());
    lanes[len..].fill(L::default());
}

/// Buffers that lanes of any width share.
#[derive(Debug, Default)]
pub(super) struct PlaneScratch {
    planes: Vec<u8>,
    writer: PlaneWriter,
}

/// Appends the image of `scratch.lanes` to `out`; lanes without coverage are overwritten.
pub(super) fn write<L: Lane>(
    scratch: &mut ImageScratch<L>,
    shared: &mut PlaneScratch,
    coverage: Option<&[u8]>,
    side: usize,
    predictor: Predictor,
    out: &mut Vec<u8>,
) {
    let len = side * side;
    if let Some(coverage) = coverage {
        fill_holes(predictor, coverage, side, &mut scratch.lanes);
    }
    resize(&mut scratch.residuals, side);
    for (y, residuals) in scratch.residuals[..len].chunks_exact_mut(side).enumerate() {
        let above = &scratch.lanes[y.saturating_sub(1) * side..y * side];
        residual_row(predictor, above, &scratch.lanes[y * side..][..side], residuals);
    }
    let union = scratch.residuals.iter().fold(L::default(), |union, &lane| union.or(lane));

    let stride = stride(len);
    shared.planes.resize(L::BITS * stride, 0);
    shuffle(&scratch.residuals, union, &mut shared.planes);

    out.push(predictor as u8);
    let methods_at = out.len();
    out.resize(methods_at + L::BITS / 4, 0);
    let mut lengths = Vec::new();
    let mut bodies = Vec::new();
    for (k, plane) in shared.planes.chunks_exact(stride).take(L::BITS).enumerate() {
        if union.into() >> k & 1 == 0 {
            continue;
        }
        let start = bodies.len();
        let method = shared.writer.write(&plane[..len.div_ceil(8)], &mut bodies);
        out[methods_at + k / 4] |= (method as u8) << (2 * (k % 4));
        if matches!(method, Method::Sparse | Method::Lz4) {
            let len = u32::try_from(bodies.len() - start).expect("a plane is at most 2.1 MB");
            lengths.extend_from_slice(&len.to_le_bytes());
        }
    }
    out.extend_from_slice(&lengths);
    out.extend_from_slice(&bodies);
}

/// Reads an image into `scratch.lanes`.
pub(super) fn read<L: Lane>(
    reader: &mut Reader<'_>,
    side: usize,
    scratch: &mut ImageScratch<L>,
    shared: &mut PlaneScratch,
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

    let len = side * side;
    let plane_len = len.div_ceil(8);
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

    let stride = stride(len);
    shared.planes.resize(L::BITS * stride, 0);
    let mut live = 0_u32;
    for (k, plane) in shared.planes.chunks_exact_mut(stride).take(L::BITS).enumerate() {
        let offset = reader.position();
        let bytes = reader.bytes("bit plane", lens[k])?;
        // The padding stays whatever an earlier page left: lanes past the last are never looked at.
        planes::read(method(k), bytes, &mut plane[..plane_len])
            .ok_or(DecodeError::Plane { plane: k, offset })?;
        live |= u32::from(method(k) != Method::Zero) << k;
    }

    resize(&mut scratch.lanes, side);
    unshuffle(&shared.planes, live, &mut scratch.lanes);
    for y in 0..side {
        let (above, rows) = scratch.lanes.split_at_mut(y * side);
        restore_row(predictor, &above[y.saturating_sub(1) * side..], &mut rows[..side]);
    }
    Ok(())
}
