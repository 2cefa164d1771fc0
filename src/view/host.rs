//! What a window asks for: pages of a cache, insertions into its folder, files beside the user.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;

use areoid_cache::insertion::{self, Lifetime};
use areoid_cache::insertion_request::InsertRequest;
use areoid_cache::{Cache, Datasets, Selection, Session, Stats, View};
use areoid_formats::body::Body;
use areoid_preprocess::build::Proceed;
use areoid_preprocess::ingest::{Event, Request};
use areoid_viewer::Style;
use areoid_viewer::window::{Content, Host, Insertion, InsertionState};
use serde_json::json;

use super::saver::Saver;
use crate::failure::in_full;

/// A cache for a window. Insertions run on threads of their own, which give way to all others.
#[derive(Debug)]
pub(super) struct CacheHost {
    cache: Cache,
    session: Session,
    /// Where rasters go, if the catalog is a folder.
    folder: Option<PathBuf>,
    insertions: Arc<Mutex<Vec<Insertion>>>,
    saver: Saver,
}

impl CacheHost {
    pub(super) fn new(cache: Cache, folder: Option<PathBuf>) -> Self {
        let mut session = cache.session();
        session.blends = true;
        Self { cache, session, folder, insertions: Arc::default(), saver: Saver::new() }
    }
}

impl Host for CacheHost {
    fn follow(&mut self, style: &Style) {
        let style = style.clone();
        self.session.hide(move |info| style.hides(&info.name));
    }

    fn exaggerate(&mut self, times: f64) {
        self.session.exaggerate(times);
    }

    fn update(&mut self, views: &[View]) -> Arc<Selection> {
        self.session.update_all(views)
    }

    fn datasets(&self) -> Datasets {
        self.cache.datasets()
    }

    fn stats(&self) -> Stats {
        self.cache.stats()
    }

    fn insert(&mut self, raster: &Path) {
        let name = raster.file_name().unwrap_or(raster.as_os_str()).to_string_lossy().into_owned();
        let started = self.folder.as_deref().ok_or("a server's catalog is changed on the server");
        let request = started.map_err(str::to_owned).and_then(|folder| request(raster, folder));
        let mut list = locked(&self.insertions);
        let place = list.len();
        let state = match &request {
            Ok(_) => InsertionState::Running(0),
            Err(reason) => InsertionState::Failed(reason.clone()),
        };
        list.push(Insertion { name, state });
        drop(list);
        if let Ok(request) = request {
            let (insertions, body) = (Arc::clone(&self.insertions), self.cache.body().clone());
            let tell = move |state| locked(&insertions)[place].state = state;
            let teller = tell.clone();
            let work = thread::Builder::new().name("insertion".to_owned());
            if let Err(error) = work.spawn(move || run(request, &body, teller)) {
                tell(InsertionState::Failed(error.to_string()));
            }
        }
    }

    fn insertions(&self) -> Vec<Insertion> {
        locked(&self.insertions).clone()
    }

    fn save(&mut self, stem: &str, content: Content) {
        self.saver.save(stem, content);
    }

    fn saved(&mut self) -> Option<Result<String, String>> {
        self.saver.saved()
    }
}

fn locked(list: &Mutex<Vec<Insertion>>) -> MutexGuard<'_, Vec<Insertion>> {
    list.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A raster as `areoid ingest` takes it.
fn request(raster: &Path, folder: &Path) -> Result<Request, String> {
    let raster = std::path::absolute(raster).map_err(|error| error.to_string())?;
    let request: InsertRequest = serde_json::from_value(json!({ "rasters": [raster] }))
        .map_err(|error| error.to_string())?;
    request.request(folder.to_owned())
}

/// The cache follows its folder: what is in the catalog shows by itself.
fn run(request: Request, body: &Body, tell: impl Fn(InsertionState) + Send + Sync) {
    let watch = |event: Event| {
        if let Event::Building(progress) = event
            && let Some(percent) = (100 * progress.units_done).checked_div(progress.units)
        {
            tell(InsertionState::Running(u8::try_from(percent).unwrap_or(100)));
        }
        Proceed::Yes
    };
    let inserted = insertion::insert(request, Lifetime::Kept, body, watch);
    tell(match inserted {
        Ok(_) => InsertionState::Done,
        Err(error) => InsertionState::Failed(in_full(&error)),
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use areoid_cache::Options;
    use std::time::{Duration, Instant};

    fn host(folder: Option<PathBuf>) -> CacheHost {
        let body = Body::parse("mars").unwrap();
        let cache = Cache::with_archives(body, Vec::new(), Options::with_budget(1 << 20)).unwrap();
        CacheHost::new(cache, folder)
    }

    fn outcome(host: &CacheHost) -> InsertionState {
        let end = Instant::now() + Duration::from_secs(60);
        loop {
            match &host.insertions()[0].state {
                InsertionState::Running(_) if Instant::now() < end => thread::yield_now(),
                state => return state.clone(),
            }
        }
    }

    #[test]
    fn an_insertion_that_fails_says_why() {
        let folder = tempfile::tempdir().unwrap();
        let mut local = host(Some(folder.path().to_owned()));
        local.insert(&folder.path().join("none.tif"));
        let InsertionState::Failed(reason) = outcome(&local) else { panic!("it was inserted") };
        assert!(reason.contains("none.tif"), "{reason}");

        let mut afar = host(None);
        afar.insert(Path::new("none.tif"));
        let InsertionState::Failed(reason) = outcome(&afar) else { panic!("it was inserted") };
        assert!(reason.contains("on the server"), "{reason}");
    }
}
