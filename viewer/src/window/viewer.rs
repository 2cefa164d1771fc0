//! The running window: events in, frames out.

use std::sync::Arc;
use std::time::{Duration, Instant};

use areoid_cache::flight::Key;
use areoid_cache::{Selection, View};
use areoid_formats::units::{Meters, Radians};
use winit::application::ApplicationHandler;
use winit::dpi::LogicalSize;
use winit::event::{ElementState, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow};
use winit::window::{Window, WindowId};

use super::hand::{Hand, Order, press};
use super::host::{Content, Host, InsertionState};
use super::painter::Painter;
use super::panel::{Figures, Panel, Wish};
use super::presenter::Presenter;
use super::record::key_of;
use super::settings::Settings;
use super::{WindowError, WindowOptions};
use crate::camera::pixel_angle;
use crate::orbit::Orbit;
use crate::render::{Image, Options, Renderer};

/// How often a window at rest looks whether pages came while some are missing, and while none is.
const POLL_BUSY: Duration = Duration::from_millis(16);
const POLL_REST: Duration = Duration::from_millis(250);
const VERTICAL_FOV: Radians = Radians(std::f64::consts::FRAC_PI_4);
/// Keys of a recorded flight stand so far apart.
const RECORD_EVERY_SECONDS: f64 = 0.1;

/// The state of a running window.
pub(super) struct Viewer<H> {
    options: WindowOptions,
    host: H,
    settings: Settings,
    /// The second is for the place beside.
    orbits: [Orbit; 2],
    /// Which of them the hand is on.
    active: usize,
    hand: Hand,
    panel: Panel,
    is_panel_shown: bool,
    figures: Figures,
    bookmarks: Vec<Orbit>,
    recording: Option<(Instant, Vec<Key>)>,
    /// Files that are being written.
    saving: usize,
    stage: Option<Stage>,
    start: Instant,
    pub(super) outcome: Result<(), WindowError>,
}

/// What exists once there is a window.
struct Stage {
    presenter: Presenter,
    renderer: Renderer,
    painter: Painter,
    /// What was drawn last: the same twice is not drawn.
    drawn: Option<(Vec<View>, u64, Settings)>,
    /// Whether the last frame left something to do, and whether the panel changes.
    unfinished: bool,
    /// Whether pages are on their way, or an insertion is.
    is_busy: bool,
    /// Whether what is drawn next is saved.
    saves_picture: bool,
}

impl<H: Host> Viewer<H> {
    pub(super) fn new(options: WindowOptions, host: H) -> Self {
        let far = Meters(3.0 * options.ellipsoid.a().0);
        let orbit = Orbit::above(options.ellipsoid, options.start, far);
        Self {
            settings: Settings::new(options.tolerance_px, options.style.clone()),
            orbits: [orbit; 2],
            active: 0,
            hand: Hand::default(),
            panel: Panel::default(),
            is_panel_shown: true,
            figures: Figures::default(),
            bookmarks: Vec::new(),
            recording: None,
            saving: 0,
            stage: None,
            start: Instant::now(),
            outcome: Ok(()),
            options,
            host,
        }
    }

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
        let gpu = presenter.gpu();
        let renderer =
            Renderer::with_budget(gpu, self.options.ellipsoid, self.options.budget_bytes);
        let painter = Painter::new(gpu, presenter.window(), presenter.format());
        Ok(Stage {
            presenter,
            renderer,
            painter,
            drawn: None,
            unfinished: true,
            is_busy: true,
            saves_picture: false,
        })
    }

    /// The views that stand side by side.
    fn views(&self, stage: &Stage) -> Vec<View> {
        let poses = self.orbits.map(|orbit| orbit.pose(|normal| stage.renderer.height_m(normal)));
        let lens = (VERTICAL_FOV, self.settings.tolerance_px);
        let (range, viewport) = (self.orbits[0].range(), stage.presenter.viewport());
        self.settings.arrangement.views(poses, range, viewport, lens)
    }

    /// Asks for pages, and draws if anything is new.
    fn draw(&mut self) {
        let Some(mut stage) = self.stage.take() else { return };
        let views = self.views(&stage);
        let is_known = |(_, _, drawn): &(_, _, Settings)| drawn.style == self.settings.style;
        if !stage.drawn.as_ref().is_some_and(is_known) {
            self.host.follow(&self.settings.style);
        }
        self.host.exaggerate(self.settings.exaggeration);
        let selection = self.host.update(&views);
        self.record(&stage);
        let insertions = self.host.insertions();
        let changed = insertions != self.figures.insertions;
        self.figures.insertions = insertions;
        let is_new = stage.drawn.as_ref().is_none_or(|(drawn, generation, settings)| {
            *drawn != views || *generation != selection.generation || *settings != self.settings
        });
        let said = self.say_saved();
        if is_new || stage.unfinished || changed || said {
            self.show(&mut stage, views, &selection);
        }
        let is_inserting = |state: &InsertionState| matches!(state, InsertionState::Running(_));
        stage.is_busy = selection.missing > 0
            || self.recording.is_some()
            || self.saving > 0
            || self.figures.insertions.iter().any(|insertion| is_inserting(&insertion.state));
        self.stage = Some(stage);
    }

    fn show(&mut self, stage: &mut Stage, views: Vec<View>, selection: &Selection) {
        // First of all: what the panel wants painted is told once.
        let Some(frame) = stage.presenter.begin() else {
            stage.unfinished = true;
            return;
        };
        let settings_before = self.settings.clone();
        self.tell(stage, &views, selection);
        let datasets = self.host.datasets();
        let mut wishes = Vec::new();
        let mut painted = self.is_panel_shown.then(|| {
            let Stage { painter, presenter, .. } = &mut *stage;
            let (panel, settings, figures) = (&mut self.panel, &mut self.settings, &self.figures);
            painter.run(presenter.window(), |context| {
                wishes.extend(panel.show(context, settings, &datasets, figures));
            })
        });

        let began = Instant::now();
        let seconds = self.start.elapsed().as_secs_f64();
        let options = self.settings.options(&self.options.ellipsoid, seconds);
        let (mut left, mut unfinished) = (0, false);
        let mut saved = std::mem::take(&mut stage.saves_picture).then(Vec::new);
        for (place, view) in views.iter().enumerate() {
            let orbit = &self.orbits[self.settings.arrangement.pose_of(place)];
            let lit = &views[self.settings.arrangement.lit_as(place)];
            let [right, up] = [lit.orientation.x_axis, lit.orientation.y_axis];
            // What a frame may write the first view has written: all show the same pages.
            let left_bytes = if place == 0 { options.upload_limit_bytes } else { 0 };
            let options = Options { upload_limit_bytes: left_bytes, ..options.clone() };
            let light = self.settings.light(orbit.focus(), right, up);
            let drawn = stage.renderer.render(view, selection, &light, &options);
            if let Some(picture) = stage.renderer.picture() {
                stage.presenter.show(&frame, picture, left);
            }
            if let Some(saved) = &mut saved {
                saved.push(stage.renderer.read_color());
            }
            left += view.viewport[0];
            unfinished |= drawn.pending_pages + drawn.coming_pages > 0;
            if !drawn.is_same {
                self.figures.frame = drawn;
            }
        }
        self.figures.frame_ms = began.elapsed().as_secs_f64() * 1e3;
        if let Some(painted) = &mut painted {
            stage.presenter.paint(&frame, &mut stage.painter, painted);
        }
        stage.presenter.end(frame);
        let is_moving = painted.is_some_and(|painted| painted.is_moving);
        // Pages that this frame brought may say more of it than the panel did.
        let is_outdated = self.is_panel_shown && self.point_out(stage, &views, selection);
        stage.unfinished =
            unfinished || is_moving || is_outdated || settings_before != self.settings;
        stage.drawn = Some((views, selection.generation, self.settings.clone()));
        if let Some(pictures) = saved {
            self.save("areoid", Content::Picture(Image::side_by_side(&pictures)));
        }
        for wish in wishes {
            self.grant(&wish, stage);
        }
    }

    fn tell(&mut self, stage: &Stage, views: &[View], selection: &Selection) {
        let figures = &mut self.figures;
        (figures.missing, figures.wanted) = (selection.missing, selection.wanted);
        figures.met_px = selection.tolerance_px;
        figures.stats = self.host.stats();
        (figures.bookmarks, figures.is_recording) =
            (self.bookmarks.len(), self.recording.is_some());
        self.point_out(stage, views, selection);
    }

    /// Finds out what is under the cursor; whether that is something else than before.
    fn point_out(&mut self, stage: &Stage, views: &[View], selection: &Selection) -> bool {
        let pointer = self.hand.position;
        let mut left = 0.0;
        let under_cursor = views.iter().find_map(|view| {
            let pixel = [pointer.x - left, pointer.y];
            left += f64::from(view.viewport[0]);
            let is_over = (0.0..f64::from(view.viewport[0])).contains(&pixel[0]);
            is_over.then(|| stage.renderer.pick(view, pixel)).flatten()
        });
        let height = under_cursor.as_ref().and_then(|picked| picked.height);
        let info = height.and_then(|height| selection.datasets.get(height.dataset));
        self.figures.dataset = info.map(|info| info.name.clone()).unwrap_or_default();
        let is_new = under_cursor != self.figures.under_cursor;
        self.figures.under_cursor = under_cursor;
        is_new
    }

    /// The place that the hand moves: of two the one under the pointer.
    fn held(&self) -> usize {
        self.settings.arrangement.pose_of(self.active)
    }

    fn record(&mut self, stage: &Stage) {
        let held = self.orbits[self.held()];
        let Some((began, keys)) = &mut self.recording else { return };
        let seconds = began.elapsed().as_secs_f64();
        if keys.last().is_none_or(|last| seconds >= last.seconds + RECORD_EVERY_SECONDS) {
            let pose = held.pose(|normal| stage.renderer.height_m(normal));
            keys.push(key_of(&pose, &self.options.ellipsoid, seconds));
        }
    }

    fn grant(&mut self, wish: &Wish, stage: &mut Stage) {
        stage.unfinished = true;
        match wish {
            Wish::Insert(raster) => self.host.insert(std::path::Path::new(raster)),
            Wish::AddBookmark => self.bookmarks.push(self.orbits[self.held()]),
            Wish::GoTo(place) => {
                if let Some(orbit) = self.bookmarks.get(*place) {
                    self.orbits[self.held()] = *orbit;
                }
            }
            Wish::Record => match self.recording.take() {
                None => self.recording = Some((Instant::now(), Vec::new())),
                Some((_, keys)) => {
                    let flight = areoid_cache::flight::Flight::new(keys);
                    let json = flight.map_err(|error| error.to_string()).and_then(|flight| {
                        serde_json::to_string_pretty(&flight).map_err(|error| error.to_string())
                    });
                    match json {
                        Ok(json) => self.save("flight", Content::Json(json)),
                        Err(reason) => self.figures.message = reason,
                    }
                }
            },
            Wish::Screenshot => stage.saves_picture = true,
        }
    }

    fn save(&mut self, stem: &str, content: Content) {
        self.host.save(stem, content);
        self.saving += 1;
    }

    /// Says what became of files; whether there is anything new to say.
    fn say_saved(&mut self) -> bool {
        let mut is_new = false;
        while let Some(saved) = self.host.saved() {
            self.saving = self.saving.saturating_sub(1);
            self.figures.message = match saved {
                Ok(name) => format!("saved {name}"),
                Err(reason) => reason,
            };
            is_new = true;
        }
        is_new
    }

    fn pressed(&mut self, event_loop: &ActiveEventLoop, key: &winit::keyboard::Key) {
        let Some(mut stage) = self.stage.take() else { return };
        let pixel_angle = self.pixel_angle(&stage);
        let held = self.held();
        let orbit = &mut self.orbits[held];
        match press(key, orbit, &mut self.settings, pixel_angle) {
            Some(Order::End) => event_loop.exit(),
            Some(Order::AddBookmark) => self.grant(&Wish::AddBookmark, &mut stage),
            Some(Order::GoTo(place)) => self.grant(&Wish::GoTo(place), &mut stage),
            Some(Order::Record) => self.grant(&Wish::Record, &mut stage),
            Some(Order::Screenshot) => self.grant(&Wish::Screenshot, &mut stage),
            Some(Order::TogglePanel) => {
                self.is_panel_shown = !self.is_panel_shown;
                stage.unfinished = true;
            }
            None => {}
        }
        self.stage = Some(stage);
    }

    fn pixel_angle(&self, stage: &Stage) -> f64 {
        pixel_angle(&self.views(stage)[0])
    }
}

impl<H: Host> ApplicationHandler for Viewer<H> {
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
        let Some(stage) = &mut self.stage else { return };
        let is_taken = if self.is_panel_shown {
            let (is_taken, changes) = stage.painter.hears(stage.presenter.window(), &event);
            stage.unfinished |= changes;
            is_taken
        } else {
            false
        };
        match &event {
            WindowEvent::CloseRequested => event_loop.exit(),
            WindowEvent::Resized(size) => {
                stage.presenter.resize(size.width, size.height);
                stage.unfinished = true;
            }
            // What the window showed may be gone: an equal frame counts as a new one.
            WindowEvent::RedrawRequested => stage.unfinished = true,
            WindowEvent::DroppedFile(path) => self.host.insert(path),
            WindowEvent::KeyboardInput { event, .. } => {
                if event.state == ElementState::Pressed && !is_taken {
                    self.pressed(event_loop, &event.logical_key);
                }
            }
            _ if is_taken => self.hand.release(),
            event => {
                if let WindowEvent::CursorMoved { position, .. } = event {
                    let is_right = 2.0 * position.x > f64::from(stage.presenter.viewport()[0]);
                    self.active = self.settings.arrangement.pose_of(usize::from(is_right));
                    // The panel tells what is under the cursor.
                    stage.unfinished |= self.is_panel_shown;
                }
                let stage = self.stage.as_ref().expect("it was there at the top");
                let pixel_angle = self.pixel_angle(stage);
                let held = self.held();
                self.hand.point(event, &mut self.orbits[held], pixel_angle);
            }
        }
    }

    /// After the events of a turn: what they changed shows in the view.
    fn about_to_wait(&mut self, event_loop: &ActiveEventLoop) {
        self.draw();
        let busy = self.stage.as_ref().is_some_and(|stage| stage.unfinished || stage.is_busy);
        let rest = if busy { POLL_BUSY } else { POLL_REST };
        event_loop.set_control_flow(ControlFlow::WaitUntil(Instant::now() + rest));
    }
}

impl<H> std::fmt::Debug for Viewer<H> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Viewer").field("settings", &self.settings).finish_non_exhaustive()
    }
}
