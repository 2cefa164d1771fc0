//! Rasters in, archives out.
//!
//! [`ingest::ingest`] is the whole way; [`verify`] holds its result against the laws.
//!
//! Modules stand in the order of their dependencies: a file uses only files above it.

pub mod once;

pub mod raster;

pub mod schedule;

pub mod texel;

pub mod tile;

mod gather;

pub mod border;

pub mod feather;

pub mod mip;

pub mod lowpass;

pub mod whole;

pub mod scratch;

pub mod frontier;

pub mod note;

pub mod build_error;

mod shop;

pub mod build;
pub mod origin;
pub mod truth;

pub mod mosaic;

pub mod estimate;
pub mod resample;

pub mod normals;

pub mod ingest;

pub mod verify;
