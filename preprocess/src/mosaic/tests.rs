//! Leaves of one raster and of several over one another, against the rule texel by texel.

use super::*;
use crate::build::Leaves as _;
use crate::raster::{Block, Outline as RasterOutline, RasterError, SampleType, Samples};
use crate::texel::Planes;
use areoid_formats::body::Body;
use areoid_formats::projection::Projection;

/// A raster in memory, in blocks of 7 × 5 pixels.
#[derive(Debug)]
struct Painted {
    info: RasterInfo,
    /// The samples of the pixel in a column and row of the raster.
    paint: fn(u32, u32) -> Vec<u8>,
}

impl Raster for Painted {
    fn info(&self) -> &RasterInfo {
        &self.info
    }

    fn read_block(&self, block_col: u32, block_row: u32) -> Result<Block, RasterError> {
        let (col, row) = (block_col * 7, block_row * 5);
        let (width, height) = (7.min(self.info.width - col), 5.min(self.info.height - row));
        let pixels =
            (row..row + height).flat_map(|row| (col..col + width).map(move |col| (col, row)));
        let samples = pixels.flat_map(|(col, row)| (self.paint)(col, row)).collect();
        Ok(Block { col, row, width, height, samples: Samples::U8(samples) })
    }

    fn check_unchanged(&self) -> Result<(), RasterError> {
        Ok(())
    }
}

fn crs() -> Crs {
    Crs::new(Projection::Geographic, Body::parse("moon").unwrap().ellipsoid)
}

/// A raster whose first pixel is in this column and row of a map of 1-degree pixels.
fn painted(
    (col, row): (u32, u32),
    (width, height): (u32, u32),
    bands: u16,
    has_alpha: bool,
    paint: fn(u32, u32) -> Vec<u8>,
) -> Painted {
    let info = RasterInfo {
        path: "painted.tif".into(),
        width,
        height,
        bands,
        has_alpha,
        sample: SampleType::U8,
        crs: Some(crs()),
        outline: RasterOutline {
            origin: [f64::from(col) - 90.0, 60.0 - f64::from(row)],
            pixel_size: [1.0, 1.0],
        },
        point_registered: false,
        nodata: Some(7.0),
        scale: 1.0,
        offset: 0.0,
        block_width: 7,
        block_height: 5,
    };
    Painted { info, paint }
}

fn mosaic(rasters: Vec<Painted>, kind: Kind) -> Mosaic {
    let rasters = rasters.into_iter().map(|raster| Arc::new(raster) as Arc<dyn Raster>).collect();
    Mosaic::new(rasters, crs(), kind, 34).unwrap()
}

/// All leaves of a mosaic, each texel as what its raster shows there.
fn check(
    mosaic: &Mosaic,
    extent: (u32, u32),
    expected: impl Fn(u32, u32) -> Option<(Vec<f32>, u8)>,
) {
    let pyramid = mosaic.grid().pyramid();
    assert_eq!((pyramid.extent().width, pyramid.extent().height), extent);
    let level = pyramid.finest();
    let (rows, cols) = pyramid.pages(level).unwrap();
    for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
        let page = PageAddress { level, row, col };
        let (rows, cols) = pyramid.interior_size(page);
        let (top, left) = (row * pyramid.interior(), col * pyramid.interior());
        let texels: Vec<_> = (top..top + rows)
            .flat_map(|row| (left..left + cols).map(move |col| (col, row)))
            .map(|(col, row)| expected(col, row))
            .collect();
        let Some(raw) = mosaic.read(page).unwrap() else {
            assert!(texels.iter().all(Option::is_none), "{page:?}");
            continue;
        };
        let side = pyramid.page_side() as usize;
        let is_opaque = texels.iter().all(|texel| matches!(texel, Some((_, u8::MAX))));
        assert_eq!(raw.alpha.is_none(), is_opaque, "{page:?}");
        for (at, texel) in texels.iter().enumerate() {
            let at = (at / cols as usize + 1) * side + at % cols as usize + 1;
            let found: Vec<f32> = match &raw.planes {
                Planes::Height(plane) => vec![plane[at]],
                Planes::WholeHeight(plane) => vec![plane[at].into()],
                Planes::Color(planes) => planes.iter().map(|plane| plane[at].into()).collect(),
            };
            let alpha = raw.alpha.as_ref().map_or(u8::MAX, |alpha| alpha[at]);
            match texel {
                Some((texel, opacity)) => assert_eq!((&found, alpha), (texel, *opacity)),
                None => {
                    assert!(alpha == 0 && found.iter().all(|value| value.is_nan() || *value == 0.0))
                }
            }
        }
    }
    assert_eq!(mosaic.decoded_blocks(), mosaic.blocks());
    assert!(mosaic.parts.iter().all(|part| part.blocks.resident_bytes() == 0));
}

fn low(value: u32) -> u8 {
    u8::try_from(value % 200).unwrap()
}

/// No data in a diagonal stripe.
fn striped(col: u32, row: u32) -> Vec<u8> {
    vec![if (col + row) % 90 < 30 { 7 } else { low(col * 3 + row) | 8 }]
}

fn full_heights(col: u32, row: u32) -> Vec<u8> {
    vec![low(col + row * 5) | 8]
}

#[test]
fn heights_of_a_later_raster_show_where_it_has_data() {
    for (scale, is_whole) in [(1.0, true), (2.0, false)] {
        let mut rasters = vec![
            painted((0, 0), (80, 40), 1, false, full_heights),
            painted((50, 20), (70, 50), 1, false, striped),
        ];
        rasters.iter_mut().for_each(|raster| raster.info.scale = scale.into());
        let mosaic = mosaic(rasters, Kind::Height);
        assert_eq!(mosaic.is_whole(), is_whole);
        check(&mosaic, (120, 70), |col, row| {
            let valid = |value: Vec<u8>| (value[0] != 7).then(|| f32::from(value[0]) * scale);
            let of = |value| valid(value).map(|height| (vec![height], u8::MAX));
            let second = (col >= 50 && row >= 20).then(|| striped(col - 50, row - 20)).and_then(of);
            second.or_else(|| (col < 80 && row < 40).then(|| full_heights(col, row)).and_then(of))
        });
    }
}

/// A band of a mosaic: rows of the rasters begin above it, end in it and below it, or miss it.
#[test]
fn a_band_has_the_pixels_of_the_whole() {
    let rasters = || {
        let rasters = [
            painted((0, 0), (80, 70), 1, false, full_heights),
            painted((50, 20), (70, 30), 1, false, striped),
            painted((0, 70), (120, 20), 1, false, striped),
        ];
        rasters.into_iter().map(|raster| Arc::new(raster) as Arc<dyn Raster>).collect()
    };
    let layout = Layout::new(rasters(), crs()).unwrap();
    for rows in [0..90, 33..81, 42..70, 3..21, 71..90] {
        let band = Mosaic::of_rows(&layout, rows.clone(), Kind::Height, 34).unwrap();
        assert_eq!(layout.rows_of(band.grid()), rows);
        let [left, top] = layout.grid_of_rows(0..90, 34).unwrap().origin();
        assert_eq!(band.grid().origin(), [left, top - f64::from(rows.start)]);
        check(&band, (120, rows.end - rows.start), |col, row| {
            let row = row + rows.start;
            let valid = |value: Vec<u8>| (value[0] != 7).then(|| f32::from(value[0]));
            let of = |value| valid(value).map(|height| (vec![height], u8::MAX));
            let third = (row >= 70).then(|| striped(col, row - 70)).and_then(of);
            let second =
                (col >= 50 && (20..50).contains(&row)).then(|| striped(col - 50, row - 20));
            let first = (col < 80 && row < 70).then(|| full_heights(col, row));
            third.or_else(|| second.and_then(of)).or_else(|| first.and_then(of))
        });
    }
}

fn solid(col: u32, row: u32) -> Vec<u8> {
    vec![low(col) | 8, low(row) | 8, low(col + row) | 8, 255]
}

/// Translucent in places, and nothing in others.
fn misty(col: u32, row: u32) -> Vec<u8> {
    let alpha = if col % 50 < 20 { 0 } else { 255 - u8::try_from(row / 25).unwrap() };
    vec![low(col * 2) | 8, 9, low(row * 2) | 8, alpha]
}

#[test]
fn translucent_colors_over_opaque_ones_are_translucent() {
    let rasters = vec![
        painted((0, 0), (100, 70), 3, true, solid),
        painted((10, 5), (90, 65), 3, true, misty),
    ];
    let mosaic = mosaic(rasters, Kind::Color);
    check(&mosaic, (100, 70), |col, row| {
        let of = |pixel: Vec<u8>| {
            let color = pixel[..3].iter().copied().map(f32::from).collect();
            (pixel[3] > 0).then_some((color, pixel[3]))
        };
        let second = (col >= 10 && row >= 5).then(|| misty(col - 10, row - 5)).and_then(of);
        second.or_else(|| of(solid(col, row)))
    });
}
