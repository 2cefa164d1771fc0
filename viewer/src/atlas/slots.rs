//! Which page lies in which slot of an atlas: least recently used goes first.

use std::collections::HashMap;

use areoid_formats::address::PageKey;

/// A page of a dataset, and what tells its texels from those of another build.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct PageName {
    pub(crate) dataset: usize,
    pub(crate) page: PageKey,
    pub(crate) checksum: u64,
}

/// The slots of one atlas.
///
/// A page keeps its slot while it is used; one that is not may lose it to another at any
/// [`Slots::place`].
#[derive(Debug)]
pub(crate) struct Slots {
    capacity: u32,
    slot_of: HashMap<PageName, u32>,
    /// By slot.
    holders: Vec<Holder>,
    turn: u64,
}

/// Who is in a slot, and when it was last used.
#[derive(Clone, Copy, Debug)]
struct Holder {
    page: PageName,
    used: u64,
}

/// Where a page went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Placed {
    /// It was there.
    Resident(u32),
    /// Its texels have to be written.
    New(u32),
    /// Every slot holds a page of this turn.
    Full,
}

impl Slots {
    pub(crate) fn new(capacity: u32) -> Self {
        Self { capacity, slot_of: HashMap::new(), holders: Vec::new(), turn: 0 }
    }

    /// More slots; those in use stay.
    pub(crate) fn grow(&mut self, capacity: u32) {
        self.capacity = self.capacity.max(capacity);
    }

    /// Starts a turn: pages placed before it may lose their slots.
    pub(crate) fn next_turn(&mut self) {
        self.turn += 1;
    }

    /// Marks a page that has a slot as used in this turn, and says where it is.
    pub(crate) fn keep(&mut self, page: PageName) -> Option<u32> {
        let slot = *self.slot_of.get(&page)?;
        let holder = &mut self.holders[slot as usize];
        holder.used = self.turn;
        Some(slot)
    }

    /// Finds a slot for `page`.
    pub(crate) fn place(&mut self, page: PageName) -> Placed {
        if let Some(slot) = self.keep(page) {
            return Placed::Resident(slot);
        }
        let next = u32::try_from(self.holders.len()).expect("slots are counted in u32");
        if next < self.capacity {
            self.holders.push(self.holder(page));
            self.slot_of.insert(page, next);
            return Placed::New(next);
        }
        let oldest = self.holders.iter().enumerate().min_by_key(|(_, holder)| holder.used);
        let Some((slot, holder)) = oldest.filter(|(_, holder)| holder.used < self.turn) else {
            return Placed::Full;
        };
        self.slot_of.remove(&holder.page);
        self.holders[slot] = self.holder(page);
        let slot = u32::try_from(slot).expect("slots are counted in u32");
        self.slot_of.insert(page, slot);
        Placed::New(slot)
    }

    fn holder(&self, page: PageName) -> Holder {
        Holder { page, used: self.turn }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name(raw: u64) -> PageName {
        PageName { dataset: 0, page: PageKey::from_raw(raw), checksum: 0 }
    }

    #[test]
    fn the_least_recently_used_page_makes_room() {
        let mut slots = Slots::new(2);
        slots.next_turn();
        assert_eq!(slots.place(name(1)), Placed::New(0));
        assert_eq!(slots.place(name(2)), Placed::New(1));
        assert_eq!(slots.place(name(3)), Placed::Full);
        slots.next_turn();
        assert_eq!(slots.place(name(1)), Placed::Resident(0));
        assert_eq!(slots.place(name(3)), Placed::New(1));
        assert_eq!(slots.keep(name(2)), None);
        assert_eq!(slots.place(name(2)), Placed::Full);
    }
}
