//! What shows outside a page's interior: copied from the pages around it, and put in its place once
//! no page looks at this one any more.

use std::ops::Range;

use areoid_formats::address::PageAddress;
use areoid_formats::bound::Span;
use areoid_formats::codec::Quantum;
use areoid_formats::page::LEAST_VALID_WEIGHT;
use areoid_formats::pyramid::{ExtendedRow, Pyramid};

use crate::texel::Texel;
use crate::tile::{Tile, nothing};

/// What shows outside a page's interior, piece by piece.
#[derive(Debug)]
pub struct Border<S> {
    pieces: Vec<Piece>,
    planes: Vec<Vec<S>>,
    original: Option<Vec<Vec<S>>>,
    coverage: Vec<u8>,
    spans: Option<Vec<Span<S>>>,
}

/// A rectangle of the window that comes from one tile, row by row.
#[derive(Clone, Debug)]
struct Piece {
    rows: Range<usize>,
    cols: Range<usize>,
}

/// Consecutive rows of a window that come from consecutive rows of a row of tiles.
struct Rows {
    to: usize,
    length: usize,
    source: ExtendedRow,
}

/// Consecutive columns of a window that come from consecutive columns of a column of tiles.
struct Cols {
    to: usize,
    length: usize,
    /// Column of tiles.
    tile: u32,
    /// First column in the tile's interior.
    from: usize,
}

impl Cols {
    /// What lies in columns `cols` of the window.
    fn within(&self, cols: &Range<usize>) -> Option<Self> {
        let start = self.to.max(cols.start);
        let end = (self.to + self.length).min(cols.end);
        let from = self.from + (start - self.to);
        (start < end).then(|| Self { to: start, length: end - start, tile: self.tile, from })
    }
}

/// Rows `within` of a page's window.
fn rows_of(pyramid: &Pyramid, page: PageAddress, within: Range<usize>) -> Vec<Rows> {
    let interior = pyramid.interior();
    let top = i64::from(page.row * interior) - i64::from(Pyramid::BORDER);
    let mut runs: Vec<Rows> = Vec::new();
    for to in within {
        let source = pyramid.extended_row(page.level, top + to as i64);
        let follows = |run: &Rows| {
            let offset = u32::try_from(run.length).expect("no longer than a page");
            let expected = ExtendedRow {
                row: run.source.row + offset,
                next: run.source.next + offset,
                ..run.source
            };
            let next_tile = source.row.is_multiple_of(interior);
            source.weight == 0.0 && source == expected && !next_tile
        };
        match runs.last_mut() {
            Some(run) if follows(run) => run.length += 1,
            _ => runs.push(Rows { to, length: 1, source }),
        }
    }
    runs
}

/// The columns of a page's window, in rows that are turned or not.
fn cols_of(pyramid: &Pyramid, page: PageAddress, turned: bool) -> Vec<Cols> {
    let interior = pyramid.interior();
    let left = i64::from(page.col * interior) - i64::from(Pyramid::BORDER);
    let mut runs: Vec<Cols> = Vec::new();
    for to in 0..pyramid.page_side() {
        let col = pyramid.extended_col(page.level, left + i64::from(to), turned);
        let (tile, from) = (col / interior, (col % interior) as usize);
        match runs.last_mut() {
            Some(run) if run.tile == tile && run.from + run.length == from => run.length += 1,
            _ => runs.push(Cols { to: to as usize, length: 1, tile, from }),
        }
    }
    runs
}

impl<S: Texel> Border<S> {
    /// The border of `page`, from what `tile_of` says of it and its neighbors: `None` for one
    /// without a valid texel.
    #[must_use]
    pub fn around<'a>(
        pyramid: &Pyramid,
        page: PageAddress,
        tile_of: impl Fn(PageAddress) -> Option<&'a Tile<S>>,
        quantum: Quantum,
    ) -> Self {
        let side = pyramid.page_side() as usize;
        let interior = pyramid.interior();
        let (rows, cols) = pyramid.interior_size(page);
        let (rows, cols) = (rows as usize, cols as usize);
        let sources = pyramid.sources(page, Pyramid::BORDER);
        let present = || sources.iter().filter_map(|&source| tile_of(source));
        let rounded = present().any(|tile| tile.original.is_some());
        let spanned = present().any(|tile| tile.spans.is_some());
        let empty = || vec![Vec::new(); S::CHANNELS];
        let mut border = Self {
            pieces: Vec::new(),
            planes: empty(),
            original: rounded.then(empty),
            coverage: Vec::new(),
            spans: spanned.then(|| vec![nothing(0); S::CHANNELS]),
        };

        let (straight, turned) = (cols_of(pyramid, page, false), cols_of(pyramid, page, true));
        let (whole, sides) = ([0..side, 0..0], [0..1, cols + 1..side]);
        let sections = [(0..1, &whole), (1..rows + 1, &sides), (rows + 1..side, &whole)];
        for (section, parts) in sections {
            for run in rows_of(pyramid, page, section) {
                let row = |row: u32| (row / interior, (row % interior) as usize);
                let (tile_row, from) = row(run.source.row);
                let runs = if run.source.turned { &turned } else { &straight };
                for cols in parts.iter().flat_map(|part| runs.iter().filter_map(|c| c.within(part)))
                {
                    let tile_at =
                        |tile_row| tile_of(PageAddress::new(page.level, tile_row, cols.tile));
                    let tile = tile_at(tile_row);
                    if run.source.weight == 0.0 {
                        border.copy(tile, from, &cols, run.length);
                    } else {
                        let (next_row, next) = row(run.source.next);
                        let weight = run.source.weight;
                        let taps = [(tile, from, 1.0 - weight), (tile_at(next_row), next, weight)];
                        border.blend(&cols, taps, quantum);
                    }
                    border.pieces.push(Piece {
                        rows: run.to..run.to + run.length,
                        cols: cols.to..cols.to + cols.length,
                    });
                }
            }
        }
        border
    }

    /// Whether no texel of it is valid.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.coverage.iter().all(|&code| code == 0)
    }

    /// Appends texels of `rows` rows from `row` of a tile's interior on.
    fn copy(&mut self, tile: Option<&Tile<S>>, row: usize, cols: &Cols, rows: usize) {
        let Some(tile) = tile else {
            (0..rows * cols.length).for_each(|_| self.invalid());
            return;
        };
        let part = (tile.at(row, cols.from), tile.side, (rows, cols.length));
        for (channel, plane) in tile.planes.iter().enumerate() {
            gather(plane, part, &mut self.planes[channel]);
            if let Some(original) = &mut self.original {
                let plane = tile.original.as_ref().map_or(plane, |original| &original[channel]);
                gather(plane, part, &mut original[channel]);
            }
            if let (Some(spans), Some(tile_spans)) = (&mut self.spans, &tile.spans) {
                let (span, source) = (&mut spans[channel], &tile_spans[channel]);
                gather(&source.least, part, &mut span.least);
                gather(&source.greatest, part, &mut span.greatest);
            }
        }
        match &tile.coverage {
            Some(codes) => gather(codes, part, &mut self.coverage),
            None => self.coverage.resize(self.coverage.len() + rows * cols.length, u8::MAX),
        }
    }

    fn invalid(&mut self) {
        let planes = self.planes.iter_mut().chain(self.original.iter_mut().flatten());
        planes.for_each(|plane| plane.push(S::INVALID));
        for span in self.spans.iter_mut().flatten() {
            span.least.push(S::NOTHING.0);
            span.greatest.push(S::NOTHING.1);
        }
        self.coverage.push(0);
    }

    /// Two rows of a post-registered grid's coarser level, mirrored over a pole between texels:
    /// their weighted mean, on the step.
    fn blend(&mut self, cols: &Cols, taps: [(Option<&Tile<S>>, usize, f64); 2], quantum: Quantum) {
        for place in 0..cols.length {
            let present = taps.iter().filter_map(|&(tile, row, weight)| {
                let tile = tile?;
                let from = tile.at(row, cols.from + place);
                let code = tile.coverage.as_ref().map_or(u8::MAX, |codes| codes[from]);
                (code != 0).then_some((tile, from, code, weight))
            });
            let total: f64 = present.clone().map(|(.., weight)| weight).sum();
            if total < LEAST_VALID_WEIGHT {
                self.invalid();
                continue;
            }
            for channel in 0..S::CHANNELS {
                let texels = present
                    .clone()
                    .map(|(tile, from, _, weight)| weight * tile.planes[channel][from].into());
                let texel = S::stored(texels.sum::<f64>() / total, quantum);
                self.planes[channel].push(texel);
                if let Some(original) = &mut self.original {
                    original[channel].push(texel);
                }
                if let Some(spans) = &mut self.spans {
                    let (mut least, mut greatest) = S::NOTHING;
                    for (tile, from, ..) in present.clone() {
                        if let Some(source) = tile.spans.as_ref().map(|spans| &spans[channel]) {
                            let (low, high) = (source.least[from], source.greatest[from]);
                            least = if low < least { low } else { least };
                            greatest = if high > greatest { high } else { greatest };
                        }
                    }
                    spans[channel].least.push(least);
                    spans[channel].greatest.push(greatest);
                }
            }
            let code: f64 = present.map(|(.., code, weight)| weight * f64::from(code)).sum();
            #[expect(clippy::cast_possible_truncation, reason = "clamped to codes")]
            #[expect(clippy::cast_sign_loss, reason = "clamped to codes")]
            self.coverage.push(code.round_ties_even().clamp(1.0, 255.0) as u8);
        }
    }
}

impl<S: Texel> Tile<S> {
    /// Puts the border around the interior. The planes that only one of the two has are made.
    pub fn close(&mut self, border: &Border<S>) {
        let side = self.side;
        let count = side * side;
        let place = |plane: &mut [S], from: &[S]| scatter(plane, from, side, &border.pieces);
        if let Some(from) = &border.original {
            let original = self.original.get_or_insert_with(|| self.planes.clone());
            original.iter_mut().zip(from).for_each(|(plane, from)| place(plane, from));
        }
        for (plane, from) in self.planes.iter_mut().zip(&border.planes) {
            place(plane, from);
        }
        if let Some(from) = &border.spans {
            let spans = self.spans.get_or_insert_with(|| vec![nothing(count); S::CHANNELS]);
            for (span, from) in spans.iter_mut().zip(from) {
                place(&mut span.least, &from.least);
                place(&mut span.greatest, &from.greatest);
            }
        }
        if self.coverage.is_some() || border.coverage.iter().any(|&code| code != u8::MAX) {
            let coverage = self.coverage.get_or_insert_with(|| vec![u8::MAX; count]);
            scatter(coverage, &border.coverage, side, &border.pieces);
        }
    }
}

/// Appends a part of a plane of `side` columns: so many rows and columns from `start` on.
fn gather<T: Copy>(
    plane: &[T],
    (start, side, (rows, cols)): (usize, usize, (usize, usize)),
    to: &mut Vec<T>,
) {
    let rows = (start..).step_by(side).take(rows);
    if cols == 1 {
        to.extend(rows.map(|at| plane[at]));
    } else {
        rows.for_each(|at| to.extend_from_slice(&plane[at..at + cols]));
    }
}

/// Puts what [`gather`] found for each piece in its place.
fn scatter<T: Copy>(plane: &mut [T], from: &[T], side: usize, pieces: &[Piece]) {
    let mut rest = from;
    for Piece { rows, cols } in pieces {
        let (here, behind) = rest.split_at(rows.len() * cols.len());
        rest = behind;
        if cols.len() == 1 {
            let places = (rows.start * side + cols.start..).step_by(side);
            places.zip(here).for_each(|(at, &texel)| plane[at] = texel);
        } else {
            for (row, texels) in rows.clone().zip(here.chunks_exact(cols.len())) {
                plane[row * side..][cols.clone()].copy_from_slice(texels);
            }
        }
    }
}
