//! The geometry of a view: which triangles of the planet to draw, made in f64 on the CPU.

pub(crate) mod sphere;

pub(crate) mod tree;

pub(crate) mod frame;

pub(crate) mod detail;

pub(crate) mod patches;
