//! What the tests of the laws stand on.
//!
//! ```text
//!   raster      samples made up here, and the outline they fill
//!   geotiff     rasters as files
//!   levels      the oracle: what every level holds, from the words of the design alone
//!   oracle      the oracle's answers: reconstructions, suprema, ranges
//!   lawful      an archive held against the oracle, page by page
//!   areoid      the command line
//! ```
//!
//! Nothing in `levels` and `oracle` calls the code under test.

pub(crate) mod areoid;
pub(crate) mod geotiff;
pub(crate) mod lawful;
pub(crate) mod levels;
pub(crate) mod oracle;
pub(crate) mod raster;
