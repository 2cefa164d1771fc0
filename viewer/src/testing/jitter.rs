//! Nothing jitters: an eye that moves by hundredths of a pixel moves vertices by as much, and vertices
//! lie where their texels do.

use std::collections::HashMap;

use areoid_cache::View;
use areoid_formats::geodesy::surface_normal;
use areoid_formats::pyramid::Extent;
use areoid_formats::units::{Degrees, Meters, Radians};
use bytemuck::{Pod, Zeroable};
use glam::{DVec2, DVec3};

use super::caster::{ground_m, quantile};
use super::gpu;
use super::worlds::{World, at, fields};
use crate::camera::{Pose, pixel_angle};
use crate::mesh::detail::SEGMENTS;
use crate::shader::Program;
use crate::{Light, Options, Renderer};

const LIGHT: Light = Light { toward_sun: DVec3::X, ambient: 1.0 };
const VIEWPORT: [u32; 2] = [240, 160];

/// A vertex, and where the dataset whose number the questions name has it.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Vertex {
    clip: [f32; 4],
    /// Its own place, whatever it comes from.
    place: [f32; 4],
    texel: [i32; 2],
    fraction: [f32; 2],
    /// Whether it is inside the dataset.
    told: u32,
    pad: [u32; 3],
}

const PROBE: &str = "
struct Probed { clip: vec4f, place: vec4f, texel: vec2i, fraction: vec2f, told: u32, pad0: u32, pad1: u32, pad2: u32 }
@group(2) @binding(0) var<storage, read_write> answers: array<Probed>;
@compute @workgroup_size(64)
fn probe(@builtin(global_invocation_id) id: vec3u) {
    let side = SEGMENTS + 1;
    let patch_index = id.x / u32(side * side);
    if id.x >= arrayLength(&answers) { return; }
    let cell = i32(id.x % u32(side * side));
    let steps = vec2i(cell / side, cell % side);
    if steps.x + steps.y > SEGMENTS { return; }
    var answer: Probed;
    answer.clip = vertex_of(patch_index, steps).clip;
    let part = patches[patch_index];
    for (var i = frames[part.frame].lists[HEIGHTS]; i < frames[part.frame].lists[HEIGHTS + 1u]; i++) {
        let anchor = anchors[i];
        if anchor.dataset != DATASET { continue; }
        let place = place_in_patch(part, vec2f(steps) / f32(SEGMENTS));
        let frame = frames[part.frame];
        let point = map_point(dataset_list[DATASET], anchor, frame.north.z, frame.up.z, place.d);
        let above = scene.exaggeration * compose(place.frame, place.d, 0.0, HEIGHTS).value.x;
        answer.place = clip_from_eye(position_at(frame, place.d, above));
        answer.texel = point.texel;
        answer.fraction = point.fraction;
        answer.told = u32(point.inside);
    }
    answers[id.x] = answer;
}
";

/// The vertices of a patch, by what names it: its middle's normal and how its sides are made.
type Patches = HashMap<([u64; 3], u32), Vec<Vertex>>;

fn vertices(renderer: &Renderer, dataset: usize) -> Patches {
    let each = (SEGMENTS as usize + 1).pow(2);
    let mesh = renderer.mesh();
    let count = mesh.patches.len() * each;
    let source = Program::Mesh.source() + &PROBE.replace("DATASET", &format!("{dataset}u"));
    let workgroups = u32::try_from(count.div_ceil(64)).unwrap();
    let bytes = renderer.probe(&source, (size_of::<Vertex>() * count) as u64, workgroups);
    let vertices: &[Vertex] = bytemuck::cast_slice(&bytes);
    let named = mesh.patches.iter().map(|patch| {
        let middle = mesh.frames[patch.frame as usize].axes.z_axis;
        (middle.to_array().map(f64::to_bits), patch.sides)
    });
    named.zip(vertices.chunks(each).map(<[Vertex]>::to_vec)).collect()
}

/// A view's projection in f64.
struct Screen<'a>(&'a View);

impl Screen<'_> {
    /// Pixels to a tangent of 1.
    fn focal(&self) -> f64 {
        1.0 / pixel_angle(self.0)
    }

    /// Pixels from the picture's middle, if it is in the picture.
    fn pixel(&self, clip: [f32; 4]) -> Option<DVec2> {
        let [x, y, near, w] = clip.map(f64::from);
        let [width, height] = self.0.viewport.map(f64::from);
        let pixel = DVec2::new(x / w * width, y / w * height) / 2.0;
        (w > near && x.abs() < w && y.abs() < w).then_some(pixel)
    }

    /// A vertex's body-fixed place.
    fn place(&self, clip: [f32; 4]) -> Option<DVec3> {
        let pixel = self.pixel(clip)?;
        let ray = DVec3::new(pixel.x, pixel.y, -self.focal()) / self.focal();
        Some(self.0.eye + self.0.orientation * (ray * f64::from(clip[3])))
    }

    fn project(&self, place: DVec3) -> DVec2 {
        self.project_from_eye(place - self.0.eye)
    }

    fn project_from_eye(&self, offset: DVec3) -> DVec2 {
        let seen = self.0.orientation.transpose() * offset;
        DVec2::new(seen.x, seen.y) / -seen.z * self.focal()
    }

    /// Where a place would show if both it and the eye were planet coordinates in f32.
    fn project_coarsely(&self, place: DVec3) -> DVec2 {
        self.project_from_eye((place.as_vec3() - self.0.eye.as_vec3()).as_dvec3())
    }
}

/// Pixels between a vertex and where its texel is, unless the texels differ by a millionth of their
/// distance: nobody sees that between two.
fn off_texel_px(world: &World, dataset: usize, view: &View, vertex: &Vertex) -> Option<f64> {
    if vertex.told == 0 {
        return None;
    }
    let place = Screen(view).place(vertex.place)?;
    let grid = &world.whole.datasets.iter().nth(dataset)?.1.grid;
    let (there, _) = world.body.geographic_from_cartesian(place);
    let expected = grid.locate(grid.pyramid().finest(), there)?;
    let told = |i: usize| f64::from(vertex.texel[i]) + f64::from(vertex.fraction[i]);
    let Extent { wraps, width, .. } = grid.pyramid().extent();
    let (across, width) = (told(0) - expected.x, f64::from(width));
    let across = if wraps { across - width * (across / width).round() } else { across };
    // Columns crowd at the poles of a globe: they count by their width on the ground.
    let is_round = grid.crs().wraps_with_period().is_some();
    let crowd = if is_round { surface_normal(there).truncate().length() } else { 1.0 };
    let off = (across * crowd).hypot(told(1) - expected.y);
    let (texel_m, _) = grid.crs().principal_scales(there, grid.pixel_size());
    let off_px = off * texel_m / (place.distance(view.eye) * pixel_angle(view));
    Some(if off < 1e-6 { 0.0 } else { off_px })
}

/// `ARCHITECTURE.md`: under 0.05 px of jitter from 1 m to 10⁷ m above ground, at the equator, near a
/// pole, and on the antimeridian.
#[test]
fn nothing_jitters_from_a_meter_to_ten_million() {
    const STEPS: u32 = 3;
    const GLOBE: usize = 3;
    let world = fields();
    let mut renderer = Renderer::new(gpu(), world.body);
    for (dataset, name, [longitude, latitude]) in [
        (0, "equator", [33.300_01, 0.000_02]),
        (1, "89.9999°", [33.0, 89.9999]),
        (2, "antimeridian", [179.999_95, 20.000_03]),
    ] {
        for altitude in [1.0, 20.0, 3e3, 1e5, 1e7] {
            let place = at(longitude, latitude);
            let pitch = if altitude < 1e4 { -30.0 } else { -80.0 };
            let eye = Meters(ground_m(&world.truth, place) + altitude);
            let pitch = Degrees(pitch).into();
            let pose = Pose::from_eye(&world.body, place, eye, Radians(0.7), pitch);
            let first = pose.view(Degrees(40.0).into(), VIEWPORT, 1.0);
            let step = first.orientation * DVec3::new(0.8, 0.5, -0.33) * 0.01 * altitude;
            // From far above a field is nothing.
            let dataset = if altitude > 1e3 { GLOBE } else { dataset };
            let mut before: Patches = HashMap::new();
            let (mut moved_px, mut texel_px, mut coarse_px) = (Vec::new(), Vec::new(), 0.0_f64);
            for number in 0..=STEPS {
                let moved = step * (pixel_angle(&first) * f64::from(number));
                let view = View { eye: first.eye + moved, ..first };
                renderer.render(&view, &world.whole, &LIGHT, &Options::default());
                let now = vertices(&renderer, dataset);
                if number == 0 {
                    before = now;
                    continue;
                }
                for (patch, now) in &now {
                    let Some(before) = before.get(patch) else { continue };
                    for (now, before) in now.iter().zip(before) {
                        let (there, shown) =
                            (Screen(&first).place(before.clip), Screen(&view).pixel(now.clip));
                        if let (Some(there), Some(shown)) = (there, shown) {
                            let expected = Screen(&view).project(there);
                            moved_px.push(expected.distance(shown));
                            let coarse = Screen(&view).project_coarsely(there);
                            coarse_px = coarse_px.max(coarse.distance(expected));
                        }
                        texel_px.extend(off_texel_px(world, dataset, &view, now));
                    }
                }
            }
            let counts = (moved_px.len(), texel_px.len());
            let [moved, texel] = [&mut moved_px, &mut texel_px].map(|px| {
                px.push(0.0);
                (quantile(px, 0.99), quantile(px, 1.0))
            });
            println!(
                "{name}, {altitude} m: {counts:?} vertices, off by {moved:.4?} px of motion, \
                 {texel:.4?} px from their texels"
            );
            assert!(counts.0 > 2_000, "{name}, {altitude} m: {counts:?}");
            assert!(counts.1 > 100, "{name}, {altitude} m: {counts:?}");
            assert!(moved.1 < 0.05 && texel.1 < 0.05, "{name}, {altitude} m");
            // Planet coordinates in f32 would be seen.
            assert!(coarse_px > 0.05 || altitude > 1e3, "{name}, {altitude} m: {coarse_px}");
        }
    }
}
