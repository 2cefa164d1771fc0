//! How fine a view wants the triangles to be, and which of them it cannot see.
//!
//! A patch splits while its vertices stand farther apart on the screen than the view asks for and
//! than the texels that it samples are worth, or while its flat triangles leave the curved surface.
//! How much too coarse it is changes steadily with the eye: vertices come and go by it.
//!
//! # References
//!
//! * `ARCHITECTURE.md`: the horizon test, for an inscribed sphere below the lowest terrain.
//! * Virtual Globes §12.1: error in pixels by distance; frustum planes.

use areoid_cache::View;
use areoid_formats::address::PageAddress;
use areoid_formats::body::Ellipsoid;
use areoid_formats::geodesy::geographic_from_normal;
use areoid_formats::grid::Grid;
use areoid_formats::page::Kind;
use glam::DVec3;
use rustc_hash::FxHashMap;

use super::frame::{Ground, reference_point};
use super::sphere::{distance_to_triangle, nearer_cosine};
use super::tree::{Asked, Note, Verdict};
use crate::camera::pixel_angle;
use crate::map::Cap;
use crate::style::Plane;
use crate::surface::Surface;

/// Segments along the side of a patch.
pub(crate) const SEGMENTS: u32 = 16;

/// Pixels between vertices, to a pixel of tolerance, where the terrain has detail for them. Measured over
/// rough terrain, meshes are then off by 0.14 px in 99 % of pixels; at 6 by 0.27, at 12 by 0.6
/// (`testing/views.rs`).
const SPACING_PX: f64 = 4.0;
/// Factor on heights up to which that is enough: what a mesh is off by grows with it, and with the square
/// of the spacing.
const LOW: f64 = 4.0;
/// Pixels between vertices everywhere: flat patches stay small enough for f32 weights.
const WIDEST_SPACING_PX: f64 = 32.0;
/// Texels between vertices at most where they are large on the screen.
const SPACING_TEXELS: f64 = 1.0;
/// Pixels by which a flat triangle may leave the curved reference surface.
const SAGITTA_PX: f64 = 0.05;
/// Pixels between vertices, times the square of a patch's side: on a patch that bends far around the
/// body, places between vertices are off by a share of that, a tenth or so near the limb.
const BENT_PX: f64 = 0.5;
/// An eye is never taken as nearer to the ground than this.
const NEAREST_M: f64 = 0.25;
/// Triangles this deep are a tenth of a meter on the Earth.
const DEEPEST: u8 = 26;
/// The first triangles curve too much for tests by their corners.
const FIRST_FLAT: u8 = 3;
/// Places whose ground is kept from view to view.
const MOST_GROUNDS: usize = 1 << 18;

/// Where a page lies, and what it has.
#[derive(Clone, Copy, Debug)]
struct PagePlace {
    cap: Cap,
    /// Ground meters to a texel.
    texel_m: f64,
    /// Of a ball around its exaggerated terrain, in body-fixed meters.
    center: DVec3,
    radius_m: f64,
}

/// A corner of a tree.
#[derive(Clone, Copy, Debug)]
struct Corner {
    /// On the reference surface, in body-fixed meters.
    base: DVec3,
    /// Of the terrain above it, exaggerated; `None` before anybody asks.
    height_m: Option<f64>,
}

/// What the pages in memory say about detail; it outlives views.
#[derive(Debug, Default)]
pub(crate) struct Detail {
    /// Of height pages.
    places: Vec<PagePlace>,
    /// Exaggerated.
    range_m: (f64, f64),
    grounds: FxHashMap<[u64; 3], Ground>,
    /// By number, of one tree: the next begins with none.
    corners: Vec<Option<Corner>>,
    /// Numbers of places, those about one triangle after those about another: of one view.
    about: Vec<u32>,
    pub(crate) exaggeration: f64,
}

impl Detail {
    /// Forgets the old pages.
    pub(crate) fn renew(&mut self, surface: &Surface, exaggeration: f64) {
        let datasets = surface.datasets();
        self.places.clear();
        self.places.extend(
            surface.pages().filter(|page| surface.shows(page.dataset, Plane::Heights)).map(
                |page| {
                    let entry = &page.entry;
                    let heights =
                        [entry.lowest, entry.highest].map(|h| exaggeration * f64::from(h));
                    place_of(&datasets[page.dataset].grid, entry.page, heights)
                },
            ),
        );
        let (low, high) = surface.height_range_m();
        self.range_m = (low * exaggeration, high * exaggeration);
        self.grounds.clear();
        self.exaggeration = exaggeration;
    }

    /// The highest exaggerated terrain, or 0.
    pub(crate) fn highest_m(&self) -> f64 {
        self.range_m.1
    }

    /// The finest surface at a normal, its height rounded once for all users.
    #[expect(clippy::cast_possible_truncation, reason = "rounded on purpose")]
    pub(crate) fn ground(&mut self, surface: &Surface, normal: DVec3) -> Ground {
        if self.grounds.len() > MOST_GROUNDS {
            self.grounds.clear();
        }
        *self.grounds.entry(normal.to_array().map(f64::to_bits)).or_insert_with(|| {
            let position = geographic_from_normal(normal);
            let found = surface.compose(Kind::Height, position, 0.0);
            Ground { position, height_m: found.map_or(0.0, |found| found.value[0]) as f32 }
        })
    }

    fn corner(&mut self, ellipsoid: &Ellipsoid, number: u32, normal: DVec3) -> &mut Corner {
        let number = number as usize;
        if number >= self.corners.len() {
            self.corners.resize(number + 1, None);
        }
        let corner = || Corner { base: reference_point(ellipsoid, normal), height_m: None };
        self.corners[number].get_or_insert_with(corner)
    }

    /// The exaggerated height of the finest surface at a corner, and the point there.
    fn lift(
        &mut self,
        surface: &Surface,
        ellipsoid: &Ellipsoid,
        number: u32,
        normal: DVec3,
    ) -> (f64, DVec3) {
        let Corner { base, height_m } = *self.corner(ellipsoid, number, normal);
        let height_m = height_m.unwrap_or_else(|| {
            let ground = self.ground(surface, normal);
            let height_m = self.exaggeration * f64::from(ground.height_m);
            self.corner(ellipsoid, number, normal).height_m = Some(height_m);
            height_m
        });
        (height_m, base + height_m * normal)
    }

    /// Notes the pages that meet a triangle; what meets it meets its parent, of which `parent` tells.
    fn note(&mut self, parent: Option<Note>, center: DVec3, radius: f64) -> Note {
        let first = self.about.len();
        let meets = |place: &PagePlace| place.cap.meets(center, radius);
        match parent {
            None => {
                let places = (0..).zip(&self.places).filter(|(_, place)| meets(place));
                self.about.extend(places.map(|(number, _)| number));
            }
            Some(parent) => {
                for at in parent.first..parent.end {
                    let number = self.about[at as usize];
                    if meets(&self.places[number as usize]) {
                        self.about.push(number);
                    }
                }
            }
        }
        let count = |at: usize| u32::try_from(at).expect("fewer pages and triangles than 2^32");
        Note { first: count(first), end: count(self.about.len()) }
    }

    fn noted(&self, note: Note) -> impl Iterator<Item = &PagePlace> {
        let numbers = &self.about[note.first as usize..note.end as usize];
        numbers.iter().map(|&number| &self.places[number as usize])
    }

    /// Ground meters to the finest texel in memory about a triangle.
    fn finest_texel_m(&self, note: Note) -> f64 {
        self.noted(note).fold(f64::INFINITY, |finest, place| finest.min(place.texel_m))
    }

    /// Meters from the eye to the nearest page that a triangle is too large to know of by its
    /// corners.
    fn nearest_within_m(&self, note: Note, radius: f64, eye: DVec3) -> f64 {
        let small = self.noted(note).filter(|place| place.cap.chord < radius);
        small.map(|place| eye.distance(place.center) - place.radius_m).fold(f64::INFINITY, f64::min)
    }
}

fn place_of(grid: &Grid, page: PageAddress, [low_m, high_m]: [f64; 2]) -> PagePlace {
    let cap = Cap::of_page(grid, page);
    let middle = geographic_from_normal(cap.center);
    let (texel_m, _) = grid.crs().principal_scales(middle, grid.pixel_size_at(page.level));
    let body = grid.crs().body;
    let center = reference_point(&body, cap.center) + 0.5 * (low_m + high_m) * cap.center;
    let radius_m = cap.chord * (body.a().0 + high_m.max(0.0)) + 0.5 * (high_m - low_m);
    PagePlace { cap, texel_m, center, radius_m }
}

/// One view's wishes.
#[derive(Debug)]
pub(crate) struct Criterion {
    ellipsoid: Ellipsoid,
    eye: DVec3,
    /// Its direction from the body's center.
    toward_eye: DVec3,
    /// Inward normals through the eye.
    planes: [DVec3; 5],
    pixel_angle: f64,
    /// How many times as coarse as the view asks for everything may be.
    coarseness: f64,
    /// Vertices to one where heights are as they are.
    fineness: f64,
    spacing_px: f64,
    widest_px: f64,
    range_m: (f64, f64),
    /// Cosine-like limit of the horizon, in meters along the eye's direction; none inside.
    horizon_m: Option<f64>,
}

impl Criterion {
    /// Of a mesh whose vertices are `coarseness` times as far apart as the view asks for.
    pub(crate) fn new(
        view: &View,
        ellipsoid: Ellipsoid,
        detail: &mut Detail,
        coarseness: f64,
    ) -> Self {
        detail.about.clear();
        detail.corners.clear();
        let [right, up, backward] =
            [view.orientation.x_axis, view.orientation.y_axis, view.orientation.z_axis];
        let tangent_y = (view.vertical_fov.0 / 2.0).tan();
        let tangent_x = tangent_y * f64::from(view.viewport[0]) / f64::from(view.viewport[1]);
        let planes = [
            -backward,
            right - backward * tangent_x,
            -right - backward * tangent_x,
            up - backward * tangent_y,
            -up - backward * tangent_y,
        ];

        let (low, high) = detail.range_m;
        let inner = ellipsoid.b().0 + low;
        let outer = ellipsoid.a().0 + high;
        let distance = view.eye.length();
        let horizon_m = (distance > inner).then(|| {
            let ratio = inner / distance;
            inner * ratio - (1.0 - ratio * ratio).sqrt() * (outer * outer - inner * inner).sqrt()
        });
        let pixel_angle = pixel_angle(view);
        // A patch is never nearer than it is wide when it splits: of neighbors whose distances are
        // that much alike, none is two levels behind the other.
        let fineness = (detail.exaggeration / LOW).max(1.0).sqrt();
        let widest_px = WIDEST_SPACING_PX.min(1.0 / (f64::from(SEGMENTS) * pixel_angle));
        Self {
            ellipsoid,
            eye: view.eye,
            toward_eye: view.eye.normalize(),
            planes,
            pixel_angle,
            coarseness,
            fineness,
            spacing_px: (SPACING_PX / fineness * view.tolerance_px.max(0.1)).min(widest_px),
            widest_px,
            range_m: detail.range_m,
            horizon_m,
        }
    }

    /// What to do with a triangle, and what to remember for its parts.
    pub(crate) fn verdict(
        &self,
        detail: &mut Detail,
        surface: &Surface,
        Asked { corners, numbers, depth, parent }: Asked,
    ) -> (Verdict, Note) {
        let [a, b, c] = corners;
        let side = a.distance(b).max(b.distance(c)).max(c.distance(a));
        let center = ((a + b + c) / 3.0).normalize();
        let reach = center.distance(a).max(center.distance(b)).max(center.distance(c));
        // Where a triangle is out of sight, its parts are as well.
        if self.beyond_horizon(center, reach) {
            return (Verdict::Hidden, Note::default());
        }
        if depth >= FIRST_FLAT {
            let bases =
                [0, 1, 2].map(|i| detail.corner(&self.ellipsoid, numbers[i], corners[i]).base);
            if self.out_of_frustum(corners, bases, side) {
                return (Verdict::Hidden, Note::default());
            }
        }
        let note = detail.note(parent, center, reach);
        if depth >= DEEPEST {
            return (Verdict::Coarse(0.0), note);
        }

        let radius = self.ellipsoid.a().0;
        let lifted =
            [0, 1, 2].map(|i| detail.lift(surface, &self.ellipsoid, numbers[i], corners[i]));
        let heights = lifted.map(|(height_m, _)| height_m);
        let relief = heights.iter().fold(0.0_f64, |most, h| most.max((h - heights[0]).abs()));
        let bulge = radius * side * side / 6.0;
        let distance =
            distance_to_triangle(self.eye, lifted.map(|(_, point)| point)) - bulge - relief;
        let distance = distance.min(detail.nearest_within_m(note, reach, self.eye));
        let pixel_m = self.pixel_angle * distance.max(NEAREST_M);

        let spacing_m = radius * side / f64::from(SEGMENTS);
        let sagitta_m = spacing_m * spacing_m / (8.0 * radius);
        let spacing_px = spacing_m / pixel_m;
        let must = (spacing_px / self.widest_px)
            .max(sagitta_m / pixel_m / SAGITTA_PX)
            .max(spacing_px * side * side / BENT_PX);
        let may = spacing_px / self.spacing_px;
        if may <= must {
            return (Verdict::Coarse(must / self.coarseness), note);
        }
        let texels = spacing_m / detail.finest_texel_m(note);
        let wanted = must.max(may.min(self.fineness * texels / SPACING_TEXELS));
        (Verdict::Coarse(wanted / self.coarseness), note)
    }

    /// `ARCHITECTURE.md`: n·p below the limit for all points of the volume.
    fn beyond_horizon(&self, center: DVec3, reach: f64) -> bool {
        let Some(limit) = self.horizon_m else { return false };
        let outer = self.ellipsoid.a().0 + self.range_m.1;
        // A point's direction differs from its normal's by less than the first term.
        let reach = reach + 2.0 * self.ellipsoid.eccentricity_squared();
        let along = nearer_cosine(self.toward_eye.dot(center), reach);
        along * if along > 0.0 { outer } else { self.ellipsoid.b().0 + self.range_m.0 } < limit
    }

    fn out_of_frustum(&self, corners: [DVec3; 3], bases: [DVec3; 3], side: f64) -> bool {
        let (low, high) = self.range_m;
        // The top bulges above its corners.
        let bulge = (self.ellipsoid.a().0 + high) * side * side / 5.0;
        let volume = [0, 1, 2].map(|i| {
            let (base, normal) = (bases[i] - self.eye, corners[i]);
            [base + (low - 1.0) * normal, base + (high + bulge + 1.0) * normal]
        });
        let points = volume.as_flattened();
        self.planes.iter().any(|plane| points.iter().all(|point| plane.dot(*point) < 0.0))
    }
}
