//! The service, from outside: `areoid serve` under wrk, beside nginx with the same bytes as files.
//!
//! ```text
//!   pages ──▶ servers ──▶ wrk ─┬─▶ serve  requests a second and their times, beside nginx
//!                              └─▶ live   the same while a raster is inserted; who sees it when
//! ```

mod pages;

mod servers;

mod wrk;

mod live;

mod serve;

use std::path::{Path, PathBuf};

use super::Setting;
use crate::bench::peers::Peers;

pub(super) use live::measure as live;
pub(super) use serve::measure as serve;

/// What both chapters measure with.
#[derive(Clone, Copy, Debug)]
pub(super) struct Outside<'a> {
    pub(super) setting: Setting,
    pub(super) folder: &'a Path,
    pub(super) peers: &'a Peers,
}

impl Outside<'_> {
    /// Of one run of wrk: whole seconds, which is what it takes.
    fn run_seconds(&self) -> u64 {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "seconds")]
        let seconds = (self.setting.seconds / 5.0).ceil() as u64;
        seconds.max(1)
    }

    fn work(&self, name: &str) -> PathBuf {
        self.folder.join("work").join(name)
    }
}
