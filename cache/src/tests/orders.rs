//! What sessions, the dispatcher and loads do to the store at once. All of it happens in steps under
//! one lock, so that every run of the threads is an order of these steps: of a few of them all
//! orders are tried, of many some thousands.

use super::*;
use crate::scene::{Dataset, Newcomer, Scene};
use crate::selection::ResidentPage;
use crate::store::{Limits, Outcome, PageName, Request, Store, Work};
use areoid_formats::page::{Page, Texels};

/// Says what happens next: one of so many.
trait Chooser {
    fn choose(&mut self, options: usize) -> usize;
}

/// All choices there are, one order after another.
#[derive(Default)]
struct All {
    path: Vec<(usize, usize)>,
    depth: usize,
}

impl All {
    /// Goes on to the next order; whether there is one.
    fn advance(&mut self) -> bool {
        self.depth = 0;
        while let Some((choice, options)) = self.path.pop() {
            if choice + 1 < options {
                self.path.push((choice + 1, options));
                return true;
            }
        }
        false
    }
}

impl Chooser for All {
    fn choose(&mut self, options: usize) -> usize {
        if self.depth == self.path.len() {
            self.path.push((0, options));
        }
        self.depth += 1;
        let (choice, there) = self.path[self.depth - 1];
        assert_eq!(there, options, "an order went another way when it was tried again");
        choice
    }
}

/// Any choices.
struct Random(u64);

impl Chooser for Random {
    fn choose(&mut self, options: usize) -> usize {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        usize::try_from(self.0 >> 33).unwrap() % options
    }
}

/// What a session does: pages that it wants, and pages that it expects to want.
type Wish = (&'static [usize], &'static [usize]);

/// A load under way, as `loader.rs` runs it: it looks whether it is wanted before it reads and after, then ends.
struct Running {
    request: Request,
    looked: usize,
}

struct World {
    store: Store,
    dataset: Arc<Dataset>,
    entries: Vec<PageEntry>,
    running: Vec<Running>,
    /// What each session draws, which stays.
    drawn: Vec<Vec<Arc<ResidentPage>>>,
    started: u64,
    limits: Limits,
}

impl World {
    fn new(planet: &Gated, budget_bytes: usize, loads: usize) -> Self {
        let newcomer =
            Newcomer::new(planet.info.clone(), Arc::clone(&planet.archive) as _).unwrap();
        let scene = Scene::empty(mars()).changed(|_| false, [newcomer]);
        let dataset = Arc::clone(&scene.datasets[0]);
        let limits = Limits { loads, bytes: budget_bytes };
        Self {
            store: Store::new(budget_bytes, limits),
            dataset,
            entries: planet.entries.clone(),
            running: Vec::new(),
            drawn: vec![Vec::new(); 3],
            started: 0,
            limits,
        }
    }

    fn name(&self, page: usize) -> PageName {
        PageName { dataset: self.dataset.number, page: self.entries[page].page }
    }

    fn requests(&self, pages: &[usize]) -> Vec<Request> {
        let request = |&page: &usize| Request {
            work: Work::Texels(self.name(page)),
            dataset: Arc::clone(&self.dataset),
            entry: self.entries[page],
            bytes: self.dataset.load_bytes(0),
        };
        pages.iter().map(request).collect()
    }

    fn wish(&mut self, session: usize, (now, soon): Wish) {
        let names: Vec<PageName> = now.iter().map(|&page| self.name(page)).collect();
        let drawn = names.into_iter().filter_map(|name| self.store.touch(name));
        self.drawn[session] = drawn.collect();
        let [now, soon] = [now, soon].map(|pages| self.requests(pages));
        self.store.replace_requests(session as u64, now);
        self.store.replace_ahead(session as u64, soon);
    }

    /// Starts a load, if one may start; whether one did.
    fn start(&mut self) -> bool {
        let Some(request) = self.store.next() else { return false };
        let is_twin = self.running.iter().any(|running| running.request.work == request.work);
        assert!(!is_twin, "two loads of {:?}", request.work);
        assert!(!self.store.holds(request.work.name()), "{:?} is there", request.work);
        self.running.push(Running { request, looked: 0 });
        self.started += 1;
        true
    }

    /// A load goes on by a step, or is given up.
    fn go_on(&mut self, place: usize, given_up: bool) {
        let work = self.running[place].request.work;
        if given_up {
            self.running.remove(place);
            self.store.finish(work, Outcome::Failed("given up".into()));
        } else if self.running[place].looked < 2 {
            if self.store.cancel_if_unwanted(work) {
                self.running.remove(place);
            } else {
                self.running[place].looked += 1;
            }
        } else {
            let Running { request, .. } = self.running.remove(place);
            let texels = Texels::Height(vec![0.0; 66 * 66]);
            let (dataset, entry) = (self.dataset.number, request.entry);
            let page = ResidentPage { dataset, entry, page: Page::new(66, texels, None) };
            self.store.finish(work, Outcome::Loaded(Some(Arc::new(page))));
        }
    }

    /// A page that a session wants in the end, is not there, and could be.
    fn lacks(&self, script: &[Wish]) -> Option<usize> {
        let lacks = |page: &&usize| {
            let name = self.name(**page);
            !self.store.holds(name) && self.store.error(Work::Texels(name)).is_none()
        };
        script[script.len() - 1].0.iter().find(lacks).copied()
    }

    fn check(&self) {
        let stats = &self.store.stats;
        let reserved: usize = self.running.iter().map(|running| running.request.bytes).sum();
        assert_eq!(stats.reserved_bytes, reserved);
        assert!(stats.bytes + reserved <= stats.budget_bytes, "{stats:?}");
        assert!(self.running.len() <= self.limits.loads);
        let held = (0..self.entries.len()).filter(|&page| self.store.holds(self.name(page)));
        assert_eq!(stats.bytes, held.count() * 66 * 66 * 4);
        let ended = stats.loads + stats.cancelled + stats.errors;
        assert_eq!(ended + self.running.len() as u64, self.started);
    }
}

/// What sessions do is done in the order that `chooser` says, with loads between and beside. When
/// nothing goes on, they look again, as sessions do that are told of loads: at the end all that is wanted
/// is there, unless a load of it was given up.
fn play(world: &mut World, scripts: &[&[Wish]], failures: usize, chooser: &mut dyn Chooser) {
    let mut steps = vec![0; scripts.len()];
    for session in 0..scripts.len() {
        world.store.add_session(session as u64);
    }
    let (mut failures, mut looks, mut may_start) = (failures, 3, false);
    loop {
        let acting: Vec<usize> =
            (0..scripts.len()).filter(|&session| steps[session] < scripts[session].len()).collect();
        let loads = world.running.len();
        let options =
            acting.len() + usize::from(may_start) + loads * (1 + usize::from(failures > 0));
        if options == 0 {
            let lacking = scripts.iter().any(|script| world.lacks(script).is_some());
            if looks == 0 || !lacking {
                break;
            }
            for (session, script) in scripts.iter().enumerate() {
                world.wish(session, script[script.len() - 1]);
            }
            (looks, may_start) = (looks - 1, true);
            continue;
        }
        let choice = chooser.choose(options);
        if let Some(&session) = acting.get(choice) {
            world.wish(session, scripts[session][steps[session]]);
            steps[session] += 1;
            may_start = true;
        } else if may_start && choice == acting.len() {
            // As long as there is something to start it goes on; afterwards it sleeps until it is woken.
            may_start = world.start();
        } else {
            let choice = choice - acting.len() - usize::from(may_start);
            let given_up = choice >= loads;
            failures -= usize::from(given_up);
            let before = world.running.len();
            world.go_on(choice % loads, given_up);
            may_start |= world.running.len() < before;
        }
        world.check();
    }
    assert_eq!(world.store.stats.reserved_bytes, 0);
    for script in scripts {
        assert_eq!(world.lacks(script), None);
    }
}

fn planet() -> Gated {
    Gated::globe()
}

/// Two sessions want a page and one of them no longer: every order in which that can go with its load.
#[test]
fn of_a_few_steps_every_order_goes_well() {
    let planet = planet();
    let page = 66 * 66 * 5;
    let scripts: [&[Wish]; 2] = [&[(&[0], &[]), (&[], &[])], &[(&[], &[0]), (&[0], &[])]];
    let (mut all, mut orders, mut cancelled, mut ahead) = (All::default(), 0, 0, 0);
    loop {
        let mut world = World::new(&planet, 8 * page, 2);
        play(&mut world, &scripts, 1, &mut all);
        (cancelled, ahead) =
            (cancelled + world.store.stats.cancelled, ahead + world.store.stats.ahead);
        orders += 1;
        if !all.advance() {
            break;
        }
    }
    assert!(orders > 1000 && cancelled > 0 && ahead > 0, "{orders} {cancelled} {ahead}");
}

/// Three sessions and more pages than there is room for.
#[test]
fn of_many_steps_some_thousand_orders_go_well() {
    let planet = planet();
    let page = 66 * 66 * 5;
    let scripts: [&[Wish]; 3] = [
        &[(&[0, 1], &[2]), (&[1, 2], &[3, 4]), (&[5], &[]), (&[0, 1], &[])],
        &[(&[0], &[1, 2, 3]), (&[6, 0], &[]), (&[], &[7]), (&[2], &[0])],
        &[(&[], &[]), (&[3, 2, 1, 0], &[]), (&[0, 2], &[5, 6])],
    ];
    let (mut evicted, mut cancelled) = (0, 0);
    for seed in 0..4000 {
        let mut world = World::new(&planet, 4 * page, 2);
        play(&mut world, &scripts, usize::from(seed % 3 == 0), &mut Random(seed));
        evicted += world.store.stats.evictions;
        cancelled += world.store.stats.cancelled;
    }
    assert!(evicted > 1000 && cancelled > 1000, "{evicted} {cancelled}");
}
