//! Pictures of what the search wants at a tolerance of a pixel, against the f64 ray caster over the
//! finest level of all pages: places, depths and silhouettes, colors.
//!
//! `AREOID_REPORT=DIR` writes the table to `DIR/reference.csv`; `AREOID_SOAK=1` looks at every pixel.

use std::fmt::Write as _;
use std::time::Instant;

use areoid_cache::View;
use areoid_formats::geodesy::Geographic;
use areoid_formats::page::Kind;
use areoid_formats::units::{Degrees, Meters, Radians};
use glam::DVec3;

use super::caster::{Caster, SKY, ground_m, middle, quantile};
use super::worlds::{INSET, PEAK, World, at, earth, split_mars};
use super::{gpu, soak};
use crate::camera::{Pose, pixel_angle};
use crate::{Aovs, Light, Options, Renderer};

/// All light from everywhere: colors as they are.
const EVEN: Light = Light { toward_sun: DVec3::X, ambient: 1.0 };

/// A view by degrees and meters.
#[derive(Clone, Copy)]
struct Named {
    name: &'static str,
    is_earth: bool,
    /// Longitude, latitude, meters above the terrain.
    eye: [f64; 3],
    /// Heading and pitch.
    look: [f64; 2],
    fov: f64,
    /// How many times heights are taken.
    times: f64,
}

const fn mars(name: &'static str, eye: [f64; 3], look: [f64; 2], fov: f64) -> Named {
    Named { name, is_earth: false, eye, look, fov, times: 1.0 }
}

const fn on_earth(name: &'static str, eye: [f64; 3], look: [f64; 2], fov: f64) -> Named {
    Named { name, is_earth: true, eye, look, fov, times: 1.0 }
}

const DOWN: f64 = -90.0;
const FIELD_X: f64 = INSET[0];
const FIELD_Y: f64 = INSET[1];
const PEAK_X: f64 = PEAK[0];
const PEAK_Y: f64 = PEAK[1];

const VIEWS: [Named; 38] = [
    mars("disc", [30.0, 20.0, 9e6], [17.0, DOWN], 45.0),
    mars("disc from near", [-100.0, -5.0, 2e6], [200.0, DOWN], 70.0),
    mars("limb", [77.0, -40.0, 8e5], [30.0, -32.0], 50.0),
    mars("wide angle", [140.0, 10.0, 3e5], [70.0, -60.0], 110.0),
    mars("oblique at the equator", [11.0, 0.3, 1.2e5], [80.0, -25.0], 50.0),
    mars("oblique at mid-latitude", [-60.0, 47.0, 6e4], [-30.0, -18.0], 45.0),
    mars("ground at the equator", [0.1, -0.1, 2.0], [45.0, -3.0], 60.0),
    mars("ground at mid-latitude", [100.0, -44.0, 50.0], [190.0, -6.0], 60.0),
    mars("north pole from above", [0.0, 90.0, 2e6], [0.0, DOWN], 45.0),
    mars("over the south pole", [140.0, -88.8, 5e4], [180.0, -25.0], 50.0),
    mars("ground near the north pole", [20.0, 89.99, 100.0], [0.0, -5.0], 60.0),
    mars("where a cap begins", [33.0, 61.0, 2e5], [10.0, -50.0], 50.0),
    mars("antimeridian", [179.0, 3.0, 3e5], [100.0, -40.0], 50.0),
    mars("ground on the antimeridian", [180.0, -20.0, 10.0], [90.0, -4.0], 50.0),
    on_earth("disc of the Earth", [10.0, 30.0, 1.2e7], [0.0, DOWN], 60.0),
    on_earth("limb of the Earth", [60.0, 50.0, 4e5], [120.0, -17.0], 40.0),
    on_earth("oblique on the Earth", [120.0, -30.0, 1e5], [-60.0, -20.0], 50.0),
    on_earth("north pole of the Earth", [20.0, 90.0, 2.5e6], [0.0, DOWN], 60.0),
    on_earth("over the Earth's north pole", [0.0, 88.5, 9e4], [0.0, -20.0], 50.0),
    on_earth("south pole of the Earth", [50.0, -89.9, 4e5], [30.0, -70.0], 60.0),
    on_earth("antimeridian of the Earth", [-179.0, -3.0, 3e5], [-110.0, -35.0], 50.0),
    on_earth("edge of a dataset from above", [20.3, 1.2, 2e5], [0.0, DOWN], 50.0),
    on_earth("edge of a dataset", [19.0, 2.2, 6e4], [80.0, -20.0], 50.0),
    on_earth("hole of a dataset", [24.0, 3.4, 3e4], [0.0, -25.0], 50.0),
    on_earth("field from above", [FIELD_X, FIELD_Y, 250.0], [10.0, DOWN], 50.0),
    on_earth("oblique over the field", [FIELD_X, FIELD_Y - 0.001, 40.0], [0.0, -20.0], 50.0),
    on_earth("ground in the field", [FIELD_X, FIELD_Y, 1.7], [120.0, -8.0], 60.0),
    on_earth("edge of the field", [FIELD_X - 0.0011, FIELD_Y, 10.0], [80.0, -12.0], 60.0),
    on_earth("peak on the horizon", [PEAK_X - 2.9, PEAK_Y, 200.0], [90.0, 0.5], 8.0),
    on_earth("peak", [PEAK_X - 0.6, PEAK_Y - 0.4, 3e3], [56.0, 3.0], 50.0),
    mars("flat oblique", [11.0, 0.3, 1.2e5], [80.0, -25.0], 50.0).times(0.0),
    mars("high disc", [30.0, 20.0, 9e6], [17.0, DOWN], 45.0).times(10.0),
    mars("high oblique", [11.0, 0.3, 1.2e5], [80.0, -25.0], 50.0).times(4.0),
    mars("high ground", [100.0, -44.0, 50.0], [190.0, -6.0], 60.0).times(3.0),
    mars("high south pole", [140.0, -88.8, 5e4], [180.0, -25.0], 50.0).times(5.0),
    mars("steep oblique", [-60.0, 47.0, 6e4], [-30.0, -18.0], 45.0).times(8.0),
    mars("steeper oblique", [-60.0, 47.0, 6e4], [-30.0, -18.0], 45.0).times(20.0),
    on_earth("high peak on the horizon", [PEAK_X - 2.9, PEAK_Y, 200.0], [90.0, 0.5], 8.0)
        .times(2.0),
];

impl Named {
    const fn times(self, times: f64) -> Self {
        Self { times, ..self }
    }

    fn world(&self) -> &'static World {
        if self.is_earth { earth() } else { split_mars() }
    }

    fn view(&self, viewport: [u32; 2]) -> View {
        let world = self.world();
        let [longitude, latitude, above_m] = self.eye;
        let place = at(longitude, latitude);
        let ground = self.times * ground_m(&world.truth, place);
        let [heading, pitch] = self.look.map(|angle| Radians::from(Degrees(angle)));
        let pose = Pose::from_eye(&world.body, place, Meters(ground + above_m), heading, pitch);
        pose.view(Degrees(self.fov).into(), viewport, 1.0)
    }
}

/// What a picture is off by, smallest first once sorted.
#[derive(Debug, Default)]
struct Errors {
    /// Of depth and silhouette.
    px: Vec<f64>,
    /// Of the place told, from where the pixel's ray meets what is drawn.
    texels: Vec<f64>,
    /// Of colors, away from silhouettes.
    codes: Vec<f64>,
    /// Of the mesh from the surface that the pages make, along the ray's pixel.
    mesh_px: Vec<f64>,
}

/// What a pixel shows: what was read of a picture.
struct Shown {
    aovs: Aovs,
    /// Along the view's axis.
    depth_m: Vec<f64>,
    rgba: Vec<u8>,
}

struct Judge<'a> {
    view: &'a View,
    caster: Caster<'a>,
    world: &'a World,
    shown: &'a Shown,
}

impl Judge<'_> {
    /// Meters along a pixel's ray to what it shows.
    fn shown_m(&self, x: u32, y: u32) -> f64 {
        let direction = self.caster.direction(middle(x, y));
        let depth_m = self.shown.depth_m[(y * self.view.viewport[0] + x) as usize];
        if depth_m.is_finite() { depth_m / direction.dot(self.view.axis()) } else { SKY }
    }

    /// Whether what is shown around a pixel is much farther or nearer.
    fn at_silhouette(&self, x: u32, y: u32) -> bool {
        let [width, height] = self.view.viewport;
        let rows = y.saturating_sub(1)..=(y + 1).min(height - 1);
        let cols = x.saturating_sub(1)..=(x + 1).min(width - 1);
        let around = rows.flat_map(|y| cols.clone().map(move |x| (x, y)));
        let (mut least, mut most) = (SKY, 0.0_f64);
        for (x, y) in around {
            let shown_m = self.shown_m(x, y);
            (least, most) = (least.min(shown_m), most.max(shown_m));
        }
        most > 1.06 * least
    }

    /// Ground meters to a texel, as a pixel asks for it: of the finest dataset there, and no finer than
    /// the pixel.
    fn texel_m(&self, place: Geographic, footprint_m: f64) -> f64 {
        let datasets = &self.world.whole.datasets;
        let heights = datasets.iter().filter(|(_, info)| info.kind == Kind::Height);
        let texels = heights.filter_map(|(_, info)| {
            info.grid.locate(info.grid.pyramid().finest(), place)?;
            Some(info.grid.crs().principal_scales(place, info.grid.pixel_size()).0)
        });
        texels.fold(f64::INFINITY, f64::min).max(footprint_m)
    }

    fn judge(&self, x: u32, y: u32, errors: &mut Errors) {
        let [width, _] = self.view.viewport;
        let index = (y * width + x) as usize;
        let (pixel, shown_m) = (middle(x, y), self.shown_m(x, y));
        let off_px = self.caster.error_px(pixel, shown_m);
        errors.px.push(off_px);
        if shown_m == SKY {
            return;
        }
        let direction = self.caster.direction(pixel);
        let footprint_m = shown_m * pixel_angle(self.view);
        let met = self.view.eye + shown_m * direction;
        let (place, _) = self.world.body.geographic_from_cartesian(met);
        let [longitude, latitude] = self.shown.aovs.geographic[index];
        let told = at(longitude, latitude);
        let ground = |place| self.world.body.cartesian_from_geographic(place, Meters(0.0));
        let off_m = ground(told).distance(ground(place));
        errors.texels.push(off_m / self.texel_m(place, footprint_m));
        let surface = DVec3::from_array(self.shown.aovs.position[index]) - self.view.eye;
        errors.mesh_px.push(surface.cross(direction).length() / footprint_m);

        if !self.at_silhouette(x, y) {
            let expected = self.world.truth.compose(Kind::Color, place, footprint_m).unwrap().value;
            let drawn = &self.shown.rgba[4 * index..4 * index + 3];
            let off = drawn.iter().zip(expected).map(|(&a, b)| (f64::from(a) - b).abs());
            errors.codes.push(off.fold(0.0, f64::max));
        }
    }
}

/// Every pixel, or one of each square of `every`, wherever chance puts it.
fn sampled(viewport: [u32; 2], every: u32) -> Vec<(u32, u32)> {
    let [width, height] = viewport;
    let mut chance = 1_u32;
    let squares = (0..height / every).flat_map(|y| (0..width / every).map(move |x| (x, y)));
    let pixels = squares.map(|(x, y)| {
        chance = chance.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let (across, down) = ((chance >> 20) % every, (chance >> 8) % every);
        (x * every + across, y * every + down)
    });
    pixels.collect()
}

fn judge(named: &Named, view: &View, shown: &Shown, pixels: &[(u32, u32)]) -> Errors {
    let world = named.world();
    let (body, surface, exaggeration) = (world.body, &world.truth, named.times);
    let caster = Caster { view, body, surface, exaggeration };
    let judge = Judge { view, caster, world, shown };
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    std::thread::scope(|scope| {
        let judge = &judge;
        let parts: Vec<_> = pixels
            .chunks(pixels.len().div_ceil(threads))
            .map(|pixels| {
                scope.spawn(move || {
                    let mut errors = Errors::default();
                    for &(x, y) in pixels {
                        judge.judge(x, y, &mut errors);
                    }
                    errors
                })
            })
            .collect();
        let mut all = Errors::default();
        for part in parts {
            let part = part.join().unwrap();
            all.px.extend(part.px);
            all.texels.extend(part.texels);
            all.codes.extend(part.codes);
            all.mesh_px.extend(part.mesh_px);
        }
        all
    })
}

/// Median, 99 %, 99.9 % and the most.
fn spread(values: &mut [f64]) -> [f64; 4] {
    [0.5, 0.99, 0.999, 1.0].map(|share| quantile(values, share))
}

#[test]
fn views_are_what_the_ray_caster_sees() {
    let (viewport, every) = if soak() { ([640, 480], 1) } else { ([320, 240], 6) };
    let mut table = String::from(
        "view,tolerance px,error px median,99 %,99.9 %,max,mesh px 99 %,max,\
         place texels median,99 %,99.9 %,max,color codes 99.9 %,max,pages,bytes,patches,triangles,\
         select ms,draw ms\n",
    );
    let mut failures = Vec::new();
    let mut renderers = [split_mars(), earth()].map(|world| Renderer::new(gpu(), world.body));
    for named in &VIEWS {
        let view = named.view(viewport);
        let start = Instant::now();
        let selection = named.world().exaggerated(&view, named.times);
        let select_ms = 1e3 * start.elapsed().as_secs_f64();
        let renderer = &mut renderers[usize::from(named.is_earth)];
        let start = Instant::now();
        let options = Options { vertical_exaggeration: named.times, ..Options::default() };
        let drawn = renderer.render(&view, &selection, &EVEN, &options);
        let rgba = renderer.read_color().rgba;
        let draw_ms = 1e3 * start.elapsed().as_secs_f64();
        let shown = Shown { aovs: renderer.read_aovs(), depth_m: renderer.read_depth_m(), rgba };
        let mut errors = judge(named, &view, &shown, &sampled(viewport, every));
        let (px, texels) = (spread(&mut errors.px), spread(&mut errors.texels));
        let (codes, mesh) = (spread(&mut errors.codes), spread(&mut errors.mesh_px));
        let bytes: usize = selection.pages.iter().map(|page| page.page.bytes()).sum();
        let pages = selection.pages.len();
        println!(
            "{:30} {} px, off {px:.3?} px, mesh {mesh:.3?} px, place {texels:.4?} texels, color \
             {:.2?}, {pages} pages, {bytes} bytes, {} patches, {select_ms:.1} + {draw_ms:.0} ms",
            named.name,
            view.tolerance_px,
            &codes[2..],
            drawn.patches
        );
        let [median, p99, p999, most] = px;
        let [t_median, t_99, t_999, t_most] = texels;
        writeln!(
            table,
            "{},{},{median:.4},{p99:.4},{p999:.4},{most:.4},{:.4},{:.4},{t_median:.5},{t_99:.5},\
             {t_999:.5},{t_most:.5},{:.2},{:.2},{pages},{bytes},{},{},{select_ms:.2},{draw_ms:.1}",
            named.name,
            view.tolerance_px,
            mesh[1],
            mesh[3],
            codes[2],
            codes[3],
            drawn.patches,
            drawn.triangles,
        )
        .unwrap();
        if !(p999 <= view.tolerance_px && t_999 < 1.0 / 16.0 && codes[2] <= 2.0) {
            failures.push(named.name);
        }
    }
    if let Some(folder) = std::env::var_os("AREOID_REPORT") {
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(std::path::Path::new(&folder).join("reference.csv"), table).unwrap();
    }
    assert!(failures.is_empty(), "{failures:?}");
}
