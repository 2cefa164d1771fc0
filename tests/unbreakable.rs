//! Whatever happens to an ingest, the catalog opens to what was committed before, and `--resume`
//! makes the bytes of an ingest that nothing happened to.
//!
//! ```text
//!   rig        rasters, catalogs, and the binary run on them
//!   kills      killed at random instants, resumed, killed again
//!   damage     what a killed build left is cut, overwritten, another's
//!   same       the same bytes for any threads and memory; nothing to do; memory is bounded
//!   churn      processes that ingest, replace and remove in one catalog while others read it
//!   full       a disk without room
//!   many       more datasets than files may be open
//!   modified   rasters that change while they are read
//!   hints      what is said of going on
//!   stray      archives that only lack a manifest that names them
//!   groups     datasets that are named, replaced and removed as one
//!   split      a raster split into such a group
//! ```
//!
//! A short form by default; `AREOID_SOAK=1` makes it 200 kills and a minute of churn.

#![cfg(unix)]
#![expect(clippy::unwrap_used, reason = "a failed test may panic")]
#![expect(clippy::print_stdout, reason = "figures, for whoever asks for them")]
#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "made-up rasters are small, and their values are chosen"
)]

#[expect(dead_code, reason = "most of it is for the laws")]
mod support;

#[path = "support/mounted.rs"]
mod mounted;

mod unbreakable {
    mod churn;
    mod damage;
    mod full;
    mod groups;
    mod hints;
    mod kills;
    mod many;
    mod modified;
    mod rig;
    mod same;
    mod split;
    mod stray;
}
