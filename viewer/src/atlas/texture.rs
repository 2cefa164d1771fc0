//! An atlas on the GPU: texture arrays of one page a layer, grown on demand up to a budget.

use areoid_formats::page::{Kind, Page, Texels};

use super::slots::{PageName, Placed, Slots};
use super::table::MOST_SLOTS;
use super::uploads::{Target, Uploads};
use crate::gpu::Gpu;

/// Layers at first.
const FIRST_LAYERS: u32 = 16;

/// Which pages an atlas holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Content {
    Heights,
    Colors,
    Normals,
    /// Colors of [gray pages](Page::is_gray): in a quarter of the memory, they look the same.
    Grays,
}

/// What of pages an atlas holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Plane {
    label: &'static str,
    format: wgpu::TextureFormat,
    bytes_per_texel: u32,
}

const HEIGHTS: [Plane; 2] = [
    Plane { label: "heights", format: wgpu::TextureFormat::R32Float, bytes_per_texel: 4 },
    Plane { label: "height coverage", format: wgpu::TextureFormat::R8Uint, bytes_per_texel: 1 },
];
const COLORS: [Plane; 1] =
    [Plane { label: "colors", format: wgpu::TextureFormat::Rgba8Unorm, bytes_per_texel: 4 }];
const NORMALS: [Plane; 1] =
    [Plane { label: "normals", format: wgpu::TextureFormat::Rgba8Unorm, bytes_per_texel: 4 }];
const GRAYS: [Plane; 1] =
    [Plane { label: "grays", format: wgpu::TextureFormat::R8Unorm, bytes_per_texel: 1 }];

impl Content {
    /// In the order of their numbers.
    pub(crate) const ALL: [Self; 4] = [Self::Heights, Self::Colors, Self::Normals, Self::Grays];

    /// The kind of the datasets whose pages it may hold.
    pub(crate) fn kind(self) -> Kind {
        match self {
            Self::Heights => Kind::Height,
            Self::Colors | Self::Grays => Kind::Color,
            Self::Normals => Kind::Normal,
        }
    }

    /// The one that a page of a kind belongs to.
    pub(crate) fn of(kind: Kind, page: &Page) -> Self {
        match kind {
            Kind::Height => Self::Heights,
            Kind::Color if page.is_gray() => Self::Grays,
            Kind::Color => Self::Colors,
            Kind::Normal => Self::Normals,
        }
    }
}

/// The pages of one content on the GPU.
#[derive(Debug)]
pub(crate) struct Atlas {
    planes: &'static [Plane],
    textures: Vec<wgpu::Texture>,
    slots: Slots,
    side: u32,
    layers: u32,
    most_layers: u32,
}

impl Atlas {
    /// An atlas for pages of up to `side` texels, in at most `budget_bytes`.
    pub(crate) fn new(gpu: &Gpu, content: Content, side: u32, budget_bytes: u64) -> Self {
        let planes: &[Plane] = match content {
            Content::Heights => &HEIGHTS,
            Content::Colors => &COLORS,
            Content::Normals => &NORMALS,
            Content::Grays => &GRAYS,
        };
        let texel_bytes: u32 = planes.iter().map(|plane| plane.bytes_per_texel).sum();
        let slot_bytes = u64::from(side) * u64::from(side) * u64::from(texel_bytes);
        let affordable = u32::try_from(budget_bytes / slot_bytes).unwrap_or(u32::MAX);
        let most = gpu.device.limits().max_texture_array_layers.min(MOST_SLOTS);
        // A texture array of one layer would be bound as none.
        let most_layers = affordable.clamp(2, most);
        let layers = FIRST_LAYERS.min(most_layers);
        let textures = planes.iter().map(|plane| texture(gpu, plane, side, layers)).collect();
        let slots = Slots::new(layers);
        Self { planes, textures, slots, side, layers, most_layers }
    }

    /// Texels along the side of a slot.
    pub(crate) fn side(&self) -> u32 {
        self.side
    }

    pub(crate) fn views(&self) -> Vec<wgpu::TextureView> {
        let descriptor = wgpu::TextureViewDescriptor {
            dimension: Some(wgpu::TextureViewDimension::D2Array),
            ..Default::default()
        };
        self.textures.iter().map(|texture| texture.create_view(&descriptor)).collect()
    }

    /// Starts a turn.
    pub(crate) fn next_turn(&mut self) {
        self.slots.next_turn();
    }

    /// Marks a page as used and says where it is, if it is.
    pub(crate) fn keep(&mut self, name: PageName) -> Option<u32> {
        self.slots.keep(name)
    }

    /// The slot of a page, written if it is new, or `None` if the budget is spent on pages of this
    /// turn. The textures change where the atlas grows: compare [`Self::layers`].
    pub(crate) fn place(
        &mut self,
        gpu: &Gpu,
        uploads: &mut Uploads,
        name: PageName,
        page: &Page,
    ) -> Option<u32> {
        let mut placed = self.slots.place(name);
        if placed == Placed::Full && self.layers < self.most_layers {
            self.grow(gpu, uploads);
            placed = self.slots.place(name);
        }
        match placed {
            Placed::Resident(slot) => Some(slot),
            Placed::New(slot) => {
                self.write(gpu, uploads, slot, page);
                Some(slot)
            }
            Placed::Full => None,
        }
    }

    /// Layers of the textures now.
    pub(crate) fn layers(&self) -> u32 {
        self.layers
    }

    fn grow(&mut self, gpu: &Gpu, uploads: &mut Uploads) {
        let layers = (2 * self.layers).min(self.most_layers);
        // What was written comes first, by itself: within one encoder its layers would each be in another
        // state, and wgpu copies no texture whose layers are in more than two.
        uploads.submit(gpu);
        let descriptor = wgpu::CommandEncoderDescriptor { label: Some("grow an atlas") };
        let mut encoder = gpu.device.create_command_encoder(&descriptor);
        for (plane, old) in self.planes.iter().zip(&mut self.textures) {
            let new = texture(gpu, plane, self.side, layers);
            encoder.copy_texture_to_texture(old.as_image_copy(), new.as_image_copy(), old.size());
            *old = new;
        }
        gpu.queue.submit([encoder.finish()]);
        self.slots.grow(layers);
        self.layers = layers;
    }

    fn write(&self, gpu: &Gpu, uploads: &mut Uploads, slot: u32, page: &Page) {
        let columns = page.side();
        let side = u32::try_from(columns).expect("a page has at most 4096 texels a side");
        for (plane, texture) in self.planes.iter().zip(&self.textures) {
            let bytes_per_texel = plane.bytes_per_texel;
            let target = Target { texture, layer: slot, side, bytes_per_texel };
            uploads.write(gpu, target, |row, bytes| {
                let texels = row * columns..(row + 1) * columns;
                let coverage = page.coverage().map(|coverage| &coverage[texels.clone()]);
                match (page.texels(), plane.format) {
                    (Texels::Height(heights), wgpu::TextureFormat::R32Float) => {
                        let finite = |height: &f32| if height.is_finite() { *height } else { 0.0 };
                        let heights = heights[texels].iter().map(finite);
                        bytes.extend(heights.flat_map(f32::to_le_bytes));
                    }
                    (Texels::Height(_), _) => match coverage {
                        Some(coverage) => bytes.extend_from_slice(coverage),
                        None => bytes.resize(columns, u8::MAX),
                    },
                    (Texels::Color(colors), wgpu::TextureFormat::R8Unorm) => {
                        bytes.extend(colors[texels].iter().map(|[gray, ..]| gray));
                    }
                    (Texels::Color(colors), _) => {
                        let alpha = |col: usize| coverage.map_or(u8::MAX, |coverage| coverage[col]);
                        let colors = colors[texels].iter().enumerate();
                        bytes.extend(
                            colors.flat_map(|(col, &[red, green, blue])| {
                                [red, green, blue, alpha(col)]
                            }),
                        );
                    }
                }
            });
        }
    }
}

fn texture(gpu: &Gpu, plane: &Plane, side: u32, layers: u32) -> wgpu::Texture {
    gpu.device.create_texture(&wgpu::TextureDescriptor {
        label: Some(plane.label),
        size: wgpu::Extent3d { width: side, height: side, depth_or_array_layers: layers },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: plane.format,
        usage: wgpu::TextureUsages::TEXTURE_BINDING
            | wgpu::TextureUsages::COPY_DST
            | wgpu::TextureUsages::COPY_SRC,
        view_formats: &[],
    })
}
