//! Bytes in memory that the system sends by itself, without another copy of them.
//!
//! ```text
//!   payload ──▶ a range of a file that is only memory ──▶ mapped: `Bytes` for whoever reads them
//!                                 └──▶ sendfile: the socket holds the file's pages themselves
//! ```
//!
//! With many connections the sockets hold more than a processor's caches do, and copying into them is what
//! an answer costs. A range is written once, before it is mapped, and given back when the last of its
//! `Bytes` is dropped; pages that a socket still holds live until they are sent. Ranges follow one another
//! in a file that has no end: given back, they take nothing.

#[cfg(target_os = "linux")]
mod crowd;

#[cfg(target_os = "linux")]
mod linux;

#[cfg(not(target_os = "linux"))]
mod elsewhere;

#[cfg(not(target_os = "linux"))]
pub(super) use elsewhere::Shelf;
#[cfg(target_os = "linux")]
pub(super) use linux::Shelf;
