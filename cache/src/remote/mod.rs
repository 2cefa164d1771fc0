//! A server's catalog, as if it were a folder's.
//!
//! ```text
//!   Archive ──▶ HttpSource ──▶ disk cache ──▶ ranges of /v1/archives/{file}, retried, in bounded time
//! ```

mod client;

mod administer;

mod blocks;

mod source;

mod catalog;

pub use administer::{insert, remove};
pub use blocks::Blocks;
pub use catalog::RemoteCatalog;
pub use client::{Client, RemoteError};
pub use source::HttpSource;
