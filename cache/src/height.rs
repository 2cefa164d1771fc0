//! Heights at positions, from the pages in memory.

use areoid_formats::address::{Level, PageAddress};
use areoid_formats::compose::{Layer, compose};
use areoid_formats::geodesy::Geographic;
use areoid_formats::page::Kind;

use crate::engine::Engine;
use crate::selection::{DatasetInfo, ResidentPage, Selection};
use crate::single::{PageError, load};

/// A height, and how far it may be from the composition of the finest data.
#[derive(Clone, Debug, PartialEq)]
pub struct Height {
    /// Meters above the reference surface.
    pub height_m: f64,
    /// Meters.
    pub bound_m: f64,
    /// Numbers of the datasets it came from, largest share first.
    pub datasets: Vec<usize>,
}

impl Selection {
    /// The height at a position as these pages have it: what a picture of them shows there, but for
    /// both bounds. `None` where they have none. It waits for nothing.
    #[must_use]
    pub fn height(&self, position: Geographic) -> Option<Height> {
        let heights = self.datasets.iter().filter(|(_, info)| info.kind == Kind::Height);
        let layers = heights.filter_map(|(number, info)| {
            let finest = info.grid.pyramid().finest();
            let levels = (0..=finest.0).rev().map(Level);
            let page =
                levels.filter_map(|level| self.page(number, info, level, position)).next()?;
            Some((number, layer(info, page, position)?))
        });
        composed(layers.collect())
    }

    /// The page of a level that a position falls on, if it is among these.
    fn page(
        &self,
        number: usize,
        info: &DatasetInfo,
        level: Level,
        position: Geographic,
    ) -> Option<&ResidentPage> {
        let wanted = (page_at(info, level, position)?, number);
        let place =
            self.pages.binary_search_by_key(&wanted, |page| (page.entry.page, page.dataset));
        place.ok().map(|place| self.pages[place].as_ref())
    }
}

/// The height of the finest data, loaded if need be.
///
/// # Cancel safety
///
/// Dropping the future withdraws its requests.
pub(crate) async fn exact(
    engine: &Engine,
    position: Geographic,
) -> Result<Option<Height>, PageError> {
    let scene = engine.shared().scene();
    let mut layers = Vec::new();
    for dataset in scene.datasets.iter().filter(|dataset| dataset.info.kind == Kind::Height) {
        let finest = dataset.info.grid.pyramid().finest();
        let Some(page) = page_at(&dataset.info, finest, position) else { continue };
        let Some(page) = load(engine, dataset.number, page).await? else { continue };
        let found = layer(&dataset.info, &page, position);
        layers.extend(found.map(|layer| (dataset.number, layer)));
    }
    Ok(composed(layers))
}

/// The page of a level that a position falls on; `None` off the grid.
fn page_at(info: &DatasetInfo, level: Level, position: Geographic) -> Option<PageAddress> {
    let point = info.grid.locate(level, position)?;
    Some(info.grid.window_from_texel(level, point).page)
}

/// What a page says of a position on it.
fn layer(info: &DatasetInfo, page: &ResidentPage, position: Geographic) -> Option<Layer> {
    let level = page.entry.page.level;
    let point = info.grid.locate(level, position)?;
    let window = info.grid.window_from_texel(level, point);
    let found = page.page.reconstruct(window.x, window.y)?;
    let is_finest = level == info.grid.pyramid().finest();
    Some(Layer {
        priority: info.priority,
        quality: info.grid.quality(position),
        coverage: found.coverage,
        weight: 1.0,
        series: 0,
        value: found.value,
        bound: f64::from(page.entry.bound),
        // Fully covered taps have fully covered leaves below them.
        coverage_bound: if is_finest || found.coverage >= 1.0 { 0.0 } else { 1.0 },
    })
}

fn composed(layers: Vec<(usize, Layer)>) -> Option<Height> {
    let (numbers, layers): (Vec<usize>, Vec<Layer>) = layers.into_iter().unzip();
    let composed = compose(&layers)?;
    let mut shares: Vec<(usize, f64)> = numbers.into_iter().zip(composed.shares).collect();
    shares.retain(|&(_, share)| share > 0.0);
    shares.sort_by(|one, other| other.1.total_cmp(&one.1));
    let datasets = shares.into_iter().map(|(number, _)| number).collect();
    Some(Height { height_m: composed.value[0], bound_m: composed.bound, datasets })
}
