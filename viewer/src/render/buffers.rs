//! GPU buffers that follow the sizes of what is written to them.

use crate::gpu::Gpu;

/// A storage buffer that grows.
#[derive(Debug)]
pub(crate) struct Growing {
    label: &'static str,
    buffer: wgpu::Buffer,
}

/// Bytes at first: no binding may be empty.
const FIRST_BYTES: u64 = 1024;

impl Growing {
    pub(crate) fn new(gpu: &Gpu, label: &'static str) -> Self {
        Self { label, buffer: create(gpu, label, FIRST_BYTES) }
    }

    /// Writes all of `items`; whether the buffer is another one now.
    pub(crate) fn write<T: bytemuck::NoUninit>(&mut self, gpu: &Gpu, items: &[T]) -> bool {
        let bytes: &[u8] = bytemuck::cast_slice(items);
        let grows = self.reserve(gpu, bytes.len() as u64);
        gpu.queue.write_buffer(&self.buffer, 0, bytes);
        grows
    }

    /// Makes room for so many bytes that the GPU writes; whether the buffer is another one now.
    pub(crate) fn reserve(&mut self, gpu: &Gpu, bytes: u64) -> bool {
        let grows = bytes > self.buffer.size();
        if grows {
            self.buffer =
                create(gpu, self.label, bytes.next_power_of_two().min(most_bytes(gpu)).max(bytes));
        }
        grows
    }

    pub(crate) fn binding(&self) -> wgpu::BindingResource<'_> {
        self.buffer.as_entire_binding()
    }
}

/// Bytes of a buffer at most.
pub(crate) fn most_bytes(gpu: &Gpu) -> u64 {
    let limits = gpu.device.limits();
    limits.max_storage_buffer_binding_size.min(limits.max_buffer_size)
}

fn create(gpu: &Gpu, label: &str, size: u64) -> wgpu::Buffer {
    gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some(label),
        size,
        usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}
