//! Rasters as files.
