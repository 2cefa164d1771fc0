//! The service's threads, from the start to the end.

use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::thread::{self, JoinHandle};
use std::time::Duration;

use tokio::runtime::{Builder, Runtime};
use tokio::sync::Semaphore;
use tokio::task::spawn_blocking;
use tokio::time::{sleep, timeout};
use tracing::{info, warn};

use super::admin::{self, Gate};
use super::cores::Core;
use super::hub::{HEIGHTS, Hub, stopped};
use super::lanes::Lane;
use super::listen::accept;
use super::options::{Admin, Options, ServiceError};
use super::public;

/// How often the catalog's folder is looked at.
const LOOK_EVERY: Duration = Duration::from_millis(400);

/// Connections of the admin listener.
const ADMIN_CONNECTIONS: usize = 64;

/// Reads that wait for a disk, on each thread that answers; heights take no other's place.
const READS: usize = 8 + HEIGHTS;

/// A service that runs.
///
/// # Threads
///
/// Any thread may call anything; [`Self::stop`] waits.
#[derive(Debug)]
pub struct Service {
    hub: Arc<Hub>,
    threads: Vec<JoinHandle<()>>,
    public: SocketAddr,
    admin: Option<SocketAddr>,
}

impl Service {
    /// Opens the catalog and listens.
    ///
    /// # Errors
    ///
    /// Any [`ServiceError`].
    pub fn start(options: &Options) -> Result<Self, ServiceError> {
        let gate = options
            .admin
            .as_ref()
            .map(|admin| Gate::open(admin, options.limits.insertions))
            .transpose()?;
        let admin = options.admin.as_ref().map(bind_admin).transpose()?.flatten();
        crate::insertion::sweep(&options.folder);
        let limits = options.limits;
        let hub = Hub::open(&options.folder, options.memory_bytes, limits)?;
        let hub = Arc::new(hub);
        let listener = bind(options.listen)?;
        let listens = |source| ServiceError::Listen { address: options.listen, source };
        let public = listener.local_addr().map_err(listens)?;
        let places = Arc::new(Semaphore::new(limits.connections));

        let mut service = Self { hub, threads: Vec::new(), public, admin: None };
        let started = service.start_threads(options, gate, (&listener, admin), &places);
        if let Err(error) = started {
            service.stop();
            return Err(error);
        }
        Ok(service)
    }

    fn start_threads(
        &mut self,
        options: &Options,
        gate: Option<Gate>,
        (listener, admin): (&TcpListener, Option<TcpListener>),
        places: &Arc<Semaphore>,
    ) -> Result<(), ServiceError> {
        let limits = options.limits;
        let one_a_core = || thread::available_parallelism().map_or(1, usize::from);
        let threads = options.threads.unwrap_or_else(one_a_core).max(1);
        let mut cores = Core::one_each(threads).into_iter();
        for (number, lane) in Lane::all(threads).into_iter().enumerate() {
            let listener = listener.try_clone().map_err(ServiceError::Threads)?;
            let (hub, places) = (Arc::clone(&self.hub), Arc::clone(places));
            let core = cores.next();
            let runtime = runtime(READS, core.clone())?;
            self.spawn(format!("areoid-http-{number}"), runtime, async move {
                if let Some(core) = core {
                    tokio::spawn(core.keep(hub.inserting.subscribe()));
                }
                let Ok(listener) = tokio::net::TcpListener::from_std(listener) else { return };
                let asked = Arc::clone(&hub);
                let respond = move |request, _| public::answer(Arc::clone(&asked), request);
                accept(listener, lane, hub, Arc::clone(&places), limits, respond).await;
                drained(places, limits.connections, limits.drain).await;
            })?;
        }

        self.admin = admin.as_ref().and_then(|admin| admin.local_addr().ok());
        let (hub, runtime) = (Arc::clone(&self.hub), runtime(READS, None)?);
        self.spawn("areoid-control".to_owned(), runtime, async move {
            tokio::spawn(follow(Arc::clone(&hub)));
            let listener = admin.and_then(|admin| tokio::net::TcpListener::from_std(admin).ok());
            let lane = Lane::all(1).pop();
            if let (Some(listener), Some(lane), Some(gate)) = (listener, lane, gate.map(Arc::new)) {
                let insertions = Arc::clone(&gate.places);
                let places = Arc::new(Semaphore::new(ADMIN_CONNECTIONS));
                let asked = Arc::clone(&hub);
                let respond =
                    move |request, _| admin::answer(Arc::clone(&asked), Arc::clone(&gate), request);
                accept(listener, lane, hub, Arc::clone(&places), limits, respond).await;
                // An insertion hears that it is to end, and takes away what it has made.
                tokio::join!(
                    drained(places, ADMIN_CONNECTIONS, limits.drain),
                    drained(insertions, limits.insertions, limits.drain)
                );
            } else {
                // Nobody can hear that the hub is gone while this holds it.
                stopped(&mut hub.stopping.subscribe()).await;
            }
        })
    }

    fn spawn(
        &mut self,
        name: String,
        runtime: Runtime,
        work: impl Future<Output = ()> + Send + 'static,
    ) -> Result<(), ServiceError> {
        let thread = thread::Builder::new().name(name).spawn(move || {
            runtime.block_on(work);
            // A read that hangs keeps nobody.
            runtime.shutdown_background();
        });
        self.threads.push(thread.map_err(ServiceError::Threads)?);
        Ok(())
    }

    #[cfg(test)]
    pub(super) fn hub(&self) -> &Hub {
        &self.hub
    }

    /// Where anybody may ask.
    #[must_use]
    pub fn public(&self) -> SocketAddr {
        self.public
    }

    /// Where the second listener is.
    #[must_use]
    pub fn admin(&self) -> Option<SocketAddr> {
        self.admin
    }

    /// Takes no connection any more and waits for the requests in flight, as long as they may take.
    pub fn stop(mut self) {
        self.hub.stopping.send_replace(true);
        for thread in self.threads.drain(..) {
            // A thread that panicked has said so.
            let _ = thread.join();
        }
    }
}

/// Serves until the process is asked to end; asked twice, it ends at once.
///
/// # Errors
///
/// Any [`ServiceError`].
pub fn run(options: &Options, started: impl FnOnce(&Service)) -> Result<(), ServiceError> {
    let runtime = runtime(1, None)?;
    // From now on no signal is missed, and none ends the process by itself.
    let mut signals = runtime.block_on(async { Signals::new() }).map_err(ServiceError::Threads)?;
    let service = Service::start(options)?;
    info!(listen = %service.public, admin = ?service.admin, "serving");
    started(&service);
    runtime.block_on(signals.next());
    info!("ending");
    let stopping = thread::Builder::new().spawn(move || service.stop());
    let stopping = stopping.map_err(ServiceError::Threads)?;
    runtime.block_on(async {
        let ended = spawn_blocking(move || stopping.join());
        tokio::select! {
            _ = ended => {}
            () = signals.next() => warn!("ended with requests in flight"),
        }
    });
    runtime.shutdown_background();
    Ok(())
}

/// What asks a process to end.
struct Signals {
    #[cfg(unix)]
    all: [tokio::signal::unix::Signal; 2],
}

impl Signals {
    #[cfg(unix)]
    fn new() -> std::io::Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Self { all: [signal(SignalKind::terminate())?, signal(SignalKind::interrupt())?] })
    }

    #[cfg(unix)]
    async fn next(&mut self) {
        let [terminated, interrupted] = &mut self.all;
        tokio::select! {
            _ = terminated.recv() => {}
            _ = interrupted.recv() => {}
        }
    }

    #[cfg(not(unix))]
    fn new() -> std::io::Result<Self> {
        Ok(Self {})
    }

    #[cfg(not(unix))]
    async fn next(&mut self) {
        // Without handlers the system ends the process itself.
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
    }
}

/// Shows what other processes change.
///
/// # Cancel safety
///
/// Dropped while it looks, the look comes to its end.
async fn follow(hub: Arc<Hub>) {
    loop {
        sleep(LOOK_EVERY).await;
        if hub.is_stopping() {
            return;
        }
        let looking = Arc::clone(&hub);
        match spawn_blocking(move || looking.refresh()).await {
            Ok(Ok(())) => {}
            // It may be gone for a moment, or for good: what is shown is kept.
            Ok(Err(error)) => warn!(error = &error as &dyn std::error::Error, "catalog not read"),
            Err(_) => return,
        }
    }
}

/// Waits until all connections have ended, but not for ever.
async fn drained(places: Arc<Semaphore>, all: usize, patience: Duration) {
    let all = u32::try_from(all).unwrap_or(u32::MAX);
    // What has not ended by then is dropped with its runtime.
    let _ = timeout(patience, places.acquire_many_owned(all)).await;
}

fn bind(address: SocketAddr) -> Result<TcpListener, ServiceError> {
    let listener = TcpListener::bind(address).and_then(|listener| {
        listener.set_nonblocking(true)?;
        Ok(listener)
    });
    listener.map_err(|source| ServiceError::Listen { address, source })
}

/// The second listener, or none where that is taken and may be done without.
fn bind_admin(admin: &Admin) -> Result<Option<TcpListener>, ServiceError> {
    match bind(admin.listen) {
        Err(ServiceError::Listen { address, source }) if admin.is_optional => {
            warn!(%address, %source, "no second listener");
            Ok(None)
        }
        listener => listener.map(Some),
    }
}

/// Threads that may wait go where the one that answers may, while it keeps to its core.
fn runtime(blocking: usize, core: Option<Core>) -> Result<Runtime, ServiceError> {
    let mut builder = Builder::new_current_thread();
    if let Some(core) = core {
        builder.on_thread_start(move || core.leave());
    }
    let runtime = builder.enable_all().max_blocking_threads(blocking).build();
    runtime.map_err(ServiceError::Threads)
}

impl Drop for Service {
    fn drop(&mut self) {
        self.hub.stopping.send_replace(true);
    }
}
