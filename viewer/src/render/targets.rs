//! What a picture is drawn into, in the size of the viewport.

use super::pipelines::{DEFERRED, DEPTH, PICTURE};
use crate::gpu::Gpu;

/// Textures of one viewport.
#[derive(Debug)]
pub(crate) struct Targets {
    pub(crate) viewport: [u32; 2],
    pub(crate) deferred: wgpu::Texture,
    pub(crate) depth: wgpu::Texture,
    pub(crate) picture: wgpu::Texture,
    /// Two numbers a pixel, written when they are asked for.
    pub(crate) measures: wgpu::Buffer,
}

/// Bytes of a measured pixel.
pub(crate) const MEASURE_LEN: u64 = 8;

impl Targets {
    pub(crate) fn new(gpu: &Gpu, viewport: [u32; 2]) -> Self {
        let [width, height] = viewport;
        let texture = |label, format| {
            gpu.device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage: wgpu::TextureUsages::RENDER_ATTACHMENT
                    | wgpu::TextureUsages::TEXTURE_BINDING
                    | wgpu::TextureUsages::COPY_SRC,
                view_formats: &[],
            })
        };
        Self {
            viewport,
            deferred: texture("deferred", DEFERRED),
            depth: texture("depth", DEPTH),
            picture: texture("picture", PICTURE),
            measures: gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("measures"),
                size: u64::from(width) * u64::from(height) * MEASURE_LEN,
                usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC,
                mapped_at_creation: false,
            }),
        }
    }
}

/// The bytes of a texture, row by row without padding. Waits for the GPU.
pub(crate) fn read_texture(gpu: &Gpu, texture: &wgpu::Texture) -> Vec<u8> {
    let texel = texture.format().block_copy_size(None).expect("color formats have a size");
    let row = texture.width() * texel;
    let padded = row.next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
    let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("texture on its way back"),
        size: u64::from(padded) * u64::from(texture.height()),
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let descriptor = wgpu::CommandEncoderDescriptor { label: Some("read a texture") };
    let mut encoder = gpu.device.create_command_encoder(&descriptor);
    encoder.copy_texture_to_buffer(
        texture.as_image_copy(),
        wgpu::TexelCopyBufferInfo {
            buffer: &buffer,
            layout: wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(padded),
                rows_per_image: None,
            },
        },
        texture.size(),
    );
    gpu.queue.submit([encoder.finish()]);
    let bytes = map(gpu, &buffer);
    bytes.chunks(padded as usize).flat_map(|line| &line[..row as usize]).copied().collect()
}

/// The bytes of a buffer. Waits for the GPU.
pub(crate) fn read_buffer(gpu: &Gpu, source: &wgpu::Buffer) -> Vec<u8> {
    let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("buffer on its way back"),
        size: source.size(),
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let descriptor = wgpu::CommandEncoderDescriptor { label: Some("read a buffer") };
    let mut encoder = gpu.device.create_command_encoder(&descriptor);
    encoder.copy_buffer_to_buffer(source, 0, &buffer, 0, source.size());
    gpu.queue.submit([encoder.finish()]);
    map(gpu, &buffer)
}

fn map(gpu: &Gpu, buffer: &wgpu::Buffer) -> Vec<u8> {
    buffer.slice(..).map_async(wgpu::MapMode::Read, |_| {});
    gpu.device.poll(wgpu::PollType::wait_indefinitely()).expect("the device answers");
    let mapped = buffer.slice(..).get_mapped_range().expect("the wait above mapped it");
    mapped.to_vec()
}
