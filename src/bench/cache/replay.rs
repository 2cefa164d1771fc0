//! Flights flown through a session, frame by frame.

use std::sync::Arc;
use std::time::{Duration, Instant};

use areoid_cache::flight::Flight;
use areoid_cache::{Selection, Session, View};
use areoid_formats::units::Degrees;

use super::planet::body;

/// Frames a second.
pub(super) const FRAMES: u32 = 60;

/// What a flight is seen on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Screen {
    /// Width and height, in pixels.
    size: [u32; 2],
    tolerance_px: f64,
}

/// A window.
pub(super) const WINDOW: Screen = Screen { size: [1280, 720], tolerance_px: 1.0 };

/// A large screen, on which errors are small: views that need as much as they may.
pub(super) const LARGE: Screen = Screen { size: [3840, 2160], tolerance_px: 0.25 };

impl Screen {
    /// The view of a flight after some seconds.
    pub(super) fn view(&self, flight: &Flight, seconds: f64) -> View {
        let pose = flight.pose(&body().ellipsoid, seconds);
        pose.view(Degrees(45.0).into(), self.size, self.tolerance_px)
    }

    /// The views of all frames.
    pub(super) fn views(self, flight: &Flight) -> impl Iterator<Item = View> + '_ {
        (0_u32..)
            .map(|frame| f64::from(frame) / f64::from(FRAMES))
            .take_while(|seconds| *seconds <= flight.seconds())
            .map(move |seconds| self.view(flight, seconds))
    }
}

/// Flies in real time; `each` is told every frame's selection and what its update took.
pub(super) fn fly(
    flight: &Flight,
    screen: Screen,
    session: &mut Session,
    mut each: impl FnMut(&View, &Arc<Selection>, Duration),
) {
    in_real_time(flight.seconds(), |now| {
        let view = screen.view(flight, now);
        let before = clock();
        let selection = session.update(&view);
        each(&view, &selection, clock().saturating_sub(before));
    });
}

/// Draws frames for so many seconds, told how many have passed.
pub(super) fn in_real_time(seconds: f64, mut draw: impl FnMut(f64)) {
    let start = Instant::now();
    let mut frame = 0;
    loop {
        let now = start.elapsed().as_secs_f64();
        if now > seconds {
            break;
        }
        draw(now);
        frame += 1;
        // A frame that comes too late is left out, as a screen would.
        while start.elapsed() > Duration::from_secs(1) * frame / FRAMES {
            frame += 1;
        }
        let next = Duration::from_secs(1) * frame / FRAMES;
        std::thread::sleep(next.saturating_sub(start.elapsed()));
    }
}

/// The time that this thread has run.
pub(in crate::bench) fn clock() -> Duration {
    #[cfg(unix)]
    {
        use nix::time::{ClockId, clock_gettime};
        clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID).map_or(Duration::ZERO, Duration::from)
    }
    #[cfg(not(unix))]
    {
        use std::sync::OnceLock;
        static START: OnceLock<Instant> = OnceLock::new();
        START.get_or_init(Instant::now).elapsed()
    }
}
