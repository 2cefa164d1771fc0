//! The threads of a cache, and what they share with its sessions.

use std::collections::HashSet;
use std::io;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use std::time::Duration;

use tokio::runtime::{Builder, Handle, Runtime};
use tokio::time::sleep;

use crate::loader::Shared;
use crate::scene::{Newcomer, Scene};
use crate::selection::DatasetInfo;
use crate::store::Limits;

/// How long sessions draw datasets that have been replaced or removed.
pub(crate) const ADOPT_WITHIN: Duration = Duration::from_millis(500);

/// The runtime and what its tasks work on.
#[derive(Debug)]
pub(crate) struct Engine {
    shared: Arc<Shared>,
    /// `Some` until dropped.
    runtime: Option<Runtime>,
    pub(crate) visited: AtomicU64,
    pub(crate) repeated: AtomicU64,
}

impl Engine {
    pub(crate) fn new(scene: Scene, budget_bytes: usize, limits: Limits) -> io::Result<Self> {
        let runtime = Builder::new_multi_thread()
            .worker_threads(1)
            // One more looks at the catalog, one looks a server's name up, one looks ahead, and one tells
            // media what comes.
            .max_blocking_threads(limits.loads + 4)
            .enable_all()
            .thread_name("areoid-cache")
            .build()?;
        let shared = Arc::new(Shared::new(scene, budget_bytes, limits));
        runtime.spawn(Arc::clone(&shared).dispatch(runtime.handle().clone()));
        runtime.spawn(Arc::clone(&shared).tidy());
        let (visited, repeated) = (AtomicU64::new(0), AtomicU64::new(0));
        Ok(Self { shared, runtime: Some(runtime), visited, repeated })
    }

    /// One whose threads the caller is: nothing goes on by itself.
    #[cfg(test)]
    pub(crate) fn still(scene: Scene, budget_bytes: usize, limits: Limits) -> Self {
        let runtime = Builder::new_current_thread().enable_all().build().unwrap();
        let shared = Arc::new(Shared::new(scene, budget_bytes, limits));
        let (visited, repeated) = (AtomicU64::new(0), AtomicU64::new(0));
        Self { shared, runtime: Some(runtime), visited, repeated }
    }

    pub(crate) fn shared(&self) -> &Arc<Shared> {
        &self.shared
    }

    pub(crate) fn handle(&self) -> &Handle {
        self.runtime.as_ref().expect("the runtime lives until the engine is dropped").handle()
    }

    /// Drops the datasets that `drop` is true for and takes in others, in one step that every
    /// session hears of.
    pub(crate) fn change(&self, drop: impl Fn(&DatasetInfo) -> bool, newcomers: Vec<Newcomer>) {
        self.step(|before| before.changed(&drop, newcomers.iter().cloned()));
    }

    /// Takes in datasets in the place of what a user could mean by `names`, a group as a whole, in one step
    /// that every session hears of.
    pub(crate) fn replace(&self, names: &HashSet<String>, newcomers: Vec<Newcomer>) {
        self.step(|before| {
            let goes =
                |info: &DatasetInfo| names.contains(&info.name) || names.contains(info.called());
            let gone: HashSet<&str> =
                before.all().filter(|info| goes(info)).map(DatasetInfo::called).collect();
            before.changed(|info| gone.contains(info.called()), newcomers.iter().cloned())
        });
    }

    fn step(&self, after: impl Fn(&Scene) -> Scene) {
        loop {
            let before = self.shared.scene();
            let after = after(&before);
            if self.shared.replace_scene(&before, after) {
                break;
            }
        }
        // Sessions that still draw what was before are told when they have to stop.
        let shared = Arc::clone(&self.shared);
        self.handle().spawn(async move {
            sleep(ADOPT_WITHIN).await;
            shared.tell();
        });
    }

    /// What failed may be tried again at once: what was in its way is gone.
    pub(crate) fn forgive(&self) {
        self.shared.store().forgive();
        self.shared.tell();
    }
}

impl Drop for Engine {
    fn drop(&mut self) {
        // Waiting for loads here could block whoever lets go last: the thread that draws, say.
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}
