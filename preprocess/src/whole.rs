//! A finished page: bounds, figures and payload.

use std::cell::RefCell;
use std::ops::Range;

use areoid_formats::address::PageAddress;
use areoid_formats::archive::{Description, MipRule, PageEntry, Payload};
use areoid_formats::bound::{self, Cells, Child, Family, Span};
use areoid_formats::codec::{EncodeError, Scratch};
use areoid_formats::lanes::{self, greatest, least};

use crate::texel::Texel;
use crate::tile::{self, Tile};

/// A finished page: what is written of it, and what its parent needs to know.
#[derive(Debug)]
pub struct Whole<S: Texel> {
    /// All but the place of its payload.
    pub entry: PageEntry,
    /// Stored bytes; empty for a constant page.
    pub payload: Vec<u8>,
    /// Intervals of `R_l − R_L`; `None` if they are all zero.
    pub cells: Option<Cells<S::Cell>>,
    /// What [`Tile::range`] is now.
    pub range: (S, S),
}

/// A finished child.
#[derive(Clone, Copy, Debug)]
pub struct WholeChild<'a, S: Texel> {
    /// 0 for the upper children, 1 for the lower.
    pub row: usize,
    /// 0 for the left children, 1 for the right.
    pub col: usize,
    /// The page with its border.
    pub tile: &'a Tile<S>,
    /// Its intervals.
    pub cells: Option<&'a Cells<S::Cell>>,
    /// Its entry.
    pub entry: &'a PageEntry,
}

/// Whether pages are encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Payloads {
    /// They are.
    Made,
    /// They stand in the archive already: payloads stay empty.
    Unneeded,
}

/// Finishes `page` from its texels, border included, and its children; `source_error` is that of a
/// leaf whose texels before rounding are not the source's pixels.
///
/// # Errors
///
/// [`EncodeError`] if a texel cannot be stored, which rounding to the step rules out.
pub fn finish<S: Texel>(
    description: &Description,
    page: PageAddress,
    tile: &Tile<S>,
    children: &[WholeChild<'_, S>],
    source_error: Option<f32>,
    payloads: Payloads,
) -> Result<Whole<S>, EncodeError> {
    let finest = page.level == description.grid.pyramid().finest();
    let interior = if finest {
        interior_range(tile, 0)
    } else {
        // Means lie between what is below; a low-pass looks farther.
        let own = match description.mip {
            MipRule::Mean => S::NOTHING,
            MipRule::Kaiser | MipRule::Unknown => interior_range(tile, 0),
        };
        children.iter().map(|child| child.tile.range).fold(own, union)
    };
    let range = union(interior, border_range(tile));
    debug_assert_eq!(union(interior_range(tile, 0), range), range, "{page} is out of its range");
    let cells = if finest {
        leaf_cells(tile)
    } else {
        let ranges = children.iter().map(|child| child.tile.range).fold(range, union);
        Some(parent_cells(description, page, tile, children, ranges))
    };
    let own_bound = cells.as_ref().map_or(0.0, Cells::bound::<S>);
    let figures = Figures::of(tile, children, (interior, range), source_error);
    let (stored, payload) = match payloads {
        Payloads::Made => encode(description, tile)?,
        Payloads::Unneeded => (NO_PAYLOAD, Vec::new()),
    };
    let entry = PageEntry {
        page,
        payload: stored,
        valid_fraction: figures.valid_fraction,
        min: figures.min,
        max: figures.max,
        lowest: figures.lowest,
        highest: figures.highest,
        bound: children.iter().map(|child| child.entry.bound).fold(own_bound, f32::max),
        source_error: figures.source_error,
        full: tile.coverage.is_none(),
    };
    Ok(Whole { entry, payload, cells, range })
}

/// The intervals of a leaf: zero but where its texels were rounded, which only heights are.
fn leaf_cells<S: Texel>(tile: &Tile<S>) -> Option<Cells<S::Cell>> {
    let original = &tile.original.as_ref()?[0];
    Some(bound::leaf_cells(window(tile, 0, None), original, (tile.rows, tile.cols)))
}

fn parent_cells<S: Texel>(
    description: &Description,
    page: PageAddress,
    tile: &Tile<S>,
    children: &[WholeChild<'_, S>],
    range: (S, S),
) -> Cells<S::Cell> {
    let children_are_leaves = page.level.finer() == description.grid.pyramid().finest();
    // A leaf's own texels before rounding are its span.
    let span = |plane: &Vec<S>| Span { least: plane.clone(), greatest: plane.clone() };
    let originals: Vec<Option<Vec<Span<S>>>> = children
        .iter()
        .map(|child| Some(child.tile.original.as_ref()?.iter().map(span).collect()))
        .collect();
    let family = |channel: usize| {
        let children = children.iter().zip(&originals).map(|(child, original)| {
            let spans = child.tile.spans.as_ref().or(original.as_ref());
            Child {
                row: child.row,
                col: child.col,
                window: window(child.tile, channel, spans.map(|spans| &spans[channel])),
                size: (child.tile.rows, child.tile.cols),
                finest: children_are_leaves,
                cells: child.cells,
            }
        });
        Family { parent: window(tile, channel, None), children: children.collect() }
    };
    let channels: Vec<Family<'_, S>> = (0..S::CHANNELS).map(family).collect();
    bound::parent_cells(&channels, (tile.rows, tile.cols), range)
}

fn window<'a, S>(
    tile: &'a Tile<S>,
    channel: usize,
    span: Option<&'a Span<S>>,
) -> bound::Window<'a, S> {
    let (texels, coverage) = (&tile.planes[channel][..], tile.coverage.as_deref());
    bound::Window { side: tile.side, texels, coverage, span }
}

/// The figures of a page's entry.
struct Figures {
    valid_fraction: f32,
    min: f32,
    max: f32,
    lowest: f32,
    highest: f32,
    source_error: f32,
}

impl Figures {
    /// Of a page; of a leaf with the ranges of its interior and of all of it.
    fn of<S: Texel>(
        tile: &Tile<S>,
        children: &[WholeChild<'_, S>],
        (interior, all): ((S, S), (S, S)),
        source_error: Option<f32>,
    ) -> Self {
        let total = tile.rows * tile.cols;
        let valid = tile.coverage.as_ref().map_or(total, |codes| {
            let row = |row: usize| codes[tile.row(row)].iter().map(|&code| u32::from(code != 0));
            (0..tile.rows).map(|at| row(at).sum::<u32>() as usize).sum()
        });
        #[expect(clippy::cast_possible_truncation, reason = "a share in f32")]
        let valid_fraction = (valid as f64 / total as f64) as f32;
        if children.is_empty() {
            // What is beyond the texel beside the outline is no border of the page's points.
            let is_cut = tile.rows.min(tile.cols) < tile.side - 2;
            let beside = if is_cut { interior_range(tile, 1) } else { all };
            let (min, max) = ends(interior);
            let (lowest, highest) = ends(beside);
            let source_error = source_error.unwrap_or_else(|| rounding(tile));
            return Self { valid_fraction, min, max, lowest, highest, source_error };
        }
        let fold = |start: f32, pick: fn(f32, f32) -> f32, field: fn(&PageEntry) -> f32| {
            children.iter().map(|child| field(child.entry)).fold(start, pick)
        };
        Self {
            valid_fraction,
            min: fold(f32::NAN, f32::min, |entry| entry.min),
            max: fold(f32::NAN, f32::max, |entry| entry.max),
            lowest: fold(f32::NAN, f32::min, |entry| entry.lowest),
            highest: fold(f32::NAN, f32::max, |entry| entry.highest),
            source_error: fold(0.0, f32::max, |entry| entry.source_error),
        }
    }
}

fn union<S: Texel>(one: (S, S), other: (S, S)) -> (S, S) {
    (least(one.0, other.0), greatest(one.1, other.1))
}

/// Both ends as an entry has them; NaN where there is nothing between.
fn ends<S: Texel>((least, greatest): (S, S)) -> (f32, f32) {
    if least > greatest { (f32::NAN, f32::NAN) } else { (in_meters(least), in_meters(greatest)) }
}

/// A texel in meters, or in codes.
#[expect(clippy::cast_possible_truncation, reason = "texels are f32 or smaller")]
fn in_meters<S: Texel>(texel: S) -> f32 {
    Into::<f64>::into(texel) as f32
}

/// Least and greatest valid texel of the interior and `margin` texels around it.
fn interior_range<S: Texel>(tile: &Tile<S>, margin: usize) -> (S, S) {
    let row = |row: usize| row * tile.side + 1 - margin..row * tile.side + 1 + tile.cols + margin;
    range_of(tile, (1 - margin..=tile.rows + margin).map(row))
}

/// Least and greatest valid texel outside the interior, and under those texels.
fn border_range<S: Texel>(tile: &Tile<S>) -> (S, S) {
    let parts = || {
        let parts = tile::outside((tile.side, tile.rows, tile.cols));
        parts.map(|(row, part)| row * tile.side + part.start..row * tile.side + part.end)
    };
    let finest = tile.spans.iter().flatten().flat_map(|span| {
        parts().map(|part| {
            let low = lanes::extremes(&span.least[part.clone()], S::NOTHING);
            let high = lanes::extremes(&span.greatest[part], S::NOTHING);
            (low.0, high.1)
        })
    });
    finest.fold(range_of(tile, parts()), union)
}

fn range_of<S: Texel>(tile: &Tile<S>, parts: impl Iterator<Item = Range<usize>>) -> (S, S) {
    let mut range = S::NOTHING;
    for part in parts {
        for plane in &tile.planes {
            let texels = &plane[part.clone()];
            let of_part = match &tile.coverage {
                None => lanes::extremes(texels, S::NOTHING),
                Some(codes) => lanes::covered_extremes(texels, &codes[part.clone()], S::NOTHING),
            };
            range = union(range, of_part);
        }
    }
    range
}

/// The largest |stored − original| in the interior.
fn rounding<S: Texel>(tile: &Tile<S>) -> f32 {
    let Some(original) = &tile.original else { return 0.0 };
    let mut largest = 0.0_f64;
    for (stored, original) in tile.planes.iter().zip(original) {
        for row in 0..tile.rows {
            let pairs = stored[tile.row(row)].iter().zip(&original[tile.row(row)]);
            let error = pairs.map(|(&s, &o)| (Into::<f64>::into(s) - o.into()).abs());
            largest = error.fold(largest, f64::max);
        }
    }
    bound::rounded_up(largest)
}

/// The place of a payload before the writer fills it in.
const NO_PAYLOAD: Payload = Payload::Record { offset: 0, length: 0, checksum: 0 };

fn encode<S: Texel>(
    description: &Description,
    tile: &Tile<S>,
) -> Result<(Payload, Vec<u8>), EncodeError> {
    thread_local! {
        static SCRATCH: RefCell<(Scratch, Vec<u8>)> = RefCell::default();
    }
    if tile.coverage.is_none() && tile.planes.iter().all(|plane| is_constant(plane)) {
        let texels: Vec<S> = tile.planes.iter().map(|plane| plane[0]).collect();
        return Ok((Payload::Constant(S::constant(&texels)), Vec::new()));
    }
    SCRATCH.with_borrow_mut(|(scratch, payload)| {
        S::encode(&tile.planes, tile.coverage.as_deref(), description, scratch, payload)?;
        // A copy of the right size: what waits to be written is not the buffer's capacity.
        Ok((NO_PAYLOAD, payload.as_slice().to_vec()))
    })
}

/// Whether all texels are the same, to the bit.
fn is_constant<S: Texel>(plane: &[S]) -> bool {
    let first = bytemuck::bytes_of(&plane[0]);
    plane.iter().all(|texel| bytemuck::bytes_of(texel) == first)
}
