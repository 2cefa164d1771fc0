//! Who asks a server for which blocks: what several threads want at once is asked for once.

use std::collections::BTreeMap;
use std::io;
use std::ops::Range;
use std::sync::{Condvar, Mutex};
use std::time::{Duration, Instant};

use super::range::{LOOK_EVERY, given_up};
use crate::locks::{lock, wait};

/// The blocks that somebody is asking for. Any thread may call anything.
#[derive(Debug, Default)]
pub(super) struct Claims {
    /// By number, and when others last waited for it.
    asked: Mutex<BTreeMap<u64, Option<Instant>>>,
    answered: Condvar,
}

/// Blocks that one thread asks for: others wait for it. Given up when dropped.
#[derive(Debug)]
pub(super) struct Claim<'a> {
    claims: &'a Claims,
    /// From the first up to and without the last.
    pub(super) numbers: Range<u64>,
}

impl Claims {
    /// Claims the first of `numbers` and those behind it up to the next that somebody asks for or that
    /// `is_there`; `None` after somebody else has asked for the first. That is waited for as long as it
    /// `is_wanted`.
    ///
    /// # Errors
    ///
    /// [`given_up`].
    pub(super) fn claim(
        &self,
        numbers: Range<u64>,
        is_there: impl Fn(u64) -> bool,
        is_wanted: impl Fn() -> bool,
    ) -> io::Result<Option<Claim<'_>>> {
        let first = numbers.start;
        let mut asked = lock(&self.asked);
        if asked.contains_key(&first) {
            while let Some(waited) = asked.get_mut(&first) {
                *waited = Some(Instant::now());
                wait(&self.answered, asked, LOOK_EVERY);
                if !is_wanted() {
                    return Err(given_up());
                }
                asked = lock(&self.asked);
            }
            return Ok(None);
        }
        let is_free = |next: &u64| !asked.contains_key(next) && !is_there(*next);
        let behind = (first + 1..numbers.end).take_while(is_free).last();
        let numbers = first..behind.unwrap_or(first) + 1;
        asked.extend(numbers.clone().map(|number| (number, None)));
        Ok(Some(Claim { claims: self, numbers }))
    }
}

impl Claim<'_> {
    /// Whoever waits says so more often.
    const WAITED: Duration = LOOK_EVERY.saturating_mul(5);

    /// Whether another thread waits for one of them.
    pub(super) fn is_waited_for(&self) -> bool {
        let asked = lock(&self.claims.asked);
        let mut waited = asked.range(self.numbers.clone()).filter_map(|(_, waited)| *waited);
        waited.any(|waited| waited.elapsed() < Self::WAITED)
    }
}

impl Drop for Claim<'_> {
    fn drop(&mut self) {
        lock(&self.claims.asked).retain(|number, _| !self.numbers.contains(number));
        self.claims.answered.notify_all();
    }
}
