//! Coordinate reference systems as people and files write them.
//!
//! Everything is brought into the form of a PROJ string, which the formats crate understands:
//!
//! ```text
//!   EPSG:3031 ──┐
//!   IAU_2015:n ─┤
//!   WKT 1, 2 ───┼──▶ PROJ string ──▶ Crs
//!   geo keys ───┘
//! ```
//!
//! No crate does this for planets: `proj4wkt` lacks the equirectangular methods, and the EPSG
//! registry knows the Earth alone.

mod codes;
mod wkt;
mod wkt_crs;

use std::path::{Path, PathBuf};

use areoid_formats::projection::{Crs, CrsError};

/// What is understood, in words.
pub(crate) const SUPPORTED: &str = "geographic, equirectangular, polar stereographic";

/// A coordinate reference system that is not understood, and why.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ParseCrsError {
    /// A system of another projection, unit or meridian.
    #[error("{found} is not supported; supported: {supported}")]
    NotSupported {
        /// The system found, by its name and code where it has them.
        found: String,
        /// What would have been understood in its place.
        supported: &'static str,
    },

    /// A code that its authority does not have.
    #[error("there is no code {found}")]
    UnknownCode {
        /// The code with its authority.
        found: String,
    },

    /// A text that is none of the things it could be.
    #[error("{found:?} is no EPSG:n, IAU_2015:n, PROJ string, WKT or a file that holds one")]
    NotUnderstood {
        /// The beginning of the text.
        found: String,
    },

    /// WKT that breaks off or is not well formed.
    #[error("WKT: found {found} at byte {at}, expected {expected}")]
    Wkt {
        /// Bytes before the fault.
        at: usize,
        /// What is there.
        found: String,
        /// What should be.
        expected: &'static str,
    },

    /// A part without which the system means nothing.
    #[error("{missing} is missing in {found}")]
    Missing {
        /// The part.
        missing: &'static str,
        /// The system, by its name.
        found: String,
    },

    /// A PROJ string that is not understood.
    #[error(transparent)]
    Proj(#[from] CrsError),

    /// The file that should hold the system.
    #[error("cannot read {}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Why it failed.
        source: std::io::Error,
    },
}

impl ParseCrsError {
    pub(crate) fn not_supported(found: impl Into<String>) -> Self {
        Self::NotSupported { found: found.into(), supported: SUPPORTED }
    }
}

/// A coordinate reference system and the unit of its maps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapCrs {
    /// The system, in meters or degrees.
    pub crs: Crs,
    /// Metres to a unit of the map's coordinates; 1 for geographic systems, which are in degrees.
    pub meters_per_unit: f64,
}

impl MapCrs {
    /// The system that a text names: `EPSG:n`, `IAU_2015:n`, a PROJ string or WKT.
    ///
    /// # Errors
    ///
    /// [`ParseCrsError`] if it is none of these or of a projection that is not supported.
    pub fn from_text(text: &str) -> Result<Self, ParseCrsError> {
        let text = text.trim().trim_start_matches('\u{feff}');
        if let Some(proj) = codes::proj_from_code(text) {
            return Self::from_proj(&proj?);
        }
        if text.contains("proj=") {
            return Self::from_proj(text);
        }
        let is_keyword = |name: &str| {
            !name.trim().is_empty()
                && name.trim().chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
        };
        match text.split_once(['[', '(']) {
            Some((name, _)) if is_keyword(name) => {
                Self::from_proj(&wkt_crs::proj_from_wkt(&wkt::parse(text)?)?)
            }
            _ => {
                let found = text.chars().take(60).collect();
                Err(ParseCrsError::NotUnderstood { found })
            }
        }
    }

    /// Like [`Self::from_text`]; a text that is none of those is the path of a file that holds one.
    ///
    /// # Errors
    ///
    /// [`ParseCrsError`] as [`Self::from_text`], or if the file cannot be read.
    pub fn from_text_or_file(text: &str) -> Result<Self, ParseCrsError> {
        match Self::from_text(text) {
            Err(ParseCrsError::NotUnderstood { .. }) if Path::new(text).is_file() => {
                let path = Path::new(text);
                let held = std::fs::read(path)
                    .map_err(|source| ParseCrsError::Io { path: path.to_owned(), source })?;
                Self::from_text(&String::from_utf8_lossy(&held))
            }
            result => result,
        }
    }

    /// The system of a PROJ string.
    pub(crate) fn from_proj(proj: &str) -> Result<Self, ParseCrsError> {
        let (crs, meters_per_unit) = Crs::from_proj_string_with_unit(proj)?;
        Ok(Self { crs, meters_per_unit })
    }

    /// The system of an EPSG code.
    pub(crate) fn from_epsg(code: u16) -> Result<Self, ParseCrsError> {
        Self::from_proj(&codes::proj_from_epsg(code)?)
    }
}

/// Parameters of a projection on their way into a PROJ string.
///
/// # Units
///
/// Degrees; `false_*` in meters.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Parameters {
    /// Equatorial radius in meters, and either the polar one or the inverse flattening.
    pub(crate) ellipsoid: Radii,
    pub(crate) method: Method,
    pub(crate) false_easting_m: f64,
    pub(crate) false_northing_m: f64,
    /// Metres to a map unit.
    pub(crate) meters_per_unit: f64,
}

/// The shape of a body as files give it, in meters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Radii {
    Polar {
        a: f64,
        b: f64,
    },
    /// 0 is a sphere.
    InverseFlattening {
        a: f64,
        rf: f64,
    },
}

/// A supported projection with its angles in degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Method {
    Geographic,
    Equirectangular {
        lon_0: f64,
        lat_0: f64,
        lat_ts: f64,
    },
    /// `lat` is ±90, or the latitude of true scale on that side of the equator.
    PolarStereographic {
        lat: f64,
        lon_0: f64,
        scale: f64,
    },
}

impl Parameters {
    /// The PROJ string that says the same.
    pub(crate) fn proj_string(&self) -> String {
        let ellipsoid = match self.ellipsoid {
            Radii::Polar { a, b } => format!("+a={a} +b={b}"),
            Radii::InverseFlattening { a, rf: 0.0 } => format!("+R={a}"),
            Radii::InverseFlattening { a, rf } => format!("+a={a} +rf={rf}"),
        };
        let method = match self.method {
            Method::Geographic => return format!("+proj=longlat {ellipsoid} +no_defs"),
            Method::Equirectangular { lon_0, lat_0, lat_ts } => {
                format!("+proj=eqc +lat_ts={lat_ts} +lat_0={lat_0} +lon_0={lon_0}")
            }
            Method::PolarStereographic { lat, lon_0, scale } => {
                let lat_0 = 90.0_f64.copysign(lat);
                let at_pole = lat.abs() == 90.0;
                let lat_ts = if at_pole { String::new() } else { format!(" +lat_ts={lat}") };
                let k =
                    if at_pole || scale != 1.0 { format!(" +k={scale}") } else { String::new() };
                format!("+proj=stere +lat_0={lat_0}{lat_ts}{k} +lon_0={lon_0}")
            }
        };
        let units = match self.meters_per_unit {
            1.0 => "+units=m".to_owned(),
            1000.0 => "+units=km".to_owned(),
            meters => format!("+to_meter={meters}"),
        };
        let (x_0, y_0) = (self.false_easting_m, self.false_northing_m);
        format!("{method} +x_0={x_0} +y_0={y_0} {ellipsoid} {units} +no_defs")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(text: &str) -> MapCrs {
        MapCrs::from_text(text).unwrap_or_else(|error| panic!("{text}: {error}"))
    }

    fn same(text: &str, proj: &str) {
        assert_eq!(map(text), MapCrs::from_proj(proj).unwrap(), "{text}");
    }

    fn error(text: &str) -> String {
        MapCrs::from_text(text).unwrap_err().to_string()
    }

    const SPHERE: &str = r#"GEOGCS["GCS_Mars",DATUM["D_Mars",SPHEROID["Mars",3396190,0]],
        PRIMEM["Reference_Meridian",0],UNIT["degree",0.0174532925199433]]"#;

    fn projected(method: &str, parameters: &[(&str, f64)], unit: f64) -> String {
        let parameters: String = parameters
            .iter()
            .map(|(name, value)| format!(r#"PARAMETER["{name}",{value}],"#))
            .collect();
        format!(
            r#"PROJCS["a map",{SPHERE},PROJECTION["{method}"],{parameters}UNIT["a unit",{unit}]]"#
        )
    }

    #[test]
    fn the_codes_of_terrain_data_are_understood() {
        for code in [4326, 4269, 3031, 3413, 3411, 3412, 3976, 3995, 5041, 5042, 4087, 32662] {
            map(&format!("EPSG:{code}"));
        }
        for code in [49900, 49901, 49910, 49915, 49930, 49935, 30100, 30135, 19910, 29930] {
            map(&format!("IAU_2015:{code}"));
        }
    }

    #[test]
    fn version_1_is_understood_in_the_words_of_gdal_and_esri() {
        same(SPHERE, "+proj=longlat +R=3396190");
        let parameters = [("standard_parallel_1", -10.0), ("central_meridian", 180.0)];
        for name in ["Equirectangular", "Equidistant_Cylindrical", "Plate_Carree"] {
            same(&projected(name, &parameters, 1.0), "+proj=eqc +lat_ts=-10 +lon_0=180 +R=3396190");
        }
        let pole = |latitude| [("latitude_of_origin", latitude), ("central_meridian", 30.0)];
        let north = "+proj=stere +lat_0=90 +lon_0=30 +k=1 +R=3396190";
        let south = "+proj=stere +lat_0=-90 +lat_ts=-71 +lon_0=30 +R=3396190";
        same(&projected("Polar_Stereographic", &pole(90.0), 1.0), north);
        same(&projected("Stereographic", &pole(90.0), 1.0), north);
        same(&projected("Polar_Stereographic", &pole(-71.0), 1.0), south);
        let esri = [("Standard_Parallel_1", -71.0), ("Central_Meridian", 30.0)];
        same(&projected("Stereographic_South_Pole", &esri, 1.0), south);
    }

    #[test]
    fn version_2_is_understood() {
        let wkt = r#"PROJCRS["WGS 84 / Antarctic Polar Stereographic",
            BASEGEOGCRS["WGS 84",DATUM["World Geodetic System 1984",
                ELLIPSOID["WGS 84",6378137,298.257223563,LENGTHUNIT["metre",1]]],
                PRIMEM["Greenwich",0,ANGLEUNIT["degree",0.0174532925199433]]],
            CONVERSION["Antarctic Polar Stereographic",
                METHOD["Polar Stereographic (variant B)",ID["EPSG",9829]],
                PARAMETER["Latitude of standard parallel",-71,ANGLEUNIT["degree",0.0174532925199433]],
                PARAMETER["Longitude of origin",0,ANGLEUNIT["degree",0.0174532925199433]],
                PARAMETER["False easting",3,LENGTHUNIT["kilometre",1000]]],
            CS[Cartesian,2],
                AXIS["easting (X)",north,ORDER[1],LENGTHUNIT["metre",1]],
                AXIS["northing (Y)",north,ORDER[2],LENGTHUNIT["metre",1]],
            ID["EPSG",3031]]"#;
        same(wkt, "+proj=stere +lat_0=-90 +lat_ts=-71 +lon_0=0 +x_0=3000 +datum=WGS84");
        let compound = format!(r#"COMPOUNDCRS["both",{wkt},VERTCRS["heights"]]"#);
        assert_eq!(map(&compound), map(wkt));
    }

    #[test]
    fn kilometers_come_with_their_factor() {
        let parameters = [("false_easting", 2.0)];
        let found = map(&projected("Equirectangular", &parameters, 1000.0));
        assert_eq!(found.meters_per_unit, 1000.0);
        let meters = map("+proj=eqc +R=3396190 +x_0=2000");
        assert_eq!(found.crs, meters.crs);
    }

    #[test]
    fn what_is_not_understood_is_named() {
        let sinusoidal = projected("Sinusoidal", &[], 1.0);
        assert_eq!(
            error(&sinusoidal),
            "a map (Sinusoidal) is not supported; \
             supported: geographic, equirectangular, polar stereographic"
        );
        assert!(error(&projected("Equirectangular", &[], 0.3048)).contains("a unit (0.3048 m)"));
        assert!(error(&SPHERE.replace("Meridian\",0", "Meridian\",2")).contains("meridian at 2"));
        assert!(error(&SPHERE.replace("0.0174", "1.0174")).contains("angular unit"));
        assert!(error(&SPHERE.replace("SPHEROID", "S")).contains("SPHEROID is missing"));
        assert!(error("LOCAL_CS[\"plan\"]").contains("LOCAL_CS \"plan\""));
        assert!(error("EPSG:32613").contains("UTM zone 13N"));
        assert!(error("the usual one").contains("is no EPSG:n"));
        assert!(error("+proj=utm +zone=13").contains("utm"));
        assert!(error("").contains("is no EPSG:n"));
    }

    #[test]
    fn a_file_may_hold_any_of_them() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mars.wkt");
        std::fs::write(&path, format!("\u{feff}{SPHERE}\n")).unwrap();
        let found = MapCrs::from_text_or_file(path.to_str().unwrap()).unwrap();
        assert_eq!(found, map("IAU_2015:49900"));
        assert!(MapCrs::from_text_or_file("/nonexistent.prj").is_err());
    }
}
