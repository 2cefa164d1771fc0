//! Where the leaves of an ingest come from: rasters, as they are or resampled, or what is derived from
//! either.

use std::fmt::Debug;
use std::sync::Arc;

use areoid_formats::address::PageAddress;
use areoid_formats::grid::Grid;

use crate::build::Leaves;
use crate::once::Overflow;

/// Leaves made of rasters, on a grid of their own.
pub trait Origin: Leaves + Send + Debug {
    /// The grid of the leaves.
    fn grid(&self) -> &Grid;

    /// The same leaves once more, with blocks of their own that stay decoded as long as they do.
    fn apart(&self) -> Box<dyn Origin>;

    /// Gives what waits in memory between two leaves a budget: what is beyond it is set aside.
    ///
    /// # Panics
    ///
    /// If a leaf has been read already.
    fn spill(&mut self, overflow: &Arc<Overflow>);

    /// Blocks decoded so far.
    fn decoded_blocks(&self) -> u64;

    /// Blocks of all rasters, those apart that no leaf needs for sure.
    fn blocks(&self) -> u64;

    /// Pixels of the blocks that are decoded for `leaves`.
    fn decoded_for(&self, leaves: &[PageAddress]) -> u64;
}
