//! The pixels of a mosaic as what a dataset on their own grid was made from.

use areoid_formats::address::PageAddress;

use super::Mosaic;
use crate::build::Leaves as _;
use crate::raster::RasterError;
use crate::texel::Planes;
use crate::tile::Raw;
use crate::truth::{Sample, Truth};

impl Truth for Mosaic {
    /// Leaves, row by row.
    fn parcels(&self) -> u64 {
        let (rows, cols) = self.pages();
        u64::from(rows) * u64::from(cols)
    }

    fn samples(&self, parcel: u64) -> Result<Vec<Sample>, RasterError> {
        let pyramid = self.grid.pyramid();
        let (_, cols) = self.pages();
        let narrow = |index: u64| u32::try_from(index).expect("parcels are numbered by leaves");
        let (row, col) = (narrow(parcel / u64::from(cols)), narrow(parcel % u64::from(cols)));
        let leaf = PageAddress::new(pyramid.finest(), row, col);
        let Some(raw) = self.read(leaf)? else { return Ok(Vec::new()) };
        let side = pyramid.page_side() as usize;
        let (rows, cols) = pyramid.interior_size(leaf);
        let places = (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col)));
        let sample = |(row, col): (u32, u32)| Sample {
            leaf,
            x: f64::from(col) + 0.5,
            y: f64::from(row) + 0.5,
            value: value(&raw, (row as usize + 1) * side + col as usize + 1),
        };
        Ok(places.map(sample).collect())
    }

    fn is_texels(&self) -> bool {
        true
    }
}

impl Mosaic {
    /// Rows and columns of leaves.
    fn pages(&self) -> (u32, u32) {
        let pyramid = self.grid.pyramid();
        pyramid.pages(pyramid.finest()).expect("a pyramid has a finest level")
    }
}

fn value(raw: &Raw, at: usize) -> Option<[f64; 3]> {
    if raw.alpha.as_ref().is_some_and(|alpha| alpha[at] == 0) {
        return None;
    }
    Some(match &raw.planes {
        Planes::Height(plane) => [f64::from(plane[at]), 0.0, 0.0],
        Planes::WholeHeight(plane) => [f64::from(plane[at]), 0.0, 0.0],
        Planes::Color(planes) => planes.each_ref().map(|plane| f64::from(plane[at])),
    })
}
