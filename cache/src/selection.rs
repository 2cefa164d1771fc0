//! What a view gets: pages in memory, and how much is still to come.

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
    /// What its texels are.
    pub kind: Kind,
    /// Where its texels lie.
    pub grid: Grid,
    /// Higher covers lower in a composition.
    pub priority: i32,
}

/// A decoded page in memory.
///
/// While anybody but the cache holds its [`Arc`], the page is not evicted and counts against the
/// budget: let go of selections that are no longer drawn.
#[derive(Debug)]
pub struct ResidentPage {
    /// Which of [`Selection::datasets`].
    pub dataset: usize,
    /// What the index says of it.
    pub entry: PageEntry,
    /// Its texels.
    pub page: Page,
}

/// A page that the view wants and cannot have.
#[derive(Clone, Debug)]
pub struct FailedPage {
    /// Which of [`Selection::datasets`].
    pub dataset: usize,
    /// Which page.
    pub page: PageAddress,
    /// Why, in words.
    pub error: Arc<str>,
}

/// The answer to a view.
#[derive(Debug)]
pub struct Selection {
    /// Changes whenever `pages` or `datasets` do, within a session.
    pub generation: u64,
    /// The datasets of the catalog. A dataset keeps its place for as long as the cache lives.
    pub datasets: Arc<[DatasetInfo]>,
    /// Every page in memory that the view uses, coarse first: those it wants, and the ancestors
    /// that stand in for the missing ones.
    pub pages: Vec<Arc<ResidentPage>>,
    /// Pages that the view wants and that may still come.
    pub missing: usize,
    /// Pages that the view wants and that cannot be read. Their ancestors stand in for them.
    pub failed: Vec<FailedPage>,
    /// The tolerance that `pages` will meet once none is missing: the view's, or more if the
    /// budget forces it.
    pub tolerance_px: f64,
    /// Pages that the search looked at.
    pub visited: usize,
    /// Pages that the search ended in: `pages` once none is missing.
    pub wanted: usize,
    /// Pages that the search found out of sight.
    pub culled: usize,
}
