//! The cheapest whole picture that a device can draw: what the cost of a frame is measured in.

use crate::full_screen::FullScreen;
use crate::gpu::Gpu;

/// One pass over a picture that computes nothing worth the name.
#[derive(Debug)]
pub struct Yardstick {
    gpu: Gpu,
    pipeline: wgpu::RenderPipeline,
    picture: wgpu::TextureView,
}

pub(crate) const SHADER: &str = include_str!("shader/yardstick.wgsl");

impl Yardstick {
    /// A pass over a picture of some pixels.
    #[must_use]
    pub fn new(gpu: &Gpu, [width, height]: [u32; 2]) -> Self {
        const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;
        let pass = FullScreen {
            label: "yardstick",
            source: SHADER,
            entry_point: "fill",
            constants: &[],
            groups: &[],
            format: FORMAT,
        };
        let pipeline = pass.pipeline(gpu);
        let picture = gpu.device.create_texture(&wgpu::TextureDescriptor {
            label: Some("yardstick"),
            size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: FORMAT,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
            view_formats: &[],
        });
        let picture = picture.create_view(&wgpu::TextureViewDescriptor::default());
        Self { gpu: gpu.clone(), pipeline, picture }
    }

    /// Draws it once; [`Gpu::wait`] tells when it is done.
    pub fn draw(&self) {
        let label = Some("yardstick");
        let descriptor = wgpu::CommandEncoderDescriptor { label };
        let mut encoder = self.gpu.device.create_command_encoder(&descriptor);
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label,
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &self.picture,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                        store: wgpu::StoreOp::Store,
                    },
                })],
                ..Default::default()
            });
            pass.set_pipeline(&self.pipeline);
            pass.draw(0..3, 0..1);
        }
        self.gpu.queue.submit([encoder.finish()]);
    }
}
