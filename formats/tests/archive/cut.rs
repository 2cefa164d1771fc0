//! A writer stopped at any byte: what was whole by then is read.

use areoid_formats::address::PageKey;
use areoid_formats::archive::{Archive, recover};
use areoid_formats::codec::Quantum;
use areoid_formats::page::Kind;
use proptest::prelude::*;

use crate::round_trip::any_plan;
use crate::small::{Plan, Small, same_entry};

/// Checks an archive cut to its first `length` bytes.
fn check(small: &Small, length: usize) {
    let cut = small.bytes[..length].to_vec();
    let whole: Vec<_> = small.records.iter().take_while(|record| record.end <= length).collect();
    let mut expected: Vec<_> = whole.iter().flat_map(|record| &record.entries).collect();
    expected.sort_by_key(|entry| PageKey::from(entry.page));

    let id = small.archive_id();
    let start = small.start() as u64;
    let found = recover::scan(&cut, id, start..(length as u64).max(start)).unwrap();
    assert_eq!(found.entries.len(), expected.len(), "cut at {length}");
    assert!(found.entries.iter().zip(&expected).all(|(one, other)| same_entry(one, other)));
    let markers = whole.iter().filter(|record| record.is_marker).count() as u64;
    assert_eq!(found.units, (0..markers).collect::<Vec<_>>(), "cut at {length}");
    assert_eq!(found.end, whole.last().map_or(start, |record| record.end as u64));

    let head = 64 + small.description.to_json().len();
    match Archive::open(Box::new(cut)) {
        Err(error) => assert!(length < head, "cut at {length}: {error}"),
        Ok(archive) => {
            assert!(length >= head, "cut at {length}");
            assert_eq!(archive.entries().unwrap().len(), expected.len());
            assert_eq!(archive.damage().unwrap().is_empty(), length == small.bytes.len());
            for entry in expected {
                assert!(same_entry(&archive.find(entry.page).unwrap().unwrap(), entry));
                archive.page(entry).unwrap();
            }
        }
    }
}

impl Small {
    fn archive_id(&self) -> u64 {
        areoid_formats::archive::layout::archive_id(&self.description.to_json())
    }
}

#[test]
fn a_writer_stopped_at_any_byte_leaves_what_was_whole() {
    let quantum = Quantum::new(1.0, 0.0).unwrap();
    let small = Small::new(Plan {
        kind: Kind::Height,
        width: 30,
        height: 20,
        page_side: 10,
        quantum,
        seed: 1,
    });
    assert!(small.records.len() > 8 && small.pages.len() > 8);
    let around = |at: &usize| [at.saturating_sub(1), *at, (at + 1).min(small.bytes.len())];
    let edges = small.calls.iter().chain(small.records.iter().map(|record| &record.end));
    let mut lengths: Vec<usize> = edges.flat_map(around).collect();
    lengths.extend((0..small.bytes.len()).step_by(61));
    lengths.sort_unstable();
    lengths.dedup();
    for length in lengths {
        check(&small, length);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn a_writer_stopped_between_two_writes_leaves_what_was_whole(plan in any_plan()) {
        let small = Small::new(plan);
        for &length in &small.calls {
            check(&small, length);
        }
    }
}
