//! Planets in memory for the tests: pyramids of pages from a function of place.

use std::sync::Arc;

use areoid_cache::{DatasetInfo, ResidentPage, Selection};
use areoid_formats::address::{Level, PageAddress, PageKey};
use areoid_formats::archive::{PageEntry, Payload};
use areoid_formats::geodesy::Geographic;
use areoid_formats::grid::{Grid, Outline, TexelPoint};
use areoid_formats::page::{Kind, Page, Texels};
use areoid_formats::projection::Crs;
use glam::DVec3;

/// A texel: a value and its coverage, 0 for none.
pub(crate) type Sample = ([f32; 3], u8);

/// One level of a dataset, without borders.
struct LevelImage {
    width: usize,
    texels: Vec<Sample>,
}

/// The dataset of a native grid.
pub(crate) fn dataset(
    name: &str,
    kind: Kind,
    crs: Crs,
    outline: Outline,
    page_side: u32,
    priority: i32,
) -> DatasetInfo {
    let grid = Grid::from_outline(crs, outline, page_side).unwrap().grid;
    DatasetInfo { name: name.to_owned(), group: None, kind, grid, priority }
}

/// A selection of every page of every dataset, whose texels are `sample(place)`.
#[derive(Default)]
pub(crate) struct Planet {
    datasets: Vec<DatasetInfo>,
    pages: Vec<Arc<ResidentPage>>,
}

impl Planet {
    /// Adds a dataset by what its finest texels hold at their centers.
    pub(crate) fn add(&mut self, info: DatasetInfo, sample: impl Fn(Geographic) -> Sample) {
        let grid = info.grid.clone();
        let finest = grid.pyramid().finest();
        self.add_texels(info, |row, col| {
            let center = TexelPoint { x: f64::from(col) + 0.5, y: f64::from(row) + 0.5 };
            grid.geographic_from_texel(finest, center).map_or(([0.0; 3], 0), &sample)
        });
    }

    /// Adds a dataset by the rows and columns of its finest texels.
    pub(crate) fn add_texels(&mut self, info: DatasetInfo, texel: impl Fn(u32, u32) -> Sample) {
        let dataset = self.datasets.len();
        let pyramid = info.grid.pyramid();
        let size = pyramid.size(pyramid.finest()).unwrap();
        let leaf = (0..size.height).flat_map(|row| (0..size.width).map(move |col| (row, col)));
        let texels: Vec<Sample> = leaf.map(|(row, col)| texel(row, col)).collect();
        let valid = || texels.iter().filter(|(_, coverage)| *coverage > 0);
        let lowest = valid().map(|(value, _)| value[0]).fold(f32::INFINITY, f32::min);
        let highest = valid().map(|(value, _)| value[0]).fold(f32::NEG_INFINITY, f32::max);

        let mut image = LevelImage { width: size.width as usize, texels };
        for level in pyramid.levels().rev() {
            if level != pyramid.finest() {
                image = halved(&image, pyramid.size(level).unwrap().height as usize);
            }
            let (rows, cols) = pyramid.pages(level).unwrap();
            for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
                let address = PageAddress::new(level, row, col);
                let Some(page) = window(&info, &image, address) else { continue };
                let checksum = PageKey::from(address).get() ^ (dataset as u64) << 40;
                let entry = PageEntry {
                    page: address,
                    payload: Payload::Record { offset: 0, length: 1, checksum },
                    valid_fraction: 1.0,
                    min: lowest,
                    max: highest,
                    lowest,
                    highest,
                    // Nobody proves it: coarser pages are never as good.
                    bound: if level == pyramid.finest() { 0.0 } else { 1e9 },
                    source_error: 0.0,
                    full: page.coverage().is_none(),
                };
                self.pages.push(Arc::new(ResidentPage { dataset, entry, page }));
            }
        }
        self.datasets.push(info);
    }

    /// Everything, or what `keep` leaves of it.
    pub(crate) fn selection(&self, keep: impl Fn(&ResidentPage) -> bool) -> Selection {
        let mut pages: Vec<_> = self.pages.iter().filter(|page| keep(page)).cloned().collect();
        pages.sort_by_key(|page| (page.entry.page.level, page.dataset));
        Selection {
            generation: 1,
            scene: 1,
            datasets: self.datasets.clone().into(),
            wanted: pages.len(),
            pages,
            missing: 0,
            roots: Vec::new(),
            beneath: Vec::new(),
            failed: Vec::new(),
            tolerance_px: 1.0,
            error_px: 1.0,
            visited: 0,
            culled: 0,
        }
    }
}

fn halved(image: &LevelImage, height: usize) -> LevelImage {
    let rows = image.texels.len() / image.width;
    let width = image.width.div_ceil(2);
    let mut texels = Vec::with_capacity(width * height);
    for row in 0..height {
        for col in 0..width {
            let children = [(0, 0), (0, 1), (1, 0), (1, 1)]
                .map(|(down, right)| (2 * row + down, 2 * col + right));
            let valid: Vec<Sample> = children
                .into_iter()
                .filter(|&(row, col)| row < rows && col < image.width)
                .map(|(row, col)| image.texels[row * image.width + col])
                .filter(|&(_, coverage)| coverage > 0)
                .collect();
            let count = valid.len().max(1) as f32;
            let mean = [0, 1, 2]
                .map(|channel| valid.iter().map(|(value, _)| value[channel]).sum::<f32>() / count);
            let coverage = valid.iter().map(|&(_, coverage)| u32::from(coverage)).sum::<u32>();
            let coverage = coverage.div_ceil(valid.len().max(1) as u32);
            texels.push((mean, u8::try_from(coverage).unwrap()));
        }
    }
    LevelImage { width, texels }
}

fn window(info: &DatasetInfo, image: &LevelImage, address: PageAddress) -> Option<Page> {
    let pyramid = info.grid.pyramid();
    let side = i64::from(pyramid.page_side());
    let interior = i64::from(pyramid.interior());
    let (top, left) =
        (i64::from(address.row) * interior - 1, i64::from(address.col) * interior - 1);
    let level: Level = address.level;
    let mut texels = Vec::new();
    for row in top..top + side {
        let extended = pyramid.extended_row(level, row);
        for col in left..left + side {
            let col = pyramid.extended_col(level, col, extended.turned) as usize;
            let at = |row: u32| image.texels[row as usize * image.width + col];
            let ((near, coverage), (far, far_coverage)) = (at(extended.row), at(extended.next));
            let weight = extended.weight as f32;
            let value = [0, 1, 2].map(|c| near[c] + (far[c] - near[c]) * weight);
            texels.push((value, if weight == 0.0 { coverage } else { coverage.min(far_coverage) }));
        }
    }
    if texels.iter().all(|&(_, coverage)| coverage == 0) {
        return None;
    }
    let full = texels.iter().all(|&(_, coverage)| coverage == u8::MAX);
    let coverage = (!full).then(|| texels.iter().map(|&(_, coverage)| coverage).collect());
    let values = if info.kind == Kind::Height {
        let height = |&(value, coverage): &Sample| if coverage > 0 { value[0] } else { f32::NAN };
        Texels::Height(texels.iter().map(height).collect())
    } else {
        Texels::Color(
            texels.iter().map(|(value, _)| value.map(|code| code.round() as u8)).collect(),
        )
    };
    Some(Page::new(pyramid.page_side() as usize, values, coverage))
}

mod air;

mod arrivals;

pub(crate) mod caster;

mod composition;

mod cracks;

mod footprints;

mod jitter;

mod layer;

mod pops;

mod functions;

mod reference;

mod twins;

mod views;

pub(crate) mod worlds;

/// The device that all tests share: a pipeline's first use is slow.
pub(crate) fn gpu() -> &'static crate::Gpu {
    static GPU: std::sync::OnceLock<crate::Gpu> = std::sync::OnceLock::new();
    GPU.get_or_init(|| {
        layer::listen();
        crate::Gpu::headless().unwrap()
    })
}

/// Whether `AREOID_SOAK` asks for more than continuous integration has time for.
pub(crate) fn soak() -> bool {
    std::env::var_os("AREOID_SOAK").is_some()
}

/// Which rounds of a test to do: the first few; as a soak all, or the part that `AREOID_SOAK` names, as in
/// `4500..6000`.
pub(crate) fn rounds(few: usize, all: usize) -> std::ops::Range<usize> {
    let Ok(asked) = std::env::var("AREOID_SOAK") else { return 0..few };
    let part = asked.split_once("..").map(|(from, to)| (from.parse().ok(), to.parse().ok()));
    match part {
        Some((Some(from), Some(to))) => from..to,
        _ => 0..all,
    }
}

/// Random numbers of a fixed seed: xorshift.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    pub(crate) fn direction(&mut self) -> DVec3 {
        let z = 2.0 * self.next() - 1.0;
        let turn = std::f64::consts::TAU * self.next();
        let r = (1.0 - z * z).sqrt();
        DVec3::new(r * turn.cos(), r * turn.sin(), z)
    }
}
