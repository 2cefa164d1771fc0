//! What can go wrong with a build.

use std::io;

use areoid_formats::address::PageAddress;
use areoid_formats::codec::EncodeError;

use crate::raster::RasterError;

/// A build that did not come to its end.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BuildError {
    /// The source cannot be read.
    #[error(transparent)]
    Raster(#[from] RasterError),
    /// A texel that cannot be stored on the dataset's step.
    #[error("page {page} holds a height that the step {step:?} cannot store in 32 bits")]
    Step {
        /// The page.
        page: PageAddress,
        /// The step in meters.
        step: f64,
    },
    /// A page that does not encode.
    #[error("page {page} does not encode")]
    Encode {
        /// The page.
        page: PageAddress,
        /// What the codec says.
        source: EncodeError,
    },
    /// The archive cannot be written.
    #[error("cannot write the archive")]
    Write(#[source] io::Error),
    /// What was written does not reach the medium. It may never: whoever asks again is told that all
    /// is well.
    #[error("the archive does not reach the medium")]
    Sync(#[source] io::Error),
    /// The scratch file cannot be written or read.
    #[error("cannot keep pages in the scratch file")]
    Scratch(#[source] io::Error),
    /// A description whose [`MipRule`](areoid_formats::archive::MipRule) is unknown.
    #[error("how coarser texels are to be made only a later version knows")]
    MipRule,
    /// Nothing to build.
    #[error("no valid sample: every one is no-data")]
    NoData,
    /// The caller asked to stop.
    #[error("interrupted")]
    Interrupted,
}

impl BuildError {
    /// Whether the same build of the same rasters may come to its end another time.
    #[must_use]
    pub fn may_go_away(&self) -> bool {
        match self {
            Self::Raster(error) => matches!(error, RasterError::Io { .. }),
            Self::Write(_) | Self::Scratch(_) | Self::Interrupted => true,
            Self::Step { .. } | Self::Encode { .. } | Self::Sync(_) => false,
            Self::MipRule | Self::NoData => false,
        }
    }
}
