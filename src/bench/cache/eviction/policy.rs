//! Which page goes when there is no room for another: policies, and traces replayed under them.
//!
//! # References
//!
//! * J. Yang et al., *FIFO queues are all you need for cache eviction*, SOSP 2023: S3-FIFO.
//! * L. A. Belady, *A study of replacement algorithms for a virtual-storage computer*, 1966: the
//!   least that any policy can fetch, which knows what will be needed.

use std::collections::{HashMap, HashSet, VecDeque};

use areoid_formats::address::PageAddress;

/// A dataset's number, and one of its pages.
pub(super) type Name = (usize, PageAddress);

/// A page that a frame needs.
#[derive(Clone, Copy, Debug)]
pub(super) struct Need {
    pub(super) name: Name,
    pub(super) error_m: f64,
    pub(super) bytes: usize,
}

/// What some frames need, one after another.
pub(super) type Trace = Vec<Vec<Need>>;

/// Which page goes.
///
/// # Contract
///
/// [`Self::used`] is told every page of every frame, in the order of frames. [`Self::victim`] names a
/// page that was used, is not pinned and has not been named since, or none.
pub(super) trait Policy {
    fn used(&mut self, need: &Need, frame: usize);
    fn victim(&mut self, frame: usize, is_pinned: &dyn Fn(&Name) -> bool) -> Option<Name>;
}

/// How a trace went.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Outcome {
    pub(super) fetched: usize,
    /// Those that had been fetched before.
    pub(super) again: usize,
    pub(super) again_bytes: usize,
}

/// Fetches what each frame needs and does not find within `budget_bytes`. What the frame needs stays.
pub(super) fn replay(trace: &Trace, budget_bytes: usize, policy: &mut dyn Policy) -> Outcome {
    let (mut held, mut known) = (HashMap::new(), HashSet::new());
    let (mut bytes, mut outcome) = (0, Outcome::default());
    for (frame, needs) in trace.iter().enumerate() {
        let pinned: HashSet<Name> = needs.iter().map(|need| need.name).collect();
        for need in needs {
            if !held.contains_key(&need.name) {
                while bytes + need.bytes > budget_bytes {
                    let victim = policy.victim(frame, &|name| pinned.contains(name));
                    let Some(freed) = victim.and_then(|name| held.remove(&name)) else { break };
                    bytes -= freed;
                }
                outcome.fetched += 1;
                if !known.insert(need.name) {
                    outcome.again += 1;
                    outcome.again_bytes += need.bytes;
                }
                held.insert(need.name, need.bytes);
                bytes += need.bytes;
            }
            policy.used(need, frame);
        }
    }
    outcome
}

/// What is known of a page that is held.
#[derive(Clone, Copy, Debug)]
pub(super) struct Held {
    last_frame: usize,
    /// Of all uses, by when it was.
    last_use: u64,
    need: Need,
}

/// The page of the greatest rank goes.
pub(super) struct Ranked {
    rank: fn(&Held, usize) -> f64,
    held: HashMap<Name, Held>,
    uses: u64,
}

impl Ranked {
    pub(super) fn by(rank: fn(&Held, usize) -> f64) -> Self {
        Self { rank, held: HashMap::new(), uses: 0 }
    }
}

/// The least recently needed.
pub(super) fn oldest(held: &Held, frame: usize) -> f64 {
    (frame - held.last_frame) as f64
}

/// The finest; of a level, the least recently needed.
pub(super) fn deepest(held: &Held, frame: usize) -> f64 {
    let level = f64::from(held.need.name.1.level.0);
    level + 1.0 - 1.0 / (1.0 + oldest(held, frame))
}

/// The least recently needed, where a page counts as the older the less its error is: what is coarse
/// stands in for more.
pub(super) fn weighted(held: &Held, frame: usize) -> f64 {
    const LEAST_M: f64 = 1.0;
    oldest(held, frame) / held.need.error_m.max(LEAST_M).sqrt()
}

impl Policy for Ranked {
    fn used(&mut self, need: &Need, frame: usize) {
        self.uses += 1;
        let held = Held { last_frame: frame, last_use: self.uses, need: *need };
        self.held.insert(need.name, held);
    }

    fn victim(&mut self, frame: usize, is_pinned: &dyn Fn(&Name) -> bool) -> Option<Name> {
        let free = self.held.iter().filter(|(name, _)| !is_pinned(name));
        let ranked = free.map(|(name, held)| ((self.rank)(held, frame), held.last_use, *name));
        // Of equals, the one used first.
        let worst = ranked.max_by(|one, other| one.0.total_cmp(&other.0).then(other.1.cmp(&one.1)));
        let (_, _, name) = worst?;
        self.held.remove(&name);
        Some(name)
    }
}

/// The page that is needed again last goes.
pub(super) struct Clairvoyant {
    /// Of each page, the frames that need it, ascending.
    frames: HashMap<Name, Vec<usize>>,
    held: HashSet<Name>,
}

impl Clairvoyant {
    pub(super) fn of(trace: &Trace) -> Self {
        let mut frames: HashMap<Name, Vec<usize>> = HashMap::new();
        for (frame, needs) in trace.iter().enumerate() {
            for need in needs {
                frames.entry(need.name).or_default().push(frame);
            }
        }
        Self { frames, held: HashSet::new() }
    }
}

impl Policy for Clairvoyant {
    fn used(&mut self, need: &Need, _: usize) {
        self.held.insert(need.name);
    }

    fn victim(&mut self, frame: usize, is_pinned: &dyn Fn(&Name) -> bool) -> Option<Name> {
        let next = |name: &Name| {
            let frames = &self.frames[name];
            let next = frames.partition_point(|&needed| needed <= frame);
            frames.get(next).copied().unwrap_or(usize::MAX)
        };
        let free = self.held.iter().filter(|name| !is_pinned(name));
        let name = free.map(|name| (next(name), *name)).max().map(|(_, name)| name)?;
        self.held.remove(&name);
        Some(name)
    }
}

/// Two queues and a memory of who left the first: what is needed once goes soon.
///
/// A view needs a page in many frames on end: they count as one use.
#[derive(Default)]
pub(super) struct S3Fifo {
    small: VecDeque<Name>,
    main: VecDeque<Name>,
    ghosts: VecDeque<Name>,
    /// Uses since it came or was passed over, at most 3, and the last frame that needed it.
    uses: HashMap<Name, (u8, usize)>,
}

impl S3Fifo {
    /// The part of the pages that may be in the first queue.
    const SMALL: usize = 10;

    /// Takes from a queue's head: the page, and its uses.
    fn head(&self, of_main: bool) -> Option<(Name, u8)> {
        let name = *if of_main { self.main.front() } else { self.small.front() }?;
        Some((name, self.uses[&name].0))
    }

    fn leave(&mut self, name: Name) -> Option<Name> {
        self.uses.remove(&name);
        Some(name)
    }
}

impl Policy for S3Fifo {
    fn used(&mut self, need: &Need, frame: usize) {
        let name = need.name;
        if let Some((uses, last)) = self.uses.get_mut(&name) {
            if *last + 1 < frame {
                *uses = (*uses + 1).min(3);
            }
            *last = frame;
            return;
        }
        self.uses.insert(name, (0, frame));
        if let Some(place) = self.ghosts.iter().position(|ghost| *ghost == name) {
            self.ghosts.remove(place);
            self.main.push_back(name);
        } else {
            self.small.push_back(name);
        }
    }

    fn victim(&mut self, _: usize, is_pinned: &dyn Fn(&Name) -> bool) -> Option<Name> {
        let pages = self.small.len() + self.main.len();
        // A page is passed over four times at most before it goes, unless it is pinned: where all of a
        // queue is, it is the other one's turn.
        for step in 0..8 * pages {
            let is_small_full = self.small.len() * Self::SMALL > pages;
            let of_main = is_small_full == (step >= 4 * pages);
            let of_main = !self.main.is_empty() && (of_main || self.small.is_empty());
            let (name, uses) = self.head(of_main)?;
            if of_main {
                self.main.pop_front();
                if uses == 0 && !is_pinned(&name) {
                    return self.leave(name);
                }
                if !is_pinned(&name) {
                    self.uses.entry(name).and_modify(|(uses, _)| *uses -= 1);
                }
                self.main.push_back(name);
            } else {
                self.small.pop_front();
                if is_pinned(&name) {
                    self.small.push_back(name);
                } else if uses > 0 {
                    self.uses.entry(name).and_modify(|(uses, _)| *uses = 0);
                    self.main.push_back(name);
                } else {
                    self.ghosts.push_back(name);
                    // As many as there is room for in the other queue.
                    while self.ghosts.len() > pages {
                        self.ghosts.pop_front();
                    }
                    return self.leave(name);
                }
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use areoid_formats::address::Level;

    fn need(number: u32) -> Need {
        let name = (0, PageAddress::new(Level(u8::from(number > 9)), 0, number));
        Need { name, error_m: if number > 9 { 1.0 } else { 100.0 }, bytes: 1 }
    }

    /// A frame for each group of numbers.
    fn trace(frames: &[&[u32]]) -> Trace {
        frames.iter().map(|frame| frame.iter().map(|number| need(*number)).collect()).collect()
    }

    #[test]
    fn the_least_recently_needed_goes() {
        let trace = trace(&[&[1], &[2], &[1], &[3], &[1], &[2]]);
        let outcome = replay(&trace, 2, &mut Ranked::by(oldest));
        // 3 takes the place of 2, and 2 that of 3.
        assert_eq!(outcome, Outcome { fetched: 4, again: 1, again_bytes: 1 });
    }

    #[test]
    fn what_is_fine_goes_before_what_is_coarse() {
        let trace = trace(&[&[1], &[11], &[12], &[1]]);
        assert_eq!(replay(&trace, 2, &mut Ranked::by(oldest)).again, 1);
        assert_eq!(replay(&trace, 2, &mut Ranked::by(deepest)).again, 0);
        assert_eq!(replay(&trace, 2, &mut Ranked::by(weighted)).again, 0);
    }

    /// Pages that are needed once do not drive out the ones that are needed again and again.
    #[test]
    fn a_scan_passes_through_the_small_queue() {
        let mut frames: Vec<Vec<u32>> = Vec::new();
        for round in 0..20 {
            frames.extend([vec![1], vec![2], vec![3]]);
            frames.extend((0..4).map(|step| vec![20 + 4 * round + step]));
        }
        let frames: Vec<&[u32]> = frames.iter().map(Vec::as_slice).collect();
        let trace = trace(&frames);
        let [fifo, lru] =
            [replay(&trace, 5, &mut S3Fifo::default()), replay(&trace, 5, &mut Ranked::by(oldest))];
        assert_eq!(lru.again, 3 * 19);
        assert!(fifo.again <= 6, "{fifo:?}");
    }

    #[test]
    fn nobody_fetches_less_than_who_knows_what_comes() {
        let mut state = 1_u32;
        for budget in [4, 7, 11] {
            let frames: Vec<Vec<u32>> = (0..400)
                .map(|_| {
                    let mut frame: Vec<u32> = (0..3)
                        .map(|_| {
                            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                            (state >> 16) % 20
                        })
                        .collect();
                    frame.sort_unstable();
                    frame.dedup();
                    frame
                })
                .collect();
            let frames: Vec<&[u32]> = frames.iter().map(Vec::as_slice).collect();
            let trace = trace(&frames);
            let least = replay(&trace, budget, &mut Clairvoyant::of(&trace)).fetched;
            let others: [&mut dyn Policy; 4] = [
                &mut Ranked::by(oldest),
                &mut Ranked::by(deepest),
                &mut Ranked::by(weighted),
                &mut S3Fifo::default(),
            ];
            for other in others {
                let outcome = replay(&trace, budget, other);
                assert!(outcome.fetched >= least, "{outcome:?} {least}");
                assert_eq!(outcome.fetched, outcome.again + 20);
            }
        }
    }
}
