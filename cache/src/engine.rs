//! The threads of a cache, and what they share with its sessions.

use std::io;
use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use tokio::runtime::{Builder, Handle, Runtime};

use crate::loader::Shared;
use crate::scene::Scene;

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
    pub(crate) fn new(scene: Scene, budget_bytes: usize, loads: usize) -> io::Result<Self> {
        let runtime = Builder::new_multi_thread()
            .worker_threads(1)
            .max_blocking_threads(loads.max(1))
            .thread_name("areoid-cache")
            .build()?;
        let shared = Arc::new(Shared::new(scene, budget_bytes, loads));
        runtime.spawn(Arc::clone(&shared).dispatch());
        let (visited, repeated) = (AtomicU64::new(0), AtomicU64::new(0));
        Ok(Self { shared, runtime: Some(runtime), visited, repeated })
    }

    pub(crate) fn shared(&self) -> &Shared {
        &self.shared
    }

    pub(crate) fn handle(&self) -> &Handle {
        self.runtime.as_ref().expect("the runtime lives until the engine is dropped").handle()
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
