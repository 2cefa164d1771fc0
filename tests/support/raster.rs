//! Rasters made up for tests: samples, the outline they fill, and archives built from them in
//! memory.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;
use std::time::Duration;

use areoid_formats::address::PageAddress;
use areoid_formats::archive::{Archive, Description, MipRule, Source};
use areoid_formats::body::Body;
use areoid_formats::codec::Quantum;
use areoid_formats::grid::{Grid, GridError, Outline};
use areoid_formats::page::Kind;
use areoid_formats::projection::{Crs, Projection};
use areoid_preprocess::build::{Leaves, Means, Proceed, build};
use areoid_preprocess::raster::RasterError;
use areoid_preprocess::scratch::Scratch;
use areoid_preprocess::texel::Planes;
use areoid_preprocess::tile::Raw;

use super::levels::{Edge, Shape};

/// Samples, and where they lie: degrees on Mars.
#[derive(Clone, Debug)]
pub(crate) struct Raster {
    pub(crate) shape: Shape,
    pub(crate) outline: Outline,
    /// One plane a channel, row-major; NaN where there is none.
    pub(crate) planes: Vec<Vec<f32>>,
    /// Step and offset that heights are stored on.
    pub(crate) step: Option<(f64, f64)>,
    /// What three planes are.
    pub(crate) codes: Codes,
    /// How coarser texels are made.
    pub(crate) mip: MipRule,
}

/// What codes stand for, and so how they are averaged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Codes {
    Colors,
    Normals,
}

/// How a raster lies on the globe, without its size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Place {
    Region,
    /// All around, between two parallels.
    Belt,
    /// All around, with the poles touched as said.
    Globe(Edge, Edge),
}

impl Raster {
    /// A raster of heights at `place`: `height(row, col)` is NaN where there is none.
    pub(crate) fn new(
        place: Place,
        (rows, cols): (usize, usize),
        step: Option<(f64, f64)>,
        mut height: impl FnMut(usize, usize) -> f32,
    ) -> Self {
        let plane = (0..rows * cols).map(|at| height(at / cols, at % cols)).collect();
        let (wraps, north, south) = match place {
            Place::Region => (false, Edge::Repeat, Edge::Repeat),
            Place::Belt => (true, Edge::Repeat, Edge::Repeat),
            Place::Globe(north, south) => (true, north, south),
        };
        let shape = Shape { width: cols, height: rows, wraps, north, south };
        Self {
            shape,
            outline: outline(shape),
            planes: vec![plane],
            step,
            codes: Codes::Colors,
            mip: MipRule::Mean,
        }
    }

    /// The grid, or why there is none.
    pub(crate) fn grid(&self, page_side: u32) -> Result<Grid, GridError> {
        let crs = Crs::new(Projection::Geographic, Body::parse("mars").unwrap().ellipsoid);
        Ok(Grid::from_outline(crs, self.outline, page_side)?.grid)
    }

    /// The archive that the builder makes of it.
    pub(crate) fn archive(&self, page_side: u32) -> Archive {
        Archive::open(Box::new(self.archive_bytes(page_side))).unwrap()
    }

    pub(crate) fn archive_bytes(&self, page_side: u32) -> Vec<u8> {
        let kind = match (self.planes.len(), self.codes) {
            (1, _) => Kind::Height,
            (_, Codes::Colors) => Kind::Color,
            (_, Codes::Normals) => Kind::Normal,
        };
        let quantum =
            self.step.map_or(Quantum::NONE, |(step, offset)| Quantum::new(step, offset).unwrap());
        let description = Description {
            dataset: "made-up".to_owned(),
            kind,
            body: Body::parse("mars").unwrap(),
            grid: self.grid(page_side).unwrap(),
            quantum,
            priority: 0,
            feather_texels: 32,
            // Small units make the schedule meet its own edges in small rasters too.
            unit_pages: 2,
            resampling: None,
            mip: self.mip,
            source: Source::default(),
        };
        let (interior, whole) = (page_side as usize - 2, is_whole(self));
        let leaves = RasterLeaves { raster: self, interior, whole };
        // Without any memory for them, pages go through the scratch file.
        let scratch = Scratch::new(tempfile::tempfile().unwrap(), &[]).unwrap();
        let frontier_bytes = if self.shape.width.is_multiple_of(2) { 0 } else { 1 << 30 };
        let means = Means {
            scratch: Arc::new(scratch),
            frontier_bytes,
            pages_together: 8,
            note_every: Duration::from_secs(3600),
        };
        let (bytes, _) =
            build(&description, &leaves, Vec::new(), &means, None, |_| Proceed::Yes).unwrap();
        bytes
    }
}

/// Pixels of a degree or so, the whole turn or the poles where the shape says so.
fn outline(shape: Shape) -> Outline {
    let (cols, rows) = (shape.width as f64, shape.height as f64);
    let past = |edge| if edge == Edge::PoleOnPosts { 0.5 } else { 0.0 };
    let (pixel_y, top) = match (shape.north, shape.south) {
        (Edge::Repeat, Edge::Repeat) => (40.0 / rows, 20.0),
        (Edge::Repeat, south) => {
            let pixel = 100.0 / (rows - past(south));
            (pixel, 10.0)
        }
        (north, Edge::Repeat) => {
            let pixel = 100.0 / (rows - past(north));
            (pixel, 90.0 + past(north) * pixel)
        }
        (north, south) => {
            let pixel = 180.0 / (rows - past(north) - past(south));
            (pixel, 90.0 + past(north) * pixel)
        }
    };
    let pixel_x = if shape.wraps { 360.0 / cols } else { 0.25 };
    Outline {
        origin: [if shape.wraps { -180.0 } else { 10.0 }, top],
        pixel_size: [pixel_x, pixel_y],
        width: u32::try_from(shape.width).unwrap(),
        height: u32::try_from(shape.height).unwrap(),
    }
}

struct RasterLeaves<'a> {
    raster: &'a Raster,
    interior: usize,
    whole: bool,
}

/// Whether all texels are whole meters that fit in 16 bits.
fn is_whole(raster: &Raster) -> bool {
    let negative_zero = (-0.0_f32).to_bits();
    let whole = |t: &f32| t.trunc() == *t && t.abs() < 32768.0 && t.to_bits() != negative_zero;
    raster.planes.len() == 1 && raster.planes.iter().flatten().all(|t| whole(t) || t.is_nan())
}

impl Leaves for RasterLeaves<'_> {
    fn is_whole(&self) -> bool {
        self.whole
    }

    fn read(&self, page: PageAddress) -> Result<Option<Raw>, RasterError> {
        let Shape { width, height, .. } = self.raster.shape;
        let (top, left) = (page.row as usize * self.interior, page.col as usize * self.interior);
        let (rows, cols) = ((height - top).min(self.interior), (width - left).min(self.interior));
        let side = self.interior + 2;
        let place = |row: usize, col: usize| (row + 1) * side + col + 1;
        let (mut planes, mut alpha) = (vec![], vec![0; side * side]);
        for plane in &self.raster.planes {
            let mut cut = vec![f32::NAN; side * side];
            for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
                let texel = plane[(top + row) * width + left + col];
                cut[place(row, col)] = texel;
                alpha[place(row, col)] = if texel.is_nan() { 0 } else { 255 };
            }
            planes.push(cut);
        }
        let holes = (0..rows).any(|row| alpha[place(row, 0)..place(row, cols)].contains(&0));
        if alpha.iter().all(|&alpha| alpha == 0) {
            return Ok(None);
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "codes")]
        let codes = |plane: &Vec<f32>| plane.iter().map(|&code| code as u8).collect();
        #[expect(clippy::cast_possible_truncation, reason = "whole heights")]
        let heights = |plane: &Vec<f32>| plane.iter().map(|&height| height as i16).collect();
        let planes = match &planes[..] {
            [plane] if self.whole => Planes::WholeHeight(heights(plane)),
            [red, green, blue] => Planes::Color([codes(red), codes(green), codes(blue)]),
            _ => Planes::Height(planes.swap_remove(0)),
        };
        Ok(Some(Raw { planes, alpha: holes.then_some(alpha) }))
    }
}

/// A small generator of random numbers: tests are the same on every machine.
#[derive(Clone, Debug)]
pub(crate) struct Random(pub(crate) u64);

impl Random {
    /// The next number of the sequence.
    ///
    /// # References
    ///
    /// `SplitMix64`: Steele, Lea, Flood, "Fast splittable pseudorandom number generators", 2014.
    pub(crate) fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// In [0, 1).
    pub(crate) fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// A field on the sphere made of spherical harmonics of degree 8 at most: polynomials in the
/// coordinates of the unit vector. Meters, within ±6000.
pub(crate) fn planet(longitude_rad: f64, latitude_rad: f64) -> f64 {
    let (sin, cos) = (latitude_rad.sin(), latitude_rad.cos());
    let harmonic = |order: i32, power: i32, phase: f64| {
        cos.powi(order) * sin.powi(power) * (f64::from(order) * longitude_rad + phase).cos()
    };
    2500.0 * harmonic(0, 1, 0.0)
        + 900.0 * harmonic(1, 0, 0.3)
        + 1100.0 * harmonic(1, 2, 1.0)
        + 700.0 * harmonic(2, 3, 2.0)
        + 500.0 * harmonic(5, 1, 4.0)
        + 300.0 * harmonic(8, 0, 5.0)
}

/// The latitude and longitude, in radians, of a pixel's center on a globe of areas.
pub(crate) fn pixel_center((row, col): (usize, usize), (rows, cols): (usize, usize)) -> (f64, f64) {
    let latitude = PI / 2.0 - (row as f64 + 0.5) * PI / rows as f64;
    (latitude, -PI + (col as f64 + 0.5) * TAU / cols as f64)
}
