//! What is written is what is read.

use areoid_formats::address::{Level, PageAddress, PageKey};
use areoid_formats::codec::Quantum;
use areoid_formats::page::Kind;
use proptest::prelude::*;

use crate::small::{Plan, Small, places, same_entry, same_page};

pub(crate) fn any_plan() -> impl Strategy<Value = Plan> {
    let quanta = [Quantum::NONE, Quantum::new(0.5, -7.0).unwrap(), Quantum::new(1.0, 0.0).unwrap()];
    let kind = prop_oneof![Just(Kind::Height), Just(Kind::Color)];
    let quantum = prop::sample::select(quanta.to_vec());
    (kind, 1..60_u32, 1..60_u32, 5..=9_u32, quantum, any::<u64>()).prop_map(
        |(kind, width, height, half_side, quantum, seed)| {
            let quantum = if kind == Kind::Height { quantum } else { Quantum::NONE };
            Plan { kind, width, height, page_side: 2 * half_side, quantum, seed }
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn every_page_comes_back(plan in any_plan()) {
        let small = Small::new(plan);
        let archive = small.open();
        prop_assert_eq!(archive.description(), &small.description);
        prop_assert_eq!(archive.len(), small.written.bytes);
        prop_assert_eq!(archive.page_count().unwrap(), small.pages.len() as u64);
        prop_assert_eq!(archive.summary(), Some(&small.written.summary));

        for place in places(small.description.grid.pyramid()) {
            let found = archive.find(place).unwrap();
            prop_assert!(matches!(archive.find_resident(place), Some(again) if again.is_some() == found.is_some()));
            match (small.pages.get(&PageKey::from(place)), found) {
                (None, None) => {}
                (Some((entry, page)), Some(found)) => {
                    prop_assert!(same_entry(entry, &found), "{entry:?} {found:?}");
                    prop_assert!(same_page(page, &archive.page(&found).unwrap()));
                }
                (expected, found) => prop_assert!(false, "{place}: {expected:?} {found:?}"),
            }
        }
        let beyond = PageAddress::new(Level(255), 0, 0);
        prop_assert_eq!(archive.find(beyond).unwrap(), None);

        let all = archive.entries().unwrap();
        let expected = small.entries();
        prop_assert_eq!(all.len(), expected.len());
        prop_assert!(all.iter().zip(&expected).all(|(one, other)| same_entry(one, other)));
        let rebuilt = archive.rebuilt().unwrap();
        prop_assert!(rebuilt.entries.iter().zip(&expected).all(|(one, other)| same_entry(one, other)));
        prop_assert_eq!(rebuilt.entries.len(), expected.len());
        prop_assert!(rebuilt.damaged.is_empty());
        let empty: usize = small.records.iter().map(|record| record.empty.len()).sum();
        prop_assert_eq!(rebuilt.empty_runs.iter().map(|run| run.1).sum::<u64>(), empty as u64);
        prop_assert_eq!(archive.damage().unwrap(), Vec::<String>::new());
    }

    /// Law 8, as far as the writer goes.
    #[test]
    fn the_same_pages_make_the_same_bytes(plan in any_plan()) {
        let (one, other) = (Small::new(plan), Small::new(plan));
        prop_assert_eq!(one.bytes, other.bytes);
        prop_assert_eq!(one.written.content, other.written.content);
    }
}
