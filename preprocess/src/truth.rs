//! What a dataset was made from, sample by sample, for those who hold it against that.

use areoid_formats::address::PageAddress;

use crate::origin::Origin;
use crate::raster::RasterError;
use crate::texel::Planes;
use crate::tile::Raw;

/// A sample of a raster, and where its center lies in a dataset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// The leaf whose interior it lies in, or on the edge of.
    pub leaf: PageAddress,
    /// Texels to the right of the interior's left edge.
    pub x: f64,
    /// Texels down from its top edge.
    pub y: f64,
    /// Meters in the first, or color codes; `None` where there is no data.
    pub value: Option<[f64; 3]>,
    /// What the texels around it must have.
    pub around: Around,
}

/// What the texels around a sample's center must have, from the samples that can make them valid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Around {
    /// Data.
    Data,
    /// None.
    Nothing,
    /// Either.
    Unknown,
}

/// The rasters of a dataset.
///
/// # Contract
///
/// * Any thread may call anything at any time; each parcel is asked for once.
/// * Every sample with data inside the dataset's outline is in one of the parcels, once; and those
///   without that have no data around, [`Around::Nothing`], as far as it is known.
pub trait Truth: Send + Sync {
    /// Into how many parcels the samples are put.
    fn parcels(&self) -> u64;

    /// The samples of a parcel.
    ///
    /// # Errors
    ///
    /// [`RasterError`] if they cannot be read.
    fn samples(&self, parcel: u64) -> Result<Vec<Sample>, RasterError>;

    /// Whether texels are samples: valid where those have data, and nowhere else.
    fn is_texels(&self) -> bool;
}

/// Leaves whose texels are what they were made from, until those are rounded to the step.
#[derive(Debug)]
pub struct OnTexels {
    origin: Box<dyn Origin>,
}

impl OnTexels {
    /// Those of `origin`, none of which has been read.
    #[must_use]
    pub fn new(origin: Box<dyn Origin>) -> Self {
        Self { origin }
    }

    /// Rows and columns of leaves.
    fn pages(&self) -> (u32, u32) {
        let pyramid = self.origin.grid().pyramid();
        pyramid.pages(pyramid.finest()).expect("a pyramid has a finest level")
    }
}

impl Truth for OnTexels {
    /// Leaves, row by row.
    fn parcels(&self) -> u64 {
        let (rows, cols) = self.pages();
        u64::from(rows) * u64::from(cols)
    }

    fn samples(&self, parcel: u64) -> Result<Vec<Sample>, RasterError> {
        let pyramid = self.origin.grid().pyramid();
        let (_, cols) = self.pages();
        let narrow = |index: u64| u32::try_from(index).expect("parcels are numbered by leaves");
        let (row, col) = (narrow(parcel / u64::from(cols)), narrow(parcel % u64::from(cols)));
        let leaf = PageAddress::new(pyramid.finest(), row, col);
        let Some(raw) = self.origin.read(leaf)? else { return Ok(Vec::new()) };
        let side = pyramid.page_side() as usize;
        let (rows, cols) = pyramid.interior_size(leaf);
        let places = (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col)));
        let sample = |(row, col): (u32, u32)| Sample {
            leaf,
            x: f64::from(col) + 0.5,
            y: f64::from(row) + 0.5,
            value: value(&raw, (row as usize + 1) * side + col as usize + 1),
            around: Around::Unknown,
        };
        Ok(places.map(sample).collect())
    }

    fn is_texels(&self) -> bool {
        true
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
