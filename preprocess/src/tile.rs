//! Pages under construction: interiors, and windows cut from them.
//!
//! ```text
//!   Raw      a leaf as read: texels, and how far each is valid
//!   Tile     an interior whose coverage is settled: what its neighbors and its parent look at
//!   Window   a page with its border, cut from the tiles it draws on
//! ```
//!
//! Texels are f32 planes, one a channel, also for colors, whose codes f32 holds exactly: one code
//! path serves all kinds, and its loops vectorize.

use std::collections::HashMap;
use std::sync::Arc;

use areoid_formats::address::PageAddress;
use areoid_formats::bound::Span;
use areoid_formats::codec::Quantum;
use areoid_formats::page::Kind;
use areoid_formats::pyramid::Pyramid;

/// A leaf's interior as read, cut at the outline.
#[derive(Clone, Debug, PartialEq)]
pub struct Raw {
    /// Rows inside the outline.
    pub rows: usize,
    /// Columns inside the outline.
    pub cols: usize,
    /// One plane a channel, row-major; NaN where invalid.
    pub planes: Vec<Vec<f32>>,
    /// Alpha beside each texel, or `None` where all are opaque and valid. 0 is invalid.
    pub alpha: Option<Vec<u8>>,
}

/// An interior whose coverage is settled, cut at the outline. At least one texel is valid.
#[derive(Clone, Debug, PartialEq)]
pub struct Tile {
    /// Rows inside the outline.
    pub rows: usize,
    /// Columns inside the outline.
    pub cols: usize,
    /// Stored texels, one plane a channel; NaN where invalid.
    pub planes: Vec<Vec<f32>>,
    /// The texels before they were rounded to the step, where that changed any (leaves only).
    pub original: Option<Vec<Vec<f32>>>,
    /// Coverage beside each texel, or `None` where all are fully covered.
    pub coverage: Option<Vec<u8>>,
    /// The finest texels under each texel, a plane a channel; `None` for leaves.
    pub spans: Option<Vec<Span>>,
}

/// A page with its border, `side * side` texels.
#[derive(Clone, Debug, PartialEq)]
pub struct Window {
    /// Texels along a side.
    pub side: usize,
    /// Stored texels, one plane a channel; NaN where invalid.
    pub planes: Vec<Vec<f32>>,
    /// See [`Tile::original`].
    pub original: Option<Vec<Vec<f32>>>,
    /// Coverage beside each texel, or `None` where all are fully covered.
    pub coverage: Option<Vec<u8>>,
    /// See [`Tile::spans`]; only where a texel of the window is invalid.
    pub spans: Option<Vec<Span>>,
}

/// Tiles by page; a page without a valid texel is present as `None`.
pub type Tiles = HashMap<PageAddress, Option<Arc<Tile>>>;

impl Tile {
    /// A planeful of invalid texels.
    pub(crate) fn blank(count: usize, channels: usize) -> Vec<Vec<f32>> {
        vec![vec![f32::NAN; count]; channels]
    }
}

/// Where the texels of a window come from: runs of consecutive texels of one tile.
struct Run {
    /// First column of the window.
    to: usize,
    /// Column of tiles.
    tile: u32,
    /// First column in the tile.
    from: usize,
    length: usize,
}

/// The columns of a window as runs.
fn runs(pyramid: &Pyramid, page: PageAddress, turned: bool) -> Vec<Run> {
    let interior = pyramid.interior();
    let start = i64::from(page.col * interior) - i64::from(Pyramid::BORDER);
    let mut runs: Vec<Run> = Vec::new();
    for to in 0..pyramid.page_side() {
        let col = pyramid.extended_col(page.level, start + i64::from(to), turned);
        let (tile, from) = (col / interior, (col % interior) as usize);
        match runs.last_mut() {
            Some(run) if run.tile == tile && run.from + run.length == from => run.length += 1,
            _ => runs.push(Run { to: to as usize, tile, from, length: 1 }),
        }
    }
    runs
}

/// Cuts the window of `page` out of `tiles`; `None` if it has no valid texel.
///
/// # Panics
///
/// If a tile that the window draws on is not among `tiles`: the schedule sees to it.
#[must_use]
pub fn window(
    pyramid: &Pyramid,
    page: PageAddress,
    tiles: &Tiles,
    kind: Kind,
    quantum: Quantum,
) -> Option<Window> {
    let side = pyramid.page_side() as usize;
    let interior = pyramid.interior();
    let sources: Vec<_> = pyramid
        .sources(page, Pyramid::BORDER)
        .into_iter()
        .map(|source| tiles.get(&source).expect("what a window draws on is settled"))
        .collect();
    let present = || sources.iter().filter_map(|tile| tile.as_deref());
    present().next()?;

    let channels = kind.channels();
    let lossy = present().any(|tile| tile.original.is_some());
    let mut window = Window {
        side,
        planes: Tile::blank(side * side, channels),
        original: lossy.then(|| Tile::blank(side * side, channels)),
        coverage: Some(vec![0; side * side]),
        spans: None,
    };
    let finest = page.level == pyramid.finest();
    let mut spans = (!finest).then(|| vec![nothing(side * side); channels]);

    let (straight, turned) = (runs(pyramid, page, false), runs(pyramid, page, true));
    let top = i64::from(page.row * interior) - i64::from(Pyramid::BORDER);
    for to_row in 0..side {
        let source = pyramid.extended_row(page.level, top + to_row as i64);
        let runs = if source.turned { &turned } else { &straight };
        let blends = source.weight != 0.0;
        for run in runs {
            let tile_at = |row: u32| {
                let address = PageAddress::new(page.level, row / interior, run.tile);
                let tile = tiles.get(&address).expect("what a window draws on is settled");
                (tile.as_deref(), (row % interior) as usize)
            };
            let to = to_row * side + run.to;
            let (tile, row) = tile_at(source.row);
            if blends {
                let (next, next_row) = tile_at(source.next);
                let taps = [(tile, row, 1.0 - source.weight), (next, next_row, source.weight)];
                blend_run(&mut window, &mut spans, to, run, taps, quantum);
            } else if let Some(tile) = tile {
                copy_run(&mut window, &mut spans, to, run, tile, row);
            }
        }
    }

    let coverage = window.coverage.take().expect("it was made above");
    if coverage.iter().all(|&code| code == 0) {
        return None;
    }
    if coverage.contains(&0) {
        window.spans = spans;
    }
    if coverage.iter().any(|&code| code != u8::MAX) {
        window.coverage = Some(coverage);
    }
    Some(window)
}

/// A span with no finest texel anywhere.
pub(crate) fn nothing(count: usize) -> Span {
    Span { least: vec![f32::INFINITY; count], greatest: vec![f32::NEG_INFINITY; count] }
}

fn copy_run(
    window: &mut Window,
    spans: &mut Option<Vec<Span>>,
    to: usize,
    run: &Run,
    tile: &Tile,
    row: usize,
) {
    let from = row * tile.cols + run.from;
    let (to, from) = (to..to + run.length, from..from + run.length);
    for (channel, plane) in tile.planes.iter().enumerate() {
        window.planes[channel][to.clone()].copy_from_slice(&plane[from.clone()]);
        if let Some(original) = &mut window.original {
            let plane = tile.original.as_ref().map_or(plane, |original| &original[channel]);
            original[channel][to.clone()].copy_from_slice(&plane[from.clone()]);
        }
        if let (Some(spans), Some(tile_spans)) = (spans.as_mut(), &tile.spans) {
            let (span, source) = (&mut spans[channel], &tile_spans[channel]);
            span.least[to.clone()].copy_from_slice(&source.least[from.clone()]);
            span.greatest[to.clone()].copy_from_slice(&source.greatest[from.clone()]);
        }
    }
    let coverage = window.coverage.as_mut().expect("it is there while the window is cut");
    match &tile.coverage {
        Some(codes) => coverage[to].copy_from_slice(&codes[from]),
        None => coverage[to].fill(u8::MAX),
    }
}

/// Two rows of a post-registered grid's coarser level, mirrored over a pole between texels: their
/// weighted mean, on the step.
fn blend_run(
    window: &mut Window,
    spans: &mut Option<Vec<Span>>,
    to: usize,
    run: &Run,
    taps: [(Option<&Tile>, usize, f64); 2],
    quantum: Quantum,
) {
    for place in 0..run.length {
        let to = to + place;
        let present = taps.iter().filter_map(|&(tile, row, weight)| {
            let tile = tile?;
            let from = row * tile.cols + run.from + place;
            let code = tile.coverage.as_ref().map_or(u8::MAX, |codes| codes[from]);
            (code != 0).then_some((tile, from, code, weight))
        });
        let total: f64 = present.clone().map(|(.., weight)| weight).sum();
        if total < areoid_formats::page::LEAST_VALID_WEIGHT {
            continue;
        }
        for channel in 0..window.planes.len() {
            let sum: f64 = present
                .clone()
                .map(|(tile, from, _, weight)| weight * f64::from(tile.planes[channel][from]))
                .sum();
            let texel = on_step(sum / total, quantum, window.planes.len());
            window.planes[channel][to] = texel;
            if let Some(original) = &mut window.original {
                original[channel][to] = texel;
            }
            for (tile, from, ..) in present.clone() {
                if let (Some(spans), Some(tile_spans)) = (spans.as_mut(), &tile.spans) {
                    let (span, source) = (&mut spans[channel], &tile_spans[channel]);
                    span.least[to] = span.least[to].min(source.least[from]);
                    span.greatest[to] = span.greatest[to].max(source.greatest[from]);
                }
            }
        }
        let code: f64 = present.map(|(.., code, weight)| weight * f64::from(code)).sum();
        let coverage = window.coverage.as_mut().expect("it is there while the window is cut");
        #[expect(clippy::cast_possible_truncation, reason = "clamped to codes")]
        #[expect(clippy::cast_sign_loss, reason = "clamped to codes")]
        {
            coverage[to] = code.round_ties_even().clamp(1.0, 255.0) as u8;
        }
    }
}

/// `value` as it is stored: on the step for heights, a whole code for colors.
pub(crate) fn on_step(value: f64, quantum: Quantum, channels: usize) -> f32 {
    if channels == 1 {
        // A mean lies between texels that are on the step.
        quantum.round(value).expect("a mean of stored texels can be stored")
    } else {
        #[expect(clippy::cast_possible_truncation, reason = "codes are 0 to 255")]
        let code = value.round_ties_even() as f32;
        code
    }
}
