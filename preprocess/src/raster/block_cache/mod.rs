//! Blocks that are decoded once, and kept until their last use.

use std::io;
use std::sync::Arc;

use super::error::RasterError;
use super::{Block, Raster, Samples};
use crate::once::{OnceCache, OnceError, Overflow, Parcel};

/// The blocks of a raster, each decoded once for all who want it: an [`OnceCache`], with its rules
/// for threads and memory.
#[derive(Debug)]
pub struct BlockCache {
    raster: Arc<dyn Raster>,
    blocks: OnceCache<Block>,
}

impl BlockCache {
    /// A cache for `raster`, of which the block at `(block_col, block_row)` will be released
    /// `uses(block_col, block_row)` times.
    #[must_use]
    pub fn new(raster: Arc<dyn Raster>, uses: impl Fn(u32, u32) -> u32) -> Self {
        let blocks = OnceCache::new(raster.info().blocks(), uses);
        Self { raster, blocks }
    }

    /// Gives the cache a budget: what is beyond it is set aside.
    ///
    /// # Panics
    ///
    /// If a block has been read already.
    pub fn spill(&mut self, overflow: Arc<Overflow>) {
        self.blocks.spill(overflow);
    }

    /// The raster whose blocks these are.
    #[must_use]
    pub fn raster(&self) -> &Arc<dyn Raster> {
        &self.raster
    }

    /// A block, decoded now if it was not yet.
    ///
    /// A block that has no announced use left is decoded for this call alone and not kept.
    ///
    /// # Errors
    ///
    /// [`RasterError`] if the block cannot be decoded or read back, or another not be set aside;
    /// the next call tries again.
    ///
    /// # Panics
    ///
    /// If the raster has no such block.
    pub fn get(&self, block_col: u32, block_row: u32) -> Result<Arc<Block>, RasterError> {
        let read = || self.raster.read_block(block_col, block_row);
        let failed = |action, source| RasterError::io(action, &self.raster.info().path)(source);
        self.blocks.get(block_col, block_row, read).map_err(|error| match error {
            OnceError::Make(error) => error,
            OnceError::SetAside(source) => failed("set aside a block of", source),
            OnceError::ReadBack(source) => failed("read back a block of", source),
        })
    }

    /// Ends one announced use; the last one drops the block.
    ///
    /// A use may end without the block having been asked for. Ends beyond those announced do
    /// nothing.
    ///
    /// # Panics
    ///
    /// If the raster has no such block.
    pub fn release(&self, block_col: u32, block_row: u32) {
        self.blocks.release(block_col, block_row);
    }

    /// How often a block was decoded: at most once each, if all uses were announced.
    #[must_use]
    pub fn decoded(&self) -> u64 {
        self.blocks.made()
    }

    /// Bytes of the samples kept in memory now.
    #[must_use]
    pub fn resident_bytes(&self) -> u64 {
        self.blocks.resident_bytes()
    }
}

impl Parcel for Block {
    fn bytes(&self) -> &[u8] {
        self.samples.as_bytes()
    }

    fn hollow(&self) -> Self {
        let samples = Samples::filled(self.samples.sample_type(), 0, 0.0);
        Self { samples, ..*self }
    }

    fn refilled(
        &self,
        len: usize,
        load: impl FnOnce(&mut [u8]) -> io::Result<()>,
    ) -> io::Result<Self> {
        let sample = self.samples.sample_type();
        let mut samples = Samples::filled(sample, len / sample.bytes(), 0.0);
        load(samples.as_bytes_mut())?;
        Ok(Self { samples, ..*self })
    }
}

#[cfg(test)]
mod tests;
