//! Blocks that are decoded once, and kept until their last use.
//!
//! ```text
//!   announced: uses of each block ──▶ get: decodes, or waits for who does ──▶ release, once a use
//!                                                                              └▶ last: dropped
//! ```

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::error::RasterError;
use super::{Block, Raster};

/// The blocks of a raster, each decoded once for all who want it.
///
/// Any thread may call anything. Threads that want a block while another decodes it wait for that
/// one; others do not wait. Memory is bounded by the blocks between their first `get` and their
/// last `release`, which is the order of the caller's visits, and 32 bytes a block.
#[derive(Debug)]
pub struct BlockCache {
    raster: Arc<dyn Raster>,
    across: u32,
    slots: Vec<Mutex<Slot>>,
    decoded: AtomicU64,
    resident_bytes: AtomicU64,
}

#[derive(Debug)]
struct Slot {
    uses_left: u32,
    block: Option<Arc<Block>>,
}

impl BlockCache {
    /// A cache for `raster`, of which the block at `(block_col, block_row)` will be released
    /// `uses(block_col, block_row)` times.
    #[must_use]
    pub fn new(raster: Arc<dyn Raster>, uses: impl Fn(u32, u32) -> u32) -> Self {
        let (across, down) = raster.info().blocks();
        let places = (0..down).flat_map(|row| (0..across).map(move |col| (col, row)));
        let slots = places
            .map(|(col, row)| Mutex::new(Slot { uses_left: uses(col, row), block: None }))
            .collect();
        let (decoded, resident_bytes) = (AtomicU64::new(0), AtomicU64::new(0));
        Self { raster, across, slots, decoded, resident_bytes }
    }

    /// The raster whose blocks these are.
    #[must_use]
    pub fn raster(&self) -> &Arc<dyn Raster> {
        &self.raster
    }

    /// A block, decoded now if it is not here yet.
    ///
    /// A block that has no announced use left is decoded for this call alone and not kept.
    ///
    /// # Errors
    ///
    /// [`RasterError`] if the block cannot be decoded; the next call tries again.
    ///
    /// # Panics
    ///
    /// If the raster has no such block.
    pub fn get(&self, block_col: u32, block_row: u32) -> Result<Arc<Block>, RasterError> {
        // Held while decoding: whoever else wants this block waits here.
        let mut slot = self.slot(block_col, block_row);
        if let Some(block) = &slot.block {
            return Ok(Arc::clone(block));
        }
        let block = Arc::new(self.raster.read_block(block_col, block_row)?);
        self.decoded.fetch_add(1, Ordering::Relaxed);
        if slot.uses_left > 0 {
            self.resident_bytes.fetch_add(block.samples.bytes() as u64, Ordering::Relaxed);
            slot.block = Some(Arc::clone(&block));
        }
        Ok(block)
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
        let mut slot = self.slot(block_col, block_row);
        slot.uses_left = slot.uses_left.saturating_sub(1);
        if slot.uses_left == 0
            && let Some(block) = slot.block.take()
        {
            self.resident_bytes.fetch_sub(block.samples.bytes() as u64, Ordering::Relaxed);
        }
    }

    /// How often a block was decoded: at most once each, if all uses were announced.
    #[must_use]
    pub fn decoded(&self) -> u64 {
        self.decoded.load(Ordering::Relaxed)
    }

    /// Bytes of the samples kept now.
    #[must_use]
    pub fn resident_bytes(&self) -> u64 {
        self.resident_bytes.load(Ordering::Relaxed)
    }

    fn slot(&self, block_col: u32, block_row: u32) -> MutexGuard<'_, Slot> {
        assert!(block_col < self.across, "the raster has {} columns of blocks", self.across);
        let index = block_row as usize * self.across as usize + block_col as usize;
        // A reader that panicked left the slot as it was: empty.
        self.slots[index].lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Outline, RasterInfo, SampleType, Samples};
    use super::*;
    use std::sync::atomic::AtomicU32;

    /// A raster of 5 × 3 blocks that counts how often each is decoded.
    #[derive(Debug)]
    struct Counting {
        info: RasterInfo,
        decoded: Vec<AtomicU32>,
        fails: AtomicU32,
    }

    impl Counting {
        fn new(fails: u32) -> Arc<Self> {
            let info = RasterInfo {
                path: "counting.tif".into(),
                width: 9,
                height: 6,
                bands: 1,
                has_alpha: false,
                sample: SampleType::U8,
                crs: None,
                outline: Outline { origin: [0.0, 0.0], pixel_size: [1.0, 1.0] },
                point_registered: false,
                nodata: None,
                scale: 1.0,
                offset: 0.0,
                block_width: 2,
                block_height: 2,
            };
            let decoded = (0..15).map(|_| AtomicU32::new(0)).collect();
            Arc::new(Self { info, decoded, fails: AtomicU32::new(fails) })
        }
    }

    impl Raster for Counting {
        fn info(&self) -> &RasterInfo {
            &self.info
        }

        fn read_block(&self, block_col: u32, block_row: u32) -> Result<Block, RasterError> {
            let failing = self
                .fails
                .fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1));
            if failing.is_ok() {
                return Err(RasterError::not_supported(&self.info.path, "today", "tomorrow"));
            }
            self.decoded[(block_row * 5 + block_col) as usize].fetch_add(1, Ordering::Relaxed);
            let [col, row, width, height] = self.info.block_window(block_col, block_row).unwrap();
            let samples = Samples::filled(SampleType::U8, (width * height) as usize, 1.0);
            Ok(Block { col, row, width, height, samples })
        }
    }

    #[test]
    fn eight_threads_decode_each_block_once() {
        const THREADS: u32 = 8;
        let raster = Counting::new(0);
        let cache = BlockCache::new(Arc::clone(&raster) as _, |_, _| THREADS);
        std::thread::scope(|scope| {
            for thread in 0..THREADS {
                let cache = &cache;
                scope.spawn(move || {
                    for step in 0..15 {
                        // Each thread starts elsewhere, so that blocks meet in every order.
                        let index = (step * 4 + thread * 2) % 15;
                        let block = cache.get(index % 5, index / 5).unwrap();
                        assert_eq!((block.col, block.row), (index % 5 * 2, index / 5 * 2));
                        cache.release(index % 5, index / 5);
                    }
                });
            }
        });
        assert_eq!(cache.decoded(), 15);
        assert!(raster.decoded.iter().all(|count| count.load(Ordering::Relaxed) == 1));
        assert_eq!(cache.resident_bytes(), 0);
    }

    #[test]
    fn a_block_is_kept_until_its_last_use_and_not_longer() {
        let raster = Counting::new(0);
        let cache = BlockCache::new(raster as _, |col, _| u32::from(col == 4) * 2);
        let held = Arc::downgrade(&cache.get(4, 0).unwrap());
        assert_eq!(cache.resident_bytes(), 2);
        cache.release(4, 0);
        assert!(held.upgrade().is_some());
        cache.release(4, 0);
        assert!(held.upgrade().is_none());
        assert_eq!(cache.resident_bytes(), 0);

        // Nothing was announced for this one: it is handed out and forgotten.
        let unannounced = cache.get(0, 0).unwrap();
        cache.release(0, 0);
        assert_eq!((Arc::strong_count(&unannounced), cache.decoded()), (1, 2));
    }

    #[test]
    fn a_block_that_failed_is_tried_again() {
        let cache = BlockCache::new(Counting::new(1) as _, |_, _| 1);
        assert!(cache.get(1, 1).is_err());
        assert_eq!(cache.decoded(), 0);
        assert!(cache.get(1, 1).is_ok());
        assert_eq!(cache.decoded(), 1);
    }
}
