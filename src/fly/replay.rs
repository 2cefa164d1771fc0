//! A flight flown without a window.

use std::collections::HashSet;
use std::fmt;
use std::io;
use std::time::{Duration, Instant};

use areoid_cache::flight::Flight;
use areoid_cache::{Cache, Selection, Session, View};
use areoid_preprocess::build::Proceed;
use areoid_viewer::{FrameStatistics, Gpu, Options, Renderer};

use super::figures::Frame;
use crate::failure::Failure;
use crate::interrupt::Interrupt;
use crate::output;
use crate::shot::Shot;

/// When a frame is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Pace {
    /// When its time has come, with the pages that are there: what a window shows. Late frames
    /// follow at once; none is left out.
    Real,
    /// When the one before is done, with the pages that are there.
    Fast,
    /// When every page that it needs is there: for films.
    Complete,
}

impl fmt::Display for Pace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Real => "real",
            Self::Fast => "fast",
            Self::Complete => "complete",
        })
    }
}

/// What is flown, and how.
#[derive(Clone, Debug)]
pub(super) struct Replay<'a> {
    pub(super) flight: &'a Flight,
    pub(super) frames: u32,
    pub(super) pace: Pace,
    pub(super) shot: &'a Shot,
    pub(super) gpu: &'a Gpu,
}

/// What came of it.
#[derive(Debug)]
pub(super) struct Flown {
    pub(super) frames: Vec<Frame>,
    /// From the first frame to the last.
    pub(super) took: Duration,
    /// Pages that could not be read.
    pub(super) failed: usize,
}

/// How often a flight that waits looks for an interruption.
const LOOK_EVERY: Duration = Duration::from_millis(50);

impl Replay<'_> {
    /// Flies over a cache's datasets; `each` is told when a frame is drawn.
    pub(super) fn run(
        &self,
        cache: &Cache,
        interrupt: &Interrupt,
        mut each: impl FnMut(u32, &Renderer) -> Result<(), Failure>,
    ) -> Result<Flown, Failure> {
        let ellipsoid = cache.body().ellipsoid;
        let options = self.shot.options(cache)?;
        let mut renderer =
            Renderer::with_budget(self.gpu, ellipsoid, self.shot.quality.memory_bytes());
        let mut session = cache.session();
        self.shot.prepare(&mut session, &options);
        let (mut frames, mut failed) = (Vec::new(), HashSet::new());
        let mut before = cache.stats();
        let start = Instant::now();
        for number in 0..self.frames {
            if interrupt.proceed() == Proceed::No {
                let reason = format!("interrupted at frame {number}: nothing was written");
                return Err(io::Error::other(reason).into());
            }
            let seconds = self.seconds(number);
            let late = self.wait_for(start, seconds, interrupt);
            let pose = self.flight.pose(&ellipsoid, seconds);
            let (at, _) = ellipsoid.geographic_from_cartesian(pose.eye);
            let over = [at.longitude, at.latitude].map(|angle| angle.0.to_degrees());
            let light = self.shot.light(&ellipsoid, over)?;
            let options = self.at(&options, start);

            let (view, begin) = (self.shot.view(pose), Instant::now());
            let selection = self.select(&mut session, &view);
            let selected = begin.elapsed();
            let drawn = renderer.render(&view, &selection, &light, &options);
            let encoded = begin.elapsed();
            self.gpu.wait();
            let done = begin.elapsed();

            for page in &selection.failed {
                if failed.insert((page.dataset, page.page)) {
                    let name = &selection.datasets[page.dataset].name;
                    output::say(format_args!("warning: {name}/{}: {}", page.page, page.error));
                }
            }
            let now = cache.stats();
            frames.push(Frame {
                frame: number,
                seconds,
                late_ms: ms(late),
                update_ms: ms(selected),
                render_ms: ms(encoded - selected),
                gpu_ms: ms(done - encoded),
                frame_ms: ms(done),
                loaded_pages: now.loads - before.loads,
                loaded_bytes: now.loaded_bytes - before.loaded_bytes,
                memory_bytes: now.bytes + now.reserved_bytes,
                budget_bytes: now.budget_bytes,
                ..shown(&selection, &drawn)
            });
            before = now;
            each(number, &renderer)?;
        }
        Ok(Flown { frames, took: start.elapsed(), failed: failed.len() })
    }

    /// When a frame is, since the flight began.
    fn seconds(&self, number: u32) -> f64 {
        let steps = (self.frames - 1).max(1);
        self.flight.seconds() * (f64::from(number) / f64::from(steps))
    }

    /// Waits until a frame's time has come; how late it is.
    fn wait_for(&self, start: Instant, seconds: f64, interrupt: &Interrupt) -> Duration {
        let Ok(due) = Duration::try_from_secs_f64(seconds) else { return Duration::ZERO };
        if self.pace != Pace::Real {
            return Duration::ZERO;
        }
        while start.elapsed() < due && interrupt.proceed() == Proceed::Yes {
            std::thread::sleep(due.saturating_sub(start.elapsed()).min(LOOK_EVERY));
        }
        start.elapsed().saturating_sub(due)
    }

    fn select(&self, session: &mut Session, view: &View) -> std::sync::Arc<Selection> {
        match self.pace {
            Pace::Complete => session.settle(view),
            Pace::Real | Pace::Fast => session.update(view),
        }
    }

    /// Options for a frame that is drawn now.
    fn at(&self, options: &Options, start: Instant) -> Options {
        let paced = match self.pace {
            Pace::Complete => Options::default(),
            Pace::Real | Pace::Fast => Options::interactive(),
        };
        let seconds = start.elapsed().as_secs_f64();
        Options {
            seconds,
            fade_seconds: paced.fade_seconds,
            upload_limit_bytes: paced.upload_limit_bytes,
            upload_limit_seconds: paced.upload_limit_seconds,
            ..options.clone()
        }
    }
}

/// What a frame shows.
fn shown(selection: &Selection, drawn: &FrameStatistics) -> Frame {
    let resident = selection.pages.len();
    Frame {
        wanted: selection.wanted,
        needed: resident + selection.missing,
        resident,
        missing: selection.missing,
        failed: selection.failed.len(),
        uploaded_pages: drawn.uploaded_pages,
        uploaded_bytes: drawn.uploaded_bytes,
        pending_pages: drawn.pending_pages,
        left_out_pages: drawn.left_out_pages,
        is_same: drawn.is_same,
        patches: drawn.patches,
        triangles: drawn.triangles,
        error_px: selection.error_px,
        tolerance_px: selection.tolerance_px,
        ..Frame::default()
    }
}

fn ms(duration: Duration) -> f64 {
    1e3 * duration.as_secs_f64()
}
