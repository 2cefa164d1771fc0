//! Pages of colors: three channels of sRGB codes.
//!
//! ```text
//!   0           form, u8: 0x20 | 1 with a coverage plane | 2 with differences
//!   1           lane image of 8 bits: green
//!   ..          lane image of 8 bits: red, or red - green, wrapping
//!   ..          lane image of 8 bits: blue, or blue - green, wrapping
//!   ..          lane image of 8 bits: the coverage, if there is any
//! ```

use super::coverage::{self, Presence};
use super::error::{DecodeError, EncodeError};
use super::image;
use super::predict::{Predictor, cheapest};
use super::reader::Reader;
use super::{Scratch, check_length, check_side};

const FORM: u8 = 0x20;
const COVERAGE: u8 = 1;
const DIFFERENCES: u8 = 2;

/// Green first: the differences need it.
const ORDER: [usize; 3] = [1, 0, 2];

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
    if let Some(coverage) = coverage {
        check_length("coverage", coverage.len(), side * side)?;
    }
    let coverage = coverage::partial(coverage);
    let Scratch { bytes, shared, channels, .. } = scratch;

    // Red, green, blue, red - green, blue - green: what is cheaper to predict is stored.
    let mut predictors = [(Predictor::None, 0); 5];
    for (which, (channel, predictor)) in channels.iter_mut().zip(&mut predictors).enumerate() {
        channel.clear();
        match which {
            0..3 => channel.extend(texels.iter().map(|texel| texel[which])),
            3 => channel.extend(texels.iter().map(|[r, g, _]| r.wrapping_sub(*g))),
            _ => channel.extend(texels.iter().map(|[_, g, b]| b.wrapping_sub(*g))),
        }
        if let Some(coverage) = coverage {
            coverage::hold(coverage, channel);
        }
        *predictor = cheapest(channel, side);
    }
    let [(_, red), _, (_, blue), (_, red_green), (_, blue_green)] = predictors;
    let differences = red_green + blue_green < red + blue;
    let stored = if differences { [1, 3, 4] } else { ORDER };

    payload.clear();
    payload.push(
        FORM | if coverage.is_some() { COVERAGE } else { 0 }
            | if differences { DIFFERENCES } else { 0 },
    );
    for which in stored {
        bytes.lanes_mut(side).copy_from_slice(&channels[which]);
        image::write(bytes, shared, coverage, side, predictors[which].0, payload);
    }
    if let Some(coverage) = coverage {
        coverage::write(coverage, side, bytes, shared, payload);
    }
    Ok(())
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
    check_side(side).map_err(|found| DecodeError::Side { found })?;
    let mut reader = Reader::new(bytes);
    let [form] = reader.array("form")?;
    if form & !(COVERAGE | DIFFERENCES) != FORM {
        let expected = "a page of colors, 0x20 to 0x23";
        return Err(DecodeError::Field { field: "form", offset: 0, expected, found: form.into() });
    }

    let Scratch { bytes, shared, channels, .. } = scratch;
    for which in ORDER {
        image::read(&mut reader, side, bytes, shared)?;
        channels[which].clear();
        channels[which].extend_from_slice(bytes.lanes_mut(side));
    }
    coverage::read(Presence::from_form(form), &mut reader, side, bytes, shared, coverage)?;
    reader.finish()?;

    let [red, green, blue, ..] = channels;
    let channels = red.iter().zip(&*green).zip(&*blue);
    texels.clear();
    if form & DIFFERENCES == 0 {
        texels.extend(channels.map(|((&r, &g), &b)| [r, g, b]));
    } else {
        texels.extend(channels.map(|((&r, &g), &b)| [r.wrapping_add(g), g, b.wrapping_add(g)]));
    }
    for (texel, &covered) in texels.iter_mut().zip(&*coverage) {
        if covered == 0 {
            *texel = [0; 3];
        }
    }
    Ok(())
}
