//! The figures of frames, and what they come to.

use std::fmt::Write as _;
use std::time::Duration;

use areoid_cache::Stats;
use serde::Serialize;

use crate::quantile::quantile;

/// What a frame took and showed. Times are milliseconds of the clock on the wall.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(super) struct Frame {
    pub(super) frame: u32,
    /// Of the flight.
    pub(super) seconds: f64,
    /// After its time, where it has one.
    pub(super) late_ms: f64,
    /// For the selection, pages that were waited for included.
    pub(super) update_ms: f64,
    /// For uploads, geometry and encoding, on the thread that draws.
    pub(super) render_ms: f64,
    /// From there until the GPU was done.
    pub(super) gpu_ms: f64,
    /// All three.
    pub(super) frame_ms: f64,
    /// Pages that the view ends in.
    pub(super) wanted: usize,
    /// `resident` and `missing`: more than wanted by those that only stand in.
    pub(super) needed: usize,
    /// Pages in memory that the frame is drawn from, those that stand in included.
    pub(super) resident: usize,
    /// Wanted ones that may still come.
    pub(super) missing: usize,
    /// Wanted ones that cannot be read.
    pub(super) failed: usize,
    /// Read and decoded since the frame before, and their bytes as they are stored.
    pub(super) loaded_pages: u64,
    pub(super) loaded_bytes: u64,
    /// Written to the GPU for this frame, and the bytes of their texels.
    pub(super) uploaded_pages: usize,
    pub(super) uploaded_bytes: u64,
    /// Put off to the next frame by the limit on uploads.
    pub(super) pending_pages: usize,
    /// Without room on the GPU.
    pub(super) left_out_pages: usize,
    /// Whether it is the picture of the frame before, and nothing was drawn.
    pub(super) is_same: bool,
    pub(super) patches: usize,
    pub(super) triangles: usize,
    /// The worst error shown, stand-ins included; nothing in JSON where a page has no stand-in.
    pub(super) error_px: f64,
    /// What it will be once nothing is missing.
    pub(super) tolerance_px: f64,
    /// Of pages and loads under way.
    pub(super) memory_bytes: usize,
    pub(super) budget_bytes: usize,
}

/// Of one figure over all frames.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Spread {
    median: f64,
    p95: f64,
    p99: f64,
    max: f64,
}

/// What all frames come to.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Summary {
    frames: usize,
    /// From the first frame to the last.
    took_s: f64,
    /// Frames over the time that was spent on them alone.
    frames_per_s: f64,
    update_ms: Spread,
    render_ms: Spread,
    gpu_ms: Spread,
    frame_ms: Spread,
    wanted: Spread,
    needed: Spread,
    resident: Spread,
    missing: Spread,
    patches: Spread,
    triangles: Spread,
    error_px: Spread,
    tolerance_px: Spread,
    /// Frames more than a thirtieth of a second after their time.
    late_frames: usize,
    /// Frames that lacked pages, and those of which some part had none at all.
    missing_frames: usize,
    bare_frames: usize,
    loaded_pages: u64,
    loaded_bytes: u64,
    uploaded_pages: usize,
    uploaded_bytes: u64,
    peak_memory_bytes: usize,
    budget_bytes: usize,
}

/// Later than this is late.
const LATE_MS: f64 = 1e3 / 30.0;

impl Spread {
    fn of(figures: impl Iterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = figures.collect();
        sorted.sort_by(f64::total_cmp);
        let of = |share| quantile(&sorted, share);
        Self { median: of(0.5), p95: of(0.95), p99: of(0.99), max: of(1.0) }
    }
}

impl Summary {
    pub(super) fn new(frames: &[Frame], took: Duration, stats: &Stats) -> Self {
        let spread = |figure: fn(&Frame) -> f64| Spread::of(frames.iter().map(figure));
        let count = |test: fn(&Frame) -> bool| frames.iter().filter(|frame| test(frame)).count();
        let spent_s = frames.iter().map(|frame| frame.frame_ms).sum::<f64>() / 1e3;
        Self {
            frames: frames.len(),
            took_s: took.as_secs_f64(),
            frames_per_s: frames.len() as f64 / spent_s,
            update_ms: spread(|frame| frame.update_ms),
            render_ms: spread(|frame| frame.render_ms),
            gpu_ms: spread(|frame| frame.gpu_ms),
            frame_ms: spread(|frame| frame.frame_ms),
            wanted: spread(|frame| frame.wanted as f64),
            needed: spread(|frame| frame.needed as f64),
            resident: spread(|frame| frame.resident as f64),
            missing: spread(|frame| frame.missing as f64),
            patches: spread(|frame| frame.patches as f64),
            triangles: spread(|frame| frame.triangles as f64),
            error_px: spread(|frame| frame.error_px),
            tolerance_px: spread(|frame| frame.tolerance_px),
            late_frames: count(|frame| frame.late_ms > LATE_MS),
            missing_frames: count(|frame| frame.missing > 0),
            bare_frames: count(|frame| frame.error_px.is_infinite()),
            loaded_pages: frames.iter().map(|frame| frame.loaded_pages).sum(),
            loaded_bytes: frames.iter().map(|frame| frame.loaded_bytes).sum(),
            uploaded_pages: frames.iter().map(|frame| frame.uploaded_pages).sum(),
            uploaded_bytes: frames.iter().map(|frame| frame.uploaded_bytes).sum(),
            peak_memory_bytes: stats.peak_bytes,
            budget_bytes: stats.budget_bytes,
        }
    }

    /// A table for people.
    pub(super) fn text(&self, adapter: &str, [width, height]: [u32; 2], flight_s: f64) -> String {
        let mut text = format!(
            "{} frames of {flight_s} s, {width}x{height}, on {adapter}: {:.1} a second\n\n\
             {:12}{:>10}{:>10}{:>10}{:>10}\n",
            self.frames, self.frames_per_s, "", "median", "p95", "p99", "max"
        );
        for (name, spread, digits) in [
            ("update ms", self.update_ms, 2),
            ("render ms", self.render_ms, 2),
            ("GPU ms", self.gpu_ms, 2),
            ("frame ms", self.frame_ms, 2),
            ("wanted", self.wanted, 0),
            ("needed", self.needed, 0),
            ("resident", self.resident, 0),
            ("missing", self.missing, 0),
            ("patches", self.patches, 0),
            ("error px", self.error_px, 2),
        ] {
            let Spread { median, p95, p99, max } = spread;
            write!(text, "{name:12}").expect("a string takes everything");
            for figure in [median, p95, p99, max] {
                write!(text, "{figure:>10.digits$}").expect("a string takes everything");
            }
            text.push('\n');
        }
        write!(
            text,
            "\n{} frames were late, {} lacked pages, {} had none for a part of the picture\n\
             {} pages loaded ({:.1} MB), {} uploaded ({:.1} MB), {:.1} of {:.0} MB of memory",
            self.late_frames,
            self.missing_frames,
            self.bare_frames,
            self.loaded_pages,
            self.loaded_bytes as f64 / 1e6,
            self.uploaded_pages,
            self.uploaded_bytes as f64 / 1e6,
            self.peak_memory_bytes as f64 / 1e6,
            self.budget_bytes as f64 / 1e6,
        )
        .expect("a string takes everything");
        text
    }
}
