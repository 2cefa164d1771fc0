//! Texels on their way to the GPU: a ring of mapped buffers that are used again, and what a frame may
//! write.

use std::num::NonZeroU64;
use std::time::{Duration, Instant};

use wgpu::util::StagingBelt;

use crate::gpu::Gpu;

/// What a frame may write.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Allowance {
    left_bytes: u64,
    time: Duration,
    /// When the first was written.
    began: Option<Instant>,
}

impl Allowance {
    pub(crate) const UNLIMITED: Self =
        Self { left_bytes: u64::MAX, time: Duration::MAX, began: None };

    /// So many bytes, and for so long from the first of them on: a page that has begun is written whole.
    /// What is no length of time is none, or an unlimited one.
    pub(crate) fn new(bytes: u64, seconds: f64) -> Self {
        let longest = if seconds > 0.0 { Duration::MAX } else { Duration::ZERO };
        let time = Duration::try_from_secs_f64(seconds).unwrap_or(longest);
        Self { left_bytes: bytes, time, began: None }
    }

    /// Whether another page may be written.
    pub(crate) fn has_more(&self) -> bool {
        let spent = self.began.map_or(Duration::ZERO, |began| began.elapsed());
        self.left_bytes > 0 && spent < self.time
    }

    /// A page is written.
    pub(crate) fn take(&mut self, bytes: u64) {
        self.began.get_or_insert_with(Instant::now);
        self.left_bytes = self.left_bytes.saturating_sub(bytes);
    }
}

/// The ring, and the commands that empty it.
#[derive(Debug)]
pub(crate) struct Uploads {
    ring: StagingBelt,
    encoder: Option<wgpu::CommandEncoder>,
    /// Written since the last submission.
    bytes: u64,
    row: Vec<u8>,
}

/// Texels of a page for one layer of a texture.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Target<'a> {
    pub(crate) texture: &'a wgpu::Texture,
    pub(crate) layer: u32,
    /// Rows, and texels of each.
    pub(crate) side: u32,
    pub(crate) bytes_per_texel: u32,
}

impl Uploads {
    const CHUNK_BYTES: u64 = 4 << 20;
    const ALIGNMENT: NonZeroU64 =
        NonZeroU64::new(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT as u64).expect("not 0");

    /// A ring that a submission made larger is not kept.
    const KEPT_BYTES: u64 = 32 << 20;

    pub(crate) fn new(gpu: &Gpu) -> Self {
        let ring = StagingBelt::new(gpu.device.clone(), Self::CHUNK_BYTES);
        Self { ring, encoder: None, bytes: 0, row: Vec::new() }
    }

    /// Writes a layer of a texture, row by row: `fill` appends the bytes of a row.
    pub(crate) fn write(
        &mut self,
        gpu: &Gpu,
        target: Target<'_>,
        mut fill: impl FnMut(usize, &mut Vec<u8>),
    ) {
        let Target { texture, layer, side, bytes_per_texel } = target;
        let pitch = (side * bytes_per_texel).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let Some(bytes) = NonZeroU64::new(u64::from(pitch) * u64::from(side)) else { return };
        let place = self.ring.allocate(bytes, Self::ALIGNMENT);
        let mut mapped = place.get_mapped_range_mut().expect("a ring's buffers are mapped");
        for row in 0..side as usize {
            self.row.clear();
            fill(row, &mut self.row);
            let start = row * pitch as usize;
            mapped.slice(start..start + self.row.len()).copy_from_slice(&self.row);
        }
        drop(mapped);
        let source = wgpu::TexelCopyBufferInfo {
            buffer: place.buffer(),
            layout: wgpu::TexelCopyBufferLayout {
                offset: place.offset(),
                bytes_per_row: Some(pitch),
                rows_per_image: Some(side),
            },
        };
        let target = wgpu::TexelCopyTextureInfo {
            origin: wgpu::Origin3d { x: 0, y: 0, z: layer },
            ..texture.as_image_copy()
        };
        let size = wgpu::Extent3d { width: side, height: side, depth_or_array_layers: 1 };
        let descriptor = wgpu::CommandEncoderDescriptor { label: Some("uploads") };
        let encoder = &mut self.encoder;
        encoder
            .get_or_insert_with(|| gpu.device.create_command_encoder(&descriptor))
            .copy_buffer_to_texture(source, target, size);
        self.bytes += bytes.get();
        if self.bytes >= Self::KEPT_BYTES {
            self.submit(gpu);
            // What is not in flight any more would be kept for good.
            self.ring = StagingBelt::new(gpu.device.clone(), Self::CHUNK_BYTES);
        }
    }

    /// Hands over what was written: commands submitted after it see it.
    pub(crate) fn submit(&mut self, gpu: &Gpu) {
        if let Some(encoder) = self.encoder.take() {
            self.ring.finish_and_recall_on_submit(&encoder);
            gpu.queue.submit([encoder.finish()]);
        }
        self.bytes = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_writes_so_many_bytes() {
        let mut allowance = Allowance::new(100, f64::INFINITY);
        assert!(allowance.has_more());
        allowance.take(99);
        assert!(allowance.has_more());
        allowance.take(1000);
        assert!(!allowance.has_more());
        assert!(!Allowance::new(0, 1.0).has_more());
    }

    #[test]
    fn a_frame_writes_for_so_long() {
        let mut allowance = Allowance::new(u64::MAX, 1e-9);
        assert!(allowance.has_more());
        allowance.take(1);
        std::thread::sleep(Duration::from_micros(10));
        assert!(!allowance.has_more());
        for seconds in [0.0, -1.0, f64::NAN, f64::NEG_INFINITY] {
            assert!(!Allowance::new(1, seconds).has_more(), "{seconds}");
        }
        for seconds in [f64::INFINITY, 1e300, 1e9] {
            let mut allowance = Allowance::new(u64::MAX, seconds);
            allowance.take(1);
            assert!(allowance.has_more(), "{seconds}");
        }
    }
}
