//! A medium that errs, lies, cuts short and dawdles by a plan, under sessions that look elsewhere all
//! the time: nobody gets a wrong page, budgets hold, and once it is whole again everything comes.

use std::sync::atomic::AtomicU64;
use std::time::{Duration, Instant};

use proptest::prelude::*;

use super::*;

/// The faulty twin of bytes in memory.
#[derive(Debug)]
struct FaultySource {
    bytes: Vec<u8>,
    plan: Arc<Plan>,
}

/// What happens to which read: a function of the seed and of how many there were.
#[derive(Debug, Default)]
struct Plan {
    seed: u64,
    reads: AtomicU64,
    /// Reads that went wrong in each way.
    counts: [AtomicU64; 4],
    faulty: AtomicBool,
}

impl ByteSource for FaultySource {
    fn len(&self) -> u64 {
        ByteSource::len(&self.bytes)
    }

    fn read_exact_at(&self, buffer: &mut [u8], offset: u64) -> io::Result<()> {
        let plan = &self.plan;
        self.bytes.read_exact_at(buffer, offset)?;
        if !plan.faulty.load(Relaxed) {
            return Ok(());
        }
        let number = u32::try_from(plan.reads.fetch_add(1, Relaxed)).unwrap();
        let page = PageAddress::new(Level(0), number, 0);
        let share = chance(page, plan.seed);
        // Four reads of ten go wrong, in four ways.
        let Some(which) = (0..4_u8).find(|which| share < 0.1 * f64::from(which + 1)) else {
            return Ok(());
        };
        let count = &plan.counts[usize::from(which)];
        count.fetch_add(1, Relaxed);
        match which {
            0 => Err(io::Error::other("the medium is out of order")),
            1 => Err(io::ErrorKind::UnexpectedEof.into()),
            2 => {
                let middle = buffer.len() / 2;
                buffer[middle] ^= 0x10;
                Ok(())
            }
            _ => {
                std::thread::sleep(Duration::from_millis(3));
                Ok(())
            }
        }
    }
}

fn faulty(bytes: Vec<u8>, plan: &Arc<Plan>) -> Arc<Archive> {
    let source = FaultySource { bytes, plan: Arc::clone(plan) };
    Arc::new(Archive::open(Box::new(source)).unwrap())
}

/// What is shown is what was stored, whichever dataset it is of.
fn assert_right(selection: &Selection, truth: &Archive) {
    let mut shown = std::collections::HashSet::new();
    for found in &selection.pages {
        assert!(selection.datasets.get(found.dataset).is_some(), "a mixture");
        assert!(shown.insert((found.dataset, found.entry.page)), "shown twice");
        let entry = truth.find(found.entry.page).unwrap().unwrap();
        assert_eq!(found.page.texels(), truth.page(&entry).unwrap().texels());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3))]

    #[test]
    fn a_faulty_medium_shows_nothing_wrong_and_heals(seed in 1_u64..200) {
        let (description, bytes) = planet("globe", globe(), Kind::Height);
        let whole = Gated::from_bytes(description, bytes.clone());
        let plan = Arc::new(Plan { seed, ..Plan::default() });
        let options = Options {
            budget_bytes: 60 * 66 * 66 * 4,
            in_flight_bytes: 30 * 66 * 66 * 4,
            concurrent_loads: 3,
        };
        let archives = vec![(whole.info.clone(), faulty(bytes.clone(), &plan))];
        let cache = Cache::with_archives(mars(), archives, options).unwrap();
        let mut sessions = [cache.session(), cache.session()];

        plan.faulty.store(true, Relaxed);
        let start = Instant::now();
        let mut step = 0;
        while start.elapsed() < Duration::from_millis(900) {
            step += 1;
            for (number, session) in sessions.iter_mut().enumerate() {
                let page = PageAddress::new(Level(0), step / 8, u32::try_from(number).unwrap());
                let chance = |salt| chance(page, seed + salt);
                let height = 10.0_f64.powf(5.0 + 2.0 * chance(3));
                let place = [360.0 * chance(1), 160.0 * chance(2) - 80.0];
                assert_right(&session.update(&view(place[0], place[1], height, 40.0)), &whole.archive);
            }
            if step % 40 == 0 {
                // Its index may not be readable just now: then nothing changes.
                let _ = cache.insert(whole.info.clone(), faulty_again(&plan, &bytes));
            }
            std::thread::sleep(Duration::from_millis(2));
        }
        plan.faulty.store(false, Relaxed);

        for count in &plan.counts {
            prop_assert!(count.load(Relaxed) > 0, "{plan:?}");
        }
        let near = view(10.0, 20.0, 3e5, 30.0);
        let start = Instant::now();
        for session in &mut sessions {
            loop {
                let now = session.update(&near);
                assert_right(&now, &whole.archive);
                if now.missing == 0 && now.failed.is_empty() && now.pages.len() == now.wanted {
                    prop_assert!(!now.pages.is_empty());
                    break;
                }
                prop_assert!(start.elapsed() < Duration::from_secs(60), "stuck: {:?}", cache.stats());
                std::thread::sleep(Duration::from_millis(2));
            }
        }
        let stats = cache.stats();
        prop_assert!(stats.errors > 0 && stats.peak_bytes <= stats.budget_bytes, "{stats:?}");
        drop(sessions);
        cache.remove("globe");
        while cache.stats().bytes + cache.stats().reserved_bytes > 0 {
            prop_assert!(start.elapsed() < Duration::from_secs(60), "kept: {:?}", cache.stats());
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

/// Another copy, which the plan leaves alone while it is opened.
fn faulty_again(plan: &Arc<Plan>, bytes: &[u8]) -> Arc<Archive> {
    plan.faulty.store(false, Relaxed);
    let archive = faulty(bytes.to_vec(), plan);
    plan.faulty.store(true, Relaxed);
    archive
}
