//! The renderer: geometry into a deferred buffer, the buffer into a picture.
//!
//! ```text
//!   selection ─▶ atlases, page table ─┐
//!   view ──────▶ patches, frames ─────┴▶ points ─▶ mesh ─▶ deferred buffer ─▶ shade ─▶ picture
//!                                                                  └───────▶ measure ─▶ AOVs
//! ```

use areoid_cache::{Datasets, Selection, View};
use areoid_formats::body::Ellipsoid;
use areoid_formats::geodesy::geographic_from_normal;
use areoid_formats::page::Kind;
use bytemuck::Zeroable;
use glam::DVec3;

use super::aovs::Aovs;
use super::buffers::{Growing, most_bytes};
use super::options::{FrameStatistics, Image, Light, Options};
use super::pattern::Pattern;
use super::pipelines::Pipelines;
use super::resident::{Brought, Clock, Resident};
use super::scene::scene_of;
use super::targets::{Targets, read_buffer, read_texture};
use super::usage::Usage;
use crate::atlas::uploads::Allowance;
use crate::atmosphere::Air;
use crate::gpu::Gpu;
use crate::mesh::detail::{Detail, SEGMENTS};
use crate::mesh::patches::{Mesh, POINT_BYTES};
use crate::mirror;
use crate::pick::{Picked, pick};
use crate::style::Style;
use crate::surface::Surface;

/// Meters to the near plane where terrain may be about the eye.
const NEAR_M: f64 = 0.05;

/// Workgroups along one axis of a dispatch at most.
const MOST_WORKGROUPS: u32 = 65_535;

/// Draws selections. One thread uses it; nothing in it waits but the `read_` calls.
#[derive(Debug)]
pub struct Renderer {
    gpu: Gpu,
    ellipsoid: Ellipsoid,
    pipelines: Pipelines,
    resident: Resident,
    mesh: Mesh,
    detail: Detail,
    surface: Surface,
    /// What `surface` was made of.
    known: Option<Known>,
    /// What the last picture was made with.
    shown: Option<(View, Light, Options)>,
    scene: wgpu::Buffer,
    air: wgpu::Buffer,
    storages: Storages,
    scene_group: Option<wgpu::BindGroup>,
    atlas_group: Option<wgpu::BindGroup>,
    /// The points of patches, to be written and to be read.
    point_groups: Option<[wgpu::BindGroup; 2]>,
    targets: Option<Targets>,
    pattern: Pattern,
    drawn: Option<View>,
    exaggeration: f64,
}

/// A state of pages: the same twice means that nothing has to be brought.
#[derive(Clone, Debug)]
struct Known {
    /// Whose list it is: no other session has the same.
    datasets: Datasets,
    generation: u64,
    exaggeration: f64,
    style: Style,
    brought: Brought,
}

#[derive(Debug)]
struct Storages {
    frames: Growing,
    datasets: Growing,
    anchors: Growing,
    table: Growing,
    edges: Growing,
    patches: Growing,
    points: Growing,
}

impl Renderer {
    /// [`Self::with_budget`] of 1 GiB.
    #[must_use]
    pub fn new(gpu: &Gpu, ellipsoid: Ellipsoid) -> Self {
        Self::with_budget(gpu, ellipsoid, 1 << 30)
    }

    /// A renderer for a body on a device, for views of a cache with so many bytes for pages: each of the
    /// atlases, of heights, colors, gray colors and normals, grows to three quarters of that if it has to. A
    /// view has half of a cache at most, colors take a third more here, gray ones a third of it, and what
    /// fades out is there, too.
    #[must_use]
    pub fn with_budget(gpu: &Gpu, ellipsoid: Ellipsoid, budget_bytes: u64) -> Self {
        Self {
            pipelines: Pipelines::new(gpu),
            resident: Resident::new(gpu, budget_bytes / 4 * 3),
            mesh: Mesh::default(),
            detail: Detail::default(),
            surface: Surface::default(),
            known: None,
            shown: None,
            scene: fixed(gpu, "scene", size_of::<mirror::Scene>()),
            air: fixed(gpu, "air", size_of::<mirror::Atmosphere>()),
            storages: Storages {
                frames: Growing::new(gpu, "frames"),
                datasets: Growing::new(gpu, "datasets"),
                anchors: Growing::new(gpu, "anchors"),
                table: Growing::new(gpu, "page table"),
                edges: Growing::new(gpu, "edges"),
                patches: Growing::new(gpu, "patches"),
                points: Growing::new(gpu, "points"),
            },
            scene_group: None,
            atlas_group: None,
            point_groups: None,
            targets: None,
            pattern: Pattern::new(gpu),
            drawn: None,
            exaggeration: 1.0,
            gpu: gpu.clone(),
            ellipsoid,
        }
    }

    /// Draws `view` into the picture, unless it is there already.
    pub fn render(
        &mut self,
        view: &View,
        selection: &Selection,
        light: &Light,
        options: &Options,
    ) -> FrameStatistics {
        let brought = self.follow(selection, options);
        let mut statistics = FrameStatistics {
            patches: self.mesh.patches.len(),
            triangles: self.mesh.patches.len() * (SEGMENTS * SEGMENTS) as usize,
            uploaded_pages: brought.map_or(0, |brought| brought.uploaded),
            uploaded_bytes: brought.map_or(0, |brought| brought.uploaded_bytes),
            pending_pages: brought.map_or(0, |brought| brought.put_off),
            coming_pages: brought.map_or(0, |brought| brought.coming),
            left_out_pages: self.known.as_ref().map_or(0, |known| known.brought.left_out),
            is_same: false,
        };
        let timeless = Options { seconds: 0.0, ..options.clone() };
        let shown = Some((*view, *light, timeless));
        if brought.is_none() && self.shown == shown {
            return FrameStatistics { is_same: true, ..statistics };
        }
        self.shown = shown;
        let maps = &self.resident.maps;
        let most_bytes = most_bytes(&self.gpu);
        self.mesh.build(view, self.ellipsoid, &self.surface, &mut self.detail, maps, most_bytes);
        self.write_scene(view, light, options);
        self.draw(view);
        self.drawn = Some(*view);
        statistics.patches = self.mesh.patches.len();
        statistics.triangles = statistics.patches * (SEGMENTS * SEGMENTS) as usize;
        statistics
    }

    /// The picture drawn last. Waits for the GPU.
    ///
    /// # Panics
    ///
    /// If nothing was drawn.
    #[must_use]
    pub fn read_color(&self) -> Image {
        let targets = self.targets.as_ref().expect("a picture was drawn");
        let [width, height] = targets.viewport;
        Image { width, height, rgba: read_texture(&self.gpu, &targets.picture) }
    }

    /// What the pixels drawn last show, in numbers. Waits for the GPU.
    ///
    /// # Panics
    ///
    /// If nothing was drawn.
    #[must_use]
    pub fn read_aovs(&self) -> Aovs {
        let targets = self.targets.as_ref().expect("a picture was drawn");
        let view = self.drawn.as_ref().expect("a picture was drawn");
        self.measure(targets);
        let deferred = read_texture(&self.gpu, &targets.deferred);
        let measures = read_buffer(&self.gpu, &targets.measures);
        Aovs::new(view, &self.ellipsoid, self.exaggeration, &self.mesh, &deferred, &measures)
    }

    /// What of the material of the picture drawn last shows in it. Waits for the GPU, and takes a while.
    ///
    /// # Panics
    ///
    /// If nothing was drawn.
    #[must_use]
    pub fn read_usage(&self) -> Usage {
        let targets = self.targets.as_ref().expect("a picture was drawn");
        let view = self.drawn.as_ref().expect("a picture was drawn");
        let deferred = read_texture(&self.gpu, &targets.deferred);
        let seen = (view, self.exaggeration);
        Usage::new(seen, &self.ellipsoid, &self.mesh, &self.surface, &deferred)
    }

    /// The exaggerated height drawn last at a unit normal, from the finest page in memory; 0 before.
    #[must_use]
    pub fn height_m(&self, normal: DVec3) -> f64 {
        let place = geographic_from_normal(normal);
        let found = self.surface.compose(Kind::Height, place, 0.0);
        found.map_or(0.0, |found| self.exaggeration * found.value[0])
    }

    /// What the ray through a place of a view's picture, in pixels from its top left, meets, by the
    /// pages drawn last.
    #[must_use]
    pub fn pick(&self, view: &View, pixel: [f64; 2]) -> Option<Picked> {
        pick(&self.surface, &self.ellipsoid, view, self.exaggeration, pixel)
    }

    /// The picture as a texture of sRGB codes, or `None` before the first.
    pub(crate) fn picture(&self) -> Option<&wgpu::Texture> {
        self.targets.as_ref().map(|targets| &targets.picture)
    }

    /// Brings what is new of a selection to the GPU; `None` if nothing is.
    fn follow(&mut self, selection: &Selection, options: &Options) -> Option<Brought> {
        let is_known = self.known.as_ref().is_some_and(|known| {
            known.datasets.is(&selection.datasets)
                && known.generation == selection.generation
                && known.exaggeration == options.vertical_exaggeration
                && known.style == options.style
        });
        let is_done = |known: &Known| (known.brought.put_off, known.brought.coming) == (0, 0);
        if is_known && self.known.as_ref().is_some_and(is_done) {
            return None;
        }
        let gpu = &self.gpu;
        let sizes = self.resident.sizes();
        let clock = Clock { seconds: options.seconds, fade_seconds: options.fade_seconds };
        let allowance = Allowance::new(options.upload_limit_bytes, options.upload_limit_seconds);
        let brought = self.resident.bring(gpu, selection, &options.style, clock, allowance);
        if sizes != self.resident.sizes() {
            self.atlas_group = None;
        }
        let grown = self.storages.table.write(gpu, &self.resident.table)
            | self.storages.datasets.write(gpu, &self.resident.mirrored);
        if grown {
            self.scene_group = None;
        }
        if !is_known {
            self.surface = Surface::styled(selection, &options.style);
            self.detail.renew(&self.surface, options.vertical_exaggeration);
        }
        self.exaggeration = options.vertical_exaggeration;
        self.known = Some(Known {
            datasets: selection.datasets.clone(),
            generation: selection.generation,
            exaggeration: options.vertical_exaggeration,
            style: options.style.clone(),
            brought,
        });
        Some(brought)
    }

    #[expect(clippy::cast_possible_truncation, reason = "a distance, and counts")]
    fn write_scene(&mut self, view: &View, light: &Light, options: &Options) {
        let scene = mirror::Scene {
            near: self.near_m(view) as f32,
            slot_bounds: self.resident.slot_bounds,
            edges: self.mesh.edges.len() as u32,
            patches: self.mesh.patches.len() as u32,
            ..scene_of(view, &self.ellipsoid, light, options)
        };
        let gpu = &self.gpu;
        gpu.queue.write_buffer(&self.scene, 0, bytemuck::bytes_of(&scene));
        let sun = light.toward_sun.normalize();
        let air = options.atmosphere.map(|air| Air::new(&self.ellipsoid, air, view.eye, sun));
        let air = air.map_or_else(mirror::Atmosphere::zeroed, |air| air.mirrored());
        gpu.queue.write_buffer(&self.air, 0, bytemuck::bytes_of(&air));
        let grown = self.storages.frames.write(gpu, &self.mesh.mirrored_frames)
            | self.storages.anchors.write(gpu, &self.mesh.anchors)
            | self.storages.edges.write(gpu, &self.mesh.edges)
            | self.storages.patches.write(gpu, &self.mesh.patches);
        if grown || self.scene_group.is_none() {
            let storages = &self.storages;
            let bindings = [
                self.scene.as_entire_binding(),
                storages.frames.binding(),
                storages.datasets.binding(),
                storages.anchors.binding(),
                storages.table.binding(),
                storages.edges.binding(),
                storages.patches.binding(),
                self.air.as_entire_binding(),
            ];
            let layout = &self.pipelines.scene_layout;
            self.scene_group = Some(bind(gpu, "scene", layout, bindings));
        }
        let point_bytes = self.mesh.points() as u64 * POINT_BYTES;
        if self.storages.points.reserve(gpu, point_bytes) || self.point_groups.is_none() {
            let layouts = [&self.pipelines.points_layout, &self.pipelines.vertices_layout];
            self.point_groups = Some(
                layouts.map(|layout| bind(gpu, "points", layout, [self.storages.points.binding()])),
            );
        }
        if self.atlas_group.is_none() {
            let views: [_; 5] =
                self.resident.views().try_into().expect("the atlases have five planes");
            let bindings = views.each_ref().map(wgpu::BindingResource::TextureView);
            self.atlas_group = Some(bind(gpu, "atlases", &self.pipelines.atlas_layout, bindings));
        }
        if self.targets.as_ref().is_none_or(|targets| targets.viewport != view.viewport) {
            self.targets = Some(Targets::new(gpu, view.viewport));
        }
    }

    /// Meters to the near plane. GL maps depth to [-1, 1] and loses what a reversed depth gains: the
    /// plane is kept far out.
    fn near_m(&self, view: &View) -> f64 {
        let clearance_m = view.eye.length() - self.ellipsoid.a().0 - self.detail.highest_m();
        (0.5 * clearance_m).max(NEAR_M)
    }

    fn draw(&self, view: &View) {
        let gpu = &self.gpu;
        let targets = self.targets.as_ref().filter(|targets| targets.viewport == view.viewport);
        let targets = targets.expect("write_scene makes them");
        let look = wgpu::TextureViewDescriptor::default();
        let (deferred, depth, picture) = (
            targets.deferred.create_view(&look),
            targets.depth.create_view(&look),
            targets.picture.create_view(&look),
        );
        let descriptor = wgpu::CommandEncoderDescriptor { label: Some("frame") };
        let mut encoder = gpu.device.create_command_encoder(&descriptor);
        let [written, read] = self.point_groups.as_ref().expect("write_scene makes them");
        if self.mesh.points() > 0 {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("points"),
                ..Default::default()
            });
            pass.set_pipeline(&self.pipelines.points);
            pass.set_bind_group(0, &self.scene_group, &[]);
            pass.set_bind_group(1, &self.atlas_group, &[]);
            pass.set_bind_group(3, written, &[]);
            let workgroups = u32::try_from(self.mesh.points().div_ceil(64)).unwrap_or(u32::MAX);
            let columns = workgroups.min(MOST_WORKGROUPS);
            pass.dispatch_workgroups(columns, workgroups.div_ceil(columns), 1);
        }
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("mesh"),
                color_attachments: &[Some(attachment(&deferred))],
                depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                    view: &depth,
                    depth_ops: Some(wgpu::Operations {
                        load: wgpu::LoadOp::Clear(0.0),
                        // The tests read it.
                        store: if cfg!(test) {
                            wgpu::StoreOp::Store
                        } else {
                            wgpu::StoreOp::Discard
                        },
                    }),
                    stencil_ops: None,
                }),
                ..Default::default()
            });
            pass.set_pipeline(&self.pipelines.mesh);
            pass.set_bind_group(0, &self.scene_group, &[]);
            pass.set_bind_group(3, read, &[]);
            pass.set_vertex_buffer(0, self.pattern.steps.slice(..));
            pass.set_index_buffer(self.pattern.indices.slice(..), wgpu::IndexFormat::Uint16);
            let instances = u32::try_from(self.mesh.patches.len()).unwrap_or(u32::MAX);
            pass.draw_indexed(0..self.pattern.index_count, 0, 0..instances);
        }
        {
            let bindings = [wgpu::BindingResource::TextureView(&deferred)];
            let group = bind(gpu, "deferred", &self.pipelines.deferred_layout, bindings);
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("shade"),
                color_attachments: &[Some(attachment(&picture))],
                ..Default::default()
            });
            pass.set_pipeline(&self.pipelines.shade);
            pass.set_bind_group(0, &self.scene_group, &[]);
            pass.set_bind_group(1, &self.atlas_group, &[]);
            pass.set_bind_group(2, &group, &[]);
            pass.draw(0..3, 0..1);
        }
        gpu.queue.submit([encoder.finish()]);
    }

    /// What `probe`, a shader about the geometry drawn last, writes at `group(2) binding(0)`.
    #[cfg(test)]
    pub(crate) fn probe(&self, source: &str, bytes: u64, workgroups: u32) -> Vec<u8> {
        let layouts = [
            &self.pipelines.scene_layout,
            &self.pipelines.atlas_layout,
            &self.pipelines.vertices_layout,
        ];
        let points = self.point_groups.as_ref().map(|[_, read]| read);
        let groups = [self.scene_group.as_ref(), self.atlas_group.as_ref(), points];
        super::testing::probe(&self.gpu, source, layouts, groups, bytes, workgroups)
    }

    /// Meters along the view's axis to what was drawn last, row by row from the top; infinite where no
    /// planet is.
    #[cfg(test)]
    #[expect(clippy::cast_possible_truncation, reason = "as the shaders have it")]
    pub(crate) fn read_depth_m(&self) -> Vec<f64> {
        let (targets, view) = (self.targets.as_ref().unwrap(), self.drawn.as_ref().unwrap());
        let bytes = read_texture(&self.gpu, &targets.depth);
        let near_m = f64::from(self.near_m(view) as f32);
        let depths: &[f32] = bytemuck::cast_slice(&bytes);
        depths.iter().map(|&depth| near_m / f64::from(depth)).collect()
    }

    /// The geometry drawn last.
    #[cfg(test)]
    pub(crate) fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    fn measure(&self, targets: &Targets) {
        let gpu = &self.gpu;
        let deferred = targets.deferred.create_view(&wgpu::TextureViewDescriptor::default());
        let bindings =
            [wgpu::BindingResource::TextureView(&deferred), targets.measures.as_entire_binding()];
        let group = bind(gpu, "measure", &self.pipelines.measure_layout, bindings);
        let descriptor = wgpu::CommandEncoderDescriptor { label: Some("measure") };
        let mut encoder = gpu.device.create_command_encoder(&descriptor);
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
                label: Some("measure"),
                ..Default::default()
            });
            pass.set_pipeline(&self.pipelines.measure);
            pass.set_bind_group(0, &self.scene_group, &[]);
            pass.set_bind_group(1, &self.atlas_group, &[]);
            pass.set_bind_group(2, &group, &[]);
            let [width, height] = targets.viewport;
            pass.dispatch_workgroups(width.div_ceil(8), height.div_ceil(8), 1);
        }
        gpu.queue.submit([encoder.finish()]);
    }
}

fn fixed(gpu: &Gpu, label: &str, bytes: usize) -> wgpu::Buffer {
    gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some(label),
        size: bytes as u64,
        usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}

fn attachment(view: &wgpu::TextureView) -> wgpu::RenderPassColorAttachment<'_> {
    wgpu::RenderPassColorAttachment {
        view,
        depth_slice: None,
        resolve_target: None,
        ops: wgpu::Operations {
            load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
            store: wgpu::StoreOp::Store,
        },
    }
}

fn bind<const N: usize>(
    gpu: &Gpu,
    label: &str,
    layout: &wgpu::BindGroupLayout,
    resources: [wgpu::BindingResource<'_>; N],
) -> wgpu::BindGroup {
    let entries: Vec<_> = (0..)
        .zip(resources)
        .map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource })
        .collect();
    gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some(label),
        layout,
        entries: &entries,
    })
}
