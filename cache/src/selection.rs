//! What a view gets: pages in memory, and how much is still to come.

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
#[derive(Clone, Debug, Default)]
pub struct Datasets {
    numbers: Arc<[usize]>,
    /// By number: these, and maybe others.
    listed: Arc<[(usize, Arc<DatasetInfo>)]>,
}

impl Datasets {
    /// Those of these that have one of some numbers, which ascend.
    pub(crate) fn some(&self, numbers: &[usize]) -> Self {
        Self { numbers: numbers.into(), listed: Arc::clone(&self.listed) }
    }

    /// The dataset of a number, if it is among these.
    #[must_use]
    pub fn get(&self, number: usize) -> Option<&DatasetInfo> {
        self.place(number).and_then(|_| self.listed(number))
    }

    /// Where the dataset of a number stands among these.
    #[must_use]
    pub fn place(&self, number: usize) -> Option<usize> {
        self.numbers.binary_search(&number).ok()
    }

    /// How many there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.numbers.len()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.numbers.is_empty()
    }

    /// All of them, with their numbers.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = (usize, &DatasetInfo)> + Clone {
        self.numbers.iter().filter_map(|&number| Some((number, self.listed(number)?)))
    }

    /// Whether both are the one list: a cheap test that nothing has changed.
    #[must_use]
    pub fn is(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.numbers, &other.numbers)
    }

    pub(crate) fn numbers(&self) -> &[usize] {
        &self.numbers
    }

    fn listed(&self, number: usize) -> Option<&DatasetInfo> {
        let place = self.listed.binary_search_by_key(&number, |(number, _)| *number).ok()?;
        Some(self.listed[place].1.as_ref())
    }
}

impl FromIterator<(usize, Arc<DatasetInfo>)> for Datasets {
    fn from_iter<I: IntoIterator<Item = (usize, Arc<DatasetInfo>)>>(datasets: I) -> Self {
        let mut listed: Vec<_> = datasets.into_iter().collect();
        listed.sort_by_key(|(number, _)| *number);
        listed.dedup_by_key(|(number, _)| *number);
        let numbers = listed.iter().map(|(number, _)| *number).collect();
        Self { numbers, listed: listed.into() }
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
