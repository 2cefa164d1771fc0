//! Finding pages through an index of more than one height.

use std::collections::BTreeMap;

use areoid_formats::address::{PageAddress, PageKey};
use areoid_formats::archive::{
    Archive, ArchiveError, ArchiveWriter, ConstantTexel, PageEntry, Payload,
};
use areoid_formats::codec::Quantum;
use areoid_formats::page::Kind;
use proptest::prelude::*;

use crate::small::{Altered, Plan, description, places, same_entry};

/// An archive of constant pages at `pages`.
pub(crate) fn constants(
    plan: Plan,
    pages: &[PageAddress],
) -> (Vec<u8>, BTreeMap<PageKey, PageEntry>) {
    let description = description(plan);
    let mut writer = ArchiveWriter::new(Vec::new(), &description).unwrap();
    let mut entries = BTreeMap::new();
    for (number, &page) in pages.iter().enumerate() {
        let height = number as f32;
        let entry = PageEntry {
            page,
            payload: Payload::Constant(ConstantTexel(height.to_le_bytes())),
            valid_fraction: 1.0,
            min: height,
            max: height,
            lowest: height,
            highest: height,
            bound: 0.0,
            source_error: 0.0,
            full: true,
        };
        writer.page(entry, &[]).unwrap();
        entries.insert(PageKey::from(page), entry);
        if number % 500 == 499 {
            writer.end_unit().unwrap();
        }
    }
    let (bytes, _) = writer.finish().unwrap();
    (bytes, entries)
}

pub(crate) const WIDE: Plan = Plan {
    kind: Kind::Height,
    width: 6 * 47,
    height: 6 * 47 - 1,
    page_side: 8,
    quantum: Quantum::NONE,
    seed: 0,
};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn a_page_is_found_if_and_only_if_it_is_there(
        left_out in prop::collection::hash_set(0..2951_usize, 0..900),
        first in any::<prop::sample::Index>(),
    ) {
        let places = places(description(WIDE).grid.pyramid());
        let chosen: Vec<_> = places
            .iter()
            .enumerate()
            .filter(|(number, _)| !left_out.contains(number))
            .map(|(_, &page)| page)
            .collect();
        prop_assert!(chosen.len() > 2 * 1023 + 4, "{}", chosen.len());
        let (bytes, entries) = constants(WIDE, &chosen);
        let archive = Archive::open(Box::new(bytes)).unwrap();

        let first = places[first.index(places.len())];
        prop_assert_eq!(archive.find_resident(first), None, "nothing has been read");
        for &page in std::iter::once(&first).chain(&places) {
            let expected = entries.get(&PageKey::from(page));
            let found = archive.find(page).unwrap();
            prop_assert_eq!(found.is_some(), expected.is_some(), "{}", page);
            prop_assert!(found.iter().zip(expected).all(|(one, other)| same_entry(one, other)));
            prop_assert_eq!(archive.find_resident(page), Some(found));
        }
        prop_assert_eq!(archive.page_count().unwrap(), entries.len() as u64);
        prop_assert!(archive.entries().unwrap().iter().eq(entries.values()));
        prop_assert!(archive.rebuilt().unwrap().entries.iter().eq(entries.values()));
    }

    /// One damaged block of a tall index sends the reader to the records, and changes no answer.
    #[test]
    fn a_damaged_block_changes_no_answer(at in any::<prop::sample::Index>(), bit in 0..8_u8) {
        let places = places(description(WIDE).grid.pyramid());
        let chosen = &places[..2 * 1023 + 5];
        let (bytes, entries) = constants(WIDE, chosen);
        let json_len = description(WIDE).to_json().len();
        let tail = bytes.len() - 128 - 64 - json_len;
        // The index: three leaves and a root, before a summary of some hundred bytes.
        let index = (tail - 4 * 65_536) & !4095;
        let at = index + at.index(4 * 65_536);
        let source = Altered::flipped(&std::sync::Arc::new(bytes), at, 1 << bit);
        let archive = Archive::open(Box::new(source)).unwrap();
        for &page in &places {
            let found = archive.find(page).unwrap();
            let expected = entries.get(&PageKey::from(page)).copied();
            prop_assert_eq!(found, expected, "byte {} changes {}", at, page);
        }
        prop_assert!(!archive.damage().unwrap().is_empty());
    }

    /// From afar the records are not walked: what a damaged block leads to cannot be had, and costs no
    /// more than the block.
    #[test]
    fn from_afar_a_damaged_block_is_an_error(at in any::<prop::sample::Index>(), bit in 0..8_u8) {
        let places = places(description(WIDE).grid.pyramid());
        let (bytes, entries) = constants(WIDE, &places[..2 * 1023 + 5]);
        let tail = bytes.len() - 128 - 64 - description(WIDE).to_json().len();
        let index = (tail - 4 * 65_536) & !4095;
        let at = index + at.index(4 * 65_536);
        let source = Altered::flipped(&std::sync::Arc::new(bytes), at, 1 << bit);
        let read = std::sync::Arc::clone(&source.read);
        let archive = Archive::open_afar(Box::new(source)).unwrap();
        let mut failed = 0;
        for &page in &places {
            let before = read.load(std::sync::atomic::Ordering::Relaxed);
            match archive.find(page) {
                Ok(found) => prop_assert_eq!(found, entries.get(&PageKey::from(page)).copied()),
                Err(error) => {
                    failed += 1;
                    prop_assert!(matches!(error, ArchiveError::Checksum { .. }), "{}", error);
                }
            }
            let more = read.load(std::sync::atomic::Ordering::Relaxed) - before;
            prop_assert!(more <= 2 * 65_536, "{} bytes", more);
        }
        prop_assert!(failed > 0 && archive.rebuilt().is_err());
    }
}
