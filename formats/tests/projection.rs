//! Properties of every map projection: there and back, seams, poles, and the ground beneath.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use areoid_formats::body::Ellipsoid;
use areoid_formats::geodesy::{Geographic, LatitudeKind, surface_normal};
use areoid_formats::projection::{
    Crs, Equirectangular, MapPoint, PolarScale, PolarStereographic, Pole, Projection,
};
use areoid_formats::units::{Meters, Radians};
use proptest::prelude::*;

fn ellipsoid(a: f64, ratio: f64) -> Ellipsoid {
    Ellipsoid::new(Meters(a), Meters(a * ratio)).expect("a ratio of at most 1")
}

/// From a sphere to far flatter than any planet: Mars has b/a = 0.994, Saturn 0.902.
fn ellipsoids() -> impl Strategy<Value = Ellipsoid> {
    let ratios = prop_oneof![Just(1.0), Just(1.0 - 1.0 / 298.257), Just(0.994), 0.5..1.0];
    (1e3..1e8, ratios).prop_map(|(a, ratio)| ellipsoid(a, ratio))
}

fn equirectangulars() -> impl Strategy<Value = Projection> {
    (-7.0..7.0, -1.5..1.5, -1.5..1.5, -1e7..1e7, -1e7..1e7).prop_map(
        |(lon_0, lat_ts, lat_0, x, y)| {
            Projection::Equirectangular(Equirectangular {
                central_meridian: Radians(lon_0),
                standard_parallel: Radians(lat_ts),
                latitude_of_origin: Radians(lat_0),
                false_easting: Meters(x),
                false_northing: Meters(y),
            })
        },
    )
}

fn polar_stereographics() -> impl Strategy<Value = Projection> {
    let scales = prop_oneof![
        (0.5..2.0).prop_map(PolarScale::AtPole),
        (0.0..1.5).prop_map(|latitude| PolarScale::TrueAt(Radians(latitude))),
    ];
    let poles = prop_oneof![Just(Pole::North), Just(Pole::South)];
    (poles, -7.0..7.0, scales, -1e7..1e7, -1e7..1e7).prop_map(|(pole, lon_0, scale, x, y)| {
        Projection::PolarStereographic(PolarStereographic {
            pole,
            central_meridian: Radians(lon_0),
            scale,
            false_easting: Meters(x),
            false_northing: Meters(y),
        })
    })
}

prop_compose! {
    /// Every kind of map, of a body that need not be the map's own surface.
    fn systems()(
        projection in prop_oneof![
            Just(Projection::Geographic), equirectangulars(), polar_stereographics(),
        ],
        surface in ellipsoids(),
        latitudes in prop_oneof![
            Just(LatitudeKind::Planetographic), Just(LatitudeKind::Planetocentric),
        ],
        ratio in prop_oneof![Just(1.0), 0.9..1.0],
    ) -> Crs {
        let body = ellipsoid(surface.a().0, ratio);
        Crs::new(projection, surface).on_body(body, latitudes)
    }
}

/// Latitudes with the poles' neighbourhoods as likely as the rest, at every distance.
fn latitudes() -> impl Strategy<Value = f64> {
    let near_pole = (-17.0..-1.0, any::<bool>()).prop_map(|(exponent, is_north)| {
        let latitude = FRAC_PI_2 - 10f64.powf(exponent);
        if is_north { latitude } else { -latitude }
    });
    prop_oneof![-FRAC_PI_2..=FRAC_PI_2, near_pole]
}

/// Longitudes over three turns, with the antimeridian as likely as the rest.
fn longitudes() -> impl Strategy<Value = f64> {
    let near_seam = (-17.0..-1.0, -3..3).prop_map(|(exponent, half)| {
        f64::from(half) * PI + 10f64.powf(exponent).copysign(f64::from(half))
    });
    prop_oneof![-9.5..9.5, near_seam]
}

fn position(longitude: f64, latitude: f64) -> Geographic {
    Geographic { longitude: Radians(longitude), latitude: Radians(latitude) }
}

/// The distance of two positions along a chord, relative to the radius.
fn apart(one: Geographic, other: Geographic) -> f64 {
    (surface_normal(one) - surface_normal(other)).length()
}

/// The size of the map's numbers that subtracting false origins leaves rounding of, relative to
/// the radius.
fn origin_noise(crs: &Crs) -> f64 {
    let (x, y) = match crs.projection {
        Projection::Geographic => return 0.0,
        Projection::Equirectangular(map) => (map.false_easting, map.false_northing),
        Projection::PolarStereographic(map) => (map.false_easting, map.false_northing),
    };
    1e-15 * x.0.hypot(y.0) / crs.ellipsoid.a().0
}

/// Projects and unprojects, and says how far off that is; `None` outside the domain.
fn round_trip(crs: &Crs, start: Geographic) -> Option<(Geographic, f64)> {
    let back = crs.unproject(crs.project(start)?).expect("what is projected can be unprojected");
    Some((back, apart(start, back)))
}

fn check_round_trip(crs: &Crs, start: Geographic) {
    let Some((back, off)) = round_trip(crs, start) else {
        let Projection::PolarStereographic(map) = crs.projection else {
            panic!("{crs:?} has no {start:?}")
        };
        let limit = FRAC_PI_2 - PolarStereographic::MAX_COLATITUDE.0;
        assert!(map.pole.sign() * start.latitude.0 < limit + 0.3, "{crs:?} has no {start:?}");
        return;
    };
    assert!((-PI..PI).contains(&back.longitude.0), "{back:?}");
    assert!(back.latitude.0.abs() <= FRAC_PI_2, "{back:?}");
    // Narrow columns: a standard parallel near a pole squeezes x, and with it the digits.
    let tolerance = 1e-9_f64.max(20.0 * origin_noise(crs));
    assert!(off <= tolerance, "{crs:?}: {start:?} came back as {back:?}, {off:e} radii away");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4000))]

    #[test]
    fn there_and_back_is_here(crs in systems(), lon in longitudes(), lat in latitudes()) {
        check_round_trip(&crs, position(lon, lat));
    }

    #[test]
    fn whole_turns_change_nothing(
        crs in systems(), lon in -PI..PI, lat in -1.2..1.2, turns in -3..=3,
    ) {
        let one = crs.project(position(lon, lat));
        let other = crs.project(position(lon + f64::from(turns) * TAU, lat));
        if let (Some(one), Some(other)) = (one, other) {
            let mut across = one.x - other.x;
            if let Some(period) = crs.wraps_with_period() {
                across -= period * (across / period).round();
            }
            let size = crs.wraps_with_period().unwrap_or_else(|| one.x.hypot(one.y));
            prop_assert!(across.hypot(one.y - other.y) <= 1e-13 * size + 1e-8);
        } else {
            prop_assert!(one.is_none() && other.is_none());
        }
    }

    #[test]
    fn a_period_of_x_is_a_turn(crs in systems(), lon in -PI..PI, lat in -1.5..1.5, turns in -2..=2) {
        let Some(period) = crs.wraps_with_period() else { return Ok(()) };
        let start = position(lon, lat);
        let point = crs.project(start).unwrap();
        let shifted = MapPoint { x: point.x + f64::from(turns) * period, ..point };
        let tolerance = 1e-9_f64.max(20.0 * origin_noise(&crs));
        prop_assert!(apart(crs.unproject(shifted).unwrap(), start) <= tolerance);
    }

    #[test]
    fn the_jacobian_is_the_slope_of_the_ground(
        crs in systems(), lon in -3.0..3.0, lat in latitudes(),
    ) {
        check_jacobian(&crs, position(lon, lat));
    }

    #[test]
    fn a_system_reads_back_to_the_last_bit(crs in systems()) {
        let text = crs.proj_string();
        let body = (crs.body, crs.latitudes);
        prop_assert_eq!(Crs::from_proj_string(&text).unwrap().on_body(body.0, body.1), crs);
        let json = serde_json::to_string(&crs).unwrap();
        prop_assert_eq!(serde_json::from_str::<Crs>(&json).unwrap(), crs);
    }
}

/// Compares the Jacobian with central differences of points on the body, over steps of the map.
fn check_jacobian(crs: &Crs, at: Geographic) {
    let Some(center) = crs.project(at) else { return };
    // Away from poles and seams, where differences of longitude make sense.
    if at.latitude.0.abs() > FRAC_PI_2 - 1e-2 || PI - at.longitude.0.abs() < 1e-2 {
        return;
    }
    let jacobian = crs.ground_jacobian(at);
    let (largest, smallest) = crs.principal_scales(at, [1.0, 1.0]);
    let step = 1e-5 * crs.body.a().0 / largest.max(1e-30);
    // Eastward and northward by the normals' own frame, so that both formulas are independent.
    let zenith = surface_normal(at);
    let east = surface_normal(position(at.longitude.0 + FRAC_PI_2, 0.0));
    let north = zenith.cross(east);
    let ground = |dx: f64, dy: f64| {
        let point = MapPoint { x: center.x + dx, y: center.y + dy };
        let shown = crs.unproject(point).expect("a step from inside stays inside");
        crs.body.cartesian_from_geographic(shown, Meters(0.0))
    };
    let steps = [(step, 0.0), (0.0, step)];
    for (column, (dx, dy)) in steps.into_iter().enumerate() {
        let slope = (ground(dx, dy) - ground(-dx, -dy)) / (2.0 * step);
        let tolerance = largest * (1e-5 + 1e6 * origin_noise(crs));
        let found = [jacobian[0][column], jacobian[1][column]];
        let off = (slope.dot(east) - found[0]).hypot(slope.dot(north) - found[1]);
        assert!(off <= tolerance, "{crs:?} at {at:?}: {found:?}, off by {off:e} of {largest:e}");
    }
    let [[a, b], [c, d]] = jacobian;
    assert!((largest * smallest - (a * d - b * c).abs()).abs() <= 1e-12 * largest * largest);
    assert!(smallest <= largest * (1.0 + 1e-12));
}

fn polar(pole: Pole, ratio: f64) -> Crs {
    let map = PolarStereographic {
        pole,
        central_meridian: Radians(0.3),
        scale: PolarScale::AtPole(1.0),
        false_easting: Meters(0.0),
        false_northing: Meters(0.0),
    };
    Crs::new(Projection::PolarStereographic(map), ellipsoid(3_396_190.0, ratio))
}

fn global() -> [Crs; 3] {
    let mars = ellipsoid(3_396_190.0, 1.0);
    let at = |lon_0| Equirectangular { central_meridian: Radians(lon_0), ..Default::default() };
    [
        Crs::new(Projection::Geographic, mars),
        Crs::new(Projection::Equirectangular(at(0.0)), mars),
        Crs::new(Projection::Equirectangular(at(PI)), mars),
    ]
}

#[test]
fn the_pole_is_the_origin_of_a_polar_map_and_comes_back_exactly() {
    for (pole, ratio) in [(Pole::North, 1.0), (Pole::South, 0.994)] {
        let crs = polar(pole, ratio);
        let at = position(1.0, pole.sign() * FRAC_PI_2);
        let point = crs.project(at).unwrap();
        assert_eq!((point.x, point.y), (0.0, 0.0));
        for x in [0.0, -0.0] {
            for y in [0.0, -0.0] {
                let back = crs.unproject(MapPoint { x, y }).unwrap();
                assert_eq!(back, position(0.3, at.latitude.0));
            }
        }
    }
}

/// Next to the pole the colatitude itself must survive: a map meter is a ground meter there.
#[test]
fn millimeters_from_the_pole_are_still_on_the_map() {
    for ratio in [1.0, 0.994] {
        let crs = polar(Pole::North, ratio);
        for meters in [1e-3, 1.0, 1e3] {
            let back = crs.unproject(MapPoint { x: meters, y: 0.0 }).unwrap();
            let ground = (FRAC_PI_2 - back.latitude.0) * 3_396_190.0 / ratio;
            // Half an ulp of a latitude near 90° is 0.4 nm of Mars.
            assert!((ground - meters).abs() < 1e-9 + 1e-6 * meters);
            let (largest, smallest) = crs.principal_scales(back, [1.0, 1.0]);
            assert!((largest - 1.0).abs() < 1e-6 && (smallest - 1.0).abs() < 1e-6);
        }
    }
}

#[test]
fn a_polar_map_passes_the_equator_and_ends_before_the_other_pole() {
    for ratio in [1.0, 0.994] {
        for pole in [Pole::North, Pole::South] {
            let crs = polar(pole, ratio);
            let far = |degrees: f64| position(-2.0, -pole.sign() * degrees.to_radians());
            let rim = crs.project(far(80.0)).expect("the rim belongs to the map");
            // What misses the rim by rounding is the rim: it comes back, and as itself.
            let past = crs.project(far(80.0 + 5e-8)).expect("past the rim by less than the slack");
            for point in [rim, past] {
                let back = crs.unproject(point).expect("what is projected comes back");
                let rim_latitude = far(80.0).latitude.0;
                assert!((back.latitude.0 - rim_latitude).abs() < 1e-14, "{back:?}");
                assert!(crs.ground_jacobian(back)[0][0].is_finite());
            }
            assert!(crs.project(far(80.001)).is_none());
            assert!(crs.project(far(90.0)).is_none());
            assert!(crs.unproject(MapPoint { x: rim.x * 1.001, y: rim.y * 1.001 }).is_none());
            assert!(crs.unproject(MapPoint { x: f64::INFINITY, y: 0.0 }).is_none());
            assert!(crs.ground_jacobian(far(85.0))[0][0].is_nan());
        }
    }
}

#[test]
fn the_map_begins_at_its_west_end() {
    let [degrees, greenwich, antimeridian] = global();
    assert_eq!(degrees.project(position(PI, 0.0)).unwrap().x, -180.0);
    assert_eq!(degrees.project(position(-PI, 0.0)).unwrap().x, -180.0);
    let west = -greenwich.wraps_with_period().unwrap() / 2.0;
    assert_eq!(greenwich.project(position(PI, 0.0)).unwrap().x, west);
    assert_eq!(antimeridian.project(position(0.0, 0.0)).unwrap().x, west);
    assert_eq!(antimeridian.project(position(PI, 0.0)).unwrap().x, 0.0);
}

/// Every float within three ulps of the seam, on both sides and several turns away.
#[test]
fn the_seam_is_no_gap() {
    for crs in global() {
        for half in -5..=5 {
            let (mut below, mut above) = (f64::from(half) * PI, f64::from(half) * PI);
            for _ in 0..=3 {
                check_round_trip(&crs, position(below, 0.7));
                check_round_trip(&crs, position(above, 0.7));
                let half_period = crs.wraps_with_period().unwrap() / 2.0 * (1.0 + 1e-15);
                let x = crs.project(position(above, 0.7)).unwrap().x;
                assert!((-half_period..=half_period).contains(&x), "{crs:?} {x}");
                (below, above) = (below.next_down(), above.next_up());
            }
        }
        let (mut below, mut above) = (180.0_f64, -180.0_f64);
        for _ in 0..=3 {
            for x in [below, above] {
                let shown = crs.unproject(MapPoint { x, y: 1.0 }).unwrap();
                assert!((-PI..PI).contains(&shown.longitude.0), "{x} {shown:?}");
            }
            (below, above) = (below.next_down(), above.next_down());
        }
    }
}

#[test]
fn a_row_that_misses_the_pole_by_rounding_is_the_pole() {
    for crs in global() {
        for pole in [Pole::North, Pole::South] {
            let y = crs.y_of_pole(pole).unwrap();
            let shown = crs.unproject(MapPoint { x: 0.0, y: y * (1.0 + 1e-12) }).unwrap();
            assert_eq!(shown.latitude.0, pole.sign() * FRAC_PI_2);
            assert!(crs.unproject(MapPoint { x: 0.0, y: y * 1.000_001 }).is_none());
            assert!(crs.project(position(0.0, pole.sign() * 1.58)).is_none());
        }
    }
}

#[test]
fn nothing_that_is_not_finite_is_on_a_map() {
    for crs in global().into_iter().chain([polar(Pole::North, 1.0), polar(Pole::South, 0.994)]) {
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert!(crs.project(position(bad, 1.0)).is_none());
            assert!(crs.project(position(1.0, bad)).is_none());
            assert!(crs.unproject(MapPoint { x: bad, y: 1.0 }).is_none());
            assert!(crs.unproject(MapPoint { x: 1.0, y: bad }).is_none());
        }
    }
}

#[test]
fn a_degree_of_mars_is_59_km_and_narrows_with_the_cosine() {
    let [degrees, ..] = global();
    let (largest, smallest) = degrees.principal_scales(position(1.0, PI / 3.0), [1.0, -1.0]);
    assert!((largest - 59_274.697).abs() < 1e-3, "{largest}");
    assert!((smallest - largest / 2.0).abs() < 1e-6, "{smallest}");
    let (_, at_pole) = degrees.principal_scales(position(1.0, FRAC_PI_2), [1.0, 1.0]);
    assert_eq!(at_pole, 0.0);
}
