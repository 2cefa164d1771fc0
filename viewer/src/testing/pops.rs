//! Nothing pops: when patches split nothing moves, when pages come or go neither, and along a slow
//! flight pixels change as the motion explains.

use std::collections::BTreeSet;

use areoid_cache::{Selection, View};
use areoid_formats::units::{Degrees, Meters, Radians};
use glam::DVec3;

use super::caster::{ground_m, quantile};
use super::worlds::{INSET, World, at, earth, noisy, split_mars};
use super::{gpu, soak};
use crate::camera::{Pose, pixel_angle};
use crate::map::Maps;
use crate::mesh::detail::Detail;
use crate::mesh::patches::Mesh;
use crate::{Light, Options, Renderer};

const VIEWPORT: [u32; 2] = [240, 180];
const LIGHT: Light = Light { toward_sun: DVec3::new(1.0, 0.5, 0.3), ambient: 0.2 };
/// Codes by which a pixel may change for no reason.
const UNSEEN: u8 = 2;

/// A flight toward a place: the eye's way in degrees and meters above the ground there.
struct Dolly {
    name: &'static str,
    world: &'static World,
    from: [f64; 3],
    to: [f64; 3],
    look: [f64; 2],
}

fn dollies() -> [Dolly; 4] {
    let [x, y] = INSET;
    let (mars, earth) = (split_mars(), earth());
    let dolly = |name, world, from, to, look| Dolly { name, world, from, to, look };
    [
        dolly("descent", mars, [20.0, 10.0, 3e6], [21.0, 11.0, 3e5], [0.0, -70.0]),
        dolly("low flight", mars, [-50.0, 40.0, 3e4], [-49.0, 40.5, 2e4], [60.0, -20.0]),
        dolly("over the pole", earth, [0.0, 88.0, 2e5], [0.0, 89.9, 1e5], [0.0, -40.0]),
        dolly("down to a field", earth, [x, y - 0.001, 300.0], [x, y, 20.0], [10.0, -35.0]),
    ]
}

impl Dolly {
    /// The view at a share of the way.
    fn view(&self, share: f64) -> View {
        let mix = |i: usize| self.from[i] + (self.to[i] - self.from[i]) * share;
        let altitude = self.from[2] * (self.to[2] / self.from[2]).powf(share);
        let below = ground_m(&self.world.truth, at(self.to[0], self.to[1]));
        let [heading, pitch] = self.look.map(|angle| Radians::from(Degrees(angle)));
        let place = at(mix(0), mix(1));
        let eye = Meters(below + altitude);
        let pose = Pose::from_eye(&self.world.body, place, eye, heading, pitch);
        pose.view(Degrees(45.0).into(), VIEWPORT, 1.0)
    }
}

/// Which patches a view has: the normals of their middles, and how their sides are made.
fn patches(mesh: &mut Mesh, detail: &mut Detail, dolly: &Dolly, share: f64) -> Names {
    let world = dolly.world;
    mesh.build(&dolly.view(share), world.body, &world.truth, detail, &Maps::default(), u64::MAX);
    let named = mesh.patches.iter().map(|patch| {
        let middle = mesh.frames[patch.frame as usize].axes.z_axis;
        (middle.to_array().map(f64::to_bits), patch.sides)
    });
    named.collect()
}

type Names = BTreeSet<([u64; 3], u32)>;

/// What a picture shows.
struct Picture {
    rgba: Vec<u8>,
    depth_m: Vec<f64>,
}

fn draw(renderer: &mut Renderer, selection: &Selection, view: &View) -> Picture {
    renderer.render(view, selection, &LIGHT, &Options::default());
    Picture { rgba: renderer.read_color().rgba, depth_m: renderer.read_depth_m() }
}

/// What pictures on both sides of events differ by.
#[derive(Default)]
struct Changes {
    events: usize,
    changed: usize,
    pixels: usize,
    worst_share: f64,
    /// Of 99.9 % of the pixels of a picture.
    most_px: f64,
}

impl Changes {
    fn add(&mut self, view: &View, old: &Picture, new: &Picture) {
        let pairs = old.rgba.chunks(4).zip(new.rgba.chunks(4));
        let is_seen = |(old, new): &(&[u8], &[u8])| {
            old.iter().zip(*new).any(|(a, b)| a.abs_diff(*b) > UNSEEN)
        };
        let differ = pairs.filter(is_seen).count();
        let depths = old.depth_m.iter().zip(&new.depth_m);
        let mut off_px: Vec<f64> = depths
            .filter(|(a, b)| a.is_finite() && b.is_finite())
            .map(|(a, b)| (a - b).abs() / (a * pixel_angle(view)))
            .collect();
        self.events += 1;
        self.changed += differ;
        self.pixels += old.depth_m.len();
        self.worst_share = self.worst_share.max(differ as f64 / old.depth_m.len() as f64);
        self.most_px = self.most_px.max(quantile(&mut off_px, 0.999));
    }

    fn judge(&self, name: &str) {
        let Self { events, changed, pixels, worst_share, most_px } = self;
        println!(
            "{name}: {events} events, {changed} of {pixels} pixels change, at worst \
             {worst_share:.1e}; depth by {most_px:.4} px in 99.9 %"
        );
        assert!(*most_px < 0.05, "{name}: {most_px} px");
        assert!(*worst_share <= 1e-4, "{name}: {worst_share}");
    }
}

/// Shares of the way a millionth of a pixel apart between which a state changes, once for each of
/// `steps` parts of the way in which it does.
fn events<State: PartialEq>(steps: u32, mut state: impl FnMut(f64) -> State) -> Vec<[f64; 2]> {
    let mut events = Vec::new();
    let mut before = state(0.0);
    for step in 1..=steps {
        let end = f64::from(step) / f64::from(steps);
        let now = state(end);
        if now == before {
            continue;
        }
        let (mut low, mut high) = (end - 1.0 / f64::from(steps), end);
        for _ in 0..24 {
            let half = low.midpoint(high);
            if state(half) == before { low = half } else { high = half }
        }
        before = now;
        events.push([low, high]);
    }
    events
}

/// Both sides of every change of the mesh along a way: no color changes, and no surface moves.
#[test]
fn nothing_moves_when_patches_split() {
    let steps = if soak() { 200 } else { 6 };
    for dolly in dollies() {
        let world = dolly.world;
        let mut renderer = Renderer::new(gpu(), world.body);
        let (mut mesh, mut detail) = (Mesh::default(), Detail::default());
        detail.renew(&world.truth, 1.0);
        let mut changes = Changes::default();
        for shares in events(steps, |share| patches(&mut mesh, &mut detail, &dolly, share)) {
            let views = shares.map(|share| dolly.view(share));
            let [old, new] = views.map(|view| draw(&mut renderer, &world.whole, &view));
            changes.add(&views[0], &old, &new);
        }
        changes.judge(dolly.name);
        assert!(changes.events > 4, "{}", changes.events);
    }
}

/// The same where pages come and go as the search wants them, of colors as rough as can be, too.
#[test]
fn nothing_moves_when_pages_change() {
    let (from, to) = ([20.0, 10.0, 1.5e7], [40.0, 15.0, 2e6]);
    let noisy = Dolly { name: "noisy colors", world: noisy(), from, to, look: [0.0, -90.0] };
    let steps = if soak() { 400 } else { 24 };
    let mut events_of_all = 0;
    for dolly in dollies().into_iter().chain([noisy]) {
        let world = dolly.world;
        let mut renderer = Renderer::new(gpu(), world.body);
        let names = |share| -> Vec<_> {
            let selection = world.selection(&dolly.view(share));
            let pages = selection.pages.iter().chain(&selection.beneath);
            pages.map(|page| (page.dataset, page.entry.page)).collect()
        };
        let mut changes = Changes::default();
        for shares in events(steps, names) {
            let views = shares.map(|share| dolly.view(share));
            let [old, new] = views.map(|view| {
                let selection = world.selection(&view);
                draw(&mut renderer, &selection, &view)
            });
            changes.add(&views[0], &old, &new);
        }
        changes.judge(dolly.name);
        events_of_all += changes.events;
    }
    assert!(events_of_all > 24, "{events_of_all}");
}

/// Pixels of a picture outside the range of the other's pixels around them, by more than is seen,
/// unless something nearer may have stood before them.
fn unexplained(old: &Picture, new: &Picture) -> usize {
    let [width, height] = VIEWPORT.map(|pixels| pixels as usize);
    let inside = (1..height - 1).flat_map(|y| (1..width - 1).map(move |x| y * width + x));
    let differs = |&i: &usize| {
        let rows = [i - width, i, i + width];
        let around = rows.iter().flat_map(|&i| i - 1..=i + 1);
        let depths = around.clone().flat_map(|i| [old.depth_m[i], new.depth_m[i]]);
        let (least, most) = depths.fold((f64::INFINITY, 0.0_f64), |(a, b), d| (d.min(a), d.max(b)));
        if most > 1.03 * least {
            return false;
        }
        (0..3).any(|channel| {
            let codes = around.clone().map(|i| old.rgba[4 * i + channel]);
            let (least, most) = codes.fold((255, 0), |(a, b), code| (code.min(a), code.max(b)));
            let code = new.rgba[4 * i + channel];
            code < least.saturating_sub(UNSEEN) || code > most.saturating_add(UNSEEN)
        })
    };
    inside.filter(differs).count()
}

/// Frames a quarter of a pixel of motion apart: a pixel takes on what was within a pixel of it before.
#[test]
fn pixels_change_as_motion_explains() {
    let frames = if soak() { 400 } else { 8 };
    for dolly in dollies() {
        let mut renderer = Renderer::new(gpu(), dolly.world.body);
        let middle = dolly.view(0.5);
        let speed = dolly.view(0.501).eye.distance(middle.eye) / 0.001;
        let altitude = (dolly.from[2] * dolly.to[2]).sqrt();
        let step = 0.25 * pixel_angle(&middle) * altitude / speed;
        let mut old = draw(&mut renderer, &dolly.world.selection(&middle), &middle);
        let (mut off, mut worst) = (0, 0);
        for frame in 1..=frames {
            let view = dolly.view(0.5 + step * f64::from(frame));
            let new = draw(&mut renderer, &dolly.world.selection(&view), &view);
            let count = unexplained(&old, &new);
            (off, worst) = (off + count, worst.max(count));
            old = new;
        }
        let pixels = old.depth_m.len();
        println!("{}: {off} pixels of {frames} frames of {pixels}, at worst {worst}", dolly.name);
        assert!(off as f64 <= 1e-4 * pixels as f64 * f64::from(frames), "{}: {off}", dolly.name);
    }
}
