//! Forged archives: every checksum holds, and what they prove makes no sense.
//!
//! Whatever a forger writes, a reader ends: without a panic, without a buffer larger than the file,
//! without reading the file many times over, and without a page that the grid does not have.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use areoid_formats::address::{Level, PageAddress, PageKey};
use areoid_formats::archive::layout::{PREAMBLE_LEN, Preamble, TRAILER_LEN, Trailer, archive_id};
use areoid_formats::archive::record::{Marker, RECORD_HEAD_LEN};
use areoid_formats::archive::{Archive, ArchiveError, ConstantTexel, PageEntry, Payload, index};
use areoid_formats::codec::Quantum;
use areoid_formats::page::Kind;
use xxhash_rust::xxh3::xxh3_64;

use crate::lookup::{WIDE, constants};
use crate::small::{Altered, Plan, Small, description, places, same_page};

const BLOCK: usize = index::BLOCK_LEN;

fn small() -> Small {
    let quantum = Quantum::new(0.5, 0.0).unwrap();
    Small::new(Plan { kind: Kind::Height, width: 30, height: 20, page_side: 10, quantum, seed: 2 })
}

fn trailer(bytes: &[u8]) -> Trailer {
    Trailer::parse(bytes.last_chunk().unwrap(), bytes.len() as u64).unwrap()
}

fn with_trailer(mut bytes: Vec<u8>, trailer: &Trailer) -> Vec<u8> {
    let at = bytes.len() - TRAILER_LEN;
    bytes[at..].copy_from_slice(&trailer.to_bytes());
    bytes
}

/// Replaces the index by one of `entries`; as many blocks as before.
fn with_entries(bytes: &[u8], entries: &[PageEntry]) -> Vec<u8> {
    let mut trailer = trailer(bytes);
    let (blocks, root_checksum) = index::build(entries, trailer.archive);
    let mut forged = bytes.to_vec();
    forged[trailer.index as usize..][..blocks.len()].copy_from_slice(&blocks);
    trailer.entries = entries.len() as u64;
    trailer.root_checksum = root_checksum;
    with_trailer(forged, &trailer)
}

/// Puts the checksum of the `length` bytes at `at` into the 8 bytes behind them.
fn seal(bytes: &mut [u8], at: usize, length: usize) {
    let sum = xxh3_64(&bytes[at..at + length]);
    bytes[at + length..][..8].copy_from_slice(&sum.to_le_bytes());
}

/// Reads everything of a forged archive; of the pages of `truth`, none may be wrong.
fn survive(what: &str, bytes: Vec<u8>, truth: &Small) {
    let length = bytes.len() as u64;
    let source = Altered::watched(bytes);
    let read = Arc::clone(&source.read);
    let archive = match Archive::open(Box::new(source)) {
        Ok(archive) => archive,
        Err(error) => {
            assert!(!error.to_string().is_empty());
            return;
        }
    };
    let pyramid = archive.description().grid.pyramid().clone();
    for place in places(truth.description.grid.pyramid()) {
        let _ = archive.find_resident(place);
        let found = archive.find(place).unwrap_or_else(|error| panic!("{what}: {error}"));
        let _ = archive.find_resident(place);
        let Some(entry) = found else { continue };
        assert_eq!(entry.page, place, "{what}");
        if let (Ok(page), Some((_, expected))) =
            (archive.page(&entry), truth.pages.get(&PageKey::from(place)))
        {
            assert!(same_page(&page, expected) || what.contains("constant"), "{what}: {place}");
        }
    }
    archive.find(PageAddress::new(Level(255), u32::MAX, u32::MAX)).unwrap();
    let entries = archive.entries().unwrap();
    assert!(entries.iter().all(|entry| pyramid.contains(entry.page)), "{what}");
    assert!(entries.is_sorted_by_key(|entry| PageKey::from(entry.page)), "{what}");
    let runs = &archive.rebuilt().unwrap().empty_runs;
    assert!(runs.iter().map(|run| run.1).sum::<u64>() < 10_000, "{what}");
    assert!(!archive.damage().unwrap().is_empty(), "{what} goes unnoticed");
    let read = read.load(Ordering::Relaxed);
    assert!(read < 40 * length, "{what}: {read} bytes read of {length}");
}

#[test]
fn a_forged_trailer_is_survived() {
    let small = small();
    let good = trailer(&small.bytes);
    let length = good.file_len;
    type Field = fn(&mut Trailer) -> &mut u64;
    let fields: [(&str, Field); 8] = [
        ("archive", |t| &mut t.archive),
        ("records", |t| &mut t.records),
        ("index", |t| &mut t.index),
        ("entries", |t| &mut t.entries),
        ("summary", |t| &mut t.summary),
        ("summary length", |t| &mut t.summary_len),
        ("copy", |t| &mut t.copy),
        ("file length", |t| &mut t.file_len),
    ];
    for (name, field) in fields {
        let mut changed = good;
        let written = *field(&mut changed);
        let near = [written - 1, written + 1, written + 4096, written.wrapping_sub(4096)];
        let far = [0, 1, length - 1, length, length + 1, 1 << 24, 1 << 40, 1 << 63];
        let last = [u64::MAX - 65_536, u64::MAX - 4095, u64::MAX - 1, u64::MAX];
        for value in near.into_iter().chain(far).chain(last) {
            let mut forged = good;
            *field(&mut forged) = value;
            if forged != good {
                let bytes = with_trailer(small.bytes.to_vec(), &forged);
                survive(&format!("{name} {value}"), bytes, &small);
            }
        }
    }
}

#[test]
fn forged_entries_are_survived() {
    let small = small();
    let entries = small.entries();
    let record = entries.iter().position(|e| matches!(e.payload, Payload::Record { .. })).unwrap();
    let other = entries.iter().rposition(|e| matches!(e.payload, Payload::Record { .. })).unwrap();
    let length = small.bytes.len() as u64;
    let place = |offset, length| Payload::Record { offset, length, checksum: 0 };
    let payloads = [
        place(0, 10),
        place(length, 0),
        place(length - 1, u32::MAX),
        place(u64::MAX, u32::MAX),
        place(u64::MAX - 4095, 0),
        place(1 << 63, 1),
        place(4097, 1),
        entries[other].payload,
        Payload::Constant(ConstantTexel(f32::NAN.to_le_bytes())),
        Payload::Constant(ConstantTexel(f32::INFINITY.to_le_bytes())),
    ];
    let mut forgeries: Vec<(String, PageEntry)> = payloads
        .into_iter()
        .map(|payload| (format!("{payload:?}"), PageEntry { payload, ..entries[record] }))
        .collect();
    let good = entries[record];
    let finest = small.description.grid.pyramid().finest();
    for page in [
        PageAddress::new(Level(255), 0, 0),
        PageAddress::new(finest.finer(), 0, 0),
        PageAddress::new(finest, 3, 0),
        PageAddress::new(finest, 0, (1 << 28) - 1),
        PageAddress::new(Level(0), 1, 1),
    ] {
        forgeries.push((format!("page {page}"), PageEntry { page, ..good }));
    }
    for value in [f32::NAN, f32::NEG_INFINITY, -1.0] {
        forgeries.push((format!("bound {value}"), PageEntry { bound: value, ..good }));
        forgeries.push((format!("error {value}"), PageEntry { source_error: value, ..good }));
        forgeries.push((format!("valid {value}"), PageEntry { valid_fraction: value, ..good }));
    }
    forgeries.push(("range".into(), PageEntry { min: 2.0, max: 1.0, ..good }));
    forgeries.push(("half a range".into(), PageEntry { lowest: f32::NAN, highest: 1.0, ..good }));
    forgeries.push(("valid 2".into(), PageEntry { valid_fraction: 2.0, ..good }));
    for (what, forged) in forgeries {
        let mut changed = entries.clone();
        changed[record] = forged;
        survive(&what, with_entries(&small.bytes, &changed), &small);
    }

    let mut reversed = entries.clone();
    reversed.reverse();
    survive("reversed", with_entries(&small.bytes, &reversed), &small);
    let mut twice = entries.clone();
    twice[record + 1] = twice[record];
    survive("twice", with_entries(&small.bytes, &twice), &small);
    survive("one left out", with_entries(&small.bytes, &entries[1..]), &small);
    survive("most left out", with_entries(&small.bytes, &entries[..1]), &small);
}

#[test]
fn forged_heads_of_blocks_are_survived() {
    let small = small();
    let good = trailer(&small.bytes);
    let at = good.index as usize;
    for (field, offset) in [("magic", 0), ("height", 4), ("count", 8), ("archive", 16)] {
        for value in [0, 1, 1022, 1023, 1024, 4092, 4093, u32::MAX / 64, u32::MAX] {
            let mut forged = small.bytes.to_vec();
            forged[at + offset..][..4].copy_from_slice(&value.to_le_bytes());
            if forged != *small.bytes {
                let root_checksum = xxh3_64(&forged[at..at + BLOCK]);
                let bytes = with_trailer(forged, &Trailer { root_checksum, ..good });
                survive(&format!("{field} {value}"), bytes, &small);
            }
        }
    }
}

/// Inner blocks that promise more children than there are: their places run into the blocks of the
/// next height, which once were taken for leaves and read beyond their end.
#[test]
fn forged_inner_blocks_are_survived() {
    let places = places(description(WIDE).grid.pyramid());
    let (bytes, entries) = constants(WIDE, &places[..2 * 1023 + 5]);
    let good = trailer(&bytes);
    let root = good.index as usize + 3 * BLOCK;
    let root_sum = xxh3_64(&bytes[root..root + BLOCK]);
    assert_eq!(root_sum, good.root_checksum);
    let check = |what: &str, mut forged: Vec<u8>, hide_root: bool| {
        let root_checksum = xxh3_64(&forged[root..root + BLOCK]);
        if hide_root {
            forged[root + 64 + 3 * 16 + 8..][..8].copy_from_slice(&root_checksum.to_le_bytes());
        }
        let root_checksum = xxh3_64(&forged[root..root + BLOCK]);
        let bytes = with_trailer(forged, &Trailer { root_checksum, ..good });
        let archive = Archive::open(Box::new(Altered::watched(bytes))).unwrap();
        for &page in &places {
            let _ = archive.find_resident(page);
            let found = archive.find(page).unwrap();
            let _ = archive.find_resident(page);
            assert_eq!(found.as_ref(), entries.get(&PageKey::from(page)), "{what}: {page}");
        }
        assert_eq!(archive.entries().unwrap().len(), entries.len());
        assert!(!archive.damage().unwrap().is_empty(), "{what}");
    };
    for count in [0, 1, 2, 4, 5, 4092, 4093, u32::MAX] {
        let mut forged = bytes.clone();
        forged[root + 8..][..4].copy_from_slice(&u32::to_le_bytes(count));
        check(&format!("{count} children"), forged.clone(), false);
        // A fourth child, with a key within reach, where the root itself lies.
        let key = PageKey::from(places[1]).get();
        forged[root + 64 + 3 * 16..][..8].copy_from_slice(&key.to_le_bytes());
        check(&format!("{count} children, the root among them"), forged, true);
    }
    let mut swapped = bytes.clone();
    let (first, second) = (root + 64 + 8, root + 64 + 16 + 8);
    swapped[first..first + 8].copy_from_slice(&bytes[second..second + 8]);
    swapped[second..second + 8].copy_from_slice(&bytes[first..first + 8]);
    check("swapped checksums", swapped, false);
}

#[test]
fn forged_records_are_survived() {
    let small = small();
    let id = archive_id(&small.description.to_json());
    let marker = small.records.iter().position(|record| record.is_marker).unwrap();
    let starts: Vec<usize> = std::iter::once(small.start())
        .chain(small.records.iter().map(|record| record.end))
        .collect();
    let length = small.bytes.len() as u64;
    for (name, at) in [("marker", starts[marker]), ("page", starts[usize::from(marker == 0)])] {
        for (field, offset) in [("body length", 16), ("unit", 32), ("constants", 40), ("runs", 48)]
        {
            for value in [
                0,
                1,
                63,
                64,
                length,
                1 << 32,
                u64::MAX / 64,
                u64::MAX / 16,
                u64::MAX - 128,
                u64::MAX,
            ] {
                let mut forged = small.bytes.to_vec();
                forged[at + offset..][..8].copy_from_slice(&value.to_le_bytes());
                seal(&mut forged, at, 96);
                if forged != *small.bytes && (name, field) != ("marker", "unit") {
                    survive(&format!("{name} {field} {value}"), forged, &small);
                }
            }
        }
    }

    // Lists that make no sense, in a marker that holds; the trailer is gone, so records decide.
    let entry = small.entries()[0];
    let strange = PageEntry { page: PageAddress::new(Level(255), 7, 7), ..entry };
    let all = PageKey::from_raw(0);
    for (what, marker) in [
        ("level 255", Marker { unit: 0, constants: vec![strange], empty_runs: vec![] }),
        ("endless run", Marker { unit: 0, constants: vec![], empty_runs: vec![(all, u64::MAX)] }),
        ("no run", Marker { unit: 0, constants: vec![], empty_runs: vec![(all, 0)] }),
        (
            "run past the end of keys",
            Marker {
                unit: 0,
                constants: vec![],
                empty_runs: vec![(PageKey::from_raw(u64::MAX), 9)],
            },
        ),
        ("a page twice", Marker { unit: 0, constants: vec![entry, entry], empty_runs: vec![] }),
    ] {
        let mut forged = small.bytes[..*starts.last().unwrap()].to_vec();
        forged.extend(marker.to_bytes(id));
        forged.resize(forged.len().next_multiple_of(4096), 0);
        survive(what, forged, &small);
    }
}

/// Markers whose bodies claim the rest of the file, one every 4096 bytes, are read once in all.
#[test]
fn a_walk_over_forged_markers_is_linear() {
    let small = small();
    let id = archive_id(&small.description.to_json());
    let mut forged = small.bytes[..small.start()].to_vec();
    let end = forged.len() + 1024 * 4096;
    while forged.len() < end {
        let body = (end - forged.len() - RECORD_HEAD_LEN) / 64;
        let mut head = Marker::default().to_bytes(id);
        head[16..24].copy_from_slice(&(64 * body as u64).to_le_bytes());
        head[40..48].copy_from_slice(&(body as u64).to_le_bytes());
        seal(&mut head, 0, 96);
        head.resize(4096, 0);
        forged.extend(head);
    }
    survive("markers", forged, &small);
}

#[test]
fn forged_descriptions_are_refused() {
    let small = small();
    let json = String::from_utf8(small.description.to_json()).unwrap();
    let open = |json: &[u8], claimed: u32| {
        let preamble = Preamble { description_len: claimed, archive: archive_id(json) };
        let mut bytes = preamble.to_bytes().to_vec();
        bytes.extend_from_slice(json);
        bytes.resize(bytes.len().next_multiple_of(4096), 0);
        Archive::open(Box::new(Altered::watched(bytes)))
    };
    let len = json.len() as u32;
    open(json.as_bytes(), len).unwrap();
    for claimed in [0, len - 1, len + 1, 1 << 24, (1 << 24) + 1, u32::MAX] {
        let error = open(json.as_bytes(), claimed).unwrap_err();
        assert!(!matches!(error, ArchiveError::NotAnArchive { .. }), "{error}");
    }
    for (from, to) in [
        (r#""width":30"#, r#""width":0"#),
        (r#""width":30"#, r#""width":4294967296"#),
        (r#""width":30"#, r#""width":-1"#),
        (r#""page_side":10"#, r#""page_side":0"#),
        (r#""page_side":10"#, r#""page_side":6"#),
        (r#""page_side":10"#, r#""page_side":4098"#),
        (r#""page_side":10"#, r#""page_side":11"#),
        (r#""north":"none""#, r#""north":"outline""#),
        (r#""unit_pages":8"#, r#""unit_pages":0"#),
        (r#""unit_pages":8"#, r#""unit_pages":65"#),
        (r#""step":0.5"#, r#""step":-0.5"#),
        (r#""step":0.5"#, r#""step":1e-300"#),
        (r#""kind":"height""#, r#""kind":"taste""#),
        (r#""pixel_size":[0.125,0.125]"#, r#""pixel_size":[0,0.125]"#),
        (r#""a":3396190.0"#, r#""a":-3396190.0"#),
    ] {
        assert!(json.contains(from), "{from} in {json}");
        let forged = json.replace(from, to);
        let error = open(forged.as_bytes(), forged.len() as u32).unwrap_err();
        assert!(matches!(error, ArchiveError::Description { .. }), "{to}: {error}");
    }
    // As wide as u32 goes: an empty archive of a quarter of a billion columns of pages opens.
    let wide = json.replace(r#""width":30"#, r#""width":1610612736"#);
    let wide = wide.replace(r#""page_side":10"#, r#""page_side":8"#);
    let archive = open(wide.as_bytes(), wide.len() as u32).unwrap();
    let finest = archive.description().grid.pyramid().finest();
    archive.find(PageAddress::new(finest, 0, (1 << 28) - 1)).unwrap();
    let wider = wide.replace("1610612736", "1610612737");
    open(wider.as_bytes(), wider.len() as u32).unwrap_err();

    let deep = "[".repeat(1 << 20);
    open(deep.as_bytes(), 1 << 20).unwrap_err();
    let newer = {
        let mut bytes = small.bytes.to_vec();
        bytes[8..12].copy_from_slice(&3_u32.to_le_bytes());
        seal(&mut bytes, 0, PREAMBLE_LEN - 8);
        Archive::open(Box::new(bytes)).unwrap_err()
    };
    assert!(matches!(newer, ArchiveError::Version { found: 3, supported: 2 }), "{newer}");
}
