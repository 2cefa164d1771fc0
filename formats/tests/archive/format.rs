//! `FORMAT.md` against the bytes: a reader that knows nothing but its tables.

use std::collections::BTreeMap;

use areoid_formats::address::PageKey;
use areoid_formats::archive::layout::Trailer;
use areoid_formats::archive::{
    Archive, Description, MipRule, PageEntry, Payload, index, payload_checksum,
};
use areoid_formats::codec::Quantum;
use areoid_formats::page::Kind;
use xxhash_rust::xxh3::xxh3_64;

use crate::lookup::{WIDE, constants};
use crate::small::{Plan, Small, description, places};

const FORMAT: &str = include_str!("../../FORMAT.md");

/// A structure as `FORMAT.md` draws it: fields by name, with offset and length.
struct Table(BTreeMap<String, (usize, usize)>);

impl Table {
    /// The table under `heading`, whose fields cover `length` bytes without a gap.
    fn read(heading: &str, length: usize) -> Self {
        let (_, text) = FORMAT.split_once(&format!("# {heading}\n")).expect("the heading is there");
        let text = text.split("\n#").next().unwrap();
        let mut fields = BTreeMap::new();
        let mut end = 0;
        for row in text.lines().filter(|line| line.starts_with('|')) {
            let cells: Vec<&str> = row.split('|').map(str::trim).collect();
            let Ok(offset) = cells[1].parse::<usize>() else { continue };
            let size = match cells[2] {
                "u32" | "f32" => 4,
                "u64" => 8,
                many => many.strip_prefix("u8×").unwrap().parse().unwrap(),
            };
            assert_eq!(offset, end, "{heading}: {row}");
            end += size;
            fields.insert(cells[3].to_owned(), (offset, size));
        }
        assert_eq!(end, length, "{heading}");
        Self(fields)
    }

    fn bytes<'a>(&self, structure: &'a [u8], field: &str) -> &'a [u8] {
        let (offset, size) = self.0[field];
        &structure[offset..offset + size]
    }

    fn number(&self, structure: &[u8], field: &str) -> u64 {
        let mut wide = [0; 8];
        let bytes = self.bytes(structure, field);
        wide[..bytes.len()].copy_from_slice(bytes);
        u64::from_le_bytes(wide)
    }

    fn float(&self, structure: &[u8], field: &str) -> f32 {
        f32::from_le_bytes(self.bytes(structure, field).try_into().unwrap())
    }
}

/// The magic number that the table under `heading` gives, byte by byte.
fn magic(heading: &str) -> Vec<u8> {
    let (_, text) = FORMAT.split_once(&format!("# {heading}\n")).unwrap();
    let row = text.lines().find(|line| line.contains("| magic |")).unwrap();
    let digits = row.split('|').nth(4).unwrap();
    digits.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
}

fn check_entry(bytes: &[u8], entry: &PageEntry) {
    let table = Table::read("Entry", 64);
    assert_eq!(table.number(bytes, "key"), PageKey::from(entry.page).get());
    let flags = table.number(bytes, "flags");
    match entry.payload {
        Payload::Constant(texel) => {
            assert_eq!(table.bytes(bytes, "texel"), texel.0);
            assert_eq!(flags & 1, 1);
            let zeros = ["offset", "length", "checksum"];
            assert!(zeros.iter().all(|field| table.number(bytes, field) == 0));
        }
        Payload::Record { offset, length, checksum } => {
            assert_eq!(table.number(bytes, "offset"), offset);
            assert_eq!(table.number(bytes, "length"), u64::from(length));
            assert_eq!(table.number(bytes, "checksum"), checksum);
            assert_eq!((flags & 1, table.number(bytes, "texel")), (0, 0));
        }
    }
    assert_eq!(flags >> 1, u64::from(entry.full));
    for (field, value) in [
        ("valid fraction", entry.valid_fraction),
        ("min", entry.min),
        ("max", entry.max),
        ("lowest", entry.lowest),
        ("highest", entry.highest),
        ("bound", entry.bound),
        ("source error", entry.source_error),
    ] {
        assert_eq!(table.float(bytes, field).to_bits(), value.to_bits(), "{field}");
    }
}

#[test]
fn the_tables_read_an_archive() {
    let quantum = Quantum::new(1.0, 0.0).unwrap();
    let small = Small::new(Plan {
        kind: Kind::Height,
        width: 30,
        height: 20,
        page_side: 10,
        quantum,
        seed: 3,
    });
    let bytes = &small.bytes[..];

    let preamble = Table::read("Preamble", 64);
    assert_eq!(preamble.bytes(bytes, "magic"), magic("Preamble"));
    assert_eq!(preamble.number(bytes, "version"), 2);
    assert_eq!(preamble.number(bytes, "checksum"), xxh3_64(&bytes[..56]));
    let json = &bytes[64..][..preamble.number(bytes, "description length") as usize];
    let id = xxh3_64(json);
    assert_eq!(preamble.number(bytes, "archive"), id);
    assert_eq!(Description::from_json(json).unwrap(), small.description);

    let (page, marker) = (Table::read("Head of a page", 128), Table::read("Head of a marker", 128));
    let run = Table::read("Run", 16);
    let mut start = (64 + json.len()).next_multiple_of(4096);
    let mut unit = 0;
    for record in &small.records {
        let head = &bytes[start..start + 128];
        let table = if record.is_marker { &marker } else { &page };
        let heading = if record.is_marker { "Head of a marker" } else { "Head of a page" };
        assert_eq!(table.bytes(head, "magic"), magic(heading));
        assert_eq!(table.number(head, "archive"), id);
        assert_eq!(table.number(head, "checksum"), xxh3_64(&head[..96]));
        let length = table.number(head, "body length") as usize;
        let body = &bytes[start + 128..][..length];
        let next = (start + 128 + length).next_multiple_of(4096);
        assert_eq!(next, record.end);
        assert!(bytes[start + 128 + length..next].iter().all(|&byte| byte == 0));
        if record.is_marker {
            assert_eq!(marker.number(head, "unit"), unit);
            unit += 1;
            let constants = marker.number(head, "constants") as usize;
            let runs = marker.number(head, "runs") as usize;
            assert_eq!(constants, record.entries.len());
            assert_eq!(length, 64 * constants + 16 * runs);
            assert_eq!(marker.number(head, "body checksum"), xxh3_64(body));
            for (bytes, entry) in body.chunks(64).zip(&record.entries) {
                check_entry(bytes, entry);
            }
            let mut listed = Vec::new();
            for bytes in body[64 * constants..].chunks(16) {
                let first = run.number(bytes, "first key");
                listed.extend((0..run.number(bytes, "pages")).map(|more| first + more));
            }
            let mut expected: Vec<u64> = record.empty.iter().map(|key| key.get()).collect();
            expected.sort_unstable();
            assert_eq!(listed, expected);
        } else {
            let entry = page.bytes(head, "entry");
            check_entry(entry, &record.entries[0]);
            let checksum = Table::read("Entry", 64).number(entry, "checksum");
            assert_eq!(checksum, payload_checksum(record.entries[0].page, body));
        }
        start = next;
    }

    let table = Table::read("Trailer", 128);
    let tail = &bytes[bytes.len() - 128..];
    assert_eq!(table.bytes(tail, "magic"), magic("Trailer"));
    assert_eq!(table.number(tail, "checksum"), xxh3_64(&tail[..120]));
    assert_eq!(table.number(tail, "version"), 2);
    assert_eq!(table.number(tail, "archive"), id);
    assert_eq!(table.number(tail, "records"), small.start() as u64);
    assert_eq!(table.number(tail, "index"), start as u64);
    assert_eq!(table.number(tail, "entries"), small.pages.len() as u64);
    assert_eq!(table.number(tail, "file length"), bytes.len() as u64);
    let block = &bytes[start..start + 65_536];
    assert_eq!(table.number(tail, "root checksum"), xxh3_64(block));
    for (bytes, entry) in block[64..].chunks(64).zip(small.entries()) {
        check_entry(bytes, &entry);
    }
    let part = |at: &str, length: usize| &bytes[table.number(tail, at) as usize..][..length];
    let summary = part("summary", table.number(tail, "summary length") as usize);
    assert_eq!(table.number(tail, "summary checksum"), xxh3_64(summary));
    assert_eq!(serde_json::to_vec(&small.written.summary).unwrap(), summary);
    assert_eq!(part("copy", 64 + json.len()), &bytes[..64 + json.len()]);
    assert_eq!(small.written.content, xxh3_64(tail));
}

#[test]
fn the_tables_find_a_page_through_a_tall_index() {
    let places = places(description(WIDE).grid.pyramid());
    let (bytes, entries) = constants(WIDE, &places[..2 * 1023 + 5]);
    let tail: Trailer = Trailer::parse(bytes.last_chunk().unwrap(), bytes.len() as u64).unwrap();
    let (head, child) = (Table::read("Head of a block", 64), Table::read("Child", 16));
    let block = |number: usize| &bytes[tail.index as usize + 65_536 * number..][..65_536];
    assert_eq!((index::ENTRIES_PER_LEAF, index::CHILDREN_PER_BLOCK), (1023, 4092));
    assert!(FORMAT.contains("1023 entries of 64 bytes"));
    assert!(FORMAT.contains("4092 children of 16 bytes"));
    let root = block(3);
    for (number, height, count) in [(0, 0, 1023), (1, 0, 1023), (2, 0, 5), (3, 1, 3)] {
        let block = block(number);
        assert_eq!(head.bytes(block, "magic"), magic("Head of a block"));
        assert_eq!(head.number(block, "height"), height);
        assert_eq!(head.number(block, "count"), count);
        assert_eq!(head.number(block, "archive"), tail.archive);
    }
    for (key, entry) in &entries {
        let place = (0..3)
            .rfind(|&place| child.number(&root[64 + 16 * place..][..16], "first key") <= key.get());
        let place = place.unwrap();
        let leaf = block(place);
        let promised = child.number(&root[64 + 16 * place..][..16], "checksum");
        assert_eq!(promised, xxh3_64(leaf));
        let found = leaf[64..].chunks(64).find(|bytes| bytes[..8] == key.get().to_le_bytes());
        check_entry(found.unwrap(), entry);
    }
}

/// The description shown is one, member for member.
#[test]
fn the_description_shown_reads_and_writes() {
    let (_, text) = FORMAT.split_once("```json\n").unwrap();
    let shown = text.split("```").next().unwrap();
    let compact: String = shown.lines().map(str::trim_start).collect();
    let description = Description::from_json(shown.as_bytes()).unwrap();
    assert_eq!(String::from_utf8(description.to_json()).unwrap(), compact);
    let mut archive =
        areoid_formats::archive::ArchiveWriter::new(Vec::new(), &description).unwrap();
    archive.end_unit().unwrap();
    let (bytes, _) = archive.finish().unwrap();
    assert!(Archive::open(Box::new(bytes)).unwrap().damage().unwrap().is_empty());
}

#[test]
fn a_rule_for_coarser_texels_is_named_and_need_not_be_known() {
    let (_, example) = FORMAT.split_once("```json\n").unwrap();
    let (example, _) = example.split_once("```").unwrap();
    let read = |json: &str| Description::from_json(json.as_bytes()).unwrap();
    let shown = read(example);
    assert_eq!(shown.mip, MipRule::Mean);
    assert!(!String::from_utf8(shown.to_json()).unwrap().contains("mip"));
    for (name, rule) in
        [("mean", MipRule::Mean), ("kaiser", MipRule::Kaiser), ("median", MipRule::Unknown)]
    {
        let with = |member: &str| example.replacen('{', &format!("{{{member},"), 1);
        let found = read(&with(&format!(r#""mip":"{name}""#)));
        assert_eq!(found, Description { mip: rule, ..shown.clone() });
        if rule != MipRule::Unknown {
            assert_eq!(found.mip.name(), name);
            assert_eq!(Description::from_json(&found.to_json()).unwrap(), found);
        }
    }
}
