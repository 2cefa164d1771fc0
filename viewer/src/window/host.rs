//! What a window asks for from outside: pages, datasets, insertions, files.

use std::path::Path;
use std::sync::Arc;

use areoid_cache::{Datasets, Selection, Stats, View};

use crate::style::Style;

/// Where a window's pages come from, and where rasters, pictures and flights go. All of it is called
/// on the thread that draws, and none of it may wait.
pub trait Host {
    /// From the next update on, nothing has to be loaded of what a style leaves out.
    fn follow(&mut self, style: &Style);

    /// From the next update on, heights are shown so many times as high.
    fn exaggerate(&mut self, times: f64);

    /// The pages in memory for views that are shown side by side.
    fn update(&mut self, views: &[View]) -> Arc<Selection>;

    /// All datasets of the catalog.
    fn datasets(&self) -> Datasets;

    /// What the cache has done.
    fn stats(&self) -> Stats;

    /// Begins to turn a raster into a dataset; what becomes of it is in [`Self::insertions`].
    fn insert(&mut self, raster: &Path);

    /// What was inserted, and what is being, in the order in which it began.
    fn insertions(&self) -> Vec<Insertion>;

    /// Begins to write a new file whose name begins with `stem`; what becomes of it is told by
    /// [`Self::saved`].
    fn save(&mut self, stem: &str, content: Content);

    /// The name of a file that is written now, or why it cannot be, for people; of each once.
    fn saved(&mut self) -> Option<Result<String, String>>;
}

/// What a window saves.
#[derive(Clone, Debug)]
pub enum Content {
    /// A picture.
    Picture(crate::Image),
    /// A text of JSON.
    Json(String),
}

/// An insertion, for people.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Insertion {
    /// Of the raster.
    pub name: String,
    /// How far it is.
    pub state: InsertionState,
}

/// How far an insertion is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum InsertionState {
    /// Percent.
    Running(u8),
    /// It is in the catalog.
    Done,
    /// It failed and left nothing.
    Failed(String),
}
