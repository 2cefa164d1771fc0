//! Rasters in, archives out.
//!
//! A raster is opened by [`raster::open`], which finds its georeferencing and hands out its samples
//! block by block.

pub mod raster;
