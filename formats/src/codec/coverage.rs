//! The coverage plane: how much of each texel is valid, 0 to 255.

use super::bits::Lane;
use super::error::DecodeError;
use super::image::{self, ImageScratch, PlaneScratch};
use super::reader::Reader;

/// The plane if it says anything: `None` where everything is covered.
pub(super) fn partial(coverage: Option<&[u8]>) -> Option<&[u8]> {
    coverage.filter(|coverage| any(coverage, |covered| covered != u8::MAX))
}

/// Whether all texels are covered, if only a little.
#[inline(always)]
pub(super) fn all(coverage: &[u8]) -> bool {
    !any(coverage, |covered| covered == 0)
}

/// Whether `holds` of any: by chunks without an exit, which become vectors.
#[inline(always)]
fn any(coverage: &[u8], holds: impl Fn(u8) -> bool) -> bool {
    coverage.chunks(256).any(|chunk| chunk.iter().fold(false, |any, &covered| any | holds(covered)))
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
    image::write(scratch, shared, None, side, None, out);
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
    if present == Presence::Absent {
        coverage.clear();
        return Ok(());
    }
    let offset = reader.position();
    coverage.resize(side * side, 0);
    image::read(reader, side, scratch, shared, |y, row| {
        coverage[y * side..][..side].copy_from_slice(row);
    })?;
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

/// Gives lanes of a row without coverage the last covered value before them, or 0.
pub(super) fn hold<L: Lane>(coverage: &[u8], row: &mut [L]) {
    if all(coverage) {
        return;
    }
    let mut last = L::default();
    for (lane, &covered) in row.iter_mut().zip(coverage) {
        last = if covered == 0 { last } else { *lane };
        *lane = last;
    }
}
