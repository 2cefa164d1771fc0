//! The triangles of any patch: a grid of steps from one corner toward the two others.

use crate::gpu::Gpu;
use crate::mesh::detail::SEGMENTS;

/// The triangles of any patch.
#[derive(Debug)]
pub(super) struct Pattern {
    pub(super) steps: wgpu::Buffer,
    pub(super) indices: wgpu::Buffer,
    pub(super) index_count: u32,
}

impl Pattern {
    pub(super) fn new(gpu: &Gpu) -> Self {
        let side = i32::try_from(SEGMENTS).expect("a patch has few segments");
        let steps: Vec<[i32; 2]> =
            (0..=side).flat_map(|b| (0..=side - b).map(move |c| [b, c])).collect();
        // Row b starts behind the rows before it, each one vertex shorter than the last.
        let vertex = |b: i32, c: i32| {
            u16::try_from(b * (side + 1) - b * (b - 1) / 2 + c).expect("a patch has few vertices")
        };
        let mut indices: Vec<u16> = Vec::new();
        for b in 0..side {
            for c in 0..side - b {
                indices.extend([vertex(b, c), vertex(b + 1, c), vertex(b, c + 1)]);
                if b + c < side - 1 {
                    indices.extend([vertex(b + 1, c), vertex(b + 1, c + 1), vertex(b, c + 1)]);
                }
            }
        }
        let index_count = u32::try_from(indices.len()).expect("a patch has few triangles");
        if indices.len() % 2 == 1 {
            indices.push(0);
        }
        let buffer = |label, bytes: &[u8], usage| {
            let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some(label),
                size: bytes.len() as u64,
                usage: usage | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            });
            gpu.queue.write_buffer(&buffer, 0, bytes);
            buffer
        };
        let steps = buffer("steps", bytemuck::cast_slice(&steps), wgpu::BufferUsages::VERTEX);
        let indices = buffer("indices", bytemuck::cast_slice(&indices), wgpu::BufferUsages::INDEX);
        Self { steps, indices, index_count }
    }
}
