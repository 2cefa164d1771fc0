//! Every byte damaged: noticed always, and confined to the page it hit.

use std::sync::Arc;

use areoid_formats::address::PageKey;
use areoid_formats::archive::{Archive, ArchiveError, Payload};
use areoid_formats::codec::Quantum;
use areoid_formats::page::Kind;

use crate::small::{Altered, Plan, Small, places, same_entry, same_page};

/// Flips bits of byte `at` and looks at everything.
fn check(small: &Small, at: usize, mask: u8) {
    let flipped = || Box::new(Altered::flipped(&small.bytes, at, mask));
    let archive = Archive::open(flipped()).unwrap_or_else(|error| panic!("byte {at}: {error}"));
    assert_eq!(archive.description(), &small.description, "byte {at}");
    for place in places(small.description.grid.pyramid()) {
        let found = archive.find(place).unwrap();
        let Some((entry, page)) = small.pages.get(&PageKey::from(place)) else {
            assert_eq!(found, None, "byte {at}");
            continue;
        };
        let found = found.unwrap_or_else(|| panic!("byte {at} loses {place}"));
        assert!(same_entry(&found, entry), "byte {at} changes {place}");
        let hit = match entry.payload {
            Payload::Record { offset, length, .. } => {
                let payload = offset as usize + 128;
                (payload..payload + length as usize).contains(&at)
            }
            Payload::Constant(_) => false,
        };
        match archive.page(&found) {
            Ok(read) => assert!(!hit && same_page(&read, page), "byte {at} changes {place}"),
            Err(ArchiveError::PageChecksum { page, .. }) => assert!(hit && page == place),
            Err(error) => panic!("byte {at}: {error}"),
        }
    }
    assert_eq!(archive.entries().unwrap().len(), small.pages.len());
    let problems = archive.damage().unwrap();
    assert!(!problems.is_empty(), "byte {at} of {} goes unnoticed", small.bytes.len());
}

fn every_byte(kind: Kind, quantum: Quantum, seed: u64) {
    let small = Small::new(Plan { kind, width: 20, height: 9, page_side: 10, quantum, seed });
    let constants =
        small.pages.values().filter(|(entry, _)| matches!(entry.payload, Payload::Constant(_)));
    let (constants, pages) = (constants.count(), small.pages.len());
    let empty: usize = small.records.iter().map(|record| record.empty.len()).sum();
    assert!(constants > 0 && pages > constants + 1 && empty > 0, "{constants} {pages} {empty}");
    for at in 0..small.bytes.len() {
        let one = 1 << (at % 8);
        let two = if at % 3 == 0 { 1 << ((at / 8) % 8) } else { 0 };
        check(&small, at, one | two);
    }
}

#[test]
fn every_damaged_byte_of_heights_is_noticed_and_confined() {
    every_byte(Kind::Height, Quantum::new(0.5, 0.0).unwrap(), SEED);
}

#[test]
fn every_damaged_byte_of_colors_is_noticed_and_confined() {
    every_byte(Kind::Color, Quantum::NONE, SEED);
}

/// Makes pages of all forms.
const SEED: u64 = 4;

#[test]
fn whole_blocks_of_damage_are_confined_too() {
    let quantum = Quantum::NONE;
    let small = Small::new(Plan {
        kind: Kind::Height,
        width: 40,
        height: 30,
        page_side: 10,
        quantum,
        seed: 9,
    });
    for start in (0..small.bytes.len()).step_by(4096) {
        let mut bytes = small.bytes.to_vec();
        let end = (start + 4096).min(bytes.len());
        bytes[start..end].fill(0xa5);
        let archive = Archive::open(Box::new(bytes)).unwrap();
        let lost = small.pages.values().filter(|(entry, page)| {
            let read = archive.find(entry.page).unwrap().map(|found| archive.page(&found));
            !matches!(read, Some(Ok(read)) if same_page(&read, page))
        });
        assert!(lost.count() <= 1, "damage from {start} on costs more than a page");
        assert!(!archive.damage().unwrap().is_empty());
    }
}

/// An audit reads the medium, not what was read before the medium went bad.
#[test]
fn damage_after_the_first_look_is_noticed() {
    #[derive(Debug)]
    struct GoesBad(Arc<Vec<u8>>, Arc<std::sync::atomic::AtomicUsize>);
    impl areoid_formats::storage::ByteSource for GoesBad {
        fn len(&self) -> u64 {
            self.0.len() as u64
        }
        fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> std::io::Result<()> {
            let at = self.1.load(std::sync::atomic::Ordering::Relaxed);
            Altered::flipped(&self.0, at, u8::from(at != 0)).read_exact_at(buffer, offset)
        }
    }

    let small = Small::new(Plan {
        kind: Kind::Color,
        width: 20,
        height: 9,
        page_side: 10,
        quantum: Quantum::NONE,
        seed: SEED,
    });
    let switch = Arc::default();
    let source = GoesBad(Arc::clone(&small.bytes), Arc::clone(&switch));
    let archive = Archive::open(Box::new(source)).unwrap();
    archive.entries().unwrap();
    assert!(archive.damage().unwrap().is_empty());
    let in_the_index = small.records.last().unwrap().end + 5000;
    for at in [in_the_index, small.bytes.len() - 1, small.bytes.len() - 200] {
        switch.store(at, std::sync::atomic::Ordering::Relaxed);
        assert!(!archive.damage().unwrap().is_empty(), "byte {at}");
    }
}
