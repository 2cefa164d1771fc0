//! What shows while pages come, and where there is no room for all of them.

use std::sync::Arc;

use areoid_cache::{Selection, View};
use areoid_formats::address::Level;
use areoid_formats::page::Kind;
use areoid_formats::units::{Degrees, Meters, Radians};
use glam::DVec3;

use super::gpu;
use super::worlds::{World, at, split_mars};
use crate::camera::Pose;
use crate::map::Maps;
use crate::mesh::detail::Detail;
use crate::mesh::patches::Mesh;
use crate::style::Part;
use crate::surface::Surface;
use crate::{FrameStatistics, Image, Light, Options, Renderer};

const LIGHT: Light = Light { toward_sun: DVec3::new(1.0, 0.5, 0.3), ambient: 0.1 };
const SIDE: u32 = 128;

fn view(tolerance_px: f64) -> View {
    let (pitch, fov) = (Degrees(-60.0).into(), Degrees(50.0).into());
    let pose = Pose::from_eye(&split_mars().body, at(60.0, 20.0), Meters(5e5), Radians(0.3), pitch);
    pose.view(fov, [SIDE; 2], tolerance_px)
}

/// What `world` has for the view at a tolerance, as of a session with generations of its own.
fn selected(world: &World, tolerance_px: f64, generation: u64) -> Selection {
    let selection = world.selection(&view(tolerance_px));
    Selection {
        generation,
        datasets: world.whole.datasets.clone(),
        pages: selection.pages.clone(),
        roots: selection.roots.clone(),
        // Nothing that has come or goes was there before.
        beneath: Vec::new(),
        failed: Vec::new(),
        ..*selection
    }
}

fn difference(one: &Image, other: &Image) -> f64 {
    let codes = one.rgba.iter().zip(&other.rgba);
    codes.map(|(a, b)| f64::from(a.abs_diff(*b))).sum()
}

/// Of what a search wants no page covers another: without what was there before, nothing could be
/// beneath a page that fades in.
#[test]
fn pages_give_way_to_others_bit_by_bit() {
    let world = split_mars();
    let (coarse, fine) = (selected(world, 6.0, 1), selected(world, 0.4, 2));
    for [from, to] in [[&coarse, &fine], [&fine, &coarse]] {
        let mut renderer = Renderer::new(gpu(), world.body);
        let mut draw = |selection: &Selection, seconds: f64| -> (Image, FrameStatistics) {
            let options = Options { seconds, fade_seconds: 1.0, ..Options::default() };
            // No coarser page's error is within that.
            let statistics = renderer.render(&view(0.01), selection, &LIGHT, &options);
            (renderer.read_color(), statistics)
        };
        draw(from, 0.0);
        let (before, _) = draw(from, 1.5);
        let (arrived, _) = draw(to, 2.0);
        let (halfway, _) = draw(to, 2.5);
        let (after, done) = draw(to, 3.5);
        assert_eq!(done.coming_pages, 0);
        let whole = difference(&before, &after);
        let shares = [arrived, halfway].map(|image| difference(&before, &image) / whole);
        println!("{whole} codes, of that {shares:.3?} at once and halfway");
        assert!(whole > 1_000.0, "{whole}");
        assert!(shares[0] < 0.1 && shares[1] > 0.3 && shares[1] < 0.8, "{shares:?}");
    }
}

/// With no time for uploads the roots show, and not bare ground.
#[test]
fn roots_stand_in_for_pages_that_are_put_off() {
    let world = split_mars();
    let mut selection = selected(world, 0.4, 1);
    selection.roots = world
        .whole
        .pages
        .iter()
        .filter(|page| page.entry.page.level == Level(0))
        .map(Arc::clone)
        .collect();
    selection.pages.retain(|page| page.entry.page.level > Level(0));
    let mut renderer = Renderer::new(gpu(), world.body);
    let options = Options { upload_limit_bytes: 0, ..Options::default() };
    let drawn = renderer.render(&view(1.0), &selection, &LIGHT, &options);
    assert!(drawn.pending_pages > 3 && drawn.left_out_pages == 0, "{drawn:?}");
    assert_eq!(drawn.uploaded_pages, selection.roots.len());
    let aovs = renderer.read_aovs();
    let surface = Surface::new(&Selection {
        pages: selection.roots.clone(),
        roots: Vec::new(),
        beneath: Vec::new(),
        datasets: selection.datasets.clone(),
        failed: Vec::new(),
        ..selection
    });
    let mut shown = 0;
    for (place, height_m) in aovs.geographic.iter().zip(&aovs.height_m) {
        if place[0].is_finite() {
            let expected = surface.compose(Kind::Height, at(place[0], place[1]), 0.0).unwrap();
            assert!(
                (f64::from(*height_m) - expected.value[0]).abs() < 0.5,
                "{height_m} {expected:?}"
            );
            shown += 1;
        }
    }
    assert!(shown > 10_000, "{shown}");
}

/// A frame without time for more writes one page, and goes on with the next; the picture is the one of
/// pages that came at once.
#[test]
fn a_frame_without_time_writes_a_page() {
    let world = split_mars();
    let selection = Selection { roots: Vec::new(), ..selected(world, 0.4, 1) };
    let count = selection.pages.len();
    let draw = |renderer: &mut Renderer, upload_limit_seconds: f64| {
        let options = Options { upload_limit_seconds, ..Options::default() };
        renderer.render(&view(1.0), &selection, &LIGHT, &options)
    };
    let mut renderer = Renderer::new(gpu(), world.body);
    assert_eq!(draw(&mut renderer, 0.0).pending_pages, count);
    for frame in 1..=count {
        let drawn = draw(&mut renderer, 1e-9);
        assert_eq!((drawn.uploaded_pages, drawn.pending_pages), (1, count - frame));
    }
    let mut at_once = Renderer::new(gpu(), world.body);
    assert_eq!(draw(&mut at_once, f64::INFINITY).uploaded_pages, count);
    assert!(renderer.read_color() == at_once.read_color());
}

/// A view has half of a cache at most, and all of that finds room.
#[test]
fn atlases_are_as_large_as_a_cache_asks() {
    let world = split_mars();
    let selection = selected(world, 0.4, 1);
    let pages = selection.pages.iter().chain(&selection.roots);
    let bytes: usize = pages.map(|page| page.page.bytes()).sum();
    let draw = |budget_bytes: usize| {
        let mut renderer = Renderer::with_budget(gpu(), world.body, budget_bytes as u64);
        renderer.render(&view(1.0), &selection, &LIGHT, &Options::default())
    };
    let (enough, little) = (draw(2 * bytes), draw(bytes / 8));
    assert_eq!((enough.left_out_pages, enough.pending_pages), (0, 0));
    assert!(little.left_out_pages > 0 && little.uploaded_bytes < bytes as u64 / 2, "{little:?}");
}

/// The maps of the heights of a selection.
fn maps_of(selection: &Selection) -> Maps {
    let heights = selection.datasets.iter().filter(|(_, info)| info.kind == Kind::Height);
    Maps::new(heights.map(|(_, info)| (info, Part::of(info.kind))))
}

/// A mesh is made of the view and the pages alone, whatever was made before it in the same room.
#[test]
fn a_mesh_remembers_no_other() {
    let world = split_mars();
    let selection = selected(world, 0.4, 1);
    let (surface, maps) = (Surface::new(&selection), maps_of(&selection));
    let elsewhere = |eye: DVec3| View { eye, ..view(0.5) };
    let build = |mesh: &mut Mesh, detail: &mut Detail, view: &View, most_bytes| {
        mesh.build(view, world.body, &surface, detail, &maps, most_bytes);
    };
    let (mut fresh, mut detail) = (Mesh::default(), Detail::default());
    detail.renew(&surface, 1.0);
    build(&mut fresh, &mut detail, &view(0.5), u64::MAX);

    let (mut used, mut detail) = (Mesh::default(), Detail::default());
    detail.renew(&surface, 7.0);
    build(&mut used, &mut detail, &view(0.5), u64::MAX);
    detail.renew(&surface, 1.0);
    build(&mut used, &mut detail, &elsewhere(1.01 * view(0.5).eye), 150_000);
    build(&mut used, &mut detail, &elsewhere(1.3 * view(0.5).eye), u64::MAX);
    build(&mut used, &mut detail, &view(0.5), u64::MAX);
    assert!(used.patches == fresh.patches && used.edges == fresh.edges);
    assert!(used.frames == fresh.frames && used.anchors == fresh.anchors);
}

/// Where lists would be too long for a device the mesh is coarser; whatever the limit, there are no more
/// anchors than it allows.
#[test]
fn a_mesh_keeps_within_what_a_device_binds() {
    let world = split_mars();
    let selection = selected(world, 0.4, 1);
    let surface = Surface::new(&selection);
    let mut detail = Detail::default();
    detail.renew(&surface, 1.0);
    let maps = maps_of(&selection);
    let mut mesh = Mesh::default();
    let counts = [u64::MAX, 150_000, 1_000].map(|most_bytes| {
        let view = View { viewport: [1600; 2], ..view(0.5) };
        mesh.build(&view, world.body, &surface, &mut detail, &maps, most_bytes);
        assert!(size_of_val(mesh.anchors.as_slice()) as u64 <= most_bytes);
        assert_eq!(mesh.mirrored_frames.len(), mesh.frames.len());
        mesh.patches.len()
    });
    assert!(counts[0] > counts[1] && counts[1] >= counts[2] && counts[2] > 0, "{counts:?}");
}
