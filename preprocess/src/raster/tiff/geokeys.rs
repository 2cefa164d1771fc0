//! The geo keys of a GeoTIFF: its geotransform and its coordinate reference system.
//!
//! ```text
//!   GeoKeyDirectory   (1 1 0 n) then n × (key, where, count, value or index)
//!                                           │  0: the value itself
//!                                           ├─ 34736 ─▶ GeoDoubleParams[index]
//!                                           └─ 34737 ─▶ GeoAsciiParams[index..]
//! ```
//!
//! GeoTIFF has no codes for planets, so their systems come as "user-defined" keys: radii, a method
//! and its parameters.
//!
//! # References
//!
//! * OGC 19-008r4, *OGC GeoTIFF Standard*, version 1.1, annexes B to D.

use std::collections::BTreeMap;

use super::super::crs::{MapCrs, Method, Parameters, ParseCrsError, Radii};
use super::super::error::RasterError;
use super::super::georeference::crs_error;
use super::super::outline::Steps;
use super::directory::{Directory, TiffFile, tags};

const MODEL_TYPE: u16 = 1024;
const RASTER_TYPE: u16 = 1025;
const CITATION: u16 = 1026;
const GEOGRAPHIC_TYPE: u16 = 2048;
const GEOGRAPHIC_CITATION: u16 = 2049;
const GEOGRAPHIC_LINEAR_UNITS: u16 = 2052;
const ANGULAR_UNITS: u16 = 2054;
const ELLIPSOID: u16 = 2056;
const SEMI_MAJOR_AXIS: u16 = 2057;
const SEMI_MINOR_AXIS: u16 = 2058;
const INVERSE_FLATTENING: u16 = 2059;
const PRIME_MERIDIAN_LONGITUDE: u16 = 2061;
const PROJECTED_TYPE: u16 = 3072;
const METHOD: u16 = 3075;
const LINEAR_UNITS: u16 = 3076;
const LINEAR_UNIT_SIZE: u16 = 3077;
const STANDARD_PARALLEL_1: u16 = 3078;
const ORIGIN_LONGITUDE: u16 = 3080;
const ORIGIN_LATITUDE: u16 = 3081;
const FALSE_EASTING: u16 = 3082;
const FALSE_NORTHING: u16 = 3083;
const CENTER_LONGITUDE: u16 = 3088;
const CENTER_LATITUDE: u16 = 3089;
const CENTER_EASTING: u16 = 3090;
const CENTER_NORTHING: u16 = 3091;
const ORIGIN_SCALE: u16 = 3092;
const CENTER_SCALE: u16 = 3093;
const VERTICAL_LONGITUDE: u16 = 3095;
const VERTICAL_UNITS: u16 = 4099;
const USER_DEFINED: u16 = 32767;

#[derive(Clone, Debug, PartialEq)]
enum Value {
    Short(u16),
    Double(f64),
    Text(String),
}

/// The keys of a file; empty if it has none.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct GeoKeys {
    values: BTreeMap<u16, Value>,
}

impl GeoKeys {
    pub(super) fn read(tiff: &TiffFile, directory: &Directory) -> Result<Self, RasterError> {
        let Some(keys) = tiff.integers(directory, tags::GEO_KEY_DIRECTORY)? else {
            return Ok(Self::default());
        };
        let doubles = tiff.floats(directory, tags::GEO_DOUBLE_PARAMS)?.unwrap_or_default();
        let texts = tiff.text(directory, tags::GEO_ASCII_PARAMS)?.unwrap_or_default();
        let mut values = BTreeMap::new();
        for key in keys.chunks_exact(4).skip(1) {
            let &[id, location, count, value] = key else { continue };
            let (Ok(id), Ok(index)) = (u16::try_from(id), usize::try_from(value)) else { continue };
            let read = match location {
                0 => u16::try_from(value).ok().map(Value::Short),
                34736 => doubles.get(index).copied().map(Value::Double),
                34737 => usize::try_from(count)
                    .ok()
                    .and_then(|count| texts.get(index..index.checked_add(count)?.min(texts.len())))
                    .map(|text| Value::Text(text.trim_end_matches('|').to_owned())),
                _ => None,
            };
            let Some(read) = read else {
                let found = format!("key {id} at {value} of tag {location}");
                let expected = "keys whose values are there";
                return Err(tiff.wrong(directory, tags::GEO_KEY_DIRECTORY, found, expected));
            };
            values.insert(id, read);
        }
        Ok(Self { values })
    }

    /// Whether the file's coordinates are those of pixel centres.
    pub(super) fn is_point(&self) -> bool {
        self.short(RASTER_TYPE) == Some(2)
    }

    /// Metres to a unit of the heights, if the keys say so.
    pub(super) fn meters_per_height(&self) -> Option<f64> {
        match self.short(VERTICAL_UNITS)? {
            9001 => Some(1.0),
            9002 => Some(0.3048),
            9003 => Some(1200.0 / 3937.0),
            9036 => Some(1000.0),
            _ => None,
        }
    }

    fn short(&self, key: u16) -> Option<u16> {
        match self.values.get(&key)? {
            Value::Short(value) => Some(*value),
            _ => None,
        }
    }

    fn double(&self, key: u16) -> Option<f64> {
        match self.values.get(&key)? {
            Value::Double(value) => Some(*value),
            Value::Short(value) => Some(f64::from(*value)),
            Value::Text(_) => None,
        }
    }

    fn first_double(&self, keys: &[u16]) -> Option<f64> {
        keys.iter().find_map(|&key| self.double(key))
    }

    /// A code of the EPSG registry, if the key has one.
    fn code(&self, key: u16) -> Option<u16> {
        self.short(key).filter(|&code| code != USER_DEFINED && code != 0)
    }

    /// The system's name in the words of the file.
    fn citation(&self) -> String {
        let text = |key| match self.values.get(&key) {
            Some(Value::Text(text)) => Some(text.clone()),
            _ => None,
        };
        text(CITATION).or_else(|| text(GEOGRAPHIC_CITATION)).unwrap_or("an unnamed system".into())
    }

    /// The coordinate reference system, or `None` if the keys name none.
    pub(super) fn crs(&self, tiff: &TiffFile) -> Result<Option<MapCrs>, RasterError> {
        self.map_crs().map_err(|source| crs_error(tiff.file.path(), "its geo keys", source))
    }

    fn map_crs(&self) -> Result<Option<MapCrs>, ParseCrsError> {
        let projected = match self.short(MODEL_TYPE) {
            Some(1) => true,
            Some(2) => false,
            Some(3) => return Err(ParseCrsError::not_supported("a geocentric system")),
            _ if self.values.contains_key(&PROJECTED_TYPE) => true,
            _ if self.values.contains_key(&GEOGRAPHIC_TYPE) => false,
            _ => return Ok(None),
        };
        self.check_units(projected)?;
        if projected {
            if let Some(code) = self.code(PROJECTED_TYPE) {
                return MapCrs::from_epsg(code).map(Some);
            }
        } else if let Some(code) = self.code(GEOGRAPHIC_TYPE) {
            match MapCrs::from_epsg(code) {
                // A code of another registry, with the radii beside it.
                Err(ParseCrsError::UnknownCode { .. }) if self.radii().is_ok() => {}
                result => return result.map(Some),
            }
        }
        let meters_per_unit = if projected { self.meters_per_unit()? } else { 1.0 };
        let length = |keys| self.first_double(keys).unwrap_or(0.0) * meters_per_unit;
        let parameters = Parameters {
            ellipsoid: self.radii()?,
            method: if projected { self.method()? } else { Method::Geographic },
            false_easting_m: length(&[FALSE_EASTING, CENTER_EASTING]),
            false_northing_m: length(&[FALSE_NORTHING, CENTER_NORTHING]),
            meters_per_unit,
        };
        MapCrs::from_proj(&parameters.proj_string()).map(Some)
    }

    fn check_units(&self, projected: bool) -> Result<(), ParseCrsError> {
        let unit = self.short(ANGULAR_UNITS).unwrap_or(9102);
        if !matches!(unit, 9102 | 9122) {
            return Err(ParseCrsError::NotSupported {
                found: format!("an angular unit of code {unit}"),
                supported: "degrees (9102)",
            });
        }
        if let Some(meridian) = self.double(PRIME_MERIDIAN_LONGITUDE).filter(|&at| at != 0.0) {
            return Err(ParseCrsError::NotSupported {
                found: format!("a prime meridian at {meridian}"),
                supported: "a prime meridian at 0",
            });
        }
        match self.short(GEOGRAPHIC_LINEAR_UNITS) {
            None | Some(9001) => Ok(()),
            Some(_) if projected => Ok(()),
            Some(unit) => Err(ParseCrsError::NotSupported {
                found: format!("radii in a unit of code {unit}"),
                supported: "meters (9001)",
            }),
        }
    }

    fn meters_per_unit(&self) -> Result<f64, ParseCrsError> {
        match (self.short(LINEAR_UNITS).unwrap_or(9001), self.double(LINEAR_UNIT_SIZE)) {
            (9001, _) | (USER_DEFINED, Some(1.0)) => Ok(1.0),
            (9036, _) | (USER_DEFINED, Some(1000.0)) => Ok(1000.0),
            (unit, size) => Err(ParseCrsError::NotSupported {
                found: match size {
                    Some(size) => format!("a unit of {size} m"),
                    None => format!("a linear unit of code {unit}"),
                },
                supported: "meters (9001) and kilometers (9036)",
            }),
        }
    }

    fn radii(&self) -> Result<Radii, ParseCrsError> {
        if let Some(a) = self.double(SEMI_MAJOR_AXIS) {
            if let Some(rf) = self.double(INVERSE_FLATTENING) {
                return Ok(Radii::InverseFlattening { a, rf });
            }
            return Ok(Radii::Polar { a, b: self.double(SEMI_MINOR_AXIS).unwrap_or(a) });
        }
        match self.code(ELLIPSOID) {
            Some(7030) => Ok(Radii::InverseFlattening { a: 6_378_137.0, rf: 298.257_223_563 }),
            Some(7019) => Ok(Radii::InverseFlattening { a: 6_378_137.0, rf: 298.257_222_101 }),
            _ => Err(ParseCrsError::Missing {
                missing: "the semi-major axis (geo key 2057)",
                found: self.citation(),
            }),
        }
    }

    fn method(&self) -> Result<Method, ParseCrsError> {
        let longitude = [VERTICAL_LONGITUDE, ORIGIN_LONGITUDE, CENTER_LONGITUDE];
        let latitude = [ORIGIN_LATITUDE, CENTER_LATITUDE];
        let lon_0 = self.first_double(&longitude).unwrap_or(0.0);
        let lat_0 = self.first_double(&latitude);
        let scale = self.first_double(&[ORIGIN_SCALE, CENTER_SCALE]).unwrap_or(1.0);
        let parallel = self.double(STANDARD_PARALLEL_1);
        match (self.short(METHOD), lat_0) {
            (Some(17), _) => Ok(Method::Equirectangular {
                lon_0: self.first_double(&[CENTER_LONGITUDE, ORIGIN_LONGITUDE]).unwrap_or(0.0),
                lat_0: self.first_double(&[CENTER_LATITUDE, ORIGIN_LATITUDE]).unwrap_or(0.0),
                lat_ts: parallel.unwrap_or(0.0),
            }),
            (Some(15), Some(lat)) if lat != 0.0 => {
                Ok(Method::PolarStereographic { lat: parallel.unwrap_or(lat), lon_0, scale })
            }
            (Some(14), Some(lat)) if lat.abs() == 90.0 => {
                Ok(Method::PolarStereographic { lat, lon_0, scale })
            }
            (Some(15), _) => Err(ParseCrsError::Missing {
                missing: "the latitude of origin (geo key 3081)",
                found: self.citation(),
            }),
            (Some(code), _) => {
                let name = method_name(code);
                let found = format!("{} ({name}, ProjCoordTrans {code})", self.citation());
                Err(ParseCrsError::not_supported(found))
            }
            (None, _) => Err(ParseCrsError::Missing {
                missing: "the projection method (geo key 3075)",
                found: self.citation(),
            }),
        }
    }
}

fn method_name(code: u16) -> &'static str {
    match code {
        1 => "transverse Mercator",
        3 => "oblique Mercator",
        7 => "Mercator",
        8 | 9 => "Lambert conformal conic",
        10 => "Lambert azimuthal equal-area",
        11 => "Albers equal-area conic",
        12 => "azimuthal equidistant",
        13 => "equidistant conic",
        14 => "oblique stereographic",
        16 => "oblique stereographic",
        18 => "Cassini-Soldner",
        19 => "gnomonic",
        20 => "Miller cylindrical",
        21 => "orthographic",
        22 => "polyconic",
        23 => "Robinson",
        24 => "sinusoidal",
        25 => "Van der Grinten",
        28 => "cylindrical equal-area",
        _ => "another method",
    }
}

/// The file's geotransform, its half pixel taken off if it is point-registered; `None` if the file
/// has none.
pub(super) fn steps(
    tiff: &TiffFile,
    directory: &Directory,
    is_point: bool,
) -> Result<Option<Steps>, RasterError> {
    let steps = if let Some(matrix) = tiff.floats(directory, tags::MODEL_TRANSFORMATION)? {
        let &[a, b, _, x, d, e, _, y, ..] = &matrix[..] else {
            let found = format!("{} values", matrix.len());
            return Err(tiff.wrong(directory, tags::MODEL_TRANSFORMATION, found, "16 values"));
        };
        if b != 0.0 || d != 0.0 {
            return Err(RasterError::not_supported(
                tiff.file.path(),
                "a rotated raster (ModelTransformation)",
                "rows along x, columns along y",
            ));
        }
        Steps { corner: [x, y], step: [a, e] }
    } else if let Some(tiepoints) = tiff.floats(directory, tags::MODEL_TIEPOINT)? {
        let Some(scale) = tiff.floats(directory, tags::MODEL_PIXEL_SCALE)? else {
            return Err(RasterError::not_supported(
                tiff.file.path(),
                "tie points without a pixel scale",
                "a pixel scale, or a transformation",
            ));
        };
        let (&[dx, dy, ..], &[i, j, _, x, y, ..]) = (&scale[..], &tiepoints[..]) else {
            let found = format!("{} values", tiepoints.len());
            return Err(tiff.wrong(directory, tags::MODEL_TIEPOINT, found, "6 values"));
        };
        // The scale is positive with north up; files that write it negative mean the same.
        let dy = dy.abs();
        Steps { corner: [x - i * dx, y + j * dy], step: [dx, -dy] }
    } else {
        return Ok(None);
    };
    let half = if is_point { 0.5 } else { 0.0 };
    let [x, y] = steps.corner;
    let [dx, dy] = steps.step;
    Ok(Some(Steps { corner: [x - half * dx, y - half * dy], ..steps }))
}
