//! Shader functions one by one, on random numbers, against their twins in f64.

use areoid_cache::View;
use areoid_formats::body::Ellipsoid;
use areoid_formats::grid::TexelPoint;
use areoid_formats::units::{Degrees, Meters};
use bytemuck::{Pod, Zeroable};
use glam::{DMat3, DVec2, DVec3};

use super::twins::grids;
use super::{Random, gpu};
use crate::atmosphere::{Air, Atmosphere, chapman, mie_phase, rayleigh_phase};
use crate::blend::{Vantage, share_of_finer};
use crate::camera::pixel_angle;
use crate::mesh::frame::{axes_at, reference_point};
use crate::mirror;
use crate::render::testing::{Given, compute};
use crate::shader::Program;
use crate::style::{Ramp, Stop, with_luminance_of};

/// Four vectors that a function is asked with. The answer stands in the place of the first.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct Question([[f32; 4]; 4]);

impl Question {
    fn of(vectors: &[DVec3]) -> Self {
        let mut question = Self::zeroed();
        for (place, vector) in question.0.iter_mut().zip(vectors) {
            place[..3].copy_from_slice(&vector.as_vec3().to_array());
        }
        question
    }

    /// As the shader gets it.
    fn vector(&self, place: usize) -> DVec3 {
        let [x, y, z, _] = self.0[place].map(f64::from);
        DVec3::new(x, y, z)
    }
}

/// What WGSL makes of `a`, `b`, `c` and `d`.
fn ask(expression: &str, given: Given<'_>, asked: &[Question]) -> Vec<[f64; 4]> {
    let probe = format!(
        "
struct Question {{ a: vec4f, b: vec4f, c: vec4f, d: vec4f }}
@group(1) @binding(0) var<storage, read_write> questions: array<Question>;
@compute @workgroup_size(64)
fn probe(@builtin(global_invocation_id) id: vec3u) {{
    if id.x >= arrayLength(&questions) {{ return; }}
    let a = questions[id.x].a;
    let b = questions[id.x].b;
    let c = questions[id.x].c;
    let d = questions[id.x].d;
    questions[id.x].a = vec4f({expression});
}}
"
    );
    let answers = compute(gpu(), &(Program::Shade.source() + &probe), given, asked);
    answers.iter().map(|answer: &Question| answer.0[0].map(f64::from)).collect()
}

/// Asks with one number after another in the first vector.
fn ask_numbers(expression: &str, given: Given<'_>, asked: &[[f64; 3]]) -> Vec<[f64; 4]> {
    let asked: Vec<Question> =
        asked.iter().map(|numbers| Question::of(&[DVec3::from_array(*numbers)])).collect();
    ask(expression, given, &asked)
}

/// A difference as a share of the truth, or of `unit` where that is larger.
fn off(found: f64, truth: f64, unit: f64) -> f64 {
    (found - truth).abs() / truth.abs().max(unit)
}

#[test]
fn angles_are_told_to_three_units_in_the_last_place() {
    let mut random = Random(0xa9_1e);
    let size = |random: &mut Random| 10.0_f64.powf(12.0 * random.next() - 6.0);
    let mut asked: Vec<[f64; 3]> = (0..20_000)
        .map(|_| {
            let side = |random: &mut Random| if random.next() < 0.5 { -1.0 } else { 1.0 };
            [side(&mut random) * size(&mut random), side(&mut random) * size(&mut random), 0.0]
        })
        .collect();
    asked.extend([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]]);
    let found = ask_numbers("angle_of(a.x, a.y), 0.0, 0.0, 0.0", Given::default(), &asked);
    for ([angle, ..], [y, x, _]) in found.iter().zip(&asked) {
        let truth = f64::from(*y as f32).atan2(f64::from(*x as f32));
        let unit = f64::from((truth.abs() as f32).next_up()) - f64::from(truth.abs() as f32);
        assert!((angle - truth).abs() <= 3.0 * unit, "{y} {x}: {angle} for {truth}");
    }
}

#[test]
fn colors_are_mixed_as_on_the_processor() {
    let mut random = Random(0xc0_10);
    let mut color = || DVec3::new(random.next(), random.next(), random.next());
    let asked: Vec<Question> = (0..5_000).map(|_| Question::of(&[color(), color()])).collect();
    let found = ask("with_luminance_of(a.xyz, b.xyz), 0.0", Given::default(), &asked);
    for (found, asked) in found.iter().zip(&asked) {
        let truth = with_luminance_of(asked.vector(0).to_array(), asked.vector(1).to_array());
        for (found, truth) in found.iter().zip(truth) {
            assert!((found - truth).abs() < 1e-5, "{asked:?}: {found} for {truth}");
        }
    }

    // IEC 61966-2-1.
    let encode = |c: f64| {
        if c <= 0.003_130_8 { 12.92 * c } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 }
    };
    let decode = |c: f64| {
        if c <= 0.040_45 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
    };
    for (function, truth) in
        [("srgb_from_linear", &encode as &dyn Fn(f64) -> f64), ("linear_from_srgb", &decode)]
    {
        let found = ask(&format!("{function}(a.xyz), 0.0"), Given::default(), &asked);
        for (found, asked) in found.iter().zip(&asked) {
            for (found, asked) in found.iter().zip(asked.vector(0).to_array()) {
                let truth = truth(asked);
                assert!((found - truth).abs() < 2e-5, "{function} {asked}: {found} for {truth}");
            }
        }
    }
}

#[test]
fn a_ramp_is_that_of_the_style() {
    let stop = |height_m, color| Stop { height_m, color };
    let stops = vec![
        stop(-8000.0, [0, 0, 90]),
        stop(-10.0, [200, 230, 255]),
        stop(0.0, [20, 90, 30]),
        stop(21_000.0, [255, 255, 255]),
    ];
    let mut scene = mirror::Scene { stops: [[7.0; 4]; 256], ..Zeroable::zeroed() };
    // Behind another one.
    for (place, stop) in scene.stops[3..].iter_mut().zip(&stops) {
        let [red, green, blue] = stop.color.map(|code| f32::from(code) / 255.0);
        *place = [red, green, blue, stop.height_m];
    }
    let ramp = Ramp { stops, opacity: 1.0 };
    let mut random = Random(0x4a_3b);
    let mut asked: Vec<[f64; 3]> =
        (0..5_000).map(|_| [35_000.0 * random.next() - 11_000.0, 0.0, 0.0]).collect();
    asked.extend([-8000.0, -10.0, 0.0, 21_000.0].map(|height| [height, 0.0, 0.0]));
    let found = ask_numbers(
        "ramp_at(vec2u(3u, 4u), a.x), 0.0",
        Given { scene, ..Given::default() },
        &asked,
    );
    for (found, [height, ..]) in found.iter().zip(&asked) {
        let truth = ramp.color(f64::from(*height as f32));
        for (found, truth) in found.iter().zip(truth) {
            assert!((255.0 * found - truth).abs() < 1e-2, "{height}: {found} for {truth}");
        }
    }
}

/// The offset of a chord's point from the normal at its foot, and the position there.
#[test]
fn places_near_a_frame_are_told_without_cancelling() {
    let body = Ellipsoid::WGS84;
    let mut random = Random(0xf4_a3);
    let mut asked = Vec::new();
    while asked.len() < 5_000 {
        let size = 10.0_f64.powf(-8.0 + 7.5 * random.next());
        let chord = random.direction() * size;
        let distance = 1.0 - 0.3 * size * random.next();
        let axes = axes_at(random.direction());
        let question = Question::of(&[chord, axes.x_axis, axes.y_axis, axes.z_axis]);
        asked.push(Question(question.0.map(|[x, y, z, _]| [x, y, z, distance as f32])));
    }
    let found = ask("offset_from_chord(a.w, a.xyz), 0.0", Given::default(), &asked);
    for (found, asked) in found.iter().zip(&asked) {
        let (chord, distance) = (asked.vector(0), f64::from(asked.0[0][3]));
        let (along, across2) = (distance + chord.z, chord.truncate().length_squared());
        let length = along.hypot(across2.sqrt());
        let truth = DVec3::new(chord.x, chord.y, -across2 / (length + along)) / length;
        let error = (DVec3::new(found[0], found[1], found[2]) - truth).length();
        assert!(error < 5e-7 * truth.length(), "{asked:?}: {found:?} for {truth}");
    }

    const HEIGHT: f64 = 5000.0;
    const ABOVE: f64 = 250.0;
    let scene = mirror::Scene {
        equatorial_radius: body.a().0 as f32,
        eccentricity2: body.eccentricity_squared() as f32,
        exaggeration: 3.0,
        ..Zeroable::zeroed()
    };
    let frame = "Frame(vec3f(0.0), 5000.0, b.xyz, 0u, c.xyz, 0u, d.xyz, array<u32, 5>())";
    let expression = format!("position_at({frame}, a.xyz, 250.0), 0.0");
    let found = ask(&expression, Given { scene, ..Given::default() }, &asked);
    for (found, asked) in found.iter().zip(&asked) {
        let axes = DMat3::from_cols(asked.vector(1), asked.vector(2), asked.vector(3));
        let (normal, step) = (axes.z_axis, axes * asked.vector(0));
        let surface = reference_point(&body, normal + step) - reference_point(&body, normal);
        let truth = surface + ABOVE * (normal + step) + 3.0 * HEIGHT * step;
        let error = (DVec3::new(found[0], found[1], found[2]) - truth).length();
        assert!(error < 2e-6 * truth.length(), "{asked:?}: {found:?} for {truth}");
    }
}

#[test]
fn pages_are_blended_by_the_same_shares() {
    let mut random = Random(0xb1_ed);
    let mut error = || 10.0_f64.powf(3.0 * random.next() - 1.5);
    let mut asked: Vec<[f64; 3]> = (0..5_000).map(|_| [error(), error(), 0.0]).collect();
    asked.extend([[1.0, 0.5, 0.0], [1.25, 0.0, 0.0]]);
    let found = ask_numbers("share_of_finer(a.x, a.y), 0.0, 0.0, 0.0", Given::default(), &asked);
    for ([found, ..], [coarser, finer, _]) in found.iter().zip(&asked) {
        let [coarser, finer] = [coarser, finer].map(|error| f64::from(*error as f32));
        let truth = share_of_finer(coarser, finer);
        // As steep as it is there.
        let steepness = 1.0 / (View::BLENDED - 1.0) + 1.0 / (coarser - finer).abs().max(1e-6);
        let allowed = 1e-6 + 1e-6 * coarser * steepness;
        assert!((found - truth).abs() < allowed, "{coarser} {finer}: {found} for {truth}");
    }

    let alike = ask_numbers(
        "share_of_finer(a.x, a.x), 0.0, 0.0, 0.0",
        Given::default(),
        &[[1.2, 0.0, 0.0]],
    );
    assert_eq!(alike[0][0], 1.0);

    let view = View {
        eye: DVec3::ZERO,
        orientation: axes_at(DVec3::new(0.3, -0.5, 0.8).normalize()),
        vertical_fov: Degrees(40.0).into(),
        viewport: [640, 480],
        tolerance_px: 0.7,
    };
    for exaggeration in [0.5_f32, 1.0, 4.0] {
        let scene = mirror::Scene {
            backward: view.orientation.z_axis.as_vec3().to_array(),
            pixel_angle: pixel_angle(&view) as f32,
            tolerance_px: 0.7,
            exaggeration,
            ..Zeroable::zeroed()
        };
        let vantage = Vantage::new(&view, exaggeration.into());
        let places: Vec<Question> = (0..2_000)
            .map(|_| {
                let forward = -view.orientation.z_axis + 0.5 * random.direction();
                Question::of(&[forward * 10.0_f64.powf(8.0 * random.next())])
            })
            .collect();
        let given = Given { scene, ..Given::default() };
        let found = ask("tolerance_m_at(a.xyz), 0.0, 0.0, 0.0", given, &places);
        for ([found, ..], place) in found.iter().zip(&places) {
            let truth = vantage.tolerance_m_at(place.vector(0));
            assert!(off(*found, truth, 0.0) < 1e-5, "{place:?}: {found} for {truth}");
        }
    }
}

/// Taps without data drop out, and the others are weighed anew.
#[test]
fn taps_are_blended_with_their_holes() {
    let mut random = Random(0x7a_95);
    let asked: Vec<Question> = (0..5_000)
        .map(|_| {
            let mut numbers = || [(); 4].map(|()| random.next() as f32);
            let (values, mut covers, places) = (numbers(), numbers(), numbers());
            for cover in &mut covers {
                // As stored, and often none.
                *cover = if *cover < 0.3 { 0.0 } else { (*cover * 255.0).round() / 255.0 };
            }
            Question([values.map(|value| 2e4 * value), covers, places, [0.0; 4]])
        })
        .collect();
    let tap = |at: char| format!("vec4f(a.{at}, 0.0, 0.0, b.{at})");
    let taps: Vec<String> = "xyzw".chars().map(tap).collect();
    let blended = format!("blend_taps({}, tap_weights(c.xy))", taps.join(", "));
    let expression = format!("{blended}.value.x, {blended}.coverage, 0.0, 0.0");
    let found = ask(&expression, Given::default(), &asked);
    let mut holes = 0;
    for ([value, coverage, ..], Question([values, covers, t, _])) in found.iter().zip(&asked) {
        let t = DVec2::new(t[0].into(), t[1].into());
        let weights = [(1.0 - t.x) * (1.0 - t.y), t.x * (1.0 - t.y), (1.0 - t.x) * t.y, t.x * t.y];
        let valid = |i: usize| covers[i] > 0.0;
        let sum: f64 = (0..4).filter(|&i| valid(i)).map(|i| weights[i]).sum();
        if (sum - 1.0 / 512.0).abs() < 1e-6 {
            continue;
        }
        holes += u32::from(sum < 1.0 / 512.0);
        let mean = |of: &[f32; 4]| {
            (0..4).filter(|&i| valid(i)).map(|i| weights[i] * f64::from(of[i])).sum::<f64>()
        };
        let (expected, covered) =
            if sum < 1.0 / 512.0 { (0.0, 0.0) } else { (mean(values) / sum, mean(covers)) };
        assert!(off(*value, expected, 1.0) < 1e-5, "{values:?} {covers:?} {t}: {value}");
        assert!((coverage - covered).abs() < 1e-6, "{covers:?} {t}: {coverage} for {covered}");
    }
    assert!(holes > 20, "{holes}");
}

#[test]
fn a_projection_has_the_quality_of_its_grid() {
    let mut random = Random(0x90_a1);
    for (name, grid, _) in grids() {
        let finest = grid.pyramid().finest();
        let size = grid.pyramid().size(finest).unwrap();
        let (mut asked, mut expected) = (Vec::new(), Vec::new());
        while asked.len() < 500 {
            let x = random.next() * f64::from(size.width);
            let place = TexelPoint { x, y: random.next() * f64::from(size.height) };
            let Some(place) = grid.geographic_from_texel(finest, place) else { continue };
            let (larger, smaller) = grid.crs().principal_scales(place, grid.pixel_size());
            asked.push([larger, smaller, 0.0]);
            expected.push(grid.quality(place));
        }
        let found = ask_numbers("quality_of(a.xy), 0.0, 0.0, 0.0", Given::default(), &asked);
        // Only ratios count.
        let factor = expected[0] / found[0][0];
        for (([found, ..], truth), scales) in found.iter().zip(&expected).zip(&asked) {
            assert!(off(factor * found, *truth, 0.0) < 1e-5, "{name} {scales:?}: {found} {truth}");
        }
    }
}

#[test]
fn the_air_is_told_function_by_function() {
    let mut random = Random(0xa1_47);
    let cosines: Vec<[f64; 3]> = (0..2_000)
        .map(|_| [300.0 + 5_000.0 * random.next(), 2.0 * random.next() - 1.0, random.next()])
        .collect();
    let found = ask_numbers(
        "chapman(a.x, abs(a.y)), rayleigh_phase(a.y), mie_phase(a.y, 0.9 * a.z), 0.0",
        Given::default(),
        &cosines,
    );
    for (found, &[x, cosine, forward]) in found.iter().zip(&cosines) {
        let forward = 0.9 * forward;
        let truth = [chapman(x, cosine.abs()), rayleigh_phase(cosine), mie_phase(cosine, forward)];
        for (found, truth) in found.iter().zip(truth) {
            assert!(off(*found, truth, 0.0) < 1e-4, "{x} {cosine} {forward}: {found} {truth}");
        }
    }

    for (body, atmosphere) in [
        (Ellipsoid::WGS84, Atmosphere::EARTH),
        (Ellipsoid::sphere(Meters(3_396_190.0)).unwrap(), Atmosphere::MARS),
    ] {
        for eye_m in [2.0, 5e3, 4e5] {
            let up = random.direction();
            let eye = up * (body.a().0 + eye_m);
            let air = Air { eye_m, radius_m: body.a().0, ..Air::new(&body, atmosphere, eye, up) };
            let given = Given { air: air.mirrored(), ..Given::default() };
            let asked: Vec<[f64; 3]> = (0..2_000)
                .map(|_| [air.atmosphere.top_m * random.next(), 2.0 * random.next() - 1.0, 0.0])
                .collect();
            let found = ask_numbers("sunlight_at(a.x, a.y), 0.0", given, &asked);
            let mut lit = 0;
            for (found, &[height_m, cosine, _]) in found.iter().zip(&asked) {
                let rim = -(1.0 - (air.radius_m / (air.radius_m + height_m)).powi(2)).sqrt();
                // Of the last meters above the ground f32 knows little.
                if (cosine - rim).abs() < 1e-5 {
                    continue;
                }
                let truth = air.sunlight(height_m, cosine);
                lit += u32::from(truth.x > 0.0);
                for (found, truth) in found.iter().zip(truth.to_array()) {
                    assert!((found - truth).abs() < 0.02, "{height_m} {cosine}: {found} {truth}");
                }
            }
            assert!(lit > 500, "{lit}");

            let asked: Vec<Question> = (0..2_000)
                .map(|_| {
                    let way = 10.0_f64.powf(6.0 * random.next());
                    Question::of(&[random.direction(), DVec3::X * way])
                })
                .collect();
            let height = "air_height(air_ray(a.xyz), air_ray(a.xyz).eye + b.x), 0.0, 0.0, 0.0";
            let found = ask(height, given, &asked);
            for ([found, ..], asked) in found.iter().zip(&asked) {
                let (direction, way) = (asked.vector(0), asked.vector(1).x);
                let truth = air.height_m(direction.dot(air.up) / direction.length(), way);
                let allowed = 10.0 + 1e-5 * truth.abs();
                assert!((found - truth).abs() < allowed, "{asked:?}: {found} for {truth}");
            }
        }
    }
}
