//! What well-known text says of a coordinate reference system, in both versions and their dialects.
//!
//! # References
//!
//! * OGC 01-009 (version 1) and OGC 18-010r7 (version 2).
//! * Methods and parameters as GDAL, PROJ, ESRI and the PDS write them.

use super::wkt::Node;
use super::{Method, Parameters, ParseCrsError, Radii};

const GEOGRAPHIC: [&str; 7] =
    ["GEOGCS", "GEOGCRS", "GEOGRAPHICCRS", "GEODCRS", "GEODETICCRS", "BASEGEOGCRS", "BASEGEODCRS"];
const PROJECTED: [&str; 3] = ["PROJCS", "PROJCRS", "PROJECTEDCRS"];
const DEGREE: f64 = std::f64::consts::PI / 180.0;

/// The PROJ string of a system; of a compound system, that of its horizontal part.
pub(super) fn proj_from_wkt(root: &Node) -> Result<String, ParseCrsError> {
    let keyword = root.keyword.as_str();
    let projected = PROJECTED.contains(&keyword);
    if !projected && !GEOGRAPHIC.contains(&keyword) {
        let wraps = matches!(keyword, "COMPD_CS" | "COMPOUNDCRS" | "BOUNDCRS" | "SOURCECRS");
        let inner = wraps.then(|| {
            root.child(&PROJECTED)
                .or_else(|| root.child(&GEOGRAPHIC))
                .or_else(|| root.child(&["SOURCECRS"]))
        });
        return match inner.flatten() {
            Some(inner) => proj_from_wkt(inner),
            None => Err(ParseCrsError::not_supported(format!("{keyword} {:?}", root.name()))),
        };
    }

    let base = if projected { root.child(&GEOGRAPHIC).unwrap_or(root) } else { root };
    check_meridian(base)?;
    check_degrees(base, projected)?;
    let meters_per_unit = if projected { meters_per_unit(root)? } else { 1.0 };
    let read = Projection { root, meters_per_unit };
    let parameters = Parameters {
        ellipsoid: radii(base)?,
        method: if projected { read.method()? } else { Method::Geographic },
        false_easting_m: read.length(&["false easting"]),
        false_northing_m: read.length(&["false northing"]),
        meters_per_unit,
    };
    Ok(parameters.proj_string())
}

fn radii(base: &Node) -> Result<Radii, ParseCrsError> {
    let missing = || ParseCrsError::Missing { missing: "SPHEROID", found: base.name().to_owned() };
    let spheroid = base.descendant(&["SPHEROID", "ELLIPSOID"]).ok_or_else(missing)?;
    let mut numbers = spheroid.numbers();
    let (Some(a), Some(rf)) = (numbers.next(), numbers.next()) else { return Err(missing()) };
    let unit = spheroid.child(&["UNIT", "LENGTHUNIT"]).and_then(|unit| unit.numbers().next());
    Ok(Radii::InverseFlattening { a: a * unit.unwrap_or(1.0), rf })
}

fn check_meridian(base: &Node) -> Result<(), ParseCrsError> {
    let Some(meridian) = base.descendant(&["PRIMEM", "PRIMEMERIDIAN"]) else { return Ok(()) };
    match meridian.numbers().next() {
        None | Some(0.0) => Ok(()),
        Some(longitude) => Err(ParseCrsError::NotSupported {
            found: format!("a prime meridian at {longitude} ({})", meridian.name()),
            supported: "a prime meridian at 0",
        }),
    }
}

/// Longitudes and latitudes, if they are the map's coordinates, must be in degrees.
fn check_degrees(base: &Node, projected: bool) -> Result<(), ParseCrsError> {
    let unit = base.child(&["UNIT", "ANGLEUNIT"]).or_else(|| base.descendant(&["ANGLEUNIT"]));
    let Some(unit) = unit else { return Ok(()) };
    match unit.numbers().next() {
        Some(radians) if (radians / DEGREE - 1.0).abs() > 1e-6 && !projected => {
            Err(ParseCrsError::NotSupported {
                found: format!("an angular unit of {}", unit.name()),
                supported: "degrees",
            })
        }
        _ => Ok(()),
    }
}

fn meters_per_unit(root: &Node) -> Result<f64, ParseCrsError> {
    let axis = || root.child(&["AXIS"]).and_then(|axis| axis.child(&["LENGTHUNIT", "UNIT"]));
    let unit = root.child(&["UNIT", "LENGTHUNIT"]).or_else(axis);
    let Some(unit) = unit else { return Ok(1.0) };
    match unit.numbers().next() {
        None | Some(1.0) => Ok(1.0),
        Some(1000.0) => Ok(1000.0),
        Some(meters) => Err(ParseCrsError::NotSupported {
            found: format!("a unit of {} ({meters} m)", unit.name()),
            supported: "meters and kilometers",
        }),
    }
}

/// The projection's name and parameters.
struct Projection<'wkt> {
    root: &'wkt Node,
    meters_per_unit: f64,
}

impl Projection<'_> {
    fn method(&self) -> Result<Method, ParseCrsError> {
        let missing = || ParseCrsError::Missing {
            missing: "PROJECTION or METHOD",
            found: self.root.name().to_owned(),
        };
        let method =
            self.root.descendant(&["PROJECTION", "METHOD"]).ok_or_else(missing)?.name().to_owned();
        let lon_0 = self.angle(&[
            "central meridian",
            "longitude of natural origin",
            "longitude of origin",
            "longitude of center",
            "straight vertical longitude from pole",
        ]);
        let lat_0 =
            self.angle(&["latitude of origin", "latitude of natural origin", "latitude of center"]);
        let parallel = self.angle(&[
            "standard parallel 1",
            "latitude of 1st standard parallel",
            "latitude of standard parallel",
        ]);
        let (lon_0, origin) = (lon_0.unwrap_or(0.0), lat_0.unwrap_or(0.0));
        let scale = self.number(&["scale factor", "scale factor at natural origin"]).unwrap_or(1.0);
        let polar = |lat: f64| Method::PolarStereographic { lat, lon_0, scale };
        Ok(match plain(&method).as_str() {
            "equirectangular"
            | "equidistant cylindrical"
            | "equidistant cylindrical (spherical)"
            | "equidistant cylindrical (ellipsoidal)"
            | "plate carree"
            | "simple cylindrical" => {
                Method::Equirectangular { lon_0, lat_0: origin, lat_ts: parallel.unwrap_or(0.0) }
            }
            "polar stereographic"
            | "polar stereographic (variant a)"
            | "polar stereographic (variant b)" => {
                match parallel.or(lat_0).filter(|lat| *lat != 0.0) {
                    Some(lat) => polar(lat),
                    None => {
                        return Err(ParseCrsError::Missing {
                            missing: "the latitude of origin",
                            found: self.root.name().to_owned(),
                        });
                    }
                }
            }
            "stereographic north pole" => polar(parallel.unwrap_or(90.0)),
            "stereographic south pole" => polar(parallel.unwrap_or(-90.0)),
            "stereographic" if origin.abs() == 90.0 => polar(origin),
            _ => {
                let found = format!("{} ({method})", self.root.name());
                return Err(ParseCrsError::not_supported(found));
            }
        })
    }

    /// The parameter with one of these plain names.
    fn parameter(&self, names: &[&str]) -> Option<&Node> {
        let conversion = self.root.child(&["CONVERSION"]).unwrap_or(self.root);
        conversion
            .children()
            .filter(|node| node.keyword == "PARAMETER")
            .find(|node| names.contains(&plain(node.name()).as_str()))
    }

    fn number(&self, names: &[&str]) -> Option<f64> {
        self.parameter(names)?.numbers().next()
    }

    /// An angle in degrees.
    fn angle(&self, names: &[&str]) -> Option<f64> {
        let value = self.number(names)?;
        let unit = self.parameter(names).and_then(|node| node.child(&["ANGLEUNIT", "UNIT"]));
        Some(match unit.and_then(|unit| unit.numbers().next()) {
            // A file's 0.0174532925199433 is a degree, though it is not the nearest number to it.
            Some(radians) if (radians / DEGREE - 1.0).abs() > 1e-6 => value * radians / DEGREE,
            _ => value,
        })
    }

    /// A length in meters, 0 if it is not given.
    fn length(&self, names: &[&str]) -> f64 {
        let value = self.number(names).unwrap_or(0.0);
        let unit = self.parameter(names).and_then(|node| node.child(&["LENGTHUNIT", "UNIT"]));
        let unit = unit.and_then(|unit| unit.numbers().next()).unwrap_or(self.meters_per_unit);
        value * unit
    }
}

/// A name without the differences between dialects.
fn plain(name: &str) -> String {
    name.to_ascii_lowercase().replace('_', " ").replace("centre", "center").trim().to_owned()
}
