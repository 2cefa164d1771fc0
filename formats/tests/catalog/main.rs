//! Catalogs whose writers die at every step, and writers that meet.
//!
//! ```text
//!   dying      a disk that stops working after so many steps
//!   rig        datasets published, and what a catalog shows
//!   killed     writers that die at every step, or find no room
//!   refused    changes and names that are refused, and leave everything
//!   forged     files that a catalog did not write
//!   groups     datasets that come and go as one
//!   meeting    writers and readers at once
//! ```

#![expect(clippy::unwrap_used, reason = "tests: a panic is a failure")]

mod dying;
mod forged;
mod groups;
mod killed;
mod meeting;
mod refused;
mod rig;
