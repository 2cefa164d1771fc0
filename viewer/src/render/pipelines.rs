//! The programs and what they bind.

use areoid_cache::View;

use crate::full_screen::FullScreen;
use crate::gpu::Gpu;
use crate::mesh::detail::SEGMENTS;
use crate::shader::Program;

/// Patch number and weights.
pub(crate) const DEFERRED: wgpu::TextureFormat = wgpu::TextureFormat::Rgba32Uint;
/// Reversed, infinitely far at 0.
pub(crate) const DEPTH: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;
/// sRGB codes, encoded by the shader.
pub(crate) const PICTURE: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;

/// The programs of a picture and their bindings.
#[derive(Debug)]
pub(crate) struct Pipelines {
    /// Scene and geometry.
    pub(crate) scene_layout: wgpu::BindGroupLayout,
    /// The atlases.
    pub(crate) atlas_layout: wgpu::BindGroupLayout,
    /// The deferred buffer.
    pub(crate) deferred_layout: wgpu::BindGroupLayout,
    /// The deferred buffer, and numbers out of it.
    pub(crate) measure_layout: wgpu::BindGroupLayout,
    /// The points of patches, to be written.
    pub(crate) points_layout: wgpu::BindGroupLayout,
    /// The points of patches, to be read.
    pub(crate) vertices_layout: wgpu::BindGroupLayout,
    pub(crate) points: wgpu::ComputePipeline,
    pub(crate) mesh: wgpu::RenderPipeline,
    pub(crate) shade: wgpu::RenderPipeline,
    pub(crate) measure: wgpu::ComputePipeline,
}

impl Pipelines {
    pub(crate) fn new(gpu: &Gpu) -> Self {
        let read = storage(true);
        // The air is the eighth buffer of fragments, what it writes that of a compute program: WebGPU
        // promises no more.
        let scene_layout = scene_layout(gpu);
        let atlas_layout = layout(
            gpu,
            "atlases",
            &[
                texture(wgpu::TextureSampleType::Float { filterable: false }, true),
                texture(wgpu::TextureSampleType::Uint, true),
                texture(wgpu::TextureSampleType::Float { filterable: false }, true),
                texture(wgpu::TextureSampleType::Float { filterable: false }, true),
                texture(wgpu::TextureSampleType::Float { filterable: false }, true),
            ],
        );
        let deferred = texture(wgpu::TextureSampleType::Uint, false);
        let deferred_layout = layout(gpu, "deferred", &[deferred]);
        let measure_layout = compute_layout(gpu, "measure", &[deferred, storage(false)]);

        let points_layout = compute_layout(gpu, "points", &[storage(false)]);
        let vertices_layout = layout(gpu, "vertices", &[read]);

        let (scene, atlas) = (Some(&scene_layout), Some(&atlas_layout));
        let points = compute_pipeline(
            gpu,
            Program::Points,
            "compose_points",
            &[scene, atlas, None, Some(&points_layout)],
        );
        let mesh = mesh_pipeline(gpu, &[scene, None, None, Some(&vertices_layout)]);
        let shade = shade_pipeline(gpu, &[&scene_layout, &atlas_layout, &deferred_layout]);
        let groups = [scene, atlas, Some(&measure_layout)];
        let measure = compute_pipeline(gpu, Program::Measure, "measure", &groups);
        Self {
            scene_layout,
            atlas_layout,
            deferred_layout,
            measure_layout,
            points_layout,
            vertices_layout,
            points,
            mesh,
            shade,
            measure,
        }
    }
}

fn storage(read_only: bool) -> wgpu::BindingType {
    wgpu::BindingType::Buffer {
        ty: wgpu::BufferBindingType::Storage { read_only },
        has_dynamic_offset: false,
        min_binding_size: None,
    }
}

fn texture(sample_type: wgpu::TextureSampleType, array: bool) -> wgpu::BindingType {
    wgpu::BindingType::Texture {
        sample_type,
        view_dimension: if array {
            wgpu::TextureViewDimension::D2Array
        } else {
            wgpu::TextureViewDimension::D2
        },
        multisampled: false,
    }
}

/// The scene, six lists of the geometry, and the air, for pixels alone.
fn scene_layout(gpu: &Gpu) -> wgpu::BindGroupLayout {
    let all = wgpu::ShaderStages::VERTEX_FRAGMENT | wgpu::ShaderStages::COMPUTE;
    let entries: Vec<_> = (0..8)
        .map(|binding| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: if binding == 7 { wgpu::ShaderStages::FRAGMENT } else { all },
            ty: storage(true),
            count: None,
        })
        .collect();
    let descriptor = wgpu::BindGroupLayoutDescriptor { label: Some("scene"), entries: &entries };
    gpu.device.create_bind_group_layout(&descriptor)
}

fn layout(gpu: &Gpu, label: &str, types: &[wgpu::BindingType]) -> wgpu::BindGroupLayout {
    let all = wgpu::ShaderStages::VERTEX_FRAGMENT | wgpu::ShaderStages::COMPUTE;
    layout_for(gpu, label, types, all)
}

fn compute_layout(gpu: &Gpu, label: &str, types: &[wgpu::BindingType]) -> wgpu::BindGroupLayout {
    layout_for(gpu, label, types, wgpu::ShaderStages::COMPUTE)
}

fn layout_for(
    gpu: &Gpu,
    label: &str,
    types: &[wgpu::BindingType],
    visibility: wgpu::ShaderStages,
) -> wgpu::BindGroupLayout {
    let entries: Vec<_> = (0..)
        .zip(types)
        .map(|(binding, &ty)| wgpu::BindGroupLayoutEntry { binding, visibility, ty, count: None })
        .collect();
    let descriptor = wgpu::BindGroupLayoutDescriptor { label: Some(label), entries: &entries };
    gpu.device.create_bind_group_layout(&descriptor)
}

fn module(gpu: &Gpu, label: &str, program: Program) -> wgpu::ShaderModule {
    gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(label),
        source: wgpu::ShaderSource::Wgsl(program.source().into()),
    })
}

fn pipeline_layout(
    gpu: &Gpu,
    label: &str,
    groups: &[Option<&wgpu::BindGroupLayout>],
) -> wgpu::PipelineLayout {
    gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some(label),
        bind_group_layouts: groups,
        immediate_size: 0,
    })
}

/// The constants that the programs with `patch.wgsl` in them take from here.
const CONSTANTS: [(&str, f64); 2] = [("SEGMENTS", SEGMENTS as f64), ("BLENDED", View::BLENDED)];

fn options() -> wgpu::PipelineCompilationOptions<'static> {
    wgpu::PipelineCompilationOptions { constants: &CONSTANTS, ..Default::default() }
}

fn mesh_pipeline(gpu: &Gpu, groups: &[Option<&wgpu::BindGroupLayout>]) -> wgpu::RenderPipeline {
    let module = module(gpu, "mesh", Program::Mesh);
    gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("mesh"),
        layout: Some(&pipeline_layout(gpu, "mesh", groups)),
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("vertex"),
            compilation_options: wgpu::PipelineCompilationOptions {
                constants: &CONSTANTS,
                ..Default::default()
            },
            buffers: &[Some(wgpu::VertexBufferLayout {
                array_stride: 8,
                step_mode: wgpu::VertexStepMode::Vertex,
                attributes: &wgpu::vertex_attr_array![0 => Sint32x2],
            })],
        },
        primitive: wgpu::PrimitiveState {
            // The patches in sight are a closed surface in front of the background: its triangles wind once
            // about a pixel of it, also where their corners are rounded, and one of them at least covers the
            // pixel. It is one that shows its face only if faces are judged by the rounded corners too. Drivers
            // may judge by others, or twice (llvmpipe does, of clipped triangles), and slivers turn over
            // between. So none is left out; what shows its back is behind what shows its face.
            cull_mode: None,
            ..Default::default()
        },
        depth_stencil: Some(wgpu::DepthStencilState {
            format: DEPTH,
            depth_write_enabled: Some(true),
            depth_compare: Some(wgpu::CompareFunction::Greater),
            stencil: wgpu::StencilState::default(),
            bias: wgpu::DepthBiasState::default(),
        }),
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some("fragment"),
            compilation_options: options(),
            targets: &[Some(DEFERRED.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}

fn shade_pipeline(gpu: &Gpu, groups: &[&wgpu::BindGroupLayout]) -> wgpu::RenderPipeline {
    let source = &Program::Shade.source();
    let (label, entry_point, constants, format) = ("shade", "shade", &CONSTANTS[..], PICTURE);
    FullScreen { label, source, entry_point, constants, groups, format }.pipeline(gpu)
}

fn compute_pipeline(
    gpu: &Gpu,
    program: Program,
    entry_point: &str,
    groups: &[Option<&wgpu::BindGroupLayout>],
) -> wgpu::ComputePipeline {
    gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some(entry_point),
        layout: Some(&pipeline_layout(gpu, entry_point, groups)),
        module: &module(gpu, entry_point, program),
        entry_point: Some(entry_point),
        compilation_options: options(),
        cache: None,
    })
}
