//! Layouts, placement and faults of TIFF files.

mod builder;
mod damage;
mod layouts;
mod oracle;
mod placement;

use std::path::Path;

use super::super::samples::{Sample, with_samples};
use super::super::{Block, Raster, RasterError, ReadOptions, open};
use builder::TestTiff;

fn opened(tiff: &TestTiff) -> Result<Box<dyn Raster>, RasterError> {
    let folder = tempfile::tempdir().unwrap();
    // The open file outlives its folder.
    open(&tiff.write(&folder), &ReadOptions::default())
}

fn error_of(tiff: &TestTiff) -> String {
    with_causes(&opened(tiff).unwrap_err())
}

/// An error and its causes, as the user reads them.
fn with_causes(error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(Some(error), |&error| error.source());
    causes.map(ToString::to_string).collect::<Vec<_>>().join(": ")
}

fn numbers(block: &Block) -> Vec<f64> {
    with_samples!(&block.samples, values => values.iter().map(|&value| value.number()).collect())
}

/// Every block of a raster.
fn blocks(raster: &dyn Raster) -> impl Iterator<Item = Result<Block, RasterError>> {
    let (across, down) = raster.info().blocks();
    (0..down).flat_map(move |row| (0..across).map(move |col| raster.read_block(col, row)))
}

fn open_bytes(name: &str, bytes: &[u8]) -> Result<Box<dyn Raster>, RasterError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    open(Path::new(&path), &ReadOptions::default())
}
