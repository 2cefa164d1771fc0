//! A page from its window: bounds, figures and payload.

use std::sync::Arc;

use areoid_formats::address::{Level, PageAddress};
use areoid_formats::archive::{ConstantTexel, Description, PageEntry, Payload};
use areoid_formats::bound::{self, Cells, Child, Span};
use areoid_formats::codec::{self, EncodeError};
use areoid_formats::page::Kind;

use crate::tile::Window;

/// A finished page: what is written of it, and what its parent needs to know.
#[derive(Debug)]
pub struct Whole {
    /// All but the place of its payload.
    pub entry: PageEntry,
    /// Stored bytes; empty for a constant page.
    pub payload: Vec<u8>,
    /// Rows and columns of the interior inside the outline.
    pub size: (usize, usize),
    /// The page with its border.
    pub window: Window,
    /// Intervals of `R_l − R_L`, one a channel; `None` if they are all zero.
    pub cells: Option<Vec<Cells>>,
}

/// A child and its place: (0 upper or 1 lower, 0 left or 1 right).
pub type PlacedWhole = ((usize, usize), Arc<Whole>);

/// Finishes `page` from its window and its children.
///
/// # Errors
///
/// [`EncodeError`] if a texel cannot be stored, which rounding to the step rules out.
pub fn finish(
    description: &Description,
    page: PageAddress,
    window: Window,
    children: &[PlacedWhole],
) -> Result<Whole, EncodeError> {
    let pyramid = description.grid.pyramid();
    let size = pyramid.interior_size(page);
    let size = (size.0 as usize, size.1 as usize);

    let cells = if page.level == pyramid.finest() {
        leaf_cells(&window, size)
    } else {
        Some(parent_cells(&window, size, children, pyramid.finest()))
    };
    let own_bound = cells.iter().flatten().map(Cells::bound).fold(0.0, f32::max);
    // Two reconstructions of codes are no farther apart than the codes themselves.
    let own_bound = match description.kind {
        Kind::Height => own_bound,
        Kind::Color | Kind::Normal => own_bound.min(255.0),
    };
    let figures = Figures::of(&window, size, children);
    let (stored, payload) = encode(description, &window)?;
    let entry = PageEntry {
        page,
        payload: stored,
        valid_fraction: figures.valid_fraction,
        min: figures.min,
        max: figures.max,
        lowest: figures.lowest,
        highest: figures.highest,
        bound: children.iter().map(|(_, child)| child.entry.bound).fold(own_bound, f32::max),
        source_error: figures.source_error,
        full: window.coverage.is_none(),
    };
    Ok(Whole { entry, payload, size, window, cells })
}

fn leaf_cells(window: &Window, size: (usize, usize)) -> Option<Vec<Cells>> {
    let original = window.original.as_ref()?;
    let channels = window.planes.iter().zip(original);
    Some(
        channels
            .map(|(stored, original)| {
                let stored = bound::Window { side: window.side, texels: stored, span: None };
                bound::leaf_cells(stored, original, size)
            })
            .collect(),
    )
}

fn parent_cells(
    window: &Window,
    size: (usize, usize),
    children: &[PlacedWhole],
    finest: Level,
) -> Vec<Cells> {
    (0..window.planes.len())
        .map(|channel| {
            // A leaf's own texels before rounding are its span.
            let originals: Vec<Option<Span>> = children
                .iter()
                .map(|(_, child)| {
                    let original = &child.window.original.as_ref()?[channel];
                    Some(Span { least: original.clone(), greatest: original.clone() })
                })
                .collect();
            let children: Vec<Child<'_>> = children
                .iter()
                .zip(&originals)
                .map(|(((row, col), child), original)| {
                    let window = &child.window;
                    let spans = window.spans.as_ref().map(|spans| &spans[channel]);
                    let texels = &window.planes[channel];
                    let span = spans.or(original.as_ref());
                    Child {
                        row: *row,
                        col: *col,
                        window: bound::Window { side: window.side, texels, span },
                        size: child.size,
                        finest: child.entry.page.level == finest,
                        cells: child.cells.as_ref().map(|cells| &cells[channel]),
                    }
                })
                .collect();
            let texels = &window.planes[channel];
            let span = window.spans.as_ref().map(|spans| &spans[channel]);
            bound::parent_cells(bound::Window { side: window.side, texels, span }, size, &children)
        })
        .collect()
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
    fn of(window: &Window, (rows, cols): (usize, usize), children: &[PlacedWhole]) -> Self {
        let invalid = (1..=rows)
            .map(|row| &window.planes[0][row * window.side + 1..][..cols])
            .map(|row| row.iter().filter(|texel| texel.is_nan()).count())
            .sum::<usize>();
        let total = (rows * cols) as f64;
        #[expect(clippy::cast_possible_truncation, reason = "a share in f32")]
        let valid_fraction = ((total - invalid as f64) / total) as f32;

        // `min` and `max` pass NaN over.
        let own = |margin: usize| {
            let mut range = (f32::NAN, f32::NAN);
            for plane in &window.planes {
                for row in 1 - margin..=rows + margin {
                    let row = &plane[row * window.side + 1 - margin..][..cols + 2 * margin];
                    range = row.iter().fold(range, |(low, high), &t| (low.min(t), high.max(t)));
                }
            }
            range
        };
        if children.is_empty() {
            let (min, max) = own(0);
            let (lowest, highest) = own(1);
            let source_error = source_error(window, (rows, cols));
            return Self { valid_fraction, min, max, lowest, highest, source_error };
        }
        let fold = |start: f32, pick: fn(f32, f32) -> f32, field: fn(&PageEntry) -> f32| {
            children.iter().map(|(_, child)| field(&child.entry)).fold(start, pick)
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

/// The largest |stored − original| in the interior.
fn source_error(window: &Window, (rows, cols): (usize, usize)) -> f32 {
    let Some(original) = &window.original else { return 0.0 };
    let mut largest = 0.0_f64;
    for (stored, original) in window.planes.iter().zip(original) {
        for row in 1..=rows {
            let at = row * window.side + 1;
            let pairs = stored[at..][..cols].iter().zip(&original[at..][..cols]);
            let error = pairs.map(|(s, o)| (f64::from(*s) - f64::from(*o)).abs());
            largest = error.fold(largest, f64::max);
        }
    }
    bound::rounded_up(largest)
}

fn encode(description: &Description, window: &Window) -> Result<(Payload, Vec<u8>), EncodeError> {
    if let Some(texel) = constant(description.kind, window) {
        return Ok((Payload::Constant(texel), Vec::new()));
    }
    let coverage = window.coverage.as_deref();
    let payload = match description.kind {
        Kind::Height => {
            codec::encode_heights(&window.planes[0], coverage, window.side, description.quantum)?
        }
        Kind::Color | Kind::Normal => {
            let texels: Vec<[u8; 3]> = (0..window.planes[0].len())
                .map(|at| std::array::from_fn(|channel| code(window.planes[channel][at])))
                .collect();
            codec::encode_colors(&texels, coverage, window.side)?
        }
    };
    Ok((Payload::Record { offset: 0, length: 0, checksum: 0 }, payload))
}

/// The one texel of a window that has no other, all of it fully covered.
fn constant(kind: Kind, window: &Window) -> Option<ConstantTexel> {
    if window.coverage.is_some() {
        return None;
    }
    let same = |plane: &Vec<f32>| plane.iter().all(|t| t.to_bits() == plane[0].to_bits());
    window.planes.iter().all(same).then(|| match kind {
        Kind::Height => ConstantTexel(window.planes[0][0].to_le_bytes()),
        Kind::Color | Kind::Normal => {
            let [red, green, blue] = std::array::from_fn(|channel| code(window.planes[channel][0]));
            ConstantTexel([red, green, blue, 0])
        }
    })
}

/// A color plane's texel as a code; black where it is invalid.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "codes are 0 to 255")]
fn code(texel: f32) -> u8 {
    texel as u8
}
