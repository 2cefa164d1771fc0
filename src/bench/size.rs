//! Bytes of the leaves at zero error beside the same pages through DEFLATE, and how fast they
//! decode.

use std::fs;
use std::io::{self, Write};
use std::path::Path;
use std::time::Instant;

use areoid_formats::archive::{Archive, PageEntry};
use areoid_formats::page::{Page, Texels};
use areoid_preprocess::raster::{self, ReadOptions, SampleType};
use flate2::Compression;
use flate2::write::ZlibEncoder;
use rayon::prelude::*;
use serde_json::{Value, json};
use tiff::decoder::Decoder;
use tiff::tags::Tag;

use super::geotiff::difference;
use super::ingest::{Setting, stem};
use super::pairs;
use super::report::{Chapter, Relation, Spread, Table, Target};
use super::terrain::MISSING;
use super::timing::thread_cpu_s;
use crate::failure::Failure;
use crate::output;

/// Pages that GDAL compresses, too.
const CHECKED_PAGES: usize = 48;

/// Pages decoded in memory: at most so many bytes of payloads are held.
const HELD_BYTES: u64 = 256 << 20;

/// Decoding goes on for so many seconds: a system's clock of processor time may tick slowly.
const LEAST_S: f64 = 1.0;

/// Times DEFLATE's bytes, on what a planet looks like and on fractal terrain.
const LIMITS: [f64; 2] = [1.0, 1.06];

/// Texels decoded in a second by one core, in bytes of int16.
const DECODE_BYTES_PER_S: f64 = 1e9;

/// Measures.
pub(super) fn measure(setting: &Setting) -> Result<Chapter, Failure> {
    let mut subjects: Vec<_> = setting.given.iter().map(|path| (path.clone(), LIMITS[0])).collect();
    let recipes = pairs::recipes(setting);
    let terrain = recipes.first().expect("heights come first");
    subjects.push((terrain.make(&setting.rasters())?, LIMITS[1]));

    let (mut rows, mut targets, mut data) = (Vec::new(), Vec::new(), Vec::new());
    for (path, limit) in subjects {
        let name = stem(&path);
        let info = raster::open(&path, &ReadOptions::default())?.info().clone();
        if info.sample != SampleType::I16 || info.bands != 1 {
            output::say(format!("{name} is not int16: its size is not compared"));
            continue;
        }
        output::say(format!("weighing {name}"));
        let (_, archive) = setting.ingested(&path)?;
        let figures = Figures::of(setting, &archive)?;
        let over_gdal = figures.over_gdal.map(|(_, ratio)| ratio);
        let ratio = over_gdal.unwrap_or(figures.stored as f64 / figures.deflated as f64);
        let by = if over_gdal.is_some() { "GDAL's" } else { "our own" };
        let what = format!("{name}: bytes over {by} DEFLATE-6");
        targets.push(Target::new(what, Relation::AtMost, limit, Some(ratio)));
        let what = format!("{name}: decoding, GB/s of int16 texels per core");
        let speed = figures.decode_bytes_per_s.median / 1e9;
        targets.push(Target::new(what, Relation::AtLeast, DECODE_BYTES_PER_S / 1e9, Some(speed)));
        rows.push(figures.row(&name));
        data.push(figures.json(&name));
    }
    let head = vec![
        "raster",
        "leaves",
        "KiB a leaf",
        "DEFLATE-6",
        "over it",
        "over GDAL's",
        "decode GB/s (int16)",
        "GB/s (f32)",
    ];
    Ok(Chapter {
        name: "size",
        title: "Bytes at zero error",
        notes: vec![
            format!(
                "Payloads of all leaf pages, without borders taken off, against the same windows \
                 of int16 through zlib at level 6 after horizontal differencing: `flate2` on \
                 miniz_oxide, in this program; and, where GDAL is installed, {CHECKED_PAGES} pages \
                 spread over the map as its tiles with DEFLATE, ZLEVEL=6, PREDICTOR=2. The target \
                 is held against GDAL's where it is there."
            ),
            "Decoding: one thread, payloads in memory, into pages of f32 as the cache has them; \
             seconds of that thread. Texels are counted as int16, 2 bytes each, and beside that as \
             the f32 they become."
                .to_owned(),
        ],
        tables: vec![Table { title: "Leaves".to_owned(), head, rows }],
        targets,
        data: json!(data),
    })
}

/// What was found of one dataset.
struct Figures {
    leaves: usize,
    stored: u64,
    deflated: u64,
    /// Pages compared with GDAL's, and their bytes over GDAL's.
    over_gdal: Option<(usize, f64)>,
    decode_bytes_per_s: Spread,
}

impl Figures {
    fn of(setting: &Setting, archive: &Archive) -> Result<Self, Failure> {
        let finest = archive.description().grid.pyramid().finest();
        let mut leaves = archive.entries()?;
        leaves.retain(|entry| entry.page.level == finest);
        let sizes: Vec<(u64, u64)> = leaves
            .par_iter()
            .map(|leaf| {
                let stored = archive.payload(leaf).map_err(io::Error::other)?.len() as u64;
                let samples = samples(archive, leaf)?;
                Ok((stored, deflated_bytes(samples, side(archive))?))
            })
            .collect::<io::Result<_>>()?;
        Ok(Self {
            leaves: leaves.len(),
            stored: sizes.iter().map(|&(stored, _)| stored).sum(),
            deflated: sizes.iter().map(|&(_, deflated)| deflated).sum(),
            over_gdal: over_gdal(setting, archive, &leaves)?,
            decode_bytes_per_s: decode_speed(setting, archive, &leaves)?,
        })
    }

    fn row(&self, name: &str) -> Vec<String> {
        let each = |bytes: u64| format!("{:.1}", bytes as f64 / 1024.0 / self.leaves.max(1) as f64);
        let over_gdal = self.over_gdal.map(|(pages, ratio)| format!("{ratio:.3} ({pages} pages)"));
        let speed = self.decode_bytes_per_s;
        vec![
            name.to_owned(),
            self.leaves.to_string(),
            each(self.stored),
            each(self.deflated),
            format!("{:.3}", self.stored as f64 / self.deflated as f64),
            over_gdal.unwrap_or_else(|| "–".to_owned()),
            format!("{:.2}", speed.median / 1e9),
            format!("{:.2}", 2.0 * speed.median / 1e9),
        ]
    }

    fn json(&self, name: &str) -> Value {
        json!({
            "raster": name,
            "leaves": self.leaves,
            "stored_bytes": self.stored,
            "deflate_bytes": self.deflated,
            "deflate_backend": "miniz_oxide",
            "gdal_pages": self.over_gdal.map(|(pages, _)| pages),
            "over_gdal": self.over_gdal.map(|(_, ratio)| ratio),
            "decode_int16_bytes_per_s": self.decode_bytes_per_s,
        })
    }
}

fn side(archive: &Archive) -> usize {
    archive.description().grid.pyramid().page_side() as usize
}

/// The texels of a leaf as the raster had them.
fn samples(archive: &Archive, leaf: &PageEntry) -> io::Result<Vec<i16>> {
    let page: Page = archive.page(leaf).map_err(io::Error::other)?;
    let Texels::Height(heights) = page.texels() else {
        return Err(io::Error::other("heights are no colors"));
    };
    let quantum = archive.description().quantum;
    let sample = |&height: &f32| {
        let index = if height.is_nan() { None } else { quantum.index(height) };
        index.and_then(|index| i16::try_from(index).ok()).unwrap_or(MISSING)
    };
    Ok(heights.iter().map(sample).collect())
}

/// Bytes of a page through horizontal differencing and zlib.
fn deflated_bytes(samples: Vec<i16>, side: usize) -> io::Result<u64> {
    let mut bytes: Vec<u8> = samples.iter().flat_map(|sample| sample.to_le_bytes()).collect();
    bytes.chunks_exact_mut(2 * side).for_each(|row| difference(row, 1, 2));
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::new(6));
    encoder.write_all(&bytes)?;
    Ok(encoder.finish()?.len() as u64)
}

/// Our bytes over GDAL's for pages spread over the map; `None` without GDAL.
fn over_gdal(
    setting: &Setting,
    archive: &Archive,
    leaves: &[PageEntry],
) -> Result<Option<(usize, f64)>, Failure> {
    let step = leaves.len().div_ceil(CHECKED_PAGES).max(1);
    let chosen: Vec<&PageEntry> = leaves.iter().step_by(step).collect();
    let (raw, to) = (setting.work().join("pages.bil"), setting.work().join("pages.tif"));
    let side = side(archive);
    let Some(mut command) = setting.peers.deflate_pages(&raw, side, &to) else { return Ok(None) };
    let (mut stored, mut bytes) = (0, Vec::new());
    for leaf in &chosen {
        stored += archive.payload(leaf)?.len() as u64;
        bytes.extend(samples(archive, leaf)?.iter().flat_map(|sample| sample.to_le_bytes()));
    }
    fs::write(&raw, bytes)?;
    let lines = side * chosen.len();
    let header = format!(
        "ENVI\nsamples = {side}\nlines = {lines}\nbands = 1\nheader offset = 0\ndata type = 2\n\
         interleave = bsq\nbyte order = 0\n"
    );
    fs::write(raw.with_extension("hdr"), header)?;
    let run = command.output()?;
    if !run.status.success() {
        let said = String::from_utf8_lossy(&run.stderr).trim().to_owned();
        output::say(format!("gdal_translate: {said}"));
        return Ok(None);
    }
    let theirs = tile_bytes(&to)?;
    for file in [&raw, &raw.with_extension("hdr"), &to] {
        fs::remove_file(file)?;
    }
    Ok(Some((chosen.len(), stored as f64 / theirs as f64)))
}

/// Bytes of all tiles of a TIFF.
fn tile_bytes(path: &Path) -> Result<u64, Failure> {
    let mut decoder = Decoder::new(io::BufReader::new(fs::File::open(path)?))?;
    Ok(decoder.get_tag_u64_vec(Tag::TileByteCounts)?.iter().sum())
}

/// Bytes of int16 texels that one thread decodes in a second of its own.
fn decode_speed(
    setting: &Setting,
    archive: &Archive,
    leaves: &[PageEntry],
) -> Result<Spread, Failure> {
    let (mut held, mut payloads) = (0, Vec::new());
    for leaf in leaves {
        let payload = archive.payload(leaf)?;
        held += payload.len() as u64;
        if held > HELD_BYTES {
            break;
        }
        payloads.push((leaf, payload));
    }
    let texels = (payloads.len() * side(archive) * side(archive)) as f64;
    let mut speeds = Vec::new();
    // The first run warms up.
    for run in 0..=setting.runs {
        let (clock, cpu) = (Instant::now(), thread_cpu_s());
        let mut rounds = 0.0;
        while rounds == 0.0 || clock.elapsed().as_secs_f64() < LEAST_S {
            for (leaf, payload) in &payloads {
                std::hint::black_box(archive.decode(leaf, payload)?);
            }
            rounds += 1.0;
        }
        let wall = clock.elapsed().as_secs_f64();
        let seconds = match (cpu, thread_cpu_s()) {
            (Some(before), Some(after)) if after > before => after - before,
            _ => wall,
        };
        if run > 0 {
            speeds.push(2.0 * rounds * texels / seconds);
        }
    }
    let spread = Spread::of(speeds.into_iter());
    Ok(spread.expect("there is at least one run"))
}
