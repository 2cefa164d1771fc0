//! The window: a surface and a hand on the renderer that pictures without a window use too.
//!
//! | input | does |
//! |---|---|
//! | left drag, arrow keys | moves the ground |
//! | wheel, `+`, `-` | nearer and farther, from space to the ground |
//! | right drag, or left drag with Shift | turns and tilts |
//! | `N` | north ahead |
//! | `E` | heights 1, 2, 4, 8 times |
//! | `Esc` | ends |
//!
//! It draws when the view or its pages change, and not otherwise.

mod presenter;

use std::sync::Arc;
use std::time::{Duration, Instant};

use areoid_cache::{Selection, View};
use areoid_formats::body::Ellipsoid;
use areoid_formats::geodesy::{Geographic, surface_normal};
use areoid_formats::units::{Meters, Radians};
use glam::DVec2;
use winit::application::ApplicationHandler;
use winit::dpi::LogicalSize;
use winit::event::{ElementState, MouseButton, MouseScrollDelta, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop};
use winit::keyboard::{Key, ModifiersState, NamedKey};
use winit::window::{Window, WindowId};

use crate::camera::pixel_angle;
use crate::gpu::GpuError;
use crate::orbit::Orbit;
use crate::render::{Light, Options, Renderer};
use presenter::Presenter;

/// What a window starts with.
#[derive(Clone, Debug, PartialEq)]
pub struct WindowOptions {
    /// In the title bar.
    pub title: String,
    /// The body shown.
    pub ellipsoid: Ellipsoid,
    /// Above which place.
    pub start: Geographic,
    /// The error that may show, in pixels.
    pub tolerance_px: f64,
}

/// Why a window cannot be shown.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WindowError {
    /// There is no display, or it broke off.
    #[error("no window")]
    EventLoop(#[source] winit::error::EventLoopError),
    /// The display gives no window.
    #[error("no window")]
    Window(#[source] winit::error::OsError),
    /// The window gives no surface to draw on.
    #[error("the window cannot be drawn on")]
    Surface(#[source] wgpu::CreateSurfaceError),
    /// The adapter cannot present to it.
    #[error("the graphics adapter cannot present to the window")]
    Unsupported,
    /// There is nothing to draw with.
    #[error(transparent)]
    Gpu(#[from] GpuError),
}

/// How often a view at rest asks whether pages came while some are missing, and while none is.
const POLL_MISSING: Duration = Duration::from_millis(30);
const POLL_COMPLETE: Duration = Duration::from_millis(250);
/// Bytes of pages to the GPU in a frame.
const UPLOAD_LIMIT_BYTES: u64 = 16 << 20;
const VERTICAL_FOV: Radians = Radians(std::f64::consts::FRAC_PI_4);
const AMBIENT: f64 = 0.06;
/// Pixels that an arrow key drags.
const KEY_STEP_PX: f64 = 60.0;
/// Radians to a pixel of a turning drag.
const TURN_PER_PX: f64 = 0.005;
/// Nearer by this much for a notch of the wheel.
const NOTCH: f64 = 0.8;
/// Pixels of a touchpad that make a notch.
const PX_PER_NOTCH: f64 = 40.0;

/// Shows a window until it is closed. `update` answers a view with the pages in memory and never
/// waits; it is called on this thread.
///
/// # Errors
///
/// Any [`WindowError`].
pub fn run(
    options: WindowOptions,
    update: impl FnMut(&View) -> Arc<Selection>,
) -> Result<(), WindowError> {
    let mut builder = EventLoop::builder();
    // Tests do not run on the main thread.
    #[cfg(all(test, target_os = "linux"))]
    winit::platform::x11::EventLoopBuilderExtX11::with_any_thread(&mut builder, true);
    let event_loop = builder.build().map_err(WindowError::EventLoop)?;
    let orbit =
        Orbit::above(options.ellipsoid, options.start, Meters(3.0 * options.ellipsoid.a().0));
    let drawing = Options { upload_limit_bytes: UPLOAD_LIMIT_BYTES, ..Options::default() };
    let mut viewer = Viewer {
        options,
        update,
        drawing,
        orbit,
        stage: None,
        pointer: Pointer::default(),
        outcome: Ok(()),
    };
    event_loop.run_app(&mut viewer).map_err(WindowError::EventLoop)?;
    viewer.outcome
}

/// The state of a running window.
struct Viewer<U> {
    options: WindowOptions,
    update: U,
    drawing: Options,
    orbit: Orbit,
    stage: Option<Stage>,
    pointer: Pointer,
    outcome: Result<(), WindowError>,
}

/// What exists once there is a window.
struct Stage {
    presenter: Presenter,
    renderer: Renderer,
    /// What was drawn last: the same twice is not drawn.
    drawn: Option<(View, u64, f64)>,
    /// Whether the last frame left something to do.
    unfinished: bool,
    /// Whether pages are on their way.
    missing: bool,
}

#[derive(Debug, Default)]
struct Pointer {
    position: DVec2,
    left: bool,
    right: bool,
    modifiers: ModifiersState,
}

impl<U: FnMut(&View) -> Arc<Selection>> Viewer<U> {
    fn open(&self, event_loop: &ActiveEventLoop) -> Result<Stage, WindowError> {
        let attributes = Window::default_attributes()
            .with_title(&self.options.title)
            .with_inner_size(LogicalSize::new(1280, 720));
        let window = event_loop.create_window(attributes).map_err(WindowError::Window)?;
        let display = Box::new(event_loop.owned_display_handle());
        let mut descriptor = wgpu::InstanceDescriptor::new_with_display_handle(display);
        descriptor.backends = wgpu::Backends::VULKAN | wgpu::Backends::GL;
        let instance = wgpu::Instance::new(descriptor);
        let presenter = Presenter::new(&instance, Arc::new(window))?;
        let renderer = Renderer::new(presenter.gpu(), self.options.ellipsoid);
        Ok(Stage { presenter, renderer, drawn: None, unfinished: true, missing: true })
    }

    fn view(&self, stage: &Stage) -> View {
        let pose = self.orbit.pose(|normal| stage.renderer.height_m(normal));
        pose.view(VERTICAL_FOV, stage.presenter.viewport(), self.options.tolerance_px)
    }

    /// Asks for pages, and draws if anything is new.
    fn draw(&mut self) {
        let Some(mut stage) = self.stage.take() else { return };
        let view = self.view(&stage);
        let selection = (self.update)(&view);
        let exaggeration = self.drawing.vertical_exaggeration;
        let state = (view, selection.generation, exaggeration);
        if stage.drawn != Some(state) || stage.unfinished {
            let over_left_shoulder = view.orientation.x_axis * -0.7 + view.orientation.y_axis * 0.5;
            let zenith = surface_normal(self.orbit.focus());
            let light = Light { toward_sun: zenith + over_left_shoulder, ambient: AMBIENT };
            let drawn = stage.renderer.render(&view, &selection, &light, &self.drawing);
            let shown = match stage.renderer.picture() {
                Some(picture) => stage.presenter.present(picture),
                None => false,
            };
            stage.unfinished = drawn.pending_pages > 0 || !shown;
            stage.drawn = Some(state);
        }
        stage.missing = selection.missing > 0;
        self.stage = Some(stage);
    }

    fn pixel_angle(&self) -> f64 {
        self.stage.as_ref().map_or(0.0, |stage| pixel_angle(&self.view(stage)))
    }

    fn moved(&mut self, to: DVec2) {
        let by = to - self.pointer.position;
        self.pointer.position = to;
        let turns = self.pointer.right || (self.pointer.left && self.pointer.modifiers.shift_key());
        if turns {
            self.orbit.turn(Radians(by.x * TURN_PER_PX), Radians(-by.y * TURN_PER_PX));
        } else if self.pointer.left {
            self.orbit.drag(by.x, by.y, self.pixel_angle());
        } else {
            return;
        }
        self.ask_for_a_frame();
    }

    fn pressed(&mut self, event_loop: &ActiveEventLoop, key: &Key) {
        let step = KEY_STEP_PX;
        match key.as_ref() {
            Key::Named(NamedKey::Escape) => event_loop.exit(),
            Key::Named(NamedKey::ArrowLeft) => self.orbit.drag(step, 0.0, self.pixel_angle()),
            Key::Named(NamedKey::ArrowRight) => self.orbit.drag(-step, 0.0, self.pixel_angle()),
            Key::Named(NamedKey::ArrowUp) => self.orbit.drag(0.0, step, self.pixel_angle()),
            Key::Named(NamedKey::ArrowDown) => self.orbit.drag(0.0, -step, self.pixel_angle()),
            Key::Character("+" | "=") => self.orbit.zoom(NOTCH),
            Key::Character("-") => self.orbit.zoom(1.0 / NOTCH),
            Key::Character("n" | "N") => self.orbit.face_north(),
            Key::Character("e" | "E") => {
                let next = 2.0 * self.drawing.vertical_exaggeration;
                self.drawing.vertical_exaggeration = if next > 8.0 { 1.0 } else { next };
            }
            _ => return,
        }
        self.ask_for_a_frame();
    }

    fn ask_for_a_frame(&self) {
        if let Some(stage) = &self.stage {
            stage.presenter.window().request_redraw();
        }
    }
}

impl<U: FnMut(&View) -> Arc<Selection>> ApplicationHandler for Viewer<U> {
    fn resumed(&mut self, event_loop: &ActiveEventLoop) {
        if self.stage.is_some() {
            return;
        }
        match self.open(event_loop) {
            Ok(stage) => self.stage = Some(stage),
            Err(error) => {
                self.outcome = Err(error);
                event_loop.exit();
            }
        }
    }

    fn window_event(&mut self, event_loop: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        match event {
            WindowEvent::CloseRequested => event_loop.exit(),
            WindowEvent::Resized(size) => {
                if let Some(stage) = &mut self.stage {
                    stage.presenter.resize(size.width, size.height);
                }
                self.ask_for_a_frame();
            }
            WindowEvent::RedrawRequested => {
                // What the window showed may be gone: an equal frame counts as a new one.
                if let Some(stage) = &mut self.stage {
                    stage.unfinished = true;
                }
                self.draw();
            }
            WindowEvent::CursorMoved { position, .. } => {
                self.moved(DVec2::new(position.x, position.y));
            }
            WindowEvent::MouseInput { state, button, .. } => {
                let down = state == ElementState::Pressed;
                match button {
                    MouseButton::Left => self.pointer.left = down,
                    MouseButton::Right => self.pointer.right = down,
                    _ => {}
                }
            }
            WindowEvent::MouseWheel { delta, .. } => {
                let notches = match delta {
                    MouseScrollDelta::LineDelta(_, lines) => f64::from(lines),
                    MouseScrollDelta::PixelDelta(pixels) => pixels.y / PX_PER_NOTCH,
                };
                self.orbit.zoom(NOTCH.powf(notches));
                self.ask_for_a_frame();
            }
            WindowEvent::ModifiersChanged(modifiers) => {
                self.pointer.modifiers = modifiers.state();
            }
            WindowEvent::KeyboardInput { event, .. } if event.state == ElementState::Pressed => {
                self.pressed(event_loop, &event.logical_key);
            }
            _ => {}
        }
    }

    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        self.draw();
        let busy = self.stage.as_ref().is_some_and(|stage| stage.unfinished || stage.missing);
        let rest = if busy { POLL_MISSING } else { POLL_COMPLETE };
        event_loop.set_control_flow(ControlFlow::WaitUntil(Instant::now() + rest));
    }
}
