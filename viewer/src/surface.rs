//! The composed surface on the CPU, in f64: what the shaders compute, from the same pages.
//!
//! A dataset of heights answers at a place with its finest page in memory, over coarser ones where a
//! view is known and their error would do; one of colors or normals with the blend of two neighboring
//! levels, each from the finest page that is not finer than it; the datasets are composed by
//! [`areoid_formats::compose`]. The renderer takes the heights of patch corners from here, and the
//! tests the whole picture.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use areoid_cache::{Datasets, ResidentPage, Selection, View};
use areoid_formats::address::{Level, PageAddress, PageKey};
use areoid_formats::compose::{Layer, compose};
use areoid_formats::geodesy::Geographic;
use areoid_formats::grid::TexelPoint;
use areoid_formats::page::{Kind, Reconstruction};
use areoid_formats::units::Meters;

use crate::blend::{Vantage, share_of_finer};
use crate::style::{Part, Plane, Ramp, Stop, Style, with_luminance_of};

/// sRGB codes where no dataset has colors.
pub const BARE_COLOR: [f64; 3] = [158.0, 140.0, 128.0];

/// The pages of a selection, found by place.
#[derive(Debug, Default)]
pub struct Surface {
    datasets: Datasets,
    pages: HashMap<(usize, PageKey), Arc<ResidentPage>>,
    /// What answers where no page does.
    roots: HashMap<(usize, PageKey), Arc<ResidentPage>>,
    /// The finest level of `pages`, by dataset.
    deepest: HashMap<usize, u8>,
    /// Datasets that take part and have a page at all.
    present: Vec<(usize, Part)>,
    ramp: Option<Ramp>,
    /// Of the ramps of all parts.
    stops: Vec<Stop>,
    /// Where it is seen from.
    vantage: Option<Vantage>,
}

/// A page's answer.
#[derive(Clone, Copy, Debug)]
struct Answer {
    found: Reconstruction,
    bound: f64,
    level: f64,
}

/// A composed value of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Meters in the first number, or color codes.
    pub value: [f64; 3],
    /// How far it may be from the composition of the finest levels.
    pub bound: f64,
    /// The level used in the dataset with the largest share.
    pub level: f64,
    /// The number of that dataset.
    pub dataset: usize,
    /// How far the user's weights let it cover what there is without it.
    pub opacity: f64,
}

impl Surface {
    /// The surface that a selection's pages make.
    #[must_use]
    pub fn new(selection: &Selection) -> Self {
        Self::styled(selection, &Style::default())
    }

    /// The surface that a selection's pages make in a style.
    #[must_use]
    pub fn styled(selection: &Selection, style: &Style) -> Self {
        let by_name = |pages: &[Arc<ResidentPage>]| -> HashMap<_, _> {
            let name = |page: &ResidentPage| (page.dataset, PageKey::from(page.entry.page));
            pages.iter().map(|page| (name(page), Arc::clone(page))).collect()
        };
        let mut pages = by_name(&selection.pages);
        pages.extend(by_name(&selection.beneath));
        let mut numbers: Vec<usize> = pages.keys().map(|&(dataset, _)| dataset).collect();
        numbers.sort_unstable();
        numbers.dedup();
        let known =
            numbers.iter().filter_map(|&number| Some((number, selection.datasets.get(number)?)));
        let present = known
            .flat_map(|(number, info)| {
                let parts = style.parts(&info.name, info.kind, info.priority);
                parts.map(move |part| (number, part))
            })
            .collect();
        let roots = by_name(&selection.roots);
        let mut deepest = HashMap::new();
        for page in &selection.pages {
            let level: &mut u8 = deepest.entry(page.dataset).or_default();
            *level = page.entry.page.level.0.max(*level);
        }
        let (datasets, ramp) = (selection.datasets.clone(), style.ramp.clone());
        let stops = style.stops().collect();
        Self { datasets, pages, roots, deepest, present, ramp, stops, vantage: None }
    }

    /// The surface that a view shows: within its tolerance, coarser pages show for finer ones.
    #[must_use]
    pub fn seen_from(self, view: &View, exaggeration: f64) -> Self {
        Self { vantage: Some(Vantage::new(view, exaggeration)), ..self }
    }

    /// The composition of all datasets of `kind`, seen at `footprint_m` ground meters to a sample:
    /// 0 asks for the finest there is. Datasets that are only taken for luminance do not count.
    #[must_use]
    pub fn compose(
        &self,
        kind: Kind,
        position: Geographic,
        footprint_m: f64,
    ) -> Option<SurfacePoint> {
        let plane = match kind {
            Kind::Height => Plane::Heights,
            Kind::Color => Plane::Colors,
            Kind::Normal => Plane::Normals,
        };
        self.compose_plane(plane, position, footprint_m, self.vantage.as_ref())
    }

    /// The composed height that a view shows.
    pub(crate) fn height_seen(
        &self,
        position: Geographic,
        vantage: &Vantage,
    ) -> Option<SurfacePoint> {
        self.compose_plane(Plane::Heights, position, 0.0, Some(vantage))
    }

    /// The sRGB codes of the ground, unlit: the colors over the ground's own, the ramp over them, and
    /// the luminances' share of both.
    #[must_use]
    pub fn color(&self, position: Geographic, footprint_m: f64) -> [f64; 3] {
        let over = |below: [f64; 3], above: [f64; 3], opacity: f64| -> [f64; 3] {
            std::array::from_fn(|i| below[i] + (above[i] - below[i]) * opacity)
        };
        let vantage = self.vantage.as_ref();
        let of_plane = |plane| self.compose_plane(plane, position, footprint_m, vantage);
        let mut color = BARE_COLOR;
        if let Some(found) = of_plane(Plane::Colors) {
            color = over(color, found.value, found.opacity);
        }
        if let (Some(ramp), Some(found)) = (&self.ramp, of_plane(Plane::Heights)) {
            color = over(color, ramp.color(found.value[0]), ramp.opacity);
        }
        if let Some(found) = of_plane(Plane::Luminances) {
            let of_one = |codes: [f64; 3]| codes.map(|code| code / 255.0);
            let both = with_luminance_of(of_one(color), of_one(found.value));
            color = over(color, both.map(|channel| 255.0 * channel), found.opacity);
        }
        color
    }

    fn compose_plane(
        &self,
        plane: Plane,
        position: Geographic,
        footprint_m: f64,
        vantage: Option<&Vantage>,
    ) -> Option<SurfacePoint> {
        let mut layers = Vec::with_capacity(self.present.len());
        let mut levels = Vec::with_capacity(self.present.len());
        for &(dataset, part) in self.present.iter().filter(|(_, part)| part.plane == plane) {
            let info = &self.datasets[dataset];
            let answer = match vantage {
                Some(vantage) if part.is_of_heights() => {
                    self.heights(dataset, position, vantage, &mut Vec::new())
                }
                _ => {
                    let wanted = self.wanted(dataset, part, position, footprint_m);
                    self.blend(dataset, position, wanted)
                }
            };
            let Some(Answer { mut found, mut bound, level }) = answer else { continue };
            if plane == Plane::Colors && part.is_of_heights() {
                let [first, count] = part.stops.map(|place| place as usize);
                let stops = &self.stops[first..first + count];
                found.value = Ramp::color_of(stops, found.value[0]);
                bound *= Ramp::steepness(stops);
            }
            let quality = info.grid.quality(position);
            let (coverage, value) = (found.coverage, found.value);
            let (priority, weight, series) = (part.priority, part.weight, part.series);
            let coverage_bound = 0.0;
            layers.push(Layer {
                priority,
                quality,
                coverage,
                weight,
                series,
                value,
                bound,
                coverage_bound,
            });
            levels.push((level, dataset));
        }
        let composed = compose(&layers)?;
        let shares = composed.shares.iter().zip(&levels);
        let (_, &(level, dataset)) = shares.max_by(|(a, _), (b, _)| a.total_cmp(b))?;
        let (value, bound, opacity) = (composed.value, composed.bound, composed.opacity);
        Some(SurfacePoint { value, bound, level, dataset, opacity })
    }

    /// The level that a dataset is asked for at a footprint, fractional.
    fn wanted(&self, dataset: usize, part: Part, position: Geographic, footprint_m: f64) -> f64 {
        let grid = &self.datasets[dataset].grid;
        let finest = f64::from(grid.pyramid().finest().0);
        if part.is_of_heights() {
            return finest;
        }
        let (largest, _) = grid.crs().principal_scales(position, grid.pixel_size());
        let tolerance_px = self.vantage.map_or(1.0, |vantage| vantage.tolerance_px.max(1.0));
        let footprint_m = footprint_m * tolerance_px;
        (finest - (footprint_m / largest).log2().max(0.0)).max(0.0)
    }

    /// Adds the pages from which the values of a place are made, as a view shows them.
    pub(crate) fn read_at(
        &self,
        position: Geographic,
        footprint_m: f64,
        vantage: &Vantage,
        read: &mut HashSet<(usize, PageAddress)>,
    ) {
        let mut pages = Vec::new();
        for plane in Plane::ALL {
            let mut parts: Vec<_> =
                self.present.iter().filter(|(_, part)| part.plane == plane).collect();
            parts.sort_by_key(|(_, part)| std::cmp::Reverse(part.priority));
            let mut clear = 1.0;
            for same in parts.chunk_by(|(_, one), (_, other)| one.priority == other.priority) {
                if clear <= 0.0 {
                    break;
                }
                for &&(dataset, part) in same {
                    let grid = &self.datasets[dataset].grid;
                    let Some(place) = grid.locate(grid.pyramid().finest(), position) else {
                        continue;
                    };
                    let answer = if part.is_of_heights() {
                        self.heights(dataset, position, vantage, &mut pages)
                    } else {
                        let wanted = self.wanted(dataset, part, position, footprint_m);
                        let [coarse, fine] = [wanted.floor(), wanted.ceil()]
                            .map(|level| self.sample(dataset, place, level_of(level)));
                        pages.extend(coarse.iter().chain(&fine).map(|(_, page)| *page));
                        fine.map(|(answer, _)| answer)
                    };
                    read.extend(pages.drain(..).map(|page| (dataset, page.entry.page)));
                    let coverage = answer.map_or(0.0, |answer| answer.found.coverage * part.weight);
                    clear *= 1.0 - coverage.clamp(0.0, 1.0);
                }
            }
        }
    }

    /// What a view shows of a dataset of heights: `shader/compose.wgsl`, `read_heights`. The pages that it
    /// is made from are added to `made_from`.
    fn heights<'a>(
        &'a self,
        dataset: usize,
        position: Geographic,
        vantage: &Vantage,
        made_from: &mut Vec<&'a ResidentPage>,
    ) -> Option<Answer> {
        let grid = &self.datasets[dataset].grid;
        let place = grid.locate(grid.pyramid().finest(), position)?;
        let (mut answer, page) = self.find(dataset, place, grid.pyramid().finest())?;
        let first = made_from.len();
        made_from.push(page);
        let height = Meters(vantage.exaggeration * answer.found.value[0]);
        let point = grid.crs().body.cartesian_from_geographic(position, height);
        let tolerance_m = vantage.tolerance_m_at(point);
        let mut own = page.entry.page.level;
        while let Some(level) = own.0.checked_sub(1).map(Level) {
            let beneath = self.find(dataset, place, level);
            let Some((below, page)) = beneath.filter(|(_, page)| page.entry.page.level < own)
            else {
                break;
            };
            let share = share_of_finer(below.bound / tolerance_m, answer.bound / tolerance_m);
            if share >= 1.0 {
                break;
            }
            if share == 0.0 {
                made_from.truncate(first);
            }
            made_from.push(page);
            answer = over(below, answer, share);
            own = page.entry.page.level;
        }
        (answer.found.coverage > 0.0).then_some(answer)
    }

    /// The blend of the two levels about `wanted`.
    fn blend(&self, dataset: usize, position: Geographic, wanted: f64) -> Option<Answer> {
        let grid = &self.datasets[dataset].grid;
        let finest = grid.pyramid().finest();
        let place = grid.locate(finest, position)?;
        let upper = level_of(wanted.ceil());
        let fine = self.sample(dataset, place, upper);
        let toward_coarse = f64::from(upper.0) - wanted;
        if toward_coarse == 0.0 {
            return fine.map(|(answer, _)| answer);
        }
        let coarse = self.sample(dataset, place, Level(upper.0 - 1));
        let level_of = |answer: &Answer| wanted.min(answer.level);
        match (fine, coarse) {
            (Some((Answer { mut found, bound, .. }, page)), Some((other, _))) => {
                let mix = |a: f64, b: f64| a + (b - a) * toward_coarse;
                for (value, &other) in found.value.iter_mut().zip(&other.found.value) {
                    *value = mix(*value, other);
                }
                found.coverage = mix(found.coverage, other.found.coverage);
                found.valid_weight = mix(found.valid_weight, other.found.valid_weight);
                let level = wanted.min(f64::from(page.entry.page.level.0));
                Some(Answer { found, bound: mix(bound, other.bound), level })
            }
            (Some((answer, _)), None) | (None, Some((answer, _))) => {
                Some(Answer { level: level_of(&answer), ..answer })
            }
            (None, None) => None,
        }
    }

    /// [`Self::find`], where that page has a value.
    fn sample(
        &self,
        dataset: usize,
        place: TexelPoint,
        level: Level,
    ) -> Option<(Answer, &ResidentPage)> {
        self.find(dataset, place, level).filter(|(answer, _)| answer.found.coverage > 0.0)
    }

    /// The finest page in memory at most as fine as `level`, or else the coarsest that is finer, or else
    /// the root, read at a place of the finest level; of no coverage where it has no value.
    fn find(
        &self,
        dataset: usize,
        place: TexelPoint,
        level: Level,
    ) -> Option<(Answer, &ResidentPage)> {
        let grid = &self.datasets[dataset].grid;
        let window_at = |level| {
            let halvings = grid.pyramid().halvings(level);
            let scale = 0.5_f64.powi(i32::try_from(halvings).unwrap_or(i32::MAX));
            let point = TexelPoint { x: place.x * scale, y: place.y * scale };
            grid.window_from_texel(level, point)
        };
        let deepest = self.deepest.get(&dataset).copied().unwrap_or(0);
        let coarser = (0..=level.0.min(deepest)).rev();
        let found = coarser.chain(level.0 + 1..=deepest).map(Level).find_map(|level| {
            let window = window_at(level);
            Some((window, self.page(dataset, window.page)?))
        });
        let root = || {
            let window = window_at(Level(0));
            let page = self.roots.get(&(dataset, PageKey::from(window.page)))?;
            Some((window, page.as_ref()))
        };
        let (window, page) = found.or_else(root)?;
        let nothing = Reconstruction { value: [0.0; 3], coverage: 0.0, valid_weight: 0.0 };
        let found = page.page.reconstruct(window.x, window.y).unwrap_or(nothing);
        let (bound, level) = (page.entry.bound, page.entry.page.level.0);
        Some((Answer { found, bound: f64::from(bound), level: f64::from(level) }, page))
    }

    fn page(&self, dataset: usize, page: PageAddress) -> Option<&ResidentPage> {
        self.pages.get(&(dataset, PageKey::from(page))).map(Arc::as_ref)
    }

    /// Whether a dataset takes part in a plane.
    pub(crate) fn shows(&self, dataset: usize, plane: Plane) -> bool {
        let first = self.present.partition_point(|&(number, _)| number < dataset);
        let mut parts = self.present[first..].iter().take_while(|(number, _)| *number == dataset);
        parts.any(|(_, part)| part.plane == plane)
    }

    /// The pages, in no order.
    pub(crate) fn pages(&self) -> impl Iterator<Item = &Arc<ResidentPage>> {
        self.pages.values()
    }

    /// What the pages belong to.
    pub(crate) fn datasets(&self) -> &Datasets {
        &self.datasets
    }

    /// The least and greatest height of the finest texels, or of the reference surface.
    pub(crate) fn height_range_m(&self) -> (f64, f64) {
        let heights = self.pages.values().filter(|page| {
            self.shows(page.dataset, Plane::Heights) && page.entry.lowest.is_finite()
        });
        heights.fold((0.0, 0.0), |(low, high), page| {
            (low.min(f64::from(page.entry.lowest)), high.max(f64::from(page.entry.highest)))
        })
    }
}

/// The finer answer over the coarser one by its share; either counts as far as it covers the place.
fn over(coarser: Answer, finer: Answer, share: f64) -> Answer {
    let mix = |a: f64, b: f64| a + (b - a) * share;
    let (below, above) = (coarser.found, finer.found);
    let coverage = mix(below.coverage, above.coverage);
    let part = if coverage > 0.0 { share * above.coverage / coverage } else { share };
    let value = |i: usize| below.value[i] + (above.value[i] - below.value[i]) * part;
    let found = Reconstruction {
        value: std::array::from_fn(value),
        coverage,
        valid_weight: mix(below.valid_weight, above.valid_weight),
    };
    let (bound, level) = (mix(coarser.bound, finer.bound), mix(coarser.level, finer.level));
    Answer { found, bound, level }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a level of a grid, between 0 and 32"
)]
fn level_of(level: f64) -> Level {
    Level(level as u8)
}
