//! Views in, pages out.
//!
//! ```text
//!   View ──Session──▶ search ──▶ wanted pages ──▶ loads (tokio) ──▶ decoded pages, on a budget
//!                        └────────▶ Selection: the best that is in memory now ◀──────┘
//! ```
//!
//! Modules stand in the order of their dependencies: a file uses only files above it.

mod words;

mod locks;

pub mod view;

pub mod camera;

pub mod flight;

pub mod selection;

pub mod pages;

pub mod stats;

pub mod insertion;

pub mod insertion_request;

pub mod remote;

pub mod place;

mod scene;

mod memo;

mod found;

mod search;

mod store;

mod held;

mod matching;

mod lookout;

mod loader;

mod engine;

mod motion;

mod coming;

mod session;

mod single;

mod height;

mod open;

mod follow;

mod follow_server;

mod cache;

pub mod describe;

pub mod service;

pub use cache::{Cache, Opening, Options, Progress};
pub use height::Height;
pub use open::CacheError;
pub use pages::PageSource;
pub use place::Place;
pub use selection::{DatasetInfo, Datasets, FailedPage, ResidentPage, Selection};
pub use session::Session;
pub use single::PageError;
pub use stats::Stats;
pub use view::View;

#[cfg(test)]
mod tests;
