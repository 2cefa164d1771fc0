//! PROJ as the oracle of bodies, positions and projections.
//!
//! `data/proj.csv` holds what PROJ 9.5.1 computes, `data/make_proj.py` made it. Every row must agree
//! to 10⁻⁹ of the body's radius, there and back.

use areoid_formats::body::{Body, Ellipsoid};
use areoid_formats::geodesy::{Geographic, LatitudeKind, surface_normal};
use areoid_formats::projection::{Crs, MapPoint, Projection};
use areoid_formats::units::{Degrees, Meters, Radians};
use glam::DVec3;

/// The agreement that the projections promise, relative to the radius.
const TOLERANCE: f64 = 1e-9;

/// A row of the table.
struct Row {
    system: String,
    position: Geographic,
    height: Meters,
    values: Vec<f64>,
}

/// The rows of one kind: at least one, or the test would pass on nothing.
fn rows(kind: &str) -> Vec<Row> {
    let rows: Vec<Row> = include_str!("data/proj.csv")
        .lines()
        .map(|line| line.split(',').collect::<Vec<_>>())
        .filter(|cells| cells[0] == kind)
        .map(|cells| {
            let number = |cell: &&str| cell.parse::<f64>().expect("a number");
            let [lon, lat, height] = [2, 3, 4].map(|column| number(&cells[column]));
            Row {
                system: cells[1].to_owned(),
                position: Geographic::from_degrees(Degrees(lon), Degrees(lat)),
                height: Meters(height),
                values: cells[5..].iter().filter(|cell| !cell.is_empty()).map(number).collect(),
            }
        })
        .collect();
    assert!(!rows.is_empty(), "no rows of kind {kind}");
    rows
}

/// Meters to a unit of the map, for tolerances.
fn meters_per_unit(crs: &Crs) -> f64 {
    match crs.projection {
        Projection::Geographic => crs.body.a().0.to_radians(),
        _ => 1.0,
    }
}

/// How far apart two positions are on a body, along a chord.
fn distance(body: &Ellipsoid, one: Geographic, other: Geographic) -> f64 {
    (surface_normal(one) - surface_normal(other)).length() * body.a().0
}

/// Holds a map against rows of x and y, both ways.
fn check_map(crs: &Crs, row: &Row) {
    let radius = crs.body.a().0;
    let expected = MapPoint { x: row.values[0], y: row.values[1] };
    let context = format!("{} at {:?}: PROJ has {expected:?}", row.system, row.position);

    let found = crs.project(row.position).unwrap_or_else(|| panic!("{context}, we have none"));
    let mut across = found.x - expected.x;
    if let Some(period) = crs.wraps_with_period() {
        across -= period * (across / period).round();
    }
    let off = across.hypot(found.y - expected.y) * meters_per_unit(crs);
    assert!(off <= TOLERANCE * radius, "{context}, we {found:?}: {off:e} m");

    let back = crs.unproject(expected).unwrap_or_else(|| panic!("{context}, no way back"));
    let off = distance(&crs.body, back, row.position);
    assert!(off <= TOLERANCE * radius, "{context}, and back we have {back:?}: {off:e} m");
}

#[test]
fn maps_agree_with_proj() {
    for row in rows("map") {
        check_map(&Crs::from_proj_string(&row.system).unwrap(), &row);
    }
}

#[test]
fn planetocentric_maps_of_an_ellipsoid_agree_with_proj() {
    let body = Body::parse("mars-ellipsoid").unwrap().ellipsoid;
    for row in rows("centric") {
        let crs = Crs::from_proj_string(&row.system).unwrap();
        check_map(&crs.on_body(body, LatitudeKind::Planetocentric), &row);
    }
}

/// The surface of a row that has no map.
fn surface(row: &Row) -> Ellipsoid {
    let crs = Crs::from_proj_string(&format!("+proj=longlat {}", row.system));
    crs.expect("a surface").ellipsoid
}

#[test]
fn planetocentric_latitudes_agree_with_proj() {
    for row in rows("latitude") {
        let (surface, graphic) = (surface(&row), row.position.latitude);
        let centric = Radians::from(Degrees(row.values[1]));
        let there = surface.planetocentric_from_planetographic(graphic);
        let back = surface.planetographic_from_planetocentric(centric);
        assert!((there.0 - centric.0).abs() <= TOLERANCE, "{} {graphic:?}", row.system);
        assert!((back.0 - graphic.0).abs() <= TOLERANCE, "{} {graphic:?}", row.system);
    }
}

#[test]
fn cartesian_points_agree_with_proj() {
    for row in rows("cart") {
        let surface = surface(&row);
        let expected = DVec3::new(row.values[0], row.values[1], row.values[2]);
        let tolerance = TOLERANCE * surface.a().0;
        let context = format!("{} at {:?} {:?}", row.system, row.position, row.height);

        let found = surface.cartesian_from_geographic(row.position, row.height);
        let off = (found - expected).length();
        assert!(off <= tolerance, "{context}: {found} for {expected}, {off:e} m");

        let (position, height) = surface.geographic_from_cartesian(expected);
        let off = distance(&surface, position, row.position);
        assert!(off <= tolerance, "{context}: back at {position:?}, {off:e} m");
        let off = (height.0 - row.height.0).abs();
        assert!(off <= tolerance, "{context}: back at {height:?}, {off:e} m");
    }
}
