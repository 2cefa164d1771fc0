//! Small archives of random pages, and sources that watch their reader.

use std::collections::BTreeMap;
use std::io::{self, Write};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use areoid_formats::address::{PageAddress, PageKey};
use areoid_formats::archive::{
    Archive, ArchiveWriter, ConstantTexel, Description, MipRule, PageEntry, Payload, Source,
    SourceFile, Written,
};
use areoid_formats::body::Body;
use areoid_formats::codec::{self, Quantum};
use areoid_formats::grid::{Grid, Outline};
use areoid_formats::page::{Kind, Page, Texels};
use areoid_formats::projection::{Crs, Projection};
use areoid_formats::pyramid::Pyramid;
use areoid_formats::storage::ByteSource;

/// Numbers that look random and are the same on every machine (splitmix64).
#[derive(Clone, Debug)]
pub(crate) struct Noise(pub(crate) u64);

impl Noise {
    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub(crate) fn below(&mut self, end: u64) -> u64 {
        self.next() % end
    }

    /// From 0 to 1, on steps that every f32 holds.
    fn share(&mut self) -> f32 {
        self.below(1025) as f32 / 1024.0
    }
}

/// What to write.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Plan {
    pub(crate) kind: Kind,
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) page_side: u32,
    pub(crate) quantum: Quantum,
    pub(crate) seed: u64,
}

/// An archive, and what was put into it.
#[derive(Debug)]
pub(crate) struct Small {
    pub(crate) description: Description,
    pub(crate) bytes: Arc<Vec<u8>>,
    /// Length of the archive after each write call.
    pub(crate) calls: Vec<usize>,
    /// The records: where each ends, its pages, and whether it is a marker.
    pub(crate) records: Vec<Record>,
    pub(crate) pages: BTreeMap<PageKey, (PageEntry, Page)>,
    pub(crate) written: Written,
}

#[derive(Debug)]
pub(crate) struct Record {
    pub(crate) end: usize,
    pub(crate) entries: Vec<PageEntry>,
    pub(crate) empty: Vec<PageKey>,
    pub(crate) is_marker: bool,
}

/// A sink that can be looked at while it is written, and counts the calls.
#[derive(Clone, Debug, Default)]
struct Watched(Arc<Mutex<(Vec<u8>, Vec<usize>)>>);

impl Watched {
    fn len(&self) -> usize {
        self.0.lock().unwrap().0.len()
    }
}

impl Write for Watched {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let (all, calls) = &mut *self.0.lock().unwrap();
        all.extend_from_slice(bytes);
        calls.push(all.len());
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

pub(crate) fn description(plan: Plan) -> Description {
    let body = Body::parse("mars").unwrap();
    let crs = Crs::new(Projection::Geographic, body.ellipsoid);
    let Plan { width, height, .. } = plan;
    let outline = Outline { origin: [-10.0, 40.0], pixel_size: [0.125; 2], width, height };
    let grid = Grid::from_outline(crs, outline, plan.page_side).unwrap().grid;
    Description {
        dataset: "noise".to_owned(),
        kind: plan.kind,
        body,
        grid,
        quantum: plan.quantum,
        priority: 3,
        feather_texels: 32,
        unit_pages: 8,
        resampling: None,
        mip: MipRule::Mean,
        source: Source {
            files: vec![SourceFile { name: "noise.tif".into(), bytes: 7, xxh3: "0".repeat(32) }],
            nodata: Some("NaN".to_owned()),
            ..Source::default()
        },
    }
}

/// All pages that a pyramid has a place for, finest level first.
pub(crate) fn places(pyramid: &Pyramid) -> Vec<PageAddress> {
    let levels = pyramid.levels().rev();
    let pages = levels.flat_map(|level| {
        let (rows, cols) = pyramid.pages(level).unwrap();
        (0..rows).flat_map(move |r| (0..cols).map(move |c| PageAddress::new(level, r, c)))
    });
    pages.collect()
}

impl Small {
    /// Writes pages of noise: of five one is empty, one constant, one has holes.
    pub(crate) fn new(plan: Plan) -> Self {
        let description = description(plan);
        let mut noise = Noise(plan.seed);
        let sink = Watched::default();
        let mut writer = ArchiveWriter::new(sink.clone(), &description).unwrap();
        let mut records = Vec::new();
        let mut pages = BTreeMap::new();
        let (mut constants, mut empty) = (Vec::new(), Vec::new());
        for address in places(description.grid.pyramid()) {
            match random_page(&description, &mut noise) {
                None => {
                    writer.empty(address);
                    empty.push(address.into());
                }
                Some((page, payload)) => {
                    let entry = random_entry(address, &page, payload.is_none(), &mut noise);
                    writer.page(entry, payload.as_deref().unwrap_or_default()).unwrap();
                    if payload.is_none() {
                        constants.push(entry);
                    } else {
                        let (entries, empty) = (vec![entry], Vec::new());
                        records.push(Record { end: sink.len(), entries, empty, is_marker: false });
                    }
                    pages.insert(PageKey::from(address), (entry, page));
                }
            }
            if noise.below(4) == 0 {
                writer.end_unit().unwrap();
                let (entries, empty) = (std::mem::take(&mut constants), std::mem::take(&mut empty));
                records.push(Record { end: sink.len(), entries, empty, is_marker: true });
            }
        }
        writer.end_unit().unwrap();
        records.push(Record { end: sink.len(), entries: constants, empty, is_marker: true });
        let (sink, written) = writer.finish().unwrap();
        let (bytes, calls) = std::mem::take(&mut *sink.0.lock().unwrap());
        let mut small =
            Self { description, bytes: Arc::new(bytes), calls, records, pages, written };
        small.place();
        small
    }

    /// Fills in where the writer has put the payloads.
    fn place(&mut self) {
        let mut start = (64 + self.description.to_json().len()).next_multiple_of(4096);
        for record in &mut self.records {
            for entry in &mut record.entries {
                if let Payload::Record { offset, length, checksum } = &mut entry.payload {
                    *offset = start as u64;
                    *length =
                        u32::from_le_bytes(self.bytes[start + 16..start + 20].try_into().unwrap());
                    let payload = &self.bytes[start + 128..][..*length as usize];
                    *checksum = areoid_formats::archive::payload_checksum(entry.page, payload);
                }
                self.pages.get_mut(&PageKey::from(entry.page)).unwrap().0 = *entry;
            }
            start = record.end;
        }
    }

    pub(crate) fn open(&self) -> Archive {
        Archive::open(Box::new(self.bytes.to_vec())).unwrap()
    }

    /// Where the records start.
    pub(crate) fn start(&self) -> usize {
        (64 + self.description.to_json().len()).next_multiple_of(4096)
    }

    /// The entries, in the order of their keys.
    pub(crate) fn entries(&self) -> Vec<PageEntry> {
        self.pages.values().map(|(entry, _)| *entry).collect()
    }
}

/// A page and its payload, or `None` for the payload of a constant one.
fn random_page(description: &Description, noise: &mut Noise) -> Option<(Page, Option<Vec<u8>>)> {
    let side = description.grid.pyramid().page_side() as usize;
    let count = side * side;
    let quantum = description.quantum;
    let height = |noise: &mut Noise| {
        let value = noise.below(20_000) as f64 / 8.0 - 900.0;
        quantum.round(value).unwrap()
    };
    let form = noise.below(5);
    if form == 0 {
        return None;
    }
    let coverage = (form == 2).then(|| {
        let mut codes: Vec<u8> =
            (0..count).map(|_| (noise.below(3) * noise.below(128)) as u8).collect();
        codes[0] = 255;
        codes[1] = 0;
        codes
    });
    let covered = |at: usize| coverage.as_ref().is_none_or(|codes| codes[at] != 0);
    let (texels, payload) = match description.kind {
        Kind::Height if form == 1 => (Texels::Height(vec![height(noise); count]), None),
        Kind::Height => {
            let texel = |at| if covered(at) { height(noise) } else { f32::NAN };
            let texels: Vec<f32> = (0..count).map(texel).collect();
            let payload = codec::encode_heights(&texels, coverage.as_deref(), side, quantum);
            (Texels::Height(texels), Some(payload.unwrap()))
        }
        _ if form == 1 => {
            let [red, green, blue, ..] = noise.next().to_le_bytes();
            (Texels::Color(vec![[red, green, blue]; count]), None)
        }
        _ => {
            let texel = |at| {
                let [red, green, blue, ..] = noise.next().to_le_bytes();
                if covered(at) { [red, green, blue] } else { [0; 3] }
            };
            let texels: Vec<[u8; 3]> = (0..count).map(texel).collect();
            let payload = codec::encode_colors(&texels, coverage.as_deref(), side);
            (Texels::Color(texels), Some(payload.unwrap()))
        }
    };
    Some((Page::new(side, texels, coverage), payload))
}

fn random_entry(page: PageAddress, texels: &Page, constant: bool, noise: &mut Noise) -> PageEntry {
    let payload = if constant {
        let texel = match texels.texels() {
            Texels::Height(texels) => texels[0].to_le_bytes(),
            Texels::Color(texels) => [texels[0][0], texels[0][1], texels[0][2], 0],
        };
        Payload::Constant(ConstantTexel(texel))
    } else {
        Payload::Record { offset: 0, length: 0, checksum: 0 }
    };
    // One in eight shows data in its border alone.
    let border_only = noise.below(8) == 0;
    let figure = |figure: f32| if border_only { f32::NAN } else { figure };
    let min = noise.share() * 100.0;
    PageEntry {
        page,
        payload,
        valid_fraction: if border_only { 0.0 } else { noise.share() },
        min: figure(min),
        max: figure(min + noise.share()),
        lowest: min - noise.share(),
        highest: min + 1.0 + noise.share(),
        bound: noise.share(),
        source_error: noise.share(),
        full: texels.coverage().is_none(),
    }
}

/// Whether two pages are the same to the bit, NaN included.
pub(crate) fn same_page(one: &Page, other: &Page) -> bool {
    let bits = |page: &Page| match page.texels() {
        Texels::Height(texels) => texels.iter().map(|texel| texel.to_bits()).collect(),
        Texels::Color(texels) => {
            texels.iter().map(|t| u32::from_le_bytes([t[0], t[1], t[2], 0])).collect::<Vec<u32>>()
        }
    };
    bits(one) == bits(other) && one.coverage() == other.coverage()
}

/// Whether two entries are the same to the bit, NaN included.
pub(crate) fn same_entry(one: &PageEntry, other: &PageEntry) -> bool {
    one.to_bytes() == other.to_bytes()
}

/// Bytes of which some differ, read by a reader that is watched: it never asks for more than there
/// is at once, and what it has read in all is counted.
#[derive(Debug)]
pub(crate) struct Altered {
    pub(crate) bytes: Arc<Vec<u8>>,
    pub(crate) at: usize,
    pub(crate) mask: u8,
    pub(crate) read: Arc<AtomicU64>,
}

impl Altered {
    pub(crate) fn flipped(bytes: &Arc<Vec<u8>>, at: usize, mask: u8) -> Self {
        Self { bytes: Arc::clone(bytes), at, mask, read: Arc::default() }
    }

    pub(crate) fn watched(bytes: Vec<u8>) -> Self {
        Self::flipped(&Arc::new(bytes), 0, 0)
    }
}

impl ByteSource for Altered {
    fn len(&self) -> u64 {
        self.bytes.len() as u64
    }

    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        assert!(buffer.len() <= self.bytes.len().max(4096), "a buffer of {}", buffer.len());
        self.read.fetch_add(buffer.len() as u64, Ordering::Relaxed);
        self.bytes.read_exact_at(buffer, offset)?;
        if let Some(byte) =
            (self.at as u64).checked_sub(offset).and_then(|at| buffer.get_mut(at as usize))
        {
            *byte ^= self.mask;
        }
        Ok(())
    }
}
