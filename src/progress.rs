//! How an ingest goes, on stderr: a bar on a terminal, else a line now and then.
//!
//! ```text
//!   building ━━━━━━━━━╾─────────── 312 of 933 Mpx, 66.1 Mpx/s, 0.21 GB written, 9 s left [00:00:05]
//! ```

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use areoid_preprocess::build::Progress;
use areoid_preprocess::estimate::{Estimate, WORTH_MEASURING_PX};
use areoid_preprocess::ingest::{Event, Leftover};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::output;

/// How often a line is said where there is no bar.
const LINE_EVERY: Duration = Duration::from_secs(10);

/// How often the bar's clock moves on.
const TICK: Duration = Duration::from_millis(200);

/// What the bar is divided into.
const STEPS: u64 = 1000;

/// What is shown of an ingest. Any thread may call anything.
#[derive(Debug)]
pub(crate) struct Screen {
    bar: Option<ProgressBar>,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    phase: Phase,
    said: Instant,
    texels: u64,
    /// Units that a build resumed has to come past before it writes.
    replayed: u64,
    progress: Option<Progress>,
}

/// What is being done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Opening,
    Hashing,
    Checking,
    Measuring,
    Building,
    Publishing,
}

/// Whether a terminal may show a bar.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Bar {
    /// If stderr is a terminal.
    Wanted,
    Unwanted,
}

impl Screen {
    pub(crate) fn new(wanted: Bar) -> Self {
        let bar = ProgressBar::with_draw_target(Some(STEPS), ProgressDrawTarget::stderr());
        let bar = (wanted == Bar::Wanted && !bar.is_hidden()).then_some(bar);
        if let Some(bar) = &bar {
            let style = "{prefix} {bar:24} {msg} [{elapsed_precise}]";
            let style = ProgressStyle::with_template(style).expect("a template that parses");
            bar.set_style(style.progress_chars("━╾─"));
            bar.enable_steady_tick(TICK);
        }
        let (phase, said) = (Phase::Opening, Instant::now());
        let state = State { phase, said, texels: 0, replayed: 0, progress: None };
        Self { bar, state: Mutex::new(state) }
    }

    /// Shows an event.
    pub(crate) fn show(&self, event: &Event) {
        let mut state = self.state();
        match *event {
            Event::Opening => self.draw(&mut state, Phase::Opening, 0.0, String::new()),
            Event::Hashing { done, bytes } => {
                self.draw_bytes(&mut state, Phase::Hashing, done, bytes);
            }
            Event::Checking { done, bytes } => {
                self.draw_bytes(&mut state, Phase::Checking, done, bytes);
            }
            Event::Leftover(leftover) => {
                if let Leftover::Resumed { units, .. } = leftover {
                    let before = state.progress.map_or(0, |progress| progress.units_done as u64);
                    state.replayed = before + units;
                }
                self.say(leftover_text(leftover));
            }
            Event::Measuring => self.draw(&mut state, Phase::Measuring, 0.0, String::new()),
            Event::Estimated(estimate) => {
                state.texels = estimate.texels;
                if estimate.texels >= WORTH_MEASURING_PX {
                    self.say(estimate_text(&estimate));
                }
                self.draw(&mut state, Phase::Building, 0.0, String::new());
            }
            Event::Building(progress) => {
                state.progress = Some(progress);
                let share = progress.texels as f64 / state.texels.max(1) as f64;
                let text = progress_text(&progress, state.texels);
                self.draw(&mut state, Phase::Building, share, text);
            }
            Event::Publishing => self.draw(&mut state, Phase::Publishing, 1.0, String::new()),
            _ => {}
        }
    }

    /// Says a line, above the bar if there is one.
    pub(crate) fn say(&self, text: impl std::fmt::Display) {
        match &self.bar {
            Some(bar) => bar.suspend(|| output::say(text)),
            None => output::say(text),
        }
    }

    /// Says what becomes of a wish to stop.
    pub(crate) fn say_stopping(&self) {
        let phase = self.state().phase;
        self.say(match phase {
            Phase::Opening | Phase::Hashing | Phase::Checking | Phase::Measuring => {
                "stopping; once more stops at once"
            }
            Phase::Building => "stopping after this unit; once more stops at once",
            Phase::Publishing => "all is built and being published; once more stops at once",
        });
    }

    /// The last unit told of.
    pub(crate) fn progress(&self) -> Option<Progress> {
        self.state().progress
    }

    /// Takes the bar away.
    pub(crate) fn clear(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }

    fn draw_bytes(&self, state: &mut State, phase: Phase, done: u64, bytes: u64) {
        let share = done as f64 / bytes.max(1) as f64;
        let text = format!("{:.0} of {:.0} MB", done as f64 / 1e6, bytes as f64 / 1e6);
        self.draw(state, phase, share, text);
    }

    fn draw(&self, state: &mut State, phase: Phase, share: f64, text: String) {
        state.phase = phase;
        let building = phase == Phase::Building;
        let done = state.progress.map_or(0, |progress| progress.units_done as u64);
        let doing = if building && done < state.replayed {
            "doing again what is written already"
        } else {
            phase.doing()
        };
        match &self.bar {
            Some(bar) => {
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "0..=1"
                )]
                bar.set_position((share.clamp(0.0, 1.0) * STEPS as f64) as u64);
                bar.set_prefix(doing);
                bar.set_message(text);
            }
            None if state.said.elapsed() >= LINE_EVERY => {
                state.said = Instant::now();
                let between = if text.is_empty() { "" } else { ": " };
                output::say(format!("{doing}{between}{text}"));
            }
            None => {}
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Phase {
    fn doing(self) -> &'static str {
        match self {
            Self::Opening => "reading what the rasters are",
            Self::Hashing => "hashing the input",
            Self::Checking => "checking what is written already",
            Self::Measuring => "measuring a few pages",
            Self::Building => "building",
            Self::Publishing => "making durable and publishing",
        }
    }
}

fn progress_text(progress: &Progress, all: u64) -> String {
    let mpx = |texels: u64| texels as f64 / 1e6;
    let seconds = progress.elapsed.as_secs_f64();
    let done = progress.texels - progress.texels_skipped;
    if done == 0 {
        return format!("{:.0} of {:.0} Mpx", mpx(progress.texels), mpx(all));
    }
    let rate = mpx(done) / seconds.max(1e-9);
    let left = mpx(all.saturating_sub(progress.texels)) / rate.max(1e-9);
    format!(
        "{:.0} of {:.0} Mpx, {rate:.1} Mpx/s, {:.2} GB written, {left:.0} s left",
        mpx(progress.texels),
        mpx(all),
        progress.bytes as f64 / 1e9,
    )
}

fn estimate_text(estimate: &Estimate) -> String {
    let pages = estimate.pages;
    match estimate.measured {
        Some(measured) => {
            let gigabytes = measured.bytes as f64 / 1e9;
            format!("about {pages} pages, {gigabytes:.2} GB, {:.0} s", measured.seconds)
        }
        None => format!("about {pages} pages"),
    }
}

fn leftover_text(leftover: Leftover) -> String {
    match leftover {
        Leftover::Resumed { units, again: 0 } => {
            format!("going on with an unfinished build: {units} units are there")
        }
        Leftover::Resumed { units, again } => format!(
            "going on with an unfinished build: {units} units are there, {again} of them are \
             worked through again"
        ),
        Leftover::Whole => {
            "an earlier build of this dataset was done, and only not published: it is now"
                .to_owned()
        }
        Leftover::Discarded => {
            "an unfinished build of this dataset is discarded; --resume would have gone on with it"
                .to_owned()
        }
        Leftover::Unrelated => "an unfinished build of this name is discarded: it is of another \
                                input, or of other options"
            .to_owned(),
    }
}
