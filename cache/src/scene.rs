//! The datasets that can be seen, as one immutable snapshot.

use std::sync::Arc;

use areoid_formats::address::{Level, PageAddress};
use areoid_formats::archive::{Archive, ArchiveError, PageEntry};
use areoid_formats::body::Body;
use areoid_formats::bounds::Aabb;
use areoid_formats::bvh::Bvh;
use areoid_formats::grid::{Grid, TexelPoint};
use areoid_formats::page::Kind;
use areoid_formats::projection::Crs;
use areoid_formats::units::Meters;
use areoid_formats::volume::Volume;

use crate::selection::DatasetInfo;

/// All datasets of one moment. Adding one makes a new scene; places of datasets never change.
#[derive(Clone, Debug)]
pub(crate) struct Scene {
    pub(crate) infos: Arc<[DatasetInfo]>,
    pub(crate) datasets: Vec<Dataset>,
    /// Over the root volumes, by place in `datasets`.
    pub(crate) tree: Bvh,
    body: Body,
    /// Least and greatest height of the terrain, the reference surface included.
    heights: [f64; 2],
}

#[derive(Clone, Debug)]
pub(crate) struct Dataset {
    pub(crate) archive: Arc<Archive>,
    pub(crate) roots: Vec<PageEntry>,
}

/// A page as the search sees it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Node {
    pub(crate) entry: PageEntry,
    pub(crate) volume: Volume,
    /// At least the ground meters of a texel.
    pub(crate) texel_m: f64,
}

impl Scene {
    pub(crate) fn empty(body: Body) -> Self {
        let (infos, tree) = (Arc::from([]), Bvh::default());
        Self { infos, datasets: Vec::new(), tree, body, heights: [0.0; 2] }
    }

    /// The scene with one more dataset. Reads the blocks of its index that lead to its roots.
    pub(crate) fn with(
        &self,
        info: DatasetInfo,
        archive: Arc<Archive>,
    ) -> Result<Self, ArchiveError> {
        let pyramid = info.grid.pyramid();
        let (rows, cols) = pyramid.pages(Level(0)).expect("a pyramid has a coarsest level");
        let mut roots = Vec::new();
        for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
            roots.extend(archive.find(PageAddress::new(Level(0), row, col))?);
        }

        let mut scene = self.clone();
        if info.kind == Kind::Height {
            for root in &roots {
                // A NaN is no height: `min` and `max` pass it over.
                scene.heights[0] = scene.heights[0].min(f64::from(root.lowest));
                scene.heights[1] = scene.heights[1].max(f64::from(root.highest));
            }
        }
        scene.infos = self.infos.iter().cloned().chain([info]).collect();
        scene.datasets.push(Dataset { archive, roots });
        // Colors lie on the terrain: their boxes follow its heights.
        let moved = scene.heights != self.heights;
        let first = if moved { 0 } else { self.datasets.len() };
        for place in first..scene.datasets.len() {
            let whole = scene.datasets[place]
                .roots
                .iter()
                .fold(Aabb::EMPTY, |whole, root| whole.union(&scene.volume(place, root).aabb()));
            let item = u32::try_from(place).expect("fewer than 2^32 datasets");
            scene.tree.insert(item, whole);
        }
        Ok(scene)
    }

    /// A sphere below all terrain.
    pub(crate) fn inscribed_radius(&self) -> Meters {
        Meters(self.body.ellipsoid.b().0 + self.heights[0])
    }

    /// A sphere around all terrain.
    pub(crate) fn greatest_radius(&self) -> Meters {
        // Boxes of colors and of heights end here too, but for rounding.
        Meters((self.body.ellipsoid.a().0 + self.heights[1]) * (1.0 + 1e-6))
    }

    /// What the search has to know of a page.
    pub(crate) fn node(&self, dataset: usize, entry: PageEntry) -> Node {
        let info = &self.infos[dataset];
        let texel_m = match info.kind {
            Kind::Height => {
                let halvings = f64::from(info.grid.pyramid().halvings(entry.page.level));
                info.grid.nominal_pixel().0 * halvings.exp2()
            }
            Kind::Color | Kind::Normal => largest_texel(&info.grid, entry.page),
        };
        Node { entry, volume: self.volume(dataset, &entry), texel_m }
    }

    /// Children of a page that have data, or `None` if the index has to be read first. Never
    /// waits.
    pub(crate) fn children(&self, dataset: usize, page: PageAddress) -> Option<Vec<Node>> {
        let archive = &self.datasets[dataset].archive;
        let mut children = Vec::new();
        for child in self.infos[dataset].grid.pyramid().children(page) {
            children.extend(archive.find_resident(child)?.map(|entry| self.node(dataset, entry)));
        }
        Some(children)
    }

    fn volume(&self, dataset: usize, entry: &PageEntry) -> Volume {
        let info = &self.infos[dataset];
        let [lowest, highest] = match info.kind {
            Kind::Height => [entry.lowest, entry.highest].map(f64::from),
            Kind::Color | Kind::Normal => self.heights,
        };
        Volume::new(&info.grid, entry.page, Meters(lowest), Meters(highest))
    }
}

/// The largest ground size of a texel at the corners and in the middle of a page.
fn largest_texel(grid: &Grid, page: PageAddress) -> f64 {
    let (rows, cols) = grid.pyramid().interior_size(page);
    let interior = f64::from(grid.pyramid().interior());
    let (left, top) = (f64::from(page.col) * interior, f64::from(page.row) * interior);
    let (width, height) = (f64::from(cols), f64::from(rows));
    let crs: &Crs = grid.crs();
    let pixel_size = grid.pixel_size_at(page.level);
    [(0.0, 0.0), (1.0, 0.0), (0.5, 0.5), (0.0, 1.0), (1.0, 1.0)]
        .into_iter()
        .filter_map(|(across, down)| {
            let point = TexelPoint { x: left + across * width, y: top + down * height };
            let position = grid.geographic_from_texel(page.level, point)?;
            Some(crs.principal_scales(position, pixel_size).0)
        })
        .fold(0.0, f64::max)
}
