//! What the renderer is given: a view, and the pages in memory that serve it.

use std::sync::Arc;

use areoid_formats::address::PageAddress;
use areoid_formats::grid::Grid;
use areoid_formats::page::{Kind, Page};
use areoid_formats::units::Radians;
use glam::{DMat3, DVec3};

/// An eye and what it looks at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Body-fixed meters.
    pub eye: DVec3,
    /// Columns right, up and backward, in body-fixed axes.
    pub orientation: DMat3,
    /// Vertical field of view.
    pub vertical_fov: Radians,
    /// Width and height in pixels.
    pub viewport: [u32; 2],
    /// The error that may show, in pixels.
    pub tolerance_px: f64,
}

/// What a dataset is, without its pages.
#[derive(Clone, Debug, PartialEq)]
pub struct DatasetInfo {
    /// The name in the catalog.
    pub name: String,
    /// What its texels are.
    pub kind: Kind,
    /// Where they lie.
    pub grid: Grid,
    /// Higher covers lower.
    pub priority: i32,
}

/// A page in memory.
#[derive(Clone, Debug)]
pub struct ResidentPage {
    /// Index into the selection's datasets.
    pub dataset: usize,
    /// Where it lies.
    pub entry_page: PageAddress,
    /// How far it is from the finest level.
    pub bound: f32,
    /// The lowest of the finest texels under it.
    pub lowest: f32,
    /// The highest of them.
    pub highest: f32,
    /// The texels.
    pub page: Page,
}

/// The pages in memory that a view uses.
#[derive(Clone, Debug)]
pub struct Selection {
    /// Changes whenever the pages do.
    pub generation: u64,
    /// All datasets; a page names its own by index.
    pub datasets: Arc<[DatasetInfo]>,
    /// Every page in memory that the view uses, and the ancestors that stand in for missing ones.
    pub pages: Vec<Arc<ResidentPage>>,
    /// Pages wanted and not in memory.
    pub missing: usize,
}
