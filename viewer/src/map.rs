//! A dataset's map as the shaders see it: one dataset's constants, and anchors in its texels.
//!
//! The shaders know a map only by differences from an anchor (`shader/map.wgsl`); here stands the
//! large part, in f64: where the anchor lies in the finest level, and the factors that turn the
//! differences into texels.

use areoid_cache::DatasetInfo;
use areoid_formats::address::{Level, PageAddress};
use areoid_formats::body::Ellipsoid;
use areoid_formats::geodesy::{Geographic, LatitudeKind, surface_normal};
use areoid_formats::grid::{Grid, TexelPoint};
use areoid_formats::projection::{Crs, Pole, Projection};
use areoid_formats::pyramid::PoleContact;
use areoid_formats::units::Radians;
use glam::DVec3;

use crate::mirror;
use crate::style::{Part, Plane};

/// Anchors farther than this from the outline count as absent: a 32-bit texel must not overflow.
const MOST_TEXELS: f64 = 1e9;

/// How the differences of a map become texels.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Factors {
    /// Texels to a radian of longitude and of latitude.
    Equirectangular([f64; 2]),
    Polar {
        pole: Pole,
        central_meridian: f64,
        /// Texels to a unit of τ E(τ).
        radius: [f64; 2],
    },
}

/// Where a dataset's pages lie: within a chord's length of a direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Cap {
    pub(crate) center: DVec3,
    pub(crate) chord: f64,
}

impl Cap {
    /// The whole sphere.
    pub(crate) const ALL: Self = Self { center: DVec3::Z, chord: 2.0 };

    /// Where a page lies, by nine points of its interior.
    pub(crate) fn of_page(grid: &Grid, page: PageAddress) -> Self {
        const SLACK: f64 = 1.2;

        let interior = f64::from(grid.pyramid().interior());
        let (rows, cols) = grid.pyramid().interior_size(page);
        let points = [0.0, 0.5, 1.0].into_iter().flat_map(|down| {
            [0.0, 0.5, 1.0].map(|across| TexelPoint {
                x: f64::from(page.col) * interior + across * f64::from(cols),
                y: f64::from(page.row) * interior + down * f64::from(rows),
            })
        });
        let normals: Option<Vec<DVec3>> = points
            .map(|point| grid.geographic_from_texel(page.level, point).map(surface_normal))
            .collect();
        let Some(normals) = normals else { return Self::ALL };
        let center = normals[normals.len() / 2];
        let reach = normals.iter().map(|normal| normal.distance(center)).fold(0.0, f64::max);
        // Nine points say little about a page around half of the body.
        if reach > 1.0 { Self::ALL } else { Self { center, chord: SLACK * reach } }
    }

    /// Whether anything lies within `reach` of a direction.
    pub(crate) fn meets(&self, direction: DVec3, reach: f64) -> bool {
        self.center.distance(direction) <= self.chord + reach
    }
}

/// What the shaders have to know of a dataset's part of the page table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Windows {
    /// Where its windows start.
    pub(crate) first: i32,
    /// The finest level with a page.
    pub(crate) deepest: i32,
    /// Where the entries of all pages of the coarsest level are; below 0 for none.
    pub(crate) roots: i32,
}

/// The constants of one dataset's map.
#[derive(Clone, Debug)]
pub(crate) struct DatasetMap {
    info: DatasetInfo,
    /// The dataset's whole outline.
    cap: Cap,
    factors: Factors,
    /// (b / a)² where the map's latitudes are planetocentric, or 1.
    latitude_ratio: f64,
}

/// The maps of the datasets that take part, by plane, the highest priority first.
#[derive(Debug, Default)]
pub(crate) struct Maps {
    maps: Vec<DatasetMap>,
    /// Where each plane starts, and where the last ends.
    starts: [usize; 5],
}

impl Maps {
    /// Of datasets and their parts, sorted.
    pub(crate) fn new<'a>(parts: impl Iterator<Item = (&'a DatasetInfo, Part)>) -> Self {
        let mut made = Self::default();
        for (info, part) in parts {
            made.maps.push(DatasetMap::new(info));
            made.starts[part.plane as usize + 1] = made.maps.len();
        }
        for plane in 1..made.starts.len() {
            made.starts[plane] = made.starts[plane].max(made.starts[plane - 1]);
        }
        made
    }

    /// Those of a plane, with their places among all.
    pub(crate) fn of_plane(&self, plane: Plane) -> impl Iterator<Item = (u32, &DatasetMap)> {
        let (first, end) = (self.starts[plane as usize], self.starts[plane as usize + 1]);
        let count = |place: usize| u32::try_from(place).expect("fewer datasets than 2^32");
        (first..end).map(move |place| (count(place), &self.maps[place]))
    }

    /// All of them.
    pub(crate) fn iter(&self) -> impl Iterator<Item = &DatasetMap> {
        self.maps.iter()
    }
}

impl DatasetMap {
    pub(crate) fn new(info: &DatasetInfo) -> Self {
        let crs = info.grid.crs();
        let [pixel_x, pixel_y] = info.grid.pixel_size();
        let centric = crs.latitudes == LatitudeKind::Planetocentric && !crs.body.is_sphere();
        let latitude_ratio = if centric { (crs.body.b().0 / crs.body.a().0).powi(2) } else { 1.0 };
        let factors = match &crs.projection {
            Projection::PolarStereographic(map) => {
                let radius = radius_at_pole(crs, map.pole, map.central_meridian);
                Factors::Polar {
                    pole: map.pole,
                    central_meridian: map.central_meridian.0,
                    radius: [radius / pixel_x, radius / pixel_y],
                }
            }
            Projection::Geographic | Projection::Equirectangular(_) => {
                let turn = crs.wraps_with_period().expect("the map is cylindrical");
                let y = |pole| crs.y_of_pole(pole).expect("the map is cylindrical");
                let half_turn = y(Pole::North) - y(Pole::South);
                Factors::Equirectangular([
                    turn / std::f64::consts::TAU / pixel_x,
                    half_turn / std::f64::consts::PI / pixel_y,
                ])
            }
        };
        let cap = match info.grid.pyramid().pages(Level(0)) {
            Some((1, 1)) => Cap::of_page(&info.grid, PageAddress::new(Level(0), 0, 0)),
            _ => Cap::ALL,
        };
        Self { info: info.clone(), cap, factors, latitude_ratio }
    }

    /// The constants for the shaders. Datasets of the same priority are blended. Their number is told by a color.
    #[expect(clippy::cast_possible_truncation, reason = "sizes and ratios; no place on the planet")]
    pub(crate) fn mirrored(
        &self,
        windows: &Windows,
        part: &Part,
        number: usize,
    ) -> mirror::Dataset {
        let (crs, pyramid) = (self.info.grid.crs(), self.info.grid.pyramid());
        let extent = pyramid.extent();
        let body = &crs.body;
        let (polar, hemisphere, per_unit) = match self.factors {
            Factors::Equirectangular(texels) => (0, 0.0, texels),
            Factors::Polar { pole, radius, .. } => (1, pole.sign(), radius),
        };
        let meridian = body.a().0 * (1.0 - body.eccentricity_squared());
        let period = match self.factors {
            Factors::Equirectangular([texels, _]) => texels * std::f64::consts::TAU,
            Factors::Polar { .. } => 0.0,
        };
        let narrow = |size: u32| i32::try_from(size).unwrap_or(i32::MAX);
        mirror::Dataset {
            size: [narrow(extent.width), narrow(extent.height)],
            interior: narrow(pyramid.interior()),
            levels: i32::from(pyramid.finest().0) + 1,
            first_window: windows.first,
            priority: part.priority,
            polar,
            wraps: i32::from(extent.wraps),
            period: period as f32,
            latitude_ratio: self.latitude_ratio as f32,
            hemisphere: hemisphere as f32,
            eccentricity: crs.ellipsoid.eccentricity_squared().sqrt() as f32,
            ground: [(body.a().0 / per_unit[0]) as f32, (meridian / per_unit[1]) as f32],
            weight: part.weight as f32,
            series: part.series,
            roots: windows.roots,
            deepest: windows.deepest,
            poles: u32::from(extent.north != PoleContact::None)
                | u32::from(extent.south != PoleContact::None) << 1,
            number: number as u32,
            stops: part.stops,
        }
    }

    /// The anchor of a frame at a position, whose normal is `up`, for places within a chord of `reach` of
    /// it; `None` where the map does not reach them. `dataset` is its place among the shaders' datasets.
    #[expect(clippy::cast_possible_truncation, reason = "whole texels, and fractions of one")]
    pub(crate) fn anchor(
        &self,
        dataset: u32,
        position: Geographic,
        up: DVec3,
        reach: f64,
    ) -> Option<mirror::Anchor> {
        if !self.cap.meets(up, reach) {
            return None;
        }
        let grid = &self.info.grid;
        let point = grid.crs().project(position)?;
        let place = grid.texel_from_map(grid.pyramid().finest(), point);
        if !(place.x.abs() < MOST_TEXELS && place.y.abs() < MOST_TEXELS) {
            return None;
        }
        let (left, top) = (place.x.floor(), place.y.floor());
        let matrix = match self.factors {
            Factors::Equirectangular([x, y]) => [x, 0.0, 0.0, -y],
            Factors::Polar { pole, central_meridian, radius: [x, y] } => {
                // A frame on the axis has those of longitude 0, as its position does.
                let (sine, cosine) = (position.longitude.0 - central_meridian).sin_cos();
                let stretch = self.conformal_factor(pole, up.z);
                let sign = pole.sign();
                let (x, y) = (x * stretch, sign * y * stretch);
                [x * sine, x * cosine, y * cosine, -y * sine]
            }
        };
        Some(mirror::Anchor {
            texel: [left as i32, top as i32],
            fraction: [(place.x - left) as f32, (place.y - top) as f32],
            matrix: matrix.map(|factor| factor as f32),
            dataset,
            _pad: [0; 3],
        })
    }

    /// E(τ), 1 at the pole, at a normal of height `z` over the equator.
    fn conformal_factor(&self, pole: Pole, z: f64) -> f64 {
        let centric_z = self.latitude_ratio * z;
        let length = ((1.0 - z * z) + centric_z * centric_z).sqrt();
        conformal_factor(&self.info.grid.crs().ellipsoid, pole.sign() * centric_z / length)
    }
}

/// exp(e artanh(e s) - e artanh(e)), with s the sine of the latitude counted toward the pole.
fn conformal_factor(ellipsoid: &Ellipsoid, s: f64) -> f64 {
    let e = ellipsoid.eccentricity_squared().sqrt();
    (e * ((e * s).atanh() - e.atanh())).exp()
}

/// Map units from the pole to a unit of τ E(τ), measured halfway down to the equator.
fn radius_at_pole(crs: &Crs, pole: Pole, central_meridian: Radians) -> f64 {
    let place = |latitude: f64| {
        let position = Geographic { longitude: central_meridian, latitude: Radians(latitude) };
        crs.project(position).expect("half a hemisphere is inside the map")
    };
    let latitude = pole.sign() * std::f64::consts::FRAC_PI_4;
    let on_map = if crs.latitudes == LatitudeKind::Planetocentric {
        crs.body.planetocentric_from_planetographic(Radians(latitude))
    } else {
        Radians(latitude)
    };
    let (at_pole, below) = (place(pole.sign() * std::f64::consts::FRAC_PI_2), place(latitude));
    let distance = (below.x - at_pole.x).hypot(below.y - at_pole.y);
    let s = pole.sign() * on_map.0.sin();
    let tau = (0.5 * (std::f64::consts::FRAC_PI_2 - s.asin())).tan();
    distance / (tau * conformal_factor(&crs.ellipsoid, s))
}
