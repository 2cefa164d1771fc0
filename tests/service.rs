//! A catalog over HTTP: what is asked and answered, who may not enter, and what happens under it.
//!
//! ```text
//!   rig        a small catalog, a service of it, and requests byte by byte
//!   endpoints  what `cache/HTTP.md` says
//!   entry      nobody enters
//!   faults     damaged and missing files, clients that misbehave, too many of everything
//!   full       a disk that fills up during an insertion
//!   changes    insertion, removal, other processes, and a reader that never sees a mixture
//!   process    the binary: signals, descriptors, killed during an insertion
//!   remote     a server read from afar
//!   server     the binary, for the others
//!   sessions   views of a server, as of its folder; restarts
//!   nonsense   servers that answer nonsense
//! ```
//!
//! A short form by default; `AREOID_SOAK=1` makes it 1,000 rounds.

#![cfg(unix)]
#![expect(clippy::unwrap_used, reason = "a failed test may panic")]

#[path = "support/mounted.rs"]
mod mounted;

mod service {
    mod changes;
    mod endpoints;
    mod entry;
    mod faults;
    mod full;
    mod nonsense;
    mod process;
    mod remote;
    mod rig;
    mod road;
    mod server;
    mod sessions;
}
