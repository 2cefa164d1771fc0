//! The structures that the shaders read, as Rust lays them out.
//!
//! Each mirrors the WGSL structure of its name, whose comments say what the fields are; a test
//! compares the offsets.

use bytemuck::{Pod, Zeroable};

/// Mirrors `struct Scene` of `shader/scene.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub(crate) struct Scene {
    pub(crate) right: [f32; 3],
    pub(crate) focal_x: f32,
    pub(crate) up: [f32; 3],
    pub(crate) focal_y: f32,
    pub(crate) backward: [f32; 3],
    pub(crate) near: f32,
    pub(crate) sun: [f32; 3],
    pub(crate) ambient: f32,
    pub(crate) background: [f32; 3],
    pub(crate) exaggeration: f32,
    pub(crate) viewport: [u32; 2],
    pub(crate) equatorial_radius: f32,
    pub(crate) eccentricity2: f32,
    pub(crate) bare: [f32; 3],
    pub(crate) pixel_angle: f32,
    pub(crate) stops: [[f32; 4]; 256],
    pub(crate) ramp_stops: u32,
    pub(crate) ramp_opacity: f32,
    pub(crate) anisotropy: i32,
    pub(crate) exposure: f32,
    pub(crate) relief: [f32; 3],
    pub(crate) debug: u32,
    pub(crate) slot_bounds: i32,
    pub(crate) tolerance_px: f32,
    pub(crate) edges: u32,
    pub(crate) patches: u32,
}

/// Mirrors `struct Atmosphere` of `shader/atmosphere.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub(crate) struct Atmosphere {
    pub(crate) rayleigh: [f32; 3],
    pub(crate) rayleigh_height: f32,
    pub(crate) mie: [f32; 3],
    pub(crate) mie_height: f32,
    pub(crate) mie_extinction: [f32; 3],
    pub(crate) asymmetry: f32,
    pub(crate) eye_up: [f32; 3],
    pub(crate) eye_height: f32,
    pub(crate) radius: f32,
    pub(crate) top: f32,
    pub(crate) _pad: [u32; 2],
}

/// Mirrors `struct Frame` of `shader/frame.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub(crate) struct Frame {
    pub(crate) origin: [f32; 3],
    pub(crate) height: f32,
    pub(crate) east: [f32; 3],
    pub(crate) _pad0: u32,
    pub(crate) north: [f32; 3],
    pub(crate) _pad1: u32,
    pub(crate) up: [f32; 3],
    pub(crate) lists: [u32; 5],
}

/// Mirrors `struct Anchor` of `shader/map.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub(crate) struct Anchor {
    pub(crate) texel: [i32; 2],
    pub(crate) fraction: [f32; 2],
    pub(crate) matrix: [f32; 4],
    pub(crate) dataset: u32,
    pub(crate) _pad: [u32; 3],
}

/// Mirrors `struct Dataset` of `shader/map.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub(crate) struct Dataset {
    pub(crate) size: [i32; 2],
    pub(crate) interior: i32,
    pub(crate) levels: i32,
    pub(crate) first_window: i32,
    pub(crate) priority: i32,
    pub(crate) polar: i32,
    pub(crate) wraps: i32,
    pub(crate) period: f32,
    pub(crate) latitude_ratio: f32,
    pub(crate) hemisphere: f32,
    pub(crate) eccentricity: f32,
    pub(crate) ground: [f32; 2],
    pub(crate) weight: f32,
    pub(crate) series: u32,
    pub(crate) roots: i32,
    pub(crate) deepest: i32,
    pub(crate) poles: u32,
    pub(crate) number: u32,
    pub(crate) stops: [u32; 2],
}

/// Mirrors `struct Edge` of `shader/patch.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub(crate) struct Edge {
    pub(crate) frames: [u32; 3],
    pub(crate) half_chord: f32,
    pub(crate) direction: [f32; 2],
    pub(crate) distance: f32,
    pub(crate) come: f32,
}

/// Mirrors `struct Patch` of `shader/patch.wgsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub(crate) struct Patch {
    pub(crate) corner_a: [f32; 3],
    pub(crate) frame: u32,
    pub(crate) corner_b: [f32; 3],
    pub(crate) sides: u32,
    pub(crate) corner_c: [f32; 3],
    pub(crate) distance: f32,
    pub(crate) edges: [u32; 3],
    pub(crate) come: f32,
}
