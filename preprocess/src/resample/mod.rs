//! Leaves of any grid from rasters on any other.
//!
//! ```text
//!   target tile ─▶ transform ─▶ coords ─┐
//!   blocks ─▶ prepared tiles ─▶ window ─┴─▶ kernel ─▶ texels
//!   (decoded)  (filled, filtered)
//! ```

pub mod tile;

pub mod transform;

pub mod needs;

pub mod target;
