//! Parcels that are made once, and kept until their last use.
//!
//! ```text
//!   announced: uses of each parcel ──▶ get: makes, or waits for who does ──▶ release, once a use
//!                                       ▲  │                                  └▶ last: dropped
//!                            read back  │  ▼  over budget: those not in use, longest unseen first
//!                                       Spill
//! ```
//!
//! Leaves are visited in squares, and what they are made of has other shapes: without a [`Spill`],
//! most of the strips of a wide raster wait in memory for the squares farther east.

mod spill;

use std::collections::BTreeMap;
use std::fmt::Debug;
use std::io;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};

#[cfg(test)]
pub(crate) use self::spill::test_support;
pub use self::spill::{Overflow, Spill, Ticket};

/// What is made once.
///
/// # Contract
///
/// [`Self::bytes`] are all of it that takes memory, and [`Self::refilled`] of what is
/// [`Self::hollow`], with the same bytes loaded, is the parcel again.
pub trait Parcel: Send + Sync + Debug + Sized {
    /// What is set aside.
    fn bytes(&self) -> &[u8];

    /// The same without the bytes.
    fn hollow(&self) -> Self;

    /// A hollow parcel with `len` bytes, which `load` writes.
    ///
    /// # Errors
    ///
    /// That of `load`.
    fn refilled(
        &self,
        len: usize,
        load: impl FnOnce(&mut [u8]) -> io::Result<()>,
    ) -> io::Result<Self>;
}

/// Why there is no parcel.
#[derive(Debug)]
pub enum OnceError<E> {
    /// It cannot be made.
    Make(E),
    /// Another, or this one, cannot be set aside.
    SetAside(io::Error),
    /// It cannot be read back.
    ReadBack(io::Error),
}

/// Parcels in rows and columns, each made once for all who want it.
///
/// Any thread may call anything. Threads that want a parcel while another makes it, reads it back
/// or sets it aside wait for that one; others do not wait. Memory is bounded by the parcels between
/// their first `get` and their last `release`, which is the order of the caller's visits, or by an
/// [`Overflow`]'s budget and the parcels in use; and by 64 bytes a parcel.
#[derive(Debug)]
pub struct OnceCache<T: Parcel> {
    across: u32,
    slots: Vec<Mutex<Slot<T>>>,
    made: AtomicU64,
    resident_bytes: AtomicU64,
    overflow: Option<Arc<Overflow>>,
    /// The parcels in memory, those seen last at the end. Locked with a slot or without, and no
    /// slot is ever waited for while it is locked, nor while another slot is.
    seen: Mutex<Seen>,
}

#[derive(Debug)]
struct Slot<T> {
    uses_left: u32,
    kept: Kept<T>,
    /// Where it is among those [`Seen`].
    stamp: Option<u64>,
}

/// What is kept of a parcel.
#[derive(Debug)]
enum Kept<T> {
    Nothing,
    /// The parcel, and its ticket if it has been set aside before.
    Here(Arc<T>, Option<Ticket>),
    /// A hollow parcel and how many bytes it is without.
    Aside(T, usize, Ticket),
}

/// Indices of slots, by when they were seen. It may hold stamps that their slots no longer have.
#[derive(Debug, Default)]
struct Seen {
    order: BTreeMap<u64, usize>,
    next: u64,
}

impl<T: Parcel> OnceCache<T> {
    /// A cache of `across` by `down` parcels, of which the one at `(col, row)` will be released
    /// `uses(col, row)` times.
    #[must_use]
    pub fn new((across, down): (u32, u32), uses: impl Fn(u32, u32) -> u32) -> Self {
        let places = (0..down).flat_map(|row| (0..across).map(move |col| (col, row)));
        let slots = places
            .map(|(col, row)| {
                Mutex::new(Slot { uses_left: uses(col, row), kept: Kept::Nothing, stamp: None })
            })
            .collect();
        let (made, resident_bytes) = (AtomicU64::new(0), AtomicU64::new(0));
        let (overflow, seen) = (None, Mutex::default());
        Self { across, slots, made, resident_bytes, overflow, seen }
    }

    /// Gives the cache a budget: what is beyond it is set aside.
    ///
    /// # Panics
    ///
    /// If a parcel has been made already.
    pub fn spill(&mut self, overflow: Arc<Overflow>) {
        assert_eq!(self.made(), 0, "a budget counts from the first parcel");
        self.overflow = Some(overflow);
    }

    /// A parcel, made now if it was not yet.
    ///
    /// A parcel that has no announced use left is made for this call alone and not kept.
    ///
    /// # Errors
    ///
    /// [`OnceError`] if the parcel cannot be made or read back, or another not be set aside; the
    /// next call tries again.
    ///
    /// # Panics
    ///
    /// If there is no such parcel.
    pub fn get<E>(
        &self,
        col: u32,
        row: u32,
        make: impl FnOnce() -> Result<T, E>,
    ) -> Result<Arc<T>, OnceError<E>> {
        let index = self.index(col, row);
        // Held while it is made: whoever else wants this parcel waits here.
        let mut slot = self.slot(index);
        let (parcel, ticket) = match &slot.kept {
            Kept::Here(parcel, _) => {
                let parcel = Arc::clone(parcel);
                self.saw(&mut slot, index);
                return Ok(parcel);
            }
            Kept::Aside(hollow, len, ticket) => {
                (self.read_back(hollow, *len, *ticket).map_err(OnceError::ReadBack)?, Some(*ticket))
            }
            Kept::Nothing => {
                let parcel = make().map_err(OnceError::Make)?;
                self.made.fetch_add(1, Ordering::Relaxed);
                (parcel, None)
            }
        };
        let parcel = Arc::new(parcel);
        if slot.uses_left > 0 {
            self.add(parcel.bytes().len() as u64);
            slot.kept = Kept::Here(Arc::clone(&parcel), ticket);
            self.saw(&mut slot, index);
            drop(slot);
            self.make_room().map_err(OnceError::SetAside)?;
        }
        Ok(parcel)
    }

    /// Ends one announced use; the last one drops the parcel. True if that was the last, and the
    /// parcel never was.
    ///
    /// A use may end without the parcel having been asked for. Ends beyond those announced do
    /// nothing.
    ///
    /// # Panics
    ///
    /// If there is no such parcel.
    pub fn release(&self, col: u32, row: u32) -> bool {
        let mut slot = self.slot(self.index(col, row));
        if slot.uses_left != 1 {
            slot.uses_left = slot.uses_left.saturating_sub(1);
            return false;
        }
        slot.uses_left = 0;
        if let Some(stamp) = slot.stamp.take() {
            self.seen().order.remove(&stamp);
        }
        let kept = std::mem::replace(&mut slot.kept, Kept::Nothing);
        let never_was = matches!(kept, Kept::Nothing);
        self.free(kept);
        never_was
    }

    /// How often a parcel was made: at most once each, if all uses were announced.
    #[must_use]
    pub fn made(&self) -> u64 {
        self.made.load(Ordering::Relaxed)
    }

    /// Bytes of the parcels kept in memory now.
    #[must_use]
    pub fn resident_bytes(&self) -> u64 {
        self.resident_bytes.load(Ordering::Relaxed)
    }

    fn read_back(&self, hollow: &T, len: usize, ticket: Ticket) -> io::Result<T> {
        let overflow = self.overflow.as_ref().expect("what is aside was set aside by it");
        hollow.refilled(len, |bytes| overflow.spill.load(ticket, bytes))
    }

    /// Sets parcels aside until memory is within the budget or all that are left are in use.
    ///
    /// No slot may be locked by this thread.
    fn make_room(&self) -> io::Result<()> {
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

    /// Sets a parcel aside that was last seen at `stamp`; false if it is in use.
    fn set_aside(&self, overflow: &Overflow, index: usize, stamp: u64) -> io::Result<bool> {
        let mut slot = match self.slots[index].try_lock() {
            Ok(slot) => slot,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => return Ok(false),
        };
        if slot.stamp != Some(stamp) {
            return Ok(true);
        }
        let Kept::Here(parcel, ticket) = &slot.kept else { return Ok(true) };
        // Others get theirs from the slot, which is locked.
        if Arc::strong_count(parcel) > 1 {
            return Ok(false);
        }
        let ticket = match *ticket {
            Some(ticket) => ticket,
            None => overflow.spill.store(parcel.bytes())?,
        };
        let len = parcel.bytes().len();
        slot.kept = Kept::Aside(parcel.hollow(), len, ticket);
        slot.stamp = None;
        self.subtract(len as u64);
        Ok(true)
    }

    /// Notes that a parcel in memory has been asked for.
    fn saw(&self, slot: &mut Slot<T>, index: usize) {
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

    fn free(&self, kept: Kept<T>) {
        let ticket = match kept {
            Kept::Nothing => None,
            Kept::Here(parcel, ticket) => {
                self.subtract(parcel.bytes().len() as u64);
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

    fn index(&self, col: u32, row: u32) -> usize {
        assert!(col < self.across, "there are {} columns of parcels", self.across);
        row as usize * self.across as usize + col as usize
    }

    fn slot(&self, index: usize) -> MutexGuard<'_, Slot<T>> {
        // Whoever panicked left the slot as it was: empty.
        self.slots[index].lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn seen(&self) -> MutexGuard<'_, Seen> {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<T: Parcel> Drop for OnceCache<T> {
    fn drop(&mut self) {
        for index in 0..self.slots.len() {
            let kept = std::mem::replace(&mut self.slot(index).kept, Kept::Nothing);
            self.free(kept);
        }
    }
}
