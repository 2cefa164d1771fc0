//! What a dataset was made from, sample by sample, for those who hold it against that.

use areoid_formats::address::PageAddress;

use crate::raster::RasterError;

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
}

/// The rasters of a dataset.
///
/// # Contract
///
/// * Any thread may call anything at any time; each parcel is asked for once.
/// * Every sample with data inside the dataset's outline is in one of the parcels, once.
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
