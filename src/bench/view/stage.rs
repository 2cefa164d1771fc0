//! Frames of one cache that are drawn again and again, each from a little farther on.

use std::time::{Duration, Instant};

use areoid_cache::{Cache, Session, View};
use areoid_formats::geodesy::{Geographic, surface_normal};
use areoid_formats::units::{Degrees, Meters};
use areoid_viewer::camera::Pose;
use areoid_viewer::yardstick::Yardstick;
use areoid_viewer::{Gpu, Light, Options, Renderer, Usage};

use crate::bench::cache::clock;

/// Above which place, and how the eye looks: degrees and meters.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spot {
    pub(super) position: [f64; 2],
    pub(super) altitude_m: f64,
    pub(super) look: [f64; 2],
}

/// The ground fills the picture.
pub(super) const OVER: Spot = Spot { position: [20.0, 10.0], altitude_m: 4e5, look: [0.0, -90.0] };

/// What a frame took.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Cost {
    /// From its begin until the GPU was done.
    pub(super) ms: f64,
    /// Of the thread, for selection, geometry and encoding.
    pub(super) cpu_ms: f64,
    /// Of that, for selection.
    pub(super) select_ms: f64,
    pub(super) patches: usize,
    pub(super) wanted: usize,
    pub(super) uploaded_bytes: u64,
    /// Whether the picture was not there already.
    pub(super) is_drawn: bool,
}

/// A renderer with something to draw.
#[derive(Debug)]
pub(super) struct Stage {
    gpu: Gpu,
    cache: Cache,
    session: Session,
    renderer: Renderer,
    size: [u32; 2],
    spot: Spot,
    first: Cost,
}

/// Pixels that the ground moves by from one frame to the next.
const STEP_PX: f64 = 1.0;

const FOV: Degrees = Degrees(45.0);

impl Stage {
    /// A stage with everything in memory that its first frames need, drawn once.
    pub(super) fn new(gpu: &Gpu, cache: Cache, size: [u32; 2], spot: Spot) -> Self {
        let mut session = cache.session();
        session.blends = true;
        let renderer = Renderer::new(gpu, cache.body().ellipsoid);
        let (gpu, first) = (gpu.clone(), Cost::default());
        let mut stage = Self { gpu, cache, session, renderer, size, spot, first };
        stage.settle();
        stage
    }

    /// Turns to another spot.
    pub(super) fn turn(&mut self, spot: Spot) {
        self.spot = spot;
        self.settle();
    }

    /// Turns to a spot and draws its frame of a number.
    pub(super) fn at(&mut self, spot: Spot, number: u32) -> Cost {
        self.turn(spot);
        self.frame(number)
    }

    /// What its first frame took.
    pub(super) fn first(&self) -> Cost {
        self.first
    }

    /// What the frame drawn last was made of.
    pub(super) fn usage(&self) -> Usage {
        self.renderer.read_usage()
    }

    pub(super) fn cache(&self) -> &Cache {
        &self.cache
    }

    fn settle(&mut self) {
        let view = self.view(0);
        drop(self.session.settle(&view));
        // A driver does more at the first time.
        self.first = self.frame(0);
    }

    /// Draws the frame of a number.
    pub(super) fn frame(&mut self, number: u32) -> Cost {
        let view = self.view(number);
        let zenith = surface_normal(self.place(number));
        let east = view.orientation.x_axis;
        let light = Light { toward_sun: zenith - 0.7 * east, ambient: 0.06 };
        let (begin, cpu) = (Instant::now(), clock());
        let selection = self.session.update(&view);
        let selected = clock() - cpu;
        let drawn = self.renderer.render(&view, &selection, &light, &Options::default());
        let encoded = clock() - cpu;
        self.gpu.wait();
        Cost {
            ms: ms(begin.elapsed()),
            cpu_ms: ms(encoded),
            select_ms: ms(selected),
            patches: drawn.patches,
            wanted: selection.wanted,
            uploaded_bytes: drawn.uploaded_bytes,
            is_drawn: !drawn.is_same,
        }
    }

    /// Along the meridian, so that poles are like other places.
    fn place(&self, number: u32) -> Geographic {
        let [_, height] = self.size.map(f64::from);
        let pixel_m = 2.0 * self.spot.altitude_m * (FOV.0.to_radians() / 2.0).tan() / height;
        let radius = self.cache.body().ellipsoid.a().0;
        let north = (STEP_PX * pixel_m / radius).to_degrees() * f64::from(number);
        let [longitude, latitude] = self.spot.position;
        let latitude = latitude + north;
        let (longitude, latitude) = match latitude {
            beyond if beyond > 90.0 => (longitude + 180.0, 180.0 - beyond),
            latitude => (longitude, latitude),
        };
        Geographic::from_degrees(Degrees(longitude), Degrees(latitude))
    }

    fn view(&self, number: u32) -> View {
        let [heading, pitch] = self.spot.look.map(Degrees);
        let ellipsoid = &self.cache.body().ellipsoid;
        let (place, altitude) = (self.place(number), Meters(self.spot.altitude_m));
        let pose = Pose::from_eye(ellipsoid, place, altitude, heading.into(), pitch.into());
        pose.view(FOV.into(), self.size, 1.0)
    }
}

/// What the cheapest picture takes.
pub(super) fn trivial(gpu: &Gpu, yardstick: &Yardstick) -> Cost {
    let (begin, cpu) = (Instant::now(), clock());
    yardstick.draw();
    let encoded = clock() - cpu;
    gpu.wait();
    Cost { ms: ms(begin.elapsed()), cpu_ms: ms(encoded), ..Cost::default() }
}

fn ms(duration: Duration) -> f64 {
    1e3 * duration.as_secs_f64()
}
