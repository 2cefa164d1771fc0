//! One page, for whoever asks for it by name.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use areoid_formats::address::PageAddress;
use areoid_formats::archive::{ArchiveError, Payload};
use tokio::task::spawn_blocking;

use crate::engine::Engine;
use crate::selection::ResidentPage;
use crate::store::{PageName, Request, Work};

/// Why there is no page.
#[derive(Clone, Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PageError {
    /// The cache has no dataset of this number, or has it no more.
    #[error("the cache has no dataset {0}")]
    NoSuchDataset(usize),

    /// It cannot be read; it may be tried again.
    #[error("cannot load {page} of dataset {dataset}: {error}")]
    Failed {
        /// The number of its dataset.
        dataset: usize,
        /// Which page.
        page: PageAddress,
        /// Why, in words.
        error: Arc<str>,
    },

    /// The index cannot be read.
    #[error("cannot find {page} of dataset {dataset}")]
    Index {
        /// The number of its dataset.
        dataset: usize,
        /// Which page.
        page: PageAddress,
        /// Why.
        source: Arc<ArchiveError>,
    },

    /// Sessions hold so much that there is no room for it.
    #[error("no memory for {page} of dataset {dataset}: all of the budget is in use")]
    NoRoom {
        /// The number of its dataset.
        dataset: usize,
        /// Which page.
        page: PageAddress,
    },

    /// The cache is gone.
    #[error("the cache is closed")]
    Closed,
}

/// Requests of one page stand among those of sessions, with numbers from the other end.
static LAST: AtomicU64 = AtomicU64::new(u64::MAX);

/// A place among the sessions, given back when dropped.
struct Turn<'a> {
    engine: &'a Engine,
    number: u64,
}

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        self.engine.shared().store().remove_session(self.number);
        self.engine.shared().wake();
    }
}

/// A page of the finest data or any other; `None` if there is none.
///
/// # Cancel safety
///
/// Dropping the future withdraws the request.
pub(crate) async fn load(
    engine: &Engine,
    dataset: usize,
    page: PageAddress,
) -> Result<Option<Arc<ResidentPage>>, PageError> {
    let shared = engine.shared();
    let name = PageName { dataset, page };
    if let Some(found) = shared.store().touch(name) {
        return Ok(Some(found));
    }
    let scene = shared.scene();
    let place = scene.place(dataset).ok_or(PageError::NoSuchDataset(dataset))?;
    let known = Arc::clone(&scene.datasets[place]);
    let entry = match known.pages.find_resident(page) {
        Some(entry) => entry,
        None => {
            let pages = Arc::clone(&known.pages);
            let found = spawn_blocking(move || pages.find(page)).await;
            let found = found.map_err(|_| PageError::Closed)?;
            found.map_err(|error| PageError::Index { dataset, page, source: Arc::new(error) })?
        }
    };
    let Some(entry) = entry else { return Ok(None) };
    let stored = match entry.payload {
        Payload::Constant(_) => 0,
        Payload::Record { length, .. } => length as usize,
    };
    let work = Work::Texels(name);
    let bytes = known.load_bytes(stored);
    let mut news = shared.subscribe();
    let turn = Turn { engine, number: LAST.fetch_sub(1, Relaxed) };
    let request = Request { work, dataset: known, entry, bytes };
    shared.store().add_session(turn.number);
    let mut asked = false;
    loop {
        {
            let mut store = shared.store();
            if let Some(found) = store.touch(name) {
                return Ok(Some(found));
            }
            if let Some(error) = store.error(work) {
                return Err(PageError::Failed { dataset, page, error: Arc::clone(error) });
            }
            // It speaks of this request from the second look on.
            if store.stalled && asked {
                return Err(PageError::NoRoom { dataset, page });
            }
            // Anew each time: it may have been loaded, and dropped for others before it was seen here.
            store.replace_requests(turn.number, vec![request.clone()]);
            asked = true;
        }
        shared.start(engine.handle());
        news.changed().await.map_err(|_| PageError::Closed)?;
    }
}
