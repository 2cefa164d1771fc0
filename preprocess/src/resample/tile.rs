//! Where the texels of a small square of the target lie in the source.

/// Texels along a side of a target tile.
pub const TILE: usize = 64;

/// A rectangle of target texels, at most [`TILE`] a side.
///
/// Rows and columns are those of the extended level: they may begin at -1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TargetTile {
    /// First row.
    pub row: i64,
    /// First column.
    pub col: i64,
    /// Rows.
    pub rows: usize,
    /// Columns.
    pub cols: usize,
}

/// Source positions of a tile's texel centers, row-major with the tile's own columns.
///
/// # Units
///
/// Source pixels, their centers at whole numbers.
///
/// # Domain
///
/// Not wrapped: over a tile they are continuous, so they may lie beyond the source's columns.
#[derive(Clone, Debug, Default)]
pub struct Coords {
    /// Columns.
    pub u: Vec<f64>,
    /// Rows, downward.
    pub v: Vec<f64>,
    /// Least and greatest column, least and greatest row: of all texels, or a little more.
    pub range: [f64; 4],
}

/// How far a step of one texel goes in the source, and how far the source's own detail reaches;
/// constant within a tile.
///
/// # Units
///
/// Source pixels, along its columns (`u`) and its rows (`v`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Footprint {
    /// Length of a texel's footprint along the source's columns.
    pub texel_u: f64,
    /// Along its rows.
    pub texel_v: f64,
    /// Pixels across the coarser of the source's two spacings, along its columns: more than 1 where
    /// an equirectangular raster is oversampled in longitude.
    pub detail_u: f64,
    /// Along its rows.
    pub detail_v: f64,
}
