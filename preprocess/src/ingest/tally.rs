//! How far an ingest of several parts is, told as that of one build.

use std::time::Duration;

use areoid_formats::archive::Description;

use super::UNIT_PAGES;
use crate::build::Progress;
use crate::feather::HALO;
use crate::lowpass;
use crate::schedule::Schedule;

/// What the parts that are done add to the progress of one that is not.
pub(super) struct Tally {
    /// Of the parts that are done; of the units, those of all parts.
    done: Progress,
    /// Of the part that is being built.
    here: Progress,
}

impl Tally {
    /// Before the first part.
    pub(super) fn new<'a>(descriptions: impl Iterator<Item = &'a Description>) -> Self {
        Self { done: Progress { units: descriptions.map(units).sum(), ..NONE }, here: NONE }
    }

    /// That of all parts, where the part that is being built is at `here`.
    pub(super) fn with(&mut self, here: Progress) -> Progress {
        self.here = here;
        let done = &self.done;
        Progress {
            units_done: done.units_done + here.units_done,
            units_resumed: done.units_resumed + here.units_resumed,
            units: done.units,
            leaves: done.leaves + here.leaves,
            texels: done.texels + here.texels,
            texels_skipped: done.texels_skipped + here.texels_skipped,
            bytes: done.bytes + here.bytes,
            elapsed: done.elapsed + here.elapsed,
        }
    }

    /// The part that was being built is done.
    pub(super) fn end_part(&mut self) {
        self.done = self.with(self.here);
        self.here = NONE;
    }

    /// The next part was done before: an archive of `bytes`.
    pub(super) fn skip_part(&mut self, description: &Description, bytes: u64) -> Progress {
        let extent = description.grid.pyramid().extent();
        let texels = u64::from(extent.width) * u64::from(extent.height);
        let units = units(description);
        let (units_done, units_resumed, texels_skipped) = (units, units, texels);
        self.here = Progress { units_done, units_resumed, texels, texels_skipped, bytes, ..NONE };
        self.end_part();
        self.done
    }

    /// Texels that were worked through.
    pub(super) fn pixels(&self) -> u64 {
        self.done.texels - self.done.texels_skipped
    }
}

const NONE: Progress = Progress {
    units_done: 0,
    units_resumed: 0,
    units: 0,
    leaves: 0,
    texels: 0,
    texels_skipped: 0,
    bytes: 0,
    elapsed: Duration::ZERO,
};

/// Work units of a dataset.
pub(super) fn units(description: &Description) -> usize {
    Schedule::new(description.grid.pyramid(), UNIT_PAGES, HALO, lowpass::reach(description.mip))
        .remaining()
}
