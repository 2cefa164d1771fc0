//! The window: a surface, a panel and a hand on the renderer that pictures without a window use too.
//!
//! | input | does |
//! |---|---|
//! | left drag, arrow keys | moves the ground |
//! | wheel, `+`, `-` | nearer and farther, from space to the ground |
//! | right drag, or left drag with Shift | turns and tilts |
//! | `N` | north ahead |
//! | `E` | heights 1, 2, 4, 8 times |
//! | `L` | light from the left shoulder, from the sun, as on maps |
//! | `A` | atmosphere |
//! | `C` | colors by height |
//! | `D` | levels, datasets, pages, what stands in |
//! | `V` | one view, two places side by side, two eyes, a wall of three screens |
//! | `B`, `1` to `9` | puts a bookmark, goes to one |
//! | `R` | begins and ends to record a flight |
//! | `P` | saves a screenshot |
//! | `H` | hides the panel and shows it |
//! | a file dropped on it | is inserted as a dataset |
//! | `Esc` | ends |
//!
//! It draws when the view, its pages or the panel change, and not otherwise.

mod arrangement;
mod hand;
mod host;
mod legend;
mod painter;
mod panel;
mod presenter;
mod record;
mod settings;
mod viewer;

use areoid_formats::body::Ellipsoid;
use areoid_formats::geodesy::Geographic;
use winit::event_loop::EventLoop;

use crate::gpu::GpuError;
use crate::style::Style;
pub use host::{Content, Host, Insertion, InsertionState};
use viewer::Viewer;

/// What a window starts with.
#[derive(Clone, Debug, PartialEq)]
pub struct WindowOptions {
    /// In the title bar.
    pub title: String,
    /// The body shown.
    pub ellipsoid: Ellipsoid,
    /// What the cache has for pages.
    pub budget_bytes: u64,
    /// Above which place.
    pub start: Geographic,
    /// The error that may show, in pixels.
    pub tolerance_px: f64,
    /// How the datasets take part at first.
    pub style: Style,
}

/// Why a window cannot be shown.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WindowError {
    /// There is no display, or it broke off.
    #[error("no window")]
    EventLoop(#[source] winit::error::EventLoopError),
    /// The display gives no window.
    #[error("no window")]
    Window(#[source] winit::error::OsError),
    /// The window gives no surface to draw on.
    #[error("the window cannot be drawn on")]
    Surface(#[source] wgpu::CreateSurfaceError),
    /// The adapter cannot present to it.
    #[error("the graphics adapter cannot present to the window")]
    Unsupported,
    /// There is nothing to draw with.
    #[error(transparent)]
    Gpu(#[from] GpuError),
}

/// Shows a window until it is closed, on this thread.
///
/// # Errors
///
/// Any [`WindowError`].
pub fn run(options: WindowOptions, host: impl Host) -> Result<(), WindowError> {
    let event_loop = EventLoop::builder().build().map_err(WindowError::EventLoop)?;
    let mut viewer = Viewer::new(options, host);
    event_loop.run_app(&mut viewer).map_err(WindowError::EventLoop)?;
    viewer.outcome
}
