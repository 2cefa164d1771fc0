//! Locks, taken whoever panicked with them: between any two steps, what they guard is whole.
//!
//! Wherever threads of a model ([`model`], in tests) come here, others of it may go first: it tries
//! the orders in which that can go.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard};
use std::sync::{RwLockWriteGuard, TryLockError, TryLockResult};
use std::time::Duration;

/// Waits for whoever has it.
pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    #[cfg(test)]
    if model::is_running() {
        return model::wait_for(|| unless_taken(mutex.try_lock()));
    }
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Never waits: `None` if somebody has it.
pub(crate) fn try_lock<T>(mutex: &Mutex<T>) -> Option<MutexGuard<'_, T>> {
    step();
    unless_taken(mutex.try_lock())
}

/// Waits for whoever writes.
pub(crate) fn read<T>(lock: &RwLock<T>) -> RwLockReadGuard<'_, T> {
    #[cfg(test)]
    if model::is_running() {
        return model::wait_for(|| unless_taken(lock.try_read()));
    }
    lock.read().unwrap_or_else(PoisonError::into_inner)
}

/// Waits for all others.
pub(crate) fn write<T>(lock: &RwLock<T>) -> RwLockWriteGuard<'_, T> {
    #[cfg(test)]
    if model::is_running() {
        return model::wait_for(|| unless_taken(lock.try_write()));
    }
    lock.write().unwrap_or_else(PoisonError::into_inner)
}

/// Lets go of a lock until it is called, or that time has passed, or for no reason.
pub(crate) fn wait<T>(called: &Condvar, guard: MutexGuard<'_, T>, at_most: Duration) {
    #[cfg(test)]
    if model::is_running() {
        drop(guard);
        return model::give_way();
    }
    drop(called.wait_timeout(guard, at_most).unwrap_or_else(PoisonError::into_inner));
}

/// A place where it matters who goes first, and no lock is taken.
#[inline]
pub(crate) fn step() {
    #[cfg(test)]
    if model::is_running() {
        model::step();
    }
}

fn unless_taken<G>(result: TryLockResult<G>) -> Option<G> {
    match result {
        Ok(guard) => Some(guard),
        Err(TryLockError::Poisoned(poisoned)) => Some(poisoned.into_inner()),
        Err(TryLockError::WouldBlock) => None,
    }
}

/// Threads of which one runs at a time, in all orders that a random choice comes upon: shuttle's.
#[cfg(test)]
pub(crate) mod model {
    use std::cell::{Cell, RefCell};
    use std::collections::HashSet;
    use std::hash::{BuildHasher as _, RandomState};
    use std::time::Duration;

    use shuttle::scheduler::{PctScheduler, RandomScheduler, Scheduler};
    use shuttle::thread::{ThreadId, current, sleep, yield_now};
    use shuttle::{Config, MaxSteps, Runner};

    thread_local! {
        /// All of a model's threads are one thread to the system.
        static RUNNING: Cell<bool> = const { Cell::new(false) };
        /// Those that must not wait.
        static HASTY: RefCell<HashSet<ThreadId>> = RefCell::default();
    }

    pub(super) fn is_running() -> bool {
        // What unwinds is cleared away without a choice.
        RUNNING.get() && !std::thread::panicking()
    }

    pub(super) fn step() {
        sleep(Duration::ZERO);
    }

    pub(super) fn give_way() {
        yield_now();
    }

    pub(super) fn wait_for<G>(take: impl Fn() -> Option<G>) -> G {
        HASTY.with_borrow(|hasty| {
            assert!(!hasty.contains(&current().id()), "waits for a lock, and must not wait");
        });
        step();
        loop {
            if let Some(guard) = take() {
                return guard;
            }
            give_way();
        }
    }

    /// Does something on a thread that must not wait for a lock meanwhile, even for one that is free.
    pub(crate) fn without_waiting<T>(act: impl FnOnce() -> T) -> T {
        HASTY.with_borrow_mut(|hasty| hasty.insert(current().id()));
        let result = act();
        HASTY.with_borrow_mut(|hasty| hasty.remove(&current().id()));
        result
    }

    /// As many orders as fit into a second or two, or many.
    pub(crate) fn orders(few: usize) -> usize {
        if is_long() { 100 * few } else { few }
    }

    fn is_long() -> bool {
        std::env::var_os("AREOID_SOAK").is_some()
    }

    /// Plays `play` in so many orders of its threads' steps, half of them such as have few surprises at
    /// odd places, which is where mistakes are mostly. Threads that all wait for each other fail it.
    pub(crate) fn check(orders: usize, play: impl Fn() + Send + Sync + Clone + 'static) {
        let run = |scheduler: Box<dyn Scheduler + Send>| {
            let mut config = Config::new();
            // A search and a decoder are at home on threads, not on a model's small stacks.
            config.stack_size = 1 << 20;
            config.max_steps = MaxSteps::FailAfter(100_000);
            let play = play.clone();
            RUNNING.set(true);
            Runner::new(scheduler, config).run(play);
            RUNNING.set(false);
        };
        // Always the same ones, but where it is asked for many.
        let seed = if is_long() { RandomState::new().hash_one(orders) } else { 1 };
        run(Box::new(RandomScheduler::new_from_seed(seed, orders / 2)));
        run(Box::new(PctScheduler::new_from_seed(seed, 3, orders.div_ceil(2))));
    }
}
