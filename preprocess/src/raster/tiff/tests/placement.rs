//! Where rasters lie: registration, orientation, systems, and files beside them.

use super::builder::{TestTiff, Values, globe, value_at};
use super::*;
use crate::raster::Outline;
use crate::raster::samples::SampleType;
use crate::raster::tiff::directory::tags;
use areoid_formats::body::Ellipsoid;
use areoid_formats::projection::{Crs, Projection};
use areoid_formats::units::Meters;

fn gray() -> TestTiff {
    globe((36, 18), SampleType::I16)
}

fn keys(tiff: TestTiff, keys: &[u16], doubles: &[f64], text: &'static str) -> TestTiff {
    let count = u16::try_from(keys.len() / 4).unwrap();
    let directory = [&[1, 1, 0, count], keys].concat();
    tiff.with(tags::GEO_KEY_DIRECTORY, Values::Short(directory))
        .with(tags::GEO_DOUBLE_PARAMS, Values::Double(doubles.to_vec()))
        .with(tags::GEO_ASCII_PARAMS, Values::Text(text))
}

fn crs_of(tiff: &TestTiff) -> Crs {
    opened(tiff).unwrap().info().crs.unwrap()
}

#[test]
fn cells_and_points_differ_by_half_a_pixel() {
    let cells = opened(&gray()).unwrap();
    let expected = Outline { origin: [-180.0, 90.0], pixel_size: [10.0, 10.0] };
    assert_eq!((cells.info().outline, cells.info().point_registered), (expected, false));

    let point = keys(gray(), &[1024, 0, 1, 2, 1025, 0, 1, 2, 2048, 0, 1, 4326], &[], "");
    let points = opened(&point).unwrap();
    let expected = Outline { origin: [-185.0, 95.0], pixel_size: [10.0, 10.0] };
    assert_eq!((points.info().outline, points.info().point_registered), (expected, true));
}

#[test]
fn a_tiepoint_need_not_be_the_first_pixel() {
    let moved =
        gray().with(tags::MODEL_TIEPOINT, Values::Double(vec![18.0, 9.0, 0.0, 0.0, 0.0, 0.0]));
    assert_eq!(opened(&moved).unwrap().info().outline.origin, [-180.0, 90.0]);
}

fn transformed(matrix: [f64; 8]) -> TestTiff {
    let mut values = matrix.to_vec();
    values.extend([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
    gray()
        .without(tags::MODEL_PIXEL_SCALE)
        .without(tags::MODEL_TIEPOINT)
        .with(tags::MODEL_TRANSFORMATION, Values::Double(values))
}

#[test]
fn south_up_rasters_are_handed_out_north_up() {
    // 18 rows are no multiple of a tile's 16: blocks and tiles do not coincide.
    let tiff = transformed([10.0, 0.0, 0.0, -180.0, 0.0, 10.0, 0.0, -90.0]);
    let raster = opened(&tiff).unwrap();
    let expected = Outline { origin: [-180.0, 90.0], pixel_size: [10.0, 10.0] };
    assert_eq!(raster.info().outline, expected);
    for block in blocks(&*raster) {
        let block = block.unwrap();
        let mut values = numbers(&block).into_iter();
        for row in block.row..block.row + block.height {
            for col in block.col..block.col + block.width {
                assert_eq!(values.next(), Some(value_at(col, 17 - row, 0)));
            }
        }
    }
}

#[test]
fn rotated_and_westward_rasters_are_refused() {
    let rotated = transformed([10.0, 0.1, 0.0, -180.0, 0.0, -10.0, 0.0, 90.0]);
    assert!(error_of(&rotated).contains("rotated"));
    let westward = transformed([-10.0, 0.0, 0.0, 180.0, 0.0, -10.0, 0.0, 90.0]);
    assert!(error_of(&westward).contains("columns eastward"));
    let points = gray().without(tags::MODEL_PIXEL_SCALE);
    assert!(error_of(&points).contains("tie points without a pixel scale"));
    let no_size = gray().with(tags::MODEL_PIXEL_SCALE, Values::Double(vec![0.0, 1.0, 0.0]));
    assert!(error_of(&no_size).contains("a pixel of 0 by"));
}

#[test]
fn a_planets_user_defined_keys_are_understood() {
    // As GDAL writes them for an equirectangular map of Mars.
    let mars = keys(
        gray(),
        &[
            1024, 0, 1, 1, 1025, 0, 1, 1, 1026, 34737, 21, 0, 2048, 0, 1, 32767, 2050, 0, 1, 32767,
            2054, 0, 1, 9102, 2056, 0, 1, 32767, 2057, 34736, 1, 5, 2058, 34736, 1, 6, 2061, 34736,
            1, 7, 3072, 0, 1, 32767, 3074, 0, 1, 32767, 3075, 0, 1, 17, 3076, 0, 1, 9001, 3078,
            34736, 1, 2, 3082, 34736, 1, 3, 3083, 34736, 1, 4, 3088, 34736, 1, 1, 3089, 34736, 1,
            0,
        ],
        &[0.0, 180.0, -10.0, 0.0, 0.0, 3_396_190.0, 3_396_190.0, 0.0],
        "Equirectangular MARS|GCS Name = GCS_MARS|",
    );
    let crs = crs_of(&mars);
    assert_eq!(crs.ellipsoid, Ellipsoid::sphere(Meters(3_396_190.0)).unwrap());
    let expected = "+proj=eqc +lat_ts=-10 +lat_0=0 +lon_0=180 +x_0=0 +y_0=0 +R=3396190 +units=m";
    assert_eq!(crs, Crs::from_proj_string(expected).unwrap());
}

fn polar(method: u16, latitude: f64, unit: u16) -> TestTiff {
    let (lat, lon) = if method == 15 { (3081, 3095) } else { (3089, 3088) };
    keys(
        gray(),
        &[
            1024, 0, 1, 1, 2048, 0, 1, 32767, 2057, 34736, 1, 2, 2059, 34736, 1, 3, 3072, 0, 1,
            32767, 3075, 0, 1, method, 3076, 0, 1, unit, lat, 34736, 1, 0, lon, 34736, 1, 1, 3082,
            34736, 1, 4,
        ],
        &[latitude, -45.0, 6_378_273.0, 298.279_411_123_064, 2.0],
        "",
    )
}

#[test]
fn polar_stereographic_comes_with_a_scale_or_a_parallel() {
    let expected = |proj| Crs::from_proj_string(proj).unwrap();
    assert_eq!(
        crs_of(&polar(15, 70.0, 9001)),
        expected(
            "+proj=stere +lat_0=90 +lat_ts=70 +lon_0=-45 +x_0=2 +y_0=0 +a=6378273 +rf=298.279411123064 +units=m"
        ),
    );
    let at_pole = expected(
        "+proj=stere +lat_0=-90 +k=1 +lon_0=-45 +x_0=2 +y_0=0 +a=6378273 +rf=298.279411123064 +units=m",
    );
    assert_eq!(crs_of(&polar(15, -90.0, 9001)), at_pole);
    assert_eq!(crs_of(&polar(14, -90.0, 9001)), at_pole);
    assert!(error_of(&polar(14, -70.0, 9001)).contains("oblique stereographic"));
}

#[test]
fn kilometers_are_scaled_and_feet_refused() {
    let raster = opened(&polar(15, 90.0, 9036)).unwrap();
    assert_eq!(raster.info().outline.pixel_size, [10_000.0, 10_000.0]);
    let Projection::PolarStereographic(map) = raster.info().crs.unwrap().projection else {
        panic!("a polar map");
    };
    assert_eq!(map.false_easting, Meters(2000.0));
    assert!(error_of(&polar(15, 90.0, 9003)).contains("a linear unit of code 9003"));
}

#[test]
fn systems_that_are_not_understood_are_named_and_can_be_overridden() {
    let utm = keys(gray(), &[1024, 0, 1, 1, 3072, 0, 1, 32613], &[], "");
    let error = error_of(&utm);
    assert!(error.contains("WGS 84 / UTM zone 13N (EPSG:32613)"), "{error}");
    assert!(error.contains("supported: geographic, equirectangular, polar stereographic"));
    let folder = tempfile::tempdir().unwrap();
    let options = ReadOptions { crs: Some("EPSG:4326".into()), ..ReadOptions::default() };
    assert!(open(&utm.write(&folder), &options).is_ok());

    let sinusoidal = keys(
        gray(),
        &[1024, 0, 1, 1, 1026, 34737, 5, 0, 2057, 34736, 1, 0, 3072, 0, 1, 32767, 3075, 0, 1, 24],
        &[3_396_190.0],
        "MDIM|",
    );
    assert!(error_of(&sinusoidal).contains("MDIM (sinusoidal, ProjCoordTrans 24)"));
    let radians = keys(gray(), &[1024, 0, 1, 2, 2048, 0, 1, 4326, 2054, 0, 1, 9101], &[], "");
    assert!(error_of(&radians).contains("angular unit of code 9101"));
    let paris = keys(gray(), &[1024, 0, 1, 2, 2048, 0, 1, 4326, 2061, 34736, 1, 0], &[2.3], "");
    assert!(error_of(&paris).contains("prime meridian at 2.3"));
}

#[test]
fn a_file_without_keys_is_placed_by_the_files_beside_it() {
    let bare = gray()
        .without(tags::GEO_KEY_DIRECTORY)
        .without(tags::MODEL_PIXEL_SCALE)
        .without(tags::MODEL_TIEPOINT);
    let folder = tempfile::tempdir().unwrap();
    let path = bare.write(&folder);
    let error = open(&path, &ReadOptions::default()).unwrap_err().to_string();
    assert!(error.contains("no georeferencing") && error.contains("test.tfw"), "{error}");

    std::fs::write(path.with_extension("TFW"), "10 0 0 -10 -175 85").unwrap();
    let raster = open(&path, &ReadOptions::default()).unwrap();
    assert_eq!((raster.info().outline.origin, raster.info().crs), ([-180.0, 90.0], None));

    let wkt = r#"GEOGCS["GCS_Mars_2000",DATUM["D_Mars_2000",
        SPHEROID["Mars_2000_IAU_IAG",3396190.0,169.89444722361179]],
        PRIMEM["Reference_Meridian",0.0],UNIT["Degree",0.0174532925199433]]"#;
    std::fs::write(path.with_extension("prj"), wkt).unwrap();
    let crs = open(&path, &ReadOptions::default()).unwrap().info().crs.unwrap();
    assert!((crs.ellipsoid.b().0 - 3_376_200.0).abs() < 1e-3);
}

#[test]
fn scale_offset_and_units_become_meters() {
    let xml = "<GDALMetadata><Item name=\"OFFSET\" sample=\"0\" role=\"offset\">100</Item>\
               <Item name=\"SCALE\" sample=\"0\" role=\"scale\">0.5</Item>\
               <Item name=\"UNITTYPE\" sample=\"0\" role=\"unittype\">km</Item></GDALMetadata>";
    let raster = opened(&gray().with(tags::GDAL_METADATA, Values::Text(xml))).unwrap();
    assert_eq!((raster.info().scale, raster.info().offset), (500.0, 100_000.0));
    let nan = gray().with(tags::GDAL_NODATA, Values::Text(" nan"));
    assert!(opened(&nan).unwrap().info().nodata.unwrap().is_nan());
    let word = gray().with(tags::GDAL_NODATA, Values::Text("none"));
    assert!(error_of(&word).contains("GDAL_NODATA (tag 42113)"));
    let feet = keys(gray(), &[1024, 0, 1, 2, 2048, 0, 1, 4326, 4099, 0, 1, 9002], &[], "");
    assert_eq!(opened(&feet).unwrap().info().scale, 0.3048);
}
