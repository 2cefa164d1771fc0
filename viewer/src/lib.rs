//! Pages in, pixels out: one path for pictures without a window and with one.
//!
//! ```text
//!   View, Selection ──▶ mesh (f64, CPU) ──▶ deferred buffer ──▶ composition, light ──▶ picture
//! ```
//!
//! Modules stand in the order of their dependencies: a file uses only files above it.

pub use areoid_cache::camera;

pub mod orbit;

mod known_body;

pub mod style;

pub mod sun;

mod mirror;

pub mod atmosphere;

mod shader;

mod blend;

pub mod surface;

pub mod pick;

mod map;

mod mesh;

mod gpu;

mod full_screen;

mod atlas;

mod render;

pub mod yardstick;

pub mod window;

#[cfg(test)]
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::print_stdout,
    reason = "tests round small known numbers and say how exact they are"
)]
mod testing;

pub use atmosphere::Atmosphere;
pub use gpu::{Gpu, GpuError};
pub use pick::Picked;
pub use render::{Aovs, Debug, FrameStatistics, Image, Light, Options, Relief, Renderer, Usage};
pub use style::Style;
