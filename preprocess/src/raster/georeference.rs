//! Where a raster lies, from everything that says so: options, the file, and files beside it.

use std::path::{Path, PathBuf};

use areoid_formats::body::{Body, Ellipsoid};
use areoid_formats::geodesy::LatitudeKind;
use areoid_formats::projection::{Crs, Projection};

use super::ReadOptions;
use super::crs::{MapCrs, ParseCrsError};
use super::error::RasterError;
use super::fence::Fence;
use super::file::{Witness, read_text};
use super::outline::{Outline, Rows, Steps};
use super::world_file;

/// A map's sphere may differ this much from the body that the caller names, relatively.
///
/// Planetary products are made on spheres of the local radius, which is anywhere between the
/// body's two radii; a raster of another body differs far more.
const LOCAL_RADIUS_WITHIN: f64 = 0.01;

/// Where a raster lies.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Placed {
    pub(crate) crs: Option<Crs>,
    pub(crate) outline: Outline,
    pub(crate) rows: Rows,
    /// The files beside the raster that say so.
    pub(crate) beside: Vec<Witness>,
}

/// Places a raster of `size` pixels.
///
/// `own_steps` and `own_crs` are what the file itself says; the second is asked only if `--crs` was
/// not given, so that a system that is not understood can be overridden.
pub(crate) fn place(
    path: &Path,
    size: (u32, u32),
    options: &ReadOptions,
    own_steps: Option<Steps>,
    own_crs: impl FnOnce() -> Result<Option<MapCrs>, RasterError>,
) -> Result<Placed, RasterError> {
    let mut beside = Vec::new();
    let map = match &options.crs {
        Some(text) => {
            let map = match options.within {
                Some(_) => MapCrs::from_text(text),
                None => MapCrs::from_text_or_file(text),
            };
            Some(map.map_err(|source| crs_error(path, "--crs", source))?)
        }
        None => match own_crs()? {
            Some(map) => Some(map),
            None => crs_beside(path, options.within.as_ref())?.map(|(map, witness)| {
                beside.push(witness);
                map
            }),
        },
    };
    let steps = match own_steps {
        Some(steps) => Some(steps),
        None if options.extent.is_some() => None,
        None => world_file::read_beside(path, options.within.as_ref())?.map(|(steps, witness)| {
            beside.push(witness);
            steps
        }),
    };
    let (outline, rows) = match (options.extent, steps) {
        (Some(extent), steps) => {
            let rows =
                if steps.is_some_and(|steps| steps.step[1] > 0.0) { Rows::Up } else { Rows::Down };
            (Outline::from_extent(path, extent, size)?, rows)
        }
        (None, Some(steps)) => placed_by_steps(path, steps, size.1, map)?,
        (None, None) => {
            return Err(RasterError::NoGeoreference {
                path: path.to_owned(),
                missing: "its extent is not known (give --extent W,S,E,N)",
                looked_for: world_file::candidates(path),
            });
        }
    };
    let crs = match map {
        Some(map) => Some(map.crs),
        None => geographic_by_extent(path, size, &outline, options)?,
    };
    let crs = match (crs, &options.body) {
        (Some(crs), Some(body)) => Some(on_body(path, crs, body, options.latitudes)?),
        (Some(crs), None) => {
            let latitudes = options.latitudes.unwrap_or(LatitudeKind::Planetographic);
            Some(crs.on_body(crs.ellipsoid, latitudes))
        }
        (None, _) => None,
    };
    if let Some(crs) = &crs {
        check_latitudes(path, size, &outline, crs)?;
    }
    Ok(Placed { crs, outline, rows, beside })
}

fn placed_by_steps(
    path: &Path,
    steps: Steps,
    height: u32,
    map: Option<MapCrs>,
) -> Result<(Outline, Rows), RasterError> {
    let unit = match map {
        Some(map) if map.crs.projection != Projection::Geographic => map.meters_per_unit,
        _ => 1.0,
    };
    let scaled = Steps {
        corner: steps.corner.map(|value| value * unit),
        step: steps.step.map(|value| value * unit),
    };
    scaled.outline(height).ok_or_else(|| {
        let [dx, dy] = steps.step;
        let found = format!("a pixel of {dx} by {dy} at {:?}", steps.corner);
        RasterError::not_supported(path, found, "finite pixels with columns eastward")
    })
}

/// The system in a `.prj` file beside the raster.
fn crs_beside(
    path: &Path,
    within: Option<&Fence>,
) -> Result<Option<(MapCrs, Witness)>, RasterError> {
    for candidate in prj_candidates(path) {
        if let Some((text, witness)) = read_text(&candidate, within)? {
            let name = candidate.display().to_string();
            return MapCrs::from_text(&text)
                .map(|map| Some((map, witness)))
                .map_err(|source| crs_error(path, name, source));
        }
    }
    Ok(None)
}

fn prj_candidates(path: &Path) -> [PathBuf; 2] {
    ["prj", "PRJ"].map(|extension| path.with_extension(extension))
}

pub(crate) fn crs_error(
    path: &Path,
    origin: impl Into<String>,
    source: ParseCrsError,
) -> RasterError {
    RasterError::Crs { path: path.to_owned(), origin: origin.into(), source }
}

/// Geographic, if the extent fits in degrees, on the body given, if any.
fn geographic_by_extent(
    path: &Path,
    (width, height): (u32, u32),
    outline: &Outline,
    options: &ReadOptions,
) -> Result<Option<Crs>, RasterError> {
    let [west, south, east, north] = outline.extent(width, height);
    let [dx, dy] = outline.pixel_size;
    // Point-registered rasters reach half a pixel past the pole and the antimeridian.
    let fits = west >= -360.0 - dx
        && east <= 360.0 + dx
        && south >= -90.0 - dy * 0.501
        && north <= 90.0 + dy * 0.501;
    if !fits {
        return Err(RasterError::NoGeoreference {
            path: path.to_owned(),
            missing: "its extent is not in degrees and its coordinate reference system is not \
                      known (give --crs)",
            looked_for: prj_candidates(path).to_vec(),
        });
    }
    Ok(options.body.as_ref().map(|body| Crs::new(Projection::Geographic, body.ellipsoid)))
}

/// The map as one of `body`: its coordinates are carried over unchanged, and latitudes on a sphere
/// are planetocentric on an ellipsoid unless the caller says otherwise.
fn on_body(
    path: &Path,
    crs: Crs,
    body: &Body,
    latitudes: Option<LatitudeKind>,
) -> Result<Crs, RasterError> {
    let (map, ellipsoid) = (crs.ellipsoid, body.ellipsoid);
    let radius_is_off = |map: Ellipsoid, body: Ellipsoid| {
        (map.a().0 / body.a().0 - 1.0).abs() > LOCAL_RADIUS_WITHIN
    };
    if radius_is_off(map, ellipsoid) {
        return Err(RasterError::Option {
            path: path.to_owned(),
            option: "--body",
            found: format!("{} of radius {} m", body.name, ellipsoid.a().0),
            expected: format!("the body of the raster, of radius {} m", map.a().0),
        });
    }
    let implied = if map.is_sphere() && !ellipsoid.is_sphere() {
        LatitudeKind::Planetocentric
    } else {
        LatitudeKind::Planetographic
    };
    Ok(crs.on_body(ellipsoid, latitudes.unwrap_or(implied)))
}

/// Degrees beyond the poles are meters by mistake, or another system.
fn check_latitudes(
    path: &Path,
    (width, height): (u32, u32),
    outline: &Outline,
    crs: &Crs,
) -> Result<(), RasterError> {
    let [_, south, _, north] = outline.extent(width, height);
    let beyond = 90.0 + outline.pixel_size[1];
    if crs.projection == Projection::Geographic && (south < -beyond || north > beyond) {
        return Err(RasterError::not_supported(
            path,
            format!("a geographic raster from latitude {south} to {north}"),
            "latitudes within ±90 degrees, and half a pixel more",
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use areoid_formats::units::Meters;

    const NOTHING: &str = "/nonexistent/a.png";

    fn placed(options: &ReadOptions) -> Result<Placed, RasterError> {
        place(Path::new(NOTHING), (360, 180), options, None, || Ok(None))
    }

    fn options(extent: [f64; 4], body: Option<&str>, crs: Option<&str>) -> ReadOptions {
        ReadOptions {
            extent: Some(extent),
            body: body.map(|name| Body::parse(name).unwrap()),
            crs: crs.map(str::to_owned),
            ..ReadOptions::default()
        }
    }

    const GLOBE: [f64; 4] = [-180.0, -90.0, 180.0, 90.0];

    #[test]
    fn an_extent_in_degrees_is_geographic_on_the_body_given() {
        assert_eq!(placed(&options(GLOBE, None, None)).unwrap().crs, None);
        let mars = placed(&options(GLOBE, Some("mars"), None)).unwrap().crs.unwrap();
        assert_eq!(mars.projection, Projection::Geographic);
        assert_eq!(mars.ellipsoid.a(), Meters(3_396_190.0));
        let error = placed(&options([0.0, 0.0, 1e5, 1e5], None, None)).unwrap_err().to_string();
        assert!(error.contains("--crs") && error.contains("a.prj"), "{error}");
    }

    #[test]
    fn nothing_at_all_names_the_files_looked_for() {
        let error = placed(&ReadOptions::default()).unwrap_err().to_string();
        assert!(error.contains("a.pgw") && error.contains("--extent"), "{error}");
    }

    #[test]
    fn a_sphere_on_an_ellipsoid_is_planetocentric_unless_told() {
        let sphere = Some("+proj=longlat +R=3396190");
        let mut options = options(GLOBE, Some("mars-ellipsoid"), sphere);
        let crs = placed(&options).unwrap().crs.unwrap();
        assert_eq!(crs.latitudes, LatitudeKind::Planetocentric);
        assert_eq!(crs.body, Body::parse("mars-ellipsoid").unwrap().ellipsoid);
        assert!(crs.ellipsoid.is_sphere());
        options.latitudes = Some(LatitudeKind::Planetographic);
        let crs = placed(&options).unwrap().crs.unwrap();
        assert_eq!(crs.latitudes, LatitudeKind::Planetographic);
    }

    #[test]
    fn another_body_than_the_raster_shows_is_refused() {
        let error = placed(&options(GLOBE, Some("moon"), Some("EPSG:4326"))).unwrap_err();
        assert!(error.to_string().contains("--body is moon"), "{error}");
        let local = Some("+proj=longlat +R=3376200");
        assert!(placed(&options(GLOBE, Some("mars"), local)).is_ok());
    }

    #[test]
    fn meters_called_degrees_are_refused() {
        let meters = [0.0, 0.0, 1e5, 1e5];
        assert!(placed(&options(meters, None, Some("EPSG:4326"))).is_err());
        assert!(placed(&options(meters, None, Some("EPSG:3031"))).is_ok());
    }
}
