//! Nothing opens between patches: neighbors meet to the bit, and no background shows through.

use std::collections::HashMap;
use std::sync::Arc;

use areoid_cache::{ResidentPage, Selection, View};
use areoid_formats::address::PageAddress;
use areoid_formats::units::{Degrees, Meters, Radians};
use glam::{DMat3, DVec3};

use super::caster::{Caster, middle};
use super::worlds::{World, at, earth, split_mars};
use super::{Random, gpu, rounds};
use crate::camera::Pose;
use crate::shader::Program;
use crate::{Light, Options, Renderer};

const LIGHT: Light = Light { toward_sun: DVec3::new(1.0, 0.5, 0.3), ambient: 0.5 };

/// What nothing but the background shows.
const IMPOSSIBLE: [u8; 3] = [255, 0, 255];

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
    let steps = crate::mesh::detail::SEGMENTS as usize;
    let world = earth();
    let mut renderer = Renderer::new(gpu(), world.body);
    let options = Options { vertical_exaggeration: 5.0, ..Options::default() };
    let mut halves_in_all = 0;
    for (longitude, latitude, altitude, pitch) in
        [(10.0, 20.0, 4e6, -50.0), (-180.0, 89.9, 6e4, -20.0), (36.0, 0.0, 9e4, -20.0)]
    {
        let pose = Pose::from_eye(
            &world.body,
            at(longitude, latitude),
            Meters(altitude),
            Radians(0.4),
            Degrees(pitch).into(),
        );
        let view = pose.view(Degrees(60.0).into(), [256; 2], 1.0);
        renderer.render(&view, &world.whole, &LIGHT, &options);
        let mesh = renderer.mesh();
        assert!(!mesh.patches.is_empty(), "{longitude} {latitude} {altitude}");
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

/// A view anywhere: any altitude, often at a pole, on the antimeridian, or over the finest dataset.
fn any_view(random: &mut Random, world: &World, viewport: [u32; 2]) -> View {
    let (longitude, latitude) = match (4.0 * random.next()) as u32 {
        0 => (360.0 * random.next() - 180.0, 90.0 - 10.0_f64.powf(4.0 * random.next() - 4.0)),
        1 => (180.0 - 10.0_f64.powf(5.0 * random.next() - 5.0), 120.0 * random.next() - 60.0),
        2 => (7.5 + 0.004 * (random.next() - 0.5), 46.25 + 0.003 * (random.next() - 0.5)),
        _ => (360.0 * random.next() - 180.0, 170.0 * random.next() - 85.0),
    };
    let south = if random.next() < 0.5 { -1.0 } else { 1.0 };
    let altitude = 10.0_f64.powf(0.3 + 6.7 * random.next());
    let place = at(longitude, south * latitude);
    let ground = super::caster::ground_m(&world.truth, place);
    let heading = Radians(std::f64::consts::TAU * random.next());
    let pitch = Degrees(-90.0 * random.next());
    let pose = Pose::from_eye(&world.body, place, Meters(ground + altitude), heading, pitch.into());
    pose.view(Degrees(20.0 + 60.0 * random.next()).into(), viewport, 1.0)
}

/// Pixels of the background that the planet shuts in: no way over such pixels leads from them to
/// where a ray misses the planet at its lowest.
fn shut_in(background: &[bool], open: &[bool], width: usize) -> usize {
    let mut reached = vec![false; background.len()];
    let mut next: Vec<usize> = (0..open.len()).filter(|&i| background[i] && open[i]).collect();
    for &i in &next {
        reached[i] = true;
    }
    while let Some(i) = next.pop() {
        let (row, col) = (i / width, i % width);
        let sides = [
            (row > 0).then(|| i - width),
            (i + width < background.len()).then(|| i + width),
            (col > 0).then(|| i - 1),
            (col + 1 < width).then(|| i + 1),
        ];
        for i in sides.into_iter().flatten().filter(|&i| background[i]) {
            if !reached[i] {
                reached[i] = true;
                next.push(i);
            }
        }
    }
    (0..background.len()).filter(|&i| background[i] && !reached[i]).count()
}

/// A selection of its own number, without some of the pages.
fn some_of(
    whole: &Selection,
    round: usize,
    keep: impl FnMut(&&Arc<ResidentPage>) -> bool,
) -> Selection {
    Selection {
        generation: 1 + round as u64,
        datasets: whole.datasets.clone(),
        pages: whole.pages.iter().filter(keep).cloned().collect(),
        roots: Vec::new(),
        beneath: Vec::new(),
        failed: Vec::new(),
        ..*whole
    }
}

/// Whether a ray meets an ellipsoid with these half axes.
fn meets(eye: DVec3, direction: DVec3, [a, b]: [f64; 2]) -> bool {
    let scale = DVec3::new(1.0, 1.0, a / b);
    let (eye, direction) = (eye * scale, (direction * scale).normalize());
    let along = -eye.dot(direction);
    along > 0.0 && eye.length_squared() - along * along < a * a
}

/// Whether what is drawn stands over the eye: straight up it sees the planet. Beside a wall, triangles slant
/// from its top to points at its foot that the eye is among, although the surface is below it at its own place.
fn stands_over(renderer: &mut Renderer, view: &View, selection: &Selection) -> bool {
    let up = view.eye.normalize();
    let right = up.any_orthonormal_vector();
    let orientation = DMat3::from_cols(right, right.cross(up), -up);
    let options = Options { background: IMPOSSIBLE, ..Options::default() };
    renderer.render(&View { orientation, ..*view }, selection, &LIGHT, &options);
    let rgba = renderer.read_color().rgba;
    let [width, height] = view.viewport.map(|side| side as usize);
    let middle = 4 * (height / 2 * width + width / 2);
    rgba[middle..middle + 3] != IMPOSSIBLE
}

#[test]
fn no_background_shows_through_the_planet() {
    const VIEWPORT: [u32; 2] = [160, 120];

    let rounds = rounds(60, 10_000);
    let worlds = [split_mars(), earth()];
    let mut renderers = worlds.map(|world| Renderer::new(gpu(), world.body));
    let options = Options { background: IMPOSSIBLE, ..Options::default() };
    let (mut patches, mut below, mut within) = (0, 0, 0);
    for round in rounds.clone() {
        // Each round is the same, whichever others are done.
        let mut random = Random((round as u64 + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
        let world = worlds[round % 2];
        let view = any_view(&mut random, world, VIEWPORT);
        // Pages that are still to come leave steps between levels, and holes.
        let keep = if round % 3 == 0 { 0.7 } else { 1.0 };
        let selection = some_of(&world.selection(&view), round, |_| random.next() < keep);
        let renderer = &mut renderers[round % 2];
        if keep < 1.0 && stands_over(renderer, &view, &selection) {
            // What stands in is above the eye: it looks at the planet from within.
            within += 1;
            continue;
        }
        patches += renderer.render(&view, &selection, &LIGHT, &options).patches;
        if (round + 1) % 500 == 0 {
            println!("{} views", round + 1);
        }
        let picture = renderer.read_color();
        let (low, high) = world.truth.height_range_m();
        let (body, surface) = (world.body, &world.truth);
        let caster = Caster { view: &view, body, surface, exaggeration: 1.0 };
        let [a, b] = [world.body.a().0, world.body.b().0];
        let shell = |height: f64| [a + height, b + height];
        let places = (0..VIEWPORT[1]).flat_map(|y| (0..VIEWPORT[0]).map(move |x| (x, y)));
        let (mut background, mut open) = (Vec::new(), Vec::new());
        for ((x, y), pixel) in places.zip(picture.rgba.chunks(4)) {
            let direction = caster.direction(middle(x, y));
            let is_sky = pixel[..3] == IMPOSSIBLE;
            let is_below = meets(view.eye, direction, shell(low - 100.0));
            below += usize::from(is_below);
            assert!(!(is_sky && is_below), "round {round}: {x} {y} of {view:?}");
            let at_edge = x == 0 || y == 0 || x + 1 == VIEWPORT[0] || y + 1 == VIEWPORT[1];
            background.push(is_sky);
            open.push(at_edge || !meets(view.eye, direction, shell(high + 100.0)));
        }
        let shut_in = shut_in(&background, &open, VIEWPORT[0] as usize);
        assert_eq!(shut_in, 0, "round {round}: {view:?}");
    }
    println!(
        "{rounds:?} views, {within} of them from within, {patches} patches, {below} pixels that must \
         show the planet"
    );
    assert!(within <= rounds.len() / 20);
    assert!(below > rounds.len() * 4_000);
}

/// About a pole some pages were still to come, and walls of 1600 m stood between those that were there.
/// From beside, their triangles are slivers: rounded to parts of a pixel, many turn over. While what shows
/// its back was left out, and the driver judged that both before it rounded and after, pixels stayed open.
#[test]
fn walls_of_slivers_are_closed() {
    const VIEWPORT: [u32; 2] = [320, 240];

    let world = split_mars();
    let (place, heading, pitch) = (at(75.0, -89.99875), Degrees(220.0), Degrees(-67.0));
    let pose = Pose::from_eye(&world.body, place, Meters(1914.0), heading.into(), pitch.into());
    let view = pose.view(Degrees(60.0).into(), VIEWPORT, 1.0);
    let selection = some_of(&world.selection(&view), 0, |page| {
        let PageAddress { row, col, .. } = page.entry.page;
        match page.dataset {
            0 => row != 11 || ![3, 4, 7, 9, 11, 13, 14, 17].contains(&col),
            2 => row != 4,
            _ => true,
        }
    });
    let options = Options { background: IMPOSSIBLE, ..Options::default() };
    let mut renderer = Renderer::new(gpu(), world.body);
    let drawn = renderer.render(&view, &selection, &LIGHT, &options);
    assert!(drawn.patches > 20_000, "no wall stands by the eye: {drawn:?}");
    let picture = renderer.read_color();
    let open = picture.rgba.chunks(4).filter(|pixel| pixel[..3] == IMPOSSIBLE).count();
    assert_eq!(open, 0);
}
