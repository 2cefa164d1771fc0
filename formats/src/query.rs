//! Heights at positions: the composition of the datasets of a catalog.

use std::collections::HashMap;
use std::sync::Arc;

use crate::address::{Level, PageAddress};
use crate::archive::{Archive, ArchiveError, PageEntry};
use crate::compose::{Layer, compose};
use crate::geodesy::Geographic;
use crate::page::{Kind, Page};

/// Pages of a dataset that a query keeps, 1.3 MiB each at most.
const KEPT_PAGES: usize = 128;

/// A height, how far it may be from the finest data, and whose it is.
#[derive(Clone, Debug, PartialEq)]
pub struct HeightAnswer {
    /// Meters above the reference surface.
    pub height_m: f64,
    /// Meters that the answer may be off the composition of the finest levels.
    pub bound_m: f64,
    /// Places of the datasets it came from in the list asked, largest share first.
    pub datasets: Vec<usize>,
}

/// Pages read so far; those that are not there as `None`.
type PagesRead = HashMap<PageAddress, Option<Arc<(PageEntry, Page)>>>;

/// Answers queries on the height datasets among some archives.
#[derive(Debug)]
pub struct HeightQuery<'a> {
    archives: Vec<&'a Archive>,
    level: Option<Level>,
    pages: Vec<PagesRead>,
}

impl<'a> HeightQuery<'a> {
    /// Asks `archives` at `level`, or at the finest level of each.
    ///
    /// A dataset with fewer levels answers at its finest.
    #[must_use]
    pub fn new(archives: impl IntoIterator<Item = &'a Archive>, level: Option<Level>) -> Self {
        let archives: Vec<_> = archives.into_iter().collect();
        let pages = vec![HashMap::new(); archives.len()];
        Self { archives, level, pages }
    }

    /// The composed height at a position, or `None` where no dataset has one.
    ///
    /// # Errors
    ///
    /// [`ArchiveError`] if a page cannot be read.
    pub fn height(&mut self, position: Geographic) -> Result<Option<HeightAnswer>, ArchiveError> {
        let mut layers = Vec::new();
        let mut places = Vec::new();
        for place in 0..self.archives.len() {
            if let Some(layer) = self.layer(place, position)? {
                layers.push(layer);
                places.push(place);
            }
        }
        let Some(composed) = compose(&layers) else { return Ok(None) };
        let mut shares: Vec<(usize, f64)> = places.into_iter().zip(composed.shares).collect();
        shares.retain(|&(_, share)| share > 0.0);
        shares.sort_by(|one, other| other.1.total_cmp(&one.1));
        Ok(Some(HeightAnswer {
            height_m: composed.value[0],
            bound_m: composed.bound,
            datasets: shares.into_iter().map(|(place, _)| place).collect(),
        }))
    }

    /// What one dataset says of a position.
    fn layer(&mut self, place: usize, position: Geographic) -> Result<Option<Layer>, ArchiveError> {
        let description = self.archives[place].description();
        if description.kind != Kind::Height {
            return Ok(None);
        }
        let grid = &description.grid;
        let finest = grid.pyramid().finest();
        let level = self.level.map_or(finest, |level| level.min(finest));
        let Some(point) = grid.locate(level, position) else { return Ok(None) };
        let window = grid.window_from_texel(level, point);
        let Some(page) = self.page(place, window.page)? else { return Ok(None) };
        let (entry, texels) = page.as_ref();
        Ok(texels.reconstruct(window.x, window.y).map(|found| Layer {
            priority: description.priority,
            quality: grid.quality(position),
            coverage: found.coverage,
            weight: 1.0,
            series: 0,
            value: found.value,
            bound: f64::from(entry.bound),
            // Fully covered taps have fully covered leaves below them, and those are the taps of
            // the finest level here.
            coverage_bound: if level == finest || found.coverage >= 1.0 { 0.0 } else { 1.0 },
        }))
    }

    fn page(
        &mut self,
        place: usize,
        page: PageAddress,
    ) -> Result<Option<Arc<(PageEntry, Page)>>, ArchiveError> {
        if let Some(held) = self.pages[place].get(&page) {
            return Ok(held.clone());
        }
        let archive = self.archives[place];
        let read = match archive.find(page)? {
            Some(entry) => Some(Arc::new((entry, archive.page(&entry)?))),
            None => None,
        };
        if self.pages[place].len() >= KEPT_PAGES {
            self.pages[place].clear();
        }
        self.pages[place].insert(page, read.clone());
        Ok(read)
    }
}
