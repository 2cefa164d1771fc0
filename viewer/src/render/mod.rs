//! One path from a selection to a picture, with a window or without.

mod aovs;
mod buffers;
mod linger;
mod options;
mod pattern;
mod pipelines;
mod renderer;
mod resident;
mod scene;
mod targets;
mod usage;

#[cfg(test)]
pub(crate) mod testing;

pub use aovs::Aovs;
pub use options::{Debug, FrameStatistics, Image, Light, Options, Relief};
pub use renderer::Renderer;
pub use usage::Usage;
