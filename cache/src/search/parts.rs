//! What the parts of a page tell of it: their boxes are tighter than its own.

use areoid_formats::bounds::Position;
use areoid_formats::volume::Volume;

use super::Search;
use crate::found::{Found, Seen};
use crate::memo::{Memo, Verdict};
use crate::view::Sight;

impl Search<'_> {
    /// How many levels of parts are looked at to see less of a page, or none.
    pub(super) const PARTS: u32 = 3;

    /// How often the sides of the last parts are halved for that.
    pub(super) const HALVINGS: u32 = 3;

    /// Drops wanted pages of which no part is in sight: at the rim of the picture, a box reaches around
    /// corners that its parts do not. Mostly a page's own middle tells, for which no part has to be fetched; its
    /// box is not flat, and some pages stay that could go. Children without data say nothing about what the
    /// page shows there. A part whose middle is in sight ends it: boxes of parts are flat.
    pub(super) fn drop_unseen(&self, memo: &mut Memo, found: &mut Found) {
        let Found { wanted, seen, visited, culled, .. } = found;
        wanted.retain(|&place| {
            let Seen { dataset, page, is_in, .. } = seen[place];
            if is_in {
                return true;
            }
            let dataset = &self.scene.datasets[dataset];
            if page.level == dataset.finest {
                return true;
            }
            let unseen =
                memo.all_parts(dataset, page, (Self::PARTS, true), visited, &|part, is_last| {
                    let halvings = if is_last { Self::HALVINGS } else { 0 };
                    if self.lenses.iter().any(|lens| lens.shows(part.volume.bounds().center)) {
                        Verdict::No
                    } else if self.is_unseen(&part.volume, halvings) {
                        Verdict::Yes
                    } else {
                        Verdict::Unsure
                    }
                });
            *culled += usize::from(unseen);
            !unseen
        });
    }

    /// Whether a part is out of sight, by itself or quarter by quarter.
    fn is_unseen(&self, part: &Volume, halvings: u32) -> bool {
        let mut is_across = false;
        for lens in self.lenses {
            match lens.position(part) {
                Position::Within => return false,
                Position::Across => is_across = true,
                Position::Outside => {}
            }
        }
        let is_unseen = |quarter: &Volume| self.is_unseen(quarter, halvings - 1);
        !is_across || halvings > 0 && part.quarters().iter().all(is_unseen)
    }

    /// Whether an error is within the tolerance wherever a part is seen.
    pub(super) fn is_fine(
        &self,
        part: &Volume,
        (error_m, tolerance_px): (f64, f64),
        halvings: u32,
    ) -> Verdict {
        let sights = self.lenses.iter().map(|lens| lens.sight(part));
        if self.worst(error_m, sights) <= tolerance_px {
            return Verdict::Yes;
        }
        // Where it is farthest off, in the middle of a picture.
        let bounds = part.bounds();
        let farthest = self.lenses.iter().map(|lens| {
            let distance = lens.eye.distance(bounds.center) + bounds.radius();
            Sight { distance, reach: distance, is_whole: false }
        });
        if self.worst(error_m, farthest) > tolerance_px {
            return Verdict::No;
        }
        let is_fine =
            |quarter| self.is_fine(&quarter, (error_m, tolerance_px), halvings - 1) == Verdict::Yes;
        if halvings > 0 && part.quarters().into_iter().all(is_fine) {
            Verdict::Yes
        } else {
            Verdict::Unsure
        }
    }
}
