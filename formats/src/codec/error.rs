//! What can be wrong with a payload, or with the texels meant for one.

use super::quantum::QuantumError;

/// Texels that cannot be encoded: always the caller's fault, never data's.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EncodeError {
    /// The side of the page is outside [`SIDES`](super::SIDES).
    #[error("a page has 4 to 4098 texels a side, not {found}")]
    Side {
        /// The side asked for, in texels.
        found: usize,
    },

    /// A buffer does not have `side * side` elements.
    #[error("{what}: expected {expected} elements, found {found}")]
    Length {
        /// The buffer.
        what: &'static str,
        /// Elements that `side` asks for.
        expected: usize,
        /// Elements given.
        found: usize,
    },

    /// The quantum is not one that [`Quantum::new`](super::Quantum::new) would make.
    #[error(transparent)]
    Quantum(#[from] QuantumError),

    /// A texel is not the value of any index of the quantum.
    #[error("texel {index} is not on the step: {texel}")]
    OffStep {
        /// Row-major index of the first such texel.
        index: usize,
        /// Its value.
        texel: f32,
    },

    /// A covered texel is NaN or infinite.
    #[error("texel {index} is covered but not finite: {texel}")]
    NotFinite {
        /// Row-major index of the first such texel.
        index: usize,
        /// Its value.
        texel: f32,
    },

    /// A texel has coverage 0, yet it is not NaN.
    #[error("texel {index} has no coverage, yet a value: {texel}")]
    Uncovered {
        /// Row-major index of the first such texel.
        index: usize,
        /// Its value.
        texel: f32,
    },
}

/// A payload that cannot be decoded, and where it stopped making sense.
///
/// Offsets are in bytes from the start of the payload. Damage that keeps the structure whole goes
/// unnoticed here: the record's checksum is what proves the texels.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DecodeError {
    /// The side of the page is outside [`SIDES`](super::SIDES).
    #[error("a page has 4 to 4098 texels a side, not {found}")]
    Side {
        /// The side asked for, in texels.
        found: usize,
    },

    /// The quantum is not one that [`Quantum::new`](super::Quantum::new) would make.
    #[error(transparent)]
    Quantum(#[from] QuantumError),

    /// The payload ends inside a structure.
    #[error("{what} needs bytes {start}..{end}, but the payload has {len}")]
    Truncated {
        /// The structure being read.
        what: &'static str,
        /// Where it starts.
        start: usize,
        /// Where it should end.
        end: usize,
        /// Where the payload ends.
        len: usize,
    },

    /// A field holds a value that the format forbids.
    #[error("{field} at byte {offset}: expected {expected}, found {found}")]
    Field {
        /// The field's name in `FORMAT.md`.
        field: &'static str,
        /// Its offset.
        offset: usize,
        /// What the format allows there, in words.
        expected: &'static str,
        /// The value found.
        found: u64,
    },

    /// A bit plane does not decode to exactly its size.
    #[error("bit plane {plane} at byte {offset} is damaged")]
    Plane {
        /// The plane, 0 the least significant.
        plane: usize,
        /// Where its bytes start.
        offset: usize,
    },

    /// A covered texel of a float page is NaN or infinite.
    #[error("a covered texel is not finite: texel {index}")]
    NotFinite {
        /// Row-major index of the first such texel.
        index: usize,
    },

    /// The coverage plane says nothing that its absence would not.
    #[error("the coverage plane at byte {offset} is full everywhere")]
    FullCoverage {
        /// Where it starts.
        offset: usize,
    },

    /// Bytes follow the last structure.
    #[error("the payload ends at byte {end}, but has {len}")]
    Trailing {
        /// Where it should end.
        end: usize,
        /// Where it ends.
        len: usize,
    },
}
