//! A page under construction: its interior first, its border when its neighbors are there.
//!
//! ```text
//!   Raw     a leaf as read: texels, and how far each is valid
//!   Tile    a page whose coverage is settled: what its neighbors' borders and its parent look at
//!   Border  what shows outside the interior, copied from the neighbors
//! ```
//!
//! All have the layout of the finished page, `side * side` texels row-major, so that a page is read,
//! averaged, bordered and encoded where it lies. A page cut by the outline has its border right
//! after the last texel and the extension beyond.

use std::ops::Range;

use areoid_formats::address::PageAddress;
use areoid_formats::bound::Span;
use areoid_formats::codec::Quantum;
use areoid_formats::page::LEAST_VALID_WEIGHT;
use areoid_formats::pyramid::Pyramid;

use crate::texel::{Planes, Texel};

/// A leaf as read. Outside the interior nothing is said.
#[derive(Clone, Debug, PartialEq)]
pub struct Raw {
    /// Texels; NaN or 0 where invalid.
    pub planes: Planes,
    /// Alpha beside each texel, or `None` where all of the interior is opaque and valid. 0 is
    /// invalid.
    pub alpha: Option<Vec<u8>>,
}

/// A page whose coverage is settled.
#[derive(Clone, Debug, PartialEq)]
pub struct Tile<S> {
    /// Texels along a side, border included.
    pub side: usize,
    /// Rows of the interior inside the outline.
    pub rows: usize,
    /// Columns of the interior inside the outline.
    pub cols: usize,
    /// Stored texels, one plane a channel; [`Texel::INVALID`] where invalid.
    pub planes: Vec<Vec<S>>,
    /// The texels before they were rounded to the step, where that changed any (leaves only).
    pub original: Option<Vec<Vec<S>>>,
    /// Coverage beside each texel, or `None` where all are fully covered.
    pub coverage: Option<Vec<u8>>,
    /// The finest texels under each texel, a plane a channel; `None` for leaves, and where the
    /// source cannot have holes.
    pub spans: Option<Vec<Span<S>>>,
    /// Valid texels of the finished page, border included, and the finest under them are not less
    /// or greater than these.
    pub range: (S, S),
}

impl<S: Texel> Tile<S> {
    /// A page without a valid texel.
    #[must_use]
    pub fn blank(side: usize, (rows, cols): (usize, usize)) -> Self {
        let planes = vec![vec![S::INVALID; side * side]; S::CHANNELS];
        let coverage = Some(vec![0; side * side]);
        let (original, spans, range) = (None, None, S::NOTHING);
        Self { side, rows, cols, planes, original, coverage, spans, range }
    }

    /// Where a texel of the interior lies.
    #[must_use]
    pub fn at(&self, row: usize, col: usize) -> usize {
        (row + 1) * self.side + col + 1
    }

    /// Where the texels of a row of the interior lie.
    #[must_use]
    pub fn row(&self, row: usize) -> Range<usize> {
        self.at(row, 0)..self.at(row, self.cols)
    }

    /// Puts the border around the interior. The planes that only one of the two has are made.
    pub fn close(&mut self, border: &Border<S>) {
        let (side, rows, cols) = (self.side, self.rows, self.cols);
        let count = side * side;
        let place = |plane: &mut [S], from: &[S]| scatter(plane, from, (side, rows, cols));
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
            scatter(coverage, &border.coverage, (side, rows, cols));
        }
    }
}

/// A span with no finest texel anywhere.
pub(crate) fn nothing<S: Texel>(count: usize) -> Span<S> {
    let (least, greatest) = S::NOTHING;
    Span { least: vec![least; count], greatest: vec![greatest; count] }
}

/// The parts of a page's rows outside its interior, from the top left.
pub(crate) fn outside(
    (side, rows, cols): (usize, usize, usize),
) -> impl Iterator<Item = (usize, Range<usize>)> {
    (0..side).flat_map(move |row| {
        let inner = (1..=rows).contains(&row);
        let parts = if inner { [0..1, cols + 1..side] } else { [0..side, 0..0] };
        parts.map(|part| (row, part))
    })
}

fn scatter<T: Copy>(plane: &mut [T], from: &[T], shape: (usize, usize, usize)) {
    let mut rest = from;
    for (row, part) in outside(shape) {
        let (here, behind) = rest.split_at(part.len());
        plane[row * shape.0..][part].copy_from_slice(here);
        rest = behind;
    }
}

/// What shows outside a page's interior, in the order of [`outside`].
#[derive(Debug)]
pub struct Border<S> {
    planes: Vec<Vec<S>>,
    original: Option<Vec<Vec<S>>>,
    coverage: Vec<u8>,
    spans: Option<Vec<Span<S>>>,
}

/// Where the texels of a border come from: runs of consecutive texels of one tile.
struct Run {
    /// First column of the window.
    to: usize,
    /// Column of tiles.
    tile: u32,
    /// First column in the tile's interior.
    from: usize,
    length: usize,
}

impl Run {
    /// The part of the run in columns `cols` of the window.
    fn within(&self, cols: &Range<usize>) -> Option<Self> {
        let start = self.to.max(cols.start);
        let end = (self.to + self.length).min(cols.end);
        let from = self.from + (start - self.to);
        (start < end).then(|| Self { to: start, tile: self.tile, from, length: end - start })
    }
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
        let shape = (side, rows as usize, cols as usize);
        let sources = pyramid.sources(page, Pyramid::BORDER);
        let present = || sources.iter().filter_map(|&source| tile_of(source));
        let rounded = present().any(|tile| tile.original.is_some());
        let spanned = present().any(|tile| tile.spans.is_some());
        let empty = || vec![Vec::new(); S::CHANNELS];
        let mut border = Self {
            planes: empty(),
            original: rounded.then(empty),
            coverage: Vec::new(),
            spans: spanned.then(|| vec![nothing(0); S::CHANNELS]),
        };

        let (straight, turned) = (runs(pyramid, page, false), runs(pyramid, page, true));
        let top = i64::from(page.row * interior) - i64::from(Pyramid::BORDER);
        for (row, part) in outside(shape) {
            let source = pyramid.extended_row(page.level, top + row as i64);
            let runs = if source.turned { &turned } else { &straight };
            let tile_at = |row: u32, run: &Run| {
                let tile = tile_of(PageAddress::new(page.level, row / interior, run.tile));
                (tile, (row % interior) as usize)
            };
            for run in runs.iter().filter_map(|run| run.within(&part)) {
                let (tile, row) = tile_at(source.row, &run);
                if source.weight != 0.0 {
                    let (next, next_row) = tile_at(source.next, &run);
                    let taps = [(tile, row, 1.0 - source.weight), (next, next_row, source.weight)];
                    border.blend(&run, taps, quantum);
                } else {
                    border.copy(&run, tile, row);
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

    fn copy(&mut self, run: &Run, tile: Option<&Tile<S>>, row: usize) {
        let Some(tile) = tile else {
            (0..run.length).for_each(|_| self.invalid());
            return;
        };
        let from = tile.at(row, run.from)..tile.at(row, run.from + run.length);
        for (channel, plane) in tile.planes.iter().enumerate() {
            self.planes[channel].extend_from_slice(&plane[from.clone()]);
            if let Some(original) = &mut self.original {
                let plane = tile.original.as_ref().map_or(plane, |original| &original[channel]);
                original[channel].extend_from_slice(&plane[from.clone()]);
            }
            if let (Some(spans), Some(tile_spans)) = (&mut self.spans, &tile.spans) {
                let (span, source) = (&mut spans[channel], &tile_spans[channel]);
                span.least.extend_from_slice(&source.least[from.clone()]);
                span.greatest.extend_from_slice(&source.greatest[from.clone()]);
            }
        }
        match &tile.coverage {
            Some(codes) => self.coverage.extend_from_slice(&codes[from]),
            None => self.coverage.resize(self.coverage.len() + run.length, u8::MAX),
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
    fn blend(&mut self, run: &Run, taps: [(Option<&Tile<S>>, usize, f64); 2], quantum: Quantum) {
        for place in 0..run.length {
            let present = taps.iter().filter_map(|&(tile, row, weight)| {
                let tile = tile?;
                let from = tile.at(row, run.from + place);
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
