//! Room on disk for what a build has no memory for.
//!
//! ```text
//!   file   | slot      | free | slot | slot         | free …
//!            whole 4 KiB blocks, written and read by position
//! ```
//!
//! A slot that a checkpoint names stays as it is until the next checkpoint, whoever frees it: a
//! build that is killed finds there what its last checkpoint saw.
//!
//! Any thread may call anything; writing and reading different slots do not wait for one another.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fs::File;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use areoid_formats::storage::{ByteSource as _, FileSource};
use serde::{Deserialize, Serialize};
use xxhash_rust::xxh3::{Xxh3, xxh3_64};

use crate::once::{Spill, Ticket};

/// Slots start and end at multiples of this many bytes.
const BLOCK: u64 = 4096;

/// A place in the scratch file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Slot {
    /// In bytes from the start of the file.
    pub offset: u64,
    /// Bytes stored there.
    pub length: u64,
    /// XXH3 of them.
    pub checksum: u64,
}

impl Slot {
    fn end(self) -> u64 {
        self.offset + self.length.next_multiple_of(BLOCK).max(BLOCK)
    }
}

/// A file that only this build writes and reads.
#[derive(Debug)]
pub struct Scratch {
    file: File,
    source: FileSource,
    room: Mutex<Room>,
}

/// Which parts of the file are free.
#[derive(Debug, Default)]
struct Room {
    /// Start and end of each free part, none beside another.
    free: BTreeMap<u64, u64>,
    /// Freed, but named by the last checkpoint.
    held: Vec<Slot>,
    end: u64,
    /// Offsets of the slots that the last checkpoint names.
    named: BTreeSet<u64>,
}

impl Scratch {
    /// Uses `file`, of which a checkpoint names the slots `named` and everything else is free.
    ///
    /// # Errors
    ///
    /// If the file cannot be opened a second time, for reading.
    pub fn new(file: File, named: &[Slot]) -> io::Result<Self> {
        let mut room = Room::default();
        let mut slots = named.to_vec();
        slots.sort_unstable_by_key(|slot| slot.offset);
        let stored = file.metadata()?.len();
        for slot in slots {
            // What no file has room for is refused when it is asked for.
            if slot.offset.checked_add(slot.length).is_none_or(|end| end > stored) {
                continue;
            }
            if slot.offset > room.end {
                room.free.insert(room.end, slot.offset);
            }
            room.end = room.end.max(slot.end());
            room.named.insert(slot.offset);
        }
        let source = FileSource::new(file.try_clone()?)?;
        Ok(Self { file, source, room: Mutex::new(room) })
    }

    fn room(&self) -> MutexGuard<'_, Room> {
        self.room.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Stores bytes.
    ///
    /// # Errors
    ///
    /// Those of the file system, a full disk above all.
    pub fn put(&self, parts: &[&[u8]]) -> io::Result<Slot> {
        let length = parts.iter().map(|part| part.len() as u64).sum();
        let mut hash = Xxh3::new();
        parts.iter().for_each(|part| hash.update(part));
        let offset = self.room().take(length);
        let slot = Slot { offset, length, checksum: hash.digest() };
        let mut at = slot.offset;
        for part in parts {
            if let Err(error) = write_at(&self.file, part, at) {
                self.room().give(slot);
                return Err(error);
            }
            at += part.len() as u64;
        }
        Ok(slot)
    }

    /// Reads back what [`Self::put`] stored.
    ///
    /// # Errors
    ///
    /// Those of the file system; [`io::ErrorKind::InvalidData`] if the bytes are others.
    pub fn get(&self, slot: Slot) -> io::Result<Vec<u8>> {
        let end = slot.offset.checked_add(slot.length);
        if end.is_none_or(|end| end > self.room().end) {
            return Err(io::Error::new(
                io::ErrorKind::InvalidData,
                "a slot past the scratch file's end",
            ));
        }
        let length = usize::try_from(slot.length)
            .map_err(|_| io::Error::other("a slot larger than the address space"))?;
        let mut bytes = vec![0; length];
        self.get_into(slot, &mut bytes)?;
        Ok(bytes)
    }

    /// [`Self::get`] into a buffer of the length stored.
    ///
    /// # Errors
    ///
    /// As [`Self::get`].
    pub fn get_into(&self, slot: Slot, bytes: &mut [u8]) -> io::Result<()> {
        if slot.length != bytes.len() as u64 {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, "a buffer of another length"));
        }
        self.source.read_exact_at(bytes, slot.offset)?;
        if xxh3_64(bytes) != slot.checksum {
            return Err(io::Error::new(io::ErrorKind::InvalidData, "the scratch file is damaged"));
        }
        Ok(())
    }

    /// Gives a slot up.
    pub fn free(&self, slot: Slot) {
        let mut room = self.room();
        if room.named.contains(&slot.offset) { room.held.push(slot) } else { room.give(slot) }
    }

    /// Notes that a checkpoint now names `slots` and no others: what the one before named, and
    /// nobody has any more, becomes free.
    pub fn name(&self, slots: &[Slot]) {
        let mut room = self.room();
        room.named = slots.iter().map(|slot| slot.offset).collect();
        for slot in std::mem::take(&mut room.held) {
            if room.named.contains(&slot.offset) { room.held.push(slot) } else { room.give(slot) }
        }
    }

    /// Gives everything up, of whomever: the checkpoint found in the file is of no use, and nothing
    /// that was stored since is asked for again.
    pub fn clear(&self) {
        *self.room() = Room::default();
    }

    /// Waits until everything stored is on the medium.
    ///
    /// # Errors
    ///
    /// Those of the file system.
    pub fn sync(&self) -> io::Result<()> {
        self.file.sync_data()
    }
}

/// Blocks of rasters set aside in a [`Scratch`].
#[derive(Debug)]
pub struct Aside {
    scratch: Arc<Scratch>,
    /// By their offset, which is their ticket.
    slots: Mutex<HashMap<u64, Slot>>,
}

impl Aside {
    /// Sets aside in `scratch`.
    #[must_use]
    pub fn new(scratch: Arc<Scratch>) -> Self {
        Self { scratch, slots: Mutex::default() }
    }

    fn slots(&self) -> MutexGuard<'_, HashMap<u64, Slot>> {
        self.slots.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Spill for Aside {
    fn store(&self, bytes: &[u8]) -> io::Result<Ticket> {
        let slot = self.scratch.put(&[bytes])?;
        self.slots().insert(slot.offset, slot);
        Ok(Ticket(slot.offset))
    }

    fn load(&self, ticket: Ticket, bytes: &mut [u8]) -> io::Result<()> {
        let slot = self.slots().get(&ticket.0).copied();
        self.scratch.get_into(slot.ok_or(io::ErrorKind::NotFound)?, bytes)
    }

    fn free(&self, ticket: Ticket) {
        let slot = self.slots().remove(&ticket.0);
        slot.into_iter().for_each(|slot| self.scratch.free(slot));
    }
}

impl Room {
    /// The first free part that is large enough, or new room at the end.
    fn take(&mut self, length: u64) -> u64 {
        let wanted = length.next_multiple_of(BLOCK).max(BLOCK);
        let fitting = self.free.iter().find(|(start, end)| *end - *start >= wanted);
        match fitting.map(|(&start, &end)| (start, end)) {
            Some((start, end)) => {
                self.free.remove(&start);
                if start + wanted < end {
                    self.free.insert(start + wanted, end);
                }
                start
            }
            None => {
                self.end += wanted;
                self.end - wanted
            }
        }
    }

    fn give(&mut self, slot: Slot) {
        let (mut start, mut end) = (slot.offset, slot.end());
        if let Some((&before, &its_end)) = self.free.range(..start).next_back()
            && its_end == start
        {
            self.free.remove(&before);
            start = before;
        }
        if let Some(its_end) = self.free.remove(&end) {
            end = its_end;
        }
        self.free.insert(start, end);
    }
}

#[cfg(unix)]
fn write_at(file: &File, bytes: &[u8], offset: u64) -> io::Result<()> {
    std::os::unix::fs::FileExt::write_all_at(file, bytes, offset)
}

#[cfg(windows)]
fn write_at(file: &File, mut bytes: &[u8], mut offset: u64) -> io::Result<()> {
    while !bytes.is_empty() {
        match std::os::windows::fs::FileExt::seek_write(file, bytes, offset)? {
            0 => return Err(io::ErrorKind::WriteZero.into()),
            written => {
                bytes = &bytes[written..];
                offset += written as u64;
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::once::test_support::keeps_the_contract;
    use proptest::prelude::*;

    fn scratch() -> Scratch {
        Scratch::new(tempfile::tempfile().unwrap(), &[]).unwrap()
    }

    proptest! {
        /// Slots of any sizes, stored and freed in any order, with checkpoints between.
        #[test]
        fn what_is_stored_comes_back(
            steps in prop::collection::vec((0..4_u8, 0..3 * 4096_usize, any::<u8>()), 1..60)
        ) {
            let scratch = scratch();
            type Stored = Vec<(Slot, Vec<u8>)>;
            let (mut live, mut named): (Stored, Stored) =
                (Vec::new(), Vec::new());
            for (what, size, byte) in steps {
                match what {
                    0 | 1 => {
                        let bytes = vec![byte; size];
                        let (front, back) = bytes.split_at(size / 3);
                        live.push((scratch.put(&[front, back]).unwrap(), bytes));
                    }
                    2 if !live.is_empty() => scratch.free(live.swap_remove(size % live.len()).0),
                    _ => {
                        named = live.clone();
                        let slots: Vec<Slot> = named.iter().map(|(slot, _)| *slot).collect();
                        scratch.name(&slots);
                    }
                }
                for (slot, bytes) in live.iter().chain(&named) {
                    prop_assert_eq!(&scratch.get(*slot).unwrap(), bytes);
                }
            }
            // Who finds the last checkpoint stores around what it names.
            let slots: Vec<Slot> = named.iter().map(|(slot, _)| *slot).collect();
            let again = Scratch::new(scratch.file.try_clone().unwrap(), &slots).unwrap();
            for _ in 0..20 {
                again.put(&[&[0xa5; 5000]]).unwrap();
            }
            for (slot, bytes) in &named {
                prop_assert_eq!(&again.get(*slot).unwrap(), bytes);
            }
        }
    }

    #[test]
    fn blocks_set_aside_keep_the_contract() {
        keeps_the_contract(&Aside::new(Arc::new(scratch())));
    }

    #[test]
    fn room_of_a_checkpoint_of_no_use_is_used_again() {
        let scratch = scratch();
        let slots: Vec<Slot> = (0..8).map(|_| scratch.put(&[&[1; 9000]]).unwrap()).collect();
        let again = Scratch::new(scratch.file.try_clone().unwrap(), &slots).unwrap();
        again.clear();
        assert_eq!(again.put(&[&[2; 70_000]]).unwrap().offset, 0);
        assert!(again.get(slots[7]).is_err());
    }

    #[test]
    fn freed_room_is_used_again() {
        let scratch = scratch();
        let slots: Vec<Slot> = (0..8).map(|_| scratch.put(&[&[1; 9000]]).unwrap()).collect();
        let end = scratch.room().end;
        slots.into_iter().for_each(|slot| scratch.free(slot));
        scratch.put(&[&[2; 70_000]]).unwrap();
        let room = scratch.room();
        assert_eq!((room.end, room.free.len()), (end, 1));
    }
}
