//! Rasters as files have them: GeoTIFF, BigTIFF, JPEG and PNG, read block by block.
//!
//! ```text
//!   file ──▶ RasterInfo: size, samples, CRS, outline, no-data
//!        └─▶ blocks ──▶ BlockCache (each decoded once) ──▶ heights_into, whole_heights_into, colors_into
//! ```
//!
//! The georeferencing of a raster comes from, in this order: `--crs` and `--extent`, the file's own
//! keys, a `.prj` and a world file beside it. Whatever the file's registration, an [`Outline`] is
//! about outer corners; the half pixel of point-registered files is taken off here and nowhere else.
//!
//! An image that has a world file and nothing that names its CRS is geographic if its extent fits
//! in degrees. Its [`RasterInfo::crs`] is then on the body given by [`ReadOptions::body`]; without
//! one it is `None`, and the caller may take the body of the catalog it builds.

pub mod block_cache;
pub mod convert;
pub mod crs;

mod error;
mod fence;
mod file;
mod georeference;
mod image;
mod outline;
mod samples;
mod tiff;
mod world_file;

use std::fmt::Debug;
use std::path::{Path, PathBuf};

use areoid_formats::body::Body;
use areoid_formats::geodesy::LatitudeKind;
use areoid_formats::projection::Crs;

pub use self::block_cache::BlockCache;
pub use self::convert::{Filled, Window, colors_into, heights_into, whole_heights_into};
pub use self::error::RasterError;
pub use self::fence::Fence;
pub use self::outline::Outline;
pub use self::samples::{SampleType, Samples};

/// What a raster is, without its samples.
#[derive(Clone, Debug, PartialEq)]
pub struct RasterInfo {
    /// The file.
    pub path: PathBuf,
    /// Pixels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Bands of height or color; alpha is not counted.
    pub bands: u16,
    /// Whether every pixel has, after its bands, a sample of alpha; 0 there is no data.
    pub has_alpha: bool,
    /// The type of every sample.
    pub sample: SampleType,
    /// The coordinate reference system, or `None` if neither the file nor the options say it: the
    /// outline is then in degrees.
    pub crs: Option<Crs>,
    /// Where the pixels lie on the map.
    pub outline: Outline,
    /// Whether the file says that its samples are points (`PixelIsPoint`) and not cells. The
    /// outline allows for it already.
    pub point_registered: bool,
    /// The sample that stands for no data, as it is stored, before scale and offset.
    pub nodata: Option<f64>,
    /// A height is `sample * scale + offset`.
    pub scale: f64,
    /// See [`Self::scale`].
    pub offset: f64,
    /// Pixels in a row of a whole block: a tile, or the full width.
    pub block_width: u32,
    /// Rows of a whole block: a tile's, or those of one or more strips.
    pub block_height: u32,
}

impl RasterInfo {
    /// Blocks in a row of blocks, and rows of blocks; the last of each may be narrower.
    #[must_use]
    pub const fn blocks(&self) -> (u32, u32) {
        (self.width.div_ceil(self.block_width), self.height.div_ceil(self.block_height))
    }

    /// Whether the first band has whole meters that fit in 16 bits with a sign.
    #[must_use]
    pub fn is_whole(&self) -> bool {
        let small = matches!(self.sample, SampleType::U8 | SampleType::I8 | SampleType::I16);
        small && (self.scale, self.offset) == (1.0, 0.0)
    }

    /// Samples of a pixel: bands, and alpha if there is one.
    #[must_use]
    pub fn samples_per_pixel(&self) -> usize {
        usize::from(self.bands) + usize::from(self.has_alpha)
    }

    /// Column and row of the first pixel, width and height of a block; `None` outside the raster.
    pub(crate) fn block_window(&self, block_col: u32, block_row: u32) -> Option<[u32; 4]> {
        let (across, down) = self.blocks();
        if block_col >= across || block_row >= down {
            return None;
        }
        let (col, row) = (block_col * self.block_width, block_row * self.block_height);
        let width = self.block_width.min(self.width - col);
        Some([col, row, width, self.block_height.min(self.height - row)])
    }
}

/// The samples of one block.
#[derive(Clone, Debug, PartialEq)]
pub struct Block {
    /// Column of the block's first pixel in the raster.
    pub col: u32,
    /// Row of the block's first pixel in the raster, counted downward.
    pub row: u32,
    /// Pixels in a row of the block.
    pub width: u32,
    /// Rows of the block.
    pub height: u32,
    /// Rows from the top, pixels from the left, bands side by side with alpha last.
    pub samples: Samples,
}

/// An open raster.
///
/// # Contract
///
/// * Any thread may call anything at any time; calls do not wait for one another, but for a JPEG
///   or PNG, which the first call decodes whole.
/// * [`Self::read_block`] reads and decodes on every call: keeping blocks is the caller's business
///   (see [`BlockCache`]).
/// * Rows go down (north to south) whatever the file's order, and blocks end at the raster's edges.
pub trait Raster: Send + Sync + Debug {
    /// What the raster is.
    fn info(&self) -> &RasterInfo;

    /// Decodes the block at column `block_col` and row `block_row` of blocks.
    ///
    /// # Errors
    ///
    /// [`RasterError`] if the block cannot be read or decoded.
    ///
    /// # Panics
    ///
    /// If the raster has no such block; [`RasterInfo::blocks`] says how many there are.
    fn read_block(&self, block_col: u32, block_row: u32) -> Result<Block, RasterError>;

    /// Checks that the raster's files are what they were when they were opened: the open file, the
    /// one that now has its name, and the world file and `.prj` that were read.
    ///
    /// # Errors
    ///
    /// [`RasterError::Modified`] if one differs in identity, length or times;
    /// [`RasterError::Io`] if one cannot be looked at.
    fn check_unchanged(&self) -> Result<(), RasterError>;
}

/// What the caller knows better than the file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ReadOptions {
    /// `EPSG:n`, `IAU_2015:n`, a PROJ string, WKT, or the path of a file that holds one of those.
    pub crs: Option<String>,
    /// West, south, east, north of the raster's outer edges, in degrees or meters of its CRS.
    pub extent: Option<[f64; 4]>,
    /// The sample that stands for no data.
    pub nodata: Option<f64>,
    /// The body that the raster shows.
    pub body: Option<Body>,
    /// What the raster's latitudes mean on that body.
    pub latitudes: Option<LatitudeKind>,
    /// Where the raster and the files beside it must lie. [`Self::crs`] is no file then.
    pub within: Option<Fence>,
}

/// Opens a raster and reads all about it but its samples.
///
/// # Errors
///
/// [`RasterError`] if the file cannot be read, is no raster, or lacks georeferencing that the
/// options do not give either.
pub fn open(path: &Path, options: &ReadOptions) -> Result<Box<dyn Raster>, RasterError> {
    const EXPECTED: &str = "a TIFF, JPEG or PNG file";
    let file = file::PositionedFile::open(path, options.within.as_ref())?;
    let start = file.read("the file's signature", 0, file.len().min(16))?;
    let mask = PathBuf::from(format!("{}.msk", path.display()));
    if mask.is_file() {
        let found = format!("a mask in a file of its own ({})", mask.display());
        return Err(RasterError::not_supported(path, found, "an alpha band or a no-data value"));
    }
    if start.starts_with(b"II") || start.starts_with(b"MM") {
        Ok(Box::new(tiff::TiffRaster::open(file, options)?))
    } else if start.starts_with(b"\xff\xd8\xff") || start.starts_with(b"\x89PNG\r\n\x1a\n") {
        Ok(Box::new(image::ImageRaster::open(file, options)?))
    } else {
        let found = if start.is_empty() {
            "nothing: it is empty".to_owned()
        } else {
            format!("{:?}", String::from_utf8_lossy(&start))
        };
        Err(RasterError::NotARaster { path: path.to_owned(), found, expected: EXPECTED })
    }
}
