//! Shader functions against the formats crate, on random inputs.

use areoid_formats::address::Level;
use areoid_formats::body::Ellipsoid;
use areoid_formats::geodesy::{Geographic, geographic_from_normal, surface_normal};
use areoid_formats::grid::{Grid, Outline};
use areoid_formats::page::Kind;
use areoid_formats::projection::{Crs, PolarScale, PolarStereographic, Pole, Projection};
use areoid_formats::units::{Degrees, Meters};
use bytemuck::{Pod, Zeroable};
use glam::{DVec3, Vec3};

use super::{Random, dataset, gpu};
use crate::map::{DatasetMap, Windows};
use crate::mesh::frame::axes_at;
use crate::mirror;
use crate::render::testing::{Given, compute};
use crate::shader::{PRESENT, Program, SURFACE};
use crate::style::Part;
use crate::yardstick;

/// A question to `map_point` and its answer.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Probe {
    d: [f32; 3],
    r0: f32,
    z0: f32,
    inside: u32,
    texel: [i32; 2],
    fraction: [f32; 2],
    scales: [f32; 2],
}

const PROBE: &str = "
struct Probe {
    d: vec3f, r0: f32, z0: f32, inside: u32, texel: vec2i, fraction: vec2f, scales: vec2f,
}
@group(1) @binding(0) var<storage, read_write> probes: array<Probe>;
@compute @workgroup_size(64)
fn probe(@builtin(global_invocation_id) id: vec3u) {
    let i = id.x;
    if i >= arrayLength(&probes) { return; }
    let asked = probes[i];
    let dataset = dataset_list[0];
    let point = map_point(dataset, anchors[i], asked.r0, asked.z0, asked.d);
    probes[i].texel = point.texel;
    probes[i].fraction = point.fraction;
    probes[i].inside = u32(point.inside);
    let x = asked.r0 + asked.d.z * asked.r0 - asked.d.y * asked.z0;
    let r = sqrt(x * x + asked.d.x * asked.d.x);
    probes[i].scales = principal_scales(dataset, r, asked.z0 + asked.d.y * asked.r0 + asked.d.z * asked.z0);
}
";

pub(super) fn grids() -> Vec<(&'static str, Grid, Ellipsoid)> {
    let earth = Ellipsoid::WGS84;
    let degrees = Crs::new(Projection::Geographic, earth);
    let width = 153 * (1 << 20);
    let pixel = 360.0 / f64::from(width);
    let globe =
        Outline { origin: [-180.0, 90.0], pixel_size: [pixel; 2], width, height: width / 2 };
    let polar = |pole, scale, meridian| {
        Projection::PolarStereographic(PolarStereographic {
            pole,
            central_meridian: Degrees(meridian).into(),
            scale,
            false_easting: Meters(2e6),
            false_northing: Meters(2e6),
        })
    };
    let cap = Outline {
        origin: [-1e6, 5e6],
        pixel_size: [0.25; 2],
        width: 24_000_000,
        height: 24_000_000,
    };
    let make = |crs, outline| Grid::from_outline(crs, outline, 512).unwrap().grid;
    let north = polar(Pole::North, PolarScale::TrueAt(Degrees(70.0).into()), -45.0);
    let south = polar(Pole::South, PolarScale::AtPole(0.994), 0.0);
    let region = Outline {
        origin: [350.0, 20.0],
        pixel_size: [1e-5; 2],
        width: 2_000_000,
        height: 1_000_000,
    };
    let mars = Ellipsoid::new(Meters(3_396_190.0), Meters(3_376_200.0)).unwrap();
    let sphere = Ellipsoid::sphere(Meters(3_396_190.0)).unwrap();
    let centric = |projection| {
        Crs::new(projection, sphere)
            .on_body(mars, areoid_formats::geodesy::LatitudeKind::Planetocentric)
    };
    vec![
        ("globe", make(degrees, globe), earth),
        ("north", make(Crs::new(north, earth), cap), earth),
        ("south", make(Crs::new(south, earth), cap), earth),
        ("region", make(degrees, region), earth),
        ("centric globe", make(centric(Projection::Geographic), globe), mars),
        ("centric north", make(centric(north), cap), mars),
    ]
}

/// What `ARCHITECTURE.md` aims at: a sixteenth of a texel on a 0.25 m raster anywhere on Earth, for offsets of the
/// patches that show single texels; the same share of a patch for larger ones.
#[test]
fn places_are_found_to_a_sixteenth_of_a_texel() {
    for (name, grid, body) in grids() {
        let info = areoid_cache::DatasetInfo {
            name: name.to_owned(),
            group: None,
            kind: Kind::Height,
            grid: grid.clone(),
            priority: 0,
        };
        let map = DatasetMap::new(&info);
        let mut random = Random(0x5eed);
        let mut asked = Vec::new();
        let mut anchors = Vec::new();
        let mut expected = Vec::new();
        let finest = grid.pyramid().finest();
        while asked.len() < 20_000 {
            let mut normal = random.direction();
            if random.next() < 0.3 {
                // Near a pole, down to a nanometer, and on it.
                let off = 10.0_f64.powf(-16.0 * random.next());
                normal = DVec3::new(normal.x * off, normal.y * off, normal.z.signum()).normalize();
            }
            let axes = axes_at(normal);
            let size = 10.0_f64.powf(-7.5 + 7.0 * random.next());
            let step = DVec3::new(random.next() - 0.5, random.next() - 0.5, 0.0) * size;
            let there = (axes * (DVec3::Z + step)).normalize();
            let d: Vec3 = (axes.transpose() * (there - normal)).as_vec3();
            // What the shader is given, it is given in f32.
            let there = (normal + axes * d.as_dvec3()).normalize();
            let place = geographic_from_normal(there);
            let Some(found) = grid.locate(finest, place) else { continue };
            let Some(anchor) = map.anchor(0, geographic_from_normal(axes.z_axis), axes.z_axis, 0.5)
            else {
                continue;
            };
            let texels = size * body.a().0 / grid.nominal_pixel().0;
            asked.push(Probe {
                d: d.to_array(),
                r0: axes.y_axis.z as f32,
                z0: axes.z_axis.z as f32,
                ..Zeroable::zeroed()
            });
            anchors.push(anchor);
            expected.push((found, place, texels, there));
        }
        let scene = mirror::Scene {
            eccentricity2: body.eccentricity_squared() as f32,
            equatorial_radius: body.a().0 as f32,
            ..Zeroable::zeroed()
        };
        let source = [SURFACE, &[PROBE]].concat().join("\n");
        let datasets = &[map.mirrored(&Windows::default(), &Part::of(Kind::Height), 0)];
        let given = Given { scene, datasets, anchors: &anchors, ..Given::default() };
        let answers: Vec<Probe> = compute(gpu(), &source, given, &asked);

        let width = f64::from(grid.pyramid().extent().width);
        let mut worst = 0.0_f64;
        let mut worst_scale = 0.0_f64;
        for (i, (answer, (found, place, texels, there))) in
            answers.iter().zip(&expected).enumerate()
        {
            let dx = f64::from(answer.texel[0]) + f64::from(answer.fraction[0]) - found.x;
            let dx =
                if grid.pyramid().extent().wraps { dx - width * (dx / width).round() } else { dx };
            let dy = f64::from(answer.texel[1]) + f64::from(answer.fraction[1]) - found.y;
            // Columns crowd at the poles of a globe: count them by their width on the ground.
            let crowded = if grid.crs().wraps_with_period().is_some() {
                there.truncate().length()
            } else {
                1.0
            };
            let error = (dx * crowded).hypot(dy);
            let allowed = 1.0 / 16.0 + 1.5e-6 * texels;
            worst = worst.max(error / allowed);
            assert!(
                error < allowed,
                "{name}: {error} of {allowed} texels at {place:?}, {texels} texels off, {i}: {:?} {:?}",
                asked[i].d,
                asked[i].r0
            );
            let (largest, smallest) = grid.crs().principal_scales(*place, grid.pixel_size());
            worst_scale = worst_scale.max((f64::from(answer.scales[0]) / largest - 1.0).abs());
            let smallest_off = (f64::from(answer.scales[1]) - smallest).abs() / largest;
            worst_scale = worst_scale.max(smallest_off);
        }
        println!("{name}: worst {worst:.3} of the error allowed, scales {worst_scale:.1e}");
        assert!(worst_scale < 2e-5, "{name}: {worst_scale}");
    }
}

/// A map around the body that ends between the poles is not drawn beyond its edges, and up to them.
#[test]
fn a_band_ends_at_its_edges() {
    let body = Ellipsoid::WGS84;
    let degrees = Crs::new(Projection::Geographic, body);
    let outline =
        Outline { origin: [-180.0, 60.0], pixel_size: [0.01; 2], width: 36_000, height: 12_000 };
    let info = dataset("band", Kind::Height, degrees, outline, 512, 0);
    let map = DatasetMap::new(&info);
    let mut random = Random(0xba2d);
    let (mut asked, mut anchors, mut expected) = (Vec::new(), Vec::new(), Vec::new());
    while asked.len() < 2_000 {
        let side = if random.next() < 0.5 { 1.0 } else { -1.0 };
        let texels = (0.01 + 2.0 * random.next()) * if random.next() < 0.5 { 1.0 } else { -1.0 };
        let longitude = 360.0 * random.next() - 180.0;
        let normal_at = |latitude: f64| {
            surface_normal(Geographic::from_degrees(Degrees(longitude), Degrees(latitude)))
        };
        let axes = axes_at(normal_at(side * 59.98));
        let there = normal_at(side * (60.0 + 0.01 * texels));
        anchors.extend(map.anchor(0, geographic_from_normal(axes.z_axis), axes.z_axis, 0.5));
        asked.push(Probe {
            d: (axes.transpose() * (there - axes.z_axis)).as_vec3().to_array(),
            r0: axes.y_axis.z as f32,
            z0: axes.z_axis.z as f32,
            ..Zeroable::zeroed()
        });
        expected.push(texels < 0.0);
    }
    let source = [SURFACE, &[PROBE]].concat().join("\n");
    let mirrored = map.mirrored(&Windows::default(), &Part::of(Kind::Height), 0);
    let scene = mirror::Scene { equatorial_radius: body.a().0 as f32, ..Zeroable::zeroed() };
    let given = Given { scene, datasets: &[mirrored], anchors: &anchors, ..Given::default() };
    let answers: Vec<Probe> = compute(gpu(), &source, given, &asked);
    for (answer, is_inside) in answers.iter().zip(expected) {
        assert_eq!(answer.inside == 1, is_inside, "{:?} {:?}", answer.texel, answer.fraction);
    }
}

#[test]
fn all_shaders_are_valid() {
    let programs = [Program::Points, Program::Mesh, Program::Shade, Program::Measure];
    let alone = [PRESENT, yardstick::SHADER].map(str::to_owned);
    for source in programs.into_iter().map(Program::source).chain(alone) {
        let module = naga::front::wgsl::parse_str(&source).unwrap();
        naga::valid::Validator::new(
            naga::valid::ValidationFlags::all(),
            naga::valid::Capabilities::empty(),
        )
        .validate(&module)
        .unwrap();
    }
}

/// Offsets and size of a WGSL structure.
fn layout_of(name: &str) -> (Vec<(String, usize)>, usize) {
    let module = naga::front::wgsl::parse_str(&Program::Shade.source()).unwrap();
    let (_, found) = module.types.iter().find(|(_, ty)| ty.name.as_deref() == Some(name)).unwrap();
    let naga::TypeInner::Struct { members, span } = &found.inner else { panic!("{name}") };
    let member = |m: &naga::StructMember| (m.name.clone().unwrap(), m.offset as usize);
    (members.iter().map(member).collect(), *span as usize)
}

macro_rules! assert_mirrored {
    ($name:ident: $($field:ident),+) => {{
        let fields = vec![
            $((stringify!($field).to_owned(), std::mem::offset_of!(mirror::$name, $field))),+
        ];
        let (mut members, size) = layout_of(stringify!($name));
        members.retain(|(name, _)| !name.starts_with("pad"));
        assert_eq!(members, fields);
        assert_eq!(size, size_of::<mirror::$name>());
    }};
}

#[test]
fn shaders_and_rust_agree_on_structures() {
    assert_mirrored!(Scene: right, focal_x, up, focal_y, backward, near, sun, ambient, background,
        exaggeration, viewport, equatorial_radius, eccentricity2, bare, pixel_angle, stops, ramp_stops,
        ramp_opacity, anisotropy, exposure, relief, debug, slot_bounds, tolerance_px, edges, patches);
    assert_mirrored!(Atmosphere: rayleigh, rayleigh_height, mie, mie_height, mie_extinction,
        asymmetry, eye_up, eye_height, radius, top);
    assert_mirrored!(Frame: origin, height, east, north, up, lists);
    assert_mirrored!(Dataset: size, interior, levels, first_window, priority, polar, wraps, period,
        latitude_ratio, hemisphere, eccentricity, ground, weight, series, roots, deepest, poles,
        number, stops);
    assert_mirrored!(Anchor: texel, fraction, matrix, dataset);
    assert_mirrored!(Edge: frames, half_chord, direction, distance, come);
    assert_mirrored!(Patch: corner_a, frame, corner_b, sides, corner_c, distance, edges, come);
}

#[test]
fn levels_are_counted_alike() {
    let body = Ellipsoid::WGS84;
    let degrees = Crs::new(Projection::Geographic, body);
    let outline = Outline { origin: [0.0, 90.0], pixel_size: [0.25; 2], width: 1440, height: 720 };
    let info = dataset("globe", Kind::Height, degrees, outline, 64, 0);
    let mirrored = DatasetMap::new(&info).mirrored(&Windows::default(), &Part::of(Kind::Height), 0);
    assert_eq!(Level(u8::try_from(mirrored.levels - 1).unwrap()), info.grid.pyramid().finest());
}
