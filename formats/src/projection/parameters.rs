//! The parameters of a PROJ string, read one at a time and with their units.
//!
//! # References
//!
//! PROJ 9.5, *Using PROJ*: cartographic projection, ellipsoids, units. The tables hold what
//! planetary and polar rasters name; anything else can be written in numbers.

use crate::body::{Ellipsoid, EllipsoidError};
use crate::units::{Degrees, Meters, Radians};

/// A PROJ string that cannot be understood, and why.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CrsError {
    /// Something PROJ may know and this system does not.
    #[error("{found} is not supported: expected {supported}")]
    NotSupported {
        /// The parameter found, with its value.
        found: String,
        /// What would have been understood in its place.
        supported: String,
    },

    /// A parameter without which the string means nothing.
    #[error("no {parameter} in the PROJ string {found:?}")]
    Missing {
        /// The parameters of which one is needed.
        parameter: &'static str,
        /// The whole text.
        found: String,
    },

    /// A parameter whose value makes no sense.
    #[error("{found} makes no sense: expected {expected}")]
    Value {
        /// The parameter found, with its value.
        found: String,
        /// What its value should be.
        expected: &'static str,
    },

    /// Radii that make no ellipsoid.
    #[error("the surface makes no sense: {0}")]
    Ellipsoid(#[from] EllipsoidError),
}

/// How the definition of a named ellipsoid gives its polar radius.
#[derive(Clone, Copy)]
enum Shape {
    Polar(f64),
    InverseFlattening(f64),
}

/// PROJ's names of ellipsoids, with their equatorial radii.
const ELLIPSOIDS: [(&str, f64, Shape); 9] = [
    ("WGS84", 6_378_137.0, Shape::InverseFlattening(298.257_223_563)),
    ("GRS80", 6_378_137.0, Shape::InverseFlattening(298.257_222_101)),
    ("WGS72", 6_378_135.0, Shape::InverseFlattening(298.26)),
    ("intl", 6_378_388.0, Shape::InverseFlattening(297.0)),
    ("clrk66", 6_378_206.4, Shape::Polar(6_356_583.8)),
    ("bessel", 6_377_397.155, Shape::InverseFlattening(299.152_812_8)),
    ("krass", 6_378_245.0, Shape::InverseFlattening(298.3)),
    ("airy", 6_377_563.396, Shape::InverseFlattening(299.324_964_6)),
    ("sphere", 6_370_997.0, Shape::Polar(6_370_997.0)),
];

/// PROJ's names of datums, with their ellipsoids. Datums are not shifted: one body, one surface.
const DATUMS: [(&str, &str); 2] = [("WGS84", "WGS84"), ("NAD83", "GRS80")];

/// PROJ's names of lengths, in meters.
const UNITS: [(&str, f64); 7] = [
    ("m", 1.0),
    ("km", 1000.0),
    ("dm", 0.1),
    ("cm", 0.01),
    ("mm", 0.001),
    ("ft", 0.3048),
    ("us-ft", 1200.0 / 3937.0),
];

/// Parameters every projection has.
const COMMON: [&str; 12] =
    ["proj", "R", "a", "b", "rf", "f", "ellps", "datum", "units", "to_meter", "pm", "axis"];

/// Parameters that change nothing here: about height, the output's range, or datum shifts, which
/// are never applied.
const IGNORED: [&str; 12] = [
    "no_defs",
    "type",
    "wktext",
    "towgs84",
    "nadgrids",
    "geoidgrids",
    "geoid_crs",
    "vunits",
    "vto_meter",
    "over",
    "lon_wrap",
    "title",
];

/// A PROJ string cut into its parameters. Where one is repeated the first counts, as in PROJ.
pub(super) struct Parameters<'a> {
    text: &'a str,
    pairs: Vec<(&'a str, &'a str)>,
}

impl<'a> Parameters<'a> {
    pub(super) fn new(text: &'a str) -> Self {
        let pair = |token: &'a str| {
            let token = token.strip_prefix('+').unwrap_or(token);
            token.split_once('=').unwrap_or((token, ""))
        };
        Self { text, pairs: text.split_whitespace().map(pair).collect() }
    }

    pub(super) fn text(&self, key: &str) -> Option<&'a str> {
        self.pairs.iter().find(|(name, _)| *name == key).map(|(_, value)| *value)
    }

    pub(super) fn missing(&self, parameter: &'static str) -> CrsError {
        CrsError::Missing { parameter, found: self.text.to_owned() }
    }

    /// The number of `key`, finite.
    pub(super) fn number(&self, key: &str) -> Result<Option<f64>, CrsError> {
        let Some(value) = self.text(key) else { return Ok(None) };
        match value.parse::<f64>() {
            Ok(number) if number.is_finite() => Ok(Some(number)),
            _ => Err(bad_value(key, value, "a finite number")),
        }
    }

    /// The angle of `key`, 0 where there is none: degrees, or radians with the suffix `r`.
    pub(super) fn angle(&self, key: &str) -> Result<Radians, CrsError> {
        let value = self.text(key).unwrap_or("0");
        let (digits, is_radians) = match value.strip_suffix('r') {
            Some(digits) => (digits, true),
            None => (value, false),
        };
        match digits.parse::<f64>() {
            Ok(angle) if angle.is_finite() && is_radians => Ok(Radians(angle)),
            Ok(angle) if angle.is_finite() => Ok(Degrees(angle).into()),
            _ => Err(bad_value(key, value, "decimal degrees, or radians with the suffix r")),
        }
    }

    /// The length of `key` in meters, 0 where there is none.
    pub(super) fn meters(&self, key: &str) -> Result<Meters, CrsError> {
        Ok(Meters(self.number(key)?.unwrap_or(0.0)))
    }

    /// Refuses parameters that are neither common to all projections nor in `own`.
    pub(super) fn expect_only(&self, own: &[&str]) -> Result<(), CrsError> {
        let known = |key| COMMON.contains(&key) || IGNORED.contains(&key) || own.contains(&key);
        match self.pairs.iter().find(|(key, _)| !known(*key)) {
            None => Ok(()),
            Some((key, value)) => Err(not_supported(key, value, &format!("only {own:?} with it"))),
        }
    }

    /// The surface: `+R` alone, or a size and a shape, each by name or in numbers.
    pub(super) fn ellipsoid(&self) -> Result<Ellipsoid, CrsError> {
        if let Some(radius) = self.number("R")? {
            return Ok(Ellipsoid::sphere(Meters(radius))?);
        }

        let named = self.named_ellipsoid()?;
        let size = self.number("a")?.or(named.map(|(equatorial, _)| equatorial));
        let a = size.ok_or_else(|| self.missing("+R, +a, +ellps or +datum"))?;
        // In PROJ's order, should a string give more than one.
        let b = if let Some(inverse) = self.number("rf")? {
            a * (1.0 - 1.0 / inverse)
        } else if let Some(flattening) = self.number("f")? {
            a * (1.0 - flattening)
        } else if let Some(polar) = self.number("b")? {
            polar
        } else {
            match named {
                Some((_, Shape::InverseFlattening(inverse))) => a * (1.0 - 1.0 / inverse),
                Some((equatorial, Shape::Polar(polar))) => a * (polar / equatorial),
                None => a,
            }
        };
        Ok(Ellipsoid::new(Meters(a), Meters(b))?)
    }

    /// Meters to a unit of the map.
    pub(super) fn meters_per_unit(&self) -> Result<f64, CrsError> {
        if let Some(factor) = self.number("to_meter")? {
            let text = self.text("to_meter").unwrap_or_default();
            let positive = (factor > 0.0).then_some(factor);
            return positive.ok_or_else(|| bad_value("to_meter", text, "a positive number"));
        }
        let name = self.text("units").unwrap_or("m");
        let unit = UNITS.iter().find(|(unit, _)| *unit == name);
        unit.map(|(_, factor)| *factor)
            .ok_or_else(|| not_supported("units", name, &one_of(UNITS.map(|unit| unit.0))))
    }

    /// Refuses prime meridians and axes other than the usual.
    pub(super) fn expect_usual_axes(&self) -> Result<(), CrsError> {
        if let Some(meridian) = self.text("pm") {
            let is_zero = meridian.parse() == Ok(0.0) || meridian.eq_ignore_ascii_case("greenwich");
            if !is_zero {
                return Err(not_supported("pm", meridian, "+pm=0"));
            }
        }
        match self.text("axis") {
            None | Some("enu") => Ok(()),
            Some(axis) => Err(not_supported("axis", axis, "+axis=enu")),
        }
    }

    /// The size and shape that `+ellps` or `+datum` names.
    fn named_ellipsoid(&self) -> Result<Option<(f64, Shape)>, CrsError> {
        let name = match (self.text("ellps"), self.text("datum")) {
            (Some(name), _) => name,
            (None, Some(datum)) => {
                let known = DATUMS.iter().find(|(name, _)| *name == datum);
                let names = DATUMS.map(|datum| datum.0);
                known.ok_or_else(|| not_supported("datum", datum, &one_of(names)))?.1
            }
            (None, None) => return Ok(None),
        };
        let known = ELLIPSOIDS.iter().find(|(known, ..)| *known == name);
        let names = ELLIPSOIDS.map(|ellipsoid| ellipsoid.0);
        let &(_, a, shape) = known.ok_or_else(|| not_supported("ellps", name, &one_of(names)))?;
        Ok(Some((a, shape)))
    }
}

pub(super) fn not_supported(key: &str, value: &str, supported: &str) -> CrsError {
    CrsError::NotSupported { found: shown(key, value), supported: supported.to_owned() }
}

pub(super) fn bad_value(key: &str, value: &str, expected: &'static str) -> CrsError {
    CrsError::Value { found: shown(key, value), expected }
}

/// A parameter as it stood in the string.
fn shown(key: &str, value: &str) -> String {
    if value.is_empty() { format!("+{key}") } else { format!("+{key}={value}") }
}

fn one_of<const N: usize>(names: [&str; N]) -> String {
    format!("one of {}", names.join(", "))
}
