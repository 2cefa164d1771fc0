//! The panel's pixels: egui over the finished picture.

use winit::event::WindowEvent;
use winit::window::Window;

use crate::gpu::Gpu;

/// egui for one window.
pub(super) struct Painter {
    context: egui::Context,
    input: egui_winit::State,
    renderer: egui_wgpu::Renderer,
}

/// Triangles to paint, and what they are painted with.
pub(super) struct Painted {
    shapes: Vec<egui::ClippedPrimitive>,
    textures: egui::TexturesDelta,
    screen: egui_wgpu::ScreenDescriptor,
    /// Whether the panel moves and wants another frame.
    pub(super) is_moving: bool,
}

impl Painter {
    pub(super) fn new(gpu: &Gpu, window: &Window, format: wgpu::TextureFormat) -> Self {
        let context = egui::Context::default();
        context.set_theme(egui::Theme::Dark);
        let side = gpu.device.limits().max_texture_dimension_2d as usize;
        let input = egui_winit::State::new(
            context.clone(),
            egui::ViewportId::ROOT,
            window,
            None,
            None,
            Some(side),
        );
        let options = egui_wgpu::RendererOptions::PREDICTABLE;
        let renderer = egui_wgpu::Renderer::new(&gpu.device, format, options);
        Self { context, input, renderer }
    }

    /// Tells the panel of an event: whether it is the panel's alone, and whether the panel changes.
    pub(super) fn hears(&mut self, window: &Window, event: &WindowEvent) -> (bool, bool) {
        let response = self.input.on_window_event(window, event);
        let is_pointer = matches!(
            event,
            WindowEvent::CursorMoved { .. }
                | WindowEvent::MouseInput { .. }
                | WindowEvent::MouseWheel { .. }
        );
        let is_taken = response.consumed || (is_pointer && self.context.egui_wants_pointer_input());
        (is_taken, response.repaint)
    }

    /// Runs the panel.
    pub(super) fn run(&mut self, window: &Window, mut show: impl FnMut(&egui::Context)) -> Painted {
        let input = self.input.take_egui_input(window);
        let output = self.context.run_pass(input, |context| show(context));
        self.input.handle_platform_output(window, output.platform_output);
        let soon = std::time::Duration::from_millis(500);
        let mut views = output.viewport_output.values();
        let is_moving = views.any(|view| view.repaint_delay < soon);
        let size = window.inner_size();
        Painted {
            shapes: self.context.tessellate(output.shapes, output.pixels_per_point),
            textures: output.textures_delta,
            screen: egui_wgpu::ScreenDescriptor {
                size_in_pixels: [size.width.max(1), size.height.max(1)],
                pixels_per_point: output.pixels_per_point,
            },
            is_moving,
        }
    }

    /// Paints over a picture, once.
    pub(super) fn paint(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        target: &wgpu::TextureView,
        painted: &mut Painted,
    ) {
        let Painted { shapes, textures, screen, .. } = painted;
        for (id, deltas) in &textures.set {
            for delta in deltas {
                self.renderer.update_texture(&gpu.device, &gpu.queue, *id, delta);
            }
        }
        let buffers =
            self.renderer.update_buffers(&gpu.device, &gpu.queue, encoder, shapes, screen);
        gpu.queue.submit(buffers);
        let pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("panel"),
            color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                view: target,
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store },
            })],
            ..Default::default()
        });
        self.renderer.render(&mut pass.forget_lifetime(), shapes, screen);
        for id in &textures.free {
            self.renderer.free_texture(id);
        }
        textures.clear();
    }
}

impl std::fmt::Debug for Painter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Painter").finish_non_exhaustive()
    }
}
