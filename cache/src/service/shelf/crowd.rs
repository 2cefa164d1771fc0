//! Whether a thread's sockets hold more than the processor's caches do.

use std::time::{Duration, Instant};

/// What a thread's sockets hold at a time while all of it is still in the processor's caches when
/// clients take it: copying into them is faster then.
const COPIED_BYTES: usize = 3 << 20;

/// For so long an answer counts as held.
const HELD: Duration = Duration::from_millis(10);

/// What the sockets of a thread were given in this span of time and in the one before, counting one
/// answer of each.
#[derive(Clone, Copy, Debug)]
pub(super) struct Crowd {
    number: u64,
    since: Option<Instant>,
    now: usize,
    before: usize,
}

impl Crowd {
    pub(super) const NONE: Self = Self { number: 0, since: None, now: 0, before: 0 };

    /// Counts an answer of a connection whose last was counted in the span `last`.
    pub(super) fn count(mut self, last: &mut u64, bytes: usize) -> Self {
        let now = Instant::now();
        let age = self.since.map_or(Duration::MAX, |since| now - since);
        if age >= HELD {
            let before = if age < 2 * HELD { self.now } else { 0 };
            self = Self { number: self.number + 1, since: Some(now), now: 0, before };
        }
        if *last != self.number {
            (*last, self.now) = (self.number, self.now + bytes);
        }
        self
    }

    pub(super) fn is_large(&self) -> bool {
        self.now.max(self.before) > COPIED_BYTES
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_connections_are_a_crowd_and_many_answers_of_a_few_are_none() {
        let mut few = [0; 2];
        let mut crowd = Crowd::NONE;
        for _ in 0..100 {
            for last in &mut few {
                crowd = crowd.count(last, 1 << 20);
                assert!(!crowd.is_large(), "{crowd:?}");
            }
        }
        for _ in 0..8 {
            crowd = crowd.count(&mut 0, 1 << 20);
        }
        assert!(crowd.is_large(), "{crowd:?}");
    }
}
