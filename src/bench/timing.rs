//! Timing processes: wall clock, processor seconds and memory of a child and its children.
//!
//! Contenders run in turn, round after round, so that what else the machine does meets all of them;
//! they are compared within a round. The first round warms the page cache and is not counted.
//! Outputs are removed between runs, outside the timing.

use std::fs::{self, File};
use std::io;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use serde::Serialize;

use super::report::Spread;

/// How often memory is looked at.
const LOOK: Duration = Duration::from_millis(5);

/// What is run: one program, or several one after another.
#[derive(Debug)]
pub(super) struct Contender {
    pub(super) name: String,
    pub(super) steps: Vec<Command>,
    /// Made anew for every run, and removed after it.
    pub(super) folder: PathBuf,
}

/// What a run took.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(super) struct Taken {
    pub(super) wall_s: f64,
    /// User and system time, in steps of 10 ms.
    pub(super) cpu_s: f64,
    /// The part of it that the system took for them.
    pub(super) system_s: f64,
    /// The most anonymous memory that any step was seen to hold.
    pub(super) peak_anonymous_bytes: u64,
    /// The most resident memory of any step, mapped files included.
    pub(super) peak_resident_bytes: u64,
}

/// The counted runs of a contender, or why there are none.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Runs {
    pub(super) name: String,
    pub(super) runs: Vec<Taken>,
    pub(super) failed: Option<String>,
}

impl Runs {
    pub(super) fn spread(&self, figure: impl Fn(&Taken) -> f64) -> Option<Spread> {
        Spread::of(self.runs.iter().map(figure))
    }

    /// This one's processor seconds over the other's, round by round.
    pub(super) fn cpu_ratio(&self, other: &Self) -> Option<Spread> {
        let pairs = self.runs.iter().zip(&other.runs);
        Spread::of(pairs.map(|(one, other)| one.cpu_s / other.cpu_s.max(TICK_S)))
    }

    pub(super) fn wall_ratio(&self, other: &Self) -> Option<Spread> {
        let pairs = self.runs.iter().zip(&other.runs);
        Spread::of(pairs.map(|(one, other)| one.wall_s / other.wall_s))
    }
}

/// Runs all contenders `rounds` times, after one round that is not counted.
pub(super) fn race(contenders: &mut [Contender], rounds: usize) -> io::Result<Vec<Runs>> {
    let mut all: Vec<Runs> = contenders
        .iter()
        .map(|contender| Runs { name: contender.name.clone(), runs: Vec::new(), failed: None })
        .collect();
    for round in 0..=rounds {
        for (contender, runs) in contenders.iter_mut().zip(&mut all) {
            if runs.failed.is_some() {
                continue;
            }
            match contender.run()? {
                Ok((taken, _)) if round > 0 => runs.runs.push(taken),
                Ok(_) => {}
                Err(reason) => {
                    runs.runs.clear();
                    runs.failed = Some(reason);
                }
            }
        }
    }
    Ok(all)
}

impl Contender {
    /// One run, and what its last step printed; `Err` inside if a step failed.
    pub(super) fn run(&mut self) -> io::Result<Result<(Taken, String), String>> {
        remove(&self.folder)?;
        fs::create_dir_all(&self.folder)?;
        let (printed, log) = (self.folder.with_extension("out"), self.folder.with_extension("log"));
        let mut taken = Taken::default();
        for step in &mut self.steps {
            step.stdin(Stdio::null()).stdout(File::create(&printed)?).stderr(File::create(&log)?);
            let (step_taken, success) = run(step)?;
            if !success {
                let said = fs::read_to_string(&log)?;
                let last = said.lines().last().unwrap_or("without a word").to_owned();
                remove(&self.folder)?;
                return Ok(Err(format!("{} failed: {last}", step.get_program().display())));
            }
            taken.wall_s += step_taken.wall_s;
            taken.cpu_s += step_taken.cpu_s;
            taken.system_s += step_taken.system_s;
            let most = |of: fn(&Taken) -> u64| of(&taken).max(of(&step_taken));
            (taken.peak_anonymous_bytes, taken.peak_resident_bytes) =
                (most(|taken| taken.peak_anonymous_bytes), most(|taken| taken.peak_resident_bytes));
        }
        remove(&self.folder)?;
        let said = fs::read_to_string(&printed)?;
        fs::remove_file(&printed)?;
        fs::remove_file(&log)?;
        Ok(Ok((taken, said)))
    }
}

/// Removes a folder that may not be there.
pub(super) fn remove(folder: &std::path::Path) -> io::Result<()> {
    match fs::remove_dir_all(folder) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

/// Runs a process to its end, and whether that was a good one.
fn run(command: &mut Command) -> io::Result<(Taken, bool)> {
    let [user_before, system_before] = children_cpu_s();
    let start = Instant::now();
    let mut child = command.spawn()?;
    let status_file = PathBuf::from(format!("/proc/{}/status", child.id()));
    let over = AtomicBool::new(false);
    let (status, wall, (anonymous, resident)) = thread::scope(|scope| {
        let watching = scope.spawn(|| {
            let mut most = (0, 0);
            while !over.load(Ordering::Relaxed) {
                if let Ok(status) = fs::read_to_string(&status_file) {
                    most.0 = field_bytes(&status, "RssAnon:").unwrap_or(0).max(most.0);
                    most.1 = field_bytes(&status, "VmHWM:").unwrap_or(0).max(most.1);
                }
                thread::sleep(LOOK);
            }
            most
        });
        let status = child.wait();
        let wall = start.elapsed();
        over.store(true, Ordering::Relaxed);
        (status, wall, watching.join().unwrap_or_default())
    });
    let [user, system] = children_cpu_s();
    let taken = Taken {
        wall_s: wall.as_secs_f64(),
        cpu_s: user - user_before + system - system_before,
        system_s: system - system_before,
        peak_anonymous_bytes: anonymous,
        peak_resident_bytes: resident,
    };
    Ok((taken, status?.success()))
}

/// A field of proc(5)'s status.
fn field_bytes(status: &str, field: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix(field))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib * 1024)
}

/// The step of [`children_cpu_s`] on every Linux.
const TICK_S: f64 = 0.01;

/// User and system seconds of all children that have been waited for, and of theirs; 0 if the
/// system does not tell.
fn children_cpu_s() -> [f64; 2] {
    // Fields 16 and 17 of proc(5), counted behind the command's closing parenthesis.
    let read = || {
        let stat = fs::read_to_string("/proc/self/stat").ok()?;
        let mut fields = stat.rsplit_once(')')?.1.split_whitespace().skip(13);
        let mut seconds = || Some(fields.next()?.parse::<f64>().ok()? * TICK_S);
        Some([seconds()?, seconds()?])
    };
    read().unwrap_or_default()
}

/// Seconds that this thread has run, if the system tells.
pub(super) fn thread_cpu_s() -> Option<f64> {
    let stat = fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    let nanoseconds: f64 = stat.split_whitespace().next()?.parse().ok()?;
    Some(nanoseconds / 1e9)
}
