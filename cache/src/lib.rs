//! Views in, pages out.
//!
//! ```text
//!   View ──Session──▶ search ──▶ wanted pages ──▶ loads (tokio) ──▶ decoded pages, on a budget
//!                        └────────▶ Selection: the best that is in memory now ◀──────┘
//! ```

pub mod view;

pub mod selection;

pub use selection::{DatasetInfo, FailedPage, ResidentPage, Selection};
pub use view::View;
