//! What is under way on a connection: requests that are open, and pieces that wait to be taken.

use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use tokio::time::{Instant, sleep};

use crate::locks::lock;

/// A piece of that many bytes, or of fewer, is to be taken within the patience; of twice as many within
/// twice that, and so on.
const BYTES: usize = 256 << 10;

/// Looks within the shortest time that is looked for.
const LOOKS: u32 = 4;

/// A connection's account.
///
/// # Threads
///
/// Any thread may call anything.
#[derive(Debug)]
pub(super) struct Watch {
    patience: Duration,
    account: Mutex<Account>,
}

#[derive(Debug)]
struct Account {
    requests: usize,
    /// When the last request ended, or the connection began.
    idle_since: Instant,
    waiting: Vec<Due>,
    next: u64,
}

/// A piece that waits.
#[derive(Debug)]
struct Due {
    number: u64,
    /// What it has of the patience.
    allowance: Duration,
    by: Instant,
}

/// Why a connection is given up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Over {
    /// Nothing was asked for a while.
    Idle,
    /// What was asked for is not taken, or too slowly.
    Slow,
}

impl Watch {
    /// Of a connection that begins, with the time in which 256 KiB have to be taken.
    pub(super) fn new(patience: Duration) -> Arc<Self> {
        let account =
            Account { requests: 0, idle_since: Instant::now(), waiting: Vec::new(), next: 0 };
        Arc::new(Self { patience, account: Mutex::new(account) })
    }

    fn account(&self) -> MutexGuard<'_, Account> {
        lock(&self.account)
    }

    /// Counts a request until it is dropped.
    pub(super) fn request(self: &Arc<Self>) -> Arc<Asked> {
        self.account().requests += 1;
        Arc::new(Asked(Arc::clone(self)))
    }

    /// Waits until the connection is to be given up: if nothing was asked for `idle`, or for what was
    /// asked is not taken in time.
    ///
    /// # Cancel safety
    ///
    /// Nothing is lost.
    pub(super) async fn over(&self, idle: Option<Duration>) -> Over {
        let shortest = idle.map_or(self.patience, |idle| idle.min(self.patience));
        loop {
            sleep(shortest / LOOKS).await;
            let (now, account) = (Instant::now(), self.account());
            if account.waiting.iter().any(|due| due.by <= now) {
                return Over::Slow;
            }
            let is_idle = |idle| account.requests == 0 && now - account.idle_since >= idle;
            if idle.is_some_and(is_idle) {
                return Over::Idle;
            }
        }
    }
}

/// A request that is not done with: its answer's last piece has not been sent.
#[derive(Debug)]
pub(super) struct Asked(Arc<Watch>);

impl Asked {
    /// Counts a piece of an answer that waits to be taken, until it is dropped. Pieces that wait together
    /// have the time of all of them.
    pub(super) fn piece(&self, bytes: usize) -> Waiting {
        let watch = &self.0;
        let times = u32::try_from(bytes.div_ceil(BYTES)).unwrap_or(u32::MAX);
        let allowance = watch.patience.saturating_mul(times);
        let mut account = watch.account();
        let before: Duration = account.waiting.iter().map(|due| due.allowance).sum();
        let now = Instant::now();
        let by = now.checked_add(before + allowance).unwrap_or(now + watch.patience);
        let number = account.next;
        account.next += 1;
        account.waiting.push(Due { number, allowance, by });
        Waiting { number, watch: Arc::clone(watch) }
    }
}

impl Drop for Asked {
    fn drop(&mut self) {
        let mut account = self.0.account();
        account.requests -= 1;
        account.idle_since = Instant::now();
    }
}

/// A piece that waits.
#[derive(Debug)]
pub(super) struct Waiting {
    number: u64,
    watch: Arc<Watch>,
}

impl Drop for Waiting {
    fn drop(&mut self) {
        self.watch.account().waiting.retain(|due| due.number != self.number);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::time::{advance, timeout};

    const PATIENCE: Duration = Duration::from_secs(30);
    const IDLE: Duration = Duration::from_secs(60);

    #[tokio::test(start_paused = true)]
    async fn whoever_asks_nothing_is_idle_and_whoever_waits_is_not() {
        let watch = Watch::new(PATIENCE);
        let start = Instant::now();
        assert_eq!(watch.over(Some(IDLE)).await, Over::Idle);
        assert!(start.elapsed() < IDLE + PATIENCE, "{:?}", start.elapsed());
        let asked = watch.request();
        assert!(timeout(10 * IDLE, watch.over(Some(IDLE))).await.is_err());
        drop(asked);
        assert!(timeout(IDLE - PATIENCE, watch.over(Some(IDLE))).await.is_err());
        assert!(timeout(10 * IDLE, watch.over(None)).await.is_err());
        assert_eq!(watch.over(Some(IDLE)).await, Over::Idle);
    }

    #[tokio::test(start_paused = true)]
    async fn a_piece_has_the_time_of_its_bytes_and_of_those_before_it() {
        let watch = Watch::new(PATIENCE);
        let asked = watch.request();
        for (pieces, patiences) in [(&[1][..], 1), (&[BYTES, 1], 2), (&[3 * BYTES + 1, 1], 5)] {
            let mut waiting: Vec<_> = pieces.iter().map(|&bytes| asked.piece(bytes)).collect();
            let last = waiting.pop();
            drop(waiting);
            let almost = patiences * PATIENCE - PATIENCE / 2;
            assert!(timeout(almost, watch.over(None)).await.is_err(), "{pieces:?}");
            let over = timeout(PATIENCE, watch.over(None)).await;
            assert_eq!(over, Ok(Over::Slow), "{pieces:?}");
            drop(last);
        }
        // What was taken early leaves no time to those behind it.
        for _ in 0..10 {
            drop(asked.piece(BYTES));
        }
        let _waiting = asked.piece(1);
        advance(PATIENCE).await;
        assert_eq!(timeout(PATIENCE / 2, watch.over(None)).await, Ok(Over::Slow));
    }
}
