//! Properties of positions: cartesian and geographic, normals, and the two kinds of latitude.

use std::f64::consts::{FRAC_PI_2, PI};

use areoid_formats::body::Ellipsoid;
use areoid_formats::geodesy::{Geographic, geographic_from_normal, surface_normal};
use areoid_formats::units::{Meters, Radians};
use glam::DVec3;
use proptest::prelude::*;

fn ellipsoid(a: f64, ratio: f64) -> Ellipsoid {
    Ellipsoid::new(Meters(a), Meters(a * ratio)).expect("a ratio of at most 1")
}

fn position(longitude: f64, latitude: f64) -> Geographic {
    Geographic { longitude: Radians(longitude), latitude: Radians(latitude) }
}

/// Spheres, planets, and ellipsoids far flatter.
fn ellipsoids() -> impl Strategy<Value = Ellipsoid> {
    let ratios = prop_oneof![Just(1.0), Just(1.0 - 1.0 / 298.257), Just(0.994), 0.3..1.0];
    (1e5..1e8, ratios).prop_map(|(a, ratio)| ellipsoid(a, ratio))
}

fn latitudes() -> impl Strategy<Value = f64> {
    let near = (-17.0..-1.0, prop_oneof![Just(0.0), Just(FRAC_PI_2)], any::<bool>());
    let near = near.prop_map(|(exponent, from, is_north)| {
        let latitude = f64::abs(from - 10f64.powf(exponent));
        if is_north { latitude } else { -latitude }
    });
    prop_oneof![-FRAC_PI_2..=FRAC_PI_2, near]
}

/// Depths down to nine tenths of the way to the nearest center of curvature, b² / a at the
/// equator, and heights to 10⁹ m.
fn height(ellipsoid: &Ellipsoid, depth: f64, exponent: f64) -> f64 {
    if depth > 0.0 {
        -0.9 * depth * ellipsoid.b().0 * (ellipsoid.b().0 / ellipsoid.a().0)
    } else {
        10f64.powf(exponent)
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4000))]

    #[test]
    fn points_come_back_from_space(
        ellipsoid in ellipsoids(), lon in -PI..PI, lat in latitudes(),
        depth in -1.0..1.0, exponent in -3.0..9.0,
    ) {
        let height = height(&ellipsoid, depth, exponent);
        let start = position(lon, lat);
        let point = ellipsoid.cartesian_from_geographic(start, Meters(height));
        let (back, back_height) = ellipsoid.geographic_from_cartesian(point);

        // Deep inside flat bodies the normals crowd, and a rounding error turns them further.
        let off = (surface_normal(back) - surface_normal(start)).length();
        prop_assert!(off <= 1e-12, "{start:?} {height} -> {back:?}: {off:e} radii");
        let tolerance = 4.0 * f64::EPSILON * point.length().max(ellipsoid.a().0);
        let off = (back_height.0 - height).abs();
        prop_assert!(off <= tolerance, "{start:?} {height} -> {back_height:?}: {off:e} m");
    }

    /// Also where normals cross and there is more than one height.
    #[test]
    fn the_foot_is_the_nearest_point_of_the_surface(
        ellipsoid in ellipsoids(), x in -1.5..1.5, z in -1.5..1.5, scale in -12.0..0.0,
        lat in latitudes(),
    ) {
        let a = ellipsoid.a().0;
        let point = DVec3::new(x, 0.0, z * 10f64.powf(scale)) * a;
        let (at, height) = ellipsoid.geographic_from_cartesian(point);
        let again = ellipsoid.cartesian_from_geographic(at, height);
        prop_assert!((again - point).length() <= 1e-9 * a, "{point} -> {at:?} {height:?} -> {again}");

        let elsewhere = ellipsoid.cartesian_from_geographic(position(at.longitude.0, lat), Meters(0.0));
        prop_assert!(height.0.abs() <= (elsewhere - point).length() + 1e-9 * a);
    }

    #[test]
    fn normals_come_back(lon in -PI..PI, lat in latitudes(), length in -9.0..9.0) {
        let start = position(lon, lat);
        let back = geographic_from_normal(surface_normal(start) * 10f64.powf(length));
        prop_assert!((surface_normal(back) - surface_normal(start)).length() <= 1e-15);
        prop_assert!((-PI..PI).contains(&back.longitude.0));
    }

    #[test]
    fn the_two_latitudes_undo_each_other(ellipsoid in ellipsoids(), lat in latitudes()) {
        let centric = ellipsoid.planetocentric_from_planetographic(Radians(lat));
        let back = ellipsoid.planetographic_from_planetocentric(centric);
        prop_assert!((back.0 - lat).abs() <= 1e-14, "{lat} -> {centric:?} -> {back:?}");
        prop_assert!(centric.0.abs() <= lat.abs() * (1.0 + 1e-15));

        // The line from the center to the foot has the planetocentric latitude.
        let foot = ellipsoid.cartesian_from_geographic(position(0.0, lat), Meters(0.0));
        prop_assert!((foot.z.atan2(foot.x) - centric.0).abs() <= 1e-15);
    }
}

#[test]
fn the_poles_are_on_the_axis_exactly() {
    for ratio in [1.0, 0.994, 0.5] {
        let ellipsoid = ellipsoid(3_396_190.0, ratio);
        for sign in [1.0, -1.0] {
            for height in [-1e6, 0.0, 1e9] {
                let pole = position(2.0, sign * FRAC_PI_2);
                let point = ellipsoid.cartesian_from_geographic(pole, Meters(height));
                assert_eq!((point.x, point.y), (0.0, 0.0), "{pole:?}");
                let (back, back_height) = ellipsoid.geographic_from_cartesian(point);
                assert_eq!(back, position(0.0, sign * FRAC_PI_2));
                let tolerance = 4.0 * f64::EPSILON * height.abs().max(ellipsoid.a().0);
                assert!((back_height.0 - height).abs() <= tolerance, "{back_height:?}");
            }
            for latitude in [0.0, sign * FRAC_PI_2] {
                let same = ellipsoid.planetocentric_from_planetographic(Radians(latitude));
                assert_eq!(same.0, latitude);
                assert_eq!(ellipsoid.planetographic_from_planetocentric(same).0, latitude);
            }
        }
    }
}

#[test]
fn the_center_belongs_to_the_north_pole() {
    for ratio in [1.0, 0.994, 0.5] {
        let ellipsoid = ellipsoid(3_396_190.0, ratio);
        let (at, height) = ellipsoid.geographic_from_cartesian(DVec3::ZERO);
        assert_eq!(at, position(0.0, FRAC_PI_2));
        assert_eq!(height.0, -ellipsoid.b().0);
    }
}

#[test]
fn the_antimeridian_is_the_west_end_of_longitudes() {
    let mars = ellipsoid(3_396_190.0, 0.994);
    let (at, _) = mars.geographic_from_cartesian(DVec3::new(-4e6, 0.0, 1.0));
    assert_eq!(at.longitude.0, -PI);
    let (at, _) = mars.geographic_from_cartesian(DVec3::new(-4e6, -0.0, 1.0));
    assert_eq!(at.longitude.0, -PI);
    assert_eq!(geographic_from_normal(DVec3::new(-1.0, 0.0, 0.0)).longitude.0, -PI);
}
