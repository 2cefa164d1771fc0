#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the grids drawn are small"
)]

use areoid_formats::body::Ellipsoid;
use areoid_formats::geodesy::LatitudeKind;
use areoid_formats::grid::{Grid, Outline};
use areoid_formats::projection::{
    Crs, Equirectangular, PolarScale, PolarStereographic, Pole, Projection,
};
use areoid_formats::units::{Degrees, Meters, Radians};
use proptest::prelude::*;

use super::*;
use crate::resample::extension::Extension;

/// A body, and what latitudes mean on a map of it.
pub(in crate::resample) fn surfaces() -> impl Strategy<Value = (Ellipsoid, LatitudeKind)> {
    let flattened = prop_oneof![Just(0.0), Just(1.0 / 298.257), Just(0.005_886), 0.0..0.04];
    let kind = prop_oneof![Just(LatitudeKind::Planetographic), Just(LatitudeKind::Planetocentric)];
    (1e5..1e7, flattened, kind).prop_map(|(a, flattened, kind)| {
        (Ellipsoid::new(Meters(a), Meters(a * (1.0 - flattened))).unwrap(), kind)
    })
}

/// A map of straight meridians of a body, whole or in part, on its own surface or on a sphere.
fn cylindrical() -> impl Strategy<Value = (Projection, bool)> {
    let equirectangular = (-180.0..180.0, -60.0..60.0).prop_map(|(meridian, parallel)| {
        Projection::Equirectangular(Equirectangular {
            central_meridian: Degrees(meridian).into(),
            standard_parallel: Degrees(parallel).into(),
            false_easting: Meters(1234.5),
            ..Equirectangular::default()
        })
    });
    (prop_oneof![Just(Projection::Geographic), equirectangular], any::<bool>())
}

fn polar() -> impl Strategy<Value = PolarStereographic> {
    let scale = prop_oneof![
        (0.9..1.1).prop_map(PolarScale::AtPole),
        (60.0..90.0).prop_map(|parallel| PolarScale::TrueAt(Degrees(parallel).into())),
    ];
    (any::<bool>(), -180.0..180.0, scale).prop_map(|(north, meridian, scale)| PolarStereographic {
        pole: if north { Pole::North } else { Pole::South },
        central_meridian: Degrees(meridian).into(),
        scale,
        false_easting: Meters(2e6),
        false_northing: Meters(-3e5),
    })
}

/// A globe, or a region of one that may cross the antimeridian, with a map of straight meridians.
#[derive(Clone, Debug)]
pub(in crate::resample) struct Straight {
    pub(in crate::resample) projection: Projection,
    pub(in crate::resample) on_sphere: bool,
    /// The whole turn in so many columns, twice a number.
    pub(in crate::resample) half_width: u32,
    pub(in crate::resample) posts: bool,
    /// West, east, south, north ends in turns and half turns from the map's own west and south; the
    /// whole globe if `None`.
    pub(in crate::resample) part: Option<[f64; 4]>,
}

pub(in crate::resample) fn straight() -> impl Strategy<Value = Straight> {
    let part = prop::option::of([-0.3..1.0, 0.02..1.0_f64, 0.0..0.9, 0.02..0.5_f64]);
    let half_width = prop_oneof![8_u32..200, 200_u32..20_000];
    (cylindrical(), half_width, any::<bool>(), part).prop_map(
        |((projection, on_sphere), half_width, posts, part)| Straight {
            projection,
            on_sphere,
            half_width,
            posts,
            part,
        },
    )
}

impl Straight {
    fn crs(&self, (body, latitudes): (Ellipsoid, LatitudeKind)) -> Crs {
        let surface = if self.on_sphere { Ellipsoid::sphere(body.a()).unwrap() } else { body };
        Crs::new(self.projection, surface).on_body(body, latitudes)
    }

    pub(in crate::resample) fn placement(&self, surface: (Ellipsoid, LatitudeKind)) -> Placement {
        let crs = self.crs(surface);
        let turn = crs.wraps_with_period().unwrap();
        let (north, south) =
            (crs.y_of_pole(Pole::North).unwrap(), crs.y_of_pole(Pole::South).unwrap());
        let west =
            crs.project(areoid_formats::geodesy::Geographic::default()).unwrap().x - turn * 0.4;
        let pixel = turn / f64::from(2 * self.half_width);
        let rows = if self.posts { self.half_width + 1 } else { self.half_width };
        let height = (north - south) / f64::from(self.half_width);
        let half_row = if self.posts { height / 2.0 } else { 0.0 };
        let mut outline = Outline {
            origin: [west, north + half_row],
            pixel_size: [pixel, height],
            width: 2 * self.half_width,
            height: rows,
        };
        if let Some([left, wide, top, tall]) = self.part {
            let count = |share: f64, of: u32| (share * f64::from(of)).floor();
            let (left, top) = (count(left, outline.width), count(top, rows));
            outline.origin[0] += left * pixel;
            outline.origin[1] -= top * height;
            outline.width = (count(wide, outline.width) as u32).max(1);
            outline.height = (count(tall, rows) as u32).clamp(1, rows - top as u32);
        }
        Placement::from_outline(crs, outline).unwrap()
    }

    /// As a target: the even widths of a pyramid, however small its pages.
    pub(in crate::resample) fn grid(&self, surface: (Ellipsoid, LatitudeKind)) -> Option<Grid> {
        let placement = self.placement(surface);
        let (origin, pixel_size) = (placement.origin, placement.pixel_size);
        Grid::new(placement.crs, origin, pixel_size, placement.extent(), 4096)
            .or_else(|_| Grid::new(placement.crs, origin, pixel_size, placement.extent(), 66))
            .ok()
    }
}

/// A square or any rectangle about or beside a pole.
#[derive(Clone, Debug)]
pub(in crate::resample) struct Round {
    pub(in crate::resample) map: PolarStereographic,
    /// Pixels to the radius of the body.
    pub(in crate::resample) scale: f64,
    pub(in crate::resample) aspect: f64,
    /// Column and row of the pole, and the size.
    pub(in crate::resample) pole: [f64; 2],
    pub(in crate::resample) size: [u32; 2],
}

pub(in crate::resample) fn round() -> impl Strategy<Value = Round> {
    let scale = prop_oneof![20.0..300.0, 300.0..20_000.0];
    let aspect = prop_oneof![Just(1.0), 0.7..1.4];
    let pole =
        prop_oneof![Just([-0.5, -0.5]), [-0.5..3.0, -0.5..3.0], [-3000.0..3000.0, -3000.0..3000.0]];
    (polar(), scale, aspect, pole, any::<bool>(), [1_u32..300, 1_u32..300]).prop_map(
        |(map, scale, aspect, pole, centered, size)| {
            let middle = size.map(|side| f64::from(side / 2));
            let pole = if centered { [pole[0] + middle[0], pole[1] + middle[1]] } else { pole };
            Round { map, scale, aspect, pole, size }
        },
    )
}

impl Round {
    pub(in crate::resample) fn placement(
        &self,
        (body, latitudes): (Ellipsoid, LatitudeKind),
    ) -> Placement {
        let crs = Crs::new(Projection::PolarStereographic(self.map), body).on_body(body, latitudes);
        let pixel = body.a().0 / self.scale;
        let pixel_size = [pixel, pixel * self.aspect];
        let [x, y] = self.pole;
        let origin = [
            self.map.false_easting.0 - (x + 0.5) * pixel_size[0],
            self.map.false_northing.0 + (y + 0.5) * pixel_size[1],
        ];
        let [width, height] = self.size;
        Placement::from_outline(crs, Outline { origin, pixel_size, width, height }).unwrap()
    }

    pub(in crate::resample) fn grid(&self, surface: (Ellipsoid, LatitudeKind)) -> Grid {
        let placement = self.placement(surface);
        let (origin, pixel_size) = (placement.origin, placement.pixel_size);
        Grid::new(placement.crs, origin, pixel_size, placement.extent(), 514).unwrap()
    }
}

/// How far two columns are apart, whole turns of a source that goes around not counted.
fn columns_apart(source: &Placement, one: f64, other: f64) -> f64 {
    let apart = (one - other).abs();
    if !source.wraps {
        return apart;
    }
    let turns = (apart / f64::from(source.width)).round();
    (apart - turns * f64::from(source.width)).abs()
}

/// The row and column of the target that shows in the extended level.
fn shown(target: &Placement, row: i64, col: i64) -> (f64, f64) {
    let extension = Extension::new(target.extent());
    let from = extension.row(row);
    // What is no pole repeats the last texel.
    let nearest = |at: i64, length: u32| at.clamp(0, i64::from(length) - 1) as f64;
    let row = if from.real { f64::from(from.index) } else { nearest(row, target.height) };
    if !target.wraps {
        return (row, nearest(col, target.width));
    }
    (row, f64::from(extension.col(col, from.real && from.turned).index))
}

/// Holds all texels of a tile against the exact way: the largest difference.
fn check(transform: &Transform, tile: TargetTile) -> Result<f64, TestCaseError> {
    let source = transform.source();
    let mut coords = Coords::default();
    let footprint = transform.coords(tile, &mut coords);
    prop_assert!(footprint.texel_u.is_finite() && footprint.detail_u >= 1.0, "{footprint:?}");
    prop_assert!(footprint.texel_v.is_finite() && footprint.detail_v >= 1.0, "{footprint:?}");
    let bound = transform.bound_px();
    prop_assert!(bound <= 1.0 / 16384.0, "{bound}");
    let range = transform.range(tile);
    let (width, height) = (f64::from(source.width), f64::from(source.height));
    let mut worst = 0.0_f64;
    for at in 0..tile.rows * tile.cols {
        let (row, col) = (at / tile.cols, at % tile.cols);
        let (row, col) = (tile.row + row as i64, tile.col + col as i64);
        let (u, v) = (coords.u[at], coords.v[at]);
        prop_assert!(coords.range[0] <= u && u <= coords.range[1], "{u} {:?}", coords.range);
        prop_assert!(coords.range[2] <= v && v <= coords.range[3], "{v} {:?}", coords.range);

        let (shown_row, shown_col) = shown(transform.target(), row, col);
        let expected = transform.exact(shown_row, shown_col);
        let inside_u = |u: f64| source.wraps || (-0.5..=width - 0.5).contains(&u);
        let inside = |(u, v): (f64, f64)| inside_u(u) && (-0.5..=height - 0.5).contains(&v);
        let position = transform.pair.position(shown_row, shown_col);
        let from_pole =
            position.map_or(1.0, |it| std::f64::consts::FRAC_PI_2 - it.latitude.0.abs());
        // Columns of a place so near a pole are rounding.
        let at_pole = from_pole < 1e-9 && source.crs.wraps_with_period().is_some();
        match expected {
            Some(expected) if inside(expected) => {
                let off = (v - expected.1).abs();
                let off = if at_pole { off } else { off.max(columns_apart(source, u, expected.0)) };
                prop_assert!(off <= bound, "{row} {col}: {u} {v}, {expected:?}: {off:e} {bound:e}");
                worst = worst.max(off);
                let Some([left, right, top, bottom]) = range else {
                    prop_assert!(at_pole, "{row} {col} lies inside, at {expected:?}");
                    continue;
                };
                prop_assert!(top - bound <= v && v <= bottom + bound, "{v} {range:?}");
                prop_assert!(
                    at_pole
                        || (left - bound <= u && u <= right + bound)
                        || source.wraps && left - bound <= u + width && u + width <= right + bound
                        || source.wraps && left - bound <= u - width && u - width <= right + bound,
                    "{u} {range:?}"
                );
            }
            Some(_) if at_pole => {}
            Some(expected) => {
                // The very edge may fall to either side.
                let (u, v) = (
                    u - 0.001 * (u - width / 2.0).signum(),
                    v - 0.001 * (v - height / 2.0).signum(),
                );
                let near = (expected.0 - u).abs() < 0.26 && (expected.1 - v).abs() < 0.26;
                prop_assert!(near || !inside((u, v)), "{row} {col}: {u} {v}, {expected:?}");
            }
            None => prop_assert!(!inside((u, v)), "{row} {col}: {u} {v} shows nothing"),
        }
    }
    Ok(worst)
}

/// A tile of a target, which may reach into the ring around it.
fn tile_at(target: &Placement, place: [f64; 2], size: [usize; 2]) -> TargetTile {
    let start = |place: f64, length: u32| (place * f64::from(length + 2)).floor() as i64 - 1;
    let (row, col) = (start(place[0], target.height), start(place[1], target.width));
    let fit =
        |start: i64, length: u32, size: usize| size.min((i64::from(length) + 1 - start) as usize);
    let (rows, cols) = (fit(row, target.height, size[0]), fit(col, target.width, size[1]));
    TargetTile { row, col, rows, cols }
}

fn places() -> impl Strategy<Value = ([f64; 2], [usize; 2])> {
    let place = || prop_oneof![Just(0.0), 0.0..1.0, 0.9..1.0];
    let size = || prop_oneof![Just(64_usize), 1_usize..=64];
    ([place(), place()], [size(), size()])
}

fn transform(target: &Placement, source: &Placement) -> Transform {
    Transform::new(target, source, Precision::default()).expect("they show one body")
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(600))]

    #[test]
    fn a_straight_map_of_a_polar_source_is_exact(
        surface in surfaces(), target in straight(), source in round(), (place, size) in places(),
    ) {
        let target = target.placement(surface);
        let transform = transform(&target, &source.placement(surface));
        check(&transform, tile_at(&target, place, size))?;
    }

    #[test]
    fn a_polar_map_of_a_straight_source_keeps_its_bound(
        surface in surfaces(), target in round(), source in straight(), (place, size) in places(),
    ) {
        let target = target.placement(surface);
        let transform = transform(&target, &source.placement(surface));
        let tile = tile_at(&target, place, size);
        let pieces = transform.tiles(rows_of(tile), cols_of(tile));
        prop_assert_eq!(pieces.iter().map(|it| it.rows * it.cols).sum::<usize>(), tile.rows * tile.cols);
        check(&transform, tile)?;
        check(&transform, pieces[pieces.len() / 2])?;
    }

    #[test]
    fn a_straight_map_of_a_straight_source_is_exact(
        surface in surfaces(), target in straight(), source in straight(),
        (place, size) in places(),
    ) {
        let target = target.placement(surface);
        let transform = transform(&target, &source.placement(surface));
        check(&transform, tile_at(&target, place, size))?;
    }

    #[test]
    fn polar_maps_about_one_pole_are_one_figure(
        surface in surfaces(), target in round(), source in round(), (place, size) in places(),
    ) {
        // About the same place on the ground, so that they meet.
        let scale = source.scale.min(target.scale * 50.0).max(target.scale / 50.0);
        let map = PolarStereographic { pole: target.map.pole, ..source.map };
        let source = Round { map, scale, ..source };
        let target = target.placement(surface);
        let transform = transform(&target, &source.placement(surface));
        check(&transform, tile_at(&target, place, size))?;
        let is_within_the_map = transform.pair.position(-1.0, -1.0).is_some()
            && transform.pair.position(target.height.into(), target.width.into()).is_some()
            && transform.pair.position(-1.0, target.width.into()).is_some()
            && transform.pair.position(target.height.into(), -1.0).is_some();
        prop_assert_eq!(matches!(transform.case, Case::Similar(_)), is_within_the_map);
    }

    #[test]
    fn a_polar_map_of_a_polar_source_is_exact(
        surface in surfaces(), target in round(), source in round(), (place, size) in places(),
    ) {
        let target = target.placement(surface);
        let transform = transform(&target, &source.placement(surface));
        check(&transform, tile_at(&target, place, size))?;
    }
}

/// V was interpolated from nodes on both sides of the pole, where it turns: 0.01 pixels off.
#[test]
fn one_texel_beside_the_pole_is_exact() {
    let surface = (Ellipsoid::sphere(Meters(1e5)).unwrap(), LatitudeKind::Planetographic);
    let map = PolarStereographic {
        pole: Pole::South,
        central_meridian: Radians(0.0),
        scale: PolarScale::AtPole(0.9),
        false_easting: Meters(0.0),
        false_northing: Meters(0.0),
    };
    let target = Round { map, scale: 20.0, aspect: 1.0, pole: [5.8, 1.6], size: [7, 3] };
    let source = Straight {
        projection: Projection::Geographic,
        on_sphere: false,
        half_width: 200,
        posts: false,
        part: None,
    };
    let transform = transform(&target.placement(surface), &source.placement(surface));
    for col in [5, 6] {
        check(&transform, TargetTile { row: 2, col, rows: 1, cols: 1 }).unwrap();
    }
}

/// Columns were taken from the middle row, which by rounding lies past the pole here: half a turn off.
#[test]
fn two_rows_of_posts_that_end_on_a_pole_have_their_columns() {
    let radius = Meters(1_911_310.285_524_836_5);
    let surface = (Ellipsoid::sphere(radius).unwrap(), LatitudeKind::Planetographic);
    let map = |projection, posts, part| Straight {
        projection,
        on_sphere: false,
        half_width: 8,
        posts,
        part,
    };
    let straight = Projection::Equirectangular(Equirectangular {
        false_easting: Meters(1234.5),
        ..Equirectangular::default()
    });
    let target = map(straight, true, Some([0.0, 0.2, 15.1 / 17.0, 0.5])).placement(surface);
    assert_eq!(target.height, 2, "the last of 17 rows, and the one before");
    let source = map(Projection::Geographic, false, None).placement(surface);
    check(&transform(&target, &source), TargetTile { row: 0, col: 0, rows: 2, cols: 3 }).unwrap();
}

/// A texel's place in the source leads back to it, to rounding: 10⁻⁹ radii of the body are so many
/// texels.
fn check_back(transform: &Transform, place: [f64; 2]) -> Result<(), TestCaseError> {
    let target = transform.target();
    let row = place[0] * (f64::from(target.height) - 1.0);
    let col = place[1] * (f64::from(target.width) - 1.0);
    let Some((u, v)) = transform.exact(row, col) else { return Ok(()) };
    let (back_row, back_col) = transform.back(u, v).expect("what is seen is on both maps");
    let texels_per_radius = target.crs.body.a().0 / target.nominal_pixel().0;
    let tolerance = 1e-9 * texels_per_radius.max(1.0);
    prop_assert!((back_row - row).abs() <= tolerance, "{row} {col}: {back_row} {back_col}");
    let position = transform.pair.position(row, col).unwrap();
    let from_pole = std::f64::consts::FRAC_PI_2 - position.latitude.0.abs();
    let turn = target.period_px().unwrap_or(0.0);
    let off = (back_col - col).abs();
    // Meridians meet at the poles, and a whole turn is none.
    let off = off.min((off - turn).abs()) * if turn > 0.0 { from_pole.sin() } else { 1.0 };
    prop_assert!(off <= tolerance, "{row} {col}: {back_row} {back_col}");
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(600))]

    #[test]
    fn back_leads_to_where_one_came_from(
        surface in surfaces(), one in straight(), other in round(), third in straight(),
        place in [0.0..=1.0, 0.0..=1.0_f64],
    ) {
        check_back(&transform(&other.placement(surface), &one.placement(surface)), place)?;
        let target = one.placement(surface);
        check_back(&transform(&target, &other.placement(surface)), place)?;
        check_back(&transform(&target, &third.placement(surface)), place)?;
    }
}

#[test]
fn what_is_asked_for_exactly_is_done_one_by_one() {
    let surface = (Ellipsoid::WGS84, LatitudeKind::Planetographic);
    let map = PolarStereographic {
        pole: Pole::South,
        central_meridian: Radians(1.0),
        scale: PolarScale::AtPole(0.994),
        false_easting: Meters(2e6),
        false_northing: Meters(2e6),
    };
    let target = Round { map, scale: 6000.0, aspect: 1.0, pole: [999.5; 2], size: [2000; 2] };
    let source = Straight {
        projection: Projection::Geographic,
        on_sphere: false,
        half_width: 5000,
        posts: true,
        part: None,
    };
    let (target, source) = (target.placement(surface), source.placement(surface));
    let tile = TargetTile { row: 0, col: 0, rows: 64, cols: 64 };
    let count = |precision| {
        let transform = Transform::new(&target, &source, precision).unwrap();
        transform.coords(tile, &mut Coords::default());
        transform.counts()
    };
    let series = TransformCounts { series: 4096, ..TransformCounts::default() };
    assert_eq!(count(Precision::default()), series);
    let exact = TransformCounts { exact: 4096, ..TransformCounts::default() };
    assert_eq!(count(Precision::Exact), exact);
    assert_eq!(count(Precision::Within { px: 1e-9 }), exact);

    let moon = Crs::new(Projection::Geographic, Ellipsoid::sphere(Meters(1_737_400.0)).unwrap());
    let elsewhere = Placement { crs: moon, ..source };
    assert!(Transform::new(&target, &elsewhere, Precision::default()).is_none());
}
