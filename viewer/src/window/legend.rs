//! What the picture's colors mean, where they are not the ground's.

use areoid_cache::{DatasetInfo, Datasets};
use areoid_formats::page::Kind;
use egui::{Color32, Sense, Ui, vec2};

use super::settings::Settings;
use crate::render::Debug;
use crate::style::{Ramp, Role};

/// A color and what it stands for.
#[derive(Clone, Debug, PartialEq)]
struct Entry {
    color: [u8; 3],
    text: String,
}

/// Shows it; nothing, where the ground has its own colors.
pub(super) fn legend(ui: &mut Ui, settings: &Settings, datasets: &Datasets) {
    for Entry { color: [red, green, blue], text } in entries(settings, datasets) {
        ui.horizontal(|ui| {
            let (place, _) = ui.allocate_exact_size(vec2(18.0, 12.0), Sense::hover());
            ui.painter().rect_filled(place, 2.0, Color32::from_rgb(red, green, blue));
            ui.monospace(text);
        });
    }
}

/// The ramps from the highest down, and what is shown of how the picture was made.
fn entries(settings: &Settings, datasets: &Datasets) -> Vec<Entry> {
    let entry = |color, text: &str| Entry { color, text: text.to_owned() };
    let mut entries = Vec::new();
    let mut tell = |ramp: &Ramp, of: &str| {
        let stops = ramp.stops.iter().rev();
        entries.extend(stops.map(|stop| entry(stop.color, &format!("{} m{of}", stop.height_m))));
    };
    if let Some(ramp) = settings.ramp() {
        tell(&ramp, "");
    }
    for layer in &settings.style.layers {
        let is_meant = |info: &DatasetInfo| {
            let found = settings.style.layer(&info.name);
            info.kind == Kind::Height && found.is_some_and(|found| std::ptr::eq(found, layer))
        };
        let is_drawn = datasets.iter().any(|(_, info)| is_meant(info));
        let ramp = layer.ramp.as_ref().filter(|ramp| layer.weight * ramp.opacity > 0.0 && is_drawn);
        if let Some(ramp) = ramp {
            tell(ramp, &format!(" of {}", layer.dataset));
        }
    }
    match settings.debug {
        Debug::Off => {}
        Debug::Dataset => {
            let may_be_told = |info: &DatasetInfo| match info.kind {
                Kind::Height => true,
                Kind::Color => settings.layer(&info.name).role == Role::Color,
                Kind::Normal => false,
            };
            let is_shown = |info: &DatasetInfo| !settings.style.hides(&info.name);
            let shown = datasets.iter().filter(|(_, info)| may_be_told(info) && is_shown(info));
            entries.extend(shown.map(|(number, info)| {
                let number = u32::try_from(number).unwrap_or(u32::MAX);
                entry(color_of_number(number).map(code), &info.name)
            }));
        }
        Debug::Level => entries.extend((0..LEVELS).map(|level| Entry {
            color: color_of_number(level).map(code),
            text: format!("level {level}"),
        })),
        Debug::Borders => entries.push(entry([255, 230, 26], "outline of a page")),
        Debug::Residency => {
            entries.push(entry([255, 26, 13], "a coarser page stands in"));
            entries.push(entry([51, 77, 255], "a finer page is shown"));
        }
        Debug::Error => {
            let texts = ["exact", "half the tolerance, or all of it", "more than the tolerance"];
            entries.extend(
                EXCESSES.into_iter().zip(texts).map(|((_, color), text)| entry(color, text)),
            );
        }
    }
    entries
}

/// Levels that are told: colors of neighbors differ, those of levels far apart need not.
const LEVELS: u32 = 12;

/// Errors over the tolerance, and their colors: of `color_of_excess` in `debug.wgsl`.
const EXCESSES: [(f32, [u8; 3]); 3] =
    [(0.0, [26, 153, 51]), (1.0, [255, 230, 26]), (1.5, [255, 26, 13])];

/// The twin of the shader's: `debug.wgsl`.
fn color_of_number(number: u32) -> [f64; 3] {
    let hue = (f64::from(number) * 0.618_033_99).fract() * 6.0;
    [(hue - 3.0).abs() - 1.0, 2.0 - (hue - 2.0).abs(), 2.0 - (hue - 4.0).abs()]
        .map(|light| light.clamp(0.0, 1.0))
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 255")]
fn code(light: f64) -> u8 {
    (255.0 * light).round() as u8
}

#[cfg(test)]
mod tests {
    use areoid_formats::body::Ellipsoid;
    use areoid_formats::grid::Outline;
    use areoid_formats::projection::{Crs, Projection};
    use bytemuck::{Pod, Zeroable};

    use super::*;
    use crate::render::testing::{Given, compute};
    use crate::shader::Program;
    use crate::style::{Layer, Stop, Style};
    use crate::testing::{dataset, gpu};

    /// A question to both functions of colors, and their answers.
    #[repr(C)]
    #[derive(Clone, Copy, Debug, Pod, Zeroable)]
    struct Probe {
        of_number: [f32; 3],
        number: u32,
        of_excess: [f32; 3],
        excess: f32,
    }

    const PROBE: &str = "
struct Probe { of_number: vec3f, number: u32, of_excess: vec3f, excess: f32 }
@group(1) @binding(0) var<storage, read_write> probes: array<Probe>;
@compute @workgroup_size(64)
fn probe(@builtin(global_invocation_id) id: vec3u) {
    let i = id.x;
    if i >= arrayLength(&probes) { return; }
    probes[i].of_number = color_of_number(probes[i].number);
    probes[i].of_excess = color_of_excess(probes[i].excess);
}
";

    #[test]
    fn a_legend_has_the_colors_of_the_shader() {
        let mut probes: Vec<Probe> =
            (0..100).map(|number| Probe { number, ..Probe::zeroed() }).collect();
        // From half the tolerance on nothing changes up to all of it.
        let excesses = EXCESSES.into_iter().chain([(0.5, EXCESSES[1].1)]);
        for (probe, (excess, _)) in probes.iter_mut().zip(excesses.clone()) {
            probe.excess = excess;
        }
        let source = Program::Shade.source() + PROBE;
        let found = compute(gpu(), &source, Given::default(), &probes);
        for probe in &found {
            for (light, truth) in probe.of_number.into_iter().zip(color_of_number(probe.number)) {
                assert!((f64::from(light) - truth).abs() < 1e-4, "{probe:?}, {truth}");
            }
        }
        for (probe, (_, color)) in found.iter().zip(excesses) {
            for (light, truth) in probe.of_excess.into_iter().zip(color) {
                assert!(code(light.into()).abs_diff(truth) <= 1, "{probe:?}, {color:?}");
            }
        }
    }

    fn settings(debug: Debug) -> Settings {
        let stop = |height_m, code| Stop { height_m, color: [code; 3] };
        let ramp = Ramp { stops: vec![stop(-10.0, 1), stop(20.5, 2)], opacity: 1.0 };
        let style = Style { layers: Vec::new(), ramp: Some(ramp) };
        Settings { debug, ..Settings::new(1.0, style) }
    }

    #[test]
    fn a_legend_is_of_the_colors_that_are_shown() {
        let mut plain = settings(Debug::Off);
        let texts = |settings: &Settings| -> Vec<String> {
            entries(settings, &Datasets::default()).into_iter().map(|entry| entry.text).collect()
        };
        assert_eq!(texts(&plain), ["20.5 m", "-10 m"]);
        assert_eq!(entries(&plain, &Datasets::default())[0].color, [2; 3]);
        plain.has_ramp = false;
        assert!(texts(&plain).is_empty());
        let ramp = plain.style.ramp.clone();
        plain.style.layers = vec![Layer { ramp, ..Layer::of("hill") }];
        assert!(texts(&plain).is_empty(), "of a dataset that is not there");
        let degrees = Crs::new(Projection::Geographic, Ellipsoid::WGS84);
        let outline = Outline { origin: [0.0; 2], pixel_size: [1.0; 2], width: 4, height: 4 };
        let [hill, shades] = [("hill", Kind::Height), ("shades", Kind::Normal)]
            .map(|(name, kind)| dataset(name, kind, degrees, outline, 64, 0));
        let datasets = Datasets::from(vec![shades, hill]);
        let all = entries(&Settings { debug: Debug::Dataset, ..plain.clone() }, &datasets);
        let told: Vec<_> = all.iter().map(|entry| entry.text.as_str()).collect();
        assert_eq!(told, ["20.5 m of hill", "-10 m of hill", "hill"]);
        assert_eq!(all[2].color, color_of_number(1).map(code));

        let levels = entries(&settings(Debug::Level), &Datasets::default());
        assert_eq!(levels.len(), 2 + LEVELS as usize);
        for pair in levels[2..].windows(2) {
            let apart = (0..3).map(|i| pair[0].color[i].abs_diff(pair[1].color[i])).max();
            assert!(apart > Some(90), "{pair:?}");
        }
        assert!(texts(&settings(Debug::Error)).contains(&"exact".to_owned()));
    }
}
