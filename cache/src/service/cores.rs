//! A core for each thread that answers, while there are insertions.
//!
//! The system moves a thread that waits to a core where nothing runs; where an insertion runs, idle as it is, it
//! often does not. Then threads that answer wait for each other on one core, for milliseconds, and the insertion
//! has another for itself. While nothing is inserted the system places them better than this would.

use tokio::sync::watch;

pub(super) use system::Core;

impl Core {
    /// Keeps this thread to the core while there are insertions, until nobody tells of them any more.
    ///
    /// # Cancel safety
    ///
    /// The thread stays where it is.
    pub(super) async fn keep(self, mut inserting: watch::Receiver<usize>) {
        let mut stays = false;
        loop {
            let any = *inserting.borrow_and_update() > 0;
            match (stays, any) {
                (false, true) => self.stay(),
                (true, false) => self.leave(),
                _ => {}
            }
            stays = any;
            if inserting.changed().await.is_err() {
                return;
            }
        }
    }
}

#[cfg(target_os = "linux")]
mod system {
    use std::sync::{Arc, Mutex};

    use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
    use tracing::debug;

    use crate::locks::lock;

    /// A thread's core, and where it could be before it kept to it last.
    #[derive(Clone, Debug)]
    pub(in super::super) struct Core {
        number: usize,
        elsewhere: Arc<Mutex<Option<CpuSet>>>,
    }

    impl Core {
        /// One for each of so many threads; none if this process has not just as many: of a part of them, other
        /// processes might take the same.
        pub(in super::super) fn one_each(threads: usize) -> Vec<Self> {
            let Ok(all) = sched_getaffinity(None) else { return Vec::new() };
            let numbers = (0..CpuSet::MAX_CPU).filter(|&number| all.is_set(number));
            let core = |number| Self { number, elsewhere: Arc::default() };
            let cores: Vec<Self> = numbers.map(core).collect();
            if cores.len() == threads { cores } else { Vec::new() }
        }

        /// Keeps this thread, and those that it starts, to the core.
        pub(super) fn stay(&self) {
            let mut one = CpuSet::new();
            one.set(self.number);
            let stayed = sched_getaffinity(None).and_then(|before| {
                *lock(&self.elsewhere) = Some(before);
                // Where it must not be any more, it does not go.
                if before.is_set(self.number) { sched_setaffinity(None, &one) } else { Ok(()) }
            });
            if let Err(error) = stayed {
                debug!(
                    core = self.number,
                    error = &error as &dyn std::error::Error,
                    "not kept to it"
                );
            }
        }

        /// Lets this thread go where the one that keeps to the core could before.
        pub(in super::super) fn leave(&self) {
            let elsewhere = *lock(&self.elsewhere);
            let left = elsewhere.map_or(Ok(()), |elsewhere| sched_setaffinity(None, &elsewhere));
            if let Err(error) = left {
                debug!(core = self.number, error = &error as &dyn std::error::Error, "not left");
            }
        }
    }
}

#[cfg(not(target_os = "linux"))]
mod system {
    /// There is none.
    #[derive(Clone, Debug)]
    pub(in super::super) enum Core {}

    impl Core {
        pub(in super::super) fn one_each(_threads: usize) -> Vec<Self> {
            Vec::new()
        }

        pub(super) fn stay(&self) {
            match *self {}
        }

        pub(in super::super) fn leave(&self) {
            match *self {}
        }
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};
    use tokio::runtime::Builder;
    use tokio::task::{spawn_blocking, yield_now};

    use super::*;

    #[test]
    fn a_thread_keeps_to_its_core_while_there_are_insertions_and_those_it_starts_do_not() {
        let all = sched_getaffinity(None).unwrap();
        let numbers: Vec<usize> = (0..CpuSet::MAX_CPU).filter(|&core| all.is_set(core)).collect();
        assert!(Core::one_each(numbers.len() + 1).is_empty());
        assert!(Core::one_each(numbers.len() - 1).is_empty());
        let [core, other] = [numbers.len() - 1, 0].map(|place| {
            let mut one = CpuSet::new();
            one.set(numbers[place]);
            (Core::one_each(numbers.len()).swap_remove(place), one)
        });
        let mut builder = Builder::new_current_thread();
        let starts = core.0.clone();
        let runtime = builder.on_thread_start(move || starts.leave()).build().unwrap();
        runtime.block_on(async {
            let own = async || {
                yield_now().await;
                sched_getaffinity(None).unwrap()
            };
            let inserting = watch::Sender::new(0);
            let keeper = tokio::spawn(core.0.keep(inserting.subscribe()));
            assert_eq!(own().await, all);
            for some in [1, 2, 1] {
                inserting.send_replace(some);
                assert_eq!(own().await, core.1);
            }
            let started = spawn_blocking(|| sched_getaffinity(None).unwrap());
            assert_eq!(started.await.unwrap(), all);
            inserting.send_replace(0);
            assert_eq!(own().await, all);
            // Whoever has sent it elsewhere since is heeded.
            sched_setaffinity(None, &other.1).unwrap();
            for some in [1, 0] {
                inserting.send_replace(some);
                assert_eq!(own().await, other.1);
            }
            sched_setaffinity(None, &all).unwrap();
            drop(inserting);
            keeper.await.unwrap();
        });
    }
}
