//! What shows outside a page's interior: copied from the pages around it, and put in its place once
//! no page looks at this one any more.

use std::ops::Range;

use areoid_formats::address::PageAddress;
use areoid_formats::codec::Quantum;
use areoid_formats::pyramid::{ExtendedRow, Pyramid};

use crate::gather::{Gathered, Tiles, cols_of};
use crate::texel::Texel;
use crate::tile::{Tile, nothing};

/// What shows outside a page's interior, piece by piece.
#[derive(Debug)]
pub struct Border<S> {
    pieces: Vec<Piece>,
    gathered: Gathered<S>,
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
        let (rows, cols) = pyramid.interior_size(page);
        let (rows, cols) = (rows as usize, cols as usize);
        let sources = pyramid.sources(page, Pyramid::BORDER);
        let present = || sources.iter().filter_map(|&source| tile_of(source));
        let rounded = present().any(|tile| tile.original.is_some());
        let spanned = present().any(|tile| tile.spans.is_some());
        let gathered = Gathered::new(rounded, spanned);
        let mut border = Self { pieces: Vec::new(), gathered };

        let tiles = Tiles { pyramid, level: page.level, tile_of, quantum };
        let left = i64::from(page.col * pyramid.interior()) - i64::from(Pyramid::BORDER);
        let within = left..left + i64::from(pyramid.page_side());
        let [straight, turned] =
            [false, true].map(|turned| cols_of(pyramid, page.level, within.clone(), turned));
        let (whole, sides) = ([0..side, 0..0], [0..1, cols + 1..side]);
        let sections = [(0..1, &whole), (1..rows + 1, &sides), (rows + 1..side, &whole)];
        for (section, parts) in sections {
            for run in rows_of(pyramid, page, section) {
                let runs = if run.source.turned { &turned } else { &straight };
                for cols in parts.iter().flat_map(|part| runs.iter().filter_map(|c| c.within(part)))
                {
                    border.gathered.take(&tiles, run.source, &cols, run.length);
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
        self.gathered.coverage.iter().all(|&code| code == 0)
    }
}

impl<S: Texel> Tile<S> {
    /// Puts the border around the interior. The planes that only one of the two has are made.
    pub fn close(&mut self, border: &Border<S>) {
        let side = self.side;
        let count = side * side;
        let Border { pieces, gathered } = border;
        let place = |plane: &mut [S], from: &[S]| scatter(plane, from, side, pieces);
        if let Some(from) = &gathered.original {
            let original = self.original.get_or_insert_with(|| self.planes.clone());
            original.iter_mut().zip(from).for_each(|(plane, from)| place(plane, from));
        }
        for (plane, from) in self.planes.iter_mut().zip(&gathered.planes) {
            place(plane, from);
        }
        if let Some(from) = &gathered.spans {
            let spans = self.spans.get_or_insert_with(|| vec![nothing(count); S::CHANNELS]);
            for (span, from) in spans.iter_mut().zip(from) {
                place(&mut span.least, &from.least);
                place(&mut span.greatest, &from.greatest);
            }
        }
        if self.coverage.is_some() || gathered.coverage.iter().any(|&code| code != u8::MAX) {
            let coverage = self.coverage.get_or_insert_with(|| vec![u8::MAX; count]);
            scatter(coverage, &gathered.coverage, side, pieces);
        }
    }
}

/// Puts what was gathered for each piece in its place.
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
