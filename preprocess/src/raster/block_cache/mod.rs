//! Blocks that are decoded once, and kept until their last use.
//!
//! ```text
//!   announced: uses of each block ──▶ get: decodes, or waits for who does ──▶ release, once a use
//!                                      ▲  │                                    └▶ last: dropped
//!                           read back  │  ▼  over budget: those not in use, longest unseen first
//!                                      Spill
//! ```
//!
//! Strips span a raster's width, and leaves are visited in squares: without a [`Spill`], most of the
//! strips of a wide raster wait in memory for the squares farther east.

mod spill;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};

#[cfg(test)]
pub(crate) use self::spill::test_support;
pub use self::spill::{Overflow, Spill, Ticket};
use super::error::RasterError;
use super::{Block, Raster, Samples};

/// The blocks of a raster, each decoded once for all who want it.
///
/// Any thread may call anything. Threads that want a block while another decodes it, reads it back
/// or sets it aside wait for that one; others do not wait. Memory is bounded by the blocks between
/// their first `get` and their last `release`, which is the order of the caller's visits, or by an
/// [`Overflow`]'s budget and the blocks in use; and by 64 bytes a block.
#[derive(Debug)]
pub struct BlockCache {
    raster: Arc<dyn Raster>,
    across: u32,
    slots: Vec<Mutex<Slot>>,
    decoded: AtomicU64,
    resident_bytes: AtomicU64,
    overflow: Option<Arc<Overflow>>,
    /// The blocks in memory, those seen last at the end. Locked with a slot or without, and no slot
    /// is ever waited for while it is locked, nor while another slot is.
    seen: Mutex<Seen>,
}

#[derive(Debug)]
struct Slot {
    uses_left: u32,
    kept: Kept,
    /// Where it is among those [`Seen`].
    stamp: Option<u64>,
}

/// What is kept of a block.
#[derive(Debug)]
enum Kept {
    Nothing,
    /// The block, and its ticket if it has been set aside before.
    Here(Arc<Block>, Option<Ticket>),
    /// A block without its samples.
    Aside(Block, usize, Ticket),
}

/// Indices of slots, by when they were seen. It may hold stamps that their slots no longer have.
#[derive(Debug, Default)]
struct Seen {
    order: BTreeMap<u64, usize>,
    next: u64,
}

impl BlockCache {
    /// A cache for `raster`, of which the block at `(block_col, block_row)` will be released
    /// `uses(block_col, block_row)` times.
    #[must_use]
    pub fn new(raster: Arc<dyn Raster>, uses: impl Fn(u32, u32) -> u32) -> Self {
        let (across, down) = raster.info().blocks();
        let places = (0..down).flat_map(|row| (0..across).map(move |col| (col, row)));
        let slots = places
            .map(|(col, row)| {
                Mutex::new(Slot { uses_left: uses(col, row), kept: Kept::Nothing, stamp: None })
            })
            .collect();
        let (decoded, resident_bytes) = (AtomicU64::new(0), AtomicU64::new(0));
        let (overflow, seen) = (None, Mutex::default());
        Self { raster, across, slots, decoded, resident_bytes, overflow, seen }
    }

    /// Gives the cache a budget: what is beyond it is set aside.
    ///
    /// # Panics
    ///
    /// If a block has been read already.
    pub fn spill(&mut self, overflow: Arc<Overflow>) {
        assert_eq!(self.decoded(), 0, "a budget counts from the first block");
        self.overflow = Some(overflow);
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
        let index = self.index(block_col, block_row);
        // Held while decoding: whoever else wants this block waits here.
        let mut slot = self.slot(index);
        let (block, ticket) = match &slot.kept {
            Kept::Here(block, _) => {
                let block = Arc::clone(block);
                self.saw(&mut slot, index);
                return Ok(block);
            }
            Kept::Aside(block, len, ticket) => {
                (self.read_back(block, *len, *ticket)?, Some(*ticket))
            }
            Kept::Nothing => {
                let block = self.raster.read_block(block_col, block_row)?;
                self.decoded.fetch_add(1, Ordering::Relaxed);
                (block, None)
            }
        };
        let block = Arc::new(block);
        if slot.uses_left > 0 {
            self.add(block.samples.bytes() as u64);
            slot.kept = Kept::Here(Arc::clone(&block), ticket);
            self.saw(&mut slot, index);
            drop(slot);
            self.make_room()?;
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
        let mut slot = self.slot(self.index(block_col, block_row));
        slot.uses_left = slot.uses_left.saturating_sub(1);
        if slot.uses_left > 0 {
            return;
        }
        if let Some(stamp) = slot.stamp.take() {
            self.seen().order.remove(&stamp);
        }
        self.free(std::mem::replace(&mut slot.kept, Kept::Nothing));
    }

    /// How often a block was decoded: at most once each, if all uses were announced.
    #[must_use]
    pub fn decoded(&self) -> u64 {
        self.decoded.load(Ordering::Relaxed)
    }

    /// Bytes of the samples kept in memory now.
    #[must_use]
    pub fn resident_bytes(&self) -> u64 {
        self.resident_bytes.load(Ordering::Relaxed)
    }

    fn read_back(&self, block: &Block, len: usize, ticket: Ticket) -> Result<Block, RasterError> {
        let overflow = self.overflow.as_ref().expect("what is aside was set aside by it");
        let sample = block.samples.sample_type();
        let mut block = Block { samples: Samples::filled(sample, len, 0.0), ..*block };
        let loaded = overflow.spill.load(ticket, block.samples.as_bytes_mut());
        loaded.map_err(RasterError::io("read back a block of", &self.raster.info().path))?;
        Ok(block)
    }

    /// Sets blocks aside until memory is within the budget or all that are left are in use.
    ///
    /// No slot may be locked by this thread.
    fn make_room(&self) -> Result<(), RasterError> {
        let Some(overflow) = &self.overflow else { return Ok(()) };
        let mut in_use = Vec::new();
        let mut result = Ok(());
        while overflow.is_over() && result.is_ok() {
            let Some((stamp, index)) = self.seen().order.pop_first() else { break };
            match self.set_aside(overflow, index, stamp) {
                Ok(true) => {}
                Ok(false) => in_use.push((stamp, index)),
                Err(error) => {
                    in_use.push((stamp, index));
                    result = Err(error);
                }
            }
        }
        // Those that have been seen or dropped meanwhile leave a stamp behind that means nothing.
        self.seen().order.extend(in_use);
        result
    }

    /// Sets a block aside that was last seen at `stamp`; false if it is in use.
    fn set_aside(
        &self,
        overflow: &Overflow,
        index: usize,
        stamp: u64,
    ) -> Result<bool, RasterError> {
        let mut slot = match self.slots[index].try_lock() {
            Ok(slot) => slot,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => return Ok(false),
        };
        if slot.stamp != Some(stamp) {
            return Ok(true);
        }
        let Kept::Here(block, ticket) = &slot.kept else { return Ok(true) };
        // Others get theirs from the slot, which is locked.
        if Arc::strong_count(block) > 1 {
            return Ok(false);
        }
        let samples = &block.samples;
        let ticket = match *ticket {
            Some(ticket) => ticket,
            None => overflow
                .spill
                .store(samples.as_bytes())
                .map_err(RasterError::io("set aside a block of", &self.raster.info().path))?,
        };
        let (bytes, len) = (samples.bytes() as u64, samples.len());
        let empty = Samples::filled(samples.sample_type(), 0, 0.0);
        slot.kept = Kept::Aside(Block { samples: empty, ..**block }, len, ticket);
        slot.stamp = None;
        self.subtract(bytes);
        Ok(true)
    }

    /// Notes that a block in memory has been asked for.
    fn saw(&self, slot: &mut Slot, index: usize) {
        if self.overflow.is_none() {
            return;
        }
        let mut seen = self.seen();
        if let Some(stamp) = slot.stamp {
            seen.order.remove(&stamp);
        }
        let stamp = seen.next;
        seen.next += 1;
        seen.order.insert(stamp, index);
        slot.stamp = Some(stamp);
    }

    fn free(&self, kept: Kept) {
        let ticket = match kept {
            Kept::Nothing => None,
            Kept::Here(block, ticket) => {
                self.subtract(block.samples.bytes() as u64);
                ticket
            }
            Kept::Aside(_, _, ticket) => Some(ticket),
        };
        if let (Some(overflow), Some(ticket)) = (&self.overflow, ticket) {
            overflow.spill.free(ticket);
        }
    }

    fn add(&self, bytes: u64) {
        self.resident_bytes.fetch_add(bytes, Ordering::Relaxed);
        self.overflow.iter().for_each(|overflow| overflow.add(bytes));
    }

    fn subtract(&self, bytes: u64) {
        self.resident_bytes.fetch_sub(bytes, Ordering::Relaxed);
        self.overflow.iter().for_each(|overflow| overflow.subtract(bytes));
    }

    fn index(&self, block_col: u32, block_row: u32) -> usize {
        assert!(block_col < self.across, "the raster has {} columns of blocks", self.across);
        block_row as usize * self.across as usize + block_col as usize
    }

    fn slot(&self, index: usize) -> MutexGuard<'_, Slot> {
        // A reader that panicked left the slot as it was: empty.
        self.slots[index].lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn seen(&self) -> MutexGuard<'_, Seen> {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for BlockCache {
    fn drop(&mut self) {
        for index in 0..self.slots.len() {
            let kept = std::mem::replace(&mut self.slot(index).kept, Kept::Nothing);
            self.free(kept);
        }
    }
}

#[cfg(test)]
mod tests;
