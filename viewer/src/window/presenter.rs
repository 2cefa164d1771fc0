//! A window's surface, and the finished picture onto it.

use std::sync::Arc;

use winit::window::Window;

use super::WindowError;
use super::painter::{Painted, Painter};
use crate::full_screen::FullScreen;
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

    /// Pixels of the surface, at least one a side.
    pub(super) fn viewport(&self) -> [u32; 2] {
        [self.configuration.width, self.configuration.height]
    }

    pub(super) fn resize(&mut self, width: u32, height: u32) {
        self.configuration.width = width.max(1);
        self.configuration.height = height.max(1);
        self.surface.configure(&self.gpu.device, &self.configuration);
    }

    /// The window.
    pub(super) fn window(&self) -> &Window {
        &self.window
    }

    /// What the surface's texels are.
    pub(super) fn format(&self) -> wgpu::TextureFormat {
        self.configuration.format
    }

    /// A frame to show pictures in, if the surface has one now.
    pub(super) fn begin(&mut self) -> Option<wgpu::SurfaceTexture> {
        use wgpu::CurrentSurfaceTexture::{Lost, Outdated, Suboptimal, Success};

        match self.surface.get_current_texture() {
            Success(frame) | Suboptimal(frame) => Some(frame),
            Outdated | Lost => {
                self.surface.configure(&self.gpu.device, &self.configuration);
                None
            }
            _ => None,
        }
    }

    /// Copies a picture into a frame, `left` pixels from its left edge.
    pub(super) fn show(&self, frame: &wgpu::SurfaceTexture, picture: &wgpu::Texture, left: u32) {
        let [width, height] = [picture.width(), picture.height()];
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
                    ops: wgpu::Operations {
                        load: if left == 0 {
                            wgpu::LoadOp::Clear(wgpu::Color::BLACK)
                        } else {
                            wgpu::LoadOp::Load
                        },
                        store: wgpu::StoreOp::Store,
                    },
                })],
                ..Default::default()
            });
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &group, &[]);
            pass.set_viewport(left as f32, 0.0, width as f32, height as f32, 0.0, 1.0);
            pass.draw(0..3, 0..1);
        }
        self.gpu.queue.submit([encoder.finish()]);
    }

    /// Paints the panel over a frame.
    pub(super) fn paint(
        &self,
        frame: &wgpu::SurfaceTexture,
        painter: &mut Painter,
        painted: &mut Painted,
    ) {
        let view = frame.texture.create_view(&wgpu::TextureViewDescriptor::default());
        let descriptor = wgpu::CommandEncoderDescriptor { label: Some("panel") };
        let mut encoder = self.gpu.device.create_command_encoder(&descriptor);
        painter.paint(&self.gpu, &mut encoder, &view, painted);
        self.gpu.queue.submit([encoder.finish()]);
    }

    /// Hands a frame to the display.
    pub(super) fn end(&self, frame: wgpu::SurfaceTexture) {
        self.window.pre_present_notify();
        self.gpu.queue.present(frame);
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
    let constants = &[("ENCODES", f64::from(u8::from(format.is_srgb())))];
    let (label, source, entry_point) = ("present", crate::shader::PRESENT, "present");
    let groups = &[&layout];
    let pass = FullScreen { label, source, entry_point, constants, groups, format };
    let pipeline = pass.pipeline(gpu);
    (layout, pipeline)
}
