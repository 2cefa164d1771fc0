//! Whether a server can be reached, as all who ask it have found.
//!
//! ```text
//!   a request finds nobody ──▶ lost: others fail at once for a while ──▶ an answer ──▶ found
//!                                └──▶ whoever waits for losses asks anew what is there
//! ```

use std::sync::Mutex;
use std::time::{Duration, Instant};

use tokio::sync::watch;

use crate::locks::lock;

/// How long others fail at once after a request that found nobody: a vanished network is not asked
/// by every page.
const SILENCE: Duration = Duration::from_secs(1);

/// See the module. Any thread may call anything; nothing waits.
#[derive(Debug)]
pub(crate) struct Link {
    outage: Mutex<Option<Outage>>,
    losses: watch::Sender<u64>,
}

#[derive(Clone, Debug)]
struct Outage {
    until: Instant,
    reason: String,
}

impl Link {
    pub(super) fn new() -> Self {
        Self { outage: Mutex::default(), losses: watch::Sender::new(0) }
    }

    /// Why it is not worth asking now.
    pub(super) fn silence(&self) -> Option<String> {
        let outage = lock(&self.outage);
        let outage = outage.as_ref().filter(|outage| Instant::now() < outage.until)?;
        Some(outage.reason.clone())
    }

    /// Whether the last to ask found nobody.
    pub(crate) fn is_lost(&self) -> bool {
        lock(&self.outage).is_some()
    }

    /// A request found nobody.
    pub(super) fn lose(&self, reason: &str) {
        let outage = Outage { until: Instant::now() + SILENCE, reason: reason.to_owned() };
        *lock(&self.outage) = Some(outage);
        self.losses.send_modify(|losses| *losses = losses.wrapping_add(1));
    }

    /// An answer came.
    pub(super) fn find(&self) {
        *lock(&self.outage) = None;
    }

    /// Hears of every request that finds nobody.
    pub(crate) fn losses(&self) -> watch::Receiver<u64> {
        self.losses.subscribe()
    }
}

/// Whether an error says that nobody is there, and not that somebody answers nonsense.
pub(super) fn is_nobody(error: &ureq::Error) -> bool {
    matches!(
        error,
        ureq::Error::Io(_)
            | ureq::Error::Timeout(_)
            | ureq::Error::HostNotFound
            | ureq::Error::ConnectionFailed
    )
}
