//! Coordinate reference systems as PROJ strings, and serialised as such.
//!
//! ```text
//! +proj=longlat +R=3396190 +no_defs
//! +proj=eqc +lat_ts=0 +lat_0=0 +lon_0=180 +x_0=0 +y_0=0 +R=3396190 +units=m +no_defs
//! +proj=stere +lat_0=90 +lon_0=0 +k=1 +x_0=0 +y_0=0 +R=3396190 +units=m +no_defs
//! +proj=stere +lat_0=-90 +lat_ts=-71 +lon_0=0 +x_0=0 +y_0=0 +datum=WGS84 +units=m +no_defs
//! ```
//!
//! Numbers are written as the shortest decimals that read back equal. An angle that no number of
//! degrees reaches (they are sparser than radians in places) is written in radians: `0.5r`.

use std::f64::consts::FRAC_PI_2;

use serde::{Deserialize, Serialize};

use super::parameters::{CrsError, Parameters, bad_value, not_supported};
use super::{Crs, Equirectangular, PolarScale, PolarStereographic, Pole, Projection};
use crate::body::Ellipsoid;
use crate::geodesy::LatitudeKind;
use crate::units::{Degrees, Meters, Radians};

impl Crs {
    /// The projection and its ellipsoid as a PROJ string that reads back equal to the last bit.
    ///
    /// What the latitudes mean on the body is not in it: PROJ has no word for that.
    #[must_use]
    pub fn proj_string(&self) -> String {
        let surface = surface(&self.ellipsoid);
        match &self.projection {
            Projection::Geographic => format!("+proj=longlat {surface} +no_defs"),
            Projection::Equirectangular(map) => format!(
                "+proj=eqc +lat_ts={} +lat_0={} +lon_0={} +x_0={} +y_0={} {surface} +units=m \
                 +no_defs",
                angle(map.standard_parallel),
                angle(map.latitude_of_origin),
                angle(map.central_meridian),
                map.false_easting.0,
                map.false_northing.0,
            ),
            Projection::PolarStereographic(map) => {
                let lon_0 = angle(map.central_meridian);
                let scale = match map.scale {
                    PolarScale::AtPole(scale) => format!("+lon_0={lon_0} +k={scale}"),
                    PolarScale::TrueAt(at) => format!("+lat_ts={} +lon_0={lon_0}", angle(at)),
                };
                format!(
                    "+proj=stere +lat_0={} {scale} +x_0={} +y_0={} {surface} +units=m +no_defs",
                    90.0 * map.pole.sign(),
                    map.false_easting.0,
                    map.false_northing.0,
                )
            }
        }
    }

    /// The system that a PROJ string in meters or degrees describes, its latitudes planetographic
    /// on a body of its own ellipsoid.
    ///
    /// # Domain
    ///
    /// `longlat`, `eqc`, polar `stere` and `ups`, on a surface that the string names or measures: a
    /// planet is never guessed. Datum shifts and vertical units are read over.
    ///
    /// # Errors
    ///
    /// [`CrsError`] if the string is not understood, or its map unit is not the meter; see
    /// [`Self::from_proj_string_with_unit`].
    pub fn from_proj_string(text: &str) -> Result<Self, CrsError> {
        let (crs, meters_per_unit) = Self::from_proj_string_with_unit(text)?;
        if meters_per_unit == 1.0 {
            return Ok(crs);
        }
        let found = format!("a map unit of {meters_per_unit} m");
        Err(CrsError::NotSupported { found, supported: "+units=m".to_owned() })
    }

    /// The same, and the meters to a unit of the string's map: 1 for degrees.
    ///
    /// The system itself is in meters whatever the string says. Its caller scales: a raster in
    /// kilometers has a geotransform that is a thousand times larger in meters.
    ///
    /// # Errors
    ///
    /// [`CrsError`] if the string is not understood.
    pub fn from_proj_string_with_unit(text: &str) -> Result<(Self, f64), CrsError> {
        let parameters = Parameters::new(text);
        let name = parameters.text("proj").ok_or_else(|| parameters.missing("+proj"))?;
        let projection = match name {
            "longlat" | "latlong" | "lonlat" | "latlon" => geographic(&parameters)?,
            "eqc" => equirectangular(&parameters)?,
            "stere" => polar_stereographic(&parameters)?,
            "ups" => universal_polar_stereographic(&parameters)?,
            _ => return Err(not_supported("proj", name, "longlat, eqc, polar stere or ups")),
        };
        parameters.expect_usual_axes()?;
        let meters_per_unit = match projection {
            Projection::Geographic => 1.0,
            _ => parameters.meters_per_unit()?,
        };
        Ok((Self::new(projection, parameters.ellipsoid()?), meters_per_unit))
    }
}

fn geographic(parameters: &Parameters<'_>) -> Result<Projection, CrsError> {
    parameters.expect_only(&["lon_0"])?;
    if parameters.angle("lon_0")?.0 != 0.0 {
        let value = parameters.text("lon_0").unwrap_or_default();
        return Err(not_supported("lon_0", value, "+lon_0=0 with longlat"));
    }
    Ok(Projection::Geographic)
}

fn equirectangular(parameters: &Parameters<'_>) -> Result<Projection, CrsError> {
    parameters.expect_only(&["lon_0", "lat_0", "lat_ts", "x_0", "y_0"])?;
    let standard_parallel = parameters.angle("lat_ts")?;
    if standard_parallel.0.abs() >= FRAC_PI_2 {
        let value = parameters.text("lat_ts").unwrap_or_default();
        return Err(bad_value("lat_ts", value, "a latitude between the poles"));
    }
    Ok(Projection::Equirectangular(Equirectangular {
        central_meridian: parameters.angle("lon_0")?,
        standard_parallel,
        latitude_of_origin: parameters.angle("lat_0")?,
        false_easting: parameters.meters("x_0")?,
        false_northing: parameters.meters("y_0")?,
    }))
}

fn polar_stereographic(parameters: &Parameters<'_>) -> Result<Projection, CrsError> {
    /// Radians within which `+lat_0` is the pole, and `+lat_ts` too: PROJ's own.
    const AT_POLE: f64 = 1e-10;

    parameters.expect_only(&["lon_0", "lat_0", "lat_ts", "k", "k_0", "x_0", "y_0"])?;
    let center = parameters.angle("lat_0")?;
    if (center.0.abs() - FRAC_PI_2).abs() > AT_POLE {
        let value = parameters.text("lat_0").unwrap_or("0");
        return Err(not_supported("lat_0", value, "+lat_0=90 or +lat_0=-90 with stere"));
    }

    let key = if parameters.text("k_0").is_some() { "k_0" } else { "k" };
    let scale_at_pole = parameters.number(key)?.unwrap_or(1.0);
    let scale_text = parameters.text(key).unwrap_or_default();
    if scale_at_pole <= 0.0 {
        return Err(bad_value(key, scale_text, "a positive number"));
    }
    let parallel = match parameters.text("lat_ts") {
        Some(_) => parameters.angle("lat_ts")?,
        None => center,
    };
    let distance_to_pole = FRAC_PI_2 - parallel.0.abs();
    let scale = if distance_to_pole.abs() <= AT_POLE {
        PolarScale::AtPole(scale_at_pole)
    } else if distance_to_pole < 0.0 {
        let value = parameters.text("lat_ts").unwrap_or_default();
        return Err(bad_value("lat_ts", value, "a latitude"));
    } else if scale_at_pole == 1.0 {
        PolarScale::TrueAt(parallel)
    } else {
        return Err(not_supported(key, scale_text, "a scale factor or +lat_ts, not both"));
    };

    Ok(Projection::PolarStereographic(PolarStereographic {
        pole: if center.0 > 0.0 { Pole::North } else { Pole::South },
        central_meridian: parameters.angle("lon_0")?,
        scale,
        false_easting: parameters.meters("x_0")?,
        false_northing: parameters.meters("y_0")?,
    }))
}

fn universal_polar_stereographic(parameters: &Parameters<'_>) -> Result<Projection, CrsError> {
    parameters.expect_only(&["south"])?;
    Ok(Projection::PolarStereographic(PolarStereographic {
        pole: if parameters.text("south").is_some() { Pole::South } else { Pole::North },
        central_meridian: Radians(0.0),
        scale: PolarScale::AtPole(0.994),
        false_easting: Meters(2e6),
        false_northing: Meters(2e6),
    }))
}

/// An angle such that [`Parameters::angle`] gives it back: rounded degrees, degrees, or radians.
fn angle(angle: Radians) -> String {
    /// Degrees have this many decimals where people chose them.
    const ROUNDED: f64 = 1e9;

    let degrees = Degrees::from(angle).0;
    // Adding 0 turns -0 into 0.
    let rounded = (degrees * ROUNDED).round() / ROUNDED + 0.0;
    [rounded, degrees, degrees.next_down(), degrees.next_up()]
        .into_iter()
        .find(|candidate| Radians::from(Degrees(*candidate)) == angle)
        .map_or_else(|| format!("{}r", angle.0), |degrees| degrees.to_string())
}

fn surface(ellipsoid: &Ellipsoid) -> String {
    let (a, b) = (ellipsoid.a().0, ellipsoid.b().0);
    if *ellipsoid == Ellipsoid::WGS84 {
        "+datum=WGS84".to_owned()
    } else if ellipsoid.is_sphere() {
        format!("+R={a}")
    } else {
        format!("+a={a} +b={b}")
    }
}

/// A [`Crs`] as it is stored.
#[derive(Serialize, Deserialize)]
#[serde(rename = "Crs")]
struct StoredCrs {
    proj: String,
    latitudes: LatitudeKind,
    body: Ellipsoid,
}

impl Serialize for Crs {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        StoredCrs { proj: self.proj_string(), latitudes: self.latitudes, body: self.body }
            .serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Crs {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let stored = StoredCrs::deserialize(deserializer)?;
        let crs = Self::from_proj_string(&stored.proj).map_err(serde::de::Error::custom)?;
        Ok(crs.on_body(stored.body, stored.latitudes))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_strings_of_planetary_products_are_written_as_they_are_read() {
        for text in [
            "+proj=longlat +R=3396190 +no_defs",
            "+proj=longlat +datum=WGS84 +no_defs",
            "+proj=eqc +lat_ts=-22.5 +lat_0=0 +lon_0=180 +x_0=0 +y_0=0 +R=1737400 +units=m +no_defs",
            "+proj=stere +lat_0=90 +lon_0=0 +k=1 +x_0=0 +y_0=0 +a=3396190 +b=3376200 +units=m +no_defs",
            "+proj=stere +lat_0=-90 +lat_ts=-71 +lon_0=0 +x_0=0 +y_0=0 +datum=WGS84 +units=m +no_defs",
        ] {
            assert_eq!(Crs::from_proj_string(text).unwrap().proj_string(), text);
        }
    }

    /// No float of degrees becomes these radians: the products skip one float in ten.
    #[test]
    fn angles_that_degrees_cannot_reach_are_written_in_radians() {
        let (mut below, mut in_radians) = (1.7_f64, 0);
        for _ in 0..1000 {
            let text = angle(Radians(below));
            let text = format!("x={text}");
            assert_eq!(Parameters::new(&text).angle("x").unwrap(), Radians(below));
            in_radians += u32::from(text.ends_with('r'));
            below = below.next_down();
        }
        assert!(in_radians > 0, "the case does not arise");
    }

    #[test]
    fn surfaces_are_read_in_every_way_proj_writes_them() {
        let surface = |text: &str| {
            let crs = Crs::from_proj_string(&format!("+proj=longlat {text}")).unwrap();
            (crs.ellipsoid.a().0, crs.ellipsoid.b().0)
        };
        assert_eq!(surface("+R=5"), (5.0, 5.0));
        assert_eq!(surface("+a=5"), (5.0, 5.0));
        assert_eq!(surface("+a=5 +b=4"), (5.0, 4.0));
        assert_eq!(surface("+a=5 +rf=5"), (5.0, 4.0));
        assert_eq!(surface("+a=5 +f=0"), (5.0, 5.0));
        assert_eq!(surface("+ellps=sphere"), (6_370_997.0, 6_370_997.0));
        assert_eq!(surface("+ellps=clrk66"), (6_378_206.4, 6_356_583.8));
        let wgs84 = (Ellipsoid::WGS84.a().0, Ellipsoid::WGS84.b().0);
        assert_eq!(surface("+ellps=WGS84"), wgs84);
        assert_eq!(surface("+datum=WGS84 +towgs84=0,0,0 +type=crs"), wgs84);
    }

    #[test]
    fn map_units_are_told_and_never_passed_over() {
        let text = "+proj=eqc +R=3396190 +x_0=7 +units=km";
        let (crs, meters_per_unit) = Crs::from_proj_string_with_unit(text).unwrap();
        assert_eq!(meters_per_unit, 1000.0);
        assert_eq!(crs, Crs::from_proj_string("+proj=eqc +R=3396190 +x_0=7").unwrap());
        assert!(Crs::from_proj_string(text).unwrap_err().to_string().contains("1000 m"));

        let degrees = Crs::from_proj_string_with_unit("+proj=longlat +R=1 +units=km").unwrap();
        assert_eq!(degrees.1, 1.0);
    }

    #[test]
    fn errors_name_what_was_found_and_what_is_supported() {
        for (text, found, expected) in [
            ("+proj=utm +zone=33 +datum=WGS84", "+proj=utm is not supported", "polar stere"),
            ("+proj=stere +lat_0=45 +R=1", "+lat_0=45 is not supported", "+lat_0=90"),
            ("+proj=stere +R=1", "+lat_0=0 is not supported", "+lat_0=90"),
            ("+proj=stere +lat_0=90 +k=2 +lat_ts=70 +R=1", "+k=2 is not supported", "not both"),
            ("+proj=stere +lat_0=90 +k=0 +R=1", "+k=0 makes no sense", "positive"),
            ("+proj=stere +lat_0=90 +lat_ts=91 +R=1", "+lat_ts=91 makes no sense", "latitude"),
            ("+proj=eqc +lat_ts=90 +R=1", "+lat_ts=90 makes no sense", "between the poles"),
            ("+proj=eqc +lon_0=10d30E +R=1", "+lon_0=10d30E makes no sense", "decimal degrees"),
            ("+proj=eqc +alpha=3 +R=1", "+alpha=3 is not supported", "lat_ts"),
            ("+proj=longlat +R=1 +pm=paris", "+pm=paris is not supported", "+pm=0"),
            ("+proj=longlat +R=1 +axis=neu", "+axis=neu is not supported", "enu"),
            ("+proj=longlat +R=1 +lon_0=180", "+lon_0=180 is not supported", "+lon_0=0"),
            ("+proj=longlat +ellps=mars", "+ellps=mars is not supported", "WGS84"),
            ("+proj=longlat +datum=NAD27", "+datum=NAD27 is not supported", "NAD83"),
            ("+proj=eqc +R=1 +units=link", "+units=link is not supported", "us-ft"),
            ("+proj=longlat +a=wide", "+a=wide makes no sense", "a finite number"),
            ("+proj=longlat +a=1 +b=2", "the surface makes no sense", "prolate"),
            ("+proj=longlat", "no +R", "+datum"),
            ("EPSG:4326", "no +proj", "EPSG:4326"),
            ("", "no +proj", ""),
        ] {
            let message = Crs::from_proj_string(text).unwrap_err().to_string();
            assert!(message.contains(found) && message.contains(expected), "{text}: {message}");
        }
    }

    #[test]
    fn a_system_is_stored_with_its_body_and_latitudes() {
        let body = Ellipsoid::new(Meters(3_396_190.0), Meters(3_376_200.0)).unwrap();
        let crs = Crs::from_proj_string("+proj=longlat +R=3396190").unwrap();
        let json = serde_json::to_value(crs.on_body(body, LatitudeKind::Planetocentric)).unwrap();
        let expected = serde_json::json!({
            "proj": "+proj=longlat +R=3396190 +no_defs",
            "latitudes": "planetocentric",
            "body": { "a": 3_396_190.0, "b": 3_376_200.0 },
        });
        assert_eq!(json, expected);
    }
}
