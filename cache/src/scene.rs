//! The datasets that can be seen, as one immutable snapshot.

use std::hint::black_box;
use std::sync::Arc;

use areoid_formats::address::{Level, PageAddress};
use areoid_formats::archive::{ArchiveError, PageEntry};
use areoid_formats::body::Body;
use areoid_formats::bounds::Aabb;
use areoid_formats::bvh::Bvh;
use areoid_formats::grid::{Grid, TexelPoint};
use areoid_formats::page::Kind;
use areoid_formats::projection::Crs;
use areoid_formats::units::Meters;
use areoid_formats::volume::Volume;

use crate::pages::PageSource;
use crate::selection::{DatasetInfo, Datasets};

/// All datasets of one moment. A change makes a new scene.
#[derive(Clone, Debug)]
pub(crate) struct Scene {
    /// How often it has changed.
    pub(crate) generation: u64,
    /// By number, ascending.
    pub(crate) datasets: Vec<Arc<Dataset>>,
    /// What there is to say of them.
    pub(crate) infos: Datasets,
    /// Over the root volumes, by slot.
    pub(crate) tree: Bvh,
    /// By slot: a dataset's place in `datasets`.
    pub(crate) slots: Vec<usize>,
    /// By slot.
    leaves: Leaves,
    /// Slots of datasets that are gone, for others.
    free: Vec<u32>,
    body: Body,
    /// Least and greatest height of the terrain that there ever was, the reference surface included.
    heights: [f64; 2],
    /// What the next dataset will be called.
    next: u32,
    /// Changes of the tree since it was built anew.
    changes: usize,
    /// The boxes around the datasets that came or went in the last change.
    latest: Vec<Aabb>,
}

/// A dataset as the search sees it.
#[derive(Clone, Debug)]
pub(crate) struct Dataset {
    pub(crate) number: usize,
    pub(crate) slot: u32,
    pub(crate) info: Arc<DatasetInfo>,
    pub(crate) pages: Arc<dyn PageSource>,
    /// What its texels are, what its finest level is, and how many texels a page has, its border included:
    /// as `info` says, and nearer by.
    pub(crate) kind: Kind,
    pub(crate) finest: Level,
    texels: usize,
    pub(crate) roots: Vec<Node>,
    /// Of the roots.
    pub(crate) entries: Vec<PageEntry>,
    /// The terrain that colors lie on.
    heights: [f64; 2],
}

/// A page as the search sees it: of its entry, what is read of most pages.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Node {
    pub(crate) page: PageAddress,
    pub(crate) volume: Volume,
    /// At least the ground meters of a texel.
    pub(crate) texel_m: f64,
    /// As in [`PageEntry`].
    pub(crate) bound: f32,
    pub(crate) full: bool,
    /// Whether it has no valid texel.
    pub(crate) is_empty: bool,
}

/// What a search reads of a dataset that it has found in sight, in as few lines of a processor's cache as it can:
/// their misses are most of what that costs.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub(crate) struct Leaf {
    /// Its root, if it has one and no more.
    pub(crate) root: Option<Node>,
    pub(crate) number: usize,
    pub(crate) kind: Kind,
    /// As in [`Dataset`].
    texels: usize,
}

const _: () = assert!(size_of::<Leaf>() == 192);

/// One for each slot, in blocks that a scene shares with the one before.
#[derive(Clone, Debug, Default)]
struct Leaves(Vec<Arc<[Leaf]>>);

/// A dataset to be, with what is known of its roots.
#[derive(Clone, Debug)]
pub(crate) struct Newcomer {
    info: Arc<DatasetInfo>,
    pages: Arc<dyn PageSource>,
    roots: Vec<PageEntry>,
}

impl Newcomer {
    /// Reads the blocks of the index that lead to its roots.
    pub(crate) fn new(info: DatasetInfo, pages: Arc<dyn PageSource>) -> Result<Self, ArchiveError> {
        let pyramid = info.grid.pyramid();
        let (rows, cols) = pyramid.pages(Level(0)).expect("a pyramid has a coarsest level");
        let mut roots = Vec::new();
        for (row, col) in (0..rows).flat_map(|row| (0..cols).map(move |col| (row, col))) {
            roots.extend(pages.find(PageAddress::new(Level(0), row, col))?);
        }
        Ok(Self { info: Arc::new(info), pages, roots })
    }
}

impl Scene {
    pub(crate) fn empty(body: Body) -> Self {
        Self {
            generation: 0,
            datasets: Vec::new(),
            infos: Datasets::default(),
            tree: Bvh::default(),
            slots: Vec::new(),
            leaves: Leaves::default(),
            free: Vec::new(),
            body,
            heights: [0.0; 2],
            next: 0,
            changes: 0,
            latest: Vec::new(),
        }
    }

    /// The scene without the datasets that `drop` is true for, and with others.
    pub(crate) fn changed(
        &self,
        drop: impl Fn(&DatasetInfo) -> bool,
        newcomers: impl IntoIterator<Item = Newcomer>,
    ) -> Self {
        let mut scene = self.clone();
        scene.generation += 1;
        scene.latest.clear();
        for gone in scene.datasets.extract_if(.., |dataset| drop(&dataset.info)) {
            scene.tree.remove(gone.slot);
            scene.free.push(gone.slot);
            scene.latest.push(gone.bounds());
            scene.changes += 1;
        }
        let newcomers: Vec<Newcomer> = newcomers.into_iter().collect();
        for newcomer in newcomers.iter().filter(|newcomer| newcomer.info.kind == Kind::Height) {
            for root in &newcomer.roots {
                // A NaN is no height: `min` and `max` pass it over.
                scene.heights[0] = scene.heights[0].min(f64::from(root.lowest));
                scene.heights[1] = scene.heights[1].max(f64::from(root.highest));
            }
        }
        if scene.heights != self.heights {
            // Colors lie on the terrain: their boxes follow its heights.
            let heights = scene.heights;
            for dataset in scene.datasets.iter_mut().filter(|dataset| dataset.is_laid_on()) {
                let moved = dataset.on(heights);
                moved.plant(&mut scene.tree);
                scene.leaves.set(moved.slot as usize, Leaf::of(&moved));
                scene.changes += 1;
                *dataset = Arc::new(moved);
            }
        }
        for Newcomer { info, pages, roots } in newcomers {
            let number = scene.next as usize;
            scene.next = scene.next.checked_add(1).expect("fewer than 2^32 datasets ever");
            let slot = scene.free.pop().unwrap_or_else(|| scene.add_slot());
            let dataset = Dataset::new(number, slot, info, pages, roots, scene.heights);
            dataset.plant(&mut scene.tree);
            scene.leaves.set(slot as usize, Leaf::of(&dataset));
            scene.latest.push(dataset.bounds());
            scene.changes += 1;
            scene.datasets.push(Arc::new(dataset));
        }
        let infos = scene.datasets.iter();
        scene.infos = infos.map(|dataset| (dataset.number, Arc::clone(&dataset.info))).collect();
        for (place, dataset) in scene.datasets.iter().enumerate() {
            scene.slots[dataset.slot as usize] = place;
        }
        scene.keep_tree();
        scene
    }

    /// Builds the tree anew once an eighth of it has changed, if that makes it better. Datasets get their slots in
    /// its order then: what lies side by side on the ground does so in memory.
    fn keep_tree(&mut self) {
        const FEW: usize = 32;
        if self.changes > FEW.max(self.datasets.len() / 8) {
            let boxes = self.datasets.iter().map(|dataset| (dataset.slot, dataset.bounds()));
            let mut fresh = Bvh::build(boxes);
            for dataset in &self.datasets {
                fresh.set_extent(dataset.slot, dataset.extent_m());
            }
            if fresh.cost() < self.tree.cost() {
                self.tree = fresh;
            }
            self.sort_slots();
            self.changes = 0;
        }
    }

    /// Gives datasets the slots that are their places in the tree.
    fn sort_slots(&mut self) {
        let before = self.tree.renumber();
        // Each has an item, and each slot that is not free has a dataset.
        self.slots = before.iter().map(|&slot| self.slots[slot as usize]).collect();
        self.free.clear();
        self.leaves = Leaves::default();
        for (slot, &place) in (0..).zip(&self.slots) {
            let dataset = Dataset { slot, ..Dataset::clone(&self.datasets[place]) };
            self.leaves.set(slot as usize, Leaf::of(&dataset));
            self.datasets[place] = Arc::new(dataset);
        }
    }

    fn add_slot(&mut self) -> u32 {
        self.slots.push(0);
        u32::try_from(self.slots.len() - 1).expect("fewer than 2^32 datasets")
    }

    /// The dataset in a slot.
    pub(crate) fn dataset(&self, slot: usize) -> &Dataset {
        &self.datasets[self.slots[slot]]
    }

    /// What a search reads first of the dataset in a slot.
    pub(crate) fn leaf(&self, slot: usize) -> &Leaf {
        self.leaves.get(slot)
    }

    /// Asks memory for that: [`Bvh::fetch`].
    pub(crate) fn fetch(&self, slot: usize) {
        if let Leaf { root: Some(Node { volume, texel_m, .. }), .. } = self.leaf(slot) {
            // One in each line of a processor's cache.
            let bounds = volume.bounds();
            black_box((bounds.center.x, bounds.half.z, *texel_m));
        }
    }

    /// Where the dataset of a number stands.
    pub(crate) fn place(&self, number: usize) -> Option<usize> {
        self.infos.place(number)
    }

    /// The boxes around the datasets that one of two scenes has and the other, a later one, has not, or
    /// `None` if what both have may lie elsewhere.
    pub(crate) fn changes<'a>(
        &'a self,
        other: &'a Self,
    ) -> Option<impl Iterator<Item = Aabb> + 'a> {
        let lacks = |one: &'a Self, other: &'a Self| {
            let mut next = 0;
            let lacking = one.datasets.iter().filter(move |dataset| {
                let others = &other.datasets;
                while others.get(next).is_some_and(|there| there.number < dataset.number) {
                    next += 1;
                }
                others.get(next).is_none_or(|there| there.number != dataset.number)
            });
            lacking.map(|dataset| dataset.bounds())
        };
        // Mostly it is the next.
        let is_next = other.generation == self.generation + 1;
        let latest = is_next.then_some(other.latest.iter().copied());
        let all = (!is_next).then(|| lacks(self, other).chain(lacks(other, self)));
        let changes = latest.into_iter().flatten().chain(all.into_iter().flatten());
        (self.heights == other.heights).then_some(changes)
    }

    /// The places of the datasets that another scene has not, or `None` if those that both have may lie
    /// elsewhere.
    pub(crate) fn newcomers(&self, before: &Self) -> Option<Vec<usize>> {
        // Numbers ascend, and those that are given later are greater.
        let is_known = |dataset: &Arc<Dataset>| dataset.number < before.next as usize;
        let first = self.datasets.partition_point(is_known);
        (self.heights == before.heights).then(|| (first..self.datasets.len()).collect())
    }

    /// All datasets, in the order of their numbers.
    pub(crate) fn all(&self) -> impl Iterator<Item = &DatasetInfo> {
        self.datasets.iter().map(|dataset| dataset.info.as_ref())
    }

    /// The radii of a sphere below all terrain whose heights are taken so many times, and of one around it.
    pub(crate) fn radii(&self, exaggeration: f64) -> [Meters; 2] {
        let ellipsoid = &self.body.ellipsoid;
        let [lowest, highest] = self.heights.map(|height| exaggeration * height);
        // Boxes of colors and of heights end at the outer one too, but for rounding.
        [(ellipsoid.b().0 + lowest).max(0.0), (ellipsoid.a().0 + highest) * (1.0 + 1e-6)]
            .map(Meters)
    }

    /// How far exaggeration moves any point of the terrain at most.
    pub(crate) fn shift_m(&self, exaggeration: f64) -> f64 {
        // Heights of a broken raster may be infinite.
        let more = (exaggeration - 1.0).abs();
        if more == 0.0 { 0.0 } else { more * self.heights[0].abs().max(self.heights[1]) }
    }
}

impl Node {
    /// How far two of its points are apart at most.
    pub(crate) fn extent_m(&self) -> f64 {
        2.0 * self.volume.bounds().radius()
    }
}

impl Leaf {
    fn of(dataset: &Dataset) -> Self {
        let root = match dataset.roots.as_slice() {
            [root] => Some(*root),
            _ => None,
        };
        let Dataset { number, kind, texels, .. } = *dataset;
        Self { root, number, kind, texels }
    }

    /// Bytes of a decoded page.
    pub(crate) fn page_bytes(&self, node: &Node) -> usize {
        page_bytes(self.kind, self.texels, node.full)
    }
}

impl Leaves {
    /// Leaves in a block: few enough to be copied for one of them.
    const BLOCK: usize = 64;

    fn get(&self, slot: usize) -> &Leaf {
        &self.0[slot / Self::BLOCK][slot % Self::BLOCK]
    }

    /// Says what stands in a slot: one that there is, or the first that there is not yet.
    fn set(&mut self, slot: usize, leaf: Leaf) {
        let (block, place) = (slot / Self::BLOCK, slot % Self::BLOCK);
        if block == self.0.len() {
            self.0.push([leaf; Self::BLOCK].into());
        }
        Arc::make_mut(&mut self.0[block])[place] = leaf;
    }
}

impl Dataset {
    fn new(
        number: usize,
        slot: u32,
        info: Arc<DatasetInfo>,
        pages: Arc<dyn PageSource>,
        roots: Vec<PageEntry>,
        heights: [f64; 2],
    ) -> Self {
        let pyramid = info.grid.pyramid();
        let (kind, finest, side) = (info.kind, pyramid.finest(), pyramid.page_side() as usize);
        let mut dataset = Self {
            number,
            slot,
            info,
            pages,
            kind,
            finest,
            texels: side * side,
            roots: Vec::new(),
            entries: roots,
            heights,
        };
        dataset.roots = dataset.nodes(&dataset.entries, 1.0);
        dataset
    }

    /// The same on another terrain.
    fn on(&self, heights: [f64; 2]) -> Self {
        let roots = self.entries.clone();
        let (info, pages) = (Arc::clone(&self.info), Arc::clone(&self.pages));
        Self::new(self.number, self.slot, info, pages, roots, heights)
    }

    /// Whether it lies on a terrain, and is none.
    fn is_laid_on(&self) -> bool {
        self.kind != Kind::Height
    }

    pub(crate) fn bounds(&self) -> Aabb {
        self.roots.iter().fold(Aabb::EMPTY, |whole, root| whole.union(&root.volume.aabb()))
    }

    /// The greatest diagonal of one of its roots, in meters.
    pub(crate) fn extent_m(&self) -> f64 {
        self.roots.iter().map(Node::extent_m).fold(0.0, f64::max)
    }

    /// Puts it into a tree.
    fn plant(&self, tree: &mut Bvh) {
        tree.insert(self.slot, self.bounds());
        tree.set_extent(self.slot, self.extent_m());
    }

    /// The terrain that its volumes depend on.
    pub(crate) fn terrain(&self) -> Option<[f64; 2]> {
        self.is_laid_on().then_some(self.heights)
    }

    /// Bytes of a decoded page.
    pub(crate) fn page_bytes(&self, node: &Node) -> usize {
        page_bytes(self.kind, self.texels, node.full)
    }

    /// The most that loading a page takes of so many stored bytes: those, and texels with a coverage
    /// beside them.
    pub(crate) fn load_bytes(&self, stored: usize) -> usize {
        self.texels * (size_of::<f32>() + 1) + stored
    }

    /// What the search has to know of pages on terrain whose heights are taken so many times.
    pub(crate) fn nodes(&self, entries: &[PageEntry], exaggeration: f64) -> Vec<Node> {
        entries.iter().map(|entry| self.node(entry, exaggeration)).collect()
    }

    /// The same of one page.
    pub(crate) fn node(&self, entry: &PageEntry, exaggeration: f64) -> Node {
        let Self { info, heights, .. } = self;
        let (texel_m, [lowest, highest]) = match info.kind {
            Kind::Height => {
                let halvings = f64::from(info.grid.pyramid().halvings(entry.page.level));
                let texel_m = info.grid.nominal_pixel().0 * halvings.exp2();
                (texel_m, [entry.lowest, entry.highest].map(f64::from))
            }
            Kind::Color | Kind::Normal => (largest_texel(&info.grid, entry.page), *heights),
        };
        let [lowest, highest] = [lowest, highest].map(|height| Meters(exaggeration * height));
        let volume = Volume::new(&info.grid, entry.page, lowest, highest);
        let &PageEntry { page, bound, full, valid_fraction, .. } = entry;
        Node { page, volume, texel_m, bound, full, is_empty: valid_fraction <= 0.0 }
    }

    /// Children of a page that have data, or `None` if the index has to be read first. Never
    /// waits.
    pub(crate) fn children(&self, page: PageAddress) -> Option<Vec<PageEntry>> {
        let mut children = Vec::with_capacity(4);
        for child in self.info.grid.pyramid().children(page) {
            children.extend(self.pages.find_resident(child)?);
        }
        Some(children)
    }
}

/// Bytes of a decoded page of so many texels, which are all covered if it is `full`.
fn page_bytes(kind: Kind, texels: usize, full: bool) -> usize {
    let per_texel = match kind {
        Kind::Height => size_of::<f32>(),
        Kind::Color | Kind::Normal => 3,
    };
    texels * (per_texel + usize::from(!full))
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
