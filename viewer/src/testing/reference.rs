//! The picture against an f64 ray caster of the same composed surface.

use areoid_cache::{Selection, View};
use areoid_formats::body::Ellipsoid;
use areoid_formats::geodesy::{Geographic, surface_normal};
use areoid_formats::grid::Outline;
use areoid_formats::page::Kind;
use areoid_formats::projection::{Crs, PolarScale, PolarStereographic, Pole, Projection};
use areoid_formats::units::{Degrees, Meters, Radians};
use glam::DVec3;

use super::{Planet, Sample, dataset, gpu};
use crate::camera::{Pose, pixel_angle};
use crate::shader::Program;
use crate::surface::Surface;
use crate::{Aovs, Light, Options, Renderer};

const SIDE: u32 = 160;
const LIGHT: Light = Light { toward_sun: DVec3::new(1.0, 0.5, 0.3), ambient: 0.1 };

fn at(longitude: f64, latitude: f64) -> Geographic {
    Geographic::from_degrees(Degrees(longitude), Degrees(latitude))
}

/// Hills of all sizes down to a few degrees, ±6 km.
fn hills(place: Geographic) -> f32 {
    let n = surface_normal(place);
    let waves = [(3.0, 2500.0), (11.0, 1500.0), (29.0, 900.0), (61.0, 500.0)];
    let sum: f64 = waves
        .iter()
        .map(|&(k, amplitude)| {
            amplitude * ((k * n.x + 0.3).sin() + (k * n.y + k).cos() + (k * n.z - 1.0).sin()) / 1.5
        })
        .sum();
    sum as f32
}

fn height(place: Geographic) -> Sample {
    ([hills(place), 0.0, 0.0], 255)
}

fn polar(pole: Pole, body: Ellipsoid) -> Crs {
    let map = PolarStereographic {
        pole,
        central_meridian: Degrees(-45.0).into(),
        scale: PolarScale::TrueAt(Degrees(70.0).into()),
        false_easting: Meters(0.0),
        false_northing: Meters(0.0),
    };
    Crs::new(Projection::PolarStereographic(map), body)
}

/// A globe and a cap on each pole whose coverage fades toward 60°.
pub(crate) fn planet(body: Ellipsoid) -> Selection {
    let mut planet = Planet::default();
    let degrees = Crs::new(Projection::Geographic, body);
    let outline =
        Outline { origin: [-180.0, 90.0], pixel_size: [0.25; 2], width: 1440, height: 720 };
    planet.add(dataset("globe", Kind::Height, degrees, outline, 128, 0), height);
    for pole in [Pole::North, Pole::South] {
        let half = 3.4e6;
        let outline = Outline {
            origin: [-half, half],
            pixel_size: [2.0 * half / 512.0; 2],
            width: 512,
            height: 512,
        };
        planet.add(
            dataset("cap", Kind::Height, polar(pole, body), outline, 128, 0),
            move |place| {
                let from_rim = pole.sign() * place.latitude.0 - Radians::from(Degrees(60.0)).0;
                let share = (from_rim / 0.1).clamp(0.0, 1.0);
                let coverage = if from_rim < 0.0 { 0 } else { 1 + (254.0 * share) as u8 };
                ([hills(place) + 300.0, 0.0, 0.0], coverage)
            },
        );
    }
    planet.selection(|_| true)
}

struct Caster<'a> {
    view: &'a View,
    body: Ellipsoid,
    surface: &'a Surface,
}

impl Caster<'_> {
    fn direction(&self, x: u32, y: u32) -> DVec3 {
        let [width, height] = self.view.viewport.map(f64::from);
        let tangent = (self.view.vertical_fov.0 / 2.0).tan();
        let right = (2.0 * (f64::from(x) + 0.5) / width - 1.0) * tangent * width / height;
        let up = (1.0 - 2.0 * (f64::from(y) + 0.5) / height) * tangent;
        (self.view.orientation * DVec3::new(right, up, -1.0)).normalize()
    }

    fn height(&self, place: Geographic, distance_m: f64) -> f64 {
        let footprint_m = distance_m * pixel_angle(self.view);
        let found = self.surface.compose(Kind::Height, place, footprint_m);
        found.map_or(0.0, |found| found.value[0])
    }

    /// Meters above the terrain along a ray.
    fn above(&self, direction: DVec3, distance_m: f64) -> f64 {
        let point = self.view.eye + distance_m * direction;
        let (place, altitude) = self.body.geographic_from_cartesian(point);
        altitude.0 - self.height(place, distance_m)
    }

    /// Meters along a ray to the surface.
    fn cast(&self, direction: DVec3) -> Option<f64> {
        let outer = self.body.a().0 + 9e3;
        let eye = self.view.eye;
        let middle = -eye.dot(direction);
        let half = (outer * outer - (eye + middle * direction).length_squared()).sqrt();
        if half.is_nan() || middle + half < 0.0 {
            return None;
        }
        let (mut near, end) = ((middle - half).max(0.0), middle + half);
        let mut above = self.above(direction, near);
        while near < end {
            let step = (0.4 * above).max(0.3 * near * pixel_angle(self.view));
            let far = near + step;
            let next = self.above(direction, far);
            if next < 0.0 {
                let (mut low, mut high) = (near, far);
                for _ in 0..60 {
                    let half = low.midpoint(high);
                    if self.above(direction, half) < 0.0 { high = half } else { low = half }
                }
                return Some(high);
            }
            (near, above) = (far, next);
        }
        None
    }
}

/// How far a picture is from the reference.
#[derive(Debug, Default)]
struct Disagreement {
    compared: usize,
    /// Pixels that differ in whether there is a planet, away from its outline.
    holes: usize,
    /// Off the pixel's own ray, in pixels.
    off_ray_px: Vec<f64>,
    /// From the reference's point, foreshortened, in pixels.
    off_point_px: Vec<f64>,
    /// Of the height shown from the surface's at the place shown.
    height_m: Vec<f64>,
    /// Of the place and the rounded height shown from the position shown.
    place_m: f64,
}

fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * share) as usize]
}

fn compare(body: Ellipsoid, view: &View, selection: &Selection, aovs: &Aovs) -> Disagreement {
    let surface = Surface::new(selection);
    let caster = Caster { view, body, surface: &surface };
    let [width, height] = view.viewport;
    let rays: Vec<Option<f64>> = (0..height)
        .flat_map(|y| (0..width).map(move |x| (x, y)))
        .map(|(x, y)| caster.cast(caster.direction(x, y)))
        .collect();
    let mut found = Disagreement::default();
    for y in 1..height - 1 {
        for x in 1..width - 1 {
            let index = (y * width + x) as usize;
            let around = (y - 1..=y + 1)
                .flat_map(|y| (x - 1..=x + 1).map(move |x| (y * width + x) as usize))
                .map(|i| rays[i]);
            let (mut least, mut most) = (f64::INFINITY, 0.0_f64);
            let mut hits = 0;
            for distance in around.flatten() {
                hits += 1;
                (least, most) = (least.min(distance), most.max(distance));
            }
            let shown = DVec3::from_array(aovs.position[index]);
            if hits == 0 && shown.is_finite() {
                found.holes += 1;
            }
            // A silhouette: some neighbor sees past it, or much farther.
            if hits < 9 || most / least > 1.06 {
                continue;
            }
            if !shown.is_finite() {
                found.holes += 1;
                continue;
            }
            found.compared += 1;
            let direction = caster.direction(x, y);
            let distance = rays[index].unwrap();
            let pixel_m = distance * pixel_angle(view);
            let expected = view.eye + distance * direction;
            found.off_ray_px.push((shown - view.eye).cross(direction).length() / pixel_m);
            let steep = expected.normalize().dot(direction).abs();
            found.off_point_px.push((shown - expected).length() * steep / pixel_m);

            let [longitude, latitude] = aovs.geographic[index];
            let place = at(longitude, latitude);
            let depth = (shown - view.eye).length();
            let there = caster.height(place, depth);
            found.height_m.push((f64::from(aovs.height_m[index]) - there).abs());
            let back =
                body.cartesian_from_geographic(place, Meters(f64::from(aovs.height_m[index])));
            found.place_m = found.place_m.max(back.distance(shown));
        }
    }
    found
}

fn check(name: &str, body: Ellipsoid, pose: Pose, fov: f64) {
    let selection = planet(body);
    let view = pose.view(Degrees(fov).into(), [SIDE; 2], 1.0);
    let mut renderer = Renderer::new(gpu(), body);
    let drawn = renderer.render(&view, &selection, &LIGHT, &Options::default());
    let aovs = renderer.read_aovs();
    let mut found = compare(body, &view, &selection, &aovs);
    let worst = |values: &mut Vec<f64>| (quantile(values, 0.999), quantile(values, 1.0));
    let (off_ray, off_point, height) =
        (worst(&mut found.off_ray_px), worst(&mut found.off_point_px), worst(&mut found.height_m));
    let report = format!(
        "{name}: {} compared, {} holes, off ray {off_ray:.3?} px, off point {off_point:.3?} px, \
         height {height:.4?} m, place {:.1e} m, {} patches",
        found.compared, found.holes, found.place_m, drawn.patches
    );
    println!("{report}");
    assert!(found.compared > 2000, "{report}");
    assert_eq!(found.holes, 0, "{report}");
    assert!(off_ray.0 < view.tolerance_px && off_point.0 < view.tolerance_px, "{report}");
    assert!(height.0 < 0.1 && found.place_m < 1e-3, "{report}");
}

fn mars() -> Ellipsoid {
    Ellipsoid::sphere(Meters(3_396_190.0)).unwrap()
}

#[test]
fn a_whole_disc_is_where_it_should_be() {
    let pose =
        Pose::from_eye(&mars(), at(30.0, 20.0), Meters(9e6), Radians(0.3), Degrees(-90.0).into());
    check("disc", mars(), pose, 45.0);
}

#[test]
fn an_oblique_near_view_is_where_it_should_be() {
    let target = mars().cartesian_from_geographic(at(12.0, 34.0), Meters(0.0));
    let pose = Pose::looking_at(&mars(), at(11.0, 31.0), Meters(120e3), target);
    check("oblique", mars(), pose, 50.0);
}

#[test]
fn a_pole_is_where_it_should_be() {
    for (name, latitude) in [("north pole", 90.0), ("south pole", -90.0)] {
        let pose = Pose::from_eye(
            &Ellipsoid::WGS84,
            at(20.0, latitude),
            Meters(2.5e6),
            Radians(0.0),
            Degrees(-90.0).into(),
        );
        check(name, Ellipsoid::WGS84, pose, 60.0);
    }
    let target = mars().cartesian_from_geographic(at(0.0, 90.0), Meters(0.0));
    let pose = Pose::looking_at(&mars(), at(0.0, 88.5), Meters(40e3), target);
    check("over the pole", mars(), pose, 50.0);
}

#[test]
fn the_antimeridian_is_where_it_should_be() {
    let body = Ellipsoid::WGS84;
    let target = body.cartesian_from_geographic(at(180.0, 1.0), Meters(0.0));
    let pose = Pose::looking_at(&body, at(179.0, -3.0), Meters(300e3), target);
    check("antimeridian", body, pose, 50.0);
}

/// No pixel inside the outline shows what lies behind the planet.
#[test]
fn there_are_no_cracks() {
    let selection = planet(mars());
    let mut renderer = Renderer::new(gpu(), mars());
    let impossible = [255, 0, 255];
    let options =
        Options { background: impossible, vertical_exaggeration: 4.0, ..Options::default() };
    for (longitude, latitude, altitude) in [
        (0.0, 0.0, 3e6),
        (72.0, 26.5, 4e5),
        (0.0, 90.0, 2e6),
        (-180.0, -89.9, 5e4),
        (5.0, 60.0, 6e4),
    ] {
        let pose = Pose::from_eye(
            &mars(),
            at(longitude, latitude),
            Meters(altitude),
            Radians(0.1),
            Degrees(-90.0).into(),
        );
        let view = pose.view(Degrees(40.0).into(), [640, 480], 1.0);
        renderer.render(&view, &selection, &LIGHT, &options);
        let picture = renderer.read_color();
        let seen_through = picture.rgba.chunks(4).filter(|pixel| pixel[..3] == impossible).count();
        assert_eq!(seen_through, 0, "{longitude} {latitude} {altitude}");
    }
}

/// What `ARCHITECTURE.md` aims at: under 0.05 px of jitter from 1 m to 10⁷ m: no pixel's place is farther off its ray,
/// wherever the eye happens to stand.
#[test]
fn nothing_jitters_from_a_meter_to_ten_million() {
    for body in [Ellipsoid::WGS84, mars()] {
        let selection = planet(body);
        let surface = Surface::new(&selection);
        let mut renderer = Renderer::new(gpu(), body);
        for (i, altitude) in [1.0, 3.0, 50.0, 2e3, 1e5, 1e7].into_iter().enumerate() {
            let place = at(100.0 / 7.0 + i as f64, [-33.3, 89.999_9, 51.4][i % 3]);
            let ground = surface.compose(Kind::Height, place, 0.0).unwrap().value[0];
            let pitch = if altitude < 1e4 { -25.0 } else { -90.0 };
            let eye = Meters(ground + altitude);
            let pose = Pose::from_eye(&body, place, eye, Radians(0.7), Degrees(pitch).into());
            let view = pose.view(Degrees(40.0).into(), [480, 320], 1.0);
            renderer.render(&view, &selection, &LIGHT, &Options::default());
            let aovs = renderer.read_aovs();
            let caster = Caster { view: &view, body, surface: &surface };
            let mut off_ray_px = Vec::new();
            for (index, (x, y)) in (0..320).flat_map(|y| (0..480).map(move |x| (x, y))).enumerate()
            {
                let shown = DVec3::from_array(aovs.position[index]) - view.eye;
                if shown.is_finite() {
                    let off = shown.cross(caster.direction(x, y)).length() / shown.length();
                    off_ray_px.push(off / pixel_angle(&view));
                }
            }
            let (most, worst) = (quantile(&mut off_ray_px, 0.999), quantile(&mut off_ray_px, 1.0));
            println!("{altitude} m: off ray {most:.4} px, at worst {worst:.4} px");
            assert!(off_ray_px.len() > 10_000 && most < 0.05, "{altitude} m: {most} px");
        }
    }
}

/// With pages missing here and there, their ancestors stand in on the GPU as on the CPU.
#[test]
fn ancestors_stand_in_for_missing_pages() {
    let mut selection = planet(mars());
    let mut count = 0_u32;
    selection.pages.retain(|page| {
        count = count.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        page.entry.page.level.0 == 0 || count >> 30 != 0
    });
    let pose =
        Pose::from_eye(&mars(), at(60.0, 55.0), Meters(8e5), Radians(0.3), Degrees(-80.0).into());
    let view = pose.view(Degrees(50.0).into(), [SIDE; 2], 1.0);
    let mut renderer = Renderer::new(gpu(), mars());
    renderer.render(&view, &selection, &LIGHT, &Options::default());
    let aovs = renderer.read_aovs();
    let surface = Surface::new(&selection);
    let caster = Caster { view: &view, body: mars(), surface: &surface };
    let mut off_m = Vec::new();
    for (index, position) in aovs.position.iter().enumerate() {
        let shown = DVec3::from_array(*position);
        if shown.is_finite() {
            let [longitude, latitude] = aovs.geographic[index];
            let there = caster.height(at(longitude, latitude), (shown - view.eye).length());
            off_m.push((f64::from(aovs.height_m[index]) - there).abs());
        }
    }
    let (most, worst) = (quantile(&mut off_m, 0.999), quantile(&mut off_m, 1.0));
    assert!(off_m.len() > 20_000 && most < 0.1, "{most} m, at worst {worst} m");
}

const SIDES_PROBE: &str = "
@group(2) @binding(0) var<storage, read_write> answers: array<vec4u>;
@compute @workgroup_size(64)
fn probe(@builtin(global_invocation_id) id: vec3u) {
    let per_patch = u32(3 * (SEGMENTS + 1));
    let patch_index = id.x / per_patch;
    if id.x >= arrayLength(&answers) { return; }
    let side = i32(id.x % per_patch) / (SEGMENTS + 1);
    let step = i32(id.x % per_patch) % (SEGMENTS + 1);
    var steps = vec2i(step, 0);
    if side == 1 { steps = vec2i(SEGMENTS - step, step); }
    if side == 2 { steps = vec2i(0, SEGMENTS - step); }
    answers[id.x] = bitcast<vec4u>(vertex_of(patch_index, steps).clip);
}
";

/// Every vertex of every side is the same to the bit on both sides, also where a finer patch meets
/// a coarser one, and where corners of several patches meet: nothing can open.
#[test]
fn neighbors_meet_to_the_bit() {
    use std::collections::HashMap;

    let steps = crate::mesh::detail::SEGMENTS as usize;
    let selection = planet(Ellipsoid::WGS84);
    let mut renderer = Renderer::new(gpu(), Ellipsoid::WGS84);
    let options = Options { vertical_exaggeration: 5.0, ..Options::default() };
    let mut halves_in_all = 0;
    for (longitude, latitude, altitude) in
        [(10.0, 20.0, 4e6), (-180.0, 89.9, 9e3), (36.0, 0.0, 4e4)]
    {
        let pose = Pose::from_eye(
            &Ellipsoid::WGS84,
            at(longitude, latitude),
            Meters(altitude),
            Radians(0.4),
            Degrees(-20.0).into(),
        );
        let view = pose.view(Degrees(60.0).into(), [256; 2], 1.0);
        renderer.render(&view, &selection, &LIGHT, &options);
        let mesh = renderer.mesh();
        let count = mesh.patches.len() * 3 * (steps + 1);
        let source = Program::Mesh.source() + SIDES_PROBE;
        let workgroups = u32::try_from(count.div_ceil(64)).unwrap();
        let bytes = renderer.probe(&source, 16 * count as u64, workgroups);
        let vertices: &[[u32; 4]] = bytemuck::cast_slice(&bytes);

        let mut on_edge: HashMap<(u32, usize), [u32; 4]> = HashMap::new();
        let mut at_corner: HashMap<u32, [u32; 4]> = HashMap::new();
        let mut halves = 0;
        for (patch, sides) in mesh.patches.iter().zip(vertices.chunks(3 * (steps + 1))) {
            for (side, vertices) in sides.chunks(steps + 1).enumerate() {
                let ends = patch.sides >> (4 * side);
                let (first, last) = ((ends & 3) as usize, (ends >> 2 & 3) as usize);
                let edge = &mesh.edges[patch.edges[side] as usize];
                halves += usize::from(first.abs_diff(last) == 1);
                for (step, &vertex) in vertices.iter().enumerate() {
                    // Off the vertices of the coarser neighbor, a vertex falls on the one before.
                    let step = if first.abs_diff(last) == 1 { step - step % 2 } else { step };
                    let own = (first * (steps - step) + last * step) / 2;
                    assert_eq!(*on_edge.entry((patch.edges[side], own)).or_insert(vertex), vertex);
                    if (2 * own).is_multiple_of(steps) {
                        let corner = edge.frames[2 * own / steps];
                        assert_eq!(*at_corner.entry(corner).or_insert(vertex), vertex);
                    }
                }
            }
        }
        halves_in_all += halves;
    }
    assert!(halves_in_all > 50, "only {halves_in_all} sides meet coarser ones");
}
