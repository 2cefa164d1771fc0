//! Rasters in, archives out.
//!
//! Modules stand in the order of their dependencies: a file uses only files above it.

pub mod schedule;
