//! A window's surface, and the finished picture onto it.

use std::sync::Arc;

use winit::window::Window;

use super::WindowError;
use crate::gpu::Gpu;

/// A configured surface.
#[derive(Debug)]
pub(super) struct Presenter {
    gpu: Gpu,
    window: Arc<Window>,
    surface: wgpu::Surface<'static>,
    configuration: wgpu::SurfaceConfiguration,
    layout: wgpu::BindGroupLayout,
    pipeline: wgpu::RenderPipeline,
}

impl Presenter {
    /// A surface for `window`, and the device that serves it.
    pub(super) fn new(instance: &wgpu::Instance, window: Arc<Window>) -> Result<Self, WindowError> {
        let surface = instance.create_surface(Arc::clone(&window)).map_err(WindowError::Surface)?;
        let gpu = Gpu::from_instance(instance, Some(&surface))?;
        let size = window.inner_size();
        let mut configuration = surface
            .get_default_config(&gpu.adapter, size.width.max(1), size.height.max(1))
            .ok_or(WindowError::Unsupported)?;
        let formats = surface.get_capabilities(&gpu.adapter).formats;
        if let Some(format) = formats.iter().find(|format| !format.is_srgb()) {
            configuration.format = *format;
        }
        configuration.present_mode = wgpu::PresentMode::Fifo;
        surface.configure(&gpu.device, &configuration);

        let (layout, pipeline) = pipeline(&gpu, configuration.format);
        Ok(Self { gpu, window, surface, configuration, layout, pipeline })
    }

    pub(super) fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    pub(super) fn window(&self) -> &Window {
        &self.window
    }

    /// Pixels of the surface, at least one a side.
    pub(super) fn viewport(&self) -> [u32; 2] {
        [self.configuration.width, self.configuration.height]
    }

    pub(super) fn resize(&mut self, width: u32, height: u32) {
        self.configuration.width = width.max(1);
        self.configuration.height = height.max(1);
        self.surface.configure(&self.gpu.device, &self.configuration);
    }

    /// Shows a picture of the surface's size; whether it could.
    pub(super) fn present(&mut self, picture: &wgpu::Texture) -> bool {
        use wgpu::CurrentSurfaceTexture::{Lost, Outdated, Suboptimal, Success};

        let frame = match self.surface.get_current_texture() {
            Success(frame) | Suboptimal(frame) => frame,
            Outdated | Lost => {
                self.surface.configure(&self.gpu.device, &self.configuration);
                return false;
            }
            _ => return false,
        };
        let picture = picture.create_view(&wgpu::TextureViewDescriptor::default());
        let group = self.gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("present"),
            layout: &self.layout,
            entries: &[wgpu::BindGroupEntry {
                binding: 0,
                resource: wgpu::BindingResource::TextureView(&picture),
            }],
        });
        let view = frame.texture.create_view(&wgpu::TextureViewDescriptor::default());
        let descriptor = wgpu::CommandEncoderDescriptor { label: Some("present") };
        let mut encoder = self.gpu.device.create_command_encoder(&descriptor);
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("present"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &view,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations::default(),
                })],
                ..Default::default()
            });
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &group, &[]);
            pass.draw(0..3, 0..1);
        }
        self.gpu.queue.submit([encoder.finish()]);
        self.window.pre_present_notify();
        self.gpu.queue.present(frame);
        true
    }
}

fn pipeline(
    gpu: &Gpu,
    format: wgpu::TextureFormat,
) -> (wgpu::BindGroupLayout, wgpu::RenderPipeline) {
    let layout = gpu.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
        label: Some("present"),
        entries: &[wgpu::BindGroupLayoutEntry {
            binding: 0,
            visibility: wgpu::ShaderStages::FRAGMENT,
            ty: wgpu::BindingType::Texture {
                sample_type: wgpu::TextureSampleType::Float { filterable: false },
                view_dimension: wgpu::TextureViewDimension::D2,
                multisampled: false,
            },
            count: None,
        }],
    });
    let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some("present"),
        source: wgpu::ShaderSource::Wgsl(crate::shader::PRESENT.into()),
    });
    let pipeline_layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some("present"),
        bind_group_layouts: &[Some(&layout)],
        immediate_size: 0,
    });
    let constants = [("ENCODES", f64::from(u8::from(format.is_srgb())))];
    let pipeline = gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("present"),
        layout: Some(&pipeline_layout),
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("whole_screen"),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: None,
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some("present"),
            compilation_options: wgpu::PipelineCompilationOptions {
                constants: &constants,
                ..Default::default()
            },
            targets: &[Some(format.into())],
        }),
        multiview_mask: None,
        cache: None,
    });
    (layout, pipeline)
}
