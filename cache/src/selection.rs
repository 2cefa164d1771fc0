//! What a view gets: pages in memory, and how much is still to come.

use std::fmt;
use std::ops::Index;
use std::sync::Arc;

use areoid_formats::address::PageAddress;
use areoid_formats::archive::PageEntry;
use areoid_formats::grid::Grid;
use areoid_formats::page::{Kind, Page};

/// What a viewer has to know of a dataset.
#[derive(Clone, Debug, PartialEq)]
pub struct DatasetInfo {
    /// The dataset's name.
    pub name: String,
    /// The group that it is a part of, which the user names as one.
    pub group: Option<String>,
    /// What its texels are.
    pub kind: Kind,
    /// Where its texels lie.
    pub grid: Grid,
    /// Higher covers lower in a composition.
    pub priority: i32,
}

impl DatasetInfo {
    /// What the user calls it: its group, if it is a part of one.
    #[must_use]
    pub fn called(&self) -> &str {
        self.group.as_ref().unwrap_or(&self.name)
    }

    /// Whether `name` means it: its own name, or that of its group.
    #[must_use]
    pub fn answers_to(&self, name: &str) -> bool {
        self.name == name || self.called() == name
    }
}

/// Some of a cache's datasets, in the order of their numbers. A dataset has its number for as long
/// as the cache lives, and no other ever has it.
#[derive(Clone, Default)]
pub struct Datasets {
    /// Their numbers, and where they stand in `listed`.
    some: Arc<[(usize, usize)]>,
    /// These, and maybe others: all selections from one state of a cache share its list.
    listed: Arc<[(usize, Arc<DatasetInfo>)]>,
}

impl Datasets {
    /// Those of these that stand at some places, by number and place, ascending.
    pub(crate) fn some(&self, some: &[(usize, usize)]) -> Self {
        debug_assert!(some.iter().all(|&(number, place)| self.listed[place].0 == number));
        Self { some: some.into(), listed: Arc::clone(&self.listed) }
    }

    /// Their numbers, ascending.
    pub(crate) fn numbers(&self) -> impl Iterator<Item = usize> {
        self.some.iter().map(|(number, _)| *number)
    }

    /// The dataset of a number, if it is among these.
    #[must_use]
    pub fn get(&self, number: usize) -> Option<&DatasetInfo> {
        self.place(number).map(|place| self.listed[self.some[place].1].1.as_ref())
    }

    /// Where the dataset of a number stands among these.
    #[must_use]
    pub fn place(&self, number: usize) -> Option<usize> {
        self.some.binary_search_by_key(&number, |(number, _)| *number).ok()
    }

    /// How many there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.some.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.some.is_empty()
    }

    /// All of them, with their numbers.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = (usize, &DatasetInfo)> + Clone {
        self.some.iter().map(|&(number, place)| (number, self.listed[place].1.as_ref()))
    }

    /// Whether both are the one list: a cheap test that nothing has changed.
    #[must_use]
    pub fn is(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.some, &other.some)
    }
}

impl fmt::Debug for Datasets {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_map().entries(self.iter()).finish()
    }
}

impl FromIterator<(usize, Arc<DatasetInfo>)> for Datasets {
    fn from_iter<I: IntoIterator<Item = (usize, Arc<DatasetInfo>)>>(datasets: I) -> Self {
        let mut listed: Vec<_> = datasets.into_iter().collect();
        listed.sort_by_key(|(number, _)| *number);
        listed.dedup_by_key(|(number, _)| *number);
        let some = listed.iter().enumerate().map(|(place, (number, _))| (*number, place)).collect();
        Self { some, listed: listed.into() }
    }
}

/// Numbered as they stand.
impl From<Vec<DatasetInfo>> for Datasets {
    fn from(infos: Vec<DatasetInfo>) -> Self {
        infos.into_iter().map(Arc::new).enumerate().collect()
    }
}

/// # Panics
///
/// If it is not among these.
impl Index<usize> for Datasets {
    type Output = DatasetInfo;

    fn index(&self, number: usize) -> &DatasetInfo {
        self.get(number).expect("a page's dataset stands beside it")
    }
}

/// A decoded page in memory.
///
/// While anybody but the cache holds its [`Arc`], the page is not evicted and counts against the
/// budget: let go of selections that are no longer drawn.
#[derive(Debug)]
pub struct ResidentPage {
    /// The number of its dataset.
    pub dataset: usize,
    /// What the index says of it.
    pub entry: PageEntry,
    /// Its texels.
    pub page: Page,
}

/// A page that the view wants and cannot have for now: it is tried again, later and later.
#[derive(Clone, Debug)]
pub struct FailedPage {
    /// The number of its dataset.
    pub dataset: usize,
    /// Which page.
    pub page: PageAddress,
    /// Why, in words.
    pub error: Arc<str>,
}

/// The answer to a view, or to several at once.
#[derive(Debug)]
pub struct Selection {
    /// Changes whenever `pages`, `roots`, `beneath` or `datasets` do, within a session.
    pub generation: u64,
    /// How often the cache's datasets had changed: which of its states is drawn.
    pub scene: u64,
    /// The datasets that something below belongs to.
    pub datasets: Datasets,
    /// Every page in memory that the view uses, coarse first: those it wants, and the ancestors
    /// that stand in for the missing ones.
    pub pages: Vec<Arc<ResidentPage>>,
    /// The coarsest pages of the datasets that `pages` belong to, where they are in memory and not
    /// among `pages`: for a viewer that has no room, or no time yet, for all of those.
    pub roots: Vec<Arc<ResidentPage>>,
    /// Coarser pages over which `pages` show bit by bit, for a viewer in which nothing pops; only if
    /// [`Session::blends`](crate::Session::blends) asks for them. None stands in for one that is
    /// missing: the next coarser one that is there shows beneath.
    pub beneath: Vec<Arc<ResidentPage>>,
    /// Pages that the view wants and that may still come.
    pub missing: usize,
    /// Pages that the view wants, or would have beneath others, and that cannot be read. Ancestors of
    /// the wanted ones stand in for them.
    pub failed: Vec<FailedPage>,
    /// The tolerance that `pages` will meet once none is missing: the view's, or more if the
    /// budget forces it. Of several views, the first one's; those of the others are by as much
    /// coarser.
    pub tolerance_px: f64,
    /// At most what a height of `pages` is off by, or how large a texel of theirs is that should be
    /// smaller, in pixels of the first view: stand-ins and what the budget forces included. Infinite
    /// where nothing stands in for a page that is missing.
    pub error_px: f64,
    /// Nodes of the tree over the datasets, and pages, that the search looked at.
    pub visited: usize,
    /// Pages that the search ended in: `pages` once none is missing.
    pub wanted: usize,
    /// Pages that the search found out of sight.
    pub culled: usize,
}

impl Selection {
    /// That of a session that has not been asked yet.
    pub(crate) fn none(scene: u64) -> Self {
        Self {
            generation: 0,
            scene,
            datasets: Datasets::default(),
            pages: Vec::new(),
            roots: Vec::new(),
            beneath: Vec::new(),
            missing: 0,
            failed: Vec::new(),
            tolerance_px: f64::INFINITY,
            error_px: f64::INFINITY,
            visited: 0,
            wanted: 0,
            culled: 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use areoid_formats::grid::Outline;
    use areoid_formats::projection::{Crs, Projection};

    use super::*;

    #[test]
    fn some_of_the_datasets_are_those_and_no_others() {
        let crs = Crs::new(
            Projection::Geographic,
            areoid_formats::body::Body::parse("mars").unwrap().ellipsoid,
        );
        let outline =
            Outline { origin: [-180.0, 90.0], pixel_size: [1.0; 2], width: 360, height: 180 };
        let grid = Grid::from_outline(crs, outline, 66).unwrap().grid;
        let info = |number: usize| {
            let name = number.to_string();
            (
                number,
                Arc::new(DatasetInfo {
                    name,
                    group: None,
                    kind: Kind::Height,
                    grid: grid.clone(),
                    priority: 0,
                }),
            )
        };
        let all: Datasets = [7, 2, 5, 11, 3].into_iter().map(info).collect();
        let numbers =
            |datasets: &Datasets| datasets.iter().map(|(number, _)| number).collect::<Vec<_>>();
        assert_eq!(numbers(&all), [2, 3, 5, 7, 11]);
        let some = all.some(&[(3, 1), (11, 4)]);
        assert_eq!((numbers(&some), some.len(), some.is_empty()), (vec![3, 11], 2, false));
        for number in 0..13 {
            let place = [3, 11].iter().position(|there| *there == number);
            assert_eq!(some.place(number), place);
            assert_eq!(
                some.get(number).map(|info| info.name.clone()),
                place.map(|_| number.to_string())
            );
        }
        assert_eq!(some[11].name, "11");
        assert!(
            some.is(&some.clone()) && !some.is(&all) && !some.is(&all.some(&[(3, 1), (11, 4)]))
        );
    }
}
