use areoid_formats::body::Body;
use areoid_formats::geodesy::{Geographic, LatitudeKind};
use areoid_formats::grid::Outline;

use super::*;

fn request(map: TargetMap, pixel_m: Option<f64>) -> TargetRequest {
    TargetRequest { map, pixel_size: pixel_m.map(Meters), page_side: 512 }
}

fn degrees(origin: [f64; 2], pixel: f64, width: u32, height: u32) -> Placement {
    let crs = Crs::new(Projection::Geographic, Body::parse("mars").unwrap().ellipsoid);
    let outline = Outline { origin, pixel_size: [pixel; 2], width, height };
    Placement::from_outline(crs, outline).unwrap()
}

fn cap(pole: Pole, half: u32, pixel: f64) -> Placement {
    let body = Body::parse("mars").unwrap().ellipsoid;
    let edge = f64::from(half) * pixel;
    let outline = Outline {
        origin: [-edge, edge],
        pixel_size: [pixel; 2],
        width: 2 * half,
        height: 2 * half,
    };
    Placement::from_outline(polar(pole, body), outline).unwrap()
}

/// Every pixel's center of a source lies in the target, a whole pixel inside its edges at most.
fn covers(grid: &Grid, source: &Placement) {
    let finest = grid.pyramid().finest();
    for at in 0..=64 {
        for end in [0.0, 1.0] {
            let share = f64::from(at) / 64.0;
            for (u, v) in [(share, end), (end, share)] {
                let u = u * (f64::from(source.width) - 1.0);
                let v = v * (f64::from(source.height) - 1.0);
                let position = source.crs.unproject(source.map_from_pixel(u, v)).unwrap();
                assert!(grid.locate(finest, position).is_some(), "{u} {v} {position:?}");
            }
        }
    }
}

#[test]
fn an_uneven_globe_gets_the_next_even_width() {
    let globe = degrees([-180.0, 90.0], 360.0 / 106_694.0, 106_694, 53_347);
    let grid = target_grid(&[globe], request(TargetMap::Equirectangular, None)).unwrap();
    let extent = grid.pyramid().extent();
    assert_eq!((extent.width, extent.height), (106_752, 53_376));
    assert_eq!((extent.north, extent.south), (PoleContact::Outline, PoleContact::Outline));
    covers(&grid, &globe);
}

#[test]
fn a_cap_becomes_a_band_around_the_body_that_ends_at_its_pole() {
    for pole in [Pole::North, Pole::South] {
        let cap = cap(pole, 2048, 500.0);
        let grid = target_grid(&[cap], request(TargetMap::Equirectangular, None)).unwrap();
        let extent = grid.pyramid().extent();
        let reached = [extent.north, extent.south].map(|it| it == PoleContact::Outline);
        assert!(extent.wraps && reached == [pole == Pole::North, pole == Pole::South]);
        // Square pixels, the last of an even width smaller by a little.
        let [x, y] = grid.pixel_size();
        assert!((x - y).abs() < 1e-9 && x <= 500.0 && x > 470.0, "{x} {y}");
        covers(&grid, &cap);
    }
}

#[test]
fn a_globe_becomes_a_hemisphere_about_a_pole() {
    let globe = degrees([-180.0, 90.0], 0.125, 2880, 1440);
    let grid = target_grid(&[globe], request(TargetMap::Polar(Pole::South), Some(5000.0)));
    let extent = grid.unwrap().pyramid().extent();
    // The equator is two radii from the pole.
    let across = 2717;
    assert!(extent.width.abs_diff(across) <= 1 && extent.height.abs_diff(across) <= 1);
}

#[test]
fn a_region_over_the_antimeridian_stays_one() {
    let region = degrees([170.0, 20.0], 0.1, 200, 100);
    let grid = target_grid(&[region], request(TargetMap::Equirectangular, None)).unwrap();
    let extent = grid.pyramid().extent();
    assert!(!extent.wraps && (200..=201).contains(&extent.width));
    assert!((100..=101).contains(&extent.height), "{extent:?}");
    covers(&grid, &region);
    let grid = target_grid(&[region], request(TargetMap::Polar(Pole::North), None)).unwrap();
    covers(&grid, &region);
}

#[test]
fn the_native_grid_is_kept_or_made_coarser_from_its_corner() {
    let region = degrees([350.0, 20.0], 0.1, 200, 100);
    let same = target_grid(&[region], request(TargetMap::Native, None)).unwrap();
    assert_eq!((same.origin(), same.pixel_size()), ([350.0, 20.0], [0.1; 2]));
    let twice = 2.0 * region.nominal_pixel().0;
    let grid = target_grid(&[region], request(TargetMap::Native, Some(twice))).unwrap();
    let extent = grid.pyramid().extent();
    assert_eq!((extent.width, extent.height), (100, 50));
    covers(&grid, &region);
}

#[test]
fn what_makes_no_target_is_refused() {
    let south = degrees([0.0, -20.0], 0.1, 200, 100);
    let map = TargetMap::Polar(Pole::North);
    assert_eq!(target_grid(&[south], request(map, None)), Err(TargetError::NothingShown));
    assert_eq!(target_grid(&[], request(map, None)), Err(TargetError::Empty));
    let flat = target_grid(&[south], request(map, Some(0.0)));
    assert_eq!(flat, Err(TargetError::PixelSize(0.0)));
}

/// On a sphere, on an ellipsoid, of planetocentric latitudes, and of posts.
fn globes(rows: u32) -> Vec<Placement> {
    let ellipsoid = Body::parse("mars-ellipsoid").unwrap().ellipsoid;
    let sphere = degrees([-180.0, 90.0], 180.0 / f64::from(rows), 2 * rows, rows);
    let geographic = Crs::new(Projection::Geographic, ellipsoid);
    let centric = sphere.crs.on_body(ellipsoid, LatitudeKind::Planetocentric);
    let pixel = 180.0 / f64::from(rows - 1);
    let posts = degrees([-pixel / 2.0, 90.0 + pixel / 2.0], pixel, 2 * (rows - 1), rows);
    vec![
        sphere,
        Placement { crs: geographic, ..sphere },
        Placement { crs: centric, ..sphere },
        posts,
    ]
}

#[test]
fn a_cap_lies_about_its_pole_in_two_thirds_of_a_row() {
    for globe in globes(1440) {
        let split = split(&globe, 512).unwrap();
        for (cap, pole) in [(&split.north, Pole::North), (&split.south, Pole::South)] {
            let finest = cap.pyramid().finest();
            let Extent { width, height, wraps, .. } = cap.pyramid().extent();
            assert!(!wraps && width == height && width % 2 == 0);
            let latitude = Radians(pole.sign() * std::f64::consts::FRAC_PI_2);
            let at = cap.locate(finest, Geographic { latitude, ..Geographic::default() }).unwrap();
            let middle = f64::from(width / 2);
            assert!((at.x - middle).abs() < 1e-9 && (at.y - middle).abs() < 1e-9, "{at:?}");
            // A row below the pole is a texel and a half away.
            let mut row = globe.map_from_pixel(0.0, 0.0);
            row.y = globe.crs.y_of_pole(pole).unwrap() - pole.sign() * globe.pixel_size[1];
            let below = cap.locate(finest, globe.crs.unproject(row).unwrap()).unwrap();
            let texels = (below.x - middle).hypot(below.y - middle);
            assert!((texels - 1.5).abs() < 1e-9, "{texels}");
        }
    }
}

/// Walks from part to part and asks the brute force of the feather: how far, in texels of its own,
/// is a place from a part's outline?
#[test]
fn of_the_parts_of_a_globe_one_covers_wholly_wherever_the_other_does_not() {
    for globe in globes(720).into_iter().chain(globes(216)) {
        let split = split(&globe, 66).unwrap();
        // Texels past the last center where all taps are full: those 32 from the edge are.
        let full = 32.5;
        let deep = |edges: [f64; 4]| edges.into_iter().fold(f64::INFINITY, f64::min) >= full;
        let in_band = |position| {
            let row = globe.pixel_from_map(globe.crs.project(position).unwrap()).1 + 0.5;
            let (top, bottom) = (f64::from(split.rows.start), f64::from(split.rows.end));
            deep([row - top, bottom - row, f64::INFINITY, f64::INFINITY])
        };
        let in_cap = |cap: &Grid, position| {
            let side = f64::from(cap.pyramid().extent().width);
            let at = cap.locate(cap.pyramid().finest(), position);
            at.is_some_and(|at| deep([at.x, at.y, side - at.x, side - at.y]))
        };
        let (mut band, mut caps, mut both) = (0, 0, 0);
        for step in 0..=3600 {
            for turn in 0..90 {
                let latitude = Radians((f64::from(step) / 3600.0 - 0.5) * std::f64::consts::PI);
                let position = Geographic { latitude, longitude: Radians(f64::from(turn) * 0.07) };
                let in_caps = in_cap(&split.north, position) || in_cap(&split.south, position);
                match (in_band(position), in_caps) {
                    (true, true) => both += 1,
                    (true, false) => band += 1,
                    (false, true) => caps += 1,
                    (false, false) => panic!("{position:?} is covered wholly by neither"),
                }
            }
        }
        assert!(band > 1000 && caps > 1000 && both > 0, "{band} {caps} {both}");
    }
}

#[test]
fn what_is_no_globe_is_not_split() {
    let refused = |source: &Placement| split(source, 512).unwrap_err().to_string();
    let polar = cap(Pole::North, 100, 5000.0);
    assert!(refused(&polar).ends_with("lies on another map"));
    let half = degrees([0.0, 90.0], 0.25, 720, 720);
    assert!(refused(&half).ends_with("does not go all around"));
    let south = degrees([0.0, 45.0], 0.25, 1440, 540);
    assert!(refused(&south).ends_with("does not reach the north pole"));
    let north = degrees([0.0, 90.0], 0.25, 1440, 540);
    assert!(refused(&north).ends_with("does not reach the south pole"));
    let small = degrees([0.0, 90.0], 1.0, 360, 180);
    assert!(matches!(split(&small, 512), Err(TargetError::TooFewRows { found: 180, .. })));
    assert!(split(&degrees([0.0, 90.0], 180.0 / 204.0, 408, 204), 512).is_ok());
}
