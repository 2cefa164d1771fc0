//! Normals against planes, an analytic planet and the rule texel by texel, on grids of all kinds.

use std::sync::Mutex;

use areoid_formats::body::{Body, Ellipsoid};
use areoid_formats::geodesy::{Geographic, surface_normal};
use areoid_formats::grid::{Outline, TexelPoint};
use areoid_formats::projection::Crs;
use areoid_formats::pyramid::Extent;
use areoid_formats::units::{Meters, Radians};
use glam::DVec3;
use proptest::prelude::*;

use super::*;

/// Heights in memory, and which leaves were asked for.
#[derive(Debug)]
struct Heights {
    grid: Grid,
    heights: Vec<f32>,
    read: Mutex<Vec<PageAddress>>,
    skipped: Mutex<Vec<PageAddress>>,
}

impl Heights {
    fn new(grid: Grid, height: impl Fn(u32, u32) -> f64) -> Self {
        let Extent { width, height: rows, .. } = grid.pyramid().extent();
        let texels = (0..rows).flat_map(|row| (0..width).map(move |col| (row, col)));
        #[expect(clippy::cast_possible_truncation, reason = "heights are f32")]
        let heights = texels.map(|(row, col)| height(row, col) as f32).collect();
        Self { grid, heights, read: Mutex::default(), skipped: Mutex::default() }
    }
}

impl Leaves for Arc<Heights> {
    fn read(&self, page: PageAddress) -> Result<Option<Raw>, RasterError> {
        self.read.lock().unwrap().push(page);
        let pyramid = self.grid.pyramid();
        let (interior, side) = (pyramid.interior(), pyramid.page_side() as usize);
        let (rows, cols) = pyramid.interior_size(page);
        let mut plane = vec![f32::NAN; side * side];
        for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
            let from =
                (page.row * interior + row) * pyramid.extent().width + page.col * interior + col;
            plane[(row as usize + 1) * side + col as usize + 1] = self.heights[from as usize];
        }
        if plane.iter().all(|height| height.is_nan()) {
            return Ok(None);
        }
        let alpha = plane.iter().map(|height| if height.is_nan() { 0 } else { 255 }).collect();
        Ok(Some(Raw { planes: Planes::Height(plane), alpha: Some(alpha) }))
    }

    fn skip(&self, page: PageAddress) {
        self.skipped.lock().unwrap().push(page);
    }
}

impl Origin for Arc<Heights> {
    fn grid(&self) -> &Grid {
        &self.grid
    }

    fn apart(&self) -> Box<dyn Origin> {
        Box::new(Self::clone(self))
    }

    fn spill(&mut self, _: &Arc<Overflow>) {}

    fn decoded_blocks(&self) -> u64 {
        0
    }

    fn blocks(&self) -> u64 {
        0
    }

    fn decoded_for(&self, _: &[PageAddress]) -> u64 {
        0
    }
}

fn leaves_of(grid: &Grid) -> Vec<PageAddress> {
    let finest = grid.pyramid().finest();
    let (rows, cols) = grid.pyramid().pages(finest).unwrap();
    (0..rows).flat_map(|row| (0..cols).map(move |col| PageAddress::new(finest, row, col))).collect()
}

/// The codes of all texels of a grid; `None` where there is no normal.
fn codes_of(heights: Heights) -> Vec<Option<[u8; 3]>> {
    let grid = heights.grid.clone();
    let normals = Normals::new(Box::new(Arc::new(heights)));
    let (interior, width) = (grid.pyramid().interior(), grid.pyramid().extent().width);
    let mut all = vec![None; width as usize * grid.pyramid().extent().height as usize];
    for page in leaves_of(&grid) {
        let Some(raw) = normals.read(page).unwrap() else { continue };
        let Planes::Color(planes) = &raw.planes else { panic!("normals are codes") };
        let side = grid.pyramid().page_side() as usize;
        let (rows, cols) = grid.pyramid().interior_size(page);
        for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
            let at = (row as usize + 1) * side + col as usize + 1;
            let codes = [0, 1, 2].map(|channel: usize| planes[channel][at]);
            let is_valid = raw.alpha.as_ref().is_none_or(|alpha| alpha[at] == 255);
            assert_eq!(is_valid, codes.iter().all(|&code| code > 0));
            assert_eq!(is_valid, codes.iter().any(|&code| code > 0));
            let to = (page.row * interior + row) * width + page.col * interior + col;
            all[to as usize] = is_valid.then_some(codes);
        }
    }
    all
}

/// How far codes are from those of a normal, before these are rounded.
fn off(codes: [u8; 3], normal: DVec3, up: DVec3) -> f64 {
    let exact = (normal - up) * 127.0 + 128.0;
    (DVec3::from_array(codes.map(f64::from)) - exact).abs().max_element()
}

fn position(grid: &Grid, row: u32, col: u32) -> Geographic {
    let point = TexelPoint { x: f64::from(col) + 0.5, y: f64::from(row) + 0.5 };
    grid.geographic_from_texel(grid.pyramid().finest(), point).unwrap()
}

fn texels(grid: &Grid) -> impl Iterator<Item = (u32, u32)> + use<> {
    let Extent { width, height, .. } = grid.pyramid().extent();
    (0..height).flat_map(move |row| (0..width).map(move |col| (row, col)))
}

/// A map of a body from the start of a PROJ string.
fn grid(
    proj: &str,
    body: Ellipsoid,
    origin: [f64; 2],
    pixel: f64,
    (width, height): (u32, u32),
    page_side: u32,
) -> Grid {
    let text = format!("{proj} +a={} +b={} +no_defs", body.a().0, body.b().0);
    let crs = Crs::from_proj_string(&text).unwrap();
    let outline = Outline { origin, pixel_size: [pixel; 2], width, height };
    Grid::from_outline(crs, outline, page_side).unwrap().grid
}

const NORTH: &str = "+proj=stere +lat_0=90 +lat_ts=90 +lon_0=20";
const SOUTH: &str = "+proj=stere +lat_0=-90 +lat_ts=-90 +lon_0=-70";
const DEGREES: &str = "+proj=longlat";

fn sphere() -> Ellipsoid {
    Body::parse("mars").unwrap().ellipsoid
}

/// Flatter than any planet.
fn flat() -> Ellipsoid {
    Body::parse("3400000,2600000").unwrap().ellipsoid
}

/// Pages small enough that edges are everywhere.
const PAGE: u32 = 18;

/// Globes of areas and of posts, maps of both poles, and one across the antimeridian.
fn grids(body: Ellipsoid) -> [Grid; 5] {
    let ground = 2.5_f64.to_radians() * body.a().0;
    let polar = [-24.0 * ground, 24.0 * ground];
    [
        grid(DEGREES, body, [-180.0, 90.0], 2.5, (144, 72), PAGE),
        grid(DEGREES, body, [-1.25, 91.25], 2.5, (144, 73), PAGE),
        grid(NORTH, body, polar, ground, (48, 48), PAGE),
        grid(SOUTH, body, polar, ground, (48, 48), PAGE),
        grid(DEGREES, body, [150.0, 60.0], 2.5, (30, 40), PAGE),
    ]
}

/// The planet's height, in radii, toward a direction of the zenith, and its gradient.
fn planet(s: DVec3) -> (f64, DVec3) {
    let DVec3 { x, y, z } = s;
    let (sin, cos) = (5.0 * x - 4.0 * y + 3.0 * z).sin_cos();
    let height = 0.4 * x + 0.8 * x * y * z + 0.5 * z * z - 0.3 * y * y * y + 0.15 * sin;
    let gradient = DVec3::new(
        0.4 + 0.8 * y * z + 0.75 * cos,
        0.8 * x * z - 0.9 * y * y - 0.6 * cos,
        0.8 * x * y + z + 0.45 * cos,
    );
    (0.1 * height, 0.1 * gradient)
}

/// The planet's exact normal: that of X = foot + H n with foot and n by latitude φ and longitude λ, so
/// ∂X/∂φ = (M + H) φ̂ + ∂H/∂φ n and ∂X/∂λ = (N + H) cos φ λ̂ + ∂H/∂λ n, M and N the radii of
/// curvature.
fn exact_normal(body: Ellipsoid, at: Geographic) -> (DVec3, DVec3) {
    let (a, b) = (body.a().0, body.b().0);
    let (sin_phi, cos_phi) = at.latitude.0.sin_cos();
    let (sin_lambda, cos_lambda) = at.longitude.0.sin_cos();
    let up = DVec3::new(cos_phi * cos_lambda, cos_phi * sin_lambda, sin_phi);
    let north = DVec3::new(-sin_phi * cos_lambda, -sin_phi * sin_lambda, cos_phi);
    let east = DVec3::new(-sin_lambda, cos_lambda, 0.0);
    let e2 = 1.0 - b * b / (a * a);
    let w2 = 1.0 - e2 * sin_phi * sin_phi;
    let (m, n) = (a * (1.0 - e2) / w2.powf(1.5), a / w2.sqrt());
    let (height, gradient) = planet(up);
    let (height, gradient) = (a * height, a * gradient);
    let slopes =
        gradient.dot(north) / (m + height) * north + gradient.dot(east) / (n + height) * east;
    ((up - slopes).normalize(), up)
}

/// What central differences leave of a code at 2.5 degrees a texel, besides its rounding: a sixth of the
/// square of the step, in radians, times third derivatives of up to 0.1 · 0.15 · 7³ and what the other
/// terms and the body's own shape have, times 127.
const TRUNCATION: f64 = 0.5;

#[test]
fn an_analytic_planet_has_its_normals_at_poles_and_antimeridian_as_elsewhere() {
    for body in [sphere(), flat()] {
        for grid in grids(body) {
            let extent = grid.pyramid().extent();
            let codes = codes_of(Heights::new(grid.clone(), |row, col| {
                body.a().0 * planet(surface_normal(position(&grid, row, col))).0
            }));
            let (mut seams, mut elsewhere, mut outline) = (0.0_f64, 0.0_f64, 0.0_f64);
            for ((row, col), codes) in texels(&grid).zip(codes) {
                let at = position(&grid, row, col);
                let (normal, up) = exact_normal(body, at);
                let off = off(codes.unwrap(), normal, up);
                let beside_seam = at.latitude.0.abs() > 86.0_f64.to_radians()
                    || at.longitude.0.abs() > 177.0_f64.to_radians();
                let on_outline = [row, extent.height - 1 - row, col, extent.width - 1 - col];
                let worst = if !extent.wraps && on_outline.contains(&0) {
                    &mut outline
                } else if beside_seam {
                    &mut seams
                } else {
                    &mut elsewhere
                };
                *worst = worst.max(off);
            }
            assert!(elsewhere > 0.4 && elsewhere < 0.5 + TRUNCATION, "{elsewhere} on {grid:?}");
            assert!(seams > 0.4 && seams < 0.5 + TRUNCATION, "{seams} on {grid:?}");
            // On one side alone half a step, 0.022, times second derivatives of up to 0.1 · 0.15 · 7² and
            // what the other terms have is left in each axis, times 127.
            assert!(outline < 4.0, "{outline} on {grid:?}");
        }
    }
}

/// All differences lie in the plane, so every one of them has its normal: beside holes and outlines,
/// however the grid lies.
#[test]
fn a_plane_through_the_body_has_one_normal() {
    for body in [sphere(), flat()] {
        let ground = 10_000.0;
        let around = |[x, y]: [f64; 2]| [x - 20.0 * ground, y + 20.0 * ground];
        for grid in [
            grid(DEGREES, body, [175.0, 5.0], 0.25, (40, 40), PAGE),
            grid(DEGREES, body, [40.0, 65.0], 0.25, (40, 40), PAGE),
            grid(NORTH, body, around([0.0; 2]), ground, (40, 40), PAGE),
            grid(SOUTH, body, around([3e5, -4e5]), ground, (40, 40), PAGE),
        ] {
            let middle = position(&grid, 20, 20);
            let up = surface_normal(middle);
            let tilted = (up + 0.4 * up.any_orthonormal_vector()).normalize();
            let through = tilted.dot(body.cartesian_from_geographic(middle, Meters(0.0)));
            let is_hole = |row: u32, col: u32| row.is_multiple_of(7) && col.is_multiple_of(5);
            let codes = codes_of(Heights::new(grid.clone(), |row, col| {
                let at = position(&grid, row, col);
                let foot = body.cartesian_from_geographic(at, Meters(0.0));
                let height = (through - tilted.dot(foot)) / tilted.dot(surface_normal(at));
                if is_hole(row, col) { f64::NAN } else { height }
            }));
            for ((row, col), codes) in texels(&grid).zip(codes) {
                assert_eq!(codes.is_none(), is_hole(row, col));
                let Some(codes) = codes else { continue };
                let off = off(codes, tilted, surface_normal(position(&grid, row, col)));
                let is_there = |row: u32, col: u32| row < 40 && col < 40 && !is_hole(row, col);
                let beside = [(1, 0), (1, 2), (0, 1), (2, 1)];
                let is_inside = beside.into_iter().all(|(down, right)| {
                    is_there((row + down).wrapping_sub(1), (col + right).wrapping_sub(1))
                });
                // Rounding to f32 bends the plane by so much. Over a body that is round, it is none to
                // who sees one side alone: half of a texel's turn, 0.0022, in each axis.
                let allowed = if is_inside { 0.501 } else { 0.501 + 2.0 * 127.0 * 0.0027 };
                assert!(off < allowed, "{off} at {row}, {col} on {grid:?}");
            }
        }
    }
}

/// What a row or a column of texels says along itself, and nothing across.
#[test]
fn one_row_one_column_and_one_texel_are_level_across() {
    let body = sphere();
    let row = grid(DEGREES, body, [10.0, 0.5], 1.0, (30, 1), PAGE);
    let column = grid(DEGREES, body, [24.5, 25.0], 1.0, (1, 30), PAGE);
    for grid in [row, column] {
        let middle = surface_normal(Geographic {
            longitude: Radians(25.0_f64.to_radians()),
            latitude: Radians(0.0),
        });
        // In the plane of the equator, or of the meridian.
        let across =
            if grid.pyramid().extent().height == 1 { DVec3::Z } else { DVec3::Z.cross(middle) };
        let tilted = (middle + 0.3 * middle.cross(across).normalize()).normalize();
        let codes = codes_of(Heights::new(grid.clone(), |row, col| {
            let up = surface_normal(position(&grid, row, col));
            body.a().0 * (tilted.dot(middle) / tilted.dot(up) - 1.0)
        }));
        for ((row, col), codes) in texels(&grid).zip(codes) {
            let off = off(codes.unwrap(), tilted, surface_normal(position(&grid, row, col)));
            // The ends see one side alone.
            let is_end = [0, 29].contains(&row.max(col));
            assert!(off < if is_end { 2.0 } else { 0.501 }, "{off} at {row}, {col}");
        }
    }
    let texel = grid(DEGREES, body, [10.0, 80.0], 1.0, (1, 1), PAGE);
    assert_eq!(codes_of(Heights::new(texel, |_, _| 5000.0)), [Some([128; 3])]);
}

#[test]
fn a_round_planet_is_level_everywhere() {
    for body in [sphere(), flat()] {
        for grid in grids(body) {
            // A chord of rows that are not equally far leans a little.
            let most = u8::from(!(body.is_sphere() && grid.pyramid().extent().wraps));
            for codes in codes_of(Heights::new(grid, |_, _| 12_345.0)) {
                let codes = codes.unwrap();
                assert!(codes.iter().all(|&code| code.abs_diff(128) <= most), "{codes:?}");
            }
        }
    }
}

/// The normal of a texel from a plain array, by the words of FORMAT.md. Contacts are of both poles.
fn by_the_words(grid: &Grid, heights: &[f32], row: i64, col: i64) -> Option<DVec3> {
    let Extent { width, height, wraps, north, .. } = grid.pyramid().extent();
    let (width, height) = (i64::from(width), i64::from(height));
    let place = |row: i64, col: i64| -> Option<(DVec3, f64)> {
        let (row, col) = match (row < 0, row >= height, north) {
            (false, false, _) => (row, col),
            (_, _, PoleContact::None) => return None,
            (true, _, PoleContact::Outline) => (-1 - row, col + width / 2),
            (true, _, PoleContact::Posts) => (-row, col + width / 2),
            (_, _, PoleContact::Outline) => (2 * height - 1 - row, col + width / 2),
            (_, _, PoleContact::Posts) => (2 * height - 2 - row, col + width / 2),
        };
        if !wraps && !(0..width).contains(&col) {
            return None;
        }
        let col = col.rem_euclid(width);
        let above = f64::from(heights[usize::try_from(row * width + col).unwrap()]);
        let at = position(grid, u32::try_from(row).unwrap(), u32::try_from(col).unwrap());
        let place = grid.crs().body.cartesian_from_geographic(at, Meters(above));
        (!above.is_nan()).then_some((place, above))
    };
    let (here, height_here) = place(row, col)?;
    let at = position(grid, u32::try_from(row).unwrap(), u32::try_from(col).unwrap());
    let up = surface_normal(at);
    let between = |one: Option<(DVec3, f64)>, other: Option<(DVec3, f64)>| {
        let step = |(place, height): (DVec3, f64)| {
            let across = place - here;
            across - up * across.dot(up) + up * (height - height_here)
        };
        match (one, other) {
            (Some((one, _)), Some((other, _))) => one - other,
            (Some(one), None) => step(one),
            (None, Some(other)) => -step(other),
            (None, None) => DVec3::ZERO,
        }
    };
    let on_pole = north == PoleContact::Posts && (row == 0 || row == height - 1);
    let (beside, quarter) = if row == 0 { (1, width / 4) } else { (height - 2, width / 4) };
    let across = if on_pole {
        between(place(beside, col + quarter), place(beside, col + quarter + width / 2))
    } else {
        between(place(row, col + 1), place(row, col - 1))
    };
    let down = between(place(row + 1, col), place(row - 1, col));
    let normal = match (across.length() > 1e-3, down.length() > 1e-3) {
        (true, true) => across.cross(down),
        (true, false) => up - across * up.dot(across) / across.length_squared(),
        (false, true) => up - down * up.dot(down) / down.length_squared(),
        (false, false) => up,
    };
    Some(if normal.dot(up) < 0.0 { -normal.normalize() } else { normal.normalize() })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Whatever page shows a texel, and whatever leaves are skipped; heights are asked for once.
    #[test]
    fn every_texel_is_made_of_its_neighbors(
        seed in any::<u64>(), kind in 0..5_u8, half_width in 2..20_u32, rows in 3..30_u32,
        page_side in prop::sample::select(vec![8, 10, 24, 64]), skip in any::<u64>(),
    ) {
        let body = flat();
        let width = 2 * half_width;
        let (crs, origin, pixel, wraps, contact) = match kind {
            0 => (DEGREES, [-180.0, 90.0], [360.0 / f64::from(width), 180.0 / f64::from(2 * rows)], true, PoleContact::Outline),
            1 => {
                let step = 180.0 / f64::from(rows - 1);
                (DEGREES, [-180.0, 90.0 + step / 2.0], [360.0 / f64::from(width), step], true, PoleContact::Posts)
            }
            2 => (DEGREES, [-180.0, 40.0], [360.0 / f64::from(width), 2.0], true, PoleContact::None),
            3 => (DEGREES, [170.0, 40.0], [2.0, 2.0], false, PoleContact::None),
            _ => (NORTH, [-6e5, 9e5], [6e4, 7e4], false, PoleContact::None),
        };
        let rows = if kind == 0 { 2 * rows } else { rows };
        let crs = Crs::from_proj_string(&format!("{crs} +a={} +b={} +no_defs", body.a().0, body.b().0)).unwrap();
        let extent = Extent { width, height: rows, wraps, north: contact, south: contact };
        let Ok(grid) = Grid::new(crs, origin, pixel, extent, page_side) else { return Ok(()) };

        let random = |row: u32, col: u32| {
            let mixed = (seed ^ u64::from(row * 1000 + col)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            (mixed ^ mixed >> 31).wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 40
        };
        let heights = Heights::new(grid.clone(), |row, col| {
            let random = random(row, col);
            if random.is_multiple_of(5) { f64::NAN } else { random as f64 / 100.0 }
        });
        let plain = heights.heights.clone();
        let heights = Arc::new(heights);
        let normals = Normals::new(Box::new(Arc::clone(&heights)));
        let interior = grid.pyramid().interior();
        for (at, page) in leaves_of(&grid).into_iter().enumerate() {
            if skip >> (at % 64) & 1 == 1 {
                normals.skip(page);
                continue;
            }
            let raw = normals.read(page).unwrap();
            let side = page_side as usize;
            let stated = raw.as_ref().map_or(0.0, |raw| stated(&normals, page, raw, side));
            let (rows, cols) = grid.pyramid().interior_size(page);
            for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
                let [in_row, in_col] = [page.row * interior + row, page.col * interior + col];
                let expected = by_the_words(&grid, &plain, in_row.into(), in_col.into());
                let place = (row as usize + 1) * side + col as usize + 1;
                let found = raw.as_ref().and_then(|raw| {
                    let Planes::Color(planes) = &raw.planes else { panic!("normals are codes") };
                    let is_valid = raw.alpha.as_ref().is_none_or(|alpha| alpha[place] != 0);
                    is_valid.then(|| [0, 1, 2].map(|channel: usize| planes[channel][place]))
                });
                prop_assert_eq!(found.is_some(), expected.is_some());
                let (Some(found), Some(expected)) = (found, expected) else { continue };
                let up = surface_normal(position(&grid, in_row, in_col));
                let exact = (expected - up) * 127.0 + 128.0;
                for (code, exact) in found.into_iter().zip(exact.to_array()) {
                    let off = (f64::from(code) - exact).abs();
                    let clamped = (f64::from(code) - exact.clamp(1.0, 255.0)).abs();
                    prop_assert!(clamped <= 0.5 + 1e-6 && off <= stated + 1e-6, "{off}");
                }
            }
        }
        let mut asked = heights.read.lock().unwrap().clone();
        asked.extend(heights.skipped.lock().unwrap().iter());
        asked.sort_unstable();
        prop_assert_eq!(asked, leaves_of(&grid));
        prop_assert_eq!(normals.kept.resident_bytes(), 0);
    }
}

/// What normals say of their own error.
fn stated(normals: &Normals, page: PageAddress, raw: &Raw, side: usize) -> f64 {
    let Planes::Color(planes) = &raw.planes else { panic!("normals are codes") };
    let planes = PlanesView::Color(planes.each_ref().map(|plane| &plane[..]));
    let leaf = Closed { side, planes, coverage: raw.alpha.as_deref() };
    normals.source_error(page, Some(&leaf)).unwrap().unwrap().into()
}

/// A turn of columns leaves every normal as it was: there is no first column.
#[test]
fn a_globe_has_no_seam() {
    let body = flat();
    let at = |origin: f64| {
        let grid = grid(DEGREES, body, [origin, 90.0], 5.0, (72, 36), PAGE);
        codes_of(Heights::new(grid.clone(), |row, col| {
            body.a().0 * planet(surface_normal(position(&grid, row, col))).0
        }))
    };
    let (here, turned) = (at(-180.0), at(-180.0 + 5.0 * 29.0));
    for (row, col) in (0..36).flat_map(|row| (0..72).map(move |col| (row, col))) {
        let (one, other) =
            (here[row * 72 + col].unwrap(), turned[row * 72 + (col + 72 - 29) % 72].unwrap());
        let off = one.iter().zip(other).map(|(&one, other)| one.abs_diff(other)).max();
        // Longitudes that are written otherwise round otherwise.
        assert!(off <= Some(1), "{one:?} and {other:?} in row {row}");
    }
}
