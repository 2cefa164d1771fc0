//! A catalog over HTTP: read by anybody, changed by whoever has the token.
//!
//! ```text
//!   public ──▶ connections ──▶ requests ──▶ snapshot ──▶ memory ──▶ Bytes
//!                 (limits)      (limits)        │           └─ fault ─▶ blocking read, proven
//!   admin  ──▶ token ──▶ insertion (idle) ──▶ next snapshot ──▶ events
//! ```
//!
//! `cache/HTTP.md` documents what is asked and answered. A core has a runtime of one thread; all of them
//! take connections from one listener. What may wait for a disk runs on threads that may.

mod watch;

mod filed;

mod answer;

mod snapshot;

mod metrics;

mod pages;

mod hub;

mod archives;

mod ranges;

mod public;

mod stream;

mod lanes;

mod cores;

mod listen;

mod options;

mod admin;

mod mutate;

mod run;

#[cfg(test)]
mod slow;

pub use listen::Limits;
pub use options::{Admin, Options, ServiceError};
pub use run::{Service, run};
