//! Runs a compute shader over questions, for tests.

use bytemuck::{Pod, Zeroable as _};

use super::targets::read_buffer;
use crate::gpu::Gpu;
use crate::mirror;

/// What stands at the places of `group(0)`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Given<'a> {
    pub(crate) scene: mirror::Scene,
    pub(crate) datasets: &'a [mirror::Dataset],
    pub(crate) anchors: &'a [mirror::Anchor],
    pub(crate) table: &'a [i32],
    pub(crate) air: mirror::Atmosphere,
}

impl Default for Given<'_> {
    fn default() -> Self {
        let (scene, air) = (mirror::Scene::zeroed(), mirror::Atmosphere::zeroed());
        Self { scene, datasets: &[], anchors: &[], table: &[], air }
    }
}

/// Whether the entry point `probe` uses what `group(0)` has at a binding.
fn uses(source: &str) -> impl Fn(u32) -> bool {
    let module = naga::front::wgsl::parse_str(source)
        .unwrap_or_else(|error| panic!("{}", error.emit_to_string(source)));
    let (flags, capabilities) =
        (naga::valid::ValidationFlags::all(), naga::valid::Capabilities::empty());
    let info = naga::valid::Validator::new(flags, capabilities).validate(&module).unwrap();
    let place = module.entry_points.iter().position(|entry| entry.name == "probe").unwrap();
    move |binding| {
        let mut globals = module.global_variables.iter();
        globals.any(|(handle, global)| {
            let is_there = global.binding.is_some_and(|at| (at.group, at.binding) == (0, binding));
            is_there && !info.get_entry_point(place)[handle].is_empty()
        })
    }
}

/// The answers of the entry point `probe`: `group(0)` has what is given, `group(1)` the questions, which it
/// overwrites.
pub(crate) fn compute<T: Pod>(
    gpu: &Gpu,
    source: &str,
    given: Given<'_>,
    questions: &[T],
) -> Vec<T> {
    let buffer = |label, bytes: &[u8]| {
        let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size: bytes.len() as u64,
            usage: wgpu::BufferUsages::STORAGE
                | wgpu::BufferUsages::COPY_DST
                | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        gpu.queue.write_buffer(&buffer, 0, bytes);
        buffer
    };
    let all: [(u32, &[u8]); 5] = [
        (0, bytemuck::bytes_of(&given.scene)),
        (2, bytemuck::cast_slice(given.datasets)),
        (3, bytemuck::cast_slice(given.anchors)),
        (4, bytemuck::cast_slice(given.table)),
        (7, bytemuck::bytes_of(&given.air)),
    ];
    let is_used = uses(source);
    let given = all.iter().filter(|(binding, _)| is_used(*binding));
    let given = given.map(|&(binding, bytes)| (binding, buffer("given", bytes))).collect();
    let probes = buffer("questions", bytemuck::cast_slice(questions));

    let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some("probe"),
        source: wgpu::ShaderSource::Wgsl(source.into()),
    });
    let pipeline = gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some("probe"),
        layout: None,
        module: &module,
        entry_point: Some("probe"),
        compilation_options: wgpu::PipelineCompilationOptions::default(),
        cache: None,
    });
    let groups: [Vec<(u32, wgpu::Buffer)>; 2] = [given, vec![(0, probes.clone())]];
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(&pipeline);
        for (index, group) in (0..).zip(&groups) {
            let entries: Vec<_> = group
                .iter()
                .map(|(binding, buffer)| wgpu::BindGroupEntry {
                    binding: *binding,
                    resource: buffer.as_entire_binding(),
                })
                .collect();
            let bound = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("probe"),
                layout: &pipeline.get_bind_group_layout(index),
                entries: &entries,
            });
            pass.set_bind_group(index, &bound, &[]);
        }
        pass.dispatch_workgroups(u32::try_from(questions.len()).unwrap().div_ceil(64), 1, 1);
    }
    gpu.queue.submit([encoder.finish()]);
    bytemuck::cast_slice(&read_buffer(gpu, &probes)).to_vec()
}

/// The bytes that the entry point `probe` writes at `group(2) binding(0)`, beside the bound groups 0,
/// 1 and 3.
pub(crate) fn probe(
    gpu: &Gpu,
    source: &str,
    layouts: [&wgpu::BindGroupLayout; 3],
    groups: [Option<&wgpu::BindGroup>; 3],
    bytes: u64,
    workgroups: u32,
) -> Vec<u8> {
    let answers = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("answers"),
        size: bytes,
        usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC,
        mapped_at_creation: false,
    });
    let layout = gpu.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("answers"),
        entries: &[wgpu::BindGroupLayoutEntry {
            binding: 0,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty: wgpu::BindingType::Buffer {
                ty: wgpu::BufferBindingType::Storage { read_only: false },
                has_dynamic_offset: false,
                min_binding_size: None,
            },
            count: None,
        }],
    });
    let bound = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("answers"),
        layout: &layout,
        entries: &[wgpu::BindGroupEntry { binding: 0, resource: answers.as_entire_binding() }],
    });
    let pipeline_layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some("probe"),
        bind_group_layouts: &[Some(layouts[0]), Some(layouts[1]), Some(&layout), Some(layouts[2])],
        immediate_size: 0,
    });
    let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some("probe"),
        source: wgpu::ShaderSource::Wgsl(source.into()),
    });
    let pipeline = gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some("probe"),
        layout: Some(&pipeline_layout),
        module: &module,
        entry_point: Some("probe"),
        compilation_options: wgpu::PipelineCompilationOptions::default(),
        cache: None,
    });
    let mut encoder = gpu.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, groups[0], &[]);
        pass.set_bind_group(1, groups[1], &[]);
        pass.set_bind_group(2, &bound, &[]);
        pass.set_bind_group(3, groups[2], &[]);
        pass.dispatch_workgroups(workgroups, 1, 1);
    }
    gpu.queue.submit([encoder.finish()]);
    read_buffer(gpu, &answers)
}
