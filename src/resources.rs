//! What this process has used, where the system tells.

use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// How often memory is looked at.
const LOOK: Duration = Duration::from_millis(20);

/// Processor seconds of all threads so far, or `None` if the system does not tell.
pub(crate) fn cpu_seconds() -> Option<f64> {
    // Fields 14 and 15 of proc(5), counted behind the command's closing parenthesis, in ticks of
    // a hundredth of a second on every Linux.
    let stat = fs::read_to_string("/proc/self/stat").ok()?;
    let mut fields = stat.rsplit_once(')')?.1.split_whitespace().skip(11);
    let mut ticks = || fields.next()?.parse::<f64>().ok();
    Some((ticks()? + ticks()?) / 100.0)
}

/// The most anonymous memory held, looked at every 20 ms from a thread of its own: the system keeps
/// no such figure.
#[derive(Debug)]
pub(crate) struct PeakMemory {
    seen: Arc<Seen>,
    watcher: Option<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Seen {
    bytes: AtomicU64,
    enough: AtomicBool,
}

impl Seen {
    fn look(&self) {
        self.bytes.fetch_max(anonymous_bytes().unwrap_or(0), Ordering::Relaxed);
    }
}

impl PeakMemory {
    /// Looks from now on.
    pub(crate) fn watch() -> Self {
        let seen = Arc::new(Seen::default());
        seen.look();
        let eyes = Arc::clone(&seen);
        let look = move || {
            while !eyes.enough.load(Ordering::Relaxed) {
                eyes.look();
                thread::park_timeout(LOOK);
            }
        };
        // Without a thread the first and the last look are all there is.
        let watcher = thread::Builder::new().name("memory".to_owned()).spawn(look).ok();
        Self { seen, watcher }
    }

    /// The most seen, in bytes; 0 if the system does not tell. Looks no more.
    pub(crate) fn bytes(mut self) -> u64 {
        self.seen.look();
        self.stop();
        self.seen.bytes.load(Ordering::Relaxed)
    }

    fn stop(&mut self) {
        self.seen.enough.store(true, Ordering::Relaxed);
        if let Some(watcher) = self.watcher.take() {
            watcher.thread().unpark();
            // It has nothing to say, not even if it panicked.
            let _ = watcher.join();
        }
    }
}

impl Drop for PeakMemory {
    fn drop(&mut self) {
        self.stop();
    }
}

/// Bytes that may still be written where `folder` is or will be, or `None` if the system does not
/// tell.
#[cfg(unix)]
pub(crate) fn free_bytes(folder: &Path) -> Option<u64> {
    let there = folder.ancestors().find(|folder| folder.is_dir());
    let there = there.filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let said = nix::sys::statvfs::statvfs(there).ok()?;
    #[allow(clippy::useless_conversion, reason = "narrower on some systems")]
    let (blocks, size): (u64, u64) = (said.blocks_available().into(), said.fragment_size().into());
    blocks.checked_mul(size)
}

#[cfg(not(unix))]
pub(crate) fn free_bytes(_folder: &Path) -> Option<u64> {
    None
}

/// Anonymous memory held now, in bytes, or `None` if the system does not tell.
fn anonymous_bytes() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib * 1024)
}
