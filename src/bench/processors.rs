//! Processors for those who serve, and others for those who ask.

use std::io;

use super::report::cores;

/// One half of the processors that this program may use; if their number is odd, the second has one more.
/// Threads of one core are in one half, as far as that goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Half {
    First,
    Second,
}

/// Whether there are two halves, on a system that can keep them apart.
pub(super) fn can_be_parted() -> bool {
    cfg!(target_os = "linux") && cores() > 1
}

/// Does `work` on this thread. What that starts stays on one half of the processors too, or goes where it likes
/// if no half is named or none [can be parted](can_be_parted) from the other.
///
/// # Errors
///
/// Those of `work`, and the system's.
pub(super) fn on<T>(half: Option<Half>, work: impl FnOnce() -> io::Result<T>) -> io::Result<T> {
    match half {
        Some(half) if can_be_parted() => on_half(half, work),
        _ => work(),
    }
}

#[cfg(target_os = "linux")]
fn on_half<T>(half: Half, work: impl FnOnce() -> io::Result<T>) -> io::Result<T> {
    use nix::sched::{CpuSet, sched_getaffinity, sched_setaffinity};
    use nix::unistd::Pid;

    const THIS_THREAD: Pid = Pid::from_raw(0);

    /// Where this thread may run when it is done.
    struct Home(CpuSet);

    impl Drop for Home {
        fn drop(&mut self) {
            // It was there before.
            let _ = sched_setaffinity(THIS_THREAD, &self.0);
        }
    }

    let all = sched_getaffinity(THIS_THREAD)?;
    let mut mine: Vec<usize> =
        (0..CpuSet::count()).filter(|&cpu| all.is_set(cpu).is_ok_and(|is_set| is_set)).collect();
    mine.sort_by_key(|&cpu| (core_of(cpu), cpu));
    let (first, second) = mine.split_at(mine.len() / 2);
    let mut some = CpuSet::new();
    for &cpu in if half == Half::First { first } else { second } {
        some.set(cpu)?;
    }
    let _home = Home(all);
    sched_setaffinity(THIS_THREAD, &some)?;
    work()
}

/// The package and the core that a processor is a thread of, as far as the system tells.
#[cfg(target_os = "linux")]
fn core_of(cpu: usize) -> [Option<usize>; 2] {
    ["physical_package_id", "core_id"].map(|name| {
        let path = format!("/sys/devices/system/cpu/cpu{cpu}/topology/{name}");
        std::fs::read_to_string(path).ok()?.trim().parse().ok()
    })
}

#[cfg(not(target_os = "linux"))]
fn on_half<T>(_half: Half, work: impl FnOnce() -> io::Result<T>) -> io::Result<T> {
    work()
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use std::collections::BTreeSet;
    use std::fs;

    use super::*;

    /// As the system tells it.
    fn allowed() -> Option<BTreeSet<usize>> {
        let status = fs::read_to_string("/proc/thread-self/status").ok()?;
        let list = status.lines().find_map(|line| line.strip_prefix("Cpus_allowed_list:"))?;
        let mut all = BTreeSet::new();
        for part in list.trim().split(',') {
            let (first, last) = part.split_once('-').unwrap_or((part, part));
            all.extend(first.parse::<usize>().ok()?..=last.parse::<usize>().ok()?);
        }
        Some(all)
    }

    #[test]
    fn halves_are_apart_and_what_comes_after_is_on_all_again() {
        let all = allowed().unwrap();
        let [first, second] = [Half::First, Half::Second]
            .map(|half| on(Some(half), || Ok(allowed().unwrap())).unwrap());
        if can_be_parted() {
            assert_eq!(first.len(), all.len() / 2);
            assert!(first.is_disjoint(&second));
        }
        assert_eq!(&first | &second, all);
        assert_eq!(on(None, || Ok(allowed())).unwrap().unwrap(), all);
        let failed = on(Some(Half::First), || -> io::Result<()> { Err(io::Error::other("no")) });
        assert!(failed.is_err());
        assert_eq!(allowed().unwrap(), all);
    }
}
