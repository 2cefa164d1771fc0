//! The heights drawn against those of the CPU's surface of the same pages.

use areoid_cache::Selection;
use areoid_formats::page::Kind;
use areoid_formats::units::{Degrees, Meters, Radians};
use glam::DVec3;

use super::caster::quantile;
use super::gpu;
use super::worlds::{at, mars, split_mars};
use crate::camera::{Pose, pixel_angle};
use crate::surface::Surface;
use crate::{Light, Options, Renderer};

const SIDE: u32 = 160;
const LIGHT: Light = Light { toward_sun: DVec3::new(1.0, 0.5, 0.3), ambient: 0.1 };

/// Every page of a planet.
fn whole() -> Selection {
    let whole = &split_mars().whole;
    Selection {
        datasets: whole.datasets.clone(),
        pages: whole.pages.clone(),
        roots: Vec::new(),
        beneath: Vec::new(),
        failed: Vec::new(),
        ..*whole
    }
}

/// With pages missing here and there, their ancestors stand in on the GPU as on the CPU, and what is
/// finer than the view asks for gives way to what is coarser.
#[test]
fn ancestors_stand_in_for_missing_pages() {
    let mut selection = whole();
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
    let surface = Surface::new(&selection).seen_from(&view, 1.0);
    let mut off_m = Vec::new();
    for (index, position) in aovs.position.iter().enumerate() {
        let shown = DVec3::from_array(*position);
        if shown.is_finite() {
            let [longitude, latitude] = aovs.geographic[index];
            let footprint_m = (shown - view.eye).length() * pixel_angle(&view);
            let there = surface.compose(Kind::Height, at(longitude, latitude), footprint_m);
            off_m.push((f64::from(aovs.height_m[index]) - there.unwrap().value[0]).abs());
        }
    }
    let (most, worst) = (quantile(&mut off_m, 0.999), quantile(&mut off_m, 1.0));
    assert!(off_m.len() > 20_000 && most < 0.1, "{most} m, at worst {worst} m");
}
