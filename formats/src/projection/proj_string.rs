//! Coordinate reference systems as PROJ strings: `+proj=stere +lat_0=90 +k=1 +R=3396190 ...`.

use super::Crs;
use crate::body::EllipsoidError;

/// A PROJ string that cannot be understood, and why.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CrsError {
    /// The text has no `+proj`.
    #[error("no PROJ string: expected +proj=..., found {found:?}")]
    NoProjection {
        /// The whole text.
        found: String,
    },

    /// Something PROJ knows and this system does not.
    #[error("{found} is not supported: expected {supported}")]
    NotSupported {
        /// The parameter found, with its value.
        found: String,
        /// What would have been understood in its place.
        supported: &'static str,
    },

    /// A parameter without which the string means nothing.
    #[error("no {parameter} in {found:?}")]
    Missing {
        /// The parameters of which one is needed.
        parameter: &'static str,
        /// The whole text.
        found: String,
    },

    /// A parameter whose value makes no sense.
    #[error("{found} makes no sense: expected {expected}")]
    Value {
        /// The parameter found, with its value.
        found: String,
        /// What its value should be.
        expected: &'static str,
    },

    /// Radii that make no ellipsoid.
    #[error("the surface makes no sense: {0}")]
    Ellipsoid(#[from] EllipsoidError),
}

impl Crs {
    /// The system as a PROJ string that reads back equal to the last bit.
    #[must_use]
    pub fn proj_string(&self) -> String {
        unimplemented!()
    }

    /// The system that a PROJ string in meters describes.
    ///
    /// # Errors
    ///
    /// [`CrsError`] if the string is not understood or its map units are not meters.
    pub fn from_proj_string(_text: &str) -> Result<Self, CrsError> {
        unimplemented!()
    }

    /// The system that a PROJ string describes, and how many meters its map unit has.
    ///
    /// # Errors
    ///
    /// [`CrsError`] if the string is not understood.
    pub fn from_proj_string_with_unit(_text: &str) -> Result<(Self, f64), CrsError> {
        unimplemented!()
    }
}
