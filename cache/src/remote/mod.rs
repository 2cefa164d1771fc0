//! A server's catalog, as if it were a folder's.
//!
//! ```text
//!   Archive ──▶ HttpSource ──▶ blocks on the disk ──▶ ranges of /v1/archives/{file}, retried, in bounded time
//!   Listing ──▶ /v1/catalog, whenever Events, /v1/events, say so
//!   Link: whether anybody is there, as all of these have found
//! ```

mod link;

mod client;

mod administer;

mod blocks;

mod range;

mod claims;

mod kept;

mod source;

mod pages;

mod catalog;

mod events;

pub use administer::{insert, remove};
pub use blocks::Blocks;
pub use catalog::{RemoteCatalog, RemoteDataset};
pub use client::{Client, RemoteError};
pub use pages::RemotePages;
pub use source::HttpSource;

pub(crate) use catalog::{Listing, each};
pub(crate) use events::Events;
