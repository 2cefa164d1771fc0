//! Pages of colors: three channels of sRGB codes.
//!
//! ```text
//!   0           form, u8: 0x20 | 1 with a coverage plane | 2 with differences
//!   1           lane image of 8 bits: green
//!   ..          lane image of 8 bits: red, or red - green, wrapping
//!   ..          lane image of 8 bits: blue, or blue - green, wrapping
//!   ..          lane image of 8 bits: the coverage, if there is any
//! ```

use std::mem;

use super::coverage::{self, Presence};
use super::error::{DecodeError, EncodeError};
use super::image::{self, ImageScratch, PlaneScratch};
use super::predict::cheapest;
use super::reader::Reader;
use super::{Scratch, check_length, check_side};

const FORM: u8 = 0x20;
const COVERAGE: u8 = 1;
const DIFFERENCES: u8 = 2;

const RED: usize = 0;
const GREEN: usize = 1;
const BLUE: usize = 2;

/// Encodes a page of colors.
///
/// # Units
///
/// sRGB codes, red, green, blue. Coverage is 0 to 255, 0 for no data.
///
/// # Shapes
///
/// `texels` and `coverage` are row-major, `side * side`. No coverage means 255 everywhere; coverage
/// of 255 everywhere is stored as none. Colors without coverage are not kept.
///
/// # Errors
///
/// [`EncodeError`] if the side or a length is wrong.
pub fn encode_colors(
    texels: &[[u8; 3]],
    coverage: Option<&[u8]>,
    side: usize,
) -> Result<Vec<u8>, EncodeError> {
    let mut payload = Vec::new();
    encode_colors_into(texels, coverage, side, &mut Scratch::default(), &mut payload)?;
    Ok(payload)
}

/// [`encode_colors`] into `payload`, which is cleared first. After an error it holds nothing of use.
///
/// # Errors
///
/// As [`encode_colors`].
pub fn encode_colors_into(
    texels: &[[u8; 3]],
    coverage: Option<&[u8]>,
    side: usize,
    scratch: &mut Scratch,
    payload: &mut Vec<u8>,
) -> Result<(), EncodeError> {
    check_side(side).map_err(|found| EncodeError::Side { found })?;
    check_length("texels", texels.len(), side * side)?;
    let Scratch { bytes, shared, channels, .. } = scratch;
    for (channel, plane) in channels.iter_mut().enumerate() {
        plane.clear();
        plane.extend(texels.iter().map(|texel| texel[channel]));
    }
    let planes = channels.each_ref().map(|plane| &plane[..]);
    write_planes(planes, coverage, side, bytes, shared, payload)
}

/// [`encode_colors_into`] from three planes, red, green and blue, which spares taking texels apart.
/// The bytes are the same.
///
/// # Shapes
///
/// `planes` and `coverage` are row-major, `side * side` each.
///
/// # Errors
///
/// As [`encode_colors`].
pub fn encode_color_planes_into(
    planes: [&[u8]; 3],
    coverage: Option<&[u8]>,
    side: usize,
    scratch: &mut Scratch,
    payload: &mut Vec<u8>,
) -> Result<(), EncodeError> {
    check_side(side).map_err(|found| EncodeError::Side { found })?;
    for (plane, what) in planes.into_iter().zip(["red", "green", "blue"]) {
        check_length(what, plane.len(), side * side)?;
    }
    let Scratch { bytes, shared, .. } = scratch;
    write_planes(planes, coverage, side, bytes, shared, payload)
}

/// Writes the payload of planes whose sizes are right.
fn write_planes(
    planes: [&[u8]; 3],
    coverage: Option<&[u8]>,
    side: usize,
    scratch: &mut ImageScratch<u8>,
    shared: &mut PlaneScratch,
    payload: &mut Vec<u8>,
) -> Result<(), EncodeError> {
    if let Some(coverage) = coverage {
        check_length("coverage", coverage.len(), side * side)?;
    }
    let coverage = coverage::partial(coverage);
    let [red, green, blue] = planes;

    // What is cheaper to predict is stored: red and blue, or their differences from green.
    let band = scratch.band_mut(side);
    let mut alone = |plane: &[u8]| {
        cheapest(side, coverage, band, |y, row| row.copy_from_slice(&plane[y * side..][..side]))
    };
    let of_channels = planes.map(&mut alone);
    let mut from_green = |plane: &[u8]| {
        cheapest(side, coverage, band, |y, row| {
            subtract(&plane[y * side..][..side], &green[y * side..][..side], row);
        })
    };
    let of_differences = [from_green(red), from_green(blue)];
    let differences =
        of_differences[0].1 + of_differences[1].1 < of_channels[RED].1 + of_channels[BLUE].1;

    payload.clear();
    payload.push(
        FORM | if coverage.is_some() { COVERAGE } else { 0 }
            | if differences { DIFFERENCES } else { 0 },
    );
    scratch.lanes_mut(side).copy_from_slice(green);
    image::write(scratch, shared, coverage, side, Some(of_channels[GREEN].0), payload);
    for (plane, alone, difference) in
        [(red, of_channels[RED], of_differences[0]), (blue, of_channels[BLUE], of_differences[1])]
    {
        let predictor = if differences {
            subtract(plane, green, scratch.lanes_mut(side));
            difference.0
        } else {
            scratch.lanes_mut(side).copy_from_slice(plane);
            alone.0
        };
        image::write(scratch, shared, coverage, side, Some(predictor), payload);
    }
    if let Some(coverage) = coverage {
        coverage::write(coverage, side, scratch, shared, payload);
    }
    Ok(())
}

/// `differences = plane - green`, wrapping.
#[inline(always)]
fn subtract(plane: &[u8], green: &[u8], differences: &mut [u8]) {
    for ((difference, &code), &green) in differences.iter_mut().zip(plane).zip(green) {
        *difference = code.wrapping_sub(green);
    }
}

/// Decodes a page of colors: texels, and their coverage where it is not 255 everywhere.
///
/// # Shapes
///
/// Row-major, `side * side`, both. Where coverage is 0 the color is `[0, 0, 0]`.
///
/// # Errors
///
/// [`DecodeError`] if the bytes are no such payload. Whatever they are, memory stays within what
/// `side` implies.
#[expect(clippy::type_complexity, reason = "texels and their coverage, as for heights")]
pub fn decode_colors(
    bytes: &[u8],
    side: usize,
) -> Result<(Vec<[u8; 3]>, Option<Vec<u8>>), DecodeError> {
    let (mut texels, mut coverage) = (Vec::new(), Vec::new());
    decode_colors_into(bytes, side, &mut Scratch::default(), &mut texels, &mut coverage)?;
    Ok((texels, (!coverage.is_empty()).then_some(coverage)))
}

/// [`decode_colors`] into `texels` and `coverage`, which ends up empty where everything is covered.
/// After an error neither holds anything of use.
///
/// # Errors
///
/// As [`decode_colors`].
pub fn decode_colors_into(
    bytes: &[u8],
    side: usize,
    scratch: &mut Scratch,
    texels: &mut Vec<[u8; 3]>,
    coverage: &mut Vec<u8>,
) -> Result<(), DecodeError> {
    let mut planes = mem::take(&mut scratch.channels);
    let decoded = decode_color_planes_into(bytes, side, scratch, &mut planes, coverage);
    let [red, green, blue] = &planes;
    texels.clear();
    texels.extend(red.iter().zip(green).zip(blue).map(|((&r, &g), &b)| [r, g, b]));
    scratch.channels = planes;
    decoded
}

/// [`decode_colors_into`] into three planes, red, green and blue.
///
/// # Shapes
///
/// The planes end up row-major, `side * side` each, `coverage` likewise or empty. Where coverage is 0
/// the codes are 0.
///
/// # Errors
///
/// As [`decode_colors`]. After one, the planes hold nothing of use.
pub fn decode_color_planes_into(
    bytes: &[u8],
    side: usize,
    scratch: &mut Scratch,
    planes: &mut [Vec<u8>; 3],
    coverage: &mut Vec<u8>,
) -> Result<(), DecodeError> {
    check_side(side).map_err(|found| DecodeError::Side { found })?;
    let mut reader = Reader::new(bytes);
    let [form] = reader.array("form")?;
    if form & !(COVERAGE | DIFFERENCES) != FORM {
        let expected = "a page of colors, 0x20 to 0x23";
        return Err(DecodeError::Field { field: "form", offset: 0, expected, found: form.into() });
    }

    let Scratch { bytes, shared, .. } = scratch;
    for plane in &mut *planes {
        plane.resize(side * side, 0);
    }
    let [red, green, blue] = planes;
    image::read(&mut reader, side, bytes, shared, |y, row| {
        green[y * side..][..side].copy_from_slice(row);
    })?;
    for plane in [&mut *red, &mut *blue] {
        image::read(&mut reader, side, bytes, shared, |y, row| {
            let plane = &mut plane[y * side..][..side];
            if form & DIFFERENCES == 0 {
                plane.copy_from_slice(row);
            } else {
                for ((code, &difference), &green) in
                    plane.iter_mut().zip(row).zip(&green[y * side..])
                {
                    *code = difference.wrapping_add(green);
                }
            }
        })?;
    }
    coverage::read(Presence::from_form(form), &mut reader, side, bytes, shared, coverage)?;
    reader.finish()?;

    if !coverage.is_empty() {
        for plane in planes {
            for (code, &covered) in plane.iter_mut().zip(&*coverage) {
                *code = if covered == 0 { 0 } else { *code };
            }
        }
    }
    Ok(())
}
