//! Systems by their code: the EPSG registry and the IAU's planets.
//!
//! # References
//!
//! * The EPSG Geodetic Parameter Dataset, through the crate `crs-definitions`.
//! * IAU_2015 of the OGC: a code is the body's NAIF number × 100 plus the system's number, as in
//!   J.-C. Malapert et al., *IAU:2015 coordinate reference systems*, and PROJ's database.

use super::{Method, Parameters, ParseCrsError, Radii};

/// Radii in meters, equatorial and polar, of the bodies of IAU_2015 by their NAIF number.
const IAU_2015: [(u32, f64, f64); 5] = [
    (199, 2_440_530.0, 2_438_260.0),
    (299, 6_051_800.0, 6_051_800.0),
    (301, 1_737_400.0, 1_737_400.0),
    (399, 6_378_136.6, 6_356_751.9),
    (499, 3_396_190.0, 3_376_200.0),
];

/// The PROJ string of `EPSG:n` or `IAU_2015:n`; `None` if the text is no code at all.
pub(super) fn proj_from_code(text: &str) -> Option<Result<String, ParseCrsError>> {
    let unknown = || ParseCrsError::UnknownCode { found: text.to_owned() };
    let (authority, code) = match text.strip_prefix("urn:ogc:def:crs:") {
        Some(urn) => (urn.split(':').next()?, urn.rsplit(':').next()?),
        None => text.split_once(':')?,
    };
    let is_code = !code.trim().is_empty() && code.trim().bytes().all(|byte| byte.is_ascii_digit());
    if !is_code {
        return None;
    }
    Some(match authority.to_ascii_uppercase().as_str() {
        "EPSG" => code.trim().parse().map_err(|_| unknown()).and_then(proj_from_epsg),
        "IAU_2015" => code.trim().parse().map_err(|_| unknown()).and_then(proj_from_iau),
        _ => Err(unknown()),
    })
}

/// The PROJ string of an EPSG code.
pub(super) fn proj_from_epsg(code: u16) -> Result<String, ParseCrsError> {
    let unknown = || ParseCrsError::UnknownCode { found: format!("EPSG:{code}") };
    let definition = crs_definitions::from_code(code).ok_or_else(unknown)?;
    let terms: Vec<&str> = definition.proj4.split_whitespace().collect();
    let value = |key: &str| terms.iter().find_map(|term| term.strip_prefix(key));
    if !matches!(value("+proj="), Some("longlat" | "latlong" | "eqc" | "stere")) {
        // The name is the first quoted text of the WKT: PROJCS["WGS 84 / UTM zone 13N",...
        let name = definition.wkt.split('"').nth(1).unwrap_or("a system");
        return Err(ParseCrsError::not_supported(format!("{name} (EPSG:{code})")));
    }
    // Polar systems are written here with a latitude of true scale *and* a scale factor, of which
    // the one that says nothing (90° or 1) goes.
    let at_pole = matches!(value("+lat_ts="), Some("90" | "-90"));
    let says_something = |term: &&&str| match **term {
        "+lat_ts=90" | "+lat_ts=-90" => value("+k=").is_none(),
        "+k=1" => at_pole || value("+lat_ts=").is_none(),
        _ => true,
    };
    Ok(terms.iter().filter(says_something).copied().collect::<Vec<_>>().join(" "))
}

/// The PROJ string of a code of IAU_2015.
fn proj_from_iau(code: u32) -> Result<String, ParseCrsError> {
    let unknown = || ParseCrsError::UnknownCode { found: format!("IAU_2015:{code}") };
    let body = IAU_2015.iter().find(|(number, _, _)| *number == code / 100);
    let &(_, a, b) = body.ok_or_else(unknown)?;
    let sphere = Radii::Polar { a, b: a };
    let (ellipsoid, method) = match code % 100 {
        0 => (sphere, Method::Geographic),
        1 if a != b => (Radii::Polar { a, b }, Method::Geographic),
        10 => (sphere, Method::Equirectangular { lon_0: 0.0, lat_0: 0.0, lat_ts: 0.0 }),
        15 => (sphere, Method::Equirectangular { lon_0: 180.0, lat_0: 0.0, lat_ts: 0.0 }),
        30 => (sphere, Method::PolarStereographic { lat: 90.0, lon_0: 0.0, scale: 1.0 }),
        35 => (sphere, Method::PolarStereographic { lat: -90.0, lon_0: 0.0, scale: 1.0 }),
        _ => {
            return Err(ParseCrsError::NotSupported {
                found: format!("IAU_2015:{code}"),
                supported: "the codes that end in 00, 01, 10, 15, 30 and 35",
            });
        }
    };
    let parameters = Parameters {
        ellipsoid,
        method,
        false_easting_m: 0.0,
        false_northing_m: 0.0,
        meters_per_unit: 1.0,
    };
    Ok(parameters.proj_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn proj(text: &str) -> String {
        proj_from_code(text).unwrap().unwrap()
    }

    #[test]
    fn polar_codes_keep_the_scale_that_says_something() {
        assert_eq!(
            proj("EPSG:3031"),
            "+proj=stere +lat_0=-90 +lat_ts=-71 +lon_0=0 +x_0=0 +y_0=0 +datum=WGS84 +units=m +no_defs"
        );
        assert_eq!(
            proj("epsg:5041"),
            "+proj=stere +lat_0=90 +lon_0=0 +k=0.994 +x_0=2000000 +y_0=2000000 +datum=WGS84 +units=m +no_defs"
        );
        assert_eq!(proj("urn:ogc:def:crs:EPSG::4326"), proj("EPSG:4326"));
    }

    #[test]
    fn codes_of_the_planets_are_spheres_but_for_ographic() {
        assert_eq!(proj("IAU_2015:49900"), "+proj=longlat +a=3396190 +b=3396190 +no_defs");
        assert_eq!(proj("IAU_2015:49901"), "+proj=longlat +a=3396190 +b=3376200 +no_defs");
        assert_eq!(
            proj("IAU_2015:30135"),
            "+proj=stere +lat_0=-90 +k=1 +lon_0=0 +x_0=0 +y_0=0 +a=1737400 +b=1737400 +units=m +no_defs"
        );
    }

    #[test]
    fn other_projections_are_named_with_what_would_do() {
        let error = proj_from_epsg(32613).unwrap_err().to_string();
        assert_eq!(
            error,
            "WGS 84 / UTM zone 13N (EPSG:32613) is not supported; \
             supported: geographic, equirectangular, polar stereographic"
        );
        assert!(proj_from_epsg(1).is_err());
        assert!(matches!(proj_from_code("EPSG:99999999"), Some(Err(_))));
        assert!(proj_from_code("C:\\mars.prj").is_none());
    }
}
