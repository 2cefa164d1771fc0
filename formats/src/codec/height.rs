//! Pages of heights: integers on a step, or floats bit for bit.
//!
//! ```text
//!   0           form, u8: 0x10 | 1 with a coverage plane | 2 with lanes of 32 bits, else 16
//!   1           base, i32: the least index of a covered texel
//!   5           lane image of index - base, wrapping
//!   ..          lane image of 8 bits: the coverage, if there is any
//! ```
//!
//! Without a step the index of a float is its bits as an i32, all but the sign flipped if it is
//! negative: an order-preserving map of all floats, -0.0 (index -1) beside 0.0 (index 0).

use super::bits::Lane;
use super::coverage::{self, Presence};
use super::error::{DecodeError, EncodeError};
use super::image::{self, ImageScratch, PlaneScratch};
use super::quantum::Quantum;
use super::reader::Reader;
use super::{Scratch, check_length, check_side};
use crate::lanes;

const FORM: u8 = 0x10;
const COVERAGE: u8 = 1;
const WIDE: u8 = 2;

/// The step whose indices are the heights themselves.
const UNIT: Quantum = Quantum { step: 1.0, offset: 0.0 };

/// A float32 within 2^22 of 0 has, plus this, itself as the distance in bits from this.
const WHOLE: f32 = 12_582_912.0; // 1.5 2^23

/// Texels handled together: found good in one go, or looked at one by one.
const CHUNK: usize = 256;

/// Encodes a page of heights.
///
/// # Units
///
/// Texels and quantum are meters. Coverage is 0 to 255, 0 for no data.
///
/// # Shapes
///
/// `texels` and `coverage` are row-major, `side * side`. No coverage means 255 everywhere; coverage
/// of 255 everywhere is stored as none.
///
/// # Domain
///
/// A texel is NaN exactly where its coverage is 0. Elsewhere it is finite and, if there is a step,
/// on it ([`Quantum::round`] puts it there); -0.0 is on no step, and kept where there is none.
/// NaN payloads are not kept.
///
/// # Errors
///
/// [`EncodeError`] outside the domain.
pub fn encode_heights(
    texels: &[f32],
    coverage: Option<&[u8]>,
    side: usize,
    quantum: Quantum,
) -> Result<Vec<u8>, EncodeError> {
    let mut payload = Vec::new();
    encode_heights_into(texels, coverage, side, quantum, &mut Scratch::default(), &mut payload)?;
    Ok(payload)
}

/// [`encode_heights`] into `payload`, which is cleared first. After an error it holds nothing of use.
///
/// # Errors
///
/// As [`encode_heights`].
pub fn encode_heights_into(
    texels: &[f32],
    coverage: Option<&[u8]>,
    side: usize,
    quantum: Quantum,
    scratch: &mut Scratch,
    payload: &mut Vec<u8>,
) -> Result<(), EncodeError> {
    check_side(side).map_err(|found| EncodeError::Side { found })?;
    let quantum = quantum.checked()?;
    check_length("texels", texels.len(), side * side)?;
    if let Some(coverage) = coverage {
        check_length("coverage", coverage.len(), side * side)?;
    }
    let coverage = coverage::partial(coverage);

    let Scratch { indices, bytes, halves, words, shared, .. } = scratch;
    let (base, last) = index(texels, coverage, quantum, indices)?;
    let range = last.wrapping_sub(base).cast_unsigned();
    let wide = range > u32::from(u16::MAX);

    write_head(coverage.is_some(), wide, base, payload);
    if wide {
        let lane = |index: i32| index.wrapping_sub(base).cast_unsigned();
        write_lanes(indices, lane, coverage, side, words, shared, payload);
    } else {
        #[expect(clippy::cast_possible_truncation, reason = "in range where there is coverage")]
        let lane = |index: i32| index.wrapping_sub(base).cast_unsigned() as u16;
        write_lanes(indices, lane, coverage, side, halves, shared, payload);
    }
    if let Some(coverage) = coverage {
        coverage::write(coverage, side, bytes, shared, payload);
    }
    Ok(())
}

/// [`encode_heights_into`] of heights that are whole meters, on the step of 1 and offset of 0: the
/// same bytes.
///
/// # Domain
///
/// Texels without coverage may be anything.
///
/// # Errors
///
/// [`EncodeError`] if the side or a length is wrong.
pub fn encode_whole_heights_into(
    texels: &[i16],
    coverage: Option<&[u8]>,
    side: usize,
    scratch: &mut Scratch,
    payload: &mut Vec<u8>,
) -> Result<(), EncodeError> {
    check_side(side).map_err(|found| EncodeError::Side { found })?;
    check_length("texels", texels.len(), side * side)?;
    if let Some(coverage) = coverage {
        check_length("coverage", coverage.len(), side * side)?;
    }
    let coverage = coverage::partial(coverage);

    let none = (i16::MAX, i16::MIN);
    let (least, greatest) = match coverage {
        None => lanes::extremes(texels, none),
        Some(coverage) => lanes::covered_extremes(texels, coverage, none),
    };
    let base = if least > greatest { 0 } else { least };
    write_head(coverage.is_some(), false, base.into(), payload);
    let Scratch { bytes, halves, shared, .. } = scratch;
    for (lane, texel) in halves.lanes_mut(side).iter_mut().zip(texels) {
        *lane = texel.wrapping_sub(base).cast_unsigned();
    }
    image::write(halves, shared, coverage, side, None, payload);
    if let Some(coverage) = coverage {
        coverage::write(coverage, side, bytes, shared, payload);
    }
    Ok(())
}

/// Begins a payload anew.
fn write_head(covered: bool, wide: bool, base: i32, payload: &mut Vec<u8>) {
    payload.clear();
    payload.push(FORM | if covered { COVERAGE } else { 0 } | if wide { WIDE } else { 0 });
    payload.extend_from_slice(&base.to_le_bytes());
}

fn write_lanes<L: Lane>(
    indices: &[i32],
    lane: impl Fn(i32) -> L,
    coverage: Option<&[u8]>,
    side: usize,
    scratch: &mut ImageScratch<L>,
    shared: &mut PlaneScratch,
    payload: &mut Vec<u8>,
) {
    for (l, &index) in scratch.lanes_mut(side).iter_mut().zip(indices) {
        *l = lane(index);
    }
    image::write(scratch, shared, coverage, side, None, payload);
}

/// Fills `indices`, and returns the least and greatest of covered texels (0 and 0 if there are
/// none). Indices without coverage are anything.
fn index(
    texels: &[f32],
    coverage: Option<&[u8]>,
    quantum: Quantum,
    indices: &mut Vec<i32>,
) -> Result<(i32, i32), EncodeError> {
    indices.resize(texels.len(), 0);
    let (mut least, mut greatest) = (i32::MAX, i32::MIN);
    for (chunk, (texels, indices)) in
        texels.chunks(CHUNK).zip(indices.chunks_mut(CHUNK)).enumerate()
    {
        let start = chunk * CHUNK;
        let coverage = coverage.map(|coverage| &coverage[start..][..texels.len()]);
        if coverage.is_none_or(coverage::all)
            && let Some((low, high)) = index_all(texels, quantum, indices)
        {
            least = least.min(low);
            greatest = greatest.max(high);
            continue;
        }
        for (i, (&texel, index)) in texels.iter().zip(indices).enumerate() {
            if coverage.is_some_and(|coverage| coverage[i] == 0) {
                if !texel.is_nan() {
                    return Err(EncodeError::Uncovered { index: start + i, texel });
                }
            } else {
                *index = index_one(start + i, texel, quantum)?;
                least = least.min(*index);
                greatest = greatest.max(*index);
            }
        }
    }
    Ok(if least > greatest { (0, 0) } else { (least, greatest) })
}

/// Indices of texels that are all covered, the least and the greatest; `None` if one needs a closer
/// look.
#[inline(always)]
fn index_all(texels: &[f32], quantum: Quantum, indices: &mut [i32]) -> Option<(i32, i32)> {
    if quantum == UNIT && texels.len() == CHUNK {
        return index_whole(texels, indices);
    }
    let mut good = true;
    let pairs = indices.iter_mut().zip(texels);
    if quantum.is_none() {
        for (index, &texel) in pairs {
            good &= texel.is_finite();
            *index = index_from_float(texel);
        }
    } else {
        let steps_per_meter = 1.0 / quantum.step;
        for (index, &texel) in pairs {
            *index = quantum.guess(texel, steps_per_meter);
            good &= quantum.value(*index).to_bits() == texel.to_bits();
        }
    }
    let least = indices.iter().fold(i32::MAX, |least, &index| least.min(index));
    let greatest = indices.iter().fold(i32::MIN, |greatest, &index| greatest.max(index));
    good.then_some((least, greatest))
}

/// [`index_all`] where the index is the height, in operations that are vectors in every instruction
/// set: floats have a minimum and a maximum, 32-bit integers often not.
#[inline(always)]
fn index_whole(texels: &[f32], indices: &mut [i32]) -> Option<(i32, i32)> {
    const LANES: usize = 16;
    let mut wrong = [0; LANES];
    let (mut least, mut greatest) = ([f32::INFINITY; LANES], [f32::NEG_INFINITY; LANES]);
    let chunks = texels.as_chunks::<LANES>().0.iter();
    for (texels, indices) in chunks.zip(indices.as_chunks_mut::<LANES>().0) {
        for i in 0..LANES {
            let texel = texels[i];
            indices[i] = (texel + WHOLE).to_bits().wrapping_sub(WHOLE.to_bits()).cast_signed();
            wrong[i] |= (indices[i] as f32).to_bits() ^ texel.to_bits();
            least[i] = if texel < least[i] { texel } else { least[i] };
            greatest[i] = if texel > greatest[i] { texel } else { greatest[i] };
        }
    }
    let least = least.into_iter().fold(f32::INFINITY, f32::min);
    let greatest = greatest.into_iter().fold(f32::NEG_INFINITY, f32::max);
    #[expect(clippy::cast_possible_truncation, reason = "whole and small where none is wrong")]
    return (wrong == [0; LANES]).then_some((least as i32, greatest as i32));
}

fn index_one(at: usize, texel: f32, quantum: Quantum) -> Result<i32, EncodeError> {
    if !texel.is_finite() {
        return Err(EncodeError::NotFinite { index: at, texel });
    }
    if quantum.is_none() {
        return Ok(index_from_float(texel));
    }
    quantum.index(texel).ok_or(EncodeError::OffStep { index: at, texel })
}

/// The bits of a float in the order of floats, as the module's documentation has it.
#[inline(always)]
const fn index_from_float(texel: f32) -> i32 {
    flip(texel.to_bits().cast_signed())
}

#[inline(always)]
const fn float_from_index(index: i32) -> f32 {
    f32::from_bits(flip(index).cast_unsigned())
}

/// Flips all bits but the sign of a negative number: its own inverse.
#[inline(always)]
const fn flip(bits: i32) -> i32 {
    bits ^ (bits >> 31) & i32::MAX
}

/// Decodes a page of heights: texels, and their coverage where it is not 255 everywhere.
///
/// `quantum` is the one that the page was encoded with; the payload does not hold it.
///
/// # Shapes
///
/// Row-major, `side * side`, both. A texel is NaN exactly where its coverage is 0, else finite.
///
/// # Errors
///
/// [`DecodeError`] if the bytes are no such payload. Whatever they are, memory stays within what
/// `side` implies.
pub fn decode_heights(
    bytes: &[u8],
    side: usize,
    quantum: Quantum,
) -> Result<(Vec<f32>, Option<Vec<u8>>), DecodeError> {
    let (mut texels, mut coverage) = (Vec::new(), Vec::new());
    let scratch = &mut Scratch::default();
    decode_heights_into(bytes, side, quantum, scratch, &mut texels, &mut coverage)?;
    Ok((texels, (!coverage.is_empty()).then_some(coverage)))
}

/// [`decode_heights`] into `texels` and `coverage`, which ends up empty where everything is covered.
/// After an error neither holds anything of use.
///
/// # Errors
///
/// As [`decode_heights`].
pub fn decode_heights_into(
    bytes: &[u8],
    side: usize,
    quantum: Quantum,
    scratch: &mut Scratch,
    texels: &mut Vec<f32>,
    coverage: &mut Vec<u8>,
) -> Result<(), DecodeError> {
    check_side(side).map_err(|found| DecodeError::Side { found })?;
    let quantum = quantum.checked()?;
    let mut reader = Reader::new(bytes);
    let [form] = reader.array("form")?;
    if form & !(COVERAGE | WIDE) != FORM {
        let expected = "a page of heights, 0x10 to 0x13";
        return Err(DecodeError::Field { field: "form", offset: 0, expected, found: form.into() });
    }
    let base = i32::from_le_bytes(reader.array("base")?);

    texels.clear();
    texels.reserve_exact(side * side);
    let Scratch { bytes, halves, words, shared, .. } = scratch;
    if form & WIDE == 0 {
        image::read(&mut reader, side, halves, shared, |_, row| {
            append(row, base, quantum, texels)
        })?;
    } else {
        image::read(&mut reader, side, words, shared, |_, row| append(row, base, quantum, texels))?;
    }
    coverage::read(Presence::from_form(form), &mut reader, side, bytes, shared, coverage)?;
    reader.finish()?;

    for (texel, &covered) in texels.iter_mut().zip(&*coverage) {
        if covered == 0 {
            *texel = f32::NAN;
        }
    }
    if quantum.is_none() {
        check_finite(texels, coverage)?;
    }
    Ok(())
}

/// Turns lanes into heights.
#[inline(always)]
fn append<L: Lane>(lanes: &[L], base: i32, quantum: Quantum, texels: &mut Vec<f32>) {
    let indices = lanes.iter().map(|&lane| base.wrapping_add(lane.into().cast_signed()));
    if quantum.is_none() {
        texels.extend(indices.map(float_from_index));
    } else if quantum == UNIT {
        // An i32 is exact in f64, so one rounding or two make no difference.
        texels.extend(indices.map(|index| index as f32));
    } else {
        texels.extend(indices.map(|index| quantum.value(index)));
    }
}

/// Damaged floats may be infinite, or NaN where there is coverage.
fn check_finite(texels: &[f32], coverage: &[u8]) -> Result<(), DecodeError> {
    let finite = texels.iter().filter(|texel| texel.is_finite()).count();
    let covered = match coverage {
        [] => texels.len(),
        _ => coverage.iter().filter(|&&covered| covered != 0).count(),
    };
    if finite == covered {
        return Ok(());
    }
    let index = texels
        .iter()
        .enumerate()
        .position(|(i, texel)| !texel.is_finite() && coverage.get(i).is_none_or(|&c| c != 0));
    Err(DecodeError::NotFinite { index: index.unwrap_or_default() })
}
