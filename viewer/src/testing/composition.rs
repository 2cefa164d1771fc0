//! What the shaders compose against the twin on the CPU: colors, ramps, luminances, normals, in any
//! style; and how pages come into a picture.

use std::sync::OnceLock;

use areoid_cache::{Selection, View};
use areoid_formats::address::Level;
use areoid_formats::body::Ellipsoid;
use areoid_formats::geodesy::{Geographic, geographic_from_normal, surface_normal};
use areoid_formats::grid::Outline;
use areoid_formats::normal;
use areoid_formats::page::Kind;
use areoid_formats::projection::{Crs, Projection};
use areoid_formats::units::{Degrees, Meters};
use glam::DVec3;

use super::{Planet, dataset, gpu};
use crate::camera::{Pose, pixel_angle};
use crate::mesh::frame::{axes_at, reference_point};
use crate::style::{Layer, Ramp, Role, Stop, Style};
use crate::surface::{BARE_COLOR, Surface};
use crate::{Debug, Image, Light, Options, Relief, Renderer};

const SIDE: u32 = 96;
/// Light from everywhere: the ground's own colors.
const UNLIT: Light = Light { toward_sun: DVec3::Z, ambient: 1.0 };

fn body() -> Ellipsoid {
    Ellipsoid::sphere(Meters(1e6)).unwrap()
}

fn globe(name: &str, kind: Kind, width: u32, priority: i32) -> areoid_cache::DatasetInfo {
    let degrees = Crs::new(Projection::Geographic, body());
    let pixel = 360.0 / f64::from(width);
    let height = width / 2;
    let outline = Outline { origin: [-180.0, 90.0], pixel_size: [pixel; 2], width, height };
    dataset(name, kind, degrees, outline, 64, priority)
}

/// A rectangle about the view, whose coverage falls off toward its rim.
fn region(name: &str, kind: Kind, priority: i32) -> areoid_cache::DatasetInfo {
    let degrees = Crs::new(Projection::Geographic, body());
    let outline = Outline { origin: [-10.0, 20.0], pixel_size: [0.1; 2], width: 240, height: 240 };
    dataset(name, kind, degrees, outline, 64, priority)
}

fn waves(place: Geographic, k: f64) -> f64 {
    let n = surface_normal(place);
    ((k * n.x).sin() + (k * n.y + 1.0).cos() + (k * n.z).sin()) / 3.0
}

fn code(value: f64) -> f32 {
    (127.5 + 120.0 * value).round() as f32
}

fn feathered(place: Geographic) -> u8 {
    let [x, y] = [place.longitude, place.latitude].map(|angle| Degrees::from(angle).0);
    let inside = (x + 10.0).min(14.0 - x).min(20.0 - y).min(y + 4.0);
    (255.0 * (inside / 6.0).clamp(0.004, 1.0)) as u8
}

/// The ground's own normal in the tests: tilted up to 30° this way and that.
fn tilted(place: Geographic) -> DVec3 {
    let up = surface_normal(place);
    (up + 0.5 * DVec3::new(waves(place, 9.0), waves(place, 7.0), waves(place, 8.0))).normalize()
}

/// Heights twice, two colors over one another, a luminance and two dates.
fn planet() -> &'static Planet {
    static PLANET: OnceLock<Planet> = OnceLock::new();
    PLANET.get_or_init(|| {
        let mut planet = Planet::default();
        planet.add(globe("heights", Kind::Height, 512, 0), |place| {
            ([2000.0 * waves(place, 5.0) as f32, 0.0, 0.0], 255)
        });
        planet.add(globe("base", Kind::Color, 512, 0), |place| {
            ([11.0, 23.0, 31.0].map(|k| code(waves(place, k))), 255)
        });
        planet.add(region("sharp", Kind::Color, 1), |place| {
            ([60.0, 40.0, 50.0].map(|k| code(waves(place, k))), feathered(place))
        });
        planet.add(region("beside", Kind::Color, 1), |place| {
            // Gray, as most of its pages are.
            ([code(-waves(place, 20.0)); 3], 255)
        });
        planet.add(region("hill", Kind::Height, 1), |place| {
            ([1000.0 + 800.0 * waves(place, 30.0) as f32, 0.0, 0.0], feathered(place))
        });
        planet
    })
}

fn view() -> View {
    view_from([2.0, 8.0])
}

fn view_from([longitude, latitude]: [f64; 2]) -> View {
    let at = Geographic::from_degrees(Degrees(longitude), Degrees(latitude));
    let pose =
        Pose::from_eye(&body(), at, Meters(3e5), Degrees(20.0).into(), Degrees(-70.0).into());
    pose.view(Degrees(45.0).into(), [SIDE; 2], 1.0)
}

fn draw(selection: &Selection, light: &Light, options: &Options) -> (Image, Vec<[f64; 2]>) {
    draw_from(&view(), selection, light, options)
}

fn draw_from(
    view: &View,
    selection: &Selection,
    light: &Light,
    options: &Options,
) -> (Image, Vec<[f64; 2]>) {
    let mut renderer = Renderer::new(gpu(), body());
    renderer.render(view, selection, light, options);
    let places = renderer.read_aovs().geographic;
    (renderer.read_color(), places)
}

/// The largest difference between a picture's codes and those of a function of place and footprint.
fn worst(
    image: &Image,
    places: &[[f64; 2]],
    expected: impl Fn(Geographic, f64) -> [f64; 3],
) -> f64 {
    let view = view();
    let mut worst = 0.0_f64;
    let mut compared = 0;
    for (pixel, &[longitude, latitude]) in image.rgba.chunks_exact(4).zip(places) {
        if longitude.is_nan() {
            continue;
        }
        let place = Geographic::from_degrees(Degrees(longitude), Degrees(latitude));
        let ground = body().cartesian_from_geographic(place, Meters(0.0));
        let footprint_m = ground.distance(view.eye) * pixel_angle(&view);
        for (code, expected) in pixel.iter().zip(expected(place, footprint_m)) {
            worst = worst.max((f64::from(*code) - expected).abs());
        }
        compared += 1;
    }
    assert!(compared > 5000, "{compared} pixels show the planet");
    worst
}

fn style(layers: Vec<Layer>) -> Style {
    Style { layers, ramp: None }
}

#[test]
fn every_style_is_composed_as_the_twin_does() {
    let stop = |height_m, color| Stop { height_m, color };
    let ramp = Ramp {
        stops: vec![stop(-900.0, [10, 0, 90]), stop(0.0, [0, 140, 20]), stop(700.0, [250; 3])],
        opacity: 0.6,
    };
    let dark =
        Ramp { stops: vec![stop(-2000.0, [0; 3]), stop(5000.0, [120, 60, 90])], opacity: 1.0 };
    let colored = |dataset: &str, priority, ramp: &Ramp| Layer {
        priority: Some(priority),
        ramp: Some(ramp.clone()),
        ..Layer::of(dataset)
    };
    let styles = [
        ("as they are", Style::default()),
        ("faint", style(vec![Layer { weight: 0.4, ..Layer::of("base") }])),
        ("alone", style(vec![Layer { weight: 0.0, ..Layer::of("base") }])),
        ("lifted", style(vec![Layer { priority: Some(5), weight: 0.7, ..Layer::of("base") }])),
        (
            "dates",
            style(vec![
                Layer { series: 1, weight: 0.3, ..Layer::of("beside") },
                Layer { series: 1, weight: 0.7, ..Layer::of("sharp") },
            ]),
        ),
        (
            "luminance",
            style(vec![
                Layer { role: Role::Luminance, weight: 0.8, ..Layer::of("sharp") },
                Layer { weight: 0.0, ..Layer::of("beside") },
            ]),
        ),
        ("colored heights", style(vec![colored("heights", 2, &ramp), colored("hill", 1, &dark)])),
        (
            "both ramps",
            Style { ramp: Some(ramp.clone()), ..style(vec![colored("hill", 1, &dark)]) },
        ),
        ("ramp", Style { ramp: Some(ramp), ..Style::default() }),
    ];
    let selection = planet().selection(|_| true);
    let mut pictures = Vec::new();
    for (name, style) in styles {
        let options = Options { style: style.clone(), anisotropy: 0, ..Options::default() };
        let (image, places) = draw(&selection, &UNLIT, &options);
        let surface = Surface::styled(&selection, &style);
        let off = worst(&image, &places, |place, footprint_m| surface.color(place, footprint_m));
        println!("{name}: at most {off:.2} codes");
        assert!(off <= 2.0, "{name}: {off}");
        pictures.push((name, image));
    }
    for (i, (one, image)) in pictures.iter().enumerate() {
        for (other, same) in &pictures[..i] {
            assert!(image != same, "{one} is {other}");
        }
    }
}

/// Of two datasets of one priority the finer one weighs more, and is told where it is.
#[test]
fn the_dataset_that_is_told_is_the_one_that_is_seen() {
    let gray = |_| ([128.0; 3], 255);
    let told = |fine: bool| {
        let mut planet = Planet::default();
        planet.add(globe("base", Kind::Color, 512, 0), gray);
        if fine {
            planet.add(region("sharp", Kind::Color, 0), gray);
        }
        let options = Options { debug: Debug::Dataset, ..Options::default() };
        draw(&planet.selection(|_| true), &UNLIT, &options)
    };
    let [(both, places), (base, _)] = [true, false].map(told);
    let mut counts = [0; 2];
    let pixels = both.rgba.chunks_exact(4).zip(base.rgba.chunks_exact(4));
    for (pixel, (one, other)) in pixels.enumerate() {
        let [x, y] = places[pixel];
        let from_rim = (x + 10.0).min(14.0 - x).min(20.0 - y).min(y + 4.0);
        if from_rim.abs() > 0.5 {
            assert_eq!(one != other, from_rim > 0.0, "{x} {y}");
            counts[usize::from(from_rim > 0.0)] += 1;
        }
    }
    assert!(counts[0] > 100 && counts[1] > 100, "{counts:?}");
}

/// Colors tell numbers, which stay whatever else is in sight: 0 is red, 1 is blue.
#[test]
fn a_dataset_has_its_own_color() {
    let gray = |_| ([128.0; 3], 255);
    let mut planet = Planet::default();
    planet.add(globe("base", Kind::Color, 512, 0), gray);
    planet.add(region("sharp", Kind::Color, 1), gray);
    let options = Options { debug: Debug::Dataset, ..Options::default() };
    let (image, places) = draw(&planet.selection(|_| true), &UNLIT, &options);
    let mut counts = [0; 2];
    for (pixel, [x, y]) in image.rgba.chunks_exact(4).zip(places) {
        let from_rim = (x + 10.0).min(14.0 - x).min(20.0 - y).min(y + 4.0);
        if from_rim.abs() > 0.5 {
            let is_sharp = from_rim > 0.0;
            assert_eq!(pixel[2] > pixel[0], is_sharp, "{pixel:?} at {x} {y}");
            counts[usize::from(is_sharp)] += 1;
        }
    }
    assert!(counts[0] > 100 && counts[1] > 100, "{counts:?}");
}

/// Bare ground, and colors.
#[test]
fn composed_normals_are_lit() {
    let light = Light { toward_sun: DVec3::new(1.0, 0.3, 0.6), ambient: 0.1 };
    let options = Options { anisotropy: 0, ..Options::default() };
    for colored in [false, true] {
        let mut planet = Planet::default();
        planet.add(globe("heights", Kind::Height, 128, 0), |_| ([0.0; 3], 255));
        planet.add(globe("tilts", Kind::Normal, 1024, 0), |place| {
            let codes = normal::codes(normal::exact_codes(tilted(place), surface_normal(place)));
            (codes.map(f32::from), 255)
        });
        if colored {
            planet.add(globe("base", Kind::Color, 512, 0), |place| {
                ([11.0, 23.0, 31.0].map(|k| code(waves(place, k))), 255)
            });
        }
        let selection = planet.selection(|_| true);
        let (image, places) = draw(&selection, &light, &options);
        let surface = Surface::new(&selection);
        let off = worst(&image, &places, |place, footprint_m| {
            let found = surface.compose(Kind::Normal, place, footprint_m).unwrap();
            let normal = normal::normal_from_codes(found.value, surface_normal(place));
            let lit = 0.1 + 0.9 * normal.dot(light.toward_sun.normalize()).max(0.0);
            let color = if colored { surface.color(place, footprint_m) } else { BARE_COLOR };
            color.map(|code| shaded(code, lit))
        });
        assert!(off <= 2.0, "{off}");
    }
}

/// Where no dataset has normals: by the sun, and by the light of a map.
#[test]
fn slopes_are_lit() {
    const AMBIENT: f64 = 0.1;
    // Wide waves, as steep as a sixth: over a texel the slope hardly changes.
    let height = |place: Geographic| {
        let normal = surface_normal(place);
        25_000.0 * ((7.0 * normal.x).sin() + (6.0 * normal.y).sin() + (8.0 * normal.z).sin())
    };
    let mut planet = Planet::default();
    planet.add(globe("heights", Kind::Height, 2048, 0), |place| {
        ([height(place) as f32, 0.0, 0.0], 255)
    });
    let selection = planet.selection(|_| true);
    let ground = |normal: DVec3| {
        reference_point(&body(), normal) + height(geographic_from_normal(normal)) * normal
    };
    let slope = |place: Geographic| {
        let axes = axes_at(surface_normal(place));
        let [east, north] = [axes.x_axis, axes.y_axis].map(|axis| {
            let step = 1e-5 * axis;
            ground((axes.z_axis + step).normalize()) - ground((axes.z_axis - step).normalize())
        });
        east.cross(north).normalize()
    };
    let sun = DVec3::new(1.0, 0.3, 0.6);
    let reliefs = [[315.0, 45.0], [80.0, 20.0]].map(Relief::from_degrees);
    let mut pictures = Vec::new();
    let reliefs = [None, Some(reliefs[0]), Some(reliefs[1])];
    // A pole in the picture, too, about which a map's light turns.
    let eyes = [[2.0, 8.0], [30.0, 88.0]];
    for (eye, relief) in eyes.into_iter().flat_map(|eye| reliefs.map(|relief| (eye, relief))) {
        let light = Light { toward_sun: sun, ambient: AMBIENT };
        let options = Options { anisotropy: 0, relief, ..Options::default() };
        let (image, places) = draw_from(&view_from(eye), &selection, &light, &options);
        let off = worst(&image, &places, |place, _| {
            let toward = relief.map_or(sun.normalize(), |relief| {
                let (across, up) = (relief.elevation.0.cos(), relief.elevation.0.sin());
                let (east, north) = (relief.azimuth.0.sin(), relief.azimuth.0.cos());
                axes_at(surface_normal(place)) * DVec3::new(east * across, north * across, up)
            });
            let lit = AMBIENT + (1.0 - AMBIENT) * slope(place).dot(toward).max(0.0);
            BARE_COLOR.map(|code| shaded(code, lit))
        });
        println!("{eye:?}, {relief:?}: at most {off:.2} codes");
        assert!(off <= 2.0, "{eye:?}, {relief:?}: {off}");
        pictures.push(image);
    }
    assert!(pictures[0] != pictures[1] && pictures[1] != pictures[2]);
}

/// The code of sRGB (IEC 61966-2-1) for so many times the light of another.
fn shaded(code: f64, light: f64) -> f64 {
    let code = code / 255.0;
    let linear = if code <= 0.040_45 { code / 12.92 } else { ((code + 0.055) / 1.055).powf(2.4) };
    let linear = linear * light;
    let encoded =
        if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
    255.0 * encoded
}

/// Colors whose channels are equal but for the blue one, which is so many codes more.
fn tinted(codes: f32) -> Planet {
    let mut planet = Planet::default();
    planet.add(globe("base", Kind::Color, 1024, 0), |place| {
        let gray = code(waves(place, 23.0));
        ([gray, gray, gray + codes], 255)
    });
    planet
}

#[test]
fn gray_pages_are_composed_as_others_are() {
    let mut planet = tinted(0.0);
    planet.add(region("sharp", Kind::Color, 1), |place| {
        ([code(waves(place, 60.0)); 3], feathered(place))
    });
    let selection = planet.selection(|_| true);
    let options = Options { anisotropy: 0, ..Options::default() };
    let (image, places) = draw(&selection, &UNLIT, &options);
    let surface = Surface::new(&selection);
    let off = worst(&image, &places, |place, footprint_m| surface.color(place, footprint_m));
    assert!(off <= 2.0, "{off}");

    // In another atlas, a code is the same code.
    let (colored, _) = draw(&tinted(1.0).selection(|_| true), &UNLIT, &options);
    let (gray, _) = draw(&tinted(0.0).selection(|_| true), &UNLIT, &options);
    for (one, other) in gray.rgba.chunks_exact(4).zip(colored.rgba.chunks_exact(4)) {
        assert!(one[..2] == other[..2] && one[2].abs_diff(other[2]) <= 1, "{one:?} {other:?}");
    }
    assert!(gray != colored);
}

#[test]
fn gray_pages_take_a_quarter_of_the_memory() {
    let options = Options {
        upload_limit_bytes: u64::MAX,
        upload_limit_seconds: f64::INFINITY,
        ..Options::default()
    };
    let left_out = |codes: f32| {
        let selection = tinted(codes).selection(|_| true);
        let texels: usize = selection.pages.iter().map(|page| page.page.side().pow(2)).sum();
        // Of which an atlas has three quarters.
        let budget_bytes = (texels * 4).div_ceil(3);
        let mut renderer = Renderer::with_budget(gpu(), body(), budget_bytes as u64);
        let drawn = renderer.render(&view(), &selection, &UNLIT, &options);
        assert_eq!(drawn.pending_pages, 0);
        drawn.left_out_pages as f64 / selection.pages.len() as f64
    };
    assert_eq!(left_out(0.0), 0.0);
    assert!((left_out(1.0) - 0.75).abs() < 0.01, "{}", left_out(1.0));
}

/// Where the budget holds no more than what is looked at, in the atlas of grays and in that of colors.
#[test]
fn pages_that_made_room_for_others_are_drawn_again() {
    let options = Options {
        upload_limit_bytes: u64::MAX,
        upload_limit_seconds: f64::INFINITY,
        fade_seconds: 0.0,
        ..Options::default()
    };
    for (codes, texel_bytes) in [(0.0, 1), (1.0, 4)] {
        let planet = tinted(codes);
        let looks = [0, 1].map(|odd| {
            let coarse = Level(2);
            let mut selection = planet.selection(|page| {
                let page = page.entry.page;
                page.level <= coarse || page.row % 2 == odd
            });
            selection.generation = 1 + u64::from(odd);
            selection
        });
        let texels = |look: &Selection| -> usize {
            look.pages.iter().map(|page| page.page.side().pow(2)).sum()
        };
        let most = looks.iter().map(texels).max().unwrap();
        // Of which an atlas has three quarters.
        let budget_bytes = ((most * texel_bytes).div_ceil(3) * 4) as u64;
        let mut renderer = Renderer::with_budget(gpu(), body(), budget_bytes);
        let fresh = looks.each_ref().map(|look| draw(look, &UNLIT, &options).0);
        assert!(fresh[0] != fresh[1]);
        for (turn, (look, fresh)) in looks.iter().zip(&fresh).cycle().take(4).enumerate() {
            let drawn = renderer.render(&view(), look, &UNLIT, &options);
            assert!(drawn.uploaded_pages > 0 && drawn.left_out_pages == 0, "{turn}: {drawn:?}");
            assert!(renderer.read_color() == *fresh, "{codes}: look {turn}");
        }
    }
}

#[test]
fn a_page_that_comes_fades_in_and_a_picture_at_rest_is_not_drawn() {
    let planet = planet();
    let coarse = planet.selection(|page| {
        let info = &planet.datasets[page.dataset];
        info.kind == Kind::Height || page.entry.page.level <= Level(1)
    });
    let mut fine = planet.selection(|_| true);
    fine.generation = 2;
    let mut renderer = Renderer::new(gpu(), body());
    let mut at = |selection: &Selection, seconds: f64| {
        let options = Options { seconds, fade_seconds: 1.0, ..Options::default() };
        let statistics = renderer.render(&view(), selection, &UNLIT, &options);
        (renderer.read_color(), statistics)
    };
    let difference = |one: &Image, other: &Image| -> f64 {
        let codes = one.rgba.iter().zip(&other.rgba);
        codes.map(|(a, b)| f64::from(a.abs_diff(*b))).sum()
    };
    let (_, first) = at(&coarse, 0.0);
    assert!(first.coming_pages > 0 && !first.is_same);
    let (before, settled) = at(&coarse, 1.0);
    assert!(settled.coming_pages == 0 && !settled.is_same);
    let (_, rest) = at(&coarse, 1.5);
    assert!(rest.is_same && rest.uploaded_pages == 0);

    let (arrived, arriving) = at(&fine, 2.0);
    assert!(arriving.uploaded_pages > 0 && arriving.coming_pages == arriving.uploaded_pages);
    assert_eq!(difference(&before, &arrived), 0.0, "nothing pops");
    let halfway = at(&fine, 2.5).0;
    let (after, done) = at(&fine, 3.0);
    assert!(done.coming_pages == 0);
    let (whole, part) = (difference(&before, &after), difference(&before, &halfway));
    assert!(whole > 1000.0 && part > 0.4 * whole && part < 0.9 * whole, "{part} of {whole}");
    assert!(at(&fine, 9.0).1.is_same);
}
