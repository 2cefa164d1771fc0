//! The coverage plane: how much of each texel is valid, 0 to 255.

use super::bits::Lane;
use super::error::DecodeError;
use super::image::{self, ImageScratch, PlaneScratch};
use super::predict::cheapest;
use super::reader::Reader;

/// The plane if it says anything: `None` where everything is covered.
pub(super) fn partial(coverage: Option<&[u8]>) -> Option<&[u8]> {
    coverage.filter(|coverage| coverage.iter().any(|&covered| covered != u8::MAX))
}

/// Appends the plane as a lane image of 8 bits.
pub(super) fn write(
    coverage: &[u8],
    side: usize,
    scratch: &mut ImageScratch<u8>,
    shared: &mut PlaneScratch,
    out: &mut Vec<u8>,
) {
    scratch.lanes_mut(side).copy_from_slice(coverage);
    let (predictor, _) = cheapest(&scratch.lanes, side);
    image::write(scratch, shared, None, side, predictor, out);
}

/// Reads the plane into `coverage`, or clears it where the payload has none.
pub(super) fn read(
    present: Presence,
    reader: &mut Reader<'_>,
    side: usize,
    scratch: &mut ImageScratch<u8>,
    shared: &mut PlaneScratch,
    coverage: &mut Vec<u8>,
) -> Result<(), DecodeError> {
    coverage.clear();
    if present == Presence::Absent {
        return Ok(());
    }
    let offset = reader.position();
    image::read(reader, side, scratch, shared)?;
    coverage.extend_from_slice(scratch.lanes_mut(side));
    match partial(Some(coverage)) {
        Some(_) => Ok(()),
        None => Err(DecodeError::FullCoverage { offset }),
    }
}

/// Whether a payload has a coverage plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Presence {
    /// It has one, and it is not full everywhere.
    Present,
    /// It has none: everything is covered.
    Absent,
}

impl Presence {
    /// What flag 1 of the form says.
    pub(super) const fn from_form(form: u8) -> Self {
        if form & 1 == 0 { Self::Absent } else { Self::Present }
    }
}

/// Gives lanes without coverage the last covered value before them, so that choosing a predictor
/// by sampling sees no cliffs at the rims of holes.
pub(super) fn hold<L: Lane>(coverage: &[u8], lanes: &mut [L]) {
    let mut last = L::default();
    for (lane, &covered) in lanes.iter_mut().zip(coverage) {
        if covered == 0 {
            *lane = last;
        } else {
            last = *lane;
        }
    }
}
