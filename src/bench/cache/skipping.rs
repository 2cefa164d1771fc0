//! Pages fetched over pages necessary: the session against brute force over every page, with the
//! true surface.
//!
//! A page is necessary if a point of the surface under it is in the picture and not behind the body
//! below all terrain, if its parent would show some such point of the parent with an error above the
//! tolerance, and if it would show all of its own within it, or is a leaf.

use std::collections::HashSet;
use std::sync::Arc;
use std::time::Duration;

use areoid_cache::{Cache, Options, View};
use areoid_formats::address::{Level, PageAddress};
use areoid_formats::grid::{Grid, Outline, Placement};
use areoid_formats::projection::{Crs, Projection};
use areoid_formats::pyramid::{Extent, PoleContact};
use areoid_preprocess::resample::target::{Split, split};
use serde_json::json;

use super::Setting;
use super::flights::flights;
use super::planet::{Planet, body};
use super::replay::WINDOW;
use crate::bench::report::{Chapter, Relation, Table, Target};
use crate::failure::Failure;

/// Texels along the side of a page, and around the planet.
const PAGE_SIDE: u32 = 66;
const WIDTH: u32 = 16_384;

const LIMIT: f64 = 1.25;

pub(super) fn measure(setting: Setting) -> Result<Chapter, Failure> {
    let planets = planets(setting)?;
    let pages: usize = planets.iter().map(|planet| planet.entries.len()).sum();
    let (mut rows, mut data, mut worst) = (Vec::new(), Vec::new(), 0.0_f64);
    // Frames of one flight overlap: a few of them, far apart, tell as much.
    for named in flights(setting.seconds)? {
        let cache = cache(&planets)?;
        let mut session = cache.session();
        session.look_ahead = false;
        let (mut necessary, mut frames, mut wanted) = (HashSet::new(), 0, [0, 0]);
        for view in WINDOW.views(&named.flight).step_by(6) {
            let selection = session.settle(&view);
            let here = brute_force(&planets, &view);
            wanted[0] += selection.wanted;
            wanted[1] += here.len();
            necessary.extend(here);
            frames += 1;
        }
        let fetched = cache.stats().loads;
        // Of a planet that is too small, nothing may be in sight.
        let ratio = fetched as f64 / necessary.len().max(1) as f64;
        worst = worst.max(ratio);
        rows.push(vec![
            named.name.to_owned(),
            frames.to_string(),
            fetched.to_string(),
            necessary.len().to_string(),
            format!("{ratio:.3}"),
            format!("{:.3}", wanted[0] as f64 / wanted[1].max(1) as f64),
        ]);
        data.push(json!({
            "flight": named.name, "fetched": fetched, "necessary": necessary.len(), "ratio": ratio,
            "wanted_over_necessary_in_a_frame": wanted[0] as f64 / wanted[1].max(1) as f64,
        }));
    }
    let head = vec!["flight", "frames", "fetched", "necessary", "ratio", "wanted in a frame"];
    Ok(Chapter {
        name: "skipping",
        title: "Pages fetched over pages necessary",
        notes: vec![
            "A split globe of waves (a band and two caps). Every frame is waited for until nothing is \
             missing, without looking ahead. Necessary is what brute force finds over every page \
             from points of the true surface (`src/bench/cache/skipping.rs`); fetched are roots and \
             pages that stand in, too."
                .to_owned(),
        ],
        tables: vec![Table { title: format!("Of {pages} pages"), head, rows }],
        targets: vec![Target::new(
            "pages fetched over necessary, worst flight",
            Relation::AtMost,
            LIMIT,
            Some(worst),
        )],
        data: json!({ "pages": pages, "flights": data }),
    })
}

/// A split globe.
pub(super) fn planets(setting: Setting) -> Result<Vec<Arc<Planet>>, Failure> {
    // The width must halve evenly.
    let halvings = (1.0 / setting.share.min(1.0)).log2().round() / 2.0;
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to 7")]
    let width = (WIDTH >> (halvings.round() as u32).min(6)).max(256);
    let failed = |error: &dyn std::error::Error| std::io::Error::other(error.to_string());
    let outline = Outline {
        origin: [-180.0, 90.0],
        pixel_size: [360.0 / f64::from(width); 2],
        width,
        height: width / 2,
    };
    let crs = Crs::new(Projection::Geographic, body().ellipsoid);
    let placement = Placement::from_outline(crs, outline).map_err(|error| failed(&error))?;
    let Split { rows, north, south } =
        split(&placement, PAGE_SIDE).map_err(|error| failed(&error))?;
    let extent = Extent {
        height: rows.end - rows.start,
        north: PoleContact::None,
        south: PoleContact::None,
        ..placement.extent()
    };
    let [left, top] = placement.origin;
    let origin = [left, top - f64::from(rows.start) * placement.pixel_size[1]];
    let band = Grid::new(crs, origin, placement.pixel_size, extent, PAGE_SIDE)
        .map_err(|error| failed(&error))?;
    let parts = [("globe.band", band), ("globe.north", north), ("globe.south", south)];
    Ok(parts.map(|(name, grid)| Planet::new(name, grid, Duration::ZERO)).into())
}

fn cache(planets: &[Arc<Planet>]) -> Result<Cache, Failure> {
    let sources = planets.iter().map(|planet| (planet.info.clone(), Arc::clone(planet) as _));
    Cache::with_sources(body(), sources, Options::with_budget(4 << 30))
        .map_err(|error| Failure::Failed(error.into()))
}

/// The necessary pages of a view, with the number of their planet.
fn brute_force(planets: &[Arc<Planet>], view: &View) -> HashSet<(usize, PageAddress)> {
    let lowest = planets.iter().flat_map(|planet| planet.entries.values());
    let lowest = lowest.map(|entry| f64::from(entry.lowest)).fold(0.0, f64::min);
    let radius = body().ellipsoid.b().0 + lowest;
    let up = (view.vertical_fov.0 / 2.0).tan();
    let right = up * f64::from(view.viewport[0]) / f64::from(view.viewport[1]);
    let scale = f64::from(view.viewport[1]) / (2.0 * up);
    let to_camera = view.orientation.transpose();
    // Pixels to a meter at a point, or 0 if it is not seen.
    let magnification = |point: &glam::DVec3| {
        let sight = *point - view.eye;
        let seen = to_camera * sight;
        let ahead = -seen.z;
        if ahead <= 0.0 || seen.x.abs() > right * ahead || seen.y.abs() > up * ahead {
            return 0.0;
        }
        let distance2 = sight.length_squared();
        let nearest = (-view.eye.dot(sight) / distance2).clamp(0.0, 1.0);
        if (view.eye + nearest * sight).length_squared() < radius * radius {
            return 0.0;
        }
        // 1 / (d cos² α), with cos α = ahead / d.
        scale * distance2.sqrt() / (ahead * ahead)
    };
    let mut necessary = HashSet::new();
    for (number, planet) in planets.iter().enumerate() {
        let pyramid = planet.info.grid.pyramid();
        let mut magnifications = std::collections::HashMap::new();
        for (&leaf, points) in &planet.leaves {
            let largest = points.iter().map(magnification).fold(0.0, f64::max);
            let mut next = Some(leaf).filter(|_| largest > 0.0);
            while let Some(page) = next {
                let known = magnifications.entry(page).or_insert(0.0_f64);
                *known = known.max(largest);
                next = page.parent();
            }
        }
        let is_fine = |page: &PageAddress| {
            let bound = f64::from(planet.entries[page].bound);
            bound * magnifications[page] <= view.tolerance_px
        };
        for page in magnifications.keys() {
            let mut above = std::iter::successors(page.parent(), |page| page.parent());
            let is_asked_for = page.level == Level(0) || above.all(|above| !is_fine(&above));
            if is_asked_for && (is_fine(page) || page.level == pyramid.finest()) {
                necessary.insert((number, *page));
            }
        }
    }
    necessary
}
