//! How the memory of an ingest is shared out.
//!
//! ```text
//!   --memory-mib ─┬─ the step: next leaves, pages looked at together, what each thread works with
//!                 ├─ 3/4 of the rest: pages that wait, before they go to the scratch file
//!                 └─ 1/4 of the rest: the rasters' blocks, likewise
//! ```
//!
//! # Precision
//!
//! What a step takes is reckoned on the safe side. With no rest at all, maps of 8192×4096 and 16384×8192
//! pixels took from 0.35 of it (64 threads on few pages) to 1.0 (16 threads): heights of both widths and
//! colors, with holes and without, on their own grid, another, and split.

use areoid_formats::archive::Description;
use areoid_formats::page::Kind;
use rayon::ThreadPool;

use super::plan::Part;
use super::request::Request;
use crate::build::is_of_whole_heights;
use crate::lowpass;
use crate::origin::Origin;

/// What a build may use.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Memory {
    /// The least that will do, in bytes.
    pub(super) least_bytes: u64,
    /// Beside that, in bytes.
    pub(super) spare_bytes: u64,
    /// Pages that are looked at together.
    pub(super) pages_together: usize,
}

/// The program itself, and its buffers for reading and writing.
const EVERYTHING_ELSE: u64 = 16 << 20;

/// What a thread works with, beside pages.
const PER_THREAD: u64 = 7 << 20;

/// Pages together that keep a thread busy.
const PAGES_PER_THREAD: u64 = 4;

/// Fewer together are none the smaller, for what they look at.
const FEWEST_TOGETHER: u64 = 8;

impl Memory {
    /// Shares the memory of a request out for the build of a part: threads look at fewer pages together
    /// where they have less.
    pub(super) fn share(request: &Request, threads: &ThreadPool, part: &Part) -> Self {
        let step = Step::of(&part.description, &*part.origin);
        let bytes = request.memory_bytes;
        let threads = threads.current_num_threads() as u64;
        let fixed = EVERYTHING_ELSE + PER_THREAD * threads;
        let mut together = (PAGES_PER_THREAD * threads).max(FEWEST_TOGETHER);
        while together > FEWEST_TOGETHER && fixed + step.bytes(together) > bytes {
            together = (together / 2).max(FEWEST_TOGETHER);
        }
        Self {
            least_bytes: fixed + step.bytes(FEWEST_TOGETHER),
            spare_bytes: bytes.saturating_sub(fixed + step.bytes(together)),
            pages_together: usize::try_from(together).expect("few"),
        }
    }
}

/// What a step of the build holds at once.
struct Step {
    /// Leaves of a unit.
    unit_bytes: u64,
    /// That of pages looked at together, with all that these look at, in eighths of a unit for each
    /// page, and the units that it does not pass however many they are.
    eighths_per_page: u64,
    most_units: u64,
    /// Beside them, units of pages around, which parents may look at.
    around: u64,
}

impl Step {
    fn of(description: &Description, origin: &dyn Origin) -> Self {
        let side = u64::from(description.grid.pyramid().page_side());
        let texel = match description.kind {
            Kind::Height if is_of_whole_heights(description, origin) => 2,
            Kind::Height => 4,
            Kind::Color | Kind::Normal => 3,
        };
        // With holes pages have coverage, and their finest texels.
        let (eighths_per_page, most_units) = if origin.may_have_holes() { (4, 10) } else { (2, 5) };
        let unit_bytes = u64::from(description.unit_pages).pow(2) * side * side * texel;
        let around = u64::from(lowpass::reach(description.mip) > 0);
        Self { unit_bytes, eighths_per_page, most_units, around }
    }

    /// With the leaves of the next unit.
    fn bytes(&self, together: u64) -> u64 {
        let of_pages = (self.unit_bytes * self.eighths_per_page * together / 8)
            .min(self.unit_bytes * self.most_units);
        self.unit_bytes + of_pages + self.around * self.unit_bytes
    }
}
