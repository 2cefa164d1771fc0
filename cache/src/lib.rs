//! Views in, pages out.
//!
//! ```text
//!   View ──Session──▶ search ──▶ wanted pages ──▶ loads (tokio) ──▶ decoded pages, on a budget
//!                        └────────▶ Selection: the best that is in memory now ◀──────┘
//! ```
//!
//! Modules stand in the order of their dependencies: a file uses only files above it.

pub mod view;

pub mod selection;

mod scene;

mod search;

mod store;

mod loader;

mod engine;

mod session;

mod cache;

pub use cache::{Cache, CacheError, Opening, Options, Progress};
pub use selection::{DatasetInfo, FailedPage, ResidentPage, Selection};
pub use session::Session;
pub use store::Stats;
pub use view::View;

#[cfg(test)]
mod tests;
