//! Ingests behind what is served or drawn: on a thread of its own that gives way to all others.
//!
//! A dataset that is kept goes into the catalog. One that is temporary goes into a catalog of its own in a
//! folder `temporary-…` of it, which is taken away as soon as its archives are open: nothing is left to be
//! found, however the process ends. A process killed before that leaves the folder, and one killed while it built
//! what is kept leaves the build: a file `inserting-…` says which. The next [`sweep`] takes both away, as their
//! owner's locks are gone with the owner.

use std::fs::{self, File};
use std::io::{self, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::thread;

use areoid_formats::archive::Archive;
use areoid_formats::body::Body;
use areoid_formats::catalog::{Build, Catalog, CatalogError, DatasetRecord, RealDisk};
use areoid_preprocess::build::Proceed;
use areoid_preprocess::ingest::{Event, IngestError, Outcome, Request, Unfinished, ingest};

/// How long an inserted dataset lives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lifetime {
    /// In the catalog, until it is removed.
    Kept,
    /// Until the process ends: no file is left.
    Temporary,
}

/// A dataset, or the parts of a group, that were inserted.
#[derive(Debug)]
pub struct Inserted {
    /// What the ingest did.
    pub outcome: Outcome,
    /// What is in no catalog: the archives of temporary datasets. They are gone when these are.
    pub temporary: Vec<(DatasetRecord, Archive)>,
}

/// An insertion that failed and left no trace.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum InsertError {
    /// The ingest.
    #[error(transparent)]
    Ingest(#[from] IngestError),
    /// What was made cannot be opened.
    #[error(transparent)]
    Catalog(#[from] CatalogError),
    /// A temporary dataset of another body than the catalog's.
    #[error("the catalog shows {catalog}, the raster {raster}")]
    OtherBody {
        /// The catalog's body.
        catalog: String,
        /// The rasters' body.
        raster: String,
    },
    /// A temporary dataset of a name that the catalog has.
    #[error("the catalog has a dataset called {name}: a temporary one cannot stand in its place")]
    Taken {
        /// The name.
        name: String,
    },
    /// No place for a temporary dataset, or for the notice of a build.
    #[error("cannot prepare an insertion in {}", folder.display())]
    Place {
        /// The catalog's folder.
        folder: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The system gave no thread, or the one it gave panicked.
    #[error("the thread of the insertion failed")]
    Thread(#[source] io::Error),
}

/// How little of the processor an insertion asks for while others want it.
const NICE: i32 = 19;

const TEMPORARY: &str = "temporary-";
const INSERTING: &str = "inserting-";
const LOCK: &str = "owner.lock";

/// Ingests into the catalog that `request` names and `body` is of, and waits; `watch` hears of it on the
/// insertion's thread and may stop it.
///
/// The dataset is in the catalog then, or in what is returned: to show it is the caller's step.
///
/// # Errors
///
/// Any [`InsertError`]; the catalog is as it was, and nothing of the build is left.
pub fn insert(
    request: Request,
    lifetime: Lifetime,
    body: &Body,
    watch: impl FnMut(Event) -> Proceed + Send,
) -> Result<Inserted, InsertError> {
    thread::scope(|scope| {
        let work = thread::Builder::new().name("areoid-insert".to_owned());
        let work = work.spawn_scoped(scope, move || {
            give_way();
            match lifetime {
                Lifetime::Kept => keep(request, watch),
                Lifetime::Temporary => make_temporary(request, body, watch),
            }
        });
        let panicked = |_| InsertError::Thread(io::Error::other("it panicked"));
        work.map_err(InsertError::Thread)?.join().map_err(panicked)?
    })
}

/// Lowers this thread's priority, and so that of the threads it will start. Linux counts it by thread.
///
/// However nice a thread is, others that wake wait until it has had a slice of some milliseconds. Idle ones
/// they interrupt.
#[cfg(target_os = "linux")]
fn give_way() {
    use thread_priority::{
        NormalThreadSchedulePolicy::Idle, ThreadPriority, ThreadSchedulePolicy::Normal,
        set_thread_priority_and_policy, thread_native_id,
    };
    // Being as urgent as others is no failure.
    let _ = set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Min, Normal(Idle));
    let _ = rustix::process::nice(NICE);
}

#[cfg(not(target_os = "linux"))]
fn give_way() {}

fn keep(
    request: Request,
    watch: impl FnMut(Event) -> Proceed + Send,
) -> Result<Inserted, InsertError> {
    let request = Request { unfinished: Unfinished::Discard, ..request };
    // What is not there yet has nobody who would sweep it.
    let _notice = request.catalog.is_dir().then(|| Notice::new(&request)).transpose()?;
    match ingest(&RealDisk, &request, watch) {
        Ok(outcome) => Ok(Inserted { outcome, temporary: Vec::new() }),
        Err(error) => {
            if error.can_be_resumed() {
                discard(&request);
            }
            Err(error.into())
        }
    }
}

/// Takes away the build that a failed ingest has kept, or those of its parts.
fn discard(request: &Request) {
    request.datasets().iter().for_each(|dataset| discard_build(&request.catalog, dataset));
}

fn discard_build(folder: &Path, dataset: &str) {
    // If it stays, the next build of that name discards it; if another process has it, that builds it.
    let _ = Build::resume(&RealDisk, folder, dataset).and_then(Build::discard);
}

/// A file, locked by its owner, that names the builds which the next sweep discards if its owner was killed.
struct Notice {
    path: PathBuf,
    owner: File,
}

impl Notice {
    fn new(request: &Request) -> Result<Self, InsertError> {
        let make = || {
            let (path, owner) =
                make_own(&request.catalog, INSERTING, |path| File::create_new(path))?;
            // From here on it goes if anything fails.
            let mut notice = Self { path, owner };
            notice.owner.lock()?;
            notice.owner.write_all(request.datasets().join("\n").as_bytes())?;
            Ok(notice)
        };
        make().map_err(|source| InsertError::Place { folder: request.catalog.clone(), source })
    }
}

impl Drop for Notice {
    fn drop(&mut self) {
        // If it stays, the next sweep finds nothing of those names, or what another process builds.
        let _ = fs::remove_file(&self.path);
    }
}

/// Makes something of a name in `folder` that nobody else has, though processes on other machines may be called
/// as this one.
fn make_own<T>(
    folder: &Path,
    kind: &str,
    make: impl Fn(&Path) -> io::Result<T>,
) -> io::Result<(PathBuf, T)> {
    static NEXT: AtomicU64 = AtomicU64::new(0);
    loop {
        let number = NEXT.fetch_add(1, Relaxed);
        let path = folder.join(format!("{kind}{}-{number}", std::process::id()));
        match make(&path) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
            made => return Ok((path, made?)),
        }
    }
}

fn make_temporary(
    request: Request,
    body: &Body,
    watch: impl FnMut(Event) -> Proceed + Send,
) -> Result<Inserted, InsertError> {
    let main = Catalog::open(&request.catalog)?;
    let called = request.called();
    let mut names = request.datasets().into_iter().chain([called.clone()]);
    if names.any(|name| main.named(&name).is_ok()) {
        return Err(InsertError::Taken { name: called });
    }
    let place = Place::new(&request.catalog)?;
    let request = Request { catalog: place.catalog(), unfinished: Unfinished::Discard, ..request };
    let outcome = ingest(&RealDisk, &request, watch)?;
    let (catalog, archives) = Catalog::open_with_archives(&request.catalog)?;
    if catalog.body() != body {
        let (catalog, raster) = (body.name.clone(), catalog.body().name.clone());
        return Err(InsertError::OtherBody { catalog, raster });
    }
    let temporary = catalog.datasets().iter().cloned().zip(archives).collect();
    Ok(Inserted { outcome, temporary })
}

/// A folder for a temporary catalog, gone when it is dropped.
struct Place {
    folder: PathBuf,
    _owner: File,
}

impl Place {
    fn new(catalog: &Path) -> Result<Self, InsertError> {
        let make = || {
            let (folder, ()) = make_own(catalog, TEMPORARY, |path| fs::create_dir(path))?;
            let owner = File::create(folder.join(LOCK))?;
            owner.lock()?;
            Ok(Self { folder, _owner: owner })
        };
        make().map_err(|source| InsertError::Place { folder: catalog.to_owned(), source })
    }

    fn catalog(&self) -> PathBuf {
        self.folder.join("catalog")
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        // If it stays, the next start sweeps it.
        let _ = fs::remove_dir_all(&self.folder);
    }
}

/// Takes away what killed processes left of insertions into the catalog at `folder`.
pub fn sweep(folder: &Path) {
    let Ok(listing) = fs::read_dir(folder) else { return };
    for entry in listing.flatten() {
        let (name, path) = (entry.file_name(), entry.path());
        let name = name.to_str().unwrap_or_default();
        if name.starts_with(TEMPORARY) {
            // Without a lock to hold, its owner was killed before it could; or is about to make one: then
            // the insertion fails, and can be asked for again.
            let owner = File::open(path.join(LOCK));
            if owner.is_ok_and(|owner| owner.try_lock().is_err()) {
                continue;
            }
            // What stays is swept by the next start.
            let _ = fs::remove_dir_all(path);
        } else if name.starts_with(INSERTING) {
            let Ok(mut notice) = File::open(&path) else { continue };
            let mut names = String::new();
            if notice.try_lock().is_err() || notice.read_to_string(&mut names).is_err() {
                continue;
            }
            names.lines().for_each(|dataset| discard_build(folder, dataset));
            let _ = fs::remove_file(path);
        }
    }
}

#[cfg(test)]
mod tests {
    /// As the system tells it: field 19 of a thread's `stat` is how nice it is, field 41 its policy.
    #[cfg(target_os = "linux")]
    #[test]
    fn an_insertion_and_the_threads_it_starts_give_way() {
        use std::{fs, thread};

        const IDLE: &str = "5";
        let own = || {
            let stat = fs::read_to_string("/proc/thread-self/stat").unwrap();
            let fields: Vec<_> = stat.rsplit(") ").next().unwrap().split(' ').collect();
            [fields[19 - 3], fields[41 - 3]].map(str::to_owned)
        };
        let before = own();
        let given = thread::spawn(move || {
            super::give_way();
            (own(), thread::spawn(own).join().unwrap())
        });
        let (given, started) = given.join().unwrap();
        assert_eq!((&given, &started), (&["19", IDLE].map(str::to_owned), &given));
        assert_eq!(own(), before);
    }
}
