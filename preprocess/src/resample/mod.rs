//! Leaves of any grid from rasters on any other.
//!
//! ```text
//!   target tile ─▶ transform ─▶ coords ─┐
//!   blocks ─▶ prepared tiles ─▶ window ─┴─▶ kernel ─▶ texels
//!   (decoded)  (filled, filtered)
//! ```

pub mod tile;

pub mod extension;
pub mod source;

pub mod prepare;

pub mod window;

pub mod kernel;
