//! Each block is decoded once, whoever wants it and wherever it waits.

use super::super::{Outline, RasterInfo, SampleType, Samples};
use super::*;
use crate::once::test_support::MemorySpill;
use std::sync::atomic::{AtomicU32, Ordering};

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
        let values = (0..width * height).map(|pixel| block_row * 50 + block_col * 9 + pixel);
        let samples = Samples::U8(values.map(|value| u8::try_from(value).unwrap()).collect());
        Ok(Block { col, row, width, height, samples })
    }

    fn check_unchanged(&self) -> Result<(), RasterError> {
        Ok(())
    }
}

fn spilling(mut cache: BlockCache, overflow: Arc<Overflow>) -> BlockCache {
    cache.spill(overflow);
    cache
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

/// What a thread does that visits every block `rounds` times.
fn visit(cache: &BlockCache, raster: &Counting, thread: u32, rounds: u32) {
    for step in 0..15 * rounds {
        let index = (step * 4 + thread * 2) % 15;
        let (col, row) = (index % 5, index / 5);
        let block = cache.get(col, row).unwrap();
        let [first_col, first_row, width, height] = raster.info.block_window(col, row).unwrap();
        let values =
            (0..width * height).map(|pixel| u8::try_from(row * 50 + col * 9 + pixel).unwrap());
        let samples = Samples::U8(values.collect());
        let expected = Block { col: first_col, row: first_row, width, height, samples };
        assert_eq!(*block, expected);
        drop(block);
        cache.release(col, row);
    }
}

#[test]
fn without_room_blocks_come_back_and_are_still_decoded_once() {
    const THREADS: u32 = 6;
    const ROUNDS: u32 = 40;
    for budget_bytes in [0, 1, 9, 30] {
        let raster = Counting::new(0);
        let spill = Arc::new(MemorySpill::default());
        let overflow = Arc::new(Overflow::new(Arc::clone(&spill) as _, budget_bytes));
        let cache = spilling(
            BlockCache::new(Arc::clone(&raster) as _, |_, _| THREADS * ROUNDS),
            Arc::clone(&overflow),
        );
        std::thread::scope(|scope| {
            for thread in 0..THREADS {
                let (cache, raster) = (&cache, &raster);
                scope.spawn(move || visit(cache, raster, thread, ROUNDS));
            }
        });
        assert_eq!(cache.decoded(), 15);
        assert!(raster.decoded.iter().all(|count| count.load(Ordering::Relaxed) == 1));
        assert_eq!((cache.resident_bytes(), overflow.resident_bytes()), (0, 0));
        // A block is written once however often it goes.
        assert!((1..=15).contains(&spill.given()), "{} were set aside", spill.given());
        assert_eq!(spill.tickets(), 0);
    }
}

#[test]
fn the_block_longest_unseen_goes_first_and_those_in_use_stay() {
    let spill = Arc::new(MemorySpill::default());
    let overflow = Arc::new(Overflow::new(Arc::clone(&spill) as _, 8));
    let cache = spilling(BlockCache::new(Counting::new(0) as _, |_, _| 9), Arc::clone(&overflow));
    let held = cache.get(0, 0).unwrap();
    drop(cache.get(1, 0).unwrap());
    assert_eq!((cache.resident_bytes(), spill.given()), (8, 0));
    drop(cache.get(2, 0).unwrap());
    // Block 0 is held, so block 1 went.
    assert_eq!((cache.resident_bytes(), spill.given()), (8, 1));
    drop(cache.get(0, 0).unwrap());
    drop(held);
    drop(cache.get(1, 0).unwrap());
    // Block 2 has now been unseen the longest.
    drop(cache.get(0, 0).unwrap());
    assert_eq!((cache.decoded(), spill.given(), spill.tickets()), (3, 2, 2));
    drop(cache);
    assert_eq!((spill.tickets(), overflow.resident_bytes()), (0, 0));
}

#[test]
fn caches_share_a_budget() {
    let spill = Arc::new(MemorySpill::default());
    let overflow = Arc::new(Overflow::new(Arc::clone(&spill) as _, 8));
    let caches = [0, 1]
        .map(|_| spilling(BlockCache::new(Counting::new(0) as _, |_, _| 1), Arc::clone(&overflow)));
    for col in 0..3 {
        for cache in &caches {
            drop(cache.get(col, 0).unwrap());
            assert!(overflow.resident_bytes() <= 8 + 4);
        }
    }
}

#[test]
fn a_block_that_cannot_be_set_aside_is_an_error_and_stays() {
    let mut spill = MemorySpill::default();
    spill.fails_after = Some(0);
    let overflow = Arc::new(Overflow::new(Arc::new(spill), 4));
    let cache = spilling(BlockCache::new(Counting::new(0) as _, |_, _| 2), overflow);
    drop(cache.get(0, 0).unwrap());
    let error = cache.get(1, 0).unwrap_err().to_string();
    assert_eq!(error, "cannot set aside a block of counting.tif");
    assert_eq!((cache.decoded(), cache.resident_bytes()), (2, 8));
    assert!(cache.get(0, 0).is_ok() && cache.get(1, 0).is_ok());
    assert_eq!(cache.decoded(), 2);
}
