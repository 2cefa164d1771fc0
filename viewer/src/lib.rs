//! Pages in, pixels out: one path for pictures without a window and with one.

pub mod camera;

mod mesh;
