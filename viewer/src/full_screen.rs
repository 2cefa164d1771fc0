//! Passes over a whole picture: one triangle that covers it.

use crate::gpu::Gpu;

/// What such a pass runs: a shader whose vertices are `whole_screen`'s.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FullScreen<'a> {
    pub(crate) label: &'a str,
    pub(crate) source: &'a str,
    /// Of its fragments.
    pub(crate) entry_point: &'a str,
    pub(crate) constants: &'a [(&'a str, f64)],
    pub(crate) groups: &'a [&'a wgpu::BindGroupLayout],
    pub(crate) format: wgpu::TextureFormat,
}

impl FullScreen<'_> {
    /// The pipeline.
    pub(crate) fn pipeline(&self, gpu: &Gpu) -> wgpu::RenderPipeline {
        let label = Some(self.label);
        let groups: Vec<_> = self.groups.iter().map(|&group| Some(group)).collect();
        let layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label,
            bind_group_layouts: &groups,
            immediate_size: 0,
        });
        let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label,
            source: wgpu::ShaderSource::Wgsl(self.source.into()),
        });
        let options =
            || wgpu::PipelineCompilationOptions { constants: self.constants, ..Default::default() };
        gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label,
            layout: Some(&layout),
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: Some("whole_screen"),
                compilation_options: options(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: None,
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: &module,
                entry_point: Some(self.entry_point),
                compilation_options: options(),
                targets: &[Some(self.format.into())],
            }),
            multiview_mask: None,
            cache: None,
        })
    }
}
