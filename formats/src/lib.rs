//! The vocabulary and the bytes of Areoid.
//!
//! Modules stand in the order of their dependencies: a file uses only files above it.

pub mod lanes;

pub mod units;

pub mod body;

pub mod geodesy;

pub mod normal;

pub mod projection;

pub mod address;

pub mod pyramid;

pub mod placement;

pub mod grid;

pub mod codec;

pub mod page;

pub mod bound;

pub mod compose;

pub mod bounds;

mod footprint;

pub mod volume;

pub mod bvh;

pub mod storage;

pub mod archive;

pub mod query;

pub mod catalog;
