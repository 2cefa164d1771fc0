//! Planets behind a cache: what the real search wants of them, and the truth, which is all of them.
//!
//! Bounds and ranges of the pages are exact: the difference of two bilinear surfaces is extreme
//! on the common lattice of their knots, half a finest texel wide.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, OnceLock};

use areoid_cache::{
    Cache, DatasetInfo, Options, PageSource, ResidentPage, Selection, Session, View,
};
use areoid_formats::address::{Level, PageAddress, PageKey};
use areoid_formats::archive::{ArchiveError, PageEntry};
use areoid_formats::body::{Body, Ellipsoid};
use areoid_formats::geodesy::{Geographic, surface_normal};
use areoid_formats::grid::Outline;
use areoid_formats::page::{Kind, Page};
use areoid_formats::projection::{Crs, PolarScale, PolarStereographic, Pole, Projection};
use areoid_formats::units::{Degrees, Meters, Radians};

use super::{Planet, Random, Sample, dataset};
use crate::surface::Surface;

/// A planet, whole and behind a cache.
pub(crate) struct World {
    pub(crate) body: Ellipsoid,
    /// Every page.
    pub(crate) whole: Selection,
    /// Of every page.
    pub(crate) truth: Surface,
    session: Mutex<Session>,
}

impl World {
    fn new(body: Ellipsoid, mut planet: Planet) -> Self {
        prove(&mut planet);
        let whole = planet.selection(|_| true);
        let sources = (0..).zip(&planet.datasets).map(|(dataset, info)| {
            let pages = planet.pages.iter().filter(|page| page.dataset == dataset);
            let pages = pages.map(|page| (PageKey::from(page.entry.page), Arc::clone(page)));
            (info.clone(), Arc::new(Pages(pages.collect())) as Arc<dyn PageSource>)
        });
        let options = Options::with_budget(1 << 30);
        let cache = Cache::with_sources(Body::from_ellipsoid(body), sources, options).unwrap();
        assert!(cache.problems().is_empty());
        let mut session = cache.session();
        session.blends = true;
        let session = Mutex::new(session);
        Self { body, truth: Surface::new(&whole), whole, session }
    }

    /// What a view wants, with nothing missing.
    pub(crate) fn selection(&self, view: &View) -> Arc<Selection> {
        self.exaggerated(view, 1.0)
    }

    /// The same of terrain that is so many times as high.
    pub(crate) fn exaggerated(&self, view: &View, times: f64) -> Arc<Selection> {
        let mut session = self.session.lock().unwrap();
        session.exaggerate(times);
        let selection = session.settle(view);
        assert_eq!((selection.missing, selection.failed.len()), (0, 0));
        selection
    }
}

/// The pages of one dataset.
#[derive(Debug)]
struct Pages(HashMap<PageKey, Arc<ResidentPage>>);

impl PageSource for Pages {
    fn find_resident(&self, page: PageAddress) -> Option<Option<PageEntry>> {
        Some(self.0.get(&PageKey::from(page)).map(|page| page.entry))
    }

    fn find(&self, page: PageAddress) -> Result<Option<PageEntry>, ArchiveError> {
        Ok(self.0.get(&PageKey::from(page)).map(|page| page.entry))
    }

    fn payload(&self, _: &PageEntry) -> Result<Vec<u8>, ArchiveError> {
        Ok(vec![0])
    }

    fn decode(&self, entry: &PageEntry, _: &[u8]) -> Result<Page, ArchiveError> {
        Ok(self.0[&PageKey::from(entry.page)].page.clone())
    }
}

/// What is known of the terrain under a page.
#[derive(Clone, Copy)]
struct Proof {
    bound: f64,
    low: f64,
    high: f64,
}

fn prove(planet: &mut Planet) {
    for (dataset, info) in planet.datasets.iter().enumerate() {
        let proofs = proofs(info, planet.pages.iter().filter(|page| page.dataset == dataset));
        for page in planet.pages.iter_mut().filter(|page| page.dataset == dataset) {
            let page = Arc::get_mut(page).expect("no selection was made yet");
            let Proof { bound, low, high } = proofs[&PageKey::from(page.entry.page)];
            page.entry.bound = (bound * (1.0 + 1e-6)) as f32;
            (page.entry.min, page.entry.lowest) = (low.next_down() as f32, low.next_down() as f32);
            (page.entry.max, page.entry.highest) = (high.next_up() as f32, high.next_up() as f32);
        }
    }
}

fn proofs<'a>(
    info: &DatasetInfo,
    pages: impl Iterator<Item = &'a Arc<ResidentPage>>,
) -> HashMap<PageKey, Proof> {
    let pyramid = info.grid.pyramid();
    let interior = f64::from(pyramid.interior());
    let pages: HashMap<PageKey, &ResidentPage> =
        pages.map(|page| (PageKey::from(page.entry.page), page.as_ref())).collect();
    let nothing = Proof { bound: 0.0, low: f64::INFINITY, high: f64::NEG_INFINITY };
    let mut proofs: HashMap<PageKey, Proof> = pages.keys().map(|&key| (key, nothing)).collect();
    let finest = pyramid.finest();
    for leaf in pages.values().filter(|page| page.entry.page.level == finest) {
        let address = leaf.entry.page;
        let ancestors = (0..=finest.0).map(|up| {
            let level = Level(finest.0 - up);
            PageAddress::new(level, address.row >> up, address.col >> up)
        });
        let ancestors: Vec<_> = ancestors
            .map(|page| (page, PageKey::from(page)))
            .filter(|(_, key)| pages.contains_key(key))
            .collect();
        let (rows, cols) = pyramid.interior_size(address);
        let mut found = vec![nothing; ancestors.len()];
        for (row, col) in (0..=2 * rows).flat_map(|row| (0..=2 * cols).map(move |col| (row, col))) {
            let (y, x) = (f64::from(row) / 2.0, f64::from(col) / 2.0);
            let Some(fine) = leaf.page.reconstruct(x + 1.0, y + 1.0) else { continue };
            for (proof, (page, key)) in found.iter_mut().zip(&ancestors) {
                let scale = 0.5_f64.powi(i32::from(finest.0 - page.level.0));
                let within = |leaf: u32, at: f64, page: u32| {
                    (f64::from(leaf) * interior + at) * scale - f64::from(page) * interior + 1.0
                };
                let (x, y) = (within(address.col, x, page.col), within(address.row, y, page.row));
                let coarse = pages[key].page.reconstruct(x, y);
                let whole = |weight: f64| weight > 1.0 - 1e-9;
                for channel in 0..if info.kind == Kind::Height { 1 } else { 3 } {
                    let value = fine.value[channel];
                    (proof.low, proof.high) = (proof.low.min(value), proof.high.max(value));
                    if let Some(coarse) = coarse
                        && whole(coarse.valid_weight)
                        && whole(fine.valid_weight)
                    {
                        proof.bound = proof.bound.max((coarse.value[channel] - value).abs());
                    }
                }
            }
        }
        let mut below = 0.0_f64;
        for (found, (_, key)) in found.iter().zip(&ancestors) {
            below = below.max(found.bound);
            let proof = proofs.get_mut(key).unwrap();
            proof.bound = proof.bound.max(below);
            (proof.low, proof.high) = (proof.low.min(found.low), proof.high.max(found.high));
        }
    }
    proofs
}

pub(crate) fn at(longitude: f64, latitude: f64) -> Geographic {
    Geographic::from_degrees(Degrees(longitude), Degrees(latitude))
}

pub(crate) fn mars() -> Ellipsoid {
    Ellipsoid::sphere(Meters(3_396_190.0)).unwrap()
}

/// Hills of all sizes down to a few texels of a globe, ±7 km.
pub(crate) fn hills(place: Geographic) -> f64 {
    let n = surface_normal(place);
    let waves = [(3.0, 2500.0), (11.0, 1500.0), (29.0, 900.0), (61.0, 500.0), (173.0, 250.0)];
    let ripples = [(331.0, 80.0)];
    let sum = waves.iter().chain(&ripples).map(|&(k, amplitude): &(f64, f64)| {
        amplitude * ((k * n.x + 0.3).sin() + (k * n.y + k).cos() + (k * n.z - 1.0).sin()) / 1.5
    });
    sum.sum()
}

fn sample(height: f64, coverage: f64) -> Sample {
    ([height as f32, 0.0, 0.0], (255.0 * coverage.clamp(0.0, 1.0)).ceil() as u8)
}

/// Slow colors: a pixel is within a code or so of its neighbors.
fn colors(place: Geographic) -> Sample {
    let n = surface_normal(place);
    let wave = |phase: f64| 128.0 + 40.0 * ((2.0 * n.x + phase).sin() * (3.0 * n.z - phase).cos());
    ([wave(0.0) as f32, wave(1.3) as f32, wave(2.9) as f32], 255)
}

pub(crate) fn polar(pole: Pole, body: Ellipsoid) -> Crs {
    let map = PolarStereographic {
        pole,
        central_meridian: Degrees(-45.0).into(),
        scale: PolarScale::TrueAt(Degrees(70.0).into()),
        false_easting: Meters(0.0),
        false_northing: Meters(0.0),
    };
    Crs::new(Projection::PolarStereographic(map), body)
}

/// A globe, a cap on each pole whose coverage fades toward 60°, and colors.
fn split(body: Ellipsoid) -> Planet {
    let mut planet = Planet::default();
    let degrees = Crs::new(Projection::Geographic, body);
    let globe = |pixel: f64| Outline {
        origin: [-180.0, 90.0],
        pixel_size: [pixel; 2],
        width: (360.0 / pixel) as u32,
        height: (180.0 / pixel) as u32,
    };
    let height = |place| sample(hills(place), 1.0);
    planet.add(dataset("globe", Kind::Height, degrees, globe(0.25), 66, 0), height);
    for pole in [Pole::North, Pole::South] {
        let half = 0.95 * body.a().0;
        let pixel_size = [2.0 * half / 512.0; 2];
        let outline = Outline { origin: [-half, half], pixel_size, width: 512, height: 512 };
        let info = dataset("cap", Kind::Height, polar(pole, body), outline, 66, 0);
        planet.add(info, move |place| {
            let from_rim = pole.sign() * place.latitude.0 - Radians::from(Degrees(60.0)).0;
            sample(hills(place) + 300.0, from_rim / 0.1)
        });
    }
    planet.add(dataset("colors", Kind::Color, degrees, globe(0.5), 66, 0), colors);
    planet
}

/// Mars as a sphere.
pub(crate) fn split_mars() -> &'static World {
    static WORLD: OnceLock<World> = OnceLock::new();
    WORLD.get_or_init(|| World::new(mars(), split(mars())))
}

/// Where the mountain of [`earth`] stands, in degrees.
pub(crate) const PEAK: [f64; 2] = [22.56, 3.0];
/// The middle of the dataset of 0.25 m of [`earth`].
pub(crate) const INSET: [f64; 2] = [7.5, 46.25];
/// Its half width, in meters.
pub(crate) const INSET_HALF_M: f64 = 96.0;

/// The Earth as an ellipsoid, with a mountain of 10 km on a map of its own that fades out and has a
/// hole, and a field of 192 m with texels of 0.25 m.
pub(crate) fn earth() -> &'static World {
    static WORLD: OnceLock<World> = OnceLock::new();
    WORLD.get_or_init(|| {
        let body = Ellipsoid::WGS84;
        let mut planet = split(body);
        let degrees = Crs::new(Projection::Geographic, body);
        let outline =
            Outline { origin: [20.0, 5.56], pixel_size: [0.02; 2], width: 256, height: 256 };
        let info = dataset("mountain", Kind::Height, degrees, outline, 66, 1);
        let [peak_x, peak_y] = PEAK;
        planet.add(info, move |place| {
            let [x, y] = [place.longitude, place.latitude].map(|angle| Degrees::from(angle).0);
            let radius2 = (x - peak_x).powi(2) + (y - peak_y).powi(2);
            let rim = (x - 20.0).min(25.12 - x).min(y - 0.44).min(5.56 - y);
            let hole = ((x - 24.0).powi(2) + (y - 4.3).powi(2)).sqrt() - 0.2;
            let ripples = 120.0 * (9.0 * x).sin() * (11.0 * y).cos();
            let height = hills(place) + ripples + 10_000.0 * (-radius2 / 0.0625).exp();
            if hole < 0.0 { sample(0.0, 0.0) } else { sample(height, rim.min(hole) / 0.5) }
        });

        let [longitude, latitude] = INSET;
        let texel = 0.25 / 111_194.0;
        let narrow = texel / latitude.to_radians().cos();
        let texels = (2.0 * INSET_HALF_M / 0.25) as u32;
        let half = f64::from(texels / 2);
        let outline = Outline {
            origin: [longitude - half * narrow, latitude + half * texel],
            pixel_size: [narrow, texel],
            width: texels,
            height: texels,
        };
        // Above the globe's surface: where a page is out of sight, that one must not rise into it.
        let base = hills(at(longitude, latitude)) + 18.0;
        planet.add(dataset("field", Kind::Height, degrees, outline, 66, 2), move |place| {
            let [x, y] = [place.longitude, place.latitude].map(|angle| Degrees::from(angle).0);
            let (east, north) = ((x - longitude) / narrow * 0.25, (y - latitude) / texel * 0.25);
            let waves = 5.0 * (east / 31.0).sin() * (north / 27.0).cos()
                + 1.5 * (east / 5.3 + north / 9.0).sin()
                + 0.3 * (east / 1.1).sin() * (north / 0.9).sin();
            let crests = 2.0 * (north / 11.0 + (east / 13.0).sin()).sin().abs();
            let rim = INSET_HALF_M - east.abs().max(north.abs());
            sample(base + waves + crests, rim / 20.0)
        });
        World::new(body, planet)
    })
}

/// A smooth Mars of colors that differ from texel to texel as much as they can.
pub(crate) fn noisy() -> &'static World {
    static WORLD: OnceLock<World> = OnceLock::new();
    WORLD.get_or_init(|| {
        let mut planet = Planet::default();
        let degrees = Crs::new(Projection::Geographic, mars());
        let pixel_size = [0.25; 2];
        let outline = Outline { origin: [-180.0, 90.0], pixel_size, width: 1440, height: 720 };
        planet.add(dataset("noise", Kind::Color, degrees, outline, 66, 0), |place| {
            let [x, y] = [place.longitude, place.latitude].map(|angle| Degrees::from(angle).0);
            let [col, row] = [4.0 * (x + 180.0), 4.0 * (90.0 - y)].map(|at| at.floor() as u64);
            let mut random = Random((row << 32 | col).wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1);
            random.next();
            ([random.next(), random.next(), random.next()].map(|share| (255.0 * share) as f32), 255)
        });
        World::new(mars(), planet)
    })
}

/// The Earth with 64 m of terrain at 0.25 m a texel on the equator, about the north pole, and across the
/// antimeridian: datasets 0, 1 and 2. Dataset 3 is all of it, level.
pub(crate) fn fields() -> &'static World {
    static WORLD: OnceLock<World> = OnceLock::new();
    WORLD.get_or_init(|| {
        let body = Ellipsoid::WGS84;
        let mut planet = Planet::default();
        let degrees = Crs::new(Projection::Geographic, body);
        let texel = 0.25 / 111_194.0;
        let around = |longitude: f64, latitude: f64| Outline {
            origin: [longitude - 128.0 * texel, latitude + 128.0 * texel],
            pixel_size: [texel; 2],
            width: 256,
            height: 256,
        };
        let bumps = |place: Geographic| {
            let n = surface_normal(place) * (body.a().0 / 3.0);
            sample(20.0 + 0.4 * (n.x.sin() + n.y.cos() + (0.7 * n.z).sin()), 1.0)
        };
        let pole = Outline { origin: [-32.0, 32.0], pixel_size: [0.25; 2], ..around(0.0, 0.0) };
        let map = PolarStereographic {
            pole: Pole::North,
            central_meridian: Radians(0.0),
            scale: PolarScale::AtPole(1.0),
            false_easting: Meters(0.0),
            false_northing: Meters(0.0),
        };
        let polar = Crs::new(Projection::PolarStereographic(map), body);
        for (crs, outline) in
            [(degrees, around(33.3, 0.0)), (polar, pole), (degrees, around(180.0, 20.0))]
        {
            planet.add(dataset("field", Kind::Height, crs, outline, 66, 1), bumps);
        }
        let globe =
            Outline { origin: [-180.0, 90.0], pixel_size: [1.0; 2], width: 360, height: 180 };
        let flat = |_| sample(20.0, 1.0);
        planet.add(dataset("globe", Kind::Height, degrees, globe, 66, 0), flat);
        World::new(body, planet)
    })
}
