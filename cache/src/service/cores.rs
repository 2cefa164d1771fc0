//! A core for each thread that answers, while there are insertions.
//!
//! The system moves a thread that waits to a core where nothing runs; where an insertion runs, idle as it is, it
//! often does not. Then threads that answer wait for each other on one core, for milliseconds, and the insertion
//! has another for itself. While nothing is inserted the system places them better than this would.

use tokio::sync::watch;

/// The cores that this process may use, if there is one for each thread that answers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cores {
    #[cfg(target_os = "linux")]
    all: rustix::thread::CpuSet,
}

#[cfg(target_os = "linux")]
impl Cores {
    /// `None` unless there are just as many: of a part of them, other processes might take the same.
    pub(super) fn one_each(threads: usize) -> Option<Self> {
        let all = rustix::thread::sched_getaffinity(None).ok()?;
        (usize::try_from(all.count()) == Ok(threads)).then_some(Self { all })
    }

    /// Keeps this thread, and those it starts, on the core of that number.
    fn stay(&self, number: usize) {
        use rustix::thread::{CpuSet, sched_setaffinity};

        let mut all = (0..CpuSet::MAX_CPU).filter(|&core| self.all.is_set(core));
        if let Some(core) = all.nth(number) {
            let mut one = CpuSet::new();
            one.set(core);
            // Where it is it answers too.
            let _ = sched_setaffinity(None, &one);
        }
    }

    /// Lets this thread go to any core.
    pub(super) fn leave(&self) {
        // A core may have been taken away.
        let _ = rustix::thread::sched_setaffinity(None, &self.all);
    }
}

#[cfg(not(target_os = "linux"))]
impl Cores {
    pub(super) fn one_each(_threads: usize) -> Option<Self> {
        None
    }

    fn stay(&self, _number: usize) {}

    pub(super) fn leave(&self) {}
}

/// Keeps this thread on the core of its number while there are insertions, until nobody tells of them any more.
///
/// # Cancel safety
///
/// The thread stays where it is.
pub(super) async fn keep(cores: Cores, number: usize, mut inserting: watch::Receiver<usize>) {
    let mut stays = false;
    loop {
        let any = *inserting.borrow_and_update() > 0;
        match (stays, any) {
            (false, true) => cores.stay(number),
            (true, false) => cores.leave(),
            _ => {}
        }
        stays = any;
        if inserting.changed().await.is_err() {
            return;
        }
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use rustix::thread::sched_getaffinity;
    use tokio::runtime::Builder;
    use tokio::task::{spawn_blocking, yield_now};

    use super::*;

    #[test]
    fn a_thread_stays_on_its_core_while_there_are_insertions_and_those_it_starts_do_not() {
        let all = sched_getaffinity(None).unwrap();
        let count = usize::try_from(all.count()).unwrap();
        assert!(Cores::one_each(count + 1).is_none());
        assert!(count == 1 || Cores::one_each(count - 1).is_none());
        let cores = Cores::one_each(count).unwrap();
        let mut builder = Builder::new_current_thread();
        let runtime = builder.on_thread_start(move || cores.leave()).build().unwrap();
        runtime.block_on(async {
            let own = async || {
                yield_now().await;
                sched_getaffinity(None).unwrap()
            };
            let inserting = watch::Sender::new(0);
            let keeper = tokio::spawn(keep(cores, count - 1, inserting.subscribe()));
            assert_eq!(own().await, all);
            for some in [1, 2, 1] {
                inserting.send_replace(some);
                let one = own().await;
                assert_eq!(one.count(), 1);
                // The last of all.
                let last = (0..rustix::thread::CpuSet::MAX_CPU).rfind(|&core| all.is_set(core));
                assert!(one.is_set(last.unwrap()));
            }
            let started = spawn_blocking(|| sched_getaffinity(None).unwrap());
            assert_eq!(started.await.unwrap(), all);
            inserting.send_replace(0);
            assert_eq!(own().await, all);
            drop(inserting);
            keeper.await.unwrap();
        });
    }
}
