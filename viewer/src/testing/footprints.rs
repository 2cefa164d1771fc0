//! The ground under a pixel: its shape against a cone cut by a plane, and what it is good for at
//! grazing angles, against the mean of many rays.

use std::sync::OnceLock;

use areoid_cache::View;
use areoid_formats::body::Ellipsoid;
use areoid_formats::geodesy::{Geographic, geographic_from_normal, surface_normal};
use areoid_formats::grid::Outline;
use areoid_formats::page::Kind;
use areoid_formats::projection::{Crs, Projection};
use areoid_formats::units::{Degrees, Meters};
use bytemuck::{Pod, Zeroable};
use glam::{DVec2, DVec3, Vec3};

use super::caster::{Caster, middle};
use super::worlds::at;
use super::{Planet, Random, dataset, gpu};
use crate::camera::Pose;
use crate::mirror;
use crate::render::testing::{Given, compute};
use crate::shader::Program;
use crate::surface::Surface;
use crate::{Light, Options, Renderer};

/// A question to `footprint_of` and its answer.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Probe {
    direction: [f32; 3],
    samples: i32,
    normal: [f32; 3],
    sample_m: f32,
    up: [f32; 3],
    _pad: u32,
    axis: [f32; 3],
    _pad_too: u32,
}

const PROBE: &str = "
struct Probe { direction: vec3f, samples: i32, normal: vec3f, sample_m: f32, up: vec3f, axis: vec3f }
@group(1) @binding(0) var<storage, read_write> probes: array<Probe>;
@compute @workgroup_size(64)
fn probe(@builtin(global_invocation_id) id: vec3u) {
    let i = id.x;
    if i >= arrayLength(&probes) { return; }
    let asked = probes[i];
    let east = vec3f(1.0, 0.0, 0.0);
    let north = vec3f(0.0, 1.0, 0.0);
    let up = vec3f(0.0, 0.0, 1.0);
    let frame = Frame(vec3f(0.0), 0.0, east, 0u, north, 0u, up, array<u32, 5>());
    let found = footprint_of(frame, asked.direction, asked.normal, asked.up, 1.0);
    probes[i].axis = found.axis;
    probes[i].samples = found.samples;
    probes[i].sample_m = found.sample_m;
}
";

/// Where a circle about a ray meets a plane, seen along `up`: the farthest of its points.
fn farthest_of_cone(direction: DVec3, normal: DVec3, up: DVec3) -> DVec3 {
    let (right, down) = direction.any_orthonormal_pair();
    let points = (0..20_000).map(|step| {
        let turn = f64::from(step) / 20_000.0 * std::f64::consts::PI;
        let rim = turn.cos() * right + turn.sin() * down;
        let met = rim - direction * (rim.dot(normal) / direction.dot(normal));
        met - met.dot(up) * up
    });
    points.max_by(|a, b| a.length_squared().total_cmp(&b.length_squared())).unwrap()
}

#[test]
fn a_footprint_is_a_cone_cut_by_the_ground() {
    let mut random = Random(0xf007);
    let mut asked = Vec::new();
    while asked.len() < 500 {
        let [direction, normal, near] = [(); 3].map(|()| random.direction());
        let up = (normal + 0.8 * near).normalize();
        if direction.dot(normal).abs() > 0.03 {
            asked.push([direction, normal, up].map(|vector| vector.as_vec3().as_dvec3()));
        }
    }
    let probes: Vec<Probe> = asked
        .iter()
        .map(|vectors| {
            let [direction, normal, up] = vectors.map(|vector| vector.as_vec3().to_array());
            Probe { direction, normal, up, ..Probe::zeroed() }
        })
        .collect();
    let mut probes = probes;
    // Straight down on level ground, where nothing is the longest.
    let (direction, normal, up) = ([0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]);
    probes.push(Probe { direction, normal, up, ..Probe::zeroed() });
    let scene = mirror::Scene { equatorial_radius: 1.0, anisotropy: 8, ..Zeroable::zeroed() };
    let source = Program::Shade.source() + PROBE;
    let found = compute(gpu(), &source, Given { scene, ..Given::default() }, &probes);
    let below = found[asked.len()];
    assert!(
        Vec3::from_array(below.axis).length() < 1.1 && (below.samples, below.sample_m) == (1, 1.0)
    );
    let (mut many, mut wide) = (0, 0);
    for (probe, [direction, normal, up]) in found.iter().zip(asked) {
        let axis = Vec3::from_array(probe.axis).as_dvec3();
        let farthest = farthest_of_cone(direction, normal, up);
        let ratio = farthest.length();
        assert!((axis.length() - ratio).abs() < 2e-3 * ratio, "{axis} for {farthest}");
        // Of a circle any axis is the longest.
        let least = ratio.min(axis.length());
        let off = (axis - farthest).length().min((axis + farthest).length());
        assert!(off < 0.05 * least || ratio < 1.1, "{axis} for {farthest}");
        let samples = ratio.round().clamp(1.0, 8.0);
        assert!(
            (f64::from(probe.samples) - samples).abs() < 1.0 || (ratio.fract() - 0.5).abs() < 0.02
        );
        assert!((f64::from(probe.sample_m) - (ratio / 8.0).max(1.0)).abs() < 2e-3 * ratio);
        many += usize::from(probe.samples > 1);
        wide += usize::from(probe.sample_m > 1.0);
    }
    assert!(many > 100 && wide > 20, "{many}, {wide}");
}

const SIZE: [u32; 2] = [160, 120];

fn body() -> Ellipsoid {
    Ellipsoid::sphere(Meters(1e6)).unwrap()
}

/// Waves of a few texels and longer.
fn codes(place: Geographic) -> [f64; 3] {
    let [x, y] = [place.longitude, place.latitude].map(|angle| Degrees::from(angle).0);
    [0.0, 1.0, 2.0].map(|phase| {
        let waves =
            [(290.0, 40.0, 1.0), (170.0, 310.0, 2.0), (700.0, 500.0, 3.0), (90.0, 60.0, 4.0)];
        let sum = waves.map(|(kx, ky, own): (f64, f64, f64)| (kx * x + ky * y + own * phase).sin());
        128.0 + 28.0 * sum.iter().sum::<f64>()
    })
}

/// Colors over a smooth globe, 0.004° to a texel.
fn planet() -> &'static Planet {
    static PLANET: OnceLock<Planet> = OnceLock::new();
    PLANET.get_or_init(|| {
        let degrees = Crs::new(Projection::Geographic, body());
        let outline =
            Outline { origin: [-3.0, 5.0], pixel_size: [0.004; 2], width: 1500, height: 1500 };
        let mut planet = Planet::default();
        planet.add(dataset("waves", Kind::Color, degrees, outline, 128, 0), |place| {
            (codes(place).map(|code| code as f32), 255)
        });
        planet
    })
}

/// Toward the horizon, from low above the ground.
fn view() -> View {
    let pose = Pose::from_eye(
        &body(),
        at(0.0, 0.1),
        Meters(3e3),
        Degrees(25.0).into(),
        Degrees(-9.0).into(),
    );
    pose.view(Degrees(20.0).into(), SIZE, 1.0)
}

/// Where a ray of the view meets the sphere.
fn met(caster: &Caster<'_>, pixel: DVec2) -> Option<Geographic> {
    let (eye, direction) = (caster.view.eye, caster.direction(pixel));
    let (along, radius) = (-eye.dot(direction), body().a().0);
    let half2 = radius * radius - (eye + along * direction).length_squared();
    (half2 > 0.0)
        .then(|| geographic_from_normal((eye + (along - half2.sqrt()) * direction) / radius))
}

/// The mean of the colors at many rays through a pixel.
fn mean(caster: &Caster<'_>, x: u32, y: u32) -> Option<[f64; 3]> {
    const RAYS: u32 = 16;
    let mut sum = DVec3::ZERO;
    for (down, across) in (0..RAYS).flat_map(|down| (0..RAYS).map(move |across| (down, across))) {
        let part = |step: u32| (f64::from(step) + 0.5) / f64::from(RAYS) - 0.5;
        let place = met(caster, middle(x, y) + DVec2::new(part(across), part(down)))?;
        let [x, y] = [place.longitude, place.latitude].map(|angle| Degrees::from(angle).0);
        if !(-2.9..2.9).contains(&x) || !(-0.9..4.9).contains(&y) {
            return None;
        }
        sum += DVec3::from_array(codes(place));
    }
    Some((sum / f64::from(RAYS * RAYS)).to_array())
}

/// The root of the mean squared difference from the mean of many rays, by how grazing rays are: at
/// slopes below a fifth and above.
#[test]
fn far_ground_neither_aliases_nor_blurs() {
    let selection = planet().selection(|_| true);
    let (view, surface) = (view(), Surface::new(&selection));
    let caster = Caster { view: &view, body: body(), surface: &surface, exaggeration: 1.0 };
    let mut renderer = Renderer::new(gpu(), body());
    let truth: Vec<_> = (0..SIZE[1])
        .flat_map(|y| (0..SIZE[0]).map(move |x| (x, y)))
        .map(|(x, y)| mean(&caster, x, y))
        .collect();
    let mut off = |anisotropy: u32| {
        let light = Light { toward_sun: surface_normal(at(0.0, 0.0)), ambient: 1.0 };
        let options = Options { anisotropy, ..Options::default() };
        renderer.render(&view, &selection, &light, &options);
        let rgba = renderer.read_color().rgba;
        let mut squares = Vec::new();
        for (pixel, truth) in rgba.chunks_exact(4).zip(&truth) {
            if let Some(truth) = truth {
                squares.extend(pixel.iter().zip(truth).map(|(&a, b)| (f64::from(a) - b).powi(2)));
            }
        }
        assert!(squares.len() > 20_000, "{}", squares.len());
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    };
    let [round, one, two, eight, sixteen] = [0, 1, 2, 8, 16].map(&mut off);
    println!("round: {round:.2}, 1: {one:.2}, 2: {two:.2}, 8: {eight:.2}, 16: {sixteen:.2} codes");
    assert!(eight < 0.5 * one.min(round) && eight < two && sixteen < 1.05 * eight);
}
