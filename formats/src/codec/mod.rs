//! Texels as bytes: the payload of a page.
//!
//! ```text
//!   heights ─ index on the step ─┐
//!   colors ─ channels ───────────┤ predict ▶ zigzag ▶ bit planes ▶ nothing, raw, sparse or LZ4
//!   coverage ────────────────────┘
//! ```
//!
//! A payload is lossless, describes itself up to the page's side and quantum, and is a function of
//! the texels alone. `FORMAT.md` draws its bytes. Decoding trusts none of them: sizes follow from the
//! side, and damage ends in an error or in wrong texels, never in a panic, never in a value without
//! coverage or coverage without a value.

mod bits;
mod color;
mod coverage;
mod error;
mod height;
mod image;
mod planes;
mod predict;
mod quantum;
mod reader;

pub use color::{
    decode_color_planes_into, decode_colors, decode_colors_into, encode_color_planes_into,
    encode_colors, encode_colors_into,
};
pub use error::{DecodeError, EncodeError};
pub use height::{
    decode_heights, decode_heights_into, encode_heights, encode_heights_into,
    encode_whole_heights_into,
};
pub use quantum::{Quantum, QuantumError};

use std::ops::RangeInclusive;

use image::{ImageScratch, PlaneScratch};

/// The sides a page may have, in texels, its border included.
pub const SIDES: RangeInclusive<usize> = 4..=4098;

/// Buffers that encoding and decoding need, to be kept between pages of one thread.
///
/// It grows to at most about 22 bytes a texel of the largest page it has seen, if it meets every kind.
/// What it held before changes no result.
#[derive(Debug, Default)]
pub struct Scratch {
    indices: Vec<i32>,
    bytes: ImageScratch<u8>,
    halves: ImageScratch<u16>,
    words: ImageScratch<u32>,
    shared: PlaneScratch,
    channels: [Vec<u8>; 3],
}

/// Refuses a side outside [`SIDES`].
fn check_side(side: usize) -> Result<(), usize> {
    if SIDES.contains(&side) { Ok(()) } else { Err(side) }
}

/// Refuses a buffer of the wrong length.
fn check_length(what: &'static str, found: usize, expected: usize) -> Result<(), EncodeError> {
    if found == expected { Ok(()) } else { Err(EncodeError::Length { what, expected, found }) }
}
